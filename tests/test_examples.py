"""The examples run as written in an empty folder, and find what can be worked out without them."""

import importlib
import re
import runpy
import sys
from pathlib import Path

import cv2
import matplotlib
import matplotlib.pyplot as plt
import numpy as np
import pytest
import trimesh
from scipy.integrate import quad

import virtual_sensor as vs
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.studies.measure import measure

ROOT = Path(__file__).parents[1]
EXAMPLES = ROOT / "examples"
SCRIPTS = sorted(path.stem for path in EXAMPLES.glob("*.py"))
slow = pytest.mark.slow


@pytest.fixture
def run(tmp_path, monkeypatch):
    """Run an example in an empty folder and give its names; `changes` of its text first."""
    monkeypatch.chdir(tmp_path)
    before = matplotlib.get_backend()
    matplotlib.use("Agg")

    def run(name, *changes):
        script = EXAMPLES / f"{name}.py"
        if changes:
            text = script.read_text(encoding="utf-8")
            for old, new in changes:
                assert old in text
                text = text.replace(old, new)
            script = tmp_path / f"changed_{name}.py"
            script.write_text(text, encoding="utf-8")
        names = runpy.run_path(str(script), run_name="__main__")
        assert Path(f"{name}.png").stat().st_size > 5000
        return names

    yield run
    plt.close("all")
    matplotlib.use(before)


@pytest.fixture(scope="module")
def maker():
    """The program that writes the pages."""
    pytest.importorskip("jupytext", reason="pip install '.[docs]'")
    sys.path.insert(0, str(ROOT / "docs"))
    try:
        yield importlib.import_module("make_examples")
    finally:
        sys.path.remove(str(ROOT / "docs"))


def test_the_parts_are_closed_and_as_large_as_their_drawings_say():
    """Rationale: the volume of the drawing, worked out by hand, is that of the mesh."""
    for name, size_mm, volume_mm3 in [
        ("bracket", (40.0, 60.0, 30.0), 19779.4),
        ("gear_blank", (60.0, 60.0, 25.0), 45620.8),
    ]:
        file = shipped_scenes() / "meshes" / f"{name}.stl"
        part = trimesh.load(file)
        assert part.is_watertight, name
        assert part.is_winding_consistent, name
        np.testing.assert_allclose(part.extents, size_mm, atol=1e-4)
        np.testing.assert_allclose(part.volume, volume_mm3, rtol=3e-4)
        assert file.stat().st_size < 300_000


def test_each_example_has_its_page_with_the_same_code(maker):
    """Rationale: a page that was not made again shows what no longer runs."""
    assert sorted(maker.ORDER) == SCRIPTS
    for name in SCRIPTS:
        page = (maker.PAGES / f"{name}.md").read_text(encoding="utf-8")
        code = [text for kind, text in maker.cells(name) if kind == "code"]
        again = f"{name}: run `python docs/make_examples.py {name}`"
        assert re.findall(r"```python\n(.*?)\n```\n", page, re.S) == code, again
        assert all(text in page for kind, text in maker.cells(name) if kind == "markdown"), again
        assert "```text\n" in page
        picture = maker.PICTURES / f"{name}.png"
        assert f"pictures/examples/{picture.name}" in page
        assert picture.stat().st_size < 60_000
        assert len([line for line in "\n".join(code).splitlines() if line.strip()]) <= 45, name
    assert (maker.PAGES / "index.md").read_text(encoding="utf-8") == maker.index()


def test_each_example_is_a_notebook_too():
    """Rationale: it costs nothing, as long as jupytext takes each cell for what it is."""
    jupytext = pytest.importorskip("jupytext", reason="pip install '.[docs]'")
    for name in SCRIPTS:
        book = jupytext.read(EXAMPLES / f"{name}.py")
        text = jupytext.writes(book, "ipynb")
        assert text.count('"cell_type": "markdown"') >= 2, name
        assert "# %%" not in text, name


@slow
def test_own_part(run):
    """The figures of the drawing: 24 mm and a radius of 8 mm, to what facets cost."""
    names = run("own_part")
    assert abs(names["upright"] - names["base"] - 24.0) < 0.002
    _, y, z = names["points_mm"][names["fillet"] & np.isfinite(names["points_mm"][:, 0])].T
    np.testing.assert_allclose(np.hypot(y - 16.0, z - 14.0), 8.0, atol=0.01)
    assert len(y) > 100


@slow
def test_shiny_metal(run):
    """How quickly the light of bare metal fades is the law of Trowbridge and Reitz (GGX).

    It is of the tilt of the facets.
    """
    names = run("shiny_metal")
    scene = names["scenes"]["shiny iron"]
    radiance = vs.render(scene).max(axis=0)
    centres = vs.TrueLine.of_frame(vs.render_frame(scene)).centres().pixel
    y = vs.triangulate(scene, centres)[:, 1]
    y_mm = np.array([0.0, 1.0, 2.0])
    light = np.interp(y_mm, *_sorted(y, radiance))
    # Light from above and a camera at 30 degrees: facets that shine have a normal at 15 degrees.
    cosine = np.cos(np.radians(15.0)) * np.sqrt(1.0 - (y_mm / 13.5) ** 2)
    tangent_2 = 1.0 / cosine**2 - 1.0
    law = 1.0 / (cosine**2 * (1.0 + tangent_2 / 0.1**2)) ** 2
    np.testing.assert_allclose(light / light[0], law / law[0], rtol=0.2)


def _sorted(x, y):
    order = np.argsort(np.where(np.isfinite(x), x, np.inf))[: np.isfinite(x).sum()]
    return x[order], y[order]


@slow
def test_two_cameras(run):
    """Each sees a part of the line, both together all of it; all points lie on the blank."""
    names = run("two_cameras")
    joined = names["joined"]
    shares = [
        np.mean(np.histogram(points[:, 1], np.linspace(-26, 26, 105))[0] > 0)
        for points in (*names["profiles"].values(), joined)
    ]
    assert max(shares[:2]) < 0.9
    assert shares[2] == 1.0
    radius, z = np.hypot(joined[:, 0], joined[:, 1]), joined[:, 2]
    surfaces = [  # distances from the lines of the drawing, mm
        z - 20.0,
        z - 12.0,
        (radius - 15.0 + (z - 12.0) / 6.0) / np.hypot(1.0, 1.0 / 6.0),
        (radius - 24.0 + (20.0 - z) / 4.0) / np.hypot(1.0, 1.0 / 4.0),
        (radius + z - 49.0) / np.sqrt(2.0),
    ]
    off_um = 1000.0 * np.min(np.abs(surfaces), axis=0)
    assert np.percentile(off_um, 95) < 4.0


@slow
def test_camera(run):
    """Shot noise: nine times the light, a third of the error; of speckle, no light makes less."""
    names = run("camera")
    true, predicted = np.array(names["true_px"]), np.array(names["predicted_px"])
    np.testing.assert_allclose(predicted, true, rtol=0.15)
    np.testing.assert_allclose(true[2] / true[4], 3.0, rtol=0.15)
    speckled = np.array(names["speckled_px"])
    np.testing.assert_allclose(speckled[2:], speckled[-1], rtol=0.15)
    assert speckled[-1] > 10.0 * true[-1]
    stored = cv2.imread("line_12bit.png", cv2.IMREAD_UNCHANGED)
    np.testing.assert_array_equal(stored, names["shots"][-1].grey)
    assert 2000 < stored.max() <= 4095


@slow
def test_scan(run):
    """The drawing's: a base 6 mm high with a hole of 14 mm; what is in the file are the points."""
    names = run("scan")
    x, y, z = trimesh.load("bracket.ply").vertices.T
    assert len(z) == len(names["points_mm"]) > 10_000
    assert abs(np.median(z[y < 10.0]) - 6.0) < 0.002
    base = (abs(z - 6.0) < 0.02) & (y < 14.0)
    assert 13.9 < 2.0 * np.hypot(x, y + 8.0)[base].min() < 14.3
    np.testing.assert_allclose(z[(y > 24.5) & (abs(x) < 13.0)], 30.0, atol=0.02)


@slow
def test_own_detector(run):
    """In pure noise a median errs sqrt(pi / 2) times as much as the best there is."""
    errors = run("own_detector")["errors"]
    best = errors["max_likelihood"].rms_px
    assert errors["median"].count == errors["max_likelihood"].count > 400
    np.testing.assert_allclose(errors["median"].rms_px / best, np.sqrt(np.pi / 2), rtol=0.1)


@slow
def test_training_images(run):
    """The same seed gives the same bytes; the true rows lie within the masks, and in the light."""
    few = ("range(100)", "range(8)")
    run("training_images", few)
    folder = Path("training_images")
    first = {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    run("training_images", few)
    assert first == {path.name: path.read_bytes() for path in sorted(folder.iterdir())}
    truth = np.loadtxt(folder / "truth.csv", delimiter=",", skiprows=1)
    assert set(truth[:, 0]) == set(range(8))
    for number in range(8):
        image, mask = (
            cv2.imread(f"{folder}/{number:03}{kind}.png", cv2.IMREAD_UNCHANGED).astype(float)
            for kind in ("", "_mask")
        )
        _, u, v = truth[truth[:, 0] == number].T
        rows = np.rint(v).astype(int)
        assert np.all(mask[rows, u.astype(int)] == 255)
        assert image[rows, u.astype(int)].mean() > image[mask == 0].mean() + 10.0


@slow
def test_correct_profile(run):
    """The correction takes the error away; of a wrong air it leaves what its deflection lacks."""
    profiles = run("correct_profile")["profiles"]
    rms = {
        name: 1000.0 * np.sqrt(np.nanmean((np.hypot(p[:, 1], p[:, 2] + 13.5) - 13.5) ** 2))
        for name, p in profiles.items()
    }
    straight, guessed, true = rms.values()
    assert 90.0 < straight < 130.0
    assert true < 0.1
    # Deflection is as the air's lost density, which at 1100 degC is (1 - 293/1373)/(1 - 293/1523).
    lacking = 1.0 - (1.0 - 293.0 / 1373.0) / (1.0 - 293.0 / 1523.0)
    assert lacking * straight < guessed < 6.0 * lacking * straight


@slow
def test_two_poses(run):
    """A second pose leaves a thirtieth of the radius's error, and the residual as it was."""
    names = run(
        "two_poses", ("(0,), (0, 15), (0, 30)", "(0,), (0, 30)"), ("(0, 15, 30)", "(0, 30)")
    )
    one, two = (names["estimate"](*betas) for betas in ((0,), (0, 30)))
    assert abs(one["radius_mm"] - 13.5) > 0.04
    assert abs(two["radius_mm"] - 13.5) < 0.0015
    np.testing.assert_allclose(two.rms_px, one.rms_px, rtol=0.2)
    assert "too small" in names["found"].notes[-1]


@slow
def test_fringes(run):
    """Bent points lie on the part; decoded pixels and their residual are those of a search."""
    names = run("fringes")
    assert np.sqrt(np.nanmean(names["deviation_um"](names["bent"]) ** 2)) < 0.1
    row, column = (each.ravel() for each in np.mgrid[20:500:40, 180:340:20])
    found = vs.projector_pixels(names["scene"], np.stack([column, row], axis=1))
    decoded = names["decoded"].pixel[row, column]
    np.testing.assert_allclose(decoded, found.projector_pixel, atol=0.005)
    _, y, z = found.point_mm.T
    np.testing.assert_allclose(np.hypot(y, z + 13.5), 13.5, atol=1e-5)
    np.testing.assert_allclose(names["bent"].point_mm[row, column], found.point_mm, atol=1e-3)


@slow
def test_own_field(run):
    """The closed form is the integral of the gradient; the shift that of searched rays."""
    names = run("own_field")
    index, sigma = names["cool"] - names["warm"], names["sigma_mm"]
    for b, formula in zip(names["b"][::7], names["formula"][::7], strict=True):

        def gradient(x, b=b):
            return index * b / sigma**2 * np.exp(-(x**2 + b**2) / (2.0 * sigma**2))

        np.testing.assert_allclose(1e6 * quad(gradient, -60.0, 60.0)[0], formula, atol=1e-3)
    assert np.abs(names["traced"] - names["formula"]).max() < 0.5
    found = vs.ray_search(names["hot"], [-6.0, 0.0, 6.0], "newton")
    point = vs.triangulate(names["hot"], found.pixel)
    true_z = np.sqrt(13.5**2 - point[:, 1] ** 2) - 13.5
    shift = np.interp(point[:, 1], *_sorted(names["profile"][:, 1], names["shift_um"]))
    np.testing.assert_allclose(1000.0 * (point[:, 2] - true_z), shift, atol=1.5)


@slow
def test_dask_sweep(run):
    """A case from the cluster has the figure that this process finds."""
    table = run("dask_sweep")["table"]
    assert list(table.status) == ["ok"] * 6
    given = {name: values[-1] for name, values in table.parameters.items()}
    here = measure(vs.load_scene("hot_cylinder", **given))
    rms_um = np.sqrt(np.nanmean(here.hot.section_error_um**2))
    np.testing.assert_allclose(table.hot_section_rms_um[-1], rms_um, rtol=1e-6)
