"""The tabulated transport against marching every ray: what it tells and what it can't."""

import gc
from dataclasses import replace

import numpy as np
import pytest
from virtual_sensor_plugins.renderer import Prepared, steady

import virtual_sensor as vs
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.render import arrangement, render_frame
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.optics.illumination import LightStatus

SCENES = ("hot_cylinder", "stepped_shaft")
COARSE = {"width": 512, "height": 512, "spp": 1}
SMALL = {"width": 256, "height": 256, "spp": 4, "line_radius": 0.5}
PIXEL_MM = 45.056 / np.array([256, 512])
POINT = """<emitter type="point"><point name="position" x="80" y="50" z="90"/>
    <spectrum name="intensity" value="0.5"/></emitter>"""


def load(name="hot_cylinder", **parameters):
    return vs.load_scene(name, **(COARSE | parameters))


def stronger(scene, contrast):
    """The scene in air whose refractivity differs from the surroundings' by so much more."""
    field = scene.field
    nodes = field.ambient + contrast * (field.nodes - field.ambient)
    return scene.with_medium(replace(field, nodes=nodes, _lookups={}))


def nodes(report):
    """Nodes of both maps."""
    return sum(np.prod(each) for each in report.map_nodes.values())


@pytest.fixture(scope="module", params=SCENES)
def frames(request):
    """A scene's name, its frame by tables, and that of rays all marched in double precision."""
    scene = load(request.param)
    exact = load(request.param, transport="marched", precision="double")
    return request.param, render_frame(scene), render_frame(exact)


# ------------------------------------------------------------------------------- what it tells


def test_line_centres_are_those_of_marched_rays(frames):
    """Rationale: this is what a measurement is made of; ends of the line and steps included."""
    _, frame, exact = frames
    assert frame.report.transport == "tabulated"
    lines, expected = vs.line_centres(frame.radiance), vs.line_centres(exact.radiance)
    found = np.isfinite(expected.pixel[:, 1])
    np.testing.assert_array_equal(np.isfinite(lines.pixel[:, 1]), found)
    assert np.count_nonzero(found) > 120
    apart = np.abs(lines.pixel - expected.pixel)[found].max(axis=1)
    assert apart.max() < 0.005


def test_the_truth_is_that_of_marched_rays(frames):
    """Rationale: to the tolerance, at every pixel; the tables find the same pixels to be lit."""
    _, frame, exact = frames
    differ = frame.lit != exact.lit  # centres that the beam just misses
    for image in (frame.radiance, exact.radiance):
        assert image[differ].max(initial=0.0) < 0.01 * image.max()
    both = frame.lit & exact.lit
    apart_mm = np.linalg.norm(frame.point_mm - exact.point_mm, axis=-1)[both]
    pixel_mm = PIXEL_MM[1]
    assert np.quantile(apart_mm, 0.98) < 3.0 * 0.002 * pixel_mm  # edges are seen or just missed
    astray_mm = np.abs(frame.coordinates() - exact.coordinates())[both].max(axis=-1)
    assert np.quantile(astray_mm, 0.98) < 3.0 * 0.002 * pixel_mm


@pytest.fixture(scope="module")
def step():
    """Where the line breaks at a step of the shaft: lit pixels there, by tables and marched."""
    images = {}
    for name in ("tabulated", "marched"):
        scene = load("stepped_shaft", width=1024, height=1024, spp=4, transport=name)
        sensor = scene.mitsuba.sensors()[0]
        held = mi.traverse(sensor)
        held["film.crop_offset"] = mi.ScalarPoint2u(410, 525)
        held["film.crop_size"] = mi.ScalarVector2u(72, 24)
        held.update()
        images[name] = vs.render(scene)
        if name == "marched":
            given, pixels = arrangement(scene), dr.arange(mi.UInt32, 72 * 24)
            fluxes = [steady(device) for device in given.sources.values()]
            place = [(k + 0.5) / 2.0 for k in range(2)]
            images["alone"] = 0.0
            for within in ((x, y) for x in place for y in place):
                on_film = given.view.place(pixels, mi.Point2f(*within))
                ray, _ = given.view.rays(on_film, mi.Point2f(0.5))
                sight, _ = given.marched.sight(ray)
                (seen,) = given.radiances(sight, fluxes, [])
                images["alone"] += np.array(seen)[0].reshape(24, 72) / 4.0
    return images


@pytest.mark.parametrize("name", ["tabulated", "marched"])
def test_samples_beside_a_step_get_their_own_light(step, name):
    """Rationale: a pixel whose centre is in the shadow has samples that are not.

    Compared with rays that know nothing of their pixel's centre.
    """
    inner = np.s_[1:-1, 1:-1]  # light beside the crop is not looked for
    apart = np.abs(step[name] - step["alone"])[inner]
    assert np.count_nonzero(step["alone"][inner]) > 300
    assert apart.max() < 2e-3 * step["alone"].max()


@pytest.fixture(scope="module")
def small():
    """A small frame of marched rays, in double precision."""
    return render_frame(
        vs.load_scene("hot_cylinder", **SMALL, transport="marched", precision="double")
    )


@pytest.fixture(scope="module")
def by_tolerance():
    """The same by tables of two tolerances, in px."""
    loose, tight = (vs.load_scene("hot_cylinder", **SMALL, tolerance=t) for t in (0.05, 0.001))
    return {0.05: render_frame(loose), 0.001: render_frame(tight)}


@pytest.mark.parametrize("tolerance", [0.05, 0.001])
def test_the_error_stays_within_the_tolerance(small, by_tolerance, tolerance):
    """Rationale: of the laser's ray and the point seen, at every pixel's centre."""
    frame, pixel_mm = by_tolerance[tolerance], PIXEL_MM[0]
    assert 0.0 < frame.report.map_error_px <= tolerance
    both = frame.lit & small.lit
    assert np.count_nonzero(both) > 1000
    # A point errs along the surface; square to the line of sight it errs by no more than this.
    apart = np.linalg.norm(frame.point_mm - small.point_mm, axis=-1)[both]
    astray = np.abs(frame.coordinates() - small.coordinates())[both].max(axis=-1)
    assert np.maximum(0.5 * apart, astray).max() < tolerance * pixel_mm


def test_a_looser_tolerance_makes_coarser_tables(by_tolerance):
    """Rationale: nodes are marched rays; who asks for less accuracy must pay less."""
    loose, tight = by_tolerance[0.05].report, by_tolerance[0.001].report
    assert nodes(loose) < 0.7 * nodes(tight)
    assert loose.map_error_px > 2.0 * tight.map_error_px


# ---------------------------------------------------------------------------------- choices


def test_the_straight_way_is_the_cold_frame():
    """Rationale: bit for bit, though the hot air's field is loaded."""
    scene = vs.load_scene("hot_cylinder", **SMALL, transport="straight")
    frame, cold = render_frame(scene), render_frame(scene.cold())
    assert scene.field is not None
    assert frame.report.transport == "straight"
    np.testing.assert_array_equal(frame.radiance, cold.radiance)
    np.testing.assert_array_equal(frame.point_mm, cold.point_mm)


@pytest.mark.parametrize(
    ("choice", "least_px"),
    [
        ({"interpolation": "linear"}, 1e-3),
        ({"dimensions": 2}, 1e-3),
        ({"transport": "first_order"}, 1e-3),
    ],
    ids=["linear", "extruded", "first order"],
)
def test_choices_of_the_model_are_taken(small, choice, least_px):
    """Rationale: each shows in the picture by a little, and by no more."""
    other = render_frame(vs.load_scene("hot_cylinder", **SMALL, **choice))
    both = other.lit & small.lit
    astray = np.abs(other.coordinates() - small.coordinates())[both].max(axis=-1) / PIXEL_MM[0]
    assert least_px < np.median(astray) < 1.0


@pytest.mark.parametrize(
    ("parameters", "expected"),
    [
        ({"transport": "teleported"}, "tabulated, marched, first_order, straight, not teleported"),
        ({"transport": "exact"}, "tabulated, marched, first_order, straight, not exact"),
        ({"tolerance": 0}, "'tolerance' must be a positive number of px, not 0"),
        ({"tolerance": -0.1}, "'tolerance' must be a positive number of px, not -0.1"),
        ({"tolerance": "nan"}, "'tolerance' must be a positive number of px, not nan"),
        ({"interpolation": "quintic"}, "quintic"),
        ({"dimensions": 4}, "4"),
    ],
)
def test_choices_that_are_none_are_refused(parameters, expected):
    """Rationale: with the scene and the line in it, and the names that there are."""
    with pytest.raises(vs.InputError, match=expected) as refusal:
        vs.load_scene("hot_cylinder", **parameters)
    assert "hot_cylinder.xml, line " in str(refusal.value)


def test_an_old_scenes_way_is_refused_with_the_new_name(tmp_path):
    """Rationale: scenes written for 0.5 are about, and must not be rendered otherwise silently."""
    text = (shipped_scenes() / "hot_cylinder.xml").read_text(encoding="utf-8")
    old = tmp_path / "old.xml"
    old.write_text(text.replace('<string name="transport"', '<string name="way"'), encoding="utf-8")
    field = shipped_scenes() / "fields" / "hot_cylinder_1250C_quarter.nc"
    with pytest.raises(vs.InputError, match=r"'way' is called 'transport' now") as no:
        vs.load_scene(old, **SMALL, field=field)
    assert "old.xml, line " in str(no.value)


# ------------------------------------------------------------------------- what it can't tell


def halved(lit):
    """Lit pixels whose camera's map ends in the middle of what they see."""
    camera = lit.tracer.camera
    grid, ends = camera.table.grid, replace(camera.table.grid, high=camera.table.grid.high.copy())
    ends.high[0] = 0.5 * (grid.low[0] + grid.high[0])
    part = type(camera.table)(ends, np.zeros((*grid.shape, 4)))
    return replace(lit, tracer=replace(lit.tracer, camera=replace(camera, table=part)))


def test_samples_off_the_tables_are_marched_and_counted(small):
    """Rationale: half of the line is off one table; what is on it is given as zero there."""
    scene = vs.load_scene("hot_cylinder", **SMALL)
    whole = vs.render(scene)
    prepared = Prepared.of(arrangement(scene))
    exposure, report = replace(prepared, lit=halved(prepared.lit)).exposed(4, 0)
    image, samples = exposure.images()[0], 4 * prepared.lit.index.size
    assert report.samples == samples
    assert 0.2 * samples < report.marched_samples < 0.6 * samples
    apart = np.abs(image - small.radiance) / small.radiance.max()
    one, other = apart[:, :126].max(), apart[:, 130:].max()  # p grows along u, or against it
    assert min(one, other) < 2e-3 < 0.05 < max(one, other)
    assert np.abs(whole - small.radiance).max() < 2e-3 * small.radiance.max()


@pytest.fixture(scope="module")
def folded():
    """A scene whose air folds the laser's map, tabulated and marched."""
    loose = SMALL | {"tolerance": 0.05, "spp": 1}
    scene = stronger(vs.load_scene("hot_cylinder", **loose), 14.0)
    return scene, render_frame(scene)


def test_a_folded_map_falls_back_to_marching_and_says_why(folded):
    """Rationale: the frame is that of marched rays to the bit, and the report says why."""
    _, frame = folded
    assert frame.report.transport == "marched"
    assert "folds" in frame.report.reason or "caustic" in frame.report.reason
    assert not frame.report.map_nodes
    assert np.isnan(frame.report.map_error_px)
    parameters = SMALL | {"transport": "marched", "spp": 1}
    exact = stronger(vs.load_scene("hot_cylinder", **parameters), 14.0)
    np.testing.assert_array_equal(frame.radiance, render_frame(exact).radiance)


def test_where_the_map_is_folded_there_is_no_light_and_no_truth(folded):
    """Rationale: black and NaN, not a plausible wrong ray."""
    _, frame = folded
    dark = frame.truth.index[frame.truth.status["laser"] == LightStatus.FOLDED]
    assert dark.size > 10
    assert np.all(np.isnan(frame.coordinates().reshape(-1, 2)[dark]))
    assert not np.any(frame.lit.ravel()[dark])
    assert np.all(frame.radiance.ravel()[dark] == 0.0)
    assert np.all(np.isfinite(frame.radiance))


# -------------------------------------------------------------------------------- other light


def test_light_of_other_emitters_comes_through_the_same_air(tmp_path):
    """Rationale: a pixel has one displacement there; edges apart it is the marched frame."""
    parameters = SMALL | {"width": 128, "height": 128}
    shipped = vs.load_scene("hot_cylinder", **parameters)
    path = tmp_path / "lamp.xml"
    text = (shipped_scenes() / "hot_cylinder.xml").read_text(encoding="utf-8")
    path.write_text(text.replace("</scene>", POINT + "</scene>"), encoding="utf-8")
    field = shipped.air.path
    frame, exact, cold = (
        render_frame(vs.load_scene(path, **parameters, field=field, transport=name))
        for name in ("tabulated", "marched", "straight")
    )
    top = exact.radiance.max()
    assert frame.report.transport == "tabulated"
    assert np.count_nonzero(exact.radiance) > 5_000
    apart = np.abs(frame.radiance - exact.radiance)
    assert np.mean(apart <= 0.005 * top) >= 0.99
    assert apart.mean() < 0.2 * np.abs(cold.radiance - exact.radiance).mean()


# ------------------------------------------------------------------------- bits and kernels


def test_tables_give_the_same_bits_with_any_number_of_threads():
    """Rationale: a worker of a cluster has other cores, and its results are compared as bytes."""
    scene = vs.load_scene("hot_cylinder", **(SMALL | {"spp": 25, "line_radius": 1.0}))
    threads, frames = dr.thread_count(), []
    try:
        for count in (1, 2):
            dr.set_thread_count(count)
            frames.append(render_frame(scene))
    finally:
        dr.set_thread_count(threads)
    assert frames[0].report.transport == "tabulated"
    for frame in frames[1:]:
        np.testing.assert_array_equal(frame.radiance, frames[0].radiance)
        np.testing.assert_array_equal(frame.coordinates(), frames[0].coordinates())


@pytest.mark.parametrize(
    "other",
    [
        {"tolerance": 0.01},
        {"beta": 7, "tilt": -25},
        {"line_radius": 0.61, "line_length": 20.5},
        {"spp": 9},
    ],
    ids=["tolerance", "pose", "line", "samples"],
)
def test_another_choice_runs_the_same_kernels(other):
    """Rationale: one compiled again for each frame of a sweep would cost more than the frame.

    The second may still compile one: the number that Mitsuba gives the part's BSDF is compiled in,
    and that of the scene before is still held.  The third must not; but scenes that other tests
    left as garbage, collected in between, would free numbers for it.
    """
    gc.collect()
    between = {"tolerance": 0.02} if "tolerance" in other else {"beta": 3}
    between = {"spp": 16} if "spp" in other else between
    for parameters in ({}, between):
        render_frame(vs.load_scene("hot_cylinder", **(SMALL | parameters)))
    scene = vs.load_scene("hot_cylinder", **(SMALL | other))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
        dr.kernel_history_clear()
        frame = render_frame(scene)
        kernels = [k for k in dr.kernel_history() if k["type"] == dr.KernelType.JIT]
    large = [k for k in kernels if k["operation_count"] > 50]  # copies are of NumPy's alignment
    assert frame.report.transport == "tabulated"
    assert large
    anew = [k["operation_count"] for k in large if not k["cache_hit"]]
    # Mitsuba's samplers have their number of samples compiled in: in kernels that make rays, and
    # that add samples up, but not in those that follow light.
    assert len(anew) <= 3 * ("spp" in other)
    assert max(anew, default=0) < 400
