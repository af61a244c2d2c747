"""Decoded fringes as observations: an image of millions of pixels in some thousand blocks.

Air is smooth over millimetres, and parts are over some pixels. In blocks of pixels, spread evenly,
a cubic of (u, v) is fitted to the decoded column and row. Its value in the block's middle is as
sure as all its pixels together: their noise, the staircase of a DMD's pixels and wrong fringe
orders are taken off. Its slopes J = d(column, row)/d(u, v) turn the decoded pixel's noise into the
camera pixel's: moving the camera's pixel by d does to points on the part what an error J d of the
decoded one does.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from virtual_sensor.arrays import whole_number
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError, short
from virtual_sensor.metrology.covariance import SIGMA_BY_MEDIAN
from virtual_sensor.metrology.fringes.decoded import DecodedFringes, FringeStatus
from virtual_sensor.metrology.observations import Observation

Array = NDArray[np.float64]
Mask = NDArray[np.bool_]

MOST_BLOCKS = 2000
"""Of an image, unless another number is asked for."""

LEAST_SIGMA_PX = 1e-3
"""Of a block's pixel, in px of the camera: what else errs is not known to be less."""

_POWERS = tuple((i, j) for i in range(4) for j in range(4 - i))  # of u and v; a constant first
_LEAST_PX, _MOST_PX = 4, 16  # edge of a block
_SHARE = 32  # edges of a block in the image: over more of it a curved part is no cubic
_ENOUGH = 0.5  # of a block's pixels, that keep to its cubic
_OUTLIER = 6.0  # robust standard deviations
_ROUNDING_PX = 1e-9
_LEAST_SLOPE = 1e-3  # of decoded pixels by camera pixels: more even is no pattern's
_ROUNDS = 3  # of fits, each without the last one's outliers
_SCATTER_PX, _SCATTER = 0.5, 5.0  # rms off a cubic, in px and predicted sigma: more is an edge


@dataclass(frozen=True)
class Blocks(Displayed):
    """Decoded projector pixels in the middles of N blocks of an image.

    Attributes
    ----------
    pixel : ndarray of shape (N, 2)
        (u, v) of the camera, the mean of the block's pixels.
    decoded_px : ndarray of shape (N, A)
        Column, row, or both, of the projector.
    sigma_px : ndarray of shape (N, A)
        Their standard deviations.
    slopes : ndarray of shape (N, A, 2)
        Their derivatives by u and v.
    """

    pixel: Array
    decoded_px: Array
    sigma_px: Array
    slopes: Array

    def _line(self) -> str:
        return f"{len(self.pixel)} blocks"


@public
def fringe_observation(
    scene: Any, decoded: DecodedFringes, *, blocks: int = MOST_BLOCKS, name: str = ""
) -> Observation:
    """What decoded fringes say of air and shape, for `estimate_air`: a pixel for each block.

    Parameters
    ----------
    scene : Scene, str or Path
        With one camera and one projector, where they are thought to stand.
    decoded : DecodedFringes
        Of an image of the camera's size. With both axes each pixel has an epipolar residual, which
        no shape can cause; with the column alone it needs a shape.
    blocks : int
        How many the whole image is divided into, about.
    name : str

    Raises
    ------
    InputError
        If the decoded image is of another camera or projector, has no column, is known but for
        whole periods, or no block of it is decoded.
    """
    from virtual_sensor.optics.sight import pixel_family, scene_of

    scene = scene_of("fringe_observation", scene)
    if not isinstance(decoded, DecodedFringes):
        raise InputError(
            f"fringe_observation: decoded is {short(decoded)}; give DecodedFringes, which the"
            " decoders give"
        )
    if not isinstance(name, str):
        raise InputError(f"fringe_observation: name is {short(name)}; give a text")
    whole_number("fringe_observation: blocks", blocks, 1, 10**9)
    projector, camera = pixel_family("fringe_observation", scene), scene.camera
    if decoded.column is None:
        raise InputError(
            "fringe_observation: the column was not decoded; give fringes along u, or along both"
            " axes"
        )
    if decoded.column.shape[::-1] != tuple(camera.size):
        (height, width), (w, h) = decoded.column.shape, camera.size
        raise InputError(
            f"fringe_observation: the decoded image has {width} x {height} px, the camera {w} x"
            f" {h}; load the scene with width={width}, height={height}"
        )
    if tuple(decoded.size_px) != tuple(projector.size):
        (width, height), (w, h) = decoded.size_px, projector.size
        raise InputError(
            f"fringe_observation: decoded were fringes of a projector of {width} x {height} px, and"
            f" the scene's has {w} x {h}; give the scene of this projector"
        )
    if not decoded.absolute:
        raise InputError(
            "fringe_observation: whole periods may be missing in what was decoded; unwrap in time,"
            " by several periods or Gray code"
        )
    found = decoded_blocks(decoded, blocks)
    if not len(found.pixel):
        raise InputError(
            "fringe_observation: no block of the image is decoded; its statuses say why"
        )
    lit = found.decoded_px
    if decoded.row is None:
        middle = np.full(len(lit), (projector.size[1] - 1) / 2.0)
        s, _ = projector.of_pixels(np.column_stack([lit[:, 0], middle]))
        u, v = found.slopes[:, 0].T
        noise = found.sigma_px[:, 0] / np.hypot(u, v)
        return Observation(
            *(scene, found.pixel, np.maximum(noise, LEAST_SIGMA_PX), s),
            name=name,
            normal_deg=np.degrees(np.arctan2(v, u)),
        )
    s, t = projector.of_pixels(lit)
    of_camera = np.linalg.inv(found.slopes) * found.sigma_px[:, None, :]
    noise = np.sqrt(np.sum(of_camera**2, axis=(1, 2)) / 2.0)
    return Observation(scene, found.pixel, np.maximum(noise, LEAST_SIGMA_PX), s, t, name)


def decoded_blocks(decoded: DecodedFringes, blocks: int = MOST_BLOCKS) -> Blocks:
    """The blocks of a decoded image; of both axes where both were decoded."""
    pairs = (decoded.column, decoded.sigma_column), (decoded.row, decoded.sigma_row)
    axes = [(value, sigma) for value, sigma in pairs if value is not None and sigma is not None]
    values = np.stack([np.asarray(value, float) for value, _ in axes])
    noise = np.stack([np.asarray(sigma, float) for _, sigma in axes])
    _, height, width = values.shape
    step = max(_LEAST_PX, int(np.ceil(np.sqrt(height * width / blocks))))
    step = min(step, height, width)
    edge = min(step, max(_LEAST_PX, min(_MOST_PX, max(height, width) // _SHARE)))
    good = np.isfinite(values).all(axis=0) & (decoded.status == FringeStatus.OK)
    first = (step - edge) // 2
    values, noise, good = (each[..., first:, first:] for each in (values, noise, good))
    rows = [
        _of_row(values[:, v : v + edge], noise[:, v : v + edge], good[v : v + edge], (step, edge))
        for v in range(0, height - first - edge + 1, step)
    ]
    pixel, *others = (np.concatenate(each) for each in zip(*rows, strict=True))
    down = np.repeat(np.arange(len(rows)) * step, [len(each[0]) for each in rows])
    pixel += float(first) + np.stack([np.zeros(len(down)), down], axis=-1)
    return Blocks(pixel, *others)


def _of_row(values: Array, noise: Array, good: Mask, size: tuple[int, int]) -> tuple[Array, ...]:
    """A row of blocks: pixels in it (N, 2), values and sigmas (N, A), slopes (N, A, 2)."""
    step, edge = size
    value, sigma, (used,) = (_cut(each, *size) for each in (values, noise, good[None]))
    some = np.flatnonzero(used.mean(axis=1) >= _ENOUGH)
    used = used[some]  # (N, M)
    value, sigma = (np.where(used, each[:, some], 0.0) for each in (value, sigma))  # (A, N, M)
    count = np.maximum(used.sum(axis=1), 1)
    y, x = np.divmod(np.arange(edge * edge), edge)
    middle = [used @ w / count for w in (x, y)]
    # From the middle of what is there, in half edges: (N, M).
    across, down = ((w - m[:, None]) * 2.0 / edge for w, m in zip((x, y), middle, strict=True))
    columns = np.stack([across**i * down**j for i, j in _POWERS], axis=-1)
    for _ in range(_ROUNDS):
        count = used.sum(axis=1)
        weighed = columns * used[..., None]
        inverse = np.linalg.pinv(np.swapaxes(weighed, 1, 2) @ columns, hermitian=True)
        found = np.einsum("nkj,nmj,anm->ank", inverse, weighed, value, optimize=True)
        off = np.abs(value - np.einsum("nmk,ank->anm", columns, found))
        robust = SIGMA_BY_MEDIAN * np.nanmedian(np.where(used, off, np.nan), axis=2, keepdims=True)
        keeps = used & (off <= np.maximum(_OUTLIER * robust, _ROUNDING_PX)).all(axis=0)
        scatter = _rms(off, used, count - len(_POWERS))
        if np.array_equal(keeps, used):
            break
        used = keeps
    predicted = _rms(sigma, used, count)
    smooth = (scatter <= np.maximum(_SCATTER_PX, _SCATTER * predicted)).all(axis=0)
    slopes = np.stack([found[..., _POWERS.index(p)] for p in ((1, 0), (0, 1))], axis=-1)
    slopes = np.swapaxes(slopes, 0, 1) * 2.0 / edge
    steep = np.linalg.svd(slopes, compute_uv=False).min(axis=1) > _LEAST_SLOPE
    fits = (count >= _ENOUGH * edge * edge) & (count > len(_POWERS)) & smooth & steep
    spread = np.maximum(scatter, predicted) * np.sqrt(inverse[:, 0, 0])
    pixel = np.stack([some * step + middle[0], middle[1]], axis=-1)
    return tuple(each[fits] for each in (pixel, found[..., 0].T, spread.T, slopes))


def _rms(off: Array, used: Mask, freedom: Array) -> Array:
    """Of values (A, N, M) that are used, (A, N)."""
    square: Array = np.sum(np.where(used, off**2, 0.0), axis=2)
    return np.sqrt(square / np.maximum(freedom, 1))


def _cut(image: NDArray[Any], step: int, edge: int) -> NDArray[Any]:
    """Blocks (A, N, edge * edge) of images (A, edge, W), every so many columns."""
    windows = sliding_window_view(image, edge, axis=2)[:, :, ::step]  # (A, edge, N, edge)
    return np.moveaxis(windows, 2, 1).reshape(len(image), -1, edge * edge)
