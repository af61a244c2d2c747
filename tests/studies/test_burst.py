"""A burst of frames through air that sways as told: what it says of the line and of the rays."""

import re

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from swaying_plume import (
    FILM,
    ORIGIN,
    SPACING,
    STORED_S,
    plume_kelvin,
    scene_of,
    shift_mm,
    swaying_scene,
)

from virtual_sensor import cli
from virtual_sensor.errors import InputError, NothingFoundError
from virtual_sensor.imaging.recording_options import RecordingOptions
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.air import air_refractivity
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.burst import MIN_FRAMES, burst, instants, spread

FRAMES = 5
RAYS_MM = np.linspace(0.0, -10.0, 9)


@pytest.fixture(scope="module")
def swaying(tmp_path_factory):
    """Scene in the swaying plume."""
    return swaying_scene(tmp_path_factory.mktemp("field") / "sway.nc")


@pytest.fixture(scope="module")
def told():
    """The progress that was told."""
    return []


@pytest.fixture(scope="module")
def passed():
    """The frames that were passed on, with their numbers and instants."""
    return []


@pytest.fixture(scope="module")
def result(swaying, told, passed):
    """A burst in the last half second, each frame at a stored instant."""
    return burst(
        *(swaying, None, 0.5, FRAMES, lambda *said: told.append(said), RAYS_MM),
        each_frame=lambda number, instant_s, frame, _: passed.append((number, instant_s, frame)),
    )


@pytest.fixture(scope="module")
def oracle(swaying):
    """The same instants from the formula alone: no file, no packing, no picture; scenes."""
    n_air = air_refractivity()
    return [
        swaying.with_medium(
            IndexField.from_arrays(
                n_air * 293.15 / plume_kelvin(shift_mm(t)), ORIGIN, SPACING, ambient=n_air
            )
        )
        for t in np.linspace(5.5, 6.0, FRAMES)
    ]


def test_the_line_sways_as_the_rays_of_each_instant_do(result, oracle):
    """Rationale: rendered, detected and averaged, against dense searches in the formula's air.

    In a single frame image and search may part by 0.003 px, in all of them by about the same.
    """
    y = np.linspace(-4.4, 4.4, 121)
    u = result.lines[0].column
    rows = []
    for scene in oracle:
        pixel = ray_search(scene, y, "newton").pixel
        ascending = pixel[np.argsort(pixel[:, 0])]
        rows.append(CubicSpline(*ascending.T, extrapolate=False)(u))
    expected = np.std(rows, axis=0, ddof=1)
    line = spread(result.centres_px)
    both = np.isfinite(expected) & (line.frames == FRAMES)
    assert both.sum() > 85
    assert expected[both].max() > 0.05
    np.testing.assert_allclose(line.std[both, 1], expected[both], atol=5e-4)
    np.testing.assert_allclose(line.mean[both, 1], np.mean(rows, axis=0)[both], atol=0.003)


def test_the_probe_rays_sway_as_in_the_formulas_air(result, oracle):
    """Rationale: packing in 16 bits is all that lies between the two; it must not be seen."""
    searched = [ray_search(scene, RAYS_MM, "newton") for scene in oracle]
    pixel = spread(result.rays_px)
    expected = np.std([found.pixel for found in searched], axis=0, ddof=1)
    seen = np.isfinite(expected[:, 0])
    assert seen.all()
    np.testing.assert_allclose(pixel.std, expected, atol=2e-4)
    points = [triangulate(oracle[0].sensor, found.pixel) for found in searched]
    heights = np.array(points) @ result.up
    table = result.ray_table
    for std_um, values in (
        (table.std_measured_um, points),
        (table.std_measured_height_um, heights),
    ):
        expected_um = 1e3 * np.std(values, axis=0, ddof=1)
        np.testing.assert_allclose(std_um, expected_um, rtol=0.01, atol=0.02)


def test_still_air_does_not_sway(tmp_path):
    """Rationale: what is left is the rounding of float32 sums, between two instants as well."""
    still = np.array([plume_kelvin(0.7)] * 2)
    scene = scene_of(tmp_path / "still.nc", still, np.array([0.0, 1.0]))
    result = burst(scene, None, 1.0, 3)
    line, rays = spread(result.centres_px), spread(result.rays_px)
    assert np.nanmax(line.std) < 1e-5
    assert np.nanmax(rays.std) < 1e-9
    assert np.isfinite(line.std).all(axis=1).sum() > 85
    assert "up to 1 s apart and the frames 0.5 s" in result.notes[-1]


def test_the_frames_are_told_as_they_come(result, told):
    """Rationale: a burst takes minutes; who waits wants to know which frame it is at."""
    stages, parts = zip(*told, strict=True)
    assert list(dict.fromkeys(stages)) == [
        f"frame {i + 1} of 5, {t:.3f} s" for i, t in enumerate(np.linspace(5.5, 6.0, FRAMES))
    ]
    assert (np.diff(parts) >= 0.0).all()
    assert (parts[0], parts[-1]) == (0.0, 1.0)
    (note,) = result.notes
    assert "marks no solid" in note


def test_a_deviation_needs_three_frames():
    """Rationale: n - 1 below the line, a column's gaps left out, and no figure from two frames."""
    values = np.array([[1.0, 5.0, np.nan], [2.0, np.nan, np.nan], [4.0, 7.0, 1.0], [9.0, 6.0, 2.0]])
    found = spread(values[..., None])
    np.testing.assert_array_equal(found.frames, [4, 3, 2])
    np.testing.assert_allclose(found.std[:2, 0], [np.std([1, 2, 4, 9], ddof=1), 1.0], rtol=1e-14)
    np.testing.assert_allclose(found.mean[:2, 0], [4.0, 6.0])
    assert np.isnan([found.std[2, 0], found.mean[2, 0]]).all()
    assert MIN_FRAMES == 3


@pytest.fixture(scope="module")
def tables(result):
    """The sway of the line and of the rays, and all frames."""
    return result.sway_table, result.ray_table, result.frame_table


def test_the_tables_hold_the_sway(tables, result):
    """Rationale: the deviations can be made again from the tidy table of frames."""
    sway, rays, frames = tables
    rows = frames.row.reshape(FRAMES, -1)
    z = frames.point_mm[:, 2].reshape(FRAMES, -1)
    whole = np.isfinite(rows).all(axis=0)
    assert whole.sum() > 85
    for std, values in ((sway.std_v_px, rows), (sway.std_um[:, 2], 1e3 * z)):
        again = np.std(values[:, whole], axis=0, ddof=1)
        np.testing.assert_allclose(std[whole], again, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(frames.time_s[:: rows.shape[1]], result.time_s)
    assert set(sway.status[whole]) == {"ok"}
    dark = sway.frames == 0
    assert set(sway.status[dark]) <= {s.name.lower() for s in Status} - {"ok"}
    assert np.isnan(sway.std_v_px[dark]).all()
    np.testing.assert_allclose(
        rays.std_px[:, 0], np.std(result.rays_px[..., 0], axis=0, ddof=1), rtol=1e-8
    )


def test_what_stays_is_the_mean_points_distance_from_the_part(tables):
    """Rationale: the plane of the laser is tilted by 30 degrees, so that it cuts an ellipse."""
    sway = tables[0]
    top = np.abs(sway.y_mm) < 0.5
    assert top.sum() > 3
    y, z = sway.mean_mm[top, 1:].T
    above_um = 1e3 * (np.hypot(y, z + 13.5) - 13.5) / np.cos(np.radians(30.0))
    np.testing.assert_allclose(sway.static_error_um[top], above_um, rtol=2e-3)


def test_the_summary_says_what_was_measured_and_where_it_sways_most(tables, result):
    """Rationale: figures without the instants and the field they are of are worth nothing."""
    sway = tables[0]
    figures = result.summary.to_dict()
    assert (figures["first_frame_s"], figures["last_frame_s"]) == (5.5, 6.0)
    assert figures["field"]["instants"] == len(STORED_S)
    assert figures["frames"] == FRAMES
    assert figures["stage_s"].keys() == {"field", "search", "render", "record", "centres"}
    v, height = figures["line"]["v_px"], figures["line"]["height_um"]
    assert v["largest"] == np.nanmax(spread(result.centres_px).std[:, 1])
    at = int(np.nanargmax(sway.std_height_um))
    assert height["largest"] == sway.std_height_um[at]
    assert (height["largest_y_mm"], height["largest_frames"]) == (sway.y_mm[at], sway.frames[at])
    assert figures["static_error_at_largest_um"] == sway.static_error_um[at]


def test_every_frame_is_passed_on_and_some_are_kept_to_be_looked_at(result, passed):
    """Rationale: a long burst's frames fill the memory; who wants them writes them as they come."""
    assert [number for number, *_ in passed] == list(range(FRAMES))
    np.testing.assert_allclose([instant for _, instant, _ in passed], result.time_s)
    views = result.views
    rows, columns = (
        slice(start, start + size)
        for start, size in (
            (views.first_row, views.mean.shape[0]),
            (views.first_column, views.mean.shape[1]),
        )
    )
    images = [frame.radiance for *_, frame in passed]
    assert all(image[rows, columns].sum() > 0.99 * image.sum() > 0.0 for image in images)
    np.testing.assert_allclose(views.mean, np.mean(images, axis=0)[rows, columns], atol=1e-7)
    assert list(views.radiance) == [5.5, 5.75, 6.0]
    np.testing.assert_array_equal(views.radiance[5.75], images[2][rows, columns])


def test_a_recorded_burst_tells_the_sensors_noise_from_the_sway_of_the_air(swaying, result):
    """Rationale: a noisy line sways in still air too; and a frame is the same alone or in a burst.

    The ideal frames are those of the burst that is not recorded; noise is independent of the air.
    """
    shots, options = [], RecordingOptions("cmos_5um5", seed=4)
    recorded = burst(
        *(swaying, None, 0.5, FRAMES),
        y_mm=RAYS_MM,
        each_frame=lambda number, instant_s, frame, shot: shots.append((instant_s, frame, shot)),
        recording=options,
    )
    line, known = recorded.sway_table, recorded.sway_table.frames == FRAMES
    np.testing.assert_array_equal(line.std_ideal_v_px, result.sway_table.std_v_px)
    expected = np.median([each.sigma[known] for each in recorded.lines])
    assert np.median(line.std_noise_v_px[known]) == pytest.approx(expected, rel=0.25)
    parts = line.std_ideal_v_px[known] ** 2 + line.std_noise_v_px[known] ** 2
    assert np.mean(line.std_v_px[known] ** 2) == pytest.approx(parts.mean(), rel=0.1)
    assert recorded.summary.line.noise_v_px.median == np.median(line.std_noise_v_px[known])
    instant_s, frame, shot = shots[3]
    alone = options.recorded(swaying.at(instant_s), frame, 3, "camera", "laser")
    np.testing.assert_array_equal(alone.grey, shot.grey)
    assert (shots[2][2].grey != shot.grey).mean() > 0.5
    assert result.summary.line.noise_v_px is None


def test_ctrl_c_in_a_ray_march_is_no_error_of_the_program(tmp_path, monkeypatch):
    """Rationale: Dr.Jit's loops turn it into a RuntimeError, and most of a burst is ray marches."""

    def interrupted(*_, **__):
        raise RuntimeError("dr.while_loop(): encountered an exception") from KeyboardInterrupt()

    monkeypatch.setattr("virtual_sensor.studies.burst.burst", interrupted)
    monkeypatch.setattr("signal.signal", lambda *_: None)
    monkeypatch.setattr(
        "sys.argv", ["virtual-sensor", "burst", "hot_cylinder", "-o", f"{tmp_path}/a"]
    )
    with pytest.raises(SystemExit) as ended:
        cli.main()
    assert ended.value.code == 130
    assert list(tmp_path.iterdir()) == []


def test_by_default_the_last_second_is_taken(swaying):
    """Rationale: the most developed flow; its instants and no others."""
    times, stored = instants(swaying)
    np.testing.assert_allclose(times, np.linspace(5.0, 6.0, 11))
    np.testing.assert_array_equal(stored, STORED_S)
    times, _ = instants(swaying, 4.0, 2.0, 3)
    np.testing.assert_allclose(times, [4.0, 5.0, 6.0])


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        ({"start_s": 3.5}, r"sway\.nc: holds 4 to 6 s, and the burst .* from 3\.5 to 4\.5 s; give"),
        ({"start_s": 5.5}, r"from 5\.5 to 6\.5 s; give another start or a shorter duration"),
        ({"duration_s": 3.0}, "from 3 to 6 s; give"),
        ({"duration_s": 0.0}, "in 0 s .* positive duration"),
        ({"duration_s": float("nan")}, "in nan s .* positive duration"),
        ({"start_s": float("nan")}, "from nan to nan s; give"),
        ({"frames": 2}, "2 frames .* at least 3 frames"),
    ],
)
def test_a_burst_that_the_field_does_not_hold_is_refused(swaying, arguments, message):
    """Rationale: asked before the first frame, in a line that tells the range."""
    with pytest.raises(InputError, match=message):
        instants(swaying, **arguments)


@pytest.mark.parametrize(
    ("scene", "parameters", "message"),
    [
        ("hot_cylinder", {}, r"1250C_quarter\.nc: holds one instant; .* dimension 'time'"),
        ("cold_cylinder", {}, "light runs straight; a burst needs a field that moves"),
        (None, {"time": 5}, "time=5 picks one instant; leave it out"),
        (None, {"dots": "0, -1"}, "follows a line; take the dots away"),
        (None, {"beta": 120}, "under the floor"),
    ],
)
def test_a_scene_that_can_have_no_burst_is_refused(swaying, scene, parameters, message):
    """Rationale: a shipped field is of one instant; what is needed instead is said."""
    field = {} if scene else {"field": swaying.air.path}
    with pytest.raises(InputError, match=message) as error:
        burst(load_scene(scene or "hot_cylinder", **field, **parameters), None, 0.5, 3)
    assert re.match(r"\S+\.(xml|nc): ", str(error.value))


def test_a_frame_without_a_line_is_refused(swaying):
    """Rationale: a line too thin for its samples is not seen; not after all frames, but now."""
    scene = load_scene(
        "hot_cylinder",
        field=swaying.air.path,
        **(FILM | {"spp": 1, "line_radius": 1e-4}),
    )
    with pytest.raises(NothingFoundError, match=r"no line in the frame at 5\.5 s; give a wider"):
        burst(scene, None, 0.5, 3)
