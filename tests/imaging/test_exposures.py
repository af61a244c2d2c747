"""Frames that take time: smear, the skew of a rolling shutter, and the truth of each row.

The oracles are frames of scenes that Mitsuba loads again with the sensor moved, and v t.
"""

from functools import lru_cache

import numpy as np
import pytest
from numpy.testing import assert_allclose, assert_array_equal

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.poses import Pose

SMALL = {"width": 96, "height": 96, "film_width": 1.056, "line_radius": 0.2, "spp": 16}


@lru_cache
def scene_of(name="cold_cylinder", **parameters):
    return vs.load_scene(name, **(SMALL | parameters))


def after(scene, velocity, time_s):
    """The part has moved on: the sensor has gone back as far."""
    return scene.with_sensor_moved(Pose.shift(-np.array(velocity) * time_s))


def moments(image):
    """Mean row and variance of the light in the middle columns."""
    light = np.asarray(image, float)[:, 30:66]
    row = np.arange(len(light))[:, None]
    mean = (light * row).sum(axis=0) / light.sum(axis=0)
    return mean, (light * (row - mean) ** 2).sum(axis=0) / light.sum(axis=0)


def edge(image):
    """Where the lit part begins in each row, by the light that is missing before column 48."""
    light = np.asarray(image, float)
    return 48.0 - light[:, :48].sum(axis=1) / light[:, 44:48].mean(axis=1)


def test_a_part_at_rest_gives_the_frame_of_the_scene():
    for parameters in ({}, {"name": "stepped_shaft", "emissivity": 0.8}):
        scene = scene_of(**parameters)
        still = vs.render_frame(scene, background=True)
        frame = vs.render_exposure(scene, "2ms", background=True)
        assert frame.exposure_s == 2e-3
        assert_array_equal(frame.radiance, still.radiance)
        assert_array_equal(frame.background, still.background)
        assert_array_equal(frame.coordinates(), still.coordinates())
        assert_array_equal(frame.point_mm, still.point_mm)


def test_a_line_smears_by_velocity_times_time():
    """The variance of a smear is (v t)^2/12, in px by frames of the scene at start and end."""
    for name, way_mm in (("cold_cylinder", 0.12), ("hot_cylinder", 0.12), ("cold_cylinder", 0.8)):
        scene = scene_of(name)
        velocity, time_s = (0.0, 0.0, way_mm / 1e-3), 1e-3
        frame = vs.render_exposure(scene, time_s, velocity)
        mean, variance = moments(frame)
        still_mean, still_variance = moments(vs.render(scene))
        ends = [moments(vs.render(after(scene, velocity, at)))[0] for at in (-5e-4, 5e-4)]
        smear_px = np.sqrt(12.0 * (variance - still_variance))
        assert_allclose(smear_px, np.abs(ends[1] - ends[0]), rtol=2e-3)
        assert_allclose(mean, still_mean, atol=0.01)
        assert (frame.traces > 1) == (way_mm > 0.5)
        assert frame.radiance.sum() == pytest.approx(vs.render(scene).sum(), rel=5e-3)


def test_a_rolling_shutter_skews_the_edges_of_a_moving_part():
    """Each row is that of a scene with the part where it is then; by another way to the same."""
    scene = scene_of("hot_cylinder", field="", emissivity=0.8, film_width=11.264, spp=64)
    velocity = (0.0, 400.0, 0.0)
    for row_time_s in (4e-5, -4e-5):
        frame = vs.render_exposure(
            scene, 1e-5, velocity, row_time_s=row_time_s, background=True, instants=1
        )
        rows, found, expected = np.array([4, 30, 91]), edge(frame.background), []
        for row in rows:
            moved = after(scene, velocity, (row - 47.5) * row_time_s)
            expected.append(edge(vs.render_frame(moved, background=True).background)[row])
        still = edge(vs.render_frame(scene, background=True).background)[rows]
        skew = np.array(expected) - still
        assert np.ptp(skew) > 2.0
        assert_allclose(
            np.polyfit(rows, found[rows] - still, 1)[0], np.polyfit(rows, skew, 1)[0], rtol=0.01
        )


def test_the_truth_of_a_rolling_line_is_that_of_each_rows_time():
    """A line across the rows, in air: its centres against its truth, and this against search."""
    scene = scene_of("hot_cylinder", beta=20)
    velocity, row_time_s = np.array([0.0, 0.0, 60.0]), 2e-5
    frame = vs.render_exposure(scene, 1e-5, velocity, row_time_s=row_time_s)
    errors = vs.compare_line(vs.line_centres(frame), frame)
    assert errors.count > 80
    assert errors.rms_px < 0.01
    still = vs.compare_line(vs.line_centres(vs.render(scene)), frame)
    assert still.largest_px > 0.03
    for at in (0, errors.count // 2, errors.count - 1):
        u, v = errors.column[at], errors.true_row[at]
        moved = after(scene, velocity, (v - 47.5) * row_time_s)
        there = vs.compare_line(vs.line_centres(vs.render(moved)), vs.render_frame(moved))
        assert there.true_row[there.column == u] == pytest.approx(v, abs=2e-3)
    row, column = round(errors.true_row[9]), int(errors.column[9])
    triangulated = vs.triangulate(scene, np.array([[column, errors.true_row[9]]]))
    point = frame.point_mm[row, column]  # where the part is then, as the sensor at rest sees it
    assert_allclose(point, triangulated[0], atol=0.03)


def test_of_many_places_none_is_left_out():
    """A way through several places, of a wide line: the mean of frames of moved scenes."""
    scene, velocity = scene_of(line_radius=0.5, spp=4), (0.0, 0.0, 1200.0)
    frame = vs.render_exposure(scene, 1e-3, velocity, instants=16)
    assert frame.traces > 3
    assert np.all(np.diff(frame.truth.index.astype(int)) > 0)
    times = 1e-3 * ((np.arange(12) + 0.5) / 12 - 0.5)
    expected = np.mean([vs.render(after(scene, velocity, at)) for at in times], axis=0)
    assert_allclose(frame.radiance, expected, atol=0.01 * expected.max())
    # In cold air the sensor at rest sees the truth of a pixel in that pixel, whatever its place.
    rolling = vs.render_exposure(scene, 1e-6, velocity, row_time_s=1e-5)
    assert rolling.traces > 3
    pixel = np.stack([rolling.truth.index % 96, rolling.truth.index // 96], axis=1)
    seen = scene.camera.project(rolling.truth.point_mm)
    lit = np.isfinite(seen).all(axis=1)
    assert lit.sum() > 4000
    assert_allclose(seen[lit], pixel[lit], atol=0.002)


def test_what_cannot_be_exposed_is_refused():
    scene = scene_of()
    for arguments, said in (
        ((0.0,), "an exposure time with its unit"),
        ((np.nan,), "an exposure time with its unit"),
        (("auto",), "how long the part moves is not known; give exposure_s"),
        ((1e-3, (1, 2)), "three finite numbers"),
        ((1e-3, (np.inf, 0, 0)), "three finite numbers"),
        ((1.0, (0, 0, 1e6)), "would smear by"),
        ((1e-3, (0, 0, 1e9)), "mm per s"),
    ):
        with pytest.raises(InputError, match=said):
            vs.render_exposure(scene, *arguments)
    with pytest.raises(InputError, match="row_time_s"):
        vs.render_exposure(scene, 1e-3, row_time_s=np.inf)
    with pytest.raises(InputError, match="instants"):
        vs.render_exposure(scene, 1e-3, instants=0)
