"""Euler's method and Dormand and Prince's: against SciPy's tableau, closed forms, SciPy's rays."""

import numpy as np
import oracles
import pytest
from oracles import unit
from scipy.integrate import RK45, quad_vec

from virtual_sensor import IndexField, RayStatus, trace
from virtual_sensor.arrays import to_numpy, to_vectors
from virtual_sensor.engine import dr, mi
from virtual_sensor.medium.exact_fields import fish_eye, hot_spot, luneburg, selfoc
from virtual_sensor.optics.eikonal import March, Straight, bend, in_plane
from virtual_sensor.optics.steppers import DOPRI5_LOWER, DOPRI5_STAGES, dopri5_with_error
from virtual_sensor.optics.surfaces import Cylinder, NoSurface

BOX = np.array([[-60.0] * 3, [60.0] * 3])
STARTS = np.array([[-12.0, 3.0, 1.0], [-10.0, -4.0, 5.0], [-11.0, 0.5, -6.0]])
DIRECTIONS = unit([[1.0, 0.2, -0.1], [1.0, 0.0, 0.3], [1.0, -0.3, 0.2]])
NOTHING = NoSurface()


def to_plane(field, march, starts=STARTS, directions=DIRECTIONS, x_mm=30.0, surface=NOTHING, **how):
    """Rays marched to the plane x = x_mm: line, rays."""
    line = Straight.through(to_vectors(starts), to_vectors(unit(directions)), march)
    ends = in_plane(march.vector(1, 0, 0), x_mm - line.anchor.x)
    return line, bend(field, surface, line, march, remaining=ends, **how)


def random_air(seed=4):
    """A smooth random field in a small box, with its SciPy twin."""
    rough = np.random.default_rng(seed).normal(size=(9, 11, 11))
    field = IndexField.from_arrays(
        0.02 * rough, [-14.0, -20.0, -20.0], [4.0, 4.0, 4.0], ambient=0.0
    )
    return field, oracles.spline_index(field.nodes, field.origin, field.spacing, field.mirror)


# ----------------------------------------------------------------------------------- the tableau


def test_the_tableau_is_scipys():
    """RK45 is Dormand and Prince's pair too, typed by others."""
    rows = [[*row, *[0.0] * (5 - len(row))] for row in DOPRI5_STAGES[:6]]
    np.testing.assert_allclose(rows, RK45.A, rtol=1e-15)
    np.testing.assert_allclose(DOPRI5_STAGES[6], RK45.B, rtol=1e-15)
    error = np.array(DOPRI5_LOWER) - [*DOPRI5_STAGES[6], 0.0]
    np.testing.assert_allclose(error, RK45.E, rtol=0, atol=1e-16)


def test_a_step_and_its_error_are_those_of_the_system_of_first_order():
    """Nystrom's form spares the stages of v, and must give what they would have given."""

    def acceleration(t, x):
        return np.array([-1.3 * x[0] + 0.4 * t, x[0] * x[2], np.sin(x[1]) - t**2])

    def slope(t, y):
        return np.concatenate([y[3:], acceleration(t, y[:3])])

    y0, t0, h = np.array([0.3, -0.2, 0.5, 1.0, 0.4, -0.7]), 0.2, 0.45
    stages = [slope(t0, y0)]
    for c, row in zip(RK45.C[1:], RK45.A[1:], strict=True):
        stages.append(slope(t0 + c * h, y0 + h * row[: len(stages)] @ np.array(stages)))
    y1 = y0 + h * RK45.B @ np.array(stages)
    stages.append(slope(t0 + h, y1))
    apart = h * RK45.E @ np.array(stages)

    def rhs(t, x):
        a = acceleration(float(t[0]), np.array(x[0]).ravel())
        return (mi.Array3f64(*a.tolist()),), mi.Float64(0.0)

    x, v = (mi.Array3f64(*part.tolist()) for part in (y0[:3], y0[3:]))
    t = mi.Float64(t0)
    (x1, v1, *_), error, last = dopri5_with_error(rhs, t, (x,), (v,), h, rhs(t, (x,)))
    np.testing.assert_allclose(np.ravel([x1[0], v1[0]]), y1, rtol=1e-14)
    expected = [np.linalg.norm(apart[:3]), np.linalg.norm(apart[3:])]
    np.testing.assert_allclose(np.ravel(error), expected, rtol=1e-10)
    np.testing.assert_allclose(np.ravel(last[0]), stages[-1][3:], rtol=1e-14)


# ------------------------------------------------------------------------------------ convergence


def in_selfoc():
    paths = [
        oracles.parabolic(1.5, [0.0, 0.045, 0.045], r0, d)
        for r0, d in zip(STARTS, DIRECTIONS, strict=True)
    ]
    ends = [path.position(path.t_at_arc(40.0)) for path in paths]
    return selfoc(1.5, 0.03, box=BOX), 40.0, np.array(ends)


def in_luneburg():
    paths = [
        oracles.parabolic(np.sqrt(2.0), [1 / 20.0] * 3, r0, d)
        for r0, d in zip(STARTS, DIRECTIONS, strict=True)
    ]
    ends = [path.position(path.t_at_arc(25.0)) for path in paths]
    return luneburg(20.0, box=np.array([[-28.0] * 3, [28.0] * 3])), 25.0, np.array(ends)


def in_fish_eye():
    rays = zip(STARTS, DIRECTIONS, strict=True)
    ends = [oracles.fish_eye(1.8, 15.0, r0, d, 25.0)[0] for r0, d in rays]
    return fish_eye(1.8, 15.0, box=BOX), 25.0, np.array(ends)


@pytest.fixture(scope="module", params=[in_selfoc, in_luneburg, in_fish_eye])
def known(request):
    """Field, arc length and the known ends of the rays."""
    return request.param()


@pytest.mark.parametrize(("method", "coarsest", "order"), [("euler", 0.02, 1), ("dopri5", 1.2, 5)])
def test_the_error_falls_with_the_methods_order(known, method, coarsest, order):
    """With steps of one length: a tolerance that nothing exceeds takes the control away."""
    field, length, ends = known
    steps = coarsest / 2.0 ** np.arange(4)
    errors = []
    for step in steps:
        rays = trace(field, STARTS, DIRECTIONS, length, step, method, tolerance_mm=1e6)
        assert np.all(rays.status == RayStatus.ENDED)
        errors.append(np.linalg.norm(rays.position - ends))
    slope = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert slope == pytest.approx(order, abs=0.1 * order)


def test_the_error_follows_the_tolerance(known):
    """Over eight decades, and the estimate is an upper bound of each step's error."""
    field, length, ends = known
    tolerances = 10.0 ** -np.arange(2.0, 11.0)
    errors = []
    for tolerance in tolerances:
        rays = trace(field, STARTS, DIRECTIONS, length, 20.0, "dopri5", tolerance_mm=tolerance)
        errors.append(np.linalg.norm(rays.position - ends, axis=1).max())
    slope = np.polyfit(np.log(tolerances), np.log(errors), 1)[0]
    assert slope == pytest.approx(1.0, abs=0.2)
    assert np.all(errors < tolerances)


def test_rays_through_a_cubic_field_are_scipys():
    """DOP853 at 1e-12 through SciPy's spline; the knots are where such a field is least smooth."""
    field, index = random_air()
    line, ray = to_plane(field, March(10.0, "dopri5", tolerance_mm=1e-10), x_mm=15.0)
    reference = oracles.integrate(index, STARTS, DIRECTIONS, 35.0, rtol=1e-12)
    arcs = reference.arcs_to(lambda p: p[:, 0] - 15.0, 20.0, 35.0)
    expected = [reference.position(s)[i] for i, s in enumerate(arcs)]
    np.testing.assert_allclose(to_numpy(ray.position(line)), expected, rtol=0, atol=1e-8)


# --------------------------------------------------------------- what a controlled march must keep


def test_a_controlled_march_meets_the_surface():
    """Where the shortest fixed steps do, and with a status for the ray that passes by."""
    field = hot_spot(0.3, 8.0, box=BOX)
    cylinder = Cylinder(radius_mm=6.0, half_length_mm=30.0, axis_y_mm=1.0, axis_z_mm=-6.0)
    starts = np.array([[-15.0, -3.0, 9.0], [-10.0, 1.0, 12.0], [-15.0, 1.0, 9.0]])
    directions = unit([[1.0, 0.1, -0.8], [0.6, -0.1, -0.8], [1.0, 0.0, 0.5]])
    hits = []
    for march in (March(10.0, "dopri5", tolerance_mm=1e-9), March(0.05)):
        line, ray = to_plane(field, march, starts, directions, 55.0, cylinder)
        statuses = [RayStatus.HIT, RayStatus.HIT, RayStatus.ENDED]
        np.testing.assert_array_equal(np.array(ray.status), statuses)
        hits.append(to_numpy(ray.position(line)))
    np.testing.assert_allclose(*hits, rtol=0, atol=1e-6)


@pytest.mark.parametrize("first_order", [False, True])
def test_a_controlled_march_carries_derivatives(first_order):
    """Those of neighbouring rays, also in the first-order model."""
    field = hot_spot(0.3, 8.0, box=1.5 * BOX)
    march = March(5.0, "dopri5", first_order=first_order, tolerance_mm=1e-9)
    starts = STARTS - [60.0, 0.0, 0.0]
    for shift, turn in ((np.array([0.0, 0.6, -0.8]), 0.0), (0.0, np.array([0.3, 0.0, 1.0]))):
        x = np.zeros((3, 3)) + shift
        v = np.zeros((3, 3)) + turn
        v -= DIRECTIONS * np.sum(DIRECTIONS * v, axis=1)[:, None]
        line, ray = to_plane(
            field, march, starts, tangents=((to_vectors(x), to_vectors(v)),), x_mm=35.0
        )
        T, w = to_numpy(ray.tangent(line)), to_numpy(ray.offset[1])
        in_the_plane = w - T * (w[:, :1] / T[:, :1])
        ends = []
        for e in (1e-4, -1e-4):
            there = to_plane(field, march, starts + e * x, DIRECTIONS + e * v, 35.0)
            ends.append(to_numpy(there[1].position(there[0])))
        expected = (ends[0] - ends[1]) / 2e-4
        tolerance = 5e-6 * abs(expected).max()
        np.testing.assert_allclose(in_the_plane, expected, rtol=0, atol=tolerance)


def test_a_tolerance_that_can_not_be_met_ends_out_of_steps():
    """And does not hang."""
    field = luneburg(20.0, box=np.array([[-28.0] * 3, [28.0] * 3]))
    march = March(1.0, "dopri5", tolerance_mm=1e-18, max_steps=300)
    _, ray = to_plane(field, march)
    np.testing.assert_array_equal(np.array(ray.status), RayStatus.OUT_OF_STEPS)


def test_float32_follows_the_tolerance_too():
    """Down to a nanometre in air, as only the difference from the straight ray is carried."""
    rough = np.random.default_rng(7).normal(size=(9, 11, 8))
    field = IndexField.from_arrays(
        1e-4 * rough, [-14.0, -20.0, -14.0], [4.0, 4.0, 4.0], ambient=0.0
    )
    ends = {
        precision: to_numpy(
            to_plane(field, March(5.0, "dopri5", precision, tolerance_mm=1e-7))[1].offset[0]
        )
        for precision in ("single", "double")
    }
    miss = abs(ends["single"] - ends["double"]).max()
    assert abs(ends["double"]).max() > 1e-3
    assert miss < 2e-6


# ------------------------------------------------------------------------------------ first order


def test_first_order_is_the_deflection_integral():
    """SciPy's adaptive quadrature of (t_end - t) n grad n along straight rays."""
    field, index = random_air()
    march = March(0.05, "rk4", first_order=True)
    _, ray = to_plane(field, march, x_mm=15.0)
    for i, (start, d) in enumerate(zip(STARTS, DIRECTIONS, strict=True)):
        end = np.array(ray.t)[i] - start @ d

        def slope(t, start=start, d=d):
            n, gradient = index((start + t * d)[None])
            return n[0] * gradient[0]

        kick = quad_vec(lambda t, end=end, s=slope: (end - t) * s(t), 0.0, end, epsabs=1e-8)[0]
        expected = (index(start[None])[0][0] - 1.0) * d * end + kick
        np.testing.assert_allclose(to_numpy(ray.offset[0])[i], expected, rtol=0, atol=1e-7)
    exact = to_plane(field, March(0.05, "rk4"), x_mm=15.0)[1]
    assert abs(to_numpy(exact.offset[0]) - to_numpy(ray.offset[0])).max() > 1e-3


# ----------------------------------------------------------------------------------------- speed


@pytest.mark.parametrize("method", ["leapfrog", "dopri5"])
def test_other_numbers_compile_no_other_kernel(method):
    """Steps, tolerances and limits are swept; each kernel would cost a tenth of a second."""
    field = luneburg(20.0, box=np.array([[-28.0] * 3, [28.0] * 3]))

    def kernels(**numbers):
        with dr.scoped_set_flag(dr.JitFlag.KernelHistory, True):
            dr.kernel_history_clear()
            _, ray = to_plane(field, March(method=method, **numbers))
            dr.eval(ray)
            history = dr.kernel_history()
        return [k["hash"] for k in history if k["type"] == dr.KernelType.JIT]

    first = kernels(step_mm=1.0)
    assert kernels(step_mm=0.7, tolerance_mm=1e-5, max_steps=900) == first != []
