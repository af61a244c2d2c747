"""From light to grey values, by a sensor's data sheet (`devices.image_sensor`): EMVA 1288.

Not modelled here: motion, and a shutter that rolls (a frame is one instant).
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import (
    LARGEST,
    SMALLEST,
    generator_of,
    image_of,
    number_within,
    numbers_of,
    unmasked,
)
from virtual_sensor.calls import public
from virtual_sensor.devices.image_sensor import ImageSensor
from virtual_sensor.devices.planck import c, h
from virtual_sensor.errors import InputError, short

Array = NDArray[np.float64]

_AT_ONCE = 4  # frames of a sequence
_SURELY_FULL = 10.0  # full wells: more light than that makes no difference
_DARKEST = 0.01  # photons, of a frame's brightest pixel
_MOST_E = 1e18  # what NumPy draws a Poisson number of


def irradiance(
    radiance: ArrayLike, f_number: float, magnification: float = 0.0, transmission: float = 1.0
) -> Array:
    """Irradiance of the sensor in W/mm^2 from a scene's radiance in W/(mm^2 sr), on the axis.

    E = pi L tau / (4 (N (1 + m))^2): Born and Wolf 1999, 4.8.3, for a lens with a pupil
    magnification of 1.
    """
    working = f_number * (1.0 + magnification)
    return np.asarray(radiance, float) * np.pi * transmission / (4.0 * working**2)


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
    seed: int | np.random.Generator = 0,
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
    seed : int or numpy.random.Generator
        Of the temporal noise; the same seed gives the same bits.
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
            f"grey_values: sensor is {short(sensor)}; give an ImageSensor, or leave it out"
        )
    dark_e = 0.0
    if exposure_s is not None:
        advice = "the exposure in s, from 0 on"
        exposure_s = number_within("grey_values: exposure_s", exposure_s, 0.0, LARGEST, advice)
        dark_e = min(sensor.dark_current * exposure_s, _MOST_E)
    images = unmasked(photons)
    if images.ndim == 3 and images.size and images.dtype.kind in "bufi":
        rng = generator_of("grey_values: seed", seed)
        return _sequence(images, sensor, rng, dark_e, peak_e, exposure_s is not None)
    photons = photons if peak_e is None else exposed(photons, peak_e, sensor)
    light = image_of("grey_values: photons", photons, 0.0)
    rng = generator_of("grey_values: seed", seed)
    if exposure_s is None:
        _check_exposure(light.max(initial=0.0))
    return _grey(light, sensor, rng, dark_e)


def _sequence(
    images: NDArray,
    sensor: ImageSensor,
    rng: np.random.Generator,
    dark_e: float,
    peak_e: float | None,
    timed: bool,
) -> NDArray:
    """Grey values (K, H, W) of frames of one exposure; a few at once, as all may be large."""
    brightest = float(np.nanmax(images, initial=0.0))
    scale = 1.0 if peak_e is None else _exposure(brightest, peak_e, sensor)
    if not timed:
        _check_exposure(scale * brightest)
    grey: NDArray = np.empty(images.shape, sensor.kind)

    def take(number: int, own: np.random.Generator) -> None:
        light = image_of(f"grey_values: photons of frame {number}", images[number], 0.0)
        grey[number] = _grey(light * scale, sensor, own, dark_e)

    with ThreadPoolExecutor(_AT_ONCE) as threads:  # NumPy draws numbers beside itself
        deque(threads.map(take, range(len(images)), rng.spawn(len(images))), maxlen=0)
    return grey


def _check_exposure(brightest: float) -> None:
    if 0.0 < brightest < _DARKEST:
        raise InputError(
            f"grey_values: photons are at most {brightest:.2g} on a pixel, less than any sensor"
            " sees; of a radiance give the exposure too: peak_e, the electrons of its brightest"
            " pixel"
        )


def _grey(light: Array, sensor: ImageSensor, rng: np.random.Generator, dark_e: float) -> NDArray:
    """Grey values (H, W) of so many photons on each pixel."""
    offset, response = _pattern(sensor, light.shape)
    brim = sensor.full_well_e * (sensor.knee[1] if sensor.knee else 1.0)
    full = min(_SURELY_FULL * brim, _MOST_E)
    mean = np.minimum(sensor.quantum_efficiency * light * response + dark_e, full)
    electrons = np.zeros(light.shape, np.float32)
    lit = mean > 0.0
    if sensor.knee is None:
        electrons[lit] = rng.poisson(mean[lit])
    else:
        last, barrier = _knee(sensor)
        first = np.minimum(rng.poisson((1.0 - last) * mean[lit]), barrier)
        electrons[lit] = first + rng.poisson(last * mean[lit])
    electrons += rng.standard_normal(light.shape, np.float32) * np.float32(sensor.dark_noise_e)
    electrons += offset
    np.minimum(electrons, sensor.full_well_e, out=electrons)
    grey = np.rint(electrons * np.float32(sensor.gain) + np.float32(sensor.black_level))
    return np.clip(grey, 0, sensor.white).astype(sensor.kind)


def _pattern(
    sensor: ImageSensor, shape: tuple[int, ...]
) -> tuple[NDArray[np.float32] | float, NDArray[np.float32] | float]:
    """Offset in electrons and response of each pixel: the same in every frame of this shape."""
    rng = np.random.default_rng((sensor.pattern_seed, *shape))
    offset: NDArray[np.float32] | float = 0.0
    response: NDArray[np.float32] | float = 1.0
    if sensor.dsnu_e:
        offset = rng.standard_normal(shape, np.float32) * np.float32(sensor.dsnu_e)
    if sensor.prnu:
        response = 1.0 + rng.standard_normal(shape, np.float32) * np.float32(sensor.prnu)
        response = np.maximum(response, 0.0)
    return offset, response


def _knee(sensor: ImageSensor) -> tuple[float, float]:
    """Share of the exposure's last part, and the level in electrons at which the first is held."""
    assert sensor.knee is not None
    share, ratio = sensor.knee
    last = (1.0 - share) / (ratio - share)
    return last, (1.0 - last) * share * sensor.full_well_e
