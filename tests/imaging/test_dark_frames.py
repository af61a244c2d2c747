"""A frame that stays black: the cause is named, one scene per cause."""

import re

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.dark_frames import why_dark
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.studies.measure import measure

INCLUDED = '    <include filename="materials/$material.xml"/>\n'
INLINE = """    <bsdf type="diffuse" id="steel">
        <float name="reflectance" value="0.5"/>
    </bsdf>
"""
COLD = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
COLD = COLD.replace(INCLUDED, INLINE)
BSDF = re.search(r"<bsdf.*?</bsdf>", COLD, re.DOTALL)[0]
SHAPES = re.search(r"<shape.*</shape>", COLD, re.DOTALL)[0]
SQUARE = "-40 -40 0{0}\n40 -40 0{0}\n40 40 0{0}\n-40 40 0{0}\n"
NORMALS = "property float nx\nproperty float ny\nproperty float nz\n"


def plate(faces, normal=""):
    """A PLY file of a square and its vertex normals."""
    return (
        "ply\nformat ascii 1.0\nelement vertex 4\nproperty float x\nproperty float y\n"
        f"property float z\n{NORMALS if normal else ''}element face 2\n"
        f"property list uchar int vertex_indices\nend_header\n{SQUARE.format(normal)}{faces}"
    )


FRONT, BACK = "3 0 1 2\n3 0 2 3\n", "3 0 2 1\n3 0 3 2\n"
PLATE = '<shape type="ply" id="plate"><string name="filename" value="plate.ply"/><ref id="steel"/>'


def material(kind):
    """The cold scene with a plain material of another type."""
    return COLD.replace(BSDF, f'<bsdf type="{kind}" id="steel"/>')


def on_plate(*replaced):
    """The cold scene with a plate for a part."""
    text = COLD.replace(SHAPES, f"{PLATE}</shape>")
    return text.replace(*replaced) if replaced else text


CASES = {
    "far clip": (
        COLD.replace('value="100000"', 'value="200"'),
        "",
        '<sensor id="camera">: far_clip is 200 mm',
    ),
    "mirror": (material("conductor"), "", '<bsdf id="steel">: it is a mirror'),
    "glass": (
        material("dielectric"),
        "",
        '<bsdf id="steel">: it lets light through',
    ),
    "black": (
        COLD.replace('name="reflectance" value="0.5"', 'name="reflectance" value="0"'),
        "",
        '<bsdf id="steel">: it reflects nothing',
    ),
    "inside out": (
        on_plate(),
        plate(BACK),
        '<shape id="plate">: camera and laser are not both in front of its faces',
    ),
    "normals inwards": (
        on_plate(),
        plate(FRONT, " 0 0 -1"),
        '<shape id="plate">: its vertex normals are nil or point into it',
    ),
    "lid of glass": (
        COLD.replace(
            "</scene>",
            '<bsdf type="dielectric" id="pane"/><shape type="rectangle"><transform name="to_world">'
            '<scale value="60"/><translate z="20"/></transform><ref id="pane"/></shape></scene>',
        ),
        "",
        '<bsdf id="pane">: it lets light through',
    ),
}


@pytest.mark.parametrize("case", CASES)
def test_a_black_frame_names_its_cause(tmp_path, case):
    """Rationale: "give a wider or longer line" was said of all of them."""
    text, part, words = CASES[case]
    (tmp_path / "plate.ply").write_text(part, encoding="utf-8")
    path = tmp_path / "scene.xml"
    path.write_text(text, encoding="utf-8")
    scene = vs.load_scene(path, width=128, height=128)
    with pytest.raises(InputError) as refused:
        measure(scene)
    message = str(refused.value)
    assert message.startswith(f"{path}: the frame is black. {words}")
    assert "\n" not in message


@pytest.mark.parametrize("twosided", [True, False])
def test_a_plate_that_is_right_is_bright(tmp_path, twosided):
    """The remedies that are given help: the faces reversed, or a material with two sides."""
    text = on_plate(
        BSDF, f'<bsdf type="twosided" id="steel">{BSDF.replace(" id=", " name=")}</bsdf>'
    )
    (tmp_path / "plate.ply").write_text(plate(BACK if twosided else FRONT), encoding="utf-8")
    path = tmp_path / "scene.xml"
    path.write_text(text if twosided else on_plate(), encoding="utf-8")
    assert np.max(vs.render(vs.load_scene(path, width=64, height=64))) > 0.0


def test_a_line_too_thin_for_the_samples_says_how_thin(tmp_path):
    """Rationale: the message of old, where it is the cause; width by the formula."""
    scene = vs.load_scene("cold_cylinder", width=64, height=64, spp=1, line_radius=1e-3)
    focal_px = 75.0 / 5.5e-3 * 64 / 2048
    width = float(re.search(r"is (\S+) px wide", why_dark(scene))[1])
    assert width == pytest.approx(2e-3 * focal_px / 300.0, rel=0.1)
