"""What the pages show is what a reader can run: each block of Python and each command.

The blocks of a page run from its top to its end, in one folder and with one set of names. A block
that does not has its reason before it: ``<!-- not run: takes half an hour -->``.
"""

import re
import shlex
from pathlib import Path
from typing import NamedTuple

import matplotlib.pyplot as plt
import numpy as np
import pytest
import trimesh
from artificial import line_image
from command_line import command

import virtual_sensor as vs
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.metrology.calibration import read_calibration
from virtual_sensor.metrology.centres import Status

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"
PAGES = [ROOT / "README.md", *sorted(DOCS.rglob("*.md"))]

_FENCE = re.compile(
    r"^(?:<!-- not run: (?P<why>[^\n]+?) -->\n)?```(?P<language>\w*)\n(?P<text>.*?)^```$",
    re.M | re.S,
)


class Block(NamedTuple):
    """A block of code of a page, and why it is not run, if it isn't."""

    language: str
    text: str
    why: str


def blocks(page):
    """The blocks of Python and of commands of a page."""
    found = (
        Block(each["language"], each["text"], each["why"] or "")
        for each in _FENCE.finditer(page.read_text(encoding="utf-8"))
    )
    return [block for block in found if block.language in ("python", "sh")]


def runnable(page):
    """The blocks that run; of the README the Python: its commands are what CI runs.

    Pages of examples are made of scripts, which `test_examples` runs.
    """
    if page.parent.name == "examples":
        return []
    chosen = ("python",) if page.name == "README.md" else ("python", "sh")
    return [each for each in blocks(page) if not each.why and each.language in chosen]


def an_image():
    """The reader's own image."""
    image = line_image(np.full(60, 30.3), 2.0, 900.0, background=64.0)
    return {"image": image.astype(np.uint16)}


def two_by_two():
    """A copy of the hot cylinder with the page's camera and laser, as the page says."""
    page = (DOCS / "how_to" / "several_cameras.md").read_text(encoding="utf-8")
    more = re.search(r"```xml\n(.*?)```", page, re.DOTALL)[1]
    assert command("new", "two_by_two", "--from", "hot_cylinder")[0] == 0
    scene = Path("two_by_two.xml")
    text = scene.read_text(encoding="utf-8").replace("</scene>", f"{more}</scene>")
    scene.write_text(text, encoding="utf-8")
    return {}


BEFORE = {
    "explanation/detectors.md": an_image,
    "how_to/several_cameras.md": two_by_two,
}
"""What a page's reader has: a function that makes it in the working folder and gives names."""


def lines_are_where_they_are(names):
    """The last line is found in a frame with noise."""
    assert names["grey"].dtype == np.uint16
    line = names["line"]
    assert np.sum(line.status == Status.OK) > 800
    assert np.all(line.sigma[np.isfinite(line.sigma)] > 0.02)


def points_lie_on_the_part(names):
    """To what hot air does to them: some tenths of a millimetre."""
    assert np.isfinite(names["found"].pixel).all()
    points = names["points_mm"][np.isfinite(names["points_mm"][:, 0])]
    assert len(points) > 300
    np.testing.assert_allclose(np.hypot(points[:, 1], points[:, 2] + 13.5), 13.5, atol=0.5)
    assert points[:, 0].mean() > 4.0  # the second laser's


def the_source_lights_a_part(names):
    """Its middle ray meets the part where the laser's does, and a ray beside it closer by."""
    cold = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    emitter = '<emitter type="focused_sheet"><float name="focus" value="380"/><transform'
    text = re.sub(r'<emitter type="laser_line".*?<transform', emitter, cold, flags=re.DOTALL)
    Path("scene.xml").write_text(text, encoding="utf-8")
    scene = vs.load_scene("scene.xml", width=256, height=256, spp=1)
    family = scene.source.family
    np.testing.assert_allclose(family.coordinates([[0.0, 0.0, 0.0]])[0, :2], 0.0, atol=1e-4)
    assert family.spread(0.0, 0.0, 300.0) == 1.0 - 300.0 / 380.0
    assert np.sum(vs.render(scene) > 0.0) > 100


def objects_say_what_the_page_shows(names):
    """The lines that the page prints are those that objects print."""
    page = (DOCS / "how_to" / "objects.md").read_text(encoding="utf-8")
    for name in ("scene", "frame", "line", "points"):
        assert repr(names[name]) in page
    assert repr(names["scene"].camera) in page
    for status, count in names["table"].status.value_counts().items():
        assert status == "ok" or re.search(rf"^{status} +{count}$", page, re.MULTILINE)
    plt.close(names["figure"])


def the_air_is_corrected_for(names):
    """The true air leaves nothing, and that of 1100 degC what the page's table says."""
    page = (DOCS / "how_to" / "correct.md").read_text(encoding="utf-8")
    (stated,) = re.findall(r"1100 °C \| ([\d.]+) µm", page)
    rms_um = []
    for points_mm in (names["corrected"].point_mm, names["points_mm"]):
        _, y, z = points_mm[np.abs(points_mm[:, 1]) <= 10.0].T
        error_um = 1e3 * (np.hypot(y, z + 13.5) - 13.5)
        rms_um.append(np.sqrt(np.mean(error_um**2)))
    assert rms_um[0] < 0.05
    np.testing.assert_allclose(rms_um[1], float(stated), rtol=0.05)


def points_are_of_the_line(names):
    """Each centre is a point near the part, and the files are there."""
    ok = names["line"].status == Status.OK
    assert np.sum(ok) > 900
    assert np.array_equal(np.isfinite(names["points_mm"][:, 0]), ok)
    assert {"found/1.csv", "points/0.ply", "line.csv"} <= {
        file.as_posix() for file in Path().rglob("*.*")
    }


AFTER = {
    "how_to/correct.md": the_air_is_corrected_for,
    "how_to/objects.md": objects_say_what_the_page_shows,
    "explanation/detectors.md": lines_are_where_they_are,
    "how_to/own_images.md": points_are_of_the_line,
    "how_to/several_cameras.md": points_lie_on_the_part,
    "how_to/own_source.md": the_source_lights_a_part,
}
"""What then holds."""


def pages():
    """The pages that have something to run; commands, and speckle on large films, take seconds."""
    for page in PAGES:
        if shown := runnable(page):
            slow = any(each.language == "sh" or "speckled" in each.text for each in shown)
            marks = [pytest.mark.slow] if slow else []
            yield pytest.param(page.relative_to(ROOT).as_posix(), marks=marks)


@pytest.mark.parametrize("page", list(pages()))
def test_what_a_page_shows_runs(page, tmp_path, monkeypatch, unpainted_test):
    """Rationale: the reader copies it."""
    name = page.removeprefix("docs/")
    monkeypatch.chdir(tmp_path)
    names = BEFORE.get(name, dict)()
    for block in runnable(ROOT / page):
        if block.language == "python":
            exec(compile(block.text, page, "exec"), names)
        else:
            for line in block.text.replace("\\\n", " ").splitlines():
                words = shlex.split(line, comments=True)
                assert words[:1] in ([], ["virtual-sensor"]), f"{page}: say why not: {line}"
                status, _, errors = command(*words[1:]) if words else (0, "", "")
                assert status == 0, f"{page}: {line}: {errors}"
    AFTER.get(name, lambda names: None)(names)


def test_commands_stand_in_blocks_of_their_own():
    """Rationale: one that is only indented is not run, has no reason why, and can't be copied."""
    for page in PAGES:
        text = page.read_text(encoding="utf-8")
        assert not re.search(r"^(?: {4,}|\t)virtual-sensor ", text, re.MULTILINE), page


def test_the_shape_of_the_page_on_scene_files_loads(tmp_path):
    """A bracket of 2 x 1 x 0.5 inches, by trimesh."""
    page = (DOCS / "reference" / "scene_files.md").read_text(encoding="utf-8")
    shape = re.search(r"```xml\n(.*?)```", page, re.DOTALL)[1]
    trimesh.creation.box((2.0, 1.0, 0.5)).export(tmp_path / "bracket.stl")
    cold = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
    path = tmp_path / "scene.xml"
    path.write_text(re.sub("<shape.*</shape>", shape, cold, flags=re.DOTALL), encoding="utf-8")
    (part,) = vs.load_scene(path).mitsuba.shapes()
    np.testing.assert_allclose(part.bbox().max, [25.4, 12.7, 6.35 - 3.0], atol=1e-5)


def test_the_calibration_of_the_page_on_own_images_is_read(tmp_path):
    """All that it gives is used, and nothing is noted."""
    page = (DOCS / "how_to" / "own_images.md").read_text(encoding="utf-8")
    path = tmp_path / "calibration.yaml"
    path.write_text(re.search(r"```yaml\n(.*?)```", page, re.DOTALL)[1], encoding="utf-8")
    calibration = read_calibration(path)
    assert calibration.notes == ()
    np.testing.assert_allclose(calibration.camera.matrix[0, 0], 2400.0)


def test_links_lead_to_pages_pictures_and_headings():
    """In the repository as on the site: anchors are made as GitHub makes them."""
    broken = []
    for page in [*PAGES, ROOT / "CHANGELOG.md", ROOT / "benchmarks" / "README.md"]:
        text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
        for target in re.findall(r"(?:\]\(<?|src=\")([^)>\s\"]+)", re.sub(r"`[^`\n]*`", "", text)):
            path, _, anchor = target.partition("#")
            file = page.parent / path if path else page
            if re.match(r"[a-z]+:", target) or (anchor.startswith("gh-") and file.exists()):
                continue
            if not file.exists() or (anchor and anchor not in anchors(file)):
                broken.append(f"{page.relative_to(ROOT)}: {target}")
    assert not broken, "\n".join(broken)


def anchors(page):
    """Those of a page's headings."""
    text = re.sub(r"^```.*?^```$", "", page.read_text(encoding="utf-8"), flags=re.M | re.S)
    headings = re.findall(r"^#+ (.+)$", text, re.MULTILINE)
    return {re.sub(r"[^\w\- ]", "", each.lower()).replace(" ", "-") for each in headings}
