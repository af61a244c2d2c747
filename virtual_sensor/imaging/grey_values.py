"""From light to grey values, by a sensor's data sheet (`devices.image_sensor`): EMVA 1288.

Not modelled here: motion, and a shutter that rolls (a frame is one instant).
"""

from __future__ import annotations

import os
from collections import deque
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from functools import lru_cache, partial

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import (
    LARGEST,
    SMALLEST,
    image_of,
    number_within,
    numbers_of,
    unmasked,
)
from virtual_sensor.calls import public
from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.devices.planck import c, h
from virtual_sensor.errors import InputError, naming, short
from virtual_sensor.imaging.pixel_noise import Floats, PixelNoise, poisson

Array = NDArray[np.float64]

_TEMPORAL, _FIXED = range(2)  # parts of what a seed makes
_THREADS = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
_BLOCK_PX = 1 << 14
_PATTERNS = 2  # that are kept
_SURELY_FULL = 10.0  # full wells: more light than that makes no difference
_DARKEST = 0.01  # photons, of a frame's brightest pixel
_MOST_E = 1e18  # that are drawn


def image_irradiance(
    radiance: ArrayLike, working_f_number: float, transmission: float = 1.0
) -> Array:
    """Irradiance of the sensor in W/mm^2 from a scene's radiance in W/(mm^2 sr), on the axis.

    E = pi L tau / (4 N_w^2), N_w = N (1 + m): Born and Wolf 1999, 4.8.3, for a lens with a pupil
    magnification of 1.
    """
    return np.asarray(radiance, float) * np.pi * transmission / (4.0 * working_f_number**2)


def photons(
    irradiance_w_mm2: ArrayLike, exposure_s: float, pixel_um: float, wavelength_nm: float
) -> Array:
    """Mean number of photons that fall on each pixel: EMVA 1288, equation 2.

    mu_p = A E t lambda/(h c) = 5.034e24 A E t lambda in SI units.
    """
    energy_j = np.asarray(irradiance_w_mm2, float) * (pixel_um * 1e-3) ** 2 * exposure_s
    return energy_j * (wavelength_nm * 1e-9) / (h * c)


@public
def exposed(image: ArrayLike, peak_e: float, sensor: ImageSensor) -> Array:
    """Photons of an image in any unit, so exposed that its brightest pixel has `peak_e` electrons.

    Raises
    ------
    InputError
        Where the image is dark.
    """
    image = numbers_of("exposed: the image", image)
    return image * _exposure(float(np.nanmax(image, initial=0.0)), peak_e, sensor)


def _exposure(brightest: float, peak_e: float, sensor: ImageSensor) -> float:
    """Photons per unit of an image."""
    number_within("exposed: peak_e", peak_e, SMALLEST, LARGEST, "electrons, more than 0")
    if not 0.0 < brightest < np.inf:
        raise InputError("exposed: the image is dark, or not finite; no exposure makes it bright")
    return peak_e / sensor.quantum_efficiency / brightest


@public
def grey_values(
    photons: ArrayLike,
    sensor: ImageSensor | None = None,
    seed: int | tuple[int, int] | np.random.Generator = 0,
    *,
    exposure_s: float | None = None,
    peak_e: float | None = None,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Grey values that a sensor makes of light: with noise, fixed pattern, black level, clipping.

    For images without a scene; a scene's frame is recorded by `record`.

    Parameters
    ----------
    photons : array_like of shape (H, W) or (K, H, W)
        Mean number of photons on each pixel; with `peak_e` an image in any unit, such as `render`
        gives, or a `Frame`.  Of a sequence, such as `render_sequence` gives, all frames are
        exposed alike, and each has noise of its own.  A frame without noise is stored by
        ``vs.save_png(frame.radiance, "frame.png")``.
    sensor : ImageSensor, optional
        By default the 12-bit one that `ImageSensor()` is.
    seed : int, (int, int) or numpy.random.Generator
        Of the temporal noise: the same seed gives the same bits, in whatever order frames are
        taken, and a part of an image from its first row and column on the same as the whole.
        Frame k of a sequence has the seed ``(seed, k)`` alone.
    exposure_s : float, optional
        In which the dark current gathers; by default there is none.
    peak_e : float, optional
        Instead of photons: electrons of the brightest pixel, in all of a sequence.

    Returns
    -------
    ndarray of shape (H, W) or (K, H, W)
        Grey values, uint8 up to 8 bits, else uint16.

    Raises
    ------
    InputError
        Where `photons` has another shape, or holds what is negative or no number; with `peak_e`
        where the image is dark.

    Notes
    -----
    With a knee (f, R) a pixel is held at the level B in the exposure's first part, and gathers all
    the light of its last part, the share s: where it has Q electrons, min(Poisson((1 - s) Q), B) +
    Poisson(s Q) are read.  Beyond the knee, at f times the full well, the mean so grows by s per
    electron, with the shot noise of the last part alone; the range of light is R full wells:
    s = (1 - f)/(R - f), B = (1 - s) f.
    """
    sensor = ImageSensor() if sensor is None else sensor
    if not isinstance(sensor, ImageSensor):
        raise InputError(
            f"grey_values: sensor is {short(sensor)}; give an ImageSensor, such as"
            ' vs.image_sensor("cmos_5um5"), or leave it out'
        )
    if hasattr(photons, "detector_options"):
        raise InputError("grey_values: photons are grey values already; give the ideal frame")
    dark_e = 0.0
    if exposure_s is not None:
        advice = "the exposure in s, from 0 on"
        exposure_s = number_within("grey_values: exposure_s", exposure_s, 0.0, LARGEST, advice)
        dark_e = sensor.dark_current * exposure_s
    with naming("grey_values"):
        noise = PixelNoise(seed, _TEMPORAL)
    images = unmasked(photons)
    several = images.ndim == 3 and images.size > 0 and images.dtype.kind in "bufi"
    if not several:
        images = _light("grey_values: photons", images)[None]
    brightest = float(np.nanmax(images, initial=0.0))
    scale = 1.0 if peak_e is None else _exposure(brightest, peak_e, sensor)
    if exposure_s is None:
        _check_exposure(scale * brightest)
    grey: NDArray = np.empty(images.shape, sensor.kind)
    with ThreadPoolExecutor(_THREADS) as threads:  # NumPy computes beside itself
        each = threads.map if images[0].size > _BLOCK_PX else map
        for number, image in enumerate(images):
            light = _light(f"grey_values: photons of frame {number}", image)
            expose = partial(_expose, light, scale, dark_e, sensor, noise, number, grey[number])
            deque(each(expose, _blocks(*light.shape)), maxlen=0)
    return grey if several else grey[0]


def _light(name: str, image: NDArray) -> NDArray:
    """The image as it is if it is one of finite numbers from 0 on; raises InputError, else."""
    plain = image.ndim == 2 and image.dtype.kind in "uf" and image.size > 0
    if plain and image.min() >= 0.0 and image.max() < np.inf:  # NaN is neither
        return image
    return image_of(name, image, 0.0)


def _check_exposure(brightest: float) -> None:
    if 0.0 < brightest < _DARKEST:
        raise InputError(
            f"grey_values: photons are at most {brightest:.2g} on a pixel, less than any sensor"
            " sees; of a radiance give the exposure too: peak_e, the electrons of its brightest"
            " pixel"
        )


def _blocks(height: int, width: int) -> Iterator[slice]:
    """Rows of an image, a few at once: the processor's cache holds what is made of them."""
    rows = max(_BLOCK_PX // max(width, 1), 1)
    return (slice(first, min(first + rows, height)) for first in range(0, height, rows))


def _expose(
    light: NDArray,
    scale: float,
    dark_e: float,
    sensor: ImageSensor,
    noise: PixelNoise,
    frame: int,
    grey: NDArray,
    rows: slice,
) -> None:
    """Write the grey values of some rows of a frame."""
    width = light.shape[1]
    offset, response = _pattern(sensor.pattern_seed, *light.shape)
    brim = sensor.light_e(sensor.full_well_e)
    with np.errstate(over="ignore"):  # far above the brim
        mean = light[rows] * float(scale * sensor.quantum_efficiency)
        if sensor.prnu:
            gain = response[rows] * np.float32(sensor.prnu) + np.float32(1.0)
            mean = mean * np.maximum(gain, 0.0)
        most = min(_SURELY_FULL * brim, _MOST_E)
        mean_e: Floats = np.minimum(mean + dark_e, most).astype(np.float32)
    lines = range(rows.start, rows.stop)
    shot, read = noise.normals(lines, width, frame)
    if sensor.knee is None:
        electrons = poisson(mean_e, shot)
    else:
        last = np.float32(sensor.beyond_knee)
        barrier = np.float32((1.0 - sensor.beyond_knee) * sensor.knee_e)
        electrons = np.minimum(poisson(mean_e * (1 - last), shot), barrier)
        electrons += poisson(mean_e * last, noise.normals(lines, width, frame, pair=1)[0])
    electrons += read * np.float32(sensor.dark_noise_e)
    if sensor.dsnu_e:
        electrons += offset[rows] * np.float32(sensor.dsnu_e)
    np.minimum(electrons, np.float32(sensor.full_well_e), out=electrons)
    electrons *= np.float32(sensor.gain)
    electrons += np.float32(sensor.black_level)
    np.rint(electrons, out=electrons)
    np.clip(electrons, 0, sensor.white, out=grey[rows], casting="unsafe")


@lru_cache(_PATTERNS)
def _pattern(seed: int, height: int, width: int) -> tuple[Floats, Floats]:
    """Normal numbers of each pixel's offset and response: the same in every frame."""
    drawn = PixelNoise(seed, _FIXED)
    found = np.empty((2, height, width), np.float32)
    for rows in _blocks(height, width):
        found[:, rows] = drawn.normals(range(rows.start, rows.stop), width)
    found.flags.writeable = False
    return found[0], found[1]
