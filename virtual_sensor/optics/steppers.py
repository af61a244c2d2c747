"""One step of x'' = a(t, x): the choices of integrator, and those that control their step.

A stepper takes ``rhs(t, x) -> (a, f)``, where x and a are tuples of vectors (the ray, and any
derivatives that travel with it) and f is n - 1 at the ray, relative to the surroundings.  It
returns the new x and v = x', and the step's arc excess, integral of (n - 1) dt, and path excess,
integral of (n^2 - 1) dt.
"""

from collections.abc import Callable, Sequence
from typing import Any

from virtual_sensor.engine import dr

Vectors = tuple[Any, ...]
Rhs = Callable[[Any, Vectors], tuple[Vectors, Any]]
Step = tuple[Vectors, Vectors, Any, Any]
Slope = tuple[Vectors, Any]
"""What rhs gives."""


def _plus(x: Vectors, *terms: tuple[Any, Vectors]) -> Vectors:
    """X + c1 w1 + c2 w2 + ..., vector by vector."""
    return tuple(sum((c * w[i] for c, w in terms), start=xi) for i, xi in enumerate(x))


def _excess(h: Any, *terms: tuple[float, Any]) -> tuple[Any, Any]:
    """Arc and path excess by a quadrature of weights and values of n - 1."""
    arc = sum(w * f for w, f in terms)
    path = sum(w * (2.0 + f) * f for w, f in terms)
    return h * arc, h * path


def euler(rhs: Rhs, t: Any, x: Vectors, v: Vectors, h: Any) -> Step:
    """Explicit Euler method: order 1, one evaluation."""
    k, f = rhs(t, x)
    return _plus(x, (h, v)), _plus(v, (h, k)), *_excess(h, (1.0, f))


def rk4(rhs: Rhs, t: Any, x: Vectors, v: Vectors, h: Any) -> Step:
    """Classical Runge-Kutta method: order 4, four evaluations."""
    k1, f1 = rhs(t, x)
    k2, f2 = rhs(t + h / 2, _plus(x, (h / 2, v)))
    k3, f3 = rhs(t + h / 2, _plus(x, (h / 2, v), (h * h / 4, k1)))
    k4, f4 = rhs(t + h, _plus(x, (h, v), (h * h / 2, k2)))
    x = _plus(x, (h, v), (h * h / 6, k1), (h * h / 6, k2), (h * h / 6, k3))
    v = _plus(v, (h / 6, k1), (h / 3, k2), (h / 3, k3), (h / 6, k4))
    return x, v, *_excess(h, (1 / 6, f1), (1 / 3, f2), (1 / 3, f3), (1 / 6, f4))


def sharma(rhs: Rhs, t: Any, x: Vectors, v: Vectors, h: Any) -> Step:
    """Runge-Kutta-Nystrom method of Sharma, Kumar and Ghatak 1982: order 4, three evaluations.

    Appl. Opt. 21, 984: it uses that a does not depend on v.
    """
    k1, f1 = rhs(t, x)
    k2, f2 = rhs(t + h / 2, _plus(x, (h / 2, v), (h * h / 8, k1)))
    k3, f3 = rhs(t + h, _plus(x, (h, v), (h * h / 2, k2)))
    x = _plus(x, (h, v), (h * h / 6, k1), (h * h / 3, k2))
    v = _plus(v, (h / 6, k1), (2 * h / 3, k2), (h / 6, k3))
    return x, v, *_excess(h, (1 / 6, f1), (2 / 3, f2), (1 / 6, f3))


def leapfrog(rhs: Rhs, t: Any, x: Vectors, v: Vectors, h: Any) -> Step:
    """Drift-kick-drift leapfrog: order 2, one evaluation, symplectic and time-reversible.

    Hairer, Lubich and Wanner 2003, Acta Numerica 12, 399.
    """
    x = _plus(x, (h / 2, v))
    k, f = rhs(t + h / 2, x)
    v = _plus(v, (h, k))
    return _plus(x, (h / 2, v)), v, *_excess(h, (1.0, f))


# Dormand and Prince 1980, J. Comput. Appl. Math. 6, 19: stages, and the fourth-order weights.  The
# last stage is the step itself.
DOPRI5_STAGES = (
    (),
    (1 / 5,),
    (3 / 40, 9 / 40),
    (44 / 45, -56 / 15, 32 / 9),
    (19372 / 6561, -25360 / 2187, 64448 / 6561, -212 / 729),
    (9017 / 3168, -355 / 33, 46732 / 5247, 49 / 176, -5103 / 18656),
    (35 / 384, 0.0, 500 / 1113, 125 / 192, -2187 / 6784, 11 / 84),
)
DOPRI5_LOWER = (5179 / 57600, 0.0, 7571 / 16695, 393 / 640, -92097 / 339200, 187 / 2100, 1 / 40)


def _twice(weights: Sequence[float]) -> list[float]:
    """Weights of a for x that go with weights for v: those of Nystrom's form of the tableau."""
    rows = list(zip(weights, DOPRI5_STAGES, strict=False))
    return [sum(w * row[j] for w, row in rows if j < len(row)) for j in range(len(weights))]


_DOPRI5_ERROR = [
    b - lower for b, lower in zip((*DOPRI5_STAGES[-1], 0.0), DOPRI5_LOWER, strict=True)
]


def dopri5_with_error(
    rhs: Rhs, t: Any, x: Vectors, v: Vectors, h: Any, first: Slope
) -> tuple[Step, tuple[Any, Any], Slope]:
    """Dormand and Prince's method of order 5 with its embedded one of order 4.

    Parameters
    ----------
    first : tuple
        ``rhs(t, x)``, the last slope of the step before.

    Returns
    -------
    step : tuple
        That of order 5.
    error : tuple of two scalars
        How much the two orders differ in x, mm, and in v; of the ray alone.
    last : tuple
        ``rhs(t + h, x)`` at the step's end.
    """
    slopes = [first]
    for row in DOPRI5_STAGES[1:]:
        used = [(c, k) for c, (k, _) in zip(_twice(row), slopes, strict=True) if c]
        at = _plus(x, (h * sum(row), v), *((h * h * c, k) for c, k in used))
        slopes.append(rhs(t + h * sum(row), at))
    ks = [k for k, _ in slopes]
    weights = DOPRI5_STAGES[-1]
    v = _plus(v, *((h * b, k) for b, k in zip(weights, ks[:-1], strict=True) if b))
    excess = _excess(h, *((b, f) for b, (_, f) in zip(weights, slopes[:-1], strict=True) if b))
    apart = sum(c * k[0] for c, k in zip(_twice(_DOPRI5_ERROR), ks, strict=True) if c)
    turned = sum(c * k[0] for c, k in zip(_DOPRI5_ERROR, ks, strict=True) if c)
    error = h * h * dr.norm(apart), dr.abs(h) * dr.norm(turned)
    return (at, v, *excess), error, slopes[-1]


def dopri5(rhs: Rhs, t: Any, x: Vectors, v: Vectors, h: Any) -> Step:
    """One step of `dopri5_with_error`, as it comes."""
    return dopri5_with_error(rhs, t, x, v, h, rhs(t, x))[0]


STEPPERS: dict[str, Callable[[Rhs, Any, Vectors, Vectors, Any], Step]] = {
    "euler": euler,
    "rk4": rk4,
    "sharma": sharma,
    "leapfrog": leapfrog,
    "dopri5": dopri5,
}
"""Steppers by name."""

CONTROLLED = {"dopri5": dopri5_with_error}
"""Those that estimate their error, on which the march chooses the next step."""
