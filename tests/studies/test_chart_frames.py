"""The chart's frames: errors against a reference, and scalings."""

import subprocess
import sys

import numpy as np
import pytest
from artificial import paper_sensor
from invented_charts import measured

from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.triangulation import error_um
from virtual_sensor.metrology.truth import TrueLine, compare_line, rms
from virtual_sensor.studies.chart import frames, scaling
from virtual_sensor.studies.chart.benchmark import measure_all
from virtual_sensor.studies.chart.chart import on_gpu
from virtual_sensor.studies.chart.frames import with_lamp
from virtual_sensor.studies.machine import cuda_found


def line(row, lost=()):
    """Line centres at rows (W,), with some columns lost."""
    status = np.full(row.size, Status.OK, np.uint8)
    status[list(lost)] = Status.LINE_END
    return LineCentres.of_rows(row).judged(status)


def test_a_known_error_comes_out_in_px_and_um():
    """Rationale: seen at 60 degrees, 22 um across the image are 22/cos(30 deg) in the sheet."""
    column = np.arange(600, 1400, 50)
    row = np.full(2048, 1023.5)
    offset = np.where(np.arange(2048) % 100 == 0, 0.3, -0.3)
    truth = TrueLine.of_rows(np.where(np.isin(np.arange(2048), column), row, np.nan))
    apart = compare_line(line(row + offset, lost=[600, 650, 601]), truth)
    assert apart.rms_px == pytest.approx(0.3)
    assert apart.largest_px == pytest.approx(0.3)
    assert apart.lost.tolist() == [Status.LINE_END] * 2
    assert rms(error_um(paper_sensor(), apart)) == pytest.approx(
        0.3 * 22.0 / np.sin(np.radians(60.0)), rel=5e-3
    )
    nothing = compare_line(line(row, lost=column), truth)
    um = rms(error_um(paper_sensor(), nothing))
    assert np.isnan([nothing.rms_px, nothing.largest_px, um]).all()
    assert nothing.lost.size == column.size


def test_windows_reach_over_both_ends_of_the_line():
    """Rationale: 'line ends included' is a promise; inner windows must not overlap the ends."""
    windows = list(frames._windows(500, 1500, inner=4))
    columns = np.concatenate([np.arange(*window) for window in windows])
    assert len(set(columns)) == len(columns)
    assert (columns.min(), columns.max()) == (495, 1504)
    assert {500, 501, 1499, 1500} <= set(columns)


def test_every_configuration_is_one_of_its_own():
    """Rationale: two of the same settings would be one, measured twice."""
    for quick in (True, False):
        chosen = [tuple(sorted(each.items())) for each in frames.settings(quick)]
        assert len(set(chosen)) == len(chosen)
    names = {each["transport"] for each in frames.settings()}
    assert names == {"straight", "first_order", "tabulated", "marched"}


def test_exponents_of_power_laws_are_found():
    """Rationale: the slope on logarithmic axes."""
    sizes = (1.0, 4.0, 64.0)
    for exponent in (0.5, 1.0):
        found = scaling.power("x", {n: 0.02 * n**exponent for n in sizes})
        assert [each.size for each in found] == list(sizes)
        assert all(each.exponent == pytest.approx(exponent) for each in found)
        assert np.isnan(scaling.power("x", {4.0: 0.5})[0].exponent)


def test_frames_that_differ_in_samples_only_are_put_together():
    """Rationale: 0.5 s and 30 ms a sample, apart from frames by another step."""

    def frame(spp, time_s, **others):
        return measured("marched", time_s, 0.1, "frames", samples_per_pixel=spp, **others)

    rows = [frame(spp, 0.5 + 0.03 * spp, step_mm=2) for spp in (1, 4, 16, 64)]
    rows += [frame(spp, 9.0, step_mm=1) for spp in (1, 4)]
    found = scaling.by_samples(rows)
    assert [each.size for each in found] == [1.0, 4.0, 16.0, 64.0]
    for each in found:
        assert "0.5 s and 30 ms for each sample" in each.note
        assert "within 0 %" in each.note


@pytest.fixture
def smooth():
    """A field, mirrored about x = 0, that a cubic spline follows closely."""
    axes = [np.linspace(0.0, 8.0, 17), np.linspace(-4.0, 4.0, 17), np.linspace(-3.0, 5.0, 17)]
    x, y, z = np.meshgrid(*axes, indexing="ij")
    n = 2.7e-4 - 1e-4 * np.exp(-(x**2 + y**2 + (z - 1.0) ** 2) / 8.0)
    place = [0.0, -4.0, -3.0]
    return IndexField.from_arrays(n, place, [0.5] * 3, ambient=2.7e-4, mirror=(True, False, False))


@pytest.mark.parametrize(("factor", "shape"), [(2, (33, 33, 33)), (-2, (9, 9, 9))])
def test_resampled_air_is_the_same_air(smooth, factor, shape):
    """Rationale: time over nodes means something only if the rays run alike."""
    other = scaling.resampled(smooth, factor)
    assert other.shape == shape
    np.testing.assert_allclose(other.box, smooth.box)
    points = np.random.default_rng(1).uniform([-4.0, -3.0, -2.0], [4.0, 3.0, 4.0], (200, 3))
    apart = other.refractivity(points) - smooth.refractivity(points)
    assert np.abs(apart).max() < 0.02e-4


def test_the_lamp_lights_all_and_moves_no_line():
    """Rationale: every pixel must cost, and the line must stay comparable."""
    film = {"width": 256, "height": 256, "spp": 1, "line_radius": 0.5, "field": ""}  # cold
    scenes = (load_scene("hot_cylinder", **film), with_lamp(**film))
    dark, lit = (render_frame(scene).radiance for scene in scenes)
    assert (dark > 0.0).mean() < 0.1
    assert (lit > 0.0).mean() > 0.5
    added = lit - dark
    assert 0.0 < added.max() < 1e-3 * dark.max()


@pytest.mark.slow
def test_the_panel_ranks_what_is_known():
    """Rationale: straight light misses by pixels, marched rays by next to nothing.

    Mitsuba's `direct` shades itself in the middle of the cylinder and loses columns there, so that
    an rms is of others; the largest error is on the flanks, which both have.
    """
    made = list(measure_all("frames", frames.tasks(quick=True), lambda *now: None, 1))
    laser, lit = (
        {(m.name, m.chosen["samples_per_pixel"]): m for m in made if m.task.startswith(task)}
        for task in ("a frame of the laser line", "a frame with every pixel lit")
    )
    assert laser["marched", 4].rms_px < 1e-3
    assert laser["tabulated", 4].rms_px < 3e-3
    assert laser["straight", 4].rms_px > 1.0
    straight = laser["straight", 4].largest_px
    assert laser["direct", 4].largest_px == pytest.approx(straight, rel=1e-2)
    assert lit["tabulated", 4].rms_px < 3e-3
    assert all(m.time_s > 0.0 for m in made)
    assert not any(m.failed for m in made if m.name != "direct")
    assert laser["marched", 4].defaults["step_mm"] == 2.0


@pytest.mark.slow
def test_memory_is_the_frames_own():
    """Rationale: a large parent's memory must not be taken for the frame's (`getrusage` does)."""
    code = (
        "import numpy as np; held = np.ones(150_000_000)\n"
        "from virtual_sensor.studies.chart.scaling import peak_memory_mb\n"
        "print(peak_memory_mb(256, 1))"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert 50.0 < float(ended.stdout) < 1000.0


@pytest.mark.slow
@pytest.mark.skipif(not cuda_found(), reason="no CUDA device")
def test_the_gpu_gives_rows_of_its_own(tmp_path):
    """Rationale: the same code under `cuda_ad_mono`, by the command as the chart calls it."""
    rows, notes = on_gpu(["frames"], quick=True)
    assert notes == []
    assert {row.chosen["variant"] for row in rows} == {"cuda_ad_mono"}
