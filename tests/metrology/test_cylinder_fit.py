"""The cylinder fit against cylinders that are known, and its interval against repeated noise."""

from itertools import product

import numpy as np
import pytest
from scipy.optimize import minimize
from scipy.signal import lfilter

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.cylinder_fit import FitStatus, fit_cylinder, radius_interval

RADIUS = 13.5
PLACE = np.array([10.0, -20.0, 30.0])
LINE_MM = np.linspace(-11.0, 11.0, 201)


def rotation(seed):
    """A random rotation (3, 3)."""
    q = np.linalg.qr(np.random.default_rng(seed).normal(size=(3, 3)))[0]
    return q * np.linalg.det(q)


def scan(half_arc_mm, half_length_mm, lines=13, rays=101, off=0.0):
    """Points on a cylinder along x through the origin, line by line, `off` mm outside."""
    angle = np.arcsin(np.linspace(-half_arc_mm, half_arc_mm, rays) / RADIUS)
    x = np.repeat(np.linspace(-half_length_mm, half_length_mm, lines), rays)
    r, angle = RADIUS + off, np.tile(angle, lines)
    return np.column_stack([x, r * np.sin(angle), r * np.cos(angle)])


def section(residual_mm):
    """One line across the same cylinder, with residuals (201,)."""
    return scan(11.0, 0.0, lines=1, rays=201, off=residual_mm)


def autoregressive(correlation, std_mm, seed, n=201):
    """Normal residuals (n,) whose correlation falls by a factor from neighbour to neighbour."""
    white = np.random.default_rng(seed).normal(size=n + 200)
    return std_mm * lfilter([np.sqrt(1.0 - correlation**2)], [1.0, -correlation], white)[200:]


def test_a_tilted_cylinder_comes_back():
    """Rationale: whatever the axis' direction and however short the arc, the truth is the truth."""
    for case in product(((11.0, 60.0), (13.4, 5.0), (5.0, 60.0), (2.0, 3.0)), (1, 2, 3)):
        (half_arc_mm, half_length_mm), seed = case
        turn = rotation(seed)
        fit = fit_cylinder(scan(half_arc_mm, half_length_mm) @ turn.T + PLACE)
        assert fit.status == FitStatus.FITTED, case
        assert fit.radius_mm == pytest.approx(RADIUS, abs=1e-9), case
        axis = turn[:, 0] * np.sign(turn[np.argmax(np.abs(turn[:, 0])), 0])
        np.testing.assert_allclose(fit.axis_direction, axis, atol=1e-10, err_msg=f"{case}")
        np.testing.assert_allclose(
            np.cross(fit.axis_point_mm - PLACE, axis), 0.0, atol=1e-9, err_msg=f"{case}"
        )
        np.testing.assert_allclose(fit.residual_um, 0.0, atol=1e-6, err_msg=f"{case}")
        assert fit.residual_std_um < 1e-7, case
        assert fit.count == 13 * 101, case


def test_the_axis_point_is_the_one_nearest_to_the_points_mean():
    """Rationale: from any point of the axis, the shift of two axes would depend on their tilt."""
    turn, points = rotation(4), scan(11.0, 20.0) + np.array([7.0, 0.0, 0.0])
    fit = fit_cylinder(points @ turn.T)
    np.testing.assert_allclose(fit.axis_point_mm, turn @ [7.0, 0.0, 0.0], atol=1e-9)


def test_no_cylinder_is_nearer_to_noisy_points():
    """Rationale: the distances of a general minimiser, by a formula of its own, say the same."""
    turn = rotation(5)
    points = scan(9.0, 20.0, lines=5, rays=41) @ turn.T
    points += np.random.default_rng(1).normal(0.0, 0.05, points.shape)
    fit = fit_cylinder(points)
    axis = np.argmax(np.abs(fit.axis_direction))

    def squares(x):
        direction = np.insert(x[3:], axis, 1.0)
        place = np.insert(x[1:3], axis, 0.0)
        away = np.linalg.norm(np.cross(points - place, direction), axis=1)
        return np.sum((away / np.linalg.norm(direction) - x[0]) ** 2)

    slope = np.delete(turn[:, 0] / turn[axis, 0], axis)
    found = minimize(squares, [13.0, 0.0, 0.0, *slope], method="BFGS", options={"gtol": 1e-7})
    assert fit.radius_mm == pytest.approx(found.x[0], abs=1e-5)
    assert abs(fit.radius_mm - RADIUS) > 1e-3
    direction = np.insert(found.x[3:], axis, 1.0)
    np.testing.assert_allclose(fit.axis_direction, direction / np.linalg.norm(direction), atol=1e-6)
    assert np.sum(fit.residual_um**2) == pytest.approx(1e6 * found.fun, rel=1e-8)
    assert fit.residual_std_um == pytest.approx(1e3 * np.sqrt(found.fun / 200), rel=1e-8)


def test_residuals_are_positive_outside():
    """Rationale: a sign that nobody fixed is a sign that somebody will read wrongly."""
    points = scan(11.0, 60.0)
    points[700] *= [1.0, 1.001, 1.001]
    fit = fit_cylinder(points)
    assert np.argmax(np.abs(fit.residual_um)) == 700
    assert fit.residual_um[700] == pytest.approx(13.5, rel=0.05)


def test_the_order_of_points_does_not_matter():
    """Rationale: a hot scan has residuals of 70 um; its fit must repeat to 0.01 um all the same."""
    wave = 0.1 * np.cos(np.linspace(-11.0, 11.0, 101))
    points = scan(11.0, 60.0, off=np.tile(wave, 13))
    shuffled = np.random.default_rng(2).permutation(points)
    assert fit_cylinder(shuffled).radius_mm == pytest.approx(
        fit_cylinder(points).radius_mm, abs=1e-8
    )


@pytest.mark.parametrize("slant_deg", [0.0, 30.0])
def test_a_line_suffices_where_the_direction_is_given(slant_deg):
    """Rationale: one laser line is a section, square or slanted; with it the direction is free."""
    points = section(0.0)
    points[:, 0] = np.tan(np.radians(slant_deg)) * points[:, 2]
    turn = rotation(6)
    fit = fit_cylinder(points @ turn.T + PLACE, direction=3.0 * turn[:, 0])
    assert fit.radius_mm == pytest.approx(RADIUS, abs=1e-9)
    np.testing.assert_allclose(fit.axis_direction, turn[:, 0], atol=1e-15)
    np.testing.assert_allclose(np.cross(fit.axis_point_mm - PLACE, turn[:, 0]), 0.0, atol=1e-9)
    assert fit_cylinder(points).status == FitStatus.UNDETERMINED


def test_missing_points_are_left_out_and_counted():
    """Rationale: a camera loses pixels; the rest must still say where they are."""
    points = scan(11.0, 60.0)
    points[3], points[500, 1] = np.nan, np.inf
    fit = fit_cylinder(points)
    assert fit.radius_mm == pytest.approx(RADIUS, abs=1e-9)
    assert fit.count == len(points) - 2
    np.testing.assert_array_equal(np.flatnonzero(np.isnan(fit.residual_um)), [3, 500])


def test_the_residuals_spread_counts_degrees_of_freedom():
    """Rationale: of 8 points 3 unknowns take their share; divided by 8, 0.79 would be left."""
    rng, squares = np.random.default_rng(3), []
    for _ in range(300):
        points = scan(13.0, 0.0, lines=1, rays=8, off=rng.normal(0.0, 1e-3, 8))
        squares.append(fit_cylinder(points, direction=[1.0, 0.0, 0.0]).residual_std_um ** 2)
    assert np.sqrt(np.mean(squares)) == pytest.approx(1.0, abs=0.08)  # 0.018 is its standard error


FLAT = np.column_stack([*np.random.default_rng(4).uniform(-9.0, 9.0, (2, 60)), np.zeros(60)])
NOISE = np.random.default_rng(5).normal(0.0, 1e-3, (201, 3))


@pytest.mark.parametrize(
    ("points", "direction", "status"),
    [
        (scan(11.0, 60.0)[:5], None, FitStatus.TOO_FEW),
        (section(0.0)[:3], [1, 0, 0], FitStatus.TOO_FEW),
        (np.full((50, 3), np.nan), None, FitStatus.TOO_FEW),
        (np.empty((0, 3)), None, FitStatus.TOO_FEW),
        (np.outer(np.arange(20.0), [1, 2, 3]), None, FitStatus.UNDETERMINED),
        (np.outer(np.arange(20.0), [0, 2, 3]), [1, 0, 0], FitStatus.UNDETERMINED),
        (np.ones((20, 3)), None, FitStatus.UNDETERMINED),
        (FLAT, None, FitStatus.UNDETERMINED),
        (FLAT, [1, 0, 0], FitStatus.UNDETERMINED),
        (FLAT + NOISE[:60], None, FitStatus.UNDETERMINED),
        (section(0.0), None, FitStatus.UNDETERMINED),
        (section(0.0) + NOISE, None, FitStatus.UNDETERMINED),
    ],
)
def test_what_determines_no_cylinder_gives_none(points, direction, status):
    """Rationale: NaN with a reason; any number there would be made up."""
    fit = fit_cylinder(points, direction=direction)
    assert fit.status == status
    assert fit.count == np.isfinite(points).all(axis=1).sum()
    numbers = (fit.radius_mm, fit.residual_std_um, *fit.axis_point_mm, *fit.axis_direction)
    assert np.isnan(numbers).all()
    assert fit.residual_um.shape == (len(points),)
    assert np.isnan(fit.residual_um).all()


def coverage(correlation, block, trials=200):
    """Part of the trials whose interval of 95 % holds the true radius."""
    held = 0
    for seed in range(trials):
        points = section(autoregressive(correlation, 1e-3, seed + 1000))
        low, high = radius_interval(points, block, direction=[1.0, 0.0, 0.0])
        held += low <= RADIUS <= high
    return held / trials


@pytest.mark.parametrize(
    ("correlation", "block"),
    [(0.0, 1), (0.8, 20), *(pytest.param(c, 10, marks=pytest.mark.slow) for c in (0.0, 0.5))],
)
def test_the_interval_holds_the_truth_as_often_as_it_says(correlation, block):
    """Rationale: that is what 95 % means; white residuals and correlated ones in blocks.

    Measured: 0.925, 0.94, 0.91 and 0.925; the standard error of 200 trials is 0.02.
    """
    assert 0.88 <= coverage(correlation, block) <= 0.99


def test_points_one_by_one_would_promise_too_much():
    """Rationale: were blocks of no use, the test before would not show that they work."""
    assert coverage(0.8, 1, trials=100) < 0.6


@pytest.mark.slow
def test_one_step_is_as_good_as_a_whole_fit():
    """Rationale: the interval is made without refitting; here each resample is refitted.

    Residuals as large as a hot cylinder's; 1500 resamples tell a width to 4 %.
    """
    direction, rays = [1.0, 0.0, 0.0], 101
    residual = np.random.default_rng(6).normal(0.0, 0.07, rays)
    points = scan(11.0, 0.0, lines=1, rays=rays, off=residual)
    fit = fit_cylinder(points, direction=direction)
    across = (points - fit.axis_point_mm) * [0.0, 1.0, 1.0]
    outward = across / np.linalg.norm(across, axis=1, keepdims=True)
    rng, radii = np.random.default_rng(7), []
    for _ in range(1500):
        drawn = rng.choice(fit.residual_um, rays)
        moved = points + outward * (drawn - fit.residual_um)[:, None] * 1e-3
        radii.append(fit_cylinder(moved, direction=direction).radius_mm)
    expected = np.quantile(radii, [0.025, 0.975])
    found = np.array(radius_interval(points, 1, direction=direction, resamples=1500))
    np.testing.assert_allclose(found, expected, atol=0.1 * np.ptp(expected))


def test_the_interval_repeats_to_the_bit():
    """Rationale: a report that differs from run to run can't be compared with anything."""
    points = scan(11.0, 60.0, off=np.tile(autoregressive(0.8, 1e-3, 1, 101), 13))
    first = radius_interval(points, 100)
    assert radius_interval(points, 100) == first
    assert radius_interval(points, 100, fit=fit_cylinder(points)) == first
    assert first[0] < fit_cylinder(points).radius_mm < first[1]
    other = radius_interval(points, 100, seed=1)
    assert other != first
    assert other == pytest.approx(first, abs=0.3 * (first[1] - first[0]))


def test_missing_points_shorten_the_interval_s_row():
    """Rationale: one lost pixel must not make an interval NaN."""
    points = section(autoregressive(0.5, 1e-3, 2))
    whole = radius_interval(points, 10, direction=[1.0, 0.0, 0.0])
    lost = np.insert(points, 100, np.nan, axis=0)
    assert radius_interval(lost, 10, direction=[1.0, 0.0, 0.0]) == whole


def test_no_fit_has_no_interval():
    """Rationale: of points in a plane."""
    assert np.isnan(radius_interval(FLAT, 1)).all()


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        ({"points_mm": np.zeros((3, 20))}, r"points_mm has the shape \(3, 20\); give \(N, 3\)"),
        ({"direction": [0.0, 0.0, 0.0]}, "give three finite numbers, not all zero"),
        ({"direction": [1.0, np.nan, 0.0]}, "give three finite numbers, not all zero"),
        ({"direction": [1.0, 0.0]}, "give three finite numbers, not all zero"),
    ],
)
def test_unfit_arguments_of_a_fit_are_refused(arguments, words):
    """Rationale: transposed points and directions that are none are easy mistakes."""
    with pytest.raises(InputError, match=words):
        fit_cylinder(**({"points_mm": scan(11.0, 60.0)} | arguments))


@pytest.mark.parametrize(
    "arguments", [{"block": 0}, {"block": 41}, {"level": 1.0}, {"level": 0.0}, {"resamples": 1}]
)
def test_unfit_arguments_of_an_interval_are_refused(arguments):
    """Rationale: with too few blocks there is no spread to speak of: 201 points leave 5 of 40."""
    with pytest.raises(InputError, match="give a block of 1 to 40 of these points"):
        radius_interval(section(0.0), **({"block": 1, "direction": [1, 0, 0]} | arguments))
