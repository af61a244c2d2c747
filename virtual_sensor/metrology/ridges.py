"""Steger's detector: lines of any direction as ridges of the smoothed image.

After Steger 1998, "An unbiased detector of curvilinear structures", IEEE PAMI 20, 113.  The image
is smoothed by a Gaussian of `scale`; n is the normal along which its second derivative is most
negative.  Where its first derivative along n vanishes within the pixel, there is a point of a line.
Steger takes the zero from a Taylor polynomial, which errs by x^3/s^2 at x from the pixel's centre;
here the filters are centred on the point found, again and again, until it vanishes there.

What shifts that zero is taken off:

- A Gaussian line on two levels that differ by h, with the step under the line: h is read beside the
  line, and h/(sqrt(2 pi) scale) taken off the derivative.  It is Steger's bias correction, for a
  Gaussian line in place of a bar.
- A line that curves with radius R: smoothing draws it inwards by scale^2/(2 R), as heat from
  a ring spreads.  R comes from the points beside it; where they are too few, near a line's ends,
  this stays.

Smoothing draws an end that is cut obliquely aside, by more than its width: points within 3 scales
of where a line ends are LINE_END, and so are short fragments as a whole.
"""

from typing import NamedTuple

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray
from scipy.spatial import KDTree

from virtual_sensor.metrology.centres import LineCentres, Status, is_found, is_measured
from virtual_sensor.metrology.line_ends import among_cuts
from virtual_sensor.metrology.line_profiles import (
    MIN_SIGMA_PX,
    SIGNIFICANCE,
    Array,
    Index,
    Noise,
)
from virtual_sensor.metrology.ridge_profiles import across, along_lines
from virtual_sensor.metrology.scatter import with_scatter_of_ridge

FIRST_SCALE_PX = 1.5  # at which lines are sought, and their widths
LEAST_SCALE_PX, MOST_SCALE_PX = 1.0, 8.0
BEST_SCALE = 1.3  # times the line's width
_REACH = 4.0  # of the filters, in scales
_BESIDE = 3.0  # smoothed widths from the centre at which the level beside a line is read
_SEEN = 4.0  # times the noise of the levels beside a line: from there on they differ
_TAIL = float(np.exp(-(_BESIDE**2) / 2.0))  # what is left of the line there
_OWN_PIXEL = 0.6  # px from a pixel's centre within which it owns a point, before the steps
_STEPS = 4
_CONVERGED_PX = 0.02
_MAX_NOISE = 0.25  # of the second derivative, relative: beyond it there is no line
_BEND_REACH = 6.0  # scales from a point within which others show the line's curvature
# Taking the curvature off adds its noise: that of points which share theirs by exp(-x^2/(4 s^2)).
_UNBENT_NOISE = float(
    np.sqrt(1.0 + np.sqrt(np.pi) * (7.5 / _BEND_REACH**3 + 11.25 / _BEND_REACH**5))
)
_FEWEST = 8  # of them
_END = 3.0  # scales from a point within which its line must go on, on both sides
_SAME_DIRECTION = 0.9  # cosine between the normals of points of one line
_CHUNK = 1 << 22  # pixels of windows at a time
_LINE_LIKE = 0.5  # second derivative along the line, relative to that across: below it


class _Local(NamedTuple):
    """Derivatives of the smoothed image at N points: r[:, i, j] of order i in v and j in u."""

    r: Array
    pixels: NDArray[np.float32]  # windows (N, m, m)
    along_u: Array  # kernels (N, m, 3), of order 0 to 2
    along_v: Array


def ridges(
    image: NDArray,
    noise: Noise,
    min_amplitude: float,
    saturation: float,
    max_sigma: float,
    scale: float | None = None,
) -> LineCentres:
    """Find the points of bright lines of any direction.

    Parameters
    ----------
    image : ndarray of shape (H, W)
        Grey values.
    noise : Noise
    min_amplitude : float
        Smallest height of a line, relative to the highest in the image.
    saturation : float
        Grey value from which on pixels are clipped.
    max_sigma : float
        Broadest line in px.
    scale : float, optional
        Standard deviation in px of the smoothing; by default 1.3 times the lines' median width,
        at which noise shifts them least.

    Returns
    -------
    LineCentres
        N points by rising u: one for each pixel that a line's crest goes through.
    """
    finite = np.isfinite(image)
    grey = image if image.dtype.kind == "f" else image.astype(np.float32)
    if not finite.all():
        grey = np.where(finite, grey, grey[finite].min(initial=0.0))
    # The filters are linear: single precision never sees large offsets and odd units.
    offset = float(np.median(grey[:: max(1, len(grey) // 64)]))
    unit = float(grey.max()) / 2.0 - float(grey.min()) / 2.0
    if not 0.0 < unit < np.inf:
        return _points(np.empty((0, 2)), np.empty((6, 0)), np.empty(0, int))
    grey = ((grey - offset) / unit).astype(np.float32)
    dark = Noise(noise.dark / unit, noise.gain / unit, noise.known)
    if scale is None:
        width = _lines(grey, dark, min_amplitude, FIRST_SCALE_PX)[1][2]
        typical = float(np.median(width)) if width.size else FIRST_SCALE_PX
        scale = float(np.clip(BEST_SCALE * typical, LEAST_SCALE_PX, MOST_SCALE_PX))
    pixel, found = _lines(grey, dark, min_amplitude, scale)
    pixel, unbent, ends = _unbent(pixel, found[5], scale, image.shape)
    found[1] *= np.where(unbent, _UNBENT_NOISE, 1.0)
    clipped = ~(image < saturation) & finite
    status = _judged(pixel, found, scale, max_sigma, finite, clipped, ends)
    good = np.flatnonzero(is_found(status))
    if good.size:
        good = good[along_lines(pixel[good], image.shape)]
        found[1, good] = with_scatter_of_ridge(found[1, good], found[2, good], noise.known)
        status[good] = across(grey, pixel[good], found[:, good], dark, max_sigma)
        status[good[among_cuts(status[None, good], found[None, 2, good])[0]]] = Status.CUT
    found[3:5] *= unit
    found[4] += offset
    return _points(pixel, found, status)


def _points(pixel: Array, found: Array, status: Index) -> LineCentres:
    order = np.lexsort((pixel[:, 1], pixel[:, 0]))
    pixel, found, status = pixel[order], found[:, order], status[order]
    good = is_measured(status)
    _, sigma, width, amplitude, background = np.where(good, found[:5], np.nan)
    u, v = np.where(good, pixel.T, np.rint(pixel.T))
    v = np.where(good, v, np.nan)
    return LineCentres(u, v, sigma, width, amplitude, background, found[5], status.astype(np.uint8))


def _lines(
    grey: NDArray[np.float32], noise: Noise, min_amplitude: float, scale: float
) -> tuple[Array, Array]:
    """Points (N, 2); and last step, sigma, width, amplitude, background, normal: (6, N)."""
    half = _half(scale)
    padded = np.pad(grey, half, mode="edge")
    candidates = _candidates(grey, noise, min_amplitude, scale)
    each = max(_CHUNK // (2 * half + 1) ** 2, 1)
    parts = [
        _refined(padded, candidates[first : first + each], noise, scale)
        for first in range(0, len(candidates), each)
    ]
    pixel = np.concatenate([np.empty((0, 2)), *(part[0] for part in parts)])
    found = np.concatenate([np.empty((6, 0)), *(part[1] for part in parts)], axis=1)
    # Two pixels may come to the same point: it is of the pixel that it lies in.
    u, v = np.rint(pixel).astype(int).T
    inside = (u >= 0) & (v >= 0) & (u < grey.shape[1]) & (v < grey.shape[0])
    _, first = np.unique(np.where(inside, v * grey.shape[1] + u, -1), return_index=True)
    first = first[inside[first]]
    strong = found[3, first] > min_amplitude * found[3, first].max(initial=0.0)
    return pixel[first[strong]], found[:, first[strong]]


def _half(scale: float) -> int:
    """Rows and columns of the filters on either side of their middle."""
    return int(np.ceil(_REACH * scale))


def _margin(pixel: Array, shape: tuple[int, ...]) -> Array:
    """How far points are from the nearest border, px."""
    return np.minimum(pixel, np.array(shape[::-1]) - 1.0 - pixel).min(axis=1, initial=np.inf)


def _unbent(
    pixel: Array, normal_deg: Array, scale: float, shape: tuple[int, ...]
) -> tuple[Array, NDArray[np.bool_], NDArray[np.bool_]]:
    """The points, with what smoothing does to a curved line taken off; where it was; line ends."""
    count = int(2.0 * np.sqrt(2.0) * _BEND_REACH * scale)  # of an oblique line's, 0.7 px apart
    count = min(count, len(pixel))
    if count < _FEWEST:
        return pixel, np.zeros(len(pixel), bool), np.ones(len(pixel), bool)
    distance, near = KDTree(pixel).query(pixel, count, workers=-1)
    angle = np.radians(normal_deg)
    normal = np.stack([np.cos(angle), np.sin(angle)], axis=1)
    offset = pixel[near] - pixel[:, None]
    x = offset[:, :, 0] * normal[:, None, 1] - offset[:, :, 1] * normal[:, None, 0]
    y = np.einsum("nkd,nd->nk", offset, normal)
    alike = np.abs(np.einsum("nkd,nd->nk", normal[near], normal)) > _SAME_DIRECTION
    alike &= (distance < _BEND_REACH * scale) & (np.abs(y) < scale)
    before, behind = (np.max(sign * x, axis=1, where=alike, initial=0.0) for sign in (-1.0, 1.0))
    ends = np.minimum(before, behind) < _END * scale
    weight = (alike & (_margin(pixel, shape) >= _REACH * scale)[near]).astype(float)
    # y = c_0 + c_1 x + c_2 x^2 by least squares, with x in reaches; the curvature is 2 c_2.
    basis = (x / (_BEND_REACH * scale))[:, :, None] ** np.arange(3)
    matrix = np.einsum("nki,nk,nkj->nij", basis, weight, basis) + 1e-9 * np.eye(3)
    c = np.linalg.solve(matrix, np.einsum("nki,nk,nk->ni", basis, weight, y)[:, :, None])[:, 2, 0]
    enough = (weight.sum(axis=1) >= _FEWEST) & (
        np.ptp(x * weight, axis=1) > 0.7 * _BEND_REACH * scale
    )
    curvature = np.where(enough, 2.0 * c / (_BEND_REACH * scale) ** 2, 0.0)
    return pixel - (curvature * (scale**2 + 1.0 / 12.0) / 2.0)[:, None] * normal, enough, ends


def _candidates(
    grey: NDArray[np.float32], noise: Noise, min_amplitude: float, scale: float
) -> Index:
    """Pixels (u, v), (N, 2), at which the smoothed image is curved more than by noise."""
    flat, _, curved = _kernels(np.zeros(1), np.zeros(1, int), scale)[0].T.astype(np.float32)
    bend = cv2.sepFilter2D(grey, cv2.CV_32F, curved, flat, borderType=cv2.BORDER_REPLICATE)
    bend += cv2.sepFilter2D(grey, cv2.CV_32F, flat, curved, borderType=cv2.BORDER_REPLICATE)
    both = np.outer(flat, curved) + np.outer(curved, flat)
    rounding = 64.0 * float(np.finfo(np.float32).eps) * float(np.abs(both).sum())
    highest = float(np.max(-bend, initial=0.0))
    least: Array = SIGNIFICANCE * noise.dark * float(np.linalg.norm(both))
    least = np.maximum(least, float(max(min_amplitude * highest, rounding)))
    v, u = np.nonzero(-bend > least)
    return np.stack([u, v], axis=1)


def _refined(
    padded: NDArray[np.float32], candidates: Index, noise: Noise, scale: float
) -> tuple[Array, Array]:
    """The points of lines near some pixels, and what `_lines` says of them."""
    pixel = candidates.astype(float)
    local = _filtered(padded, pixel, scale)
    normal, across, along = _normals(local.r)
    step = _first(local.r, normal) / np.where(across < 0.0, -across, np.nan)
    with np.errstate(invalid="ignore"):
        owned = np.abs(step[:, None] * normal).max(axis=1) <= _OWN_PIXEL
        owned &= (across < 0.0) & (np.abs(along) < _LINE_LIKE * np.abs(across))
    # Beside a curved line the crest's own tangent is a normal; but the image climbs across it.
    tangent = np.stack([-normal[:, 1], normal[:, 0]], axis=1)
    owned &= np.abs(_first(local.r, tangent)) < scale * np.abs(across)
    pixel, normal, local = pixel[owned], normal[owned], _Local(*(part[owned] for part in local))
    column = candidates[owned, 0]
    dark = noise.dark[column]

    start, width = pixel, np.full(len(pixel), 1.5 * scale)
    for number in range(_STEPS):
        curved = _curved(local.r, normal)
        levels, width = _beside(padded, pixel, normal, local.r, curved, width, scale)
        h = levels[1] - levels[0]
        h = np.where(np.abs(h) > _SEEN * dark / (np.sqrt(2.0 * np.pi) * scale), h, 0.0)
        slope = _first(local.r, normal) - h / (np.sqrt(2.0 * np.pi) * np.hypot(scale, 12**-0.5))
        step = slope / curved
        pixel = pixel + np.clip(np.nan_to_num(step), -1.0, 1.0)[:, None] * normal
        if number < _STEPS - 1:
            local = _filtered(padded, pixel, scale)

    background = levels.mean(axis=0)
    height = local.r[:, 0, 0] - background
    line = np.sqrt(np.maximum(width**2 - scale**2 - 1.0 / 12.0, 0.01))
    sigma, doubt = _noise_passed_on(local, normal, curved, background, noise, column)
    # Each level has the noise dark/(2 sqrt(pi) scale), and so h has its own in the slope.
    of_h = np.where(h != 0.0, dark / (2.0 * np.pi * scale**2), 0.0)
    sigma = np.hypot(sigma, of_h / curved)
    sound = (doubt < _MAX_NOISE) & (np.linalg.norm(pixel - start, axis=1) < np.maximum(scale, 1.0))
    angle = np.degrees(np.arctan2(normal[:, 1], normal[:, 0])) % 180.0
    found = np.stack([step, sigma, line, height * width / line, background, angle])
    return pixel[sound], found[:, sound]


def _filtered(padded: NDArray[np.float32], pixel: Array, scale: float) -> _Local:
    """Derivatives up to the second at points (N, 2), by filters that are centred on them."""
    half = _half(scale)
    size = np.array(padded.shape[::-1]) - 2 * half
    nearest = np.clip(np.rint(pixel).astype(int), 0, size - 1)
    windows = sliding_window_view(padded, (2 * half + 1, 2 * half + 1))
    pixels = windows[nearest[:, 1], nearest[:, 0]]
    along_u, along_v = (_kernels(pixel[:, k], nearest[:, k], scale) for k in (0, 1))
    r = np.matmul(along_v.transpose(0, 2, 1), np.matmul(pixels, along_u))
    return _Local(r, pixels, along_u, along_v)


def _kernels(place: Array, nearest: Index, scale: float) -> Array:
    """Gaussian and its first two derivatives at pixels about places (N,): shape (N, m, 3)."""
    half = _half(scale)
    x = (place - nearest)[:, None] - np.arange(-half, half + 1)
    g = np.exp(-0.5 * (x / scale) ** 2)
    g /= g.sum(axis=1, keepdims=True)
    return np.stack([g, -x / scale**2 * g, (x**2 / scale**2 - 1.0) / scale**2 * g], axis=2)


def _normals(r: Array) -> tuple[Array, Array, Array]:
    """Unit normals (N, 2), second derivatives across and along the line: (N,) each."""
    uu, uv, vv = r[:, 0, 2], r[:, 1, 1], r[:, 2, 0]
    middle, apart = (uu + vv) / 2.0, np.hypot((uu - vv) / 2.0, uv)
    angle = 0.5 * np.arctan2(-2.0 * uv, vv - uu)  # of the smaller eigenvalue
    return np.stack([np.cos(angle), np.sin(angle)], axis=1), middle - apart, middle + apart


def _first(r: Array, normal: Array) -> Array:
    """First derivative along the normals."""
    return r[:, 0, 1] * normal[:, 0] + r[:, 1, 0] * normal[:, 1]


def _curved(r: Array, normal: Array) -> Array:
    """Second derivative along the normals, negated: NaN where there is no crest."""
    x, y = normal.T
    second = r[:, 0, 2] * x**2 + 2.0 * r[:, 1, 1] * x * y + r[:, 2, 0] * y**2
    return np.where(second < 0.0, -second, np.nan)


def _beside(
    padded: NDArray[np.float32],
    pixel: Array,
    normal: Array,
    r: Array,
    curved: Array,
    width: Array,
    scale: float,
) -> tuple[Array, Array]:
    """Levels of both sides (2, N), and the smoothed line's widths (N,), better than those given.

    With a height a above the level, r_nn = -a/s^2; beside it, at 3 s, exp(-4.5) of a is left.
    """
    away = (_BESIDE * width)[:, None] * normal
    sides = np.stack([_filtered(padded, pixel + sign * away, scale).r[:, 0, 0] for sign in (-1, 1)])
    height = (r[:, 0, 0] - sides.mean(axis=0)) / (1.0 - _TAIL)
    width = np.sqrt(np.clip(np.nan_to_num(height / curved), scale**2, 64.0 * scale**2))
    return sides - _TAIL * height, width


def _noise_passed_on(
    local: _Local, normal: Array, curved: Array, background: Array, noise: Noise, column: Index
) -> tuple[Array, Array]:
    """Standard deviation of the points along their normals, and of r_nn, relative: (N,) each."""
    variance = noise.variance((local.pixels - background[:, None, None]).T, column).T
    (x, y), u, v = normal.T, local.along_u, local.along_v

    def summed(by_u: Array, by_v: Array) -> Array:
        return np.einsum("nm,nml,nl->n", by_v, variance, by_u, optimize=True)

    u0, u1, u2 = np.moveaxis(u, 2, 0)
    v0, v1, v2 = np.moveaxis(v, 2, 0)
    first = x**2 * summed(u1**2, v0**2) + y**2 * summed(u0**2, v1**2)
    first += 2.0 * x * y * summed(u0 * u1, v0 * v1)
    second = x**4 * summed(u2**2, v0**2) + y**4 * summed(u0**2, v2**2)
    second += 4.0 * x**2 * y**2 * summed(u1**2, v1**2)
    second += 2.0 * x**2 * y**2 * summed(u2 * u0, v0 * v2)
    return np.sqrt(np.maximum(first, 0.0)) / curved, np.sqrt(np.maximum(second, 0.0)) / curved


def _judged(
    pixel: Array,
    found: Array,
    scale: float,
    max_sigma: float,
    finite: NDArray[np.bool_],
    clipped: NDArray[np.bool_],
    ends: NDArray[np.bool_],
) -> Index:
    """Status of each point: (N,)."""
    step, _, width, amplitude, _, _ = found
    u, v = np.rint(pixel).astype(int).T
    reach = 2 * int(np.ceil(scale)) + 1
    kernel = np.ones((2 * reach + 1,) * 2, np.uint8)
    near = [
        cv2.dilate(mask.astype(np.uint8), kernel)[v, u] > 0 if mask.any() else np.array(False)
        for mask in (~finite, clipped)
    ]
    reasons = {
        Status.BAD_PIXELS: near[0],
        Status.SATURATED: near[1],
        Status.AT_BORDER: _margin(pixel, finite.shape) < _REACH * scale,
        Status.LINE_END: ends,
        Status.TOO_NARROW: width < MIN_SIGMA_PX,
        Status.POOR_FIT: ~(np.abs(step) < _CONVERGED_PX) | (width > max_sigma) | ~(amplitude > 0.0),
    }
    return np.select(list(reasons.values()), list(reasons), Status.OK)
