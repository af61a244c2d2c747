"""The main job as a whole: what a measurement of the paper's cylinder must keep to."""

import csv
import json
import re
from dataclasses import replace

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.scene_file import find_scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.metrology.truth import DotErrors, TrueLine, TruthStatus, compare_line
from virtual_sensor.optics.ray_search import SearchStatus, ray_search
from virtual_sensor.reporting.measure import on_console, save, table
from virtual_sensor.studies.measure import measure, probe_deviations, summary
from virtual_sensor.studies.notes import _closer_nodes, beside_solid, centre_notes, coarse_grid
from virtual_sensor.studies.probes import PROBES, probe_rays
from virtual_sensor.studies.reproduction.settings import NINE_RAYS_MM
from virtual_sensor.studies.search import search

FIELD_OF_VIEW_MM = 45.056


@pytest.fixture(
    scope="module",
    params=[
        pytest.param({"width": 512, "height": 512, "spp": 4}, id="512px"),
        pytest.param({}, id="2048px", marks=pytest.mark.slow),
    ],
)
def measured(request):
    """The hot cylinder measured, on a small film and on the paper's, and the progress told."""
    stages = []
    scene = load_scene("hot_cylinder", **request.param)
    return measure(scene, lambda stage, fraction: stages.append((stage, fraction))), stages


@pytest.fixture(scope="module")
def result(measured):
    return measured[0]


@pytest.mark.parametrize("state", ["cold", "hot"])
def test_the_rendered_line_lies_on_the_searched_one(result, state):
    """Rationale: image and search share the march only; 0.003 px rms is what a detector resolves.

    On the small film a pixel is four times as large, and so is what this allows in um.
    """
    compared = result.states[state].by_search
    assert compared.rms_px <= 0.003
    assert compared.largest_px <= 0.01


@pytest.mark.parametrize("state", ["cold", "hot"])
def test_every_column_of_the_searched_line_is_compared(result, state):
    """Rationale: a figure without the line's ends would be the better for it, and worth less."""
    measured = result.states[state]
    assert (measured.dense.status == SearchStatus.FOUND).all()
    u = np.sort(measured.dense.pixel[:, 0])
    wholly = np.arange(np.ceil(u[0] + 0.5), np.floor(u[-1] - 0.5) + 1.0)
    assert np.isin(wholly, measured.by_search.column).all()
    assert measured.by_search.expected == wholly.size
    assert measured.by_search.cut == 0


@pytest.mark.parametrize("state", ["cold", "hot"])
def test_the_papers_search_ends_within_its_radius_in_its_steps(result, state):
    """Rationale: Beermann et al. 2018, section 4.2: r_max = 1 um, k_stop = 15."""
    found = result.states[state].paper
    assert (found.status == SearchStatus.FOUND).all()
    assert found.distance_um.max() < 1.0
    assert found.iterations.max() <= 15


@pytest.mark.parametrize("state", ["cold", "hot"])
def test_newtons_search_needs_few_marches_and_finds_the_same(result, state):
    """Rationale: quadratic convergence to what the paper's search came near, by its own distance.

    In px that is the distance over a pixel's size, but for the plume, a lens of up to 1.3.
    """
    newton, paper = result.states[state].newton, result.states[state].paper
    assert newton.iterations.max() <= 6
    assert newton.distance_um.max() < 1e-3
    camera = result.cold.scene.sensor.camera
    um_per_px = 1e3 * camera.pose.to_local(newton.laser_point_mm)[:, 2] / camera.matrix[0, 0]
    apart = np.linalg.norm(newton.pixel - paper.pixel, axis=1) * um_per_px
    np.testing.assert_allclose(apart, paper.distance_um, rtol=0.3, atol=1e-3)


def test_in_cold_air_the_measured_point_is_the_point(result):
    """Rationale: straight light closes the circle laser, surface, pixel, triangulation."""
    assert np.abs(probe_deviations(result).cold_error_um).max() < 1e-6


def test_rounded_pixels_move_the_point_by_half_a_step_along_each_axis_of_the_sensor(result):
    """Rationale: half of 0.25 px is 0.125 px, 2.75 um of 22 um, along u and along v.

    The paper's 2.7 um is that figure.  The distance in space is larger, up to 3.35 um for its rays,
    because the laser plane is inclined to the sensor: by 60 degrees to its axis, so that a
    point which moves by dv across the line of sight moves by dv tan(30 degrees) along it, too.
    """
    cold_um = probe_deviations(result, 0.25).cold_error_um
    camera = result.cold.scene.sensor.camera
    half_step_um = 0.125 * FIELD_OF_VIEW_MM * 1e3 / camera.size[0]
    perspective = camera.pose.to_local(result.cold.newton.laser_point_mm)[:, 2] / 300.0
    along = np.abs(cold_um @ camera.pose.rotation) / perspective[:, None]
    assert (along[:, :2] <= 1.001 * half_step_um).all()
    np.testing.assert_allclose(along[:, 2], along[:, 1] * np.tan(np.radians(30.0)), rtol=2e-3)
    in_space = summary(result).probe_rays.largest_cold_error_rounded_um
    assert half_step_um < in_space < half_step_um * np.sqrt(1.0 + 1.0 / np.cos(np.radians(30)) ** 2)


def test_at_the_top_line_the_measured_point_lies_above_the_surface(result):
    """Rationale: as in the paper's figure 7; refraction of the wrong sign would put it below."""
    [top] = np.flatnonzero(result.probe_y_mm == 0.0)
    hot = result.hot.newton
    measured = triangulate(result.hot.scene.sensor, hot.pixel)
    assert abs(hot.laser_point_mm[top, 2]) < 1e-3
    assert 0.02 < measured[top, 2] < 0.2


def test_progress_never_goes_back(measured):
    """Rationale: a bar that jumps back is worse than none."""
    stages, fractions = zip(*measured[1], strict=True)
    assert (np.diff(fractions) >= 0.0).all()
    assert (fractions[0], fractions[-1]) == (0.0, pytest.approx(1.0))
    assert {"cold part: rendering", "hot part: rendering"} <= set(stages)


def test_a_search_tells_its_progress():
    """Rationale: 3,001 rays take seconds, in which the command said nothing."""
    told = []
    search(load_scene("hot_cylinder"), "paper", [0.0, 5.0], report=lambda *now: told.append(now))
    stages, fractions = zip(*told, strict=True)
    assert (np.diff(fractions) >= 0.0).all()
    assert fractions[0] == 0.0
    assert stages.count("searching, ray by ray") > 5


def test_a_part_that_is_only_cold_has_no_hot_figures():
    """Rationale: NaN and null where nothing was measured, never a zero."""
    film = {"width": 256, "height": 256, "spp": 1, "line_radius": 0.5}
    result = measure(load_scene("cold_cylinder", **film))
    assert list(result.states) == ["cold"]
    deviation = probe_deviations(result)
    assert np.isnan(
        [deviation.hot_error_um, deviation.incidence_shift_um, deviation.measured_shift_um]
    ).all()
    assert np.abs(deviation.cold_error_um).max() < 1e-6
    figures = json.loads(json.dumps(summary(result).to_dict()))
    assert figures["probe_rays"]["largest_incidence_shift_um"] is None
    assert list(figures["states"]) == ["cold"]
    assert figures["states"]["cold"]["paths"] is None


LASERS = {"line_length": 6}, {"line_length": 500}, {"dots": "0 -5"}, {"dots": "-12"}, {"beta": 30}


@pytest.mark.parametrize("given", LASERS, ids=str)
@pytest.mark.parametrize("name", ["hot_cylinder", "stepped_shaft"])
def test_a_scenes_own_probe_rays_are_lit_and_seen(name, given):
    """Rationale: of a line of 6 mm the paper's rays lit three of nine; a user's line is his own."""
    scene = load_scene(name, **given)
    y = probe_rays(scene)
    laser = scene.sensor.laser
    found = ray_search(scene.cold(), y, "newton")
    assert (found.status == SearchStatus.FOUND).all()
    if laser.dots_mm.size:
        np.testing.assert_array_equal(y, laser.dots_mm)
        return
    assert y.size == PROBES
    seen = ray_search(scene.cold(), np.linspace(-0.5, 0.5, 2001) * laser.length_mm, "newton")
    seen_y = seen.laser_point_mm[seen.status == SearchStatus.FOUND, 1]
    assert np.ptp(found.laser_point_mm[:, 1]) > 0.8 * np.ptp(seen_y)


def test_probe_rays_that_are_given_are_those_of_all_tables(tmp_path):
    """Rationale: who compares with another program's rays asks for these, wherever they are."""
    film = {"width": 256, "height": 256, "spp": 1, "line_radius": 0.5}
    given = [1.0, -7.25, 3.5]
    result = measure(load_scene("hot_cylinder", **film), y_mm=given)
    save(result, tmp_path / "out", "virtual-sensor measure")
    with (tmp_path / "out/probe_rays.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [float(row["y_mm"]) for row in rows] == given
    np.testing.assert_allclose(
        [float(row["incidence_cold_mm_y"]) for row in rows], given, atol=1e-9
    )
    with pytest.raises(InputError, match=r"the rays' y are \[nan\]; give finite numbers in mm"):
        measure(load_scene("hot_cylinder"), y_mm=[np.nan])


@pytest.mark.parametrize(
    ("laser", "lit"),
    [
        ({"line_length": 6}, 3),
        pytest.param({"dots": "0 -5"}, 2, marks=pytest.mark.slow),
        ({"dots": "-12"}, 0),
    ],
    ids=str,
)
def test_rays_without_light_have_no_figure_anywhere(tmp_path, laser, lit):
    """Rationale: a line of 6 mm was said to have nine found rays, the farthest 333 um off."""
    film = {"width": 512, "height": 512, "spp": 1}
    result = measure(load_scene("hot_cylinder", **film, **laser), y_mm=NINE_RAYS_MM)
    figures = save(result, tmp_path / "out", "virtual-sensor measure")
    with (tmp_path / "out/probe_rays.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    dark = [row for row in rows if row["status_cold"] != "found"]
    assert len(dark) == 9 - lit
    assert any(f"{9 - lit} of 9 probe rays are not lit" in note for note in result.notes)
    for row in dark:
        assert {row.pop(name) for name in list(row) if "status" in name} == {"unlit"}
        assert not any(row[name] for name in row if name != "y_mm")
    rays = figures.probe_rays
    assert rays.lit == lit
    for state in figures.states.values():
        assert state.paper_search.found == state.newton_search.found == lit
    largest = [value for name, value in vars(rays).items() if name.startswith("largest")]
    assert all(np.isnan(value) == (lit == 0) for value in largest)


def test_a_field_whose_grid_is_too_coarse_is_noted(tmp_path):
    """Rationale: `field info` said so, `measure` did not; right: what eight times the nodes say."""
    x, z = np.arange(-96.0, 97.0, 12.0), np.arange(-16.0, 161.0, 8.0)

    def scene(step_mm):
        y = np.arange(-24.0, 24.1, step_mm)
        along = np.exp(-((x / 32.0) ** 2))[:, None, None]
        across = np.exp(-0.5 * (y / 5.0) ** 2)[:, None] * np.cos(z / 102.0) ** 4
        air = GriddedQuantity(
            "temperature", 293.15 + 900.0 * along * across, [-96, -24, -16], [12.0, step_mm, 8.0]
        )
        write_quantity(tmp_path / "air.nc", air)
        return load_scene("hot_cylinder", field=tmp_path / "air.nc")

    coarse, fine = scene(6.0), scene(0.75)
    [(note, caveat)] = coarse_grid(coarse).items()
    rows = []
    for each in (fine, coarse):  # of the line: along itself nobody sees it move
        u, v = ray_search(each, np.linspace(-10.5, 10.5, 401), "newton").pixel.T
        rows.append(np.interp(np.linspace(600.0, 1400.0, 81), u, v))
    lost_px = np.abs(rows[1] - rows[0]).max()
    said = re.search(r"air.nc: .*loses about ([\d.]+) px of the .* \(([\d.]+) um\)", note)
    said_px, said_um = map(float, said.groups())
    assert 0.5 < said_px / lost_px < 2.0
    assert said_um == pytest.approx(said_px * 22.0 / np.sin(np.radians(60.0)), rel=0.1)
    moved_px = float(re.search(r"air moves it by ([\d.]+) px", note)[1])
    assert caveat == (said_px > 0.1 * moved_px)
    assert note.endswith(
        "make it with closer nodes (field simulate --grid, field import --spacing)"
    )
    assert coarse_grid(fine) == {}


def test_closer_nodes_of_a_simulation_are_made_by_the_command_that_is_told(tmp_path, monkeypatch):
    """Rationale: without the case's name the flow is solved again, for minutes."""
    monkeypatch.chdir(tmp_path)
    history = (
        "2026-01-01T00:00:00+00:00 virtual-sensor field simulate --scene 'my a' -o b.nc --quick"
    )
    said = {"history": history, "parameters": '{"cell_mm": 3.1}'}
    air = GriddedQuantity(
        "temperature", np.full((4, 4, 4), 300.0), [0.0] * 3, [1.05, 1.5, 2.1], attributes=said
    )
    write_quantity(tmp_path / "b.nc", air)
    field = IndexField.read("b.nc")
    assert "`" not in _closer_nodes(tmp_path / "b.nc", field)  # its case is gone
    (tmp_path / "b.case").mkdir()
    told = _closer_nodes(tmp_path / "b.nc", field)
    assert "the flow's cells, 3.1 mm, are wider" in told
    assert told.split("`")[1] == (
        "virtual-sensor field simulate --scene 'my a' --quick --cell 2.1 -o finer_cells.nc"
    )
    air = replace(air, attributes=said | {"parameters": '{"cell_mm": 2}'})
    write_quantity(tmp_path / "b.nc", air)
    assert _closer_nodes(tmp_path / "b.nc", field).split("`")[1] == (
        "virtual-sensor field simulate --scene 'my a' --quick --grid 0.7,1,1.4 --case b.case -o"
        " closer_nodes.nc"
    )


def test_a_line_beside_the_solid_of_its_field_is_told():
    """Rationale: a part that is 3 mm higher was measured in air that was simulated inside it."""
    scene = load_scene("hot_cylinder")
    y = np.linspace(-3.0, 3.0, 9)
    points = np.column_stack([0.0 * y, y, np.sqrt(13.5**2 - y**2) - 13.5])
    assert beside_solid(scene, points) == []
    for by_mm, words in ((3.0, "mm above the solid"), (-3.0, "mm inside the solid")):
        (note,) = beside_solid(scene, points + np.array([0.0, 0.0, by_mm]))
        said = float(re.search(rf"the laser's line lies (\S+) {words} of the field hot_", note)[1])
        assert said == pytest.approx(3.0, abs=0.7)
    assert beside_solid(scene, np.full((3, 3), np.nan)) == []
    assert beside_solid(scene.cold(), points) == []


def test_a_line_that_stands_upright_is_noted(tmp_path):
    """Rationale: "none none 2" leaves a user puzzled; only the camera is turned."""
    text = find_scene("cold_cylinder").read_text(encoding="utf-8")
    turned = text.replace("<lookat", '<rotate z="1" angle="90"/><lookat', 1)
    (tmp_path / "turned.xml").write_text(turned, encoding="utf-8")
    film = {"width": 256, "height": 256, "spp": 1, "line_radius": 0.5}
    upright, flat = (
        [note for note in measure(load_scene(scene, **film)).notes if "upright" in note]
        for scene in (tmp_path / "turned.xml", "cold_cylinder")
    )
    assert "turn the camera by 90 degrees" in upright[0]
    assert flat == []


def test_notes_say_when_the_figures_are_worth_little():
    """Rationale: few centres, all of one side or cut ones have an rms that says nothing."""
    rows = np.full(100, 20.0)
    truth = TrueLine.of_rows(rows)

    def notes(found, truth=truth, status=Status.OK):
        line = LineCentres.of_rows(np.where(found, rows, np.nan))
        line = replace(line, status=np.where(found, Status.OK, status).astype(np.uint8))
        searched, by_frame = (compare_line(line, truth, cut=cut) for cut in (False, True))
        return centre_notes(line, searched, by_frame, (-9.5, 2.0))

    column = np.arange(100)
    assert notes(column >= 0) == {}
    far = compare_line(LineCentres.of_rows(rows + 0.5), truth, cut=True)
    for speckled in (False, True):
        (wrong,) = centre_notes(LineCentres.of_rows(rows), far, far, (0.0, 0.0), speckled)
        assert ("nothing of speckle" in wrong) == speckled
    [(few, caveat)] = notes(column >= 5, status=Status.SATURATED).items()
    assert not caveat
    assert few == "5 of 100 columns that see the whole line have no centre: saturated 5"
    [(one_side, caveat)] = notes(column >= 60, status=Status.SATURATED).items()
    assert caveat
    assert one_side.endswith("saturated 60, and none has one from y = -9.5 to 2.0 mm")
    [(narrow, caveat)] = notes(column >= 95, status=Status.TOO_NARROW).items()
    assert caveat
    assert narrow.endswith("; a finer film (width, height) or a wider line (line_radius) has more")
    cut = replace(truth, status=np.where(column < 80, TruthStatus.CUT, truth.status))
    [(hardly, caveat)] = notes(column >= 0, truth=cut).items()
    assert caveat
    assert hardly == "20 of 100 centres were compared with the search; 80 are cut by an edge"
    [(nothing, caveat)] = notes(column < 0, status=Status.TOO_NARROW).items()
    assert not caveat
    assert nothing.startswith("no line centres, the columns are too_narrow; the line is")
    assert nothing.endswith(" or some defocus")
    most_dark = np.where(column < 80, Status.NO_PEAK, Status.TOO_NARROW)
    assert "too_narrow; the line is too narrow" in next(iter(notes(column < 0, status=most_dark)))
    nearly_dark = np.where(column < 99, Status.NO_PEAK, Status.TOO_NARROW)
    assert "too_narrow; no line stands out" in next(iter(notes(column < 0, status=nearly_dark)))
    dots = DotErrors(np.array([[1.0, 2.0], *2 * [[np.nan] * 2]]), np.ones(3), np.zeros((3, 2)), 0)
    assert centre_notes(None, dots, None, (0.0, 0.0)) == {"1 of 3 dots were found": True}


def test_what_is_true_of_cold_and_hot_is_noted_once(monkeypatch):
    """Rationale: of two long notes that say the same nobody sees where they differ."""
    words = iter([["of both", "of the cold"], ["of both"]])
    monkeypatch.setattr("virtual_sensor.studies.measure.frame_notes", lambda report: next(words))
    notes = measure(load_scene("hot_cylinder", width=64, height=64, spp=1, line_radius=1)).notes
    assert {"of both", "cold: of the cold"} <= set(notes)
    assert not {"cold: of both", "hot: of both"} & set(notes)


def test_the_summary_says_what_was_really_used():
    """Rationale: of 7 samples asked for 9 were taken, and the summary still said 7."""
    film = {"width": 128, "height": 128, "line_radius": 1, "spp": 9, "step": 4}
    made = summary(measure(load_scene("hot_cylinder", **film))).made_with
    assert (made.samples_per_pixel, made.step_mm) == (9, 4.0)


def test_a_search_of_no_ray_is_empty():
    """Rationale: a script's empty list is an answer of its kind, not a fault of the engine."""
    result = search(load_scene("hot_cylinder"), "newton", [])
    assert result.found == 0
    assert len(result.rays) == 0
    assert result.rays.status.dtype.kind == "U"


def test_a_line_much_longer_than_the_part_is_compared_as_well_as_one_that_fits():
    """Rationale: of 401 rays over 500 mm the search had a point every 1.25 mm: 0.26 px rms."""
    scene = load_scene("cold_cylinder", line_length=500, line_radius=0.4, width=512, height=512)
    state = measure(scene).cold
    assert state.compared.rms_px < 0.005
    assert state.compared.count > 0.98 * state.centres


def test_a_part_that_lights_itself_has_its_ghosts_counted():
    """In summary, console and table of all; of direct light alone there is no word of them."""
    film = {"width": 128, "height": 128, "line_radius": 1.0, "spp": 4}
    steel = {"material": "ground_steel", "roughness": 0.3}
    figures = {}
    for depth in (2, 3):
        result = measure(load_scene("v_groove", **film, **steel, max_depth=depth))
        figures[depth] = summary(result)
        shown = f"{on_console(figures[depth])}{table(result, figures[depth]).markdown()}"
        assert ("Ghost" in shown) == (depth == 3)
    assert figures[2].states["cold"].ghosts is None
    assert any("max_depth=3 has them" in note for note in figures[2].notes)
    ghosts = figures[3].states["cold"].ghosts
    assert ghosts.bounces == 1
    assert 0.5 * ghosts.columns < ghosts.ghost_columns < ghosts.columns
    assert ghosts.ghost_over_line < ghosts.largest_ghost_over_line
    assert 0.1 < ghosts.indirect_share < 0.6
