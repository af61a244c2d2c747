"""What `field info` prints, draws and writes: of any field, with whatever texts in it."""

import json
import re
from xml.etree import ElementTree

import cv2
import numpy as np
import pytest
from command_line import command
from data_dictionary import undocumented
from fields_of_air import AMBIENT, HIGH, LOW, air, swaying_quantity, warm_sheet
from matplotlib.colors import to_rgb

from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity
from virtual_sensor.reporting import field as reporting
from virtual_sensor.reporting.style import colour
from virtual_sensor.studies.field_info import field_info

NASTY = "<script>alert('1')</script> $\\frac$ | [red] \x1b[31m"


def light_in(path):
    """Whether a picture shows the laser's light."""
    blue_green_red = cv2.imread(str(path))
    wanted = 255.0 * np.array(to_rgb(colour("laser"))[::-1])
    assert blue_green_red.shape[0] > 600 < blue_green_red.shape[1]
    return bool(cv2.inRange(blue_green_red, wanted - 2.0, wanted + 2.0).any())


@pytest.fixture(scope="module")
def shown(tmp_path_factory):
    """A folder with a field, its picture, page and figures; and what the command printed."""
    folder = tmp_path_factory.mktemp("shown")
    air((17, 17, 17), warm_sheet).write(folder / "air.nc")
    arguments = ("air.nc", "-o", "a.png", "--json", "a.json")
    with pytest.MonkeyPatch.context() as patch:
        patch.chdir(folder)
        patch.setenv("COLUMNS", "80")
        return folder, *command("field", "info", *arguments)


def test_the_command_prints_draws_and_writes(shown, monkeypatch):
    """Rationale: the terminal for people, the picture for strangers, the file for programs."""
    folder, status, out, err = shown
    assert (status, err) == (0, "")
    for words in ("largest jump of n", "Narrowest", "every 2nd", "Border: sound.", "Grid: "):
        assert words in out
    assert re.search(
        r"^[\d.]+ (ms|s|min) in all; figures in a.json, picture in a.png, open a.html first$",
        out,
        re.M,
    )
    assert light_in(folder / "a.png")
    figures = json.loads((folder / "a.json").read_text(encoding="utf-8"))
    monkeypatch.chdir(folder)
    found = field_info(folder / "air.nc")
    assert figures["light"]["shift_px"] == found.light.shift_px.tolist()
    assert figures["border"] == "sound"
    assert figures["losses"][-1]["shift_px"]["present"] == found.losses[-1].shift_px.present
    assert sorted(p.name for p in folder.iterdir()) == ["a.html", "a.json", "a.png", "air.nc"]
    assert undocumented(folder, reporting.FILES) == ["air.nc"]


@pytest.mark.slow
@pytest.mark.parametrize("suffix", [".svg", ".pdf"])
def test_a_picture_may_be_of_curves_and_letters(tmp_path, suffix, unpainted_test):
    """Rationale: for a paper; a name with markup in it stays a name."""
    air((5, 5, 5), lambda x, y, z: 0.0).write(tmp_path / "<b>&.nc")
    reporting.save(field_info(tmp_path / "<b>&.nc"), "command", tmp_path / f"a{suffix}")
    if suffix == ".pdf":
        assert (tmp_path / "a.pdf").read_bytes().startswith(b"%PDF")
        return
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    assert root.tag.endswith("svg")
    assert len(root.findall(".//{*}image")) >= 3  # the cuts


@pytest.mark.parametrize("name", ["a.png", "a.html", "a.json"])
def test_no_result_is_overwritten_unasked(shown, tmp_path, monkeypatch, name):
    """Rationale: the page is a result too, though its name is not on the command line."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).touch()
    arguments = (shown[0] / "air.nc", "-o", "a.png", "--json", "a.json")
    status, _, err = command("field", "info", *arguments)
    assert status == 2
    assert f"{name}: exists" in err
    assert [p.name for p in tmp_path.iterdir()] == [name]


def test_the_page_opens_anywhere_and_says_the_main_things_first(shown, faults_of):
    """Rationale: by how much the image is shifted is asked first, then whether it is right."""
    page = shown[0] / "a.html"
    assert faults_of(page) == []
    html = page.read_text(encoding="utf-8")
    lead = re.search('class="lead">([^<]*)<', html)[1]
    assert re.search(r"by up to [\d.]+ mrad, .* by up to [\d.]+ px", lead)
    assert "The border is sound; the grid is" in lead
    assert html.count("<img ") == 4
    assert "virtual-sensor field info air.nc -o a.png --json a.json" in html


def test_texts_in_a_file_are_texts(tmp_path, monkeypatch, faults_of):
    """Rationale: a field comes from anybody, and its attributes hold anything, of any length."""
    monkeypatch.chdir(tmp_path)
    quantity = swaying_quantity()
    texts = {"title": NASTY, "grid": "1 2 3", "comment": "long " * 2000}
    write_quantity(
        tmp_path / "<b> $x$.nc", GriddedQuantity(**{**vars(quantity), "attributes": texts})
    )
    status, out, err = command("field", "info", "<b> $x$.nc", "-o", "<b> $x$.png")
    assert (status, err) == (0, "")
    assert "\x1b[31m" not in out.replace("\\x1b", "")
    assert "5 x 6 x 7 nodes" in out
    assert out.count("long") < 100
    html = (tmp_path / "<b> $x$.html").read_text(encoding="utf-8")
    assert "<script>" not in html
    assert html.count("long ") >= 2000
    assert faults_of(tmp_path / "<b> $x$.html") == []


def test_what_the_file_holds_is_said(tmp_path):
    """Rationale: whose field, how large, when: in the file, and yet not seen by looking at it."""
    path = tmp_path / "swaying.nc"
    write_quantity(path, swaying_quantity())
    said = dict(reporting.facts(field_info(path)).rows)
    assert re.match(rf"{path}, 0\.00\d+ MB, holds temperature", said["file"])
    assert said["times"] == "2 instants from 2 to 3 s; all figures are of 3 s"
    assert said["grid"] == "5 x 6 x 7 nodes (x, y, z), 30 x 10 x 50 mm apart"
    assert said["extent"] == (
        "x -120 to 120, y -50 to 50, z -30 to 270 mm, mirrored at x = 0 and y = 0 mm"
    )


@pytest.mark.parametrize(
    ("difference", "border", "grid"),
    [
        (lambda *place: 5e-6, "Border: tolerable.", "Grid: fine enough for 0.02 px;"),
        (lambda *place: 1e-4, "Border: too close.", "Grid: fine enough for 0.02 px;"),
        (
            lambda *place: warm_sheet(*place, half_width=10.0),
            "Border: sound.",
            "Grid: fine enough for 0.1 px but not for 0.02 px;",
        ),
    ],
)
def test_the_verdicts_are_sentences(tmp_path, difference, border, grid):
    """Rationale: the answer to the question for which the figures are asked."""
    air((17, 25, 33), difference).write(tmp_path / "air.nc")
    said = reporting.verdicts(field_info(tmp_path / "air.nc"))
    assert [said[0].startswith(border), said[1].startswith(grid)] == [True, True], said


def test_a_field_that_suits_no_scene_is_drawn_all_the_same(tmp_path):
    """Rationale: a field of another part is a field; what can't be found of it is left out."""
    aside = np.array([0.0, 500.0, 0.0])
    field = air((9, 17, 9), warm_sheet, low=LOW + aside, high=HIGH + aside)
    field.write(tmp_path / "air.nc")
    info = field_info(tmp_path / "air.nc")
    assert reporting.verdicts(info) == [
        "Grid: unknown in px, as no scene's light passes through the field."
    ]
    assert {len(row) for row in reporting.border_table(info).rows} == {4}
    assert {row[2:] for row in reporting.border_table(info).rows} == {("", "")}
    reporting.save(info, "command", tmp_path / "air.png")
    assert not light_in(tmp_path / "air.png")


@pytest.mark.parametrize(
    ("nodes", "difference"),
    [pytest.param(5, 0.0, id="even", marks=pytest.mark.slow), pytest.param(4, -AMBIENT, id="none")],
)
def test_even_and_tiny_air_can_be_drawn(tmp_path, nodes, difference):
    """Rationale: a field without any structure is where scales divide by zero."""
    air((nodes,) * 3, lambda x, y, z: difference).write(tmp_path / "air.nc")
    info = field_info(tmp_path / "air.nc")
    reporting.save(info, "command", tmp_path / "air.png", tmp_path / "air.json")
    assert light_in(tmp_path / "air.png")


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("air.nc -o a.png", "air.nc: .*there is no such field file"),
        ("-o a.png", "name a FIELD, or a --scene that has one"),
        ("broken.nc -o a.png", "broken.nc: is not a NetCDF.* file"),
        ("air.nc -o a.jpg", r"-o a.jpg: the picture is written as \.png"),
    ],
)
def test_what_cannot_be_shown_is_refused_in_a_line(tmp_path, monkeypatch, arguments, said):
    """Rationale: one line with the file's name, before anything is drawn."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "broken.nc").write_bytes(b"a picture")
    status, _, err = command("field", "info", *arguments.split())
    assert status == 2
    assert re.search(said, err)
    assert err.count("\n") == 1
    assert [p.name for p in tmp_path.iterdir()] == ["broken.nc"]
