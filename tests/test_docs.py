"""What the pages show is what a reader can run."""

import re
from pathlib import Path
from typing import Any

import numpy as np
import trimesh
from artificial import line_image
from several import text_of

import virtual_sensor as vs
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.metrology.centres import Status

DOCS = Path(__file__).parents[1] / "docs"
SCENE_FILES = DOCS / "reference" / "scene_files.md"
SEVERAL = DOCS / "how_to" / "several_cameras.md"
SOURCE = DOCS / "how_to" / "own_source.md"
DETECTORS = DOCS / "explanation" / "detectors.md"


def test_the_python_of_the_page_on_detectors_runs_from_its_top_to_its_end():
    """Rationale: the reader copies it; `image` is the reader's own."""
    image = line_image(np.full(60, 30.3), 2.0, 900.0, background=64.0).astype(np.uint16)
    known = {"image": image}
    blocks = re.findall(r"```python\n(.*?)```", DETECTORS.read_text(encoding="utf-8"), re.DOTALL)
    assert len(blocks) == 2
    exec(blocks[0], known)
    np.testing.assert_allclose(known["line"].row, 30.3, atol=0.01)
    scene = '"hot_cylinder"'
    assert scene in blocks[1]
    exec(blocks[1].replace(scene, f"{scene}, width=1024, height=1024, line_radius=0.3"), known)
    line = known["line"]
    assert known["grey"].dtype == np.uint16
    assert np.sum(line.status == Status.OK) > 400
    assert np.all(line.sigma[np.isfinite(line.sigma)] > 0.05)


def test_the_shape_of_the_page_on_scene_files_loads(tmp_path):
    """A bracket of 2 x 1 x 0.5 inches, by trimesh."""
    shape = re.search(r"```xml\n(.*?)```", SCENE_FILES.read_text(encoding="utf-8"), re.DOTALL)[1]
    trimesh.creation.box((2.0, 1.0, 0.5)).export(tmp_path / "bracket.stl")
    cold = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    path = tmp_path / "scene.xml"
    path.write_text(re.sub("<shape.*</shape>", shape, cold, flags=re.DOTALL), encoding="utf-8")
    (part,) = vs.load_scene(path).mitsuba.shapes()
    np.testing.assert_allclose(part.bbox().max, [25.4, 12.7, 6.35 - 3.0], atol=1e-5)


def block(page):
    """The only Python of a page."""
    (found,) = re.findall(r"```python\n(.*?)```", page.read_text(encoding="utf-8"), re.DOTALL)
    return found


def test_the_two_cameras_and_lasers_of_their_page_are_told_apart(tmp_path, monkeypatch):
    """What is shown runs: the points of the pair lie on the part, to what is straight about it."""
    cameras, lasers = [("near", 0, 1), ("far", 20, 1)], [("red", 0, 0), ("blue", 15, 4)]
    text = text_of("cold_cylinder", cameras, lasers)
    text = text.replace('name="width" value="2048"', 'name="width" value="256"')
    text = text.replace('name="height" value="2048"', 'name="height" value="256"')
    text = text.replace('name="line_radius" value="0.15"', 'name="line_radius" value="0.5"')
    (tmp_path / "two_by_two.xml").write_text(text, encoding="utf-8")
    monkeypatch.chdir(tmp_path)
    told: dict[str, Any] = {"vs": vs, "y_mm": [0.0, -4.0]}
    exec(block(SEVERAL), told)
    assert told["image"].max() > 0.0
    assert np.isfinite(told["found"].pixel).all()
    points = told["points"][np.isfinite(told["points"][:, 0])]
    assert len(points) > 50
    np.testing.assert_allclose(np.hypot(points[:, 1], points[:, 2] + 13.5), 13.5, atol=0.02)


def test_the_source_of_its_page_lights_a_part(tmp_path):
    """Its middle ray meets the part where the laser's does, and a ray beside it closer by."""
    exec(block(SOURCE), {})
    cold = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    emitter = '<emitter type="focused_sheet"><float name="focus" value="380"/><transform'
    text = re.sub(r'<emitter type="laser_line".*?<transform', emitter, cold, flags=re.DOTALL)
    (tmp_path / "scene.xml").write_text(text, encoding="utf-8")
    scene = vs.load_scene(tmp_path / "scene.xml", width=256, height=256, spp=1)
    family = scene.source.family
    np.testing.assert_allclose(family.coordinates([[0.0, 0.0, 0.0]])[0, :2], 0.0, atol=1e-4)
    assert family.spread(0.0, 0.0, 300.0) == 1.0 - 300.0 / 380.0
    assert np.sum(vs.render(scene) > 0.0) > 100
