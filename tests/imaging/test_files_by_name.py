"""Scenes and fields by their names: one's own before those that come with the program."""

import pickle
import shutil

import pytest

import virtual_sensor as vs
from virtual_sensor.files import named_file
from virtual_sensor.imaging.scene import load_scene, scene_files
from virtual_sensor.imaging.scene_file import find_scene, shipped_scenes
from virtual_sensor.medium.find_field import find_field
from virtual_sensor.studies.field_info import field_info

NAME = "hot_cylinder_900C_quarter"
SHIPPED = shipped_scenes() / "fields" / f"{NAME}.nc"
WAYS = (NAME, f"{NAME}.nc", f"fields/{NAME}", f"fields/{NAME}.nc")


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder to work in, whose name is not plain."""
    folder = tmp_path / "Grüße aus dem Büro"
    folder.mkdir()
    monkeypatch.chdir(folder)
    return folder


def test_a_shipped_field_is_found_by_its_name_from_anywhere(here):
    """By four spellings, from a shipped scene, one of one's own and Python."""
    own = shutil.copy(shipped_scenes() / "cold_cylinder.xml", here / "own.xml")
    text = own.read_text(encoding="utf-8")
    air = f'"refractive"><string name="field" value="{NAME}"/>'
    own.write_text(text.replace('"refractive">', air), encoding="utf-8")
    assert load_scene("own.xml").air.path == SHIPPED
    for way in WAYS:
        assert find_field(way) == SHIPPED
        assert load_scene("hot_cylinder", field=way).air.path == SHIPPED
    assert vs.IndexField.read(NAME).source.startswith("OpenFOAM")


def test_ones_own_file_comes_before_a_shipped_one(here):
    """Named alike, where one stands or in a folder `fields` there; a default stays the scene's."""
    for place in (here / "fields", here):  # the nearer one last
        place.mkdir(exist_ok=True)
        mine = shutil.copy(SHIPPED, place / f"{NAME}.nc")
        for way in WAYS[:2] if place == here else WAYS:
            assert find_field(way).absolute() == mine
            assert load_scene("hot_cylinder", field=way).air.path == mine
    assert load_scene("hot_cylinder", temperature=900).air.path == SHIPPED
    assert find_scene("hot_cylinder") == shipped_scenes() / "hot_cylinder.xml"
    shutil.copy(shipped_scenes() / "cold_cylinder.xml", here / "hot_cylinder.xml")
    assert find_scene("hot_cylinder").absolute() == here / "hot_cylinder.xml"


def test_a_field_found_by_its_name_is_one_of_the_scenes_files(here):
    """Rationale: what was measured is known by its files, and a scene that is pickled by theirs."""
    mine = shutil.copy(SHIPPED, here / "mine.nc")
    scene = load_scene("hot_cylinder", field="mine")
    assert mine in scene_files(scene.path, dict(scene.parameters))
    assert pickle.loads(pickle.dumps(scene)) == scene
    with mine.open("ab") as file:
        file.write(b"\n")
    with pytest.raises(vs.InputError, match=r"mine\.nc was changed"):
        scene.with_parameters(beta=1)


def test_a_mistyped_name_is_answered_with_places_names_and_the_nearest(here):
    """In a line: where it was looked for, what there is, and what may be meant."""
    shutil.copy(SHIPPED, here / "bracket_air.nc")
    for asked, words in {
        "hot_cylinder_1050C_quarter": ("with a field: 900, 1100, 1250; virtual-sensor",),
        "hot_cilinder_900C_quarter": ("1100C_quarter, hot_cylinder_1250C", "did you mean hot_"),
        "braket_air.nc": (f"looked in {here};", "there is bracket_air.nc", "did you mean bracket_"),
        "air/x.nc": (f"looked in {here}/air (no folder)", "simulate makes one"),
    }.items():
        for read in (vs.IndexField.read, lambda name: field_info(name)):
            with pytest.raises(vs.InputError, match="there is no such field file") as refused:
                read(asked)
            for word in words:
                assert word in str(refused.value)
    with pytest.raises(vs.InputError, match=r"installed scenes: .*cold.*mean hot_cylinder\?"):
        load_scene("hot_cilinder")
    with pytest.raises(vs.InputError, match="did you mean bracket_air"):
        load_scene("hot_cylinder", field="bracket_ai")


def test_a_path_in_the_home_folder_is_found(here, monkeypatch):
    """Rationale: a shell leaves the ~ of `-D field=~/air.nc` as it is."""
    monkeypatch.setenv("HOME", str(here))
    mine = shutil.copy(SHIPPED, here / "air.nc")
    assert find_field("~/air") == mine
    with pytest.raises(vs.InputError, match="is a folder"):
        named_file(here, "field", ".nc", [here], [])
