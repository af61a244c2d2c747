"""An image sensor by its data sheet: the linear camera of EMVA Standard 1288, release 4.0.

    photons --QE--> electrons --+ dark noise, clipped at the full well--> K --+ offset, rounded--> y

The variance of the grey values is K^2 sigma_d^2 + 1/12 + K (mu_y - mu_dark), equation 14 there.
The fixed pattern is the sensor's own, the same in each frame: DSNU an offset, PRNU a gain of each
pixel.

A data sheet is a TOML file (``cameras/*.toml``): the attributes of `ImageSensor` are its keys, the
quantum efficiency is a number or a table by wavelength in nm::

    description = "5.5 um global-shutter CMOS, 4 megapixels"
    pixel_um = 5.5
    gain = 0.29
    [quantum_efficiency]
    400 = 0.35
    550 = 0.60

Not modelled: deviations from linearity other than the knee, defect pixels, correlations between
pixels, colour.
"""

from __future__ import annotations

import tomllib
from collections.abc import Mapping
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import LARGEST, SMALLEST, number_within, points_of, whole_number
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, span
from virtual_sensor.errors import InputError, cause_of, naming, nearest, short
from virtual_sensor.files import named_file, readable
from virtual_sensor.seeds import LARGEST_SEED

_LARGEST, _LARGEST_WELL = 1e12, 1e30  # grey values are finite in float32
_MOST_PX = 1 << 20
_PIXELS_UM = 0.1, 1e3
_USUAL_NM = 532.0  # the laser of the shipped scenes
_COLDEST_C, _HOTTEST_C = -273.15, 200.0
_MOST_FILE_BYTES = 1 << 20


@dataclass(frozen=True, eq=False)
class LinearGrey(Displayed):
    """Grey values in proportion to the light, and what is known of them.

    Attributes
    ----------
    grey : ndarray of shape (H, W) or (K, H, W)
    detector_options : dict
        As an `ImageSensor` says them; beyond its knee-point the noise is more.
    """

    grey: NDArray[np.floating]
    detector_options: Mapping[str, float]

    def _line(self) -> str:
        return span("", self.grey)

    def __array__(self, dtype: Any = None, copy: bool | None = None) -> NDArray:
        """The grey values, wherever an image is asked for."""
        return np.array(self.grey, dtype) if copy else np.asarray(self.grey, dtype)


@public
@dataclass(frozen=True, kw_only=True)
class ImageSensor(Displayed):
    """A monochrome image sensor's parameters by EMVA 1288; the defaults are a 12-bit CMOS sensor's.

    Attributes
    ----------
    name, description : str
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
        Of the fixed pattern: which sensor of its kind.
    pixel_um : float or None
        Pitch of its pixels; None: any, the scene's.
    width_px, height_px : int or None
        Of the whole sensor; a frame may be a part of it.
    dark_current_e_s : float
        Electrons per second and pixel at `dark_current_at_c`.
    temperature_c, dark_current_at_c, doubling_c : float
        The sensor's temperature, that of the data sheet's dark current, and the rise that doubles
        it: EMVA 1288, equation 19.
    knee : (float, float) or None
        One knee-point of a high dynamic range: at which share of the full well it lies, and by how
        many times the range of light grows, such as (0.5, 6): see `grey_values`.
    row_time_us : float
        Of a rolling shutter, from a row's exposure to the next one's; 0: a global shutter.
    spectrum : tuple of (float, float)
        Wavelength in nm and quantum efficiency, as the data sheet tabulates them.
    """

    name: str = ""
    quantum_efficiency: float = 0.62
    gain: float = 0.37
    dark_noise_e: float = 2.4
    full_well_e: float = 10_500.0
    bit_depth: int = 12
    black_level: float = 64.0
    dsnu_e: float = 0.6
    prnu: float = 0.006
    pattern_seed: int = field(default=0, repr=False)
    pixel_um: float | None = None
    width_px: int | None = None
    height_px: int | None = None
    dark_current_e_s: float = 0.0
    temperature_c: float = 25.0
    dark_current_at_c: float = 25.0
    doubling_c: float = 8.0
    knee: tuple[float, float] | None = None
    row_time_us: float = 0.0
    spectrum: tuple[tuple[float, float], ...] = field(default=(), repr=False)
    description: str = field(default="", repr=False)

    def __post_init__(self) -> None:
        positive = ("quantum_efficiency", "gain", "full_well_e")
        others = ("dark_noise_e", "black_level", "dsnu_e", "prnu", "dark_current_e_s")
        for name in (*positive, *others, "row_time_us"):
            least, kind = (SMALLEST, "positive") if name in positive else (0.0, "not negative")
            most = _LARGEST_WELL if name == "full_well_e" else _LARGEST
            self._number(name, least, most, f"a number that is {kind}")
        for name in ("quantum_efficiency", "prnu"):
            if (value := getattr(self, name)) > 1.0:
                raise InputError(
                    f"sensor: {name} is {value}; give it up to 1, a part and no per cent"
                )
        for name in ("temperature_c", "dark_current_at_c"):
            self._number(name, _COLDEST_C, _HOTTEST_C, "a temperature in degC, up to 200")
        self._number("doubling_c", 1.0, 100.0, "the rise in degC, 1 to 100; about 8")
        if self.pixel_um is not None:
            self._number("pixel_um", *_PIXELS_UM, "the pitch of the pixels in um, such as 3.45")
        for name in ("width_px", "height_px"):
            if getattr(self, name) is not None:
                self._whole(name, 1, _MOST_PX)
        self._whole("bit_depth", 1, 16)
        self._whole("pattern_seed", 0, LARGEST_SEED)
        for name in ("name", "description"):
            if not isinstance(getattr(self, name), str):
                raise InputError(f"sensor: {name} is {short(getattr(self, name))}; give a text")
        object.__setattr__(self, "knee", _knee(self.knee))
        object.__setattr__(self, "spectrum", _spectrum(self.spectrum))

    def _number(self, name: str, least: float, most: float, advice: str) -> None:
        number_within(f"sensor: {name}", getattr(self, name), least, most, advice)

    def _whole(self, name: str, least: int, most: int) -> None:
        whole_number(f"sensor: {name}", getattr(self, name), least, most)

    def _line(self) -> str:
        knee = f"knee at {self.knee[0]:g} of it, range x{self.knee[1]:g}" if self.knee else ""
        return listed(
            self.name,
            f"{self.bit_depth} bits",
            f"{self.pixel_um:g} um" if self.pixel_um else "",
            f"full well {self.full_well_e:g} e",
            knee,
            f"dark noise {self.dark_noise_e:g} e",
            f"{self.gain:g} DN/e",
            f"quantum efficiency {self.quantum_efficiency:g}",
            f"black at {self.black_level:g}",
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

    @property
    def saturation_e(self) -> float:
        """Electrons read from which on a pixel is clipped, by the well or by the converter."""
        return float(min(self.full_well_e, (self.white - self.black_level) / self.gain))

    @property
    def row_time_s(self) -> float:
        """Of a rolling shutter: `row_time_us` in s."""
        return 1e-6 * self.row_time_us

    @property
    def knee_e(self) -> float:
        """Electrons read at the knee-point; without one, those of the full well."""
        return self.full_well_e * (self.knee[0] if self.knee else 1.0)

    @property
    def beyond_knee(self) -> float:
        """Electrons read for each one that light makes beyond the knee-point; 1 without one."""
        if self.knee is None:
            return 1.0
        share, ratio = self.knee
        return (1.0 - share) / (ratio - share)

    def light_e(self, read_e: float) -> float:
        """Electrons that light makes where so many are read: beyond the knee-point more."""
        return read_e + max(read_e - self.knee_e, 0.0) * (1.0 / self.beyond_knee - 1.0)

    def without_knee(self, grey: ArrayLike) -> NDArray[np.floating]:
        """Grey values in proportion to the light: those beyond the knee-point are stretched back.

        As a sensor of the same gain without a knee, and of a larger well, would give them; without
        a knee they stay as they are.  In single precision, of images as of single numbers: a pixel
        at the saturation is at the saturation afterwards too.
        """
        grey = np.asarray(grey, np.float32)
        if self.knee is None:
            return grey
        knee = np.float32(self.black_level + self.gain * self.knee_e)
        beyond = np.maximum(grey - knee, np.float32(0.0))
        return np.asarray(grey + beyond * np.float32(1.0 / self.beyond_knee - 1.0))

    def linear(self, grey: ArrayLike, options: Mapping[str, float]) -> LinearGrey:
        """Grey values without the knee-point, and a detector's options for them."""
        levels = {"saturation", "black"} & options.keys()
        straight = {name: float(self.without_knee(options[name])) for name in levels}
        return LinearGrey(self.without_knee(grey), {**options, **straight})

    def with_bits(self, bits: int) -> ImageSensor:
        """The same with grey values of so many bits, the largest still of the same electrons."""
        finer = (2**bits - 1) / self.white
        gain, black = self.gain * finer, self.black_level * finer
        return replace(self, gain=gain, black_level=black, bit_depth=bits)

    @property
    def detector_options(self) -> dict[str, float]:
        """What a detector or a codec is to know of the grey values, and an image's file says.

        `noise` in the dark, with the rounding; `gain` in grey values per electron; `saturation`;
        `black`.
        """
        return self.detector_options_above(0.0)

    def detector_options_above(self, electrons: float) -> dict[str, float]:
        """Likewise where every pixel has so many electrons more: of dark current, or ambient light.

        Beyond the knee-point the noise is more.
        """
        return {
            "noise": float(np.hypot(self.grey_noise, self.gain * np.sqrt(electrons))),
            "gain": self.gain,
            "saturation": self.saturation,
            "black": self.black_level + self.gain * electrons,
        }

    @property
    def dark_current(self) -> float:
        """Electrons per second and pixel at the sensor's temperature."""
        warmer = (self.temperature_c - self.dark_current_at_c) / self.doubling_c
        return self.dark_current_e_s * float(np.exp2(warmer))

    def at_wavelength(self, wavelength_nm: float) -> ImageSensor:
        """The sensor with the quantum efficiency of a wavelength; as it is without a `spectrum`.

        Raises
        ------
        InputError
            Beyond the wavelengths that the data sheet tabulates.
        """
        number_within("sensor: wavelength_nm", wavelength_nm, SMALLEST, LARGEST, "it in nm")
        if not self.spectrum:
            return self
        known_nm, share = np.transpose(self.spectrum)
        if not known_nm[0] <= wavelength_nm <= known_nm[-1]:
            raise InputError(
                f"sensor {self.name}: wavelength_nm is {wavelength_nm:g}, but its quantum"
                f" efficiency is known from {known_nm[0]:g} to {known_nm[-1]:g} nm; add it to the"
                " sensor's file"
            )
        return replace(self, quantum_efficiency=float(np.interp(wavelength_nm, known_nm, share)))


def _knee(knee: Any) -> tuple[float, float] | None:
    if knee is None:
        return None
    advice = "(share of the full well, times the range), such as (0.5, 6)"
    try:
        share, ratio = knee
    except (TypeError, ValueError):
        raise InputError(f"sensor: knee is {short(knee)}; give {advice}") from None
    share = number_within("sensor: knee's share", share, 1e-6, 1.0 - 1e-6, "it between 0 and 1")
    ratio = number_within("sensor: knee's range", ratio, 1.0 + 1e-6, 1e6, "it above 1")
    return share, ratio


def _spectrum(spectrum: Any) -> tuple[tuple[float, float], ...]:
    table = points_of("sensor: spectrum", spectrum, 2)
    if table.ndim != 2 or table.shape[1] != 2:
        raise InputError(
            f"sensor: spectrum is of shape {table.shape}; give rows of (wavelength in nm, quantum"
            " efficiency)"
        )
    if not (np.all(np.diff(table[:, 0]) > 0.0) and np.all(table[:, 0] > 0.0)):
        raise InputError(
            "sensor: the spectrum of quantum_efficiency has wavelengths in nm, above 0 and rising"
        )
    for wavelength_nm, share in table.tolist():
        name = f"sensor: spectrum of quantum_efficiency, at {wavelength_nm:g} nm"
        number_within(name, share, SMALLEST, 1.0, "it above 0 and up to 1")
    return tuple((nm, share) for nm, share in table.tolist())


# ------------------------------------------------------------------------- data sheets as files


def shipped_sensors() -> Path:
    """Folder of the data sheets that come with the program."""
    return Path(__file__).with_name("cameras")


@public
def image_sensors() -> tuple[str, ...]:
    """Names of the sensors that come with the program, each of a stated class."""
    return tuple(sorted(path.stem for path in shipped_sensors().glob("*.toml")))


@public
def image_sensor(name: str | Path) -> ImageSensor:
    """A sensor by its name, or by the path of its data sheet, a TOML file.

    Parameters
    ----------
    name : str or Path
        One of `image_sensors()`, or a path; a sensor is given back.

    Raises
    ------
    InputError
        If there is none, or its file says what can't be: it names the file, the key and the remedy.
    """
    if isinstance(name, ImageSensor):
        return name
    path = named_file(name, "image sensor", ".toml", [Path()], [shipped_sensors()])
    with naming(path):
        return _of_sheet(path.stem, _sheet(readable(path)))


def _sheet(path: Path) -> dict[str, Any]:
    if path.stat().st_size > _MOST_FILE_BYTES:
        raise InputError("is no data sheet of a sensor: it has more than 1 MB")
    try:
        return tomllib.loads(path.read_text(encoding="utf-8"))
    except (tomllib.TOMLDecodeError, UnicodeDecodeError, RecursionError) as error:
        raise InputError(f"is no TOML file ({cause_of(error)})") from None


def _of_sheet(name: str, sheet: dict[str, Any]) -> ImageSensor:
    known = [each.name for each in fields(ImageSensor) if each.name != "spectrum"]
    for key in sheet:
        if key not in known:
            words = nearest(key, known) or f"; known are {', '.join(known)}"
            raise InputError(f"sensor: there is no key '{key}'{words}")
    values = {"name": name} | sheet
    efficiency = sheet.get("quantum_efficiency")
    if isinstance(efficiency, dict):
        values["spectrum"] = sorted((_wavelength(nm), share) for nm, share in efficiency.items())
        if not values["spectrum"]:
            raise InputError("sensor: quantum_efficiency is empty; give a number, or rows by nm")
        known_nm, share = np.transpose(_spectrum(values["spectrum"]))
        values["quantum_efficiency"] = float(np.interp(_USUAL_NM, known_nm, share))
    return ImageSensor(**values)


def _wavelength(text: str) -> float:
    try:
        return float(text)
    except ValueError:
        raise InputError(
            f"sensor: quantum_efficiency has the key '{text}'; give wavelengths in nm, such as"
            " 532 = 0.6"
        ) from None
