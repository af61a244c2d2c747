"""Scene files as programs write them and as nobody should: read right, or refused in one line."""

import os
import re
import shutil
import subprocess
import sys

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.engine import mi
from virtual_sensor.imaging.loading import warnings_of as loading_notes
from virtual_sensor.imaging.scene import scene_files, scene_parameters
from virtual_sensor.imaging.scene_file import (
    LONGEST_VALUE,
    MOST_INCLUDED,
    MOST_NESTED,
    find_scene,
    parameter_words,
    shipped_scenes,
)

INCLUDED = '    <include filename="materials/$material.xml"/>\n'
INLINE = """    <bsdf type="diffuse" id="steel">
        <float name="reflectance" value="0.5"/>
    </bsdf>
"""
COLD = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
COLD = COLD.replace(INCLUDED, INLINE)
LASER_PLACE = '<lookat origin="0, 0, $distance" target="0, 0, 0" up="0, 1, 0"/>'
CAMERA_PLACE = '<lookat origin="0, 0, $distance" target="0, 0, 0" up="-1, 0, 0"/>'
STEEL = re.search(r" *<bsdf.*?</bsdf>\n", COLD, re.DOTALL)[0]
SHAPES = re.search(r" *<shape.*</shape>\n", COLD, re.DOTALL)[0]
STEEL_HEAD = '<bsdf type="diffuse" id="steel">'
MANY = "x" * 5000


def changed(old, new):
    """The cold cylinder's scene with some text replaced at its first place."""
    assert old in COLD
    return COLD.replace(old, new, 1)


def added(text):
    """The cold cylinder's scene with more elements at its end."""
    return changed("</scene>", f"{text}</scene>")


def refusal(path, **parameters):
    """The one line with which a scene is refused; it names the scene's file."""
    with pytest.raises(vs.InputError) as refused:
        vs.load_scene(path, **parameters)
    message = str(refused.value)
    assert message.startswith(str(path.parent))
    assert "\n" not in message
    assert "Traceback" not in message
    assert len(message) < 1000
    return message


@pytest.mark.parametrize(
    ("encoding", "declared"),
    [
        *((name, "") for name in ("utf-8-sig", "utf-16", "utf-32")),
        *(("utf-16", "UTF-16"), ("cp1252", "windows-1252")),
        *(("latin-1", name) for name in ("ISO-8859-1", "latin1")),
    ],
)
def test_a_scene_in_any_encoding_is_the_scene(tmp_path, encoding, declared):
    """Each letter counts where it names a file; what isn't UTF-8 is noted; lines stay the same."""
    name = "stähl.xml"
    (tmp_path / name).write_text(f'<scene version="3.0.0">\n{STEEL}</scene>', encoding="utf-8")
    head = f'<?xml version="1.0"\n encoding="{declared}"?>' if declared else ""
    path = tmp_path / "scene.xml"
    text = head + "<!-- 60°, Größe -->\n" + changed(STEEL, f'<include filename="{name}"/>\n')
    path.write_bytes(text.encode(encoding))
    scene = vs.load_scene(path)
    np.testing.assert_array_equal(
        scene.sensor.camera.matrix, vs.load_scene("cold_cylinder").sensor.camera.matrix
    )
    assert scene_files(path, scene.parameters) == [tmp_path / name]
    notes = [note for note in scene.notes if "read as" in note]
    assert len(notes) == (encoding != "utf-8-sig")
    faulty = text.replace('name="power"', 'name="pwoer"')
    path.write_bytes(faulty.encode(encoding))
    line = faulty[: faulty.index("<emitter")].count("\n") + 1
    assert f"{path}, line {line}: <emitter" in refusal(path)


def test_a_file_that_is_something_else_is_named_for_what_it_is(tmp_path):
    """A part by its suffix or its first bytes, an image, a field; with the command to take."""
    for name, data, words in (
        ("wavy 1.stl", b"\x80" * 84, "is a part, not a scene; `virtual-sensor new 'wavy 1' --part"),
        ("ascii.stl", b"solid box\n", "is a part, not a scene; `virtual-sensor new ascii --part"),
        ("part", b"ply\nformat ascii 1.0\n", "is a part, not a scene"),
        ("part.step", b"ISO-10303-21;\n", "is a part, not a scene"),
        ("frame.png", b"\x89PNG\r\n", "is an image, not a scene; `virtual-sensor detect"),
        ("air.nc", b"\x89HDF\r\n", "is a field of air, not a scene; give it to one"),
    ):
        (tmp_path / name).write_bytes(data)
        assert words in refusal(tmp_path / name)


@pytest.mark.parametrize(
    ("data", "words"),
    [
        (b'<?xml version="1.0" encoding="foo"?><scene/>', "its encoding, foo, can't be read"),
        (b'<?xml version="1.0" encoding="hex"?><scene/>', "its encoding, hex, can't be read"),
        ("<!-- ä -->\n<scene a='ä'/>".encode("latin-1"), "line 1: not utf-8 as it says"),
        (b"\xff\xfe<", "not UTF-16 as it says"),
        (b'<scene a="\0"/>', "not well-formed"),
        (b"", "no element found"),
        (b'<!DOCTYPE scene [<!ENTITY a "b">]>\n<scene a="&a;"/>', "<!ENTITY a>"),
        (
            b'<!DOCTYPE s [<!ENTITY a "aa"><!ENTITY b "&a;&a;">]><scene>&b;</scene>',
            "Mitsuba expands no entities",
        ),
        (b"<scene>" * 100_000, f"nest no more than {MOST_NESTED}"),
        (f'<scene version="{"3" * 200_000}"/>'.encode(), f"no more than {LONGEST_VALUE}"),
        (b'<scene version="3.0.0"><default value="3"/></scene>', "<default> needs a name"),
        (b'<scene version="3.0.0"><default name="" value="3"/></scene>', "<default> needs a name"),
        (b'<scene version="3.0.0"><default name="a"/></scene>', "<default> needs a name and a"),
    ],
    ids=range(13),
)
def test_what_is_no_scene_is_refused_before_mitsuba_reads_it(tmp_path, data, words):
    """Rationale: Mitsuba dies of deep nesting, and Python of entities and of unknown encodings."""
    path = tmp_path / "scene.xml"
    path.write_bytes(data)
    assert words in refusal(path)


def test_growing_defaults_are_refused(tmp_path):
    """Rationale: seven of thirty each are 2e10 characters."""
    grows = '<default name="p0" value="xxxxxxxxxx"/>'
    for n in range(1, 8):
        grows += f'<default name="p{n}" value="{f"$p{n - 1}" * 30}"/>'
    path = tmp_path / "laughs.xml"
    path.write_text(changed("<default", f"{grows}<default"), encoding="utf-8")
    assert f"grows beyond {LONGEST_VALUE} characters" in refusal(path)


@pytest.mark.parametrize(
    ("element", "close"),
    [('<shape type="sphere">', "</shape>"), ('<bsdf type="twosided">', "</bsdf>")],
)
def test_deep_nesting_is_refused(tmp_path, element, close):
    """Rationale: 10,000 nested shapes were a SIGSEGV, 1,000 nested BSDFs took for ever."""
    path = tmp_path / "deep.xml"
    for depth in (MOST_NESTED, 1000, 10_000):
        path.write_text(added(element * depth + close * depth), encoding="utf-8")
        assert f"nest no more than {MOST_NESTED}" in refusal(path)


def test_files_that_include_one_another_are_refused(tmp_path):
    """In a circle, or deeper than Mitsuba follows."""
    include = '<scene version="3.0.0"><include filename="{}.xml"/></scene>'
    for file, other in (("a", "b"), ("b", "c"), ("c", "a"), ("me", "me")):
        (tmp_path / f"{file}.xml").write_text(include.format(other), encoding="utf-8")
    for file in ("a", "me"):
        assert re.search(rf"{file}\.xml includes itself", refusal(tmp_path / f"{file}.xml"))
    for n in range(20):
        (tmp_path / f"{n}.xml").write_text(include.format(n + 1), encoding="utf-8")
    (tmp_path / "20.xml").write_text(COLD, encoding="utf-8")
    assert f"no more than {MOST_INCLUDED}" in refusal(tmp_path / "0.xml")
    assert vs.load_scene(tmp_path / "6.xml", beta=3).parameters["beta"] == "3"


def test_parameters_of_an_included_file_are_the_scenes(tmp_path):
    """They have defaults there, are given by name, and their faults name the right file."""
    material = tmp_path / "material.xml"
    text = f'<scene version="3.0.0">\n<default name="rho" value="0.5"/>\n{STEEL}</scene>'
    material.write_text(text.replace('value="0.5"/>\n    </', 'value="$rho"/>\n    </'), "utf-8")
    path = tmp_path / "scene.xml"
    path.write_text(changed(STEEL, '<include filename="material.xml"/>\n'), encoding="utf-8")
    assert scene_parameters(path, {"rho": "0.25"})["rho"] == "0.25"
    half, quarter = (vs.load_scene(path, width=64, height=64, rho=rho) for rho in (0.5, 0.25))
    np.testing.assert_allclose(vs.render(quarter), 0.5 * vs.render(half), rtol=1e-5)
    assert "no parameter 'roh'; the scene has: along" in refusal(path, roh=1)
    assert "it was made without; say --roughness to `virtual-s" in refusal(path, roughness=1)
    material.write_text(text.replace('"diffuse"', '"difuse"'), encoding="utf-8")
    assert f'{material}, line 3: there is no <bsdf type="difuse">' in refusal(path)


@pytest.mark.parametrize(
    ("name", "value"),
    [(name, value) for name in ("alpha", "beta", "tilt", "along") for value in ("nan", "1e300")]
    + [("fan", "nan"), ("line_length", "1e999"), ("line_radius", "inf"), ("dots", "0, nan")]
    + [("line_length", "1e308"), ("line_radius", "1e-320"), ("tilt", "-inf")],
)
def test_a_parameter_that_is_no_finite_number_is_refused(name, value):
    """Rationale: beta=nan was a traceback."""
    path = shipped_scenes() / "cold_cylinder.xml"
    message = refusal(path, **{name: value})
    assert f"({name}={value})" in message or f"'{name.removeprefix('line_')}'" in message


@pytest.mark.parametrize(
    ("name", "value"),
    [
        *((name, "nan") for name in ("temperature", "emissivity", "widen", "blur")),
        *((name, "inf") for name in ("temperature", "emissivity", "widen", "blur", "step")),
        ("step", "nan"),
    ],
)
def test_a_parameter_of_hot_air_that_is_no_finite_number_is_refused(name, value):
    """Also a temperature of a part that has an emissivity."""
    path = shipped_scenes() / "hot_cylinder.xml"
    message = refusal(path, **{"emissivity": 0.5, name: value})
    assert f"{name}={value}" in message
    assert "finite number" in message


FAULTS = {
    "sphere of no radius": (
        added('<shape type="sphere"><float name="radius" value="nan"/></shape>'),
        '<shape type="sphere">: radius is not a finite number',
    ),
    "sphere at no place": (
        added('<shape type="sphere"><point name="center" x="0" y="nan" z="0"/></shape>'),
        "center is not a finite number",
    ),
    "spectrum": (
        changed(
            '<float name="reflectance" value="0.5"/>', '<spectrum name="reflectance" value="nan"/>'
        ),
        "reflectance is not a finite number",
    ),
    "film beyond memory": (changed('value="$width"', 'value="1000000000"'), "give a smaller one"),
    "laser scaled": (
        changed(LASER_PLACE, f'<scale value="2"/>{LASER_PLACE}'),
        "laser_line: 'to_world' scales or shears",
    ),
    "laser sheared": (
        changed(LASER_PLACE, '<matrix value="1 .5 0 0 0 1 0 0 0 0 1 300 0 0 0 1"/>'),
        "laser_line: 'to_world' scales or shears",
    ),
    "camera scaled": (
        changed(CAMERA_PLACE, f'<scale value="2"/>{CAMERA_PLACE}'),
        '<sensor type="lens_camera">: to_world scales or shears',
    ),
    "laser far": (
        changed(LASER_PLACE, LASER_PLACE.replace("$distance", "1e20")),
        "mm from the origin; lengths are in mm",
    ),
    "no direction": (changed(LASER_PLACE, LASER_PLACE.replace("0, 1, 0", "0, 0, 1")), "lookat"),
    "no shape": (changed(SHAPES, ""), "its shapes have no finite size"),
    "camera on the part": (
        added('<sensor type="perspective"/>'),
        '<sensor id="camera_2">: the camera stands on a surface',
    ),
    "id missing": (changed('<ref id="steel"/>', '<ref id="steal"/>'), "no element has this id"),
    "id twice": (changed('id="end_minus"', 'id="end_plus"'), 'two elements have the id "end_plus"'),
    "no id": (changed('<ref id="steel"/>', "<ref/>"), '<ref> lacks its attribute "id"'),
    "no type": (changed(' type="diffuse"', ""), '<bsdf> lacks its attribute "type"'),
    "empty type": (changed('type="diffuse"', 'type=""'), "plugin name must be specified"),
    "long type": (changed('type="diffuse"', f'type="{MANY}"'), "correct its type"),
    "long property": (changed('name="power"', f'name="{MANY}"'), "correct its name"),
    "empty property": (changed('name="power"', 'name=""'), "laser_line"),
    "unknown element": (added("<foo/>"), "a scene knows no element <foo>"),
    "number out of place": (
        changed(STEEL_HEAD, f'{STEEL_HEAD}<float name="rho" value="1"/>'),
        '<bsdf type="diffuse"> has no property "rho"',
    ),
    "spectrum out of place": (
        changed(STEEL_HEAD, f'{STEEL_HEAD}<spectrum name="rho" value="1"/>'),
        '<bsdf type="diffuse"> has no property "rho"',
    ),
    "pose out of place": (
        changed(STEEL_HEAD, f'{STEEL_HEAD}<transform name="to_world"/>'),
        '<bsdf type="diffuse"> has no property "to_world"',
    ),
    "width out of place": (
        changed(
            '<rfilter type="box"/>', '<rfilter type="box"><float name="width" value="1"/></rfilter>'
        ),
        '<rfilter type="box"> has no property "width"',
    ),
    "ball squeezed": (
        added('<shape type="sphere"><transform name="to_world"><scale x="2"/></transform></shape>'),
        '<shape type="sphere">: to_world has non-uniform scaling, and Mitsuba would draw another',
    ),
    "cylinder sheared": (
        changed(
            '<point name="p0"',
            '<transform name="to_world"><matrix value="1 .5 0 0 0 1 0 0 0'
            ' 0 1 0 0 0 0 1"/></transform><point name="p0"',
        ),
        '<shape type="cylinder">: to_world has ',
    ),
    "shape in a shape": (
        added('<shape type="sphere"><shape type="sphere"/></shape>'),
        '<shape type="sphere"> has no use for an element that is in it',
    ),
    "include missing": (added('<include filename="no.xml"/>'), '<include>: there is no file "no.x'),
}


@pytest.mark.parametrize("fault", FAULTS)
def test_a_scene_that_makes_no_sense_is_refused_in_one_line(tmp_path, fault):
    """With its file, the element and what to do."""
    text, words = FAULTS[fault]
    path = tmp_path / "scene.xml"
    path.write_text(text, encoding="utf-8")
    assert words in refusal(path)


def test_a_scene_that_is_no_file_is_refused(tmp_path):
    """A pipe would block for ever; a loop of links and a long name are nothing."""
    os.mkfifo(tmp_path / "pipe.xml")
    (tmp_path / "loop.xml").symlink_to(tmp_path / "loop.xml")
    assert "is a pipe; give a regular file" in refusal(tmp_path / "pipe.xml")
    assert "is a folder; give a file" in refusal(tmp_path)
    for name in (tmp_path / "loop.xml", MANY, "", "a\0b"):
        with pytest.raises(vs.InputError, match=r"there is no such scene file; .*installed"):
            vs.load_scene(name)


def test_a_field_that_is_nowhere_is_named_with_every_place(tmp_path, monkeypatch):
    """Rationale: it is looked for beside the scene and where one stands; one was named."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "here.nc").touch()
    (tmp_path / "own").mkdir()
    own = shutil.copy(shipped_scenes() / "hot_cylinder.xml", tmp_path / "own" / "own.xml")
    message = refusal(own, field="nosuch.nc")
    for word in (f"looked in {own.parent}, {tmp_path}", "there is here.nc", "1250C_quarter"):
        assert word in message
    assert "no such field" in refusal(shipped_scenes() / "hot_cylinder.xml", field=MANY)
    assert "zero byte" in refusal(shipped_scenes() / "hot_cylinder.xml", field="a\0b")


def test_what_is_ignored_or_assumed_is_noted(tmp_path):
    """A medium, a missing film, a mirrored camera, a scene in metres; of a sound scene nothing."""
    medium = '<medium name="interior" type="homogeneous"/>'
    ball = f'<shape type="sphere"><float name="radius" value="1"/>{medium}</shape>'
    tiny = '<shape type="sphere"><float name="radius" value="0.015"/><ref id="steel"/></shape>\n'
    metres = COLD.replace(SHAPES, tiny).replace("0, 0, $distance", "0, 0, 0.3")
    mirror = f'<scale x="-1"/>{CAMERA_PLACE}'
    for text, words in (
        (added(ball), r'line \d+: <medium type="homogeneous">: ignored'),
        (re.sub(r"<film.*?</film>", "", COLD, flags=re.DOTALL), "has no <film>.*768 x 576"),
        (changed(CAMERA_PLACE, mirror), '<sensor type="lens_camera">: to_world mirrors it'),
        (metres, r"0\.03 mm in size and the camera 0\.\d+ mm away; .*in metres\?"),
    ):
        path = tmp_path / "scene.xml"
        path.write_text(text, encoding="utf-8")
        (note,) = vs.load_scene(path).notes
        assert note.startswith(str(path))
        assert re.search(words, note)
    for name in ("cold_cylinder", "hot_cylinder"):
        assert vs.load_scene(name).notes == ()


def test_a_mirrored_camera_measures_the_same_points(tmp_path):
    """Its image is the plain one's mirror image, and the points are the same."""
    path = tmp_path / "mirror.xml"
    path.write_text(changed(CAMERA_PLACE, f'<scale x="-1"/>{CAMERA_PLACE}'), encoding="utf-8")
    film = {"width": 128, "height": 128, "line_radius": 1.0}
    plain, mirrored = (vs.load_scene(name, **film) for name in ("cold_cylinder", path))
    one, other = (vs.line_centres(vs.render(scene)) for scene in (plain, mirrored))
    np.testing.assert_allclose(other.row[::-1], one.row, atol=2e-4)
    points, again = (
        vs.triangulate(scene.sensor, line.pixel)
        for scene, line in ((plain, one), (mirrored, other))
    )
    np.testing.assert_allclose(again[::-1], points, atol=1e-3)
    assert np.isfinite(points).any()


def test_what_mitsuba_warns_of_is_a_note_and_is_not_printed(tmp_path, capfd):
    """Rationale: it went to the terminal in colours, and no summary held it."""
    path = tmp_path / "scene.xml"
    grey = '<string name="pixel_format" value="luminance"/>'
    path.write_text(changed(grey, ""), encoding="utf-8")
    assert vs.load_scene(path).notes == ()  # of its film in colours one channel is taken
    mi.Log(mi.LogLevel.Warn, "as before")
    printed = capfd.readouterr()
    assert "HDRFilm" not in printed.out + printed.err
    assert "as before" in printed.out + printed.err
    heard = ["2026-11-28 21:48:10 WARN  [Plugin] this is odd."] * 2
    assert loading_notes(path, heard) == [f"{path}: [Plugin] this is odd."]


@pytest.mark.parametrize(
    "variant", ["llvm_ad_rgb", pytest.param("llvm_ad_mono_polarized", marks=pytest.mark.slow)]
)
def test_other_variants_make_the_same_frame(variant, tmp_path):
    """Rationale: what is grey in one is grey in all; the spectral ones are refused."""
    film = {"width": 64, "height": 64, "line_radius": 1}
    file = tmp_path / "frame.npy"
    program = (
        "import numpy as np, virtual_sensor as vs\nfrom virtual_sensor.engine import activate\n"
        f"activate({variant!r})\n"
        f"np.save({str(file)!r}, vs.render(vs.load_scene('cold_cylinder', **{film})))"
    )
    subprocess.run([sys.executable, "-c", program], cwd=tmp_path, check=True)
    ours = vs.render(vs.load_scene("cold_cylinder", **film))
    assert ours.max() > 0.0
    np.testing.assert_allclose(np.load(file), ours, rtol=1e-5)


def test_what_a_scene_says_of_its_parameters_is_the_comment_behind_them(tmp_path):
    """Rationale: an axis takes its unit from there, and a comment of another line is another's."""
    assert parameter_words(find_scene("hot_cylinder"))["beta"].endswith("axis, degrees")
    file = tmp_path / "scene.xml"
    file.write_text(
        '<scene version="3.0.0"><!-- before -->\n'
        "<default value='1' name='a'/>  <!-- of the part,\n   mm -->\n"
        '<default name="b" value="2"/>\n<!-- of the next -->\n'
        '<default name="c" value="3"/><!-- px --></scene>'
    )
    assert parameter_words(file) == {"a": "of the part, mm", "c": "px"}


def test_a_scene_is_found_with_or_without_its_suffix(tmp_path, monkeypatch):
    """`new bracket` is followed by `measure bracket`; a folder of results is no scene."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "Träger 1.xml").write_text(COLD, encoding="utf-8")
    (tmp_path / "Träger 1").mkdir()
    for name in ("Träger 1", "Träger 1.xml", tmp_path / "Träger 1"):
        assert find_scene(name).resolve() == tmp_path / "Träger 1.xml"


def test_a_scene_that_is_missing_is_missed_before_the_engine_starts():
    """Rationale: a typing slip was answered after a second."""
    code = (
        "import sys; from virtual_sensor.cli.commands import run\n"
        "sys.argv = ['virtual-sensor', 'measure', 'nope']\n"
        "print(run(), {'drjit', 'mitsuba'} & sys.modules.keys())"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert ended.stdout == "2 set()\n", ended
