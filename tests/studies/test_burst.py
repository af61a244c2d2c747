"""A burst of frames through air that sways as told: what it says of the line and of the rays."""

import csv
import json
import re

import numpy as np
import pytest
from scipy.interpolate import CubicSpline
from typer.testing import CliRunner

from virtual_sensor import cli
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.air import air_refractivity
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity
from virtual_sensor.metrology.line_peaks import Status
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies import burst_results
from virtual_sensor.studies.burst import MIN_FRAMES, burst, instants, spread, summary

FILM = {"width": 512, "height": 512, "spp": 4, "line_length": 20}
X, Y, Z = np.arange(-96.0, 97.0, 12.0), np.arange(-24.0, 25.0, 1.5), np.arange(-16.0, 161.0, 8.0)
ORIGIN, SPACING = [-96.0, -24.0, -16.0], [12.0, 1.5, 8.0]
AMPLITUDE_MM = 1.5
STORED_S = np.linspace(4.0, 6.0, 17)
FRAMES = 5
RAYS_MM = np.linspace(0.0, -10.0, 9)


def shift_mm(time_s):
    """Where the plume stands across the cylinder: a sine of 0.8 s."""
    return AMPLITUDE_MM * np.sin(2.0 * np.pi * time_s / 0.8)


def plume_kelvin(centre_mm):
    """Temperature of a plume about y = centre_mm that fades in x, y and z; (nx, ny, nz)."""
    x, y, z = np.meshgrid(X, Y, Z, indexing="ij")
    fading = np.cos(np.pi / 320.0 * np.clip(z, 0.0, 160.0)) ** 2
    across = np.exp(-0.5 * ((y - centre_mm) / 4.0) ** 2)
    return 293.15 + 900.0 * across * np.exp(-((x / 32.0) ** 2)) * fading


def scene_of(path, temperatures, times, **parameters):
    """The hot cylinder in air of these temperatures (nt, nx, ny, nz)."""
    quantity = GriddedQuantity("temperature", temperatures, ORIGIN, SPACING, times)
    write_quantity(path, quantity)
    return load_scene("hot_cylinder", field=path, **FILM, **parameters)


@pytest.fixture(scope="module")
def swaying(tmp_path_factory):
    """Scene in the swaying plume."""
    path = tmp_path_factory.mktemp("field") / "sway.nc"
    return scene_of(path, np.array([plume_kelvin(shift_mm(t)) for t in STORED_S]), STORED_S)


@pytest.fixture(scope="module")
def told():
    """The progress that was told."""
    return []


@pytest.fixture(scope="module")
def result(swaying, told):
    """A burst in the last half second, each frame at a stored instant."""
    return burst(swaying, None, 0.5, FRAMES, lambda *said: told.append(said), RAYS_MM)


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
    measured = spread(result.with_height(result.measured_mm))
    np.testing.assert_allclose(
        measured.std[:, :3], np.std(points, axis=0, ddof=1), rtol=0.01, atol=2e-5
    )
    heights = np.array(points) @ result.up
    np.testing.assert_allclose(
        measured.std[:, 3], np.std(heights, axis=0, ddof=1), rtol=0.01, atol=2e-5
    )


def test_still_air_does_not_sway(tmp_path):
    """Rationale: what is left is the rounding of float32 sums, between two instants as well."""
    still = np.array([plume_kelvin(0.7)] * 2)
    scene = scene_of(tmp_path / "still.nc", still, np.array([0.0, 1.0]))
    result = burst(scene, None, 1.0, 3)
    line, rays = spread(result.centres_px), spread(result.rays_px)
    assert np.nanmax(line.std) < 1e-5
    assert np.nanmax(rays.std) < 1e-9
    assert np.isfinite(line.std).all(axis=1).sum() > 85
    assert "up to 1 s apart and the frames 0.5 s" in result.notes[0]


def test_the_frames_are_told_as_they_come(result, told):
    """Rationale: a burst takes minutes; who waits wants to know which frame it is at."""
    stages, parts = zip(*told, strict=True)
    assert list(dict.fromkeys(stages)) == [
        f"frame {i + 1} of 5, {t:.3f} s" for i, t in enumerate(np.linspace(5.5, 6.0, FRAMES))
    ]
    assert (np.diff(parts) >= 0.0).all()
    assert (parts[0], parts[-1]) == (0.0, 1.0)
    assert result.notes == ()


def test_a_deviation_needs_three_frames():
    """Rationale: n - 1 below the line, a column's gaps left out, and no figure from two frames."""
    values = np.array([[1.0, 5.0, np.nan], [2.0, np.nan, np.nan], [4.0, 7.0, 1.0], [9.0, 6.0, 2.0]])
    found = spread(values[..., None])
    np.testing.assert_array_equal(found.frames, [4, 3, 2])
    np.testing.assert_allclose(found.std[:2, 0], [np.std([1, 2, 4, 9], ddof=1), 1.0], rtol=1e-14)
    np.testing.assert_allclose(found.mean[:2, 0], [4.0, 6.0])
    assert np.isnan([found.std[2, 0], found.mean[2, 0]]).all()
    assert MIN_FRAMES == 3


def columns_of(path):
    """Columns of a CSV file as text."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    return dict(zip(header, zip(*rows, strict=True), strict=True))


def numbers(cells):
    """Cells as numbers, empty ones NaN."""
    return np.array([float(cell or "nan") for cell in cells])


@pytest.fixture(scope="module")
def folder(result, tmp_path_factory):
    """The burst's results as files."""
    place = tmp_path_factory.mktemp("burst") / "sway"
    burst_results.save_burst(result, summary(result), place)
    return place


def test_the_tables_hold_the_sway(folder, result):
    """Rationale: the deviations can be made again from the tidy table of frames."""
    assert {p.name for p in folder.iterdir()} == {
        *("sway.csv", "probe_rays.csv", "frames.csv", "sway.ply", "report.png", "summary.json")
    }
    sway, frames = (columns_of(folder / name) for name in ("sway.csv", "frames.csv"))
    rows = numbers(frames["row"]).reshape(FRAMES, -1)
    z = numbers(frames["point_mm_z"]).reshape(FRAMES, -1)
    whole = np.isfinite(rows).all(axis=0)
    assert whole.sum() > 85
    for name, values in (("std_v_px", rows), ("std_um_z", 1e3 * z)):
        again = np.std(values[:, whole], axis=0, ddof=1)
        np.testing.assert_allclose(numbers(sway[name])[whole], again, rtol=1e-5, atol=1e-6)
    np.testing.assert_allclose(numbers(frames["time_s"])[:: rows.shape[1]], result.time_s)
    assert set(np.array(sway["status"])[whole]) == {"ok"}
    dark = numbers(sway["frames"]) == 0
    assert set(np.array(sway["status"])[dark]) <= {s.name.lower() for s in Status} - {"ok"}
    assert np.isnan(numbers(sway["std_v_px"])[dark]).all()
    rays = columns_of(folder / "probe_rays.csv")
    np.testing.assert_allclose(
        numbers(rays["std_px_u"]), np.std(result.rays_px[..., 0], axis=0, ddof=1), rtol=1e-8
    )


def test_the_summary_says_what_was_measured(folder, result):
    """Rationale: figures without the instants and the field they are of are worth nothing."""
    figures = json.loads((folder / "summary.json").read_text(encoding="utf-8"))
    assert figures["first and last frame, s"] == [5.5, 6.0]
    assert figures["field"]["instants stored"] == len(STORED_S)
    along = figures["standard deviation along the line"]
    assert along["v, px"]["largest"] == np.nanmax(spread(result.centres_px).std[:, 1])
    assert figures["frames"] == FRAMES
    assert figures["seconds"].keys() == {"field", "search", "render", "centres"}


def test_an_interrupted_burst_leaves_nothing(result, tmp_path, monkeypatch):
    """Rationale: Ctrl-C while the page is drawn, when the tables are written already."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(burst_results, "draw_burst", interrupted)
    with pytest.raises(KeyboardInterrupt):
        burst_results.save_burst(result, summary(result), tmp_path / "sway")
    assert list(tmp_path.iterdir()) == []


def test_the_command_passes_on_what_is_asked_for(result, swaying, tmp_path, monkeypatch):
    """Rationale: its work is tested above; here, that the options reach it and its answer the user.

    Results that are there are not replaced.
    """
    asked = []

    def answered(scene, start_s, duration_s, frames, report, y_mm):
        asked.append((scene.parameters["field"], start_s, duration_s, frames, y_mm))
        return result

    monkeypatch.setattr("virtual_sensor.studies.burst.burst", answered)
    file, place = str(swaying.air.path), tmp_path / "sway"
    line = ["burst", "hot_cylinder", "-D", f"field={file}", "-o", str(place)]
    options = ["--start", "5.5", "--duration", "0.5", "--frames", "5", "-y", "-1", "-y", "2"]
    ended = CliRunner().invoke(cli.app, [*line, *options])
    assert (ended.exit_code, asked) == (0, [(file, 5.5, 0.5, 5, [-1.0, 2.0])])
    assert (place / "sway.csv").exists()
    again = CliRunner().invoke(cli.app, line)
    assert isinstance(again.exception, InputError)
    assert "--overwrite" in str(again.exception)


def test_ctrl_c_in_a_ray_march_is_no_error_of_the_program(tmp_path, monkeypatch):
    """Rationale: Dr.Jit's loops turn it into a RuntimeError, and most of a burst is ray marches."""

    def interrupted(*_):
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
    with pytest.raises(InputError, match=r"no line in the frame at 5\.5 s; give a wider"):
        burst(scene, None, 0.5, 3)
