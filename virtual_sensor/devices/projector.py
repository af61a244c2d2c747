"""A projector: a camera turned round, which rays of its family it lights, and by how much."""

from __future__ import annotations

import math
from dataclasses import dataclass, field, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import (
    LARGEST,
    SMALLEST,
    floor,
    number_for,
    number_within,
    truth_of,
    where,
    whole_number,
)
from virtual_sensor.calls import public
from virtual_sensor.devices.patterns import Pattern, Picture, Uniform
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, short
from virtual_sensor.optics.distortion import distorted
from virtual_sensor.optics.ray_families import PixelFamily
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

_MOST_BITS = 16
_BLURRED = 3.0  # standard deviations of the defocus, beyond which an edge is not felt
_BLUR_REACH = 4.0  # standard deviations of the defocus beyond which there is no light
_FINE, _LEAST_FINE = 64, 4  # samples a pixel of a blurred pattern along one axis
_COARSE, _MOST_COARSE = 4.0, 4  # samples a standard deviation, and a pixel, of one along both
_STEP = 2e-3  # of the image's width, for a distortion's derivatives
_ON_BORDER = 65  # places along each side of the image that show its extent


@public
@dataclass(frozen=True)
class Projector(Displayed):
    """A projector that shows a pattern.

    A grey value g leaves it as light 1/contrast + (1 - 1/contrast) g^gamma, of the full light 1;
    each of its pixels has an equal share of the power.

    Attributes
    ----------
    family : Pinhole or Telecentric
        Its rays, with its pixels: a camera's, turned round.
    pattern : Pattern
    power_w : float
        Of an all-white image.
    pixels : bool
        Whether it shows square pixels, each with the grey value at its centre; else the pattern
        itself, between pixel centres too.
    contrast : float
        Light of white over light of black; infinite: black is dark.
    gamma : float
        Light goes with the grey value to this power.
    bits : int
        To so many bits grey values are rounded; 0: not at all.
    defocus_px : float
        Standard deviation of the Gaussian that blurs the image, px.
    """

    family: PixelFamily
    pattern: Pattern = field(default_factory=Uniform)
    power_w: float = 1.0
    pixels: bool = True
    contrast: float = math.inf
    gamma: float = 1.0
    bits: int = 0
    defocus_px: float = 0.0

    def __post_init__(self) -> None:
        if not isinstance(self.pattern, Pattern):
            raise InputError(f"Projector: pattern is {short(self.pattern)}; give a Pattern")
        if not isinstance(self.family, PixelFamily) or self.family.fisheye:
            raise InputError("Projector: its family has no pixels; give a Pinhole or Telecentric")
        within = (
            ("power_w", SMALLEST, LARGEST, "a power above 0 W"),
            ("contrast", 1.0, math.inf, "white over black, from 1 on"),
            ("gamma", 0.01, 100.0, "an exponent from 0.01 to 100"),
            ("defocus_px", 0.0, 100.0, "a standard deviation of up to 100 px"),
        )
        for name, least, most, advice in within:
            number_within(f"Projector: {name}", getattr(self, name), least, most, advice)
        truth_of("Projector: pixels", self.pixels)
        whole_number("Projector: bits", self.bits, 0, _MOST_BITS)
        check_size(self.pattern, self.size)

    def _line(self) -> str:
        width, height = self.size
        pixels = f"{width} x {height} {'square ' * self.pixels}px"
        blur = f"blurred by {self.defocus_px:g} px" if self.defocus_px else ""
        kind = type(self.family).__name__.lower()
        return listed(kind, pixels, f"{self.pattern}", f"{self.power_w:g} W", blur)

    @property
    def size(self) -> tuple[int, int]:
        """Width and height, px."""
        return self.family.size

    @property
    def pose(self) -> Pose:
        """Of its lens: x along u, y along v, z forward."""
        return self.family.pose

    def with_pose(self, pose: Pose) -> Projector:
        """The same in another place."""
        return replace(self, family=self.family.with_pose(pose))

    def with_pattern(self, pattern: Pattern) -> Projector:
        """The same with another pattern."""
        return replace(self, pattern=pattern)

    @property
    def plane(self) -> tuple[Array, float]:
        """Unit normal (3,) and offset of the plane of its middle column: normal . x = offset."""
        normal, offset = self.family.plane(0.0)
        return normal, float(offset)

    @property
    def target_mm(self) -> Array:
        """About where things are measured: the middle ray's point nearest to the world's origin."""
        middle = np.array(self.size) / 2.0 - 0.5
        origin, direction = self.family.rays(*self.rays_of(*middle))
        return origin - (origin @ direction) * direction

    # ---------------------------------------------------------------- rays and pixels

    def pixels_of(self, s: Any, t: Any) -> tuple[Any, Any]:
        """Pixels (u, v) that light rays of coordinates (s, t), of NumPy's arrays as of Dr.Jit's."""
        K = self.family.matrix
        a, b, c, d, e, f = (number_for(s, float(k)) for k in K[:2].ravel())
        x, y = distorted(s, t, self.family.distortion)
        return a * x + b * y + c, d * x + e * y + f

    def rays_of(self, u: ArrayLike, v: ArrayLike) -> tuple[Array, Array]:
        """Coordinates (s, t) of the rays of pixels; NaN where a distortion can't be undone."""
        u, v = np.broadcast_arrays(np.asarray(u, float), np.asarray(v, float))
        return self.family.of_pixels(np.stack([u, v], axis=-1))

    @cached_property
    def extent(self) -> tuple[Array, Array]:
        """Lowest and highest (s, t) with light, each of shape (2,)."""
        ends = np.array(self.size) - 0.5 + self._beyond
        first = -0.5 - self._beyond
        u, v = (np.linspace(first, end, _ON_BORDER) for end in ends)
        sides = [(u, first), (u, ends[1]), (first, v), (ends[0], v)]
        around = np.concatenate([np.stack(self.rays_of(*side), axis=-1) for side in sides])
        if not np.isfinite(around).all():
            raise InputError(
                "Projector: its distortion folds the image; give coefficients that hold up to its"
                " corners"
            )
        return around.min(axis=0), around.max(axis=0)

    @property
    def _beyond(self) -> float:
        """How far beyond the image there is light, px."""
        return _BLUR_REACH * self.defocus_px

    @property
    def blurred_border_px(self) -> float:
        """Width of the image's border whose light blur mixes with the dark beside it, px."""
        return _BLURRED * self.defocus_px

    def reaches(
        self, s: Any, t: Any, margin: tuple[Any, Any] = (0.0, 0.0), depth: Any = None
    ) -> Any:
        """Mask of the coordinates with light, or near it; NaN has none.

        Of NumPy's arrays as of Dr.Jit's.  Light is all that may be shown: a black pixel counts.
        """
        low, high = self.extent
        return (
            (s >= number_for(s, float(low[0])) - margin[0])
            & (s <= number_for(s, float(high[0])) + margin[0])
            & (t >= number_for(t, float(low[1])) - margin[1])
            & (t <= number_for(t, float(high[1])) + margin[1])
        )

    # ---------------------------------------------------------------- light

    def flux(self, s: Any, t: Any, depth: Any = None) -> Any:
        """Power per unit of both coordinates, W; none outside the image, nor of NaN.

        Of NumPy's arrays as of Dr.Jit's, at any depth.
        """
        light = self.density(s, t) * self.shown(*self.pixels_of(s, t))
        return where(self.reaches(s, t), light, 0.0)

    def density(self, s: Any, t: Any) -> Any:
        """The flux of an all-white image, whatever of it lies outside: W per unit of both."""
        a, b, d, e = (float(k) for k in self.family.matrix[:2, :2].ravel())
        width, height = self.size
        even = number_for(s, self.power_w / (width * height) * abs(a * e - b * d))
        if not np.any(self.family.distortion):
            return even + 0.0 * s
        step = number_for(s, _STEP * width / abs(a))
        (x_1, y_1), (x_0, y_0), (x_3, y_3), (x_2, y_2) = (
            distorted(*place, self.family.distortion)
            for place in ((s + step, t), (s - step, t), (s, t + step), (s, t - step))
        )
        area = (x_1 - x_0) * (y_3 - y_2) - (x_3 - x_2) * (y_1 - y_0)
        return even * abs(area) / (4.0 * step * step)

    def shown(self, u: Any, v: Any) -> Any:
        """The light at places in px, of an all-white pixel's 1; none outside the image.

        Of NumPy's arrays as of Dr.Jit's.
        """
        if self.defocus_px:
            return self._defocused(u, v)
        width, height = (number_for(u, float(n)) for n in self.size)
        inside = (u >= -0.5) & (u < width - 0.5) & (v >= -0.5) & (v < height - 0.5)
        return where(inside, self._sharp(u, v), 0.0)

    def _sharp(self, u: Any, v: Any) -> Any:
        """The light of the image without its border or its defocus."""
        if self.pixels:
            u, v = floor(u + 0.5), floor(v + 0.5)
        grey = self.pattern.grey(u, v)
        if self.bits:
            levels = number_for(u, 2.0**self.bits - 1.0)
            grey = floor(grey * levels + 0.5) / levels
        if self.gamma != 1.0:
            grey = where(grey > 0.0, grey, 0.0) ** number_for(u, self.gamma)
        black = number_for(u, 1.0 / self.contrast)
        return black + (1.0 - black) * grey

    # ---------------------------------------------------------------- defocus

    def _defocused(self, u: Any, v: Any) -> Any:
        """As `shown`, by tables of the blurred image."""
        light: Any = 1.0
        for image, fine in self._blurred:
            first = number_for(u, 0.5 + self._pad)
            light = light * image.grey(*((x + first) * fine - 0.5 for x in (u, v)))
        return where((u == u) & (v == v), light, 0.0)

    @cached_property
    def _blurred(self) -> list[tuple[Picture, float]]:
        """Images whose product is the blurred one, and how fine they are, in samples a pixel.

        What varies along one axis is a fine row, times the blurred border along the other.
        """
        sharp, sigma = replace(self, defocus_px=0.0), self.defocus_px
        axis = "u" if isinstance(self.pattern, Uniform) else self.pattern.axis
        if axis is None:
            fine = min(math.ceil(_COARSE / sigma), _MOST_COARSE)
            alike = fine if self.pixels else 1  # places within a pixel, which have one light
            places = [self._places(count, fine // alike) for count in self.size]
            image = np.asarray(sharp.shown(*np.meshgrid(*places)), np.float32)
            image = image.repeat(alike, axis=0).repeat(alike, axis=1)
            kernel = _gaussian(sigma * fine)
            image = cv2.sepFilter2D(image, -1, kernel, kernel, borderType=cv2.BORDER_CONSTANT)
            return [(_picture(image), float(fine))]
        fine = math.ceil(min(max(_FINE / sigma, _LEAST_FINE), _FINE))
        kernel = _gaussian(sigma * fine)
        across, down = (self._places(count, fine) for count in self.size)
        white = replace(sharp, pattern=Uniform(), contrast=math.inf)
        of_u, of_v = (sharp, white) if axis == "u" else (white, sharp)
        row = np.asarray(of_u.shown(across, 0.0 * across), float)
        column = np.asarray(of_v.shown(0.0 * down, down), float)
        row, column = (np.convolve(line, kernel, "same") for line in (row, column))
        return [(_picture(image), float(fine)) for image in (row[None], column[:, None])]

    @property
    def _pad(self) -> int:
        """Whole pixels beside the image in tables."""
        return math.ceil(self._beyond) + 1

    def _places(self, count: int, fine: int) -> Array:
        """Middles of the cells of a table of so many pixels, and of those beside them, px."""
        cells = (count + 2 * self._pad) * fine
        return (np.arange(cells) + 0.5) / fine - 0.5 - self._pad


def _gaussian(sigma: float) -> Array:
    """A Gaussian's weights over cells of width 1, up to its reach; their sum is 1."""
    half = math.ceil(_BLUR_REACH * sigma)
    edges = (np.arange(2 * half + 2) - half - 0.5) / (math.sqrt(2.0) * sigma)
    weights = np.diff([math.erf(edge) for edge in edges.tolist()])
    return weights / weights.sum()


def _picture(light: Array) -> Picture:
    """A table of light."""
    return Picture(np.clip(light, 0.0, 1.0))


def check_size(pattern: Pattern, size: tuple[int, int]) -> None:
    """Raise InputError if a pattern is an image of another size than the projector's."""
    if not isinstance(pattern, Picture):
        return
    height, width = pattern.values.shape
    if (width, height) != size:
        name = f"the image {pattern.name}" if pattern.name else "the pattern"
        raise InputError(
            f"{name} is {width} x {height} px, and the projector has {size[0]} x {size[1]} px;"
            " give an image of the projector's size"
        )
