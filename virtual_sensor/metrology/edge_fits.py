"""The fit of a line over an edge of the reflectance, many columns at once.

A laser line of Gaussian profile that falls on two reflectances is G(v - row) times a step. A lens
that blurs both leaves the form: G times 1 + (ratio - 1) Phi((v - edge)/blur), a skew-normal profile
with an offset (Azzalini 1985, Scandinavian Journal of Statistics 12, 171).  One profile says little
of all its parameters at once; columns beside each other share the ratio and the blur, their width
hardly changes, and the edge goes on straight or nearly so.  That is a Gaussian Markov random field
(Rue and Held 2005), whose normal equations are banded: Gauss-Newton with the damping of Marquardt
1963.  Nothing is assumed of the line's own course: each row is of its own column's pixels.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.linalg import cho_solve_banded, cholesky_banded
from scipy.special import ndtr

from virtual_sensor.metrology.line_profiles import Array, Index

OWN = 5  # parameters of each column: level, log height, row, log width, edge
LEVEL, HEIGHT, ROW, WIDTH, EDGE = range(OWN)
RATIO, BLUR = range(2)  # logarithms that all columns share

_ALIKE = 0.002  # change of the log width from column to column
_STRAIGHT_PX = 0.3  # change of the edge's slope from column to column, at first
_EVEN = 0.05  # change of the log height from column to column, at first
_LEAST_BLUR_PX = 0.15
_BLUR_SPREAD = 0.7  # of the log blur about what is usual
_USUAL_BLUR = 0.2  # of the line's width
MOST_STEPS = 40
_GONE_RATIO, _GONE_BLUR = np.log(60.0), 1.2  # log, and widths: beyond, it is no edge that is fitted
_TOLERANCE = 1e-2
_NODES, _WEIGHTS = np.polynomial.legendre.leggauss(4)  # in each pixel
_BAND = 2 * OWN + 1


class Window(NamedTuple):
    """Pixels near a line in L adjoining columns: (n, L) each; `use` is 0 where they don't count."""

    rows: Index
    values: Array
    use: NDArray[np.bool_]


class Smooth(NamedTuple):
    """What changes from column to column: the edge's slope in px, log height and log width."""

    straight_px: float = _STRAIGHT_PX
    even: float = _EVEN
    alike: float = _ALIKE

    def over(self, step: float) -> "Smooth":
        """Of columns that are so far apart: of the slope, it is the integral that changes."""
        wider = np.sqrt(step)
        return Smooth(self.straight_px * step * wider, self.even * wider, self.alike * wider)


_AT_FIRST = Smooth()


class EdgeFit(NamedTuple):
    """A fitted edge: each column's parameters (5, L), the shared ones (2,), and what is left.

    `row_error` (L,) is the standard deviation of the rows, `ratio_error` that of the log ratio;
    `signal`, `residual` and `variance` are (n, L), `cost` the weighted squares' sum with the prior.
    """

    own: Array
    shared: Array
    row_error: Array
    ratio_error: float
    signal: Array
    residual: Array
    variance: Array
    cost: float


def modelled(rows: Index, own: Array, shared: Array) -> tuple[Array, Array, Array]:
    """Signal (n, L) above the level, and its derivatives by own and shared parameters.

    They are (5, n, L), and (2, n, L).
    """
    _, height, row, log_width, edge = own
    ratio, blur = shared
    width, blur = np.exp(log_width), np.hypot(np.exp(blur), _LEAST_BLUR_PX)
    fine = rows[:, None, :] + 0.5 * _NODES[:, None]
    z, x = (fine - row) / width, (fine - edge) / blur
    gaussian = np.exp(height - 0.5 * z**2) * (0.5 * _WEIGHTS[:, None])
    below = ndtr(x)
    dark, bright = np.exp(-0.5 * ratio), np.exp(0.5 * ratio)
    reflected = dark + (bright - dark) * below
    signal = gaussian * reflected
    stepping = gaussian * (bright - dark) * np.exp(-0.5 * x**2) / np.sqrt(2.0 * np.pi)
    total = signal.sum(axis=1)
    by_own = np.stack(
        [
            np.ones_like(total),
            total,
            (signal * z).sum(axis=1) / width,
            (signal * z**2).sum(axis=1),
            -stepping.sum(axis=1) / blur,
        ]
    )
    by_ratio = (gaussian * (0.5 * (bright + dark) * below - 0.5 * dark)).sum(axis=1)
    own_share = 1.0 - (_LEAST_BLUR_PX / blur) ** 2
    by_blur = -(stepping * x).sum(axis=1) * own_share
    return total, by_own, np.stack([by_ratio, by_blur])


def fit_edge(
    window: Window,
    own: Array,
    shared: Array,
    variance: Array,
    smooth: Smooth = _AT_FIRST,
    most_steps: int = MOST_STEPS,
) -> EdgeFit:
    """Fit from a first guess of the parameters, with a variance (n, L) of each pixel.

    It ends early where it runs away from all that is an edge.
    """
    weight = window.use / variance
    usual = np.log(_USUAL_BLUR) + np.median(own[WIDTH])
    prior = _prior(own.shape[1], smooth)
    penalty = np.array([1.0, 1.0 / _BLUR_SPREAD**2])
    expected = np.array([shared[RATIO], usual])
    damping, state = 1e-3, (own, shared)

    def cost_of(own: Array, shared: Array) -> tuple[float, Array, tuple[Array, Array, Array]]:
        parts = modelled(window.rows, own, shared)
        residual = window.values - own[LEVEL] - parts[0]
        away = shared - expected
        cost = np.sum(weight * residual**2) + _walked(own, smooth) + penalty @ away**2
        return float(cost), residual, parts

    cost, residual, parts = cost_of(*state)
    for _ in range(most_steps):
        normal, border, corner = _normal(weight, parts)
        normal += prior
        gradient, shared_gradient = _gradients(weight, parts, residual)
        gradient -= _times(prior, state[0])
        shared_gradient -= penalty * (state[1] - expected)
        corner = corner + np.diag(penalty)
        better = False
        for _ in range(8):
            try:
                step, shared_step = _step(
                    normal, border, corner, gradient, shared_gradient, damping
                )
            except np.linalg.LinAlgError:  # rounding has made it indefinite
                damping *= 10.0
                continue
            moved = state[0] + _limited(step, state[0]), state[1] + np.clip(shared_step, -0.5, 0.5)
            trial = cost_of(*moved)
            if trial[0] < cost:
                better = True
                break
            damping *= 10.0
        if not better:
            break
        gained = cost - trial[0]
        state, (cost, residual, parts) = moved, trial
        damping = max(damping * 0.2, 1e-9)
        if gained < _TOLERANCE * (1.0 + 1e-3 * cost) or _is_gone(*state):
            break
    normal, border, corner = _normal(weight, parts)
    try:
        found = _variances(normal + prior, border, corner + np.diag(penalty))
    except np.linalg.LinAlgError:  # nothing is known of it: no edge
        found = np.full(own.shape[1], np.inf), np.inf
    rows_variance, ratio_variance = (np.where(each > 0.0, each, np.inf) for each in found)
    return EdgeFit(
        *state,
        np.sqrt(rows_variance),
        float(np.sqrt(ratio_variance)),
        parts[0],
        residual,
        variance,
        cost,
    )


def _is_gone(own: Array, shared: Array) -> bool:
    gone = np.abs(shared[RATIO]) > _GONE_RATIO
    return bool(gone or np.exp(shared[BLUR]) > _GONE_BLUR * np.exp(np.median(own[WIDTH])))


def _limited(step: Array, own: Array) -> Array:
    width = np.exp(own[WIDTH])
    most = np.stack([np.full_like(width, np.inf), 0 * width + 1.0, width, 0 * width + 0.3, width])
    return np.clip(step, -most, most)


def _prior(count: int, smooth: Smooth) -> Array:
    """The penalty on changes of the width, and of the edge's slope, as an upper band matrix."""
    band = np.zeros((_BAND, count, OWN))  # [k, u]: of parameters of column u and earlier ones
    loose = np.array([1e-12, 1e-4, 1e-6, 1e-4, 1e-8])
    band[-1] += loose
    for which, change in ((WIDTH, smooth.alike), (HEIGHT, smooth.even)):
        band[-1, 1:, which] += change**-2
        band[-1, :-1, which] += change**-2
        band[-1 - OWN, 1:, which] -= change**-2
    bend = smooth.straight_px**-2
    for offset, coefficient in enumerate((1.0, -2.0, 1.0)):
        for other, second in enumerate((1.0, -2.0, 1.0)[: offset + 1]):
            away = offset - other
            band[-1 - OWN * away, offset : count - 2 + offset, EDGE] += coefficient * second * bend
    return band.reshape(_BAND, -1)


def _walked(own: Array, smooth: Smooth) -> float:
    changes = (
        np.diff(own[WIDTH]) / smooth.alike,
        np.diff(own[HEIGHT]) / smooth.even,
        np.diff(own[EDGE], 2) / smooth.straight_px,
    )
    return float(sum(np.sum(each**2) for each in changes))


def _times(band: Array, own: Array) -> Array:
    """The prior's matrix times the parameters: without its loose part, which has no centre."""
    flat = np.ascontiguousarray(own.T).ravel()
    flat = flat.copy()
    product = np.zeros_like(flat)
    for above in range(_BAND):
        row = band[_BAND - 1 - above]
        if above == 0:
            product += row * flat
        else:
            product[above:] += row[above:] * flat[:-above]
            product[:-above] += row[above:] * flat[above:]
    loose = np.tile(np.array([1e-12, 1e-4, 1e-6, 1e-4, 1e-8]), own.shape[1])
    return (product - loose * flat).reshape(-1, OWN).T


def _normal(weight: Array, parts: tuple[Array, Array, Array]) -> tuple[Array, Array, Array]:
    _, by_own, by_shared = parts
    weighted = weight * by_own
    blocks = np.einsum("inl,jnl->lij", weighted, by_own)
    band = np.zeros((_BAND, blocks.shape[0], OWN))
    for i in range(OWN):
        for j in range(i, OWN):
            band[_BAND - 1 - (j - i), :, j] = blocks[:, i, j]
    border = np.einsum("inl,jnl->lij", weighted, by_shared).reshape(-1, 2)
    corner = np.einsum("inl,jnl->ij", weight * by_shared, by_shared)
    return band.reshape(_BAND, -1), border, corner


def _gradients(
    weight: Array, parts: tuple[Array, Array, Array], residual: Array
) -> tuple[Array, Array]:
    weighted = weight * residual
    return (
        np.einsum("inl,nl->il", parts[1], weighted),
        np.einsum("jnl,nl->j", parts[2], weighted),
    )


def _step(
    band: Array, border: Array, corner: Array, gradient: Array, shared: Array, damping: float
) -> tuple[Array, Array]:
    damped = band.copy()
    damped[-1] *= 1.0 + damping
    factor = cholesky_banded(damped, check_finite=False)
    right = np.column_stack([gradient.T.ravel(), border])
    solved = cho_solve_banded((factor, False), right, check_finite=False)
    schur = corner * (1.0 + damping * np.eye(2)) - border.T @ solved[:, 1:]
    of_shared = np.linalg.solve(schur, shared - border.T @ solved[:, 0])
    own = solved[:, 0] - solved[:, 1:] @ of_shared
    return own.reshape(-1, OWN).T, of_shared


def _variances(band: Array, border: Array, corner: Array) -> tuple[Array, float]:
    """Of the rows (L,), and of the log ratio: the diagonal of the inverse (Takahashi's recursion).

    Two columns are one block, so that only adjoining blocks are coupled.
    """
    count = band.shape[1] // OWN
    factor = cholesky_banded(band, check_finite=False)
    solved = cho_solve_banded((factor, False), border, check_finite=False)
    shared = np.linalg.inv(corner - border.T @ solved)
    size = 2 * OWN
    blocks = -(-count // 2)
    padded = np.zeros((_BAND, blocks * size))
    padded[-1] = 1.0
    padded[:, : band.shape[1]] = band
    within, coupled = np.zeros((2, blocks, size, size))
    places = padded.reshape(_BAND, blocks, size)
    for i in range(size):
        for j in range(i, size):
            if j - i < _BAND:
                within[:, i, j] = within[:, j, i] = places[_BAND - 1 - (j - i), :, j]
        for j in range(size):
            away = size + j - i
            if away < _BAND:
                coupled[1:, i, j] = places[_BAND - 1 - away, 1:, j]
    inverse = np.empty_like(within)
    inverse[0] = np.linalg.inv(within[0])
    gain = np.empty_like(within)
    for k in range(1, blocks):
        gain[k] = inverse[k - 1] @ coupled[k]
        inverse[k] = np.linalg.inv(within[k] - coupled[k].T @ gain[k])
    found = inverse[-1]
    diagonal = np.empty((blocks, size))
    diagonal[-1] = np.diag(found)
    for k in range(blocks - 2, -1, -1):
        found = inverse[k] + gain[k + 1] @ found @ gain[k + 1].T
        diagonal[k] = np.diag(found)
    own = diagonal.reshape(-1, OWN)[:count, ROW]
    at_rows = solved[ROW::OWN]
    return own + np.einsum("li,ij,lj->l", at_rows, shared, at_rows), float(shared[RATIO, RATIO])
