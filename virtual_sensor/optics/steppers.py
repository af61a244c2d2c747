"""One step of x'' = a(t, x): the choices of integrator.

A stepper takes ``rhs(t, x) -> (a, f)``, where x and a are tuples of vectors (the ray, and any
derivatives that travel with it) and f is n - 1 at the ray, relative to the surroundings.  It
returns the new x and v = x', and the step's arc excess, integral of (n - 1) dt, and path excess,
integral of (n^2 - 1) dt.
"""

from collections.abc import Callable
from typing import Any

Vectors = tuple[Any, ...]
Rhs = Callable[[Any, Vectors], tuple[Vectors, Any]]
Step = tuple[Vectors, Vectors, Any, Any]


def _plus(x: Vectors, *terms: tuple[Any, Vectors]) -> Vectors:
    """X + c1 w1 + c2 w2 + ..., vector by vector."""
    return tuple(sum((c * w[i] for c, w in terms), start=xi) for i, xi in enumerate(x))


def _excess(h: Any, *terms: tuple[float, Any]) -> tuple[Any, Any]:
    """Arc and path excess by a quadrature of weights and values of n - 1."""
    arc = sum(w * f for w, f in terms)
    path = sum(w * (2.0 + f) * f for w, f in terms)
    return h * arc, h * path


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


STEPPERS: dict[str, Callable[[Rhs, Any, Vectors, Vectors, Any], Step]] = {
    "rk4": rk4,
    "sharma": sharma,
    "leapfrog": leapfrog,
}
"""Steppers by name."""
