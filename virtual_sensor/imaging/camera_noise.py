"""From light to grey values: the linear camera of EMVA Standard 1288, release 4.0.

    photons --QE--> electrons --+ dark noise, clipped at the full well--> K --+ offset, rounded--> y

The variance of the grey values is K^2 sigma_d^2 + 1/12 + K (mu_y - mu_dark), equation 14 there.
The fixed pattern is the camera's own, the same in each frame: DSNU an offset, PRNU a gain of each
pixel.

Not modelled: motion and a shutter that rolls (a frame is one instant), dark current, deviations
from linearity, defect pixels, correlations between pixels, colour.
"""

from __future__ import annotations

from collections import deque
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

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
    whole_number,
)
from virtual_sensor.calls import public
from virtual_sensor.devices.planck import c, h
from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError, short

Array = NDArray[np.float64]

_AT_ONCE = 4  # frames of a sequence
_SURELY_FULL = 10.0  # full wells: more light than that makes no difference
_LARGEST, _LARGEST_WELL = 1e12, 1e30  # grey values are finite in float32
_DARKEST = 0.01  # photons, of a frame's brightest pixel
_MOST_E = 1e18  # what NumPy draws a Poisson number of


@public
@dataclass(frozen=True)
class CameraNoise(Displayed):
    """A monochrome camera's parameters by EMVA 1288; the defaults are a 12-bit CMOS sensor's.

    Attributes
    ----------
    quantum_efficiency : float
        Electrons per photon, at the laser's wavelength.
    gain : float
        System gain K, grey values (DN) per electron.
    dark_noise_e : float
        Temporal noise in the dark, sigma_d, electrons.
    full_well_e : float
        Electrons at which a pixel is clipped.  The standard's saturation capacity, the mean at
        which the temporal variance is largest, is less: by about three times the spread of shot
        noise and PRNU together, 2 to 6 %.
    bit_depth : int
    black_level : float
        Mean grey value in the dark, DN.
    dsnu_e : float
        Dark signal nonuniformity: spread of the pixels' offsets, electrons.
    prnu : float
        Photo response nonuniformity: spread of the pixels' gains, relative.
    pattern_seed : int
        Of the fixed pattern: which camera of its kind.
    """

    quantum_efficiency: float = 0.62
    gain: float = 0.37
    dark_noise_e: float = 2.4
    full_well_e: float = 10_500.0
    bit_depth: int = 12
    black_level: float = 64.0
    dsnu_e: float = 0.6
    prnu: float = 0.006
    pattern_seed: int = field(default=0, repr=False)

    def __post_init__(self) -> None:
        positive = ("quantum_efficiency", "gain", "full_well_e")
        for name in (*positive, "dark_noise_e", "black_level", "dsnu_e", "prnu"):
            least, kind = (SMALLEST, "positive") if name in positive else (0.0, "not negative")
            advice = f"a number that is {kind}"
            most = _LARGEST_WELL if name == "full_well_e" else _LARGEST
            number_within(f"camera: {name}", getattr(self, name), least, most, advice)
        if self.quantum_efficiency > 1.0:
            raise InputError(
                f"camera: quantum_efficiency is {self.quantum_efficiency}; give it up to 1"
            )
        whole_number("camera: bit_depth", self.bit_depth, 1, 16)
        whole_number("camera: pattern_seed", self.pattern_seed, 0, 2**63 - 1)

    def _line(self) -> str:
        return (
            f"{self.bit_depth} bits, full well {self.full_well_e:g} e, dark noise"
            f" {self.dark_noise_e:g} e, {self.gain:g} DN/e, quantum efficiency"
            f" {self.quantum_efficiency:g}, black at {self.black_level:g}"
        )

    @property
    def white(self) -> int:
        """Largest grey value."""
        return int(2**self.bit_depth - 1)

    @property
    def kind(self) -> type[np.uint8] | type[np.uint16]:
        """Of its grey values."""
        return np.uint8 if self.bit_depth <= 8 else np.uint16

    @property
    def grey_noise(self) -> float:
        """Standard deviation of the grey values in the dark: what `line_centres` calls noise."""
        return float(np.sqrt((self.gain * self.dark_noise_e) ** 2 + 1.0 / 12.0))

    @property
    def saturation(self) -> float:
        """Grey value from which on pixels are clipped, by the well or by the converter."""
        return float(min(self.white, np.floor(self.black_level + self.gain * self.full_well_e)))


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
def exposed(image: ArrayLike, peak_e: float, camera: CameraNoise) -> Array:
    """Photons of an image in any unit, so exposed that its brightest pixel has `peak_e` electrons.

    Raises
    ------
    InputError
        Where the image is dark.
    """
    image = numbers_of("exposed: the image", image)
    return image * _exposure(float(np.nanmax(image, initial=0.0)), peak_e, camera)


def _exposure(brightest: float, peak_e: float, camera: CameraNoise) -> float:
    """Photons per unit of an image."""
    number_within("exposed: peak_e", peak_e, SMALLEST, LARGEST, "electrons, more than 0")
    if not 0.0 < brightest < np.inf:
        raise InputError("exposed: the image is dark, or not finite; no exposure makes it bright")
    return peak_e / camera.quantum_efficiency / brightest


@public
def record(
    photons: ArrayLike,
    camera: CameraNoise | None = None,
    seed: int | np.random.Generator = 0,
    *,
    peak_e: float | None = None,
) -> NDArray[np.uint8] | NDArray[np.uint16]:
    """Take a frame: the grey values of a camera, with its noise, black level and clipping.

    Parameters
    ----------
    photons : array_like of shape (H, W) or (K, H, W)
        Mean number of photons on each pixel; with `peak_e` an image in any unit, such as `render`
        gives, or a `Frame`.  Of a sequence, such as `render_sequence` gives, all frames are
        exposed alike, and each has noise of its own.  A frame without noise is stored by
        ``vs.save_png(frame.radiance, "frame.png")``.
    camera : CameraNoise, optional
        By default the 12-bit one that `CameraNoise()` is.
    seed : int or numpy.random.Generator
        Of the temporal noise; the same seed gives the same bits.
    peak_e : float, optional
        The exposure: electrons of the brightest pixel, in all of a sequence.

    Returns
    -------
    ndarray of shape (H, W) or (K, H, W)
        Grey values, uint8 up to 8 bits, else uint16.

    Raises
    ------
    InputError
        Where `photons` has another shape, or holds what is negative or no number; with `peak_e`
        where the image is dark.
    """
    camera = CameraNoise() if camera is None else camera
    if not isinstance(camera, CameraNoise):
        raise InputError(f"record: camera is {short(camera)}; give a CameraNoise, or leave it out")
    images = unmasked(photons)
    if images.ndim == 3 and images.size and images.dtype.kind in "bufi":
        return _sequence(images, camera, generator_of("record: seed", seed), peak_e)
    photons = photons if peak_e is None else exposed(photons, peak_e, camera)
    light = image_of("record: photons", photons, 0.0)
    rng = generator_of("record: seed", seed)
    _check_exposure(light.max(initial=0.0))
    return _grey(light, camera, rng)


def _sequence(
    images: NDArray, camera: CameraNoise, rng: np.random.Generator, peak_e: float | None
) -> NDArray:
    """Grey values (K, H, W) of frames of one exposure; a few at once, as all may be large."""
    brightest = float(np.nanmax(images, initial=0.0))
    scale = 1.0 if peak_e is None else _exposure(brightest, peak_e, camera)
    _check_exposure(scale * brightest)
    grey: NDArray = np.empty(images.shape, camera.kind)

    def take(number: int, own: np.random.Generator) -> None:
        light = image_of(f"record: photons of frame {number}", images[number], 0.0)
        grey[number] = _grey(light * scale, camera, own)

    with ThreadPoolExecutor(_AT_ONCE) as threads:  # NumPy draws numbers beside itself
        deque(threads.map(take, range(len(images)), rng.spawn(len(images))), maxlen=0)
    return grey


def _check_exposure(brightest: float) -> None:
    if 0.0 < brightest < _DARKEST:
        raise InputError(
            f"record: photons are at most {brightest:.2g} on a pixel, less than any camera sees; of"
            " a radiance give the exposure too: peak_e, the electrons of its brightest pixel"
        )


def _grey(light: Array, camera: CameraNoise, rng: np.random.Generator) -> NDArray:
    """Grey values (H, W) of so many photons on each pixel."""
    offset, response = _pattern(camera, light.shape)
    full = min(_SURELY_FULL * camera.full_well_e, _MOST_E)
    mean = np.minimum(camera.quantum_efficiency * light * response, full)
    electrons = np.zeros(light.shape, np.float32)
    lit = mean > 0.0
    electrons[lit] = rng.poisson(mean[lit])
    electrons += rng.standard_normal(light.shape, np.float32) * np.float32(camera.dark_noise_e)
    electrons += offset
    np.minimum(electrons, camera.full_well_e, out=electrons)
    grey = np.rint(electrons * np.float32(camera.gain) + np.float32(camera.black_level))
    return np.clip(grey, 0, camera.white).astype(camera.kind)


def _pattern(
    camera: CameraNoise, shape: tuple[int, ...]
) -> tuple[NDArray[np.float32] | float, NDArray[np.float32] | float]:
    """Offset in electrons and response of each pixel: the same in every frame of this shape."""
    rng = np.random.default_rng((camera.pattern_seed, *shape))
    offset: NDArray[np.float32] | float = 0.0
    response: NDArray[np.float32] | float = 1.0
    if camera.dsnu_e:
        offset = rng.standard_normal(shape, np.float32) * np.float32(camera.dsnu_e)
    if camera.prnu:
        response = 1.0 + rng.standard_normal(shape, np.float32) * np.float32(camera.prnu)
        response = np.maximum(response, 0.0)
    return offset, response
