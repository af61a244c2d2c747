"""What a lens makes of images: blur that is the same all over, and distortion.

For images without a scene; a `lens_camera` blurs by depth and distorts while it renders.  Not
modelled: vignetting, chromatic aberration.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import irfft2, next_fast_len, rfft2
from scipy.ndimage import fourier_ellipsoid, fourier_gaussian, map_coordinates

from virtual_sensor.arrays import image_of, number_within
from virtual_sensor.calls import public
from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_families import Pinhole

Array = NDArray[np.float64]

_REACH = 6.0  # of the Gaussian, in sigma
_ORDER = 5  # of the spline through the frame's pixels
_TILE = 16  # px: side of the squares in which light is looked for
_APRON_PX = 3  # about a lit tile, in which the spline still shows


@public
def gaussian_blur(image: ArrayLike, sigma_px: float) -> Array:
    """Blur an image (H, W) by a Gaussian of so many px; the light that leaves it is lost.

    Parameters
    ----------
    image : array_like of shape (H, W)
    sigma_px : float
        Standard deviation; 0: no blur.

    Raises
    ------
    InputError
        If the image has another shape, or a number is not finite, or `sigma_px` negative.
    """
    image, sigma = _checked(image, sigma_px, "sigma_px")
    return _blurred(image, fourier_gaussian, sigma, _REACH * sigma)


@public
def defocus_blur(image: ArrayLike, radius_px: float) -> Array:
    """Blur an image (H, W) by a disc: the lens's pupil out of focus, in geometric optics."""
    image, radius = _checked(image, radius_px, "radius_px")
    return _blurred(image, fourier_ellipsoid, 2.0 * radius, radius)


def _blurred(image: Array, by: Callable[..., NDArray], size: float, reach_px: float) -> Array:
    """Multiply an image's spectrum: exact where its pixels sample what it shows."""
    if not (size and image.size):
        return image
    apron = int(np.ceil(reach_px)) + 1
    shape = [next_fast_len(n + apron, real=True) for n in image.shape]
    spectrum = rfft2(image, shape, workers=-1)
    by(spectrum, size, n=shape[-1], output=spectrum)
    seen = irfft2(spectrum, shape, workers=-1)[: image.shape[0], : image.shape[1]]
    return _not_negative(seen) if image.min() >= 0.0 else seen


def _not_negative(seen: Array) -> Array:
    """Cut off what swings below zero beside sharp edges, but keep the light as a whole."""
    light, cut = seen.sum(), np.maximum(seen, 0.0)
    return cut * (light / cut.sum()) if light > 0.0 else cut


def distorted(image: ArrayLike, camera: Pinhole) -> Array:
    """What a camera that distorts sees, from what an ideal pinhole of the same K sees.

    A spline through the ideal frame is read where each pixel's light would have fallen; its pixels
    must sample the line (a width of about 1 px or more).

    Parameters
    ----------
    image : array_like of shape (H, W)
    camera : Pinhole
        With its `distortion`; of the image's size.

    Raises
    ------
    InputError
        Where the image has another shape, or holds no numbers.
    """
    image = image_of("distorted: the image", image)
    if image.shape != camera.size[::-1]:
        raise InputError(
            f"distorted: the image is {image.shape[1]} x {image.shape[0]} px, the camera has"
            f" {camera.size[0]} x {camera.size[1]} px; give an image of its size"
        )
    if not camera.distorts:
        return image
    seen = np.zeros_like(image)
    v, u = np.nonzero(_reached(image != 0.0, camera))
    ideal = camera.undistorted(np.stack([u, v], axis=-1).astype(float))
    there = np.isfinite(ideal).all(axis=-1)
    seen[v[there], u[there]] = map_coordinates(image, ideal[there, ::-1].T, order=_ORDER)
    return np.maximum(seen, 0.0) if image.min() >= 0.0 else seen


def _reached(lit: NDArray[np.bool_], camera: Pinhole) -> NDArray[np.bool_]:
    """Pixels (H, W) of a camera that distorts to which light may get from the ideal's lit ones."""
    size = np.array(lit.shape)
    padded = np.pad(lit, [(0, -n % _TILE) for n in lit.shape])
    tiles = padded.reshape(padded.shape[0] // _TILE, _TILE, -1, _TILE).any(axis=(1, 3))
    middles = (np.argwhere(tiles) + 0.5) * _TILE - 0.5
    half = _TILE / 2 + _APRON_PX
    around = np.stack(np.meshgrid(*2 * [[-half, 0.0, half]]), axis=-1).reshape(-1, 2)
    corners = camera.distort((middles[:, None] + around)[..., ::-1])[..., ::-1]
    first = np.clip(np.floor(corners.min(axis=1)) - 1, 0, size).astype(int)
    last = np.clip(np.ceil(corners.max(axis=1)) + 2, 0, size).astype(int)
    reached = np.zeros(lit.shape, bool)
    for (top, left), (bottom, right) in zip(first, last, strict=True):
        reached[top:bottom, left:right] = True
    return reached


def _checked(image: ArrayLike, number: float, name: str) -> tuple[Array, float]:
    image = image_of("lens: the image", image)
    most = min(image.shape) / 2.0 + 1.0
    return image, number_within(
        f"lens: {name}", number, 0.0, most, "it from 0 up to half the image"
    )
