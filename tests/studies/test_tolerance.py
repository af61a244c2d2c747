"""A tolerance in px: the chosen settings keep it, cost no more than they must, and say why."""

import re

import numpy as np
import pytest
from command_line import command
from random_scenes import check, random_scene, random_tolerance

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.metrology.truth import TrueLine
from virtual_sensor.optics.ray_search import FoundPixels, ray_search
from virtual_sensor.studies import tolerance
from virtual_sensor.studies.tolerance import (
    STEPS_MM,
    choose,
    configured,
    largest_error,
    line_of,
    whole_columns,
)

FILM = {"width": 512, "height": 512}
WEAK = {"blur": 12, "beta": 60}


@pytest.fixture(scope="module")
def weak():
    """Air so broad that it hardly bends light."""
    return load_scene("hot_cylinder", **FILM, **WEAK)


@pytest.fixture(scope="module")
def hot():
    """Light runs along the plume and is bent by pixels."""
    return load_scene("hot_cylinder", **FILM)


@pytest.fixture(scope="module")
def configuration(hot):
    """What is chosen for 0.02 px there."""
    return choose(hot, 0.02)


def moved_px(scene):
    """Largest distance of the hot line from the cold one, from 2001 rays of the float64 search."""
    y = np.linspace(-0.5, 0.5, 2001) * scene.sensor.laser.length_mm
    (u, v), (cold_u, cold_v) = (
        ray_search(s, y, "newton").pixel[::-1].T for s in (scene, scene.cold())
    )
    if u[0] > u[-1]:
        u, v, cold_u, cold_v = u[::-1], v[::-1], cold_u[::-1], cold_v[::-1]
    columns = np.arange(np.ceil(u[0] + 1.0), u[-1] - 1.0)
    return np.abs(np.interp(columns, u, v) - np.interp(columns, cold_u, cold_v)).max()


@pytest.fixture(scope="module")
def weak_px(weak):
    """What refraction moves its line by."""
    return moved_px(weak)


@pytest.mark.slow
def test_of_a_lens_the_sub_pupils_are_chosen():
    """Rationale: each costs a frame's ray maps; too few, and a blurred line is a row of lines.

    The choice keeps its tolerance beside marched light through other points of the pupil.
    """
    film = {"width": 256, "height": 256, "line_radius": 0.3}
    lens = load_scene("hot_cylinder", **film, f_number=8)
    coarse, fine = (choose(lens, px) for px in (0.5, 0.01))
    assert 0 < coarse.sub_pupils < fine.sub_pupils
    assert f"by {fine.sub_pupils} sub-pupils" in " ".join(fine.why)
    assert f", {fine.sub_pupils} sub-pupils: about" in str(fine)
    assert choose(load_scene("hot_cylinder", **film), 0.5).sub_pupils == 0
    assert choose(lens.with_parameters(sub_pupils=1), 0.5).sub_pupils == 0
    chosen = configured(lens, fine)
    assert chosen.camera.sub_pupils == fine.sub_pupils
    marched = lens.with_parameters(transport="marched", sub_pupils=49)
    column = np.arange(90, 98)
    truth = TrueLine.of_rows(line_of(marched, column, 441).row)
    assert largest_error(line_of(chosen, column, fine.spp), truth) < 0.01


@pytest.mark.slow
def test_where_light_bounces_the_points_of_the_stripe_are_chosen():
    """Of a shiny groove; direct light alone has none.  The line is judged where it stands out."""
    film = {"width": 512, "height": 512, "line_radius": 0.4, "material": "ground_steel"}
    steel = load_scene("v_groove", **film, max_depth=3)
    coarse, fine = (choose(steel, px) for px in (0.5, 0.05))
    assert 0 < coarse.indirect_samples < fine.indirect_samples
    assert f"by {fine.indirect_samples} points of the stripe" in " ".join(fine.why)
    assert f", {fine.indirect_samples} indirect samples: about" in str(fine)
    assert configured(steel, fine).indirect_samples == fine.indirect_samples
    assert choose(load_scene("v_groove", **film), 0.5).indirect_samples == 0


def test_a_weak_field_needs_no_bent_rays(weak, weak_px):
    """Rationale: the line moves by less than is asked for; to bend its light is wasted work."""
    configuration = choose(weak, 1.3 * weak_px)
    assert configuration.transport == "straight"
    assert configuration.estimate_px["refraction left out"] == pytest.approx(weak_px, rel=0.01)


def test_where_the_line_moves_further_light_is_bent(weak, weak_px, hot):
    """Rationale: just below what refraction moves the line by, straight light is wrong."""
    assert choose(weak, 0.9 * weak_px).transport == "tabulated"
    assert choose(hot, 1.0).transport == "tabulated"


def test_less_tolerance_is_never_had_for_less(hot):
    """Rationale: each configuration asked for less error is as costly in every respect, or more."""
    configurations = [choose(hot, px) for px in (100.0, 0.1, 0.01, 0.003)]
    cost = [(-r.step_mm, r.spp, -r.table_px) for r in configurations]
    assert [r.transport for r in configurations] == ["straight"] + 3 * ["tabulated"]
    assert (np.diff(cost[1:], axis=0) >= 0).all()
    assert all(
        r.error_px <= px for r, px in zip(configurations, (100.0, 0.1, 0.01, 0.003), strict=True)
    )


def test_a_cold_scene_is_rendered_straight():
    """Rationale: without a field there is nothing to weigh but samples."""
    configuration = choose(load_scene("cold_cylinder", **FILM), 0.01)
    assert (configuration.transport, set(configuration.estimate_px)) == ("straight", {"samples"})
    assert configuration.error_px <= 0.01


@pytest.mark.parametrize("px", [0.0, -0.01, float("nan"), float("inf")])
def test_a_tolerance_that_is_none_is_refused(hot, px):
    """Rationale: nothing keeps it, or anything does."""
    with pytest.raises(InputError, match=rf"tolerance {px}: give a positive number of px"):
        choose(hot, px)


def test_a_tolerance_that_cannot_be_kept_is_refused_with_the_best(hot):
    """Rationale: float32 ends at about 1e-5 px; settings that miss must not be handed out."""
    with pytest.raises(InputError, match=r"tolerance 1e-07 px: the best that was found is .*march"):
        choose(hot, 1e-7)


def test_a_line_that_has_no_centres_is_refused_with_a_remedy():
    """Rationale: where no column has a centre, no error can be judged."""
    scene = load_scene("hot_cylinder", **FILM, line_radius=0.03)
    with pytest.raises(InputError, match=r"no column has a line centre.*wider line"):
        choose(scene, 0.01)


def test_dots_are_refused():
    """Rationale: what is judged are a line's centres."""
    scene = load_scene("hot_cylinder", **FILM, dots="-2, 2")
    with pytest.raises(InputError, match="the laser makes dots"):
        choose(scene, 0.01)


def test_it_says_what_it_weighed(configuration):
    """Rationale: a user must be able to see which part of the error rules."""
    assert set(configuration.estimate_px) == {"march", "tables", "samples"}
    for words in ("refraction moves the line", "a step of", "per pixel"):
        assert any(words in each for each in configuration.why)
    for part, px in configuration.estimate_px.items():
        assert f"{part} {px:.2g}" in str(configuration)


def test_the_chosen_scene_is_the_configurations(hot, configuration):
    """Rationale: what was judged is what the user gets."""
    chosen = configured(hot, configuration)
    assert chosen.transport.name == configuration.transport
    assert chosen.transport.march.step_mm == configuration.step_mm
    assert chosen.transport.tolerance_px == pytest.approx(configuration.table_px, rel=1e-5)
    assert chosen.mitsuba.sensors()[0].sampler().sample_count() == configuration.spp


def test_choosing_leaves_the_scene_as_it_was(hot):
    """Rationale: many samples are tried on the scene's own sampler."""
    before = hot.mitsuba.sensors()[0].sampler().sample_count()
    choose(hot, 0.1)
    assert hot.mitsuba.sensors()[0].sampler().sample_count() == before


def test_a_scene_without_the_parameters_is_refused_by_name(hot, tmp_path):
    """Rationale: a user's own scene may fix what the configuration would set."""
    text = hot.path.read_text(encoding="utf-8")
    fixed = tmp_path / "fixed.xml"
    fixed.write_text(
        re.sub(r'<default name="transport".*', "", text).replace("$transport", "marched"),
        encoding="utf-8",
    )
    field = hot.path.parent / "fields/hot_cylinder_1250C_quarter.nc"
    scene = load_scene(fixed, **FILM, field=field)
    with pytest.raises(InputError, match=r"no parameter 'transport'; the scene has: .*step"):
        configured(scene, choose(scene, 100.0))


def test_where_rays_are_turned_away_the_shortest_step_is_taken(hot, monkeypatch):
    """Rationale: an error that is not known must not be given out as none."""

    def turned_away(*_):
        raise tolerance.NoMapError("a ray did not reach its depth")

    monkeypatch.setattr(tolerance, "_step", turned_away)
    configuration = choose(hot, 0.02)
    assert configuration.step_mm == min(STEPS_MM)
    assert "march" not in configuration.estimate_px
    assert any("a ray did not reach its depth" in each for each in configuration.why)


def test_columns_beyond_the_line_are_not_judged():
    """Rationale: a column that the line only partly covers has no centre of it."""
    u, nothing = np.array([12.3, np.nan, 3.9]), np.full((3, 3), np.nan)
    none = np.zeros(3, int)
    found = FoundPixels(nothing, np.stack([u, u], axis=1), nothing, nothing[:, 0], none, none)
    np.testing.assert_array_equal(whole_columns(found), np.arange(5, 12))


def test_the_command_says_what_was_chosen(tmp_path):
    """Rationale: what was chosen for the user, and why, must be seen without looking for it."""
    film = ["-D", "width=256", "-D", "height=256", "-D", "line_radius=0.5"]
    status, out, err = command(
        "measure", "hot_cylinder", *film, "--tolerance", 0.02, "-o", tmp_path / "out"
    )
    assert status == 0, err
    assert re.search(r"0\.02 px: transport tabulated, step \d+ mm, .*, spp \d+: about 0\.0", out)
    assert "because refraction moves the line by up to" in out


@pytest.mark.slow
def test_the_tolerance_is_kept_in_random_scenes():
    """Rationale: promised of 200 scenes (benchmarks/random_scenes.py); here of twelve."""
    ratios = []
    for number in range(12):
        rng = np.random.default_rng((1, number))
        scene, parameters = random_scene(rng)
        done = check(scene, parameters, random_tolerance(rng), rng, clock=None)
        assert not done.failure
        ratios.append(done.error_ratio)
    assert max(ratios) <= 1.0
