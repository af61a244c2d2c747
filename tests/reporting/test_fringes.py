"""A measurement by fringes: its picture, page and files, cold and hot and along one axis."""

import json
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from data_dictionary import undocumented
from matplotlib.figure import Figure

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.reporting import fringes as reporting
from virtual_sensor.studies.fringes import measure
from virtual_sensor.studies.fringes.decoded_files import read_decoded
from virtual_sensor.studies.fringes.measure import Settings, measure_fringes

AGAIN = "virtual-sensor fringes fringe_cylinder"
SIZE = 96


def measured(codec, cold=False):
    loaded = load_scene("fringe_cylinder", width=SIZE, height=SIZE, spp=4, pixels=False)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(measure, "SEARCHED", 200)
        return measure_fringes(loaded, Settings(codec, cold=cold))


@pytest.fixture(scope="module")
def both():
    return measured("phase 4 16,128,1280 uv")


@pytest.fixture(scope="module")
def folder(both, tmp_path_factory):
    place = tmp_path_factory.mktemp("results") / "fringes"
    reporting.save(both, place, AGAIN, frames=True)
    return place


def test_a_folder_of_results_holds_what_the_dictionary_lists(both, folder, faults_of):
    names = {each.relative_to(folder).as_posix() for each in folder.rglob("*") if each.is_file()}
    assert {"report.html", "report.png", "summary.json", "table.md", "cold.exr", "hot.exr"} <= names
    assert {
        f"surface_{each}.ply" for each in ("cold_straight", "hot_straight", "hot_bent")
    } <= names
    assert {"frames_hot/00.png", "frames_hot/23.png", "search_hot.csv"} <= names
    assert undocumented(folder, reporting.FILES) == []
    assert faults_of(folder / "report.html") == []
    said = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert said["states"]["hot"]["straight"]["rms_um"] == both.hot.straight.facts.rms_um
    with pytest.raises(InputError, match="overwrite"):
        reporting.save(both, folder, AGAIN)


def test_frames_that_are_not_kept_are_drawn_small_and_not_written(both, monkeypatch, tmp_path):
    """Rationale: frames in full are most of what a measurement of 2048 px keeps in memory."""
    monkeypatch.setattr(measure, "SHRUNK_PX", SIZE // 4)
    images = both.hot.images
    quarter = images.reshape(-1, SIZE // 4, 4, SIZE // 4, 4).mean(axis=(2, 4))
    np.testing.assert_allclose(measure.shrunk(images), quarter, rtol=1e-4, atol=1e-9)
    small = replace(both, hot=replace(both.hot, images=quarter))
    window = reporting.window_of(both.hot.decoded.column)
    sheets = []
    for result in (small, both):
        figure = Figure()
        reporting._frames_panel(result, result.hot, "the part", window).draw(figure)
        sheets.append(figure.axes[0].images[0].get_array())
    few, many = sheets
    assert few.shape[1] < many.shape[1] // 3
    assert np.nanmean(few) == pytest.approx(np.nanmean(many), rel=0.1)
    with pytest.raises(InputError, match=r"were not kept; measure with Settings\(frames=True\)"):
        reporting.save(small, tmp_path / "results", AGAIN, frames=True)
    assert not (tmp_path / "results").exists()


def test_decoded_pixels_are_read_back(both, folder):
    again = read_decoded(folder / "hot.exr")
    np.testing.assert_allclose(again.column, both.hot.decoded.column, rtol=1e-6)
    np.testing.assert_array_equal(again.status, both.hot.decoded.status)


def test_its_objects_are_saved_as_what_they_are(both, tmp_path):
    """Rationale: of an image of millions of pixels no JSON is made."""
    said = json.loads(both.save(tmp_path / "all.json").read_text(encoding="utf-8"))
    assert said["codec"] == both.summary.codec
    again = read_decoded(both.hot.decoded.save(tmp_path / "decoded.exr"))
    np.testing.assert_array_equal(again.status, both.hot.decoded.status)
    mesh = trimesh.load(both.hot.bent.save(tmp_path / "bent.ply"), process=False)
    assert len(mesh.faces) > 1000


def test_surfaces_are_triangles_with_their_deviation(both, folder):
    """Rationale: opened in another program, the colour is the error, in µm."""
    surface = both.hot.straight
    mesh = trimesh.load(folder / "surface_hot_straight.ply", process=False)
    assert 0.99 < len(mesh.vertices) / np.isfinite(surface.deviation_um).sum() <= 1.0
    _, y, z = mesh.vertices.T
    off_um = 1e3 * (np.hypot(y, z + 13.5) - 13.5)
    data = mesh.metadata["_ply_raw"]["vertex"]["data"]
    np.testing.assert_allclose(data["deviation_um"], off_um, atol=0.02)
    assert (mesh.face_normals[:, 2] > 0.0).mean() > 0.99


def test_cold_and_hot_have_the_same_colours(both):
    window = reporting.window_of(both.hot.straight.deviation_um)
    limits = {}
    for name, panel in reporting.deviation_panels(both.states, window).items():
        figure = Figure()
        panel.draw(figure)
        limits[name] = figure.axes[0].images[0].get_clim()
    assert list(limits) == [
        "deviation_hot_straight",
        "deviation_hot_bent",
        "deviation_cold_straight",
    ]
    assert limits["deviation_hot_straight"] == limits["deviation_cold_straight"]
    assert max(limits["deviation_hot_bent"]) < 0.1 * max(limits["deviation_hot_straight"])


def test_the_console_says_straight_and_bent_with_the_figures_of_the_summary(both):
    surface, fit, check = reporting.on_console(both.summary)
    assert [row[:2] for row in surface.rows] == [
        ("cold", "straight"),
        ("hot", "straight"),
        ("hot", "bent"),
    ]
    facts = both.hot.straight.facts
    assert float(surface.rows[1][3]) == pytest.approx(facts.rms_um, rel=0.01)
    assert fit.rows[1][2] == f"{facts.fit.radius_mm:.4f}"
    assert len(check.rows) == 2
    assert len(check.head) == 7


def test_what_is_not_there_is_not_drawn():
    """Rationale: of one axis there is no epipolar residual, of a cold part no bent light."""
    cold = measured("phase 3 64,1280 v", cold=True)
    panels = reporting.picture(cold)[1]
    assert not [name for name in panels if name.startswith("epipolar") or "hot" in name]
    assert "row" in panels
    assert "column" not in panels
    page = reporting.page(cold, panels, AGAIN)
    assert "What shape can't fake" not in [section.title for section in page.sections]
    assert len(reporting.on_console(cold.summary)[-1].head) == 3


def test_the_drawn_row_of_deviations_is_none_of_a_steps():
    """Rationale: a step of the part along the frame's middle leaves that row empty."""
    deviation_um = np.ones((40, 30), np.float32)
    deviation_um[19:22] = np.nan
    deviation_um[22:, :9] = np.nan
    whole = (slice(0, 40), slice(0, 30))
    assert reporting._full_row([deviation_um], whole) == 18
    assert reporting._full_row([deviation_um], (slice(24, 40), slice(0, 30))) == 32
    assert reporting._full_row([deviation_um * np.nan], whole) == 20


def test_that_nothing_is_measured_is_said_with_the_reason(both):
    cold = both.summary.states["cold"]
    decoded = replace(cold.decoded, pixels=0, status={"ok": 0, "black": 9216})
    none = replace(cold, straight=replace(cold.straight, points=0, compared=0), decoded=decoded)
    figures = replace(both.summary, states={"cold": none})
    assert "nothing is measured: the pixels are black 9216" in reporting.headline(figures)
