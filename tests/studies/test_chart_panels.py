"""The chart's panels of searches, corrections, fringes and detectors: tasks know the truth."""

from dataclasses import replace

import numpy as np
import pytest
from artificial import line_image

from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.drawn_lines import line_shares
from virtual_sensor.studies.chart import bounces, cameras, corrections, detectors, fringes, searches
from virtual_sensor.studies.chart.benchmark import measure_all

UNBIASED = ("gaussian", "weighted_gaussian", "max_likelihood")
UM_PER_PX = 22.0
FRINGES = ("phase 3 16,128,1280 u", "phase 6 16,128,1280 u", "phase 4 8,64,1280 u")


def quick(panel, module):
    """What the panel measures, run once."""
    return list(measure_all(panel, module.tasks(quick=True), lambda *now: None, 1))


def test_searches_are_ordered_by_their_march():
    """Newton's default is right to 1e-6 px, the paper's to its r_max, and long steps to neither."""
    found = quick("search", searches)
    assert all(m.panel == "search" and m.time_s > 0.0 for m in found)
    new, cached, papers, lost, newtons, longer = found
    assert newtons.largest_px < 1e-6 < 1e-4 < longer.largest_px < papers.largest_px
    assert papers.largest_px < 1.1 / UM_PER_PX
    assert lost.failed == lost.items
    assert newtons.failed == longer.failed == papers.failed == 0
    assert newtons.largest_px < new.largest_px == cached.largest_px <= 1e-3
    assert new.failed == cached.failed == 0


@pytest.mark.slow
def test_corrections_are_ordered_by_what_is_known_of_the_air():
    """Nothing, other air, air found from one pose and from two; the air itself leaves 0.01 µm."""
    task = next(corrections.tasks(quick=True))
    left = {m.name: m for m in measure_all("correction", [task], lambda *now: None, 1)}
    assert all(m.failed == 0 and m.time_s > 0.0 for m in left.values())
    um = {name: m.rms_um for name, m in left.items()}
    assert um["not_corrected"] == pytest.approx(255.0, abs=5.0)
    assert um["own_air_new_maps"] == um["own_air_cached_maps"] < 0.02
    assert um["own_air_marched"] < 0.02
    assert um["own_air_marched"] < um["found_on_a_known_shape"] < um["found_from_one_pose"]
    assert um["found_from_two_poses"] < um["found_from_one_pose"] < um["other_air"] < 20.0


def test_fringes_are_ordered_by_their_steps_and_periods():
    """More steps and finer fringes err less in noise, by sqrt(2/N) lambda; gamma goes by steps."""
    rms_px = {}
    noisy, gamma = [task for task, _ in zip(fringes.tasks(), range(2), strict=False)]
    for task in (noisy, gamma):
        some = [c for c in task.configurations if c.defaults["codec"] in FRINGES]
        for each in measure_all("fringes", [replace(task, configurations=some)], print, 1):
            rms_px[task.name, each.defaults["codec"]] = each.rms_px
            assert each.failed <= 0.01 * each.items
    three, six, fine = (rms_px[noisy.name, text] for text in FRINGES)
    assert three / six == pytest.approx(np.sqrt(2.0), rel=0.05)
    assert six / fine == pytest.approx(2.0 * np.sqrt(4.0 / 6.0), rel=0.05)
    assert rms_px[gamma.name, FRINGES[0]] > 10 * rms_px[gamma.name, FRINGES[1]]


def test_a_rendered_sequence_is_as_good_as_the_search():
    """Of a coarse film a thousandth of a projector's pixel, by maps and by marches."""
    *_, rendered = fringes.tasks(quick=True)
    for each in measure_all("fringes", [rendered], lambda *now: None, 1):
        assert each.rms_px < 0.01
        assert each.failed < 0.2 * each.items


@pytest.mark.slow
def test_cameras_are_ordered_by_their_sub_pupils_and_by_what_is_recorded():
    """A pinhole misses what the lens does to hot air; noise and speckle hide what few pupils err.

    The reference is marched, through other points of the pupil.
    """
    tasks = list(cameras.tasks(quick=True))
    found = [list(measure_all("camera", [task], lambda *now: None, 1)) for task in tasks]
    by = [{(m.name, m.chosen.get("sub_pupils")): m.rms_px for m in each} for each in found]
    light, noisy, speckled = by
    assert all(m.time_s > 0.0 for each in found for m in each)
    assert all(m.failed == 0 for each in found for m in each if m.chosen.get("sub_pupils") != 4)
    (few, _), (many, _) = cameras.QUICK_SUB_PUPILS
    assert light["pinhole", None] > 3.0 * light["cached_maps", many]
    assert light["cached_maps", few] > light["cached_maps", many] == light["new_maps", many]
    assert light["marched", few] == pytest.approx(light["cached_maps", few], abs=2e-3)
    assert light["cached_maps", many] < noisy["recorded", many] < 0.3 * speckled["recorded", many]


def test_light_that_bounces_is_less_noisy_by_more_points_of_the_stripe():
    """Direct light alone misses what a shiny groove adds to its own line."""
    (task,) = bounces.tasks(quick=True)
    direct, bounced = measure_all("bounces", [task], lambda *now: None, 1)
    assert (direct.name, bounced.name) == ("direct_light", "bounced")
    assert bounced.chosen == {"bounces": 1, "indirect_samples": 4}
    assert direct.failed == bounced.failed == 0
    assert 0.0 < bounced.rms_px < direct.rms_px


def test_detectors_know_their_truth_and_their_bound():
    """Exact on drawn lines without noise, as good as they predict in noise, right in a frame."""
    found = quick("lines", detectors)
    tasks = list(dict.fromkeys(m.task for m in found))
    assert tasks[0] == "line of sigma 1.5 px, 5,000 e at its peak, read noise 2 e"
    assert all([m.name for m in found if m.task == task] == list(COLUMNWISE) for task in tasks)
    assert all(m.failed == 0 for m in found if "read noise" not in m.task)
    assert all(m.failed <= 0.02 * m.items for m in found)
    for each in found:
        if "no noise" in each.task:
            assert each.largest_px < (1e-4 if each.name in UNBIASED else 0.1)
        elif "frame" in each.task:
            assert each.largest_px < (0.01 if each.name in UNBIASED else 0.1)
            assert each.rms_um == pytest.approx(each.rms_px * 88.0)
        else:
            predicted = float(each.note.split()[1])
            assert np.isnan(predicted) or each.rms_px == pytest.approx(predicted, rel=0.35)
            assert each.rms_px > 0.85 * each.bound_px > 0.0  # of 256 columns, by chance
    best = {m.name: m.rms_px / m.bound_px for m in found if m.task == tasks[0]}
    assert best["max_likelihood"] == pytest.approx(1.0, abs=0.15)


def test_lines_are_drawn_as_the_tests_draw_them():
    """With the error function over the pixel's edges, written twice."""
    centre = np.linspace(30.0, 31.0, 7)
    peak = 5.0 * np.sqrt(2.0 * np.pi) * 1.3
    drawn = peak * line_shares(centre, 1.3, 64)[0]
    np.testing.assert_allclose(drawn, line_image(centre, 1.3, 5.0), atol=1e-12)
