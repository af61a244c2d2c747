"""Laser speckle on a frame: coherent imaging of a rough surface by a round aperture.

The surface scatters the light with random phase: its field is the square root of the ideal frame
times circular complex Gaussian noise, without correlation.  The aperture passes the field's
frequencies up to 1/(2 lambda N), N the working f-number; the intensity is the field's square, and
the pixels integrate it.  Contrast and grain so follow from aperture and wavelength, and the mean of
many frames is the ideal frame blurred by diffraction.  Goodman 2007, "Speckle phenomena in optics",
chapters 3 to 5.

Light is coherent only in part where the surface depolarises it, where its wavelengths see the
surface's depth by different numbers of waves, or where the laser has several modes: patterns that
differ add, and contrast falls by 1/sqrt(their number) while the grains stay as large (chapter 5
there).

Limits: fully developed speckle, no aberration but defocus.  Light of other sources is added
afterwards.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import asdict, dataclass, replace
from itertools import pairwise, product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.fft import fft, fftfreq, ifft, ifft2, irfft2, next_fast_len, rfft2, rfftfreq
from scipy.integrate import quad
from scipy.special import j1, struve

from virtual_sensor.arrays import (
    LARGEST,
    SMALLEST,
    generator_of,
    image_of,
    number_within,
    numbers_of,
)
from virtual_sensor.calls import public
from virtual_sensor.devices.coherence import Coherence, weights_of
from virtual_sensor.errors import InputError, naming, short
from virtual_sensor.optics.lens import Lens
from virtual_sensor.seeds import LARGEST_SEED

Array = NDArray[np.float64]
Box = tuple[slice, slice]

_APRON_GRAINS = 8  # about what is lit, and about each window; 1 % of the light is scattered farther
_WINDOW = 128  # px: width of the strips in which lit runs are looked for, and their most height
_MOST_SAMPLES = 1 << 22  # of a window
_LARGEST_PX = 32  # grain
_MOST_FINE = 32  # samples per pixel's side
_MOST_PATTERNS = 256
_BLOCK = 8, 16  # px, rows and columns: of the surface, each with random numbers of its own
_AT_ONCE = 4  # windows
_FAINT = 1e-5  # of the mean image's brightest pixel
_MOST_FACTOR = 4.0  # between a blurred image and that which defocus makes of the sharp one
_MISSED = 0.05  # of the light
_DARK = 1e-30  # of the brightest pixel
_AIRY_ZERO = 1.2197  # of 2 J1(pi x)/(pi x)


@public
@dataclass(frozen=True)
class Aperture(Coherence):
    """What the camera's lens lets through, and how coherent the light is: together the speckle.

    Attributes
    ----------
    f_number : float
    wavelength_nm : float
    pixel_um : float
        Pitch of the pixels.
    magnification : float
        Image over object; the working f-number is N (1 + m).
    polarisations, linewidth_nm, roughness_um, modes
        As those of a laser line's `Coherence`.
    """

    f_number: float
    wavelength_nm: float = 532.0
    pixel_um: float = 5.5
    magnification: float = 0.0

    def __post_init__(self) -> None:
        for name in ("f_number", "pixel_um"):
            number_within(f"aperture: {name}", getattr(self, name), SMALLEST, LARGEST, "it above 0")
        number_within("aperture: wavelength_nm", self.wavelength_nm, 1.0, 1e6, "it from 1 to 1e6")
        number_within("aperture: magnification", self.magnification, 0.0, LARGEST, "it from 0 on")
        with naming("aperture"):
            super().__post_init__()

    @staticmethod
    def of(
        lens: Lens, pixel_um: float, wavelength_nm: float, coherence: Coherence | None = None
    ) -> Aperture:
        """That of a lens and its sensor, in light of a laser line's `coherence`."""
        return Aperture(
            lens.f_number,
            wavelength_nm,
            pixel_um,
            lens.magnification,
            **({} if coherence is None else asdict(coherence)),
        )

    @property
    def resolution_px(self) -> float:
        """Wavelength times working f-number, lambda N, in px: the inverse of the cutoff."""
        working = self.f_number * (1.0 + self.magnification)
        return self.wavelength_nm * 1e-3 * working / self.pixel_um

    @property
    def grain_px(self) -> float:
        """Radius of a speckle: first zero of the intensity's correlation, 1.22 lambda N."""
        return _AIRY_ZERO * self.resolution_px

    @property
    def patterns(self) -> float:
        """Number of equal patterns that would have the contrast of all that add."""
        return self.patterns_at(self.wavelength_nm)

    def moved(self, path_px: float) -> Aperture:
        """The same where the surface moves so far in the image during the exposure, evenly.

        Its patterns add: the squared contrast is the mean of the correlation over all pairs of
        instants, 2 (1 - t) |2 J1/x|^2 over t from 0 to 1 at the distance t `path_px`.  They are
        counted as modes.
        """
        path = number_within("aperture: path_px", path_px, 0.0, LARGEST, "it in px, from 0 on")
        if path < 1e-9 * self.resolution_px:
            return self
        ends = np.clip(np.arange(12.0) ** 2 * self.resolution_px / path, 0.0, 1.0)

        def pairs(t: float) -> float:
            return 2.0 * (1.0 - t) * float(self.correlation(t * path))

        return replace(self, modes=self.modes / _integral(pairs, [*ends, 1.0]))

    def correlation(self, distance_px: ArrayLike) -> Array:
        """Correlation of the intensity on the sensor, |2 J1(x)/x|^2: Goodman 2007, 4.4."""
        x = np.pi * np.asarray(distance_px, float) / self.resolution_px
        small = np.abs(x) < 1e-6
        return np.where(small, 1.0, (2.0 * j1(x) / np.where(small, 1.0, x)) ** 2)

    @property
    def contrast(self) -> float:
        """Standard deviation over mean of the pixels' grey values where the light is even.

        C^2 = integral of (1 - |x|)(1 - |y|) |2 J1/r|^2 over the pixel, over the number of
        patterns: Goodman 2007, 4.6.  The sum over directions is done first, so that one integral
        is left.
        """

        def ring(r: float) -> float:
            """Integral of the triangles over a circle of radius r."""
            if r <= 1.0:
                return r * (2.0 * np.pi - 8.0 * r + 2.0 * r**2)
            low = np.arccos(1.0 / r)
            if low >= np.pi / 4.0:
                return 0.0
            ends = np.array([low, np.pi / 2.0 - low])
            parts = ends - r * (np.sin(ends) - np.cos(ends)) + 0.5 * r**2 * np.sin(ends) ** 2
            return 4.0 * r * float(parts[1] - parts[0])

        edges = np.clip(np.arange(0.0, 3.0, 0.5 * self.resolution_px), 0.0, np.sqrt(2.0))
        ends = [*edges, 1.0, np.sqrt(2.0)]
        total = _integral(lambda r: ring(r) * float(self.correlation(r)), ends)
        return float(np.sqrt(total / self.patterns))


def _integral(function: Callable[[float], float], edges: list[float]) -> float:
    """Integral of a function that is smooth between the edges, from the first to the last."""
    between = pairwise(np.unique(edges))
    return float(sum(quad(function, a, b, limit=200)[0] for a, b in between))


@public
def speckled(
    image: ArrayLike,
    aperture: Aperture,
    seed: int | np.random.Generator = 0,
    blur_px: ArrayLike = 0.0,
    sharp: ArrayLike | None = None,
) -> Array:
    """An image (H, W) as coherent light shows it: with speckle, in the same unit.

    What lies within 8 grains of lit pixels is computed, the rest is dark.  At the image's borders
    the light goes on outside as it is on them.

    Parameters
    ----------
    image : array_like of shape (H, W)
        The ideal frame, of incoherent light: the laser's alone.
    aperture : Aperture
    seed : int or numpy.random.Generator
        Of the surface: the same seed gives the same bits.  Each pixel has scatterers of its own,
        whatever else is lit: light that moves on a surface at rest finds it as it was.
    blur_px : float or array_like of shape (H, W)
        Radius of the circle of confusion, where defocus blurs the light: a thin line's grains are
        drawn out across it.  An image of radii is averaged over each window of 128 px.
    sharp : array_like of shape (H, W), optional
        The ideal frame of a lens that is in focus everywhere, where `image` is already blurred: the
        mean of the speckle stays the image's.  By default the image is the sharp one.  Where such
        blur of `sharp` can't be `image`, as that of motion can't, the image itself is speckled.

    Raises
    ------
    InputError
        Where the image has another shape, or holds what is negative or no number; where the grains
        are finer than a 16th of a pixel or larger than 32 of them, or more patterns add than are
        worth simulating.
    """
    if not isinstance(aperture, Aperture):
        raise InputError(f"speckled: aperture is {short(aperture)}; give an Aperture")
    if hasattr(image, "detector_options"):
        raise InputError("speckled: image is of grey values already; give the ideal frame")
    image = image_of("speckled: image", image, 0.0)
    source = image if sharp is None else image_of("speckled: sharp", sharp, 0.0)
    if source.shape != image.shape:
        raise InputError(
            f"speckled: sharp is of shape {source.shape}, and image of {image.shape}; give it alike"
        )
    blur = _blur_of(blur_px, image.shape)
    fine = _fineness(aperture)
    key = int(generator_of("speckled: seed", seed).integers(LARGEST_SEED + 1))
    seen = np.zeros(image.shape)
    brightest = image.max(initial=0.0)
    if not brightest:
        return seen
    lit = (image > _DARK * brightest) | (source > _DARK * brightest)
    apron = int(np.ceil(_APRON_GRAINS * aperture.grain_px + blur[lit].max())) + 2

    def fill(box: Box) -> None:
        near = _lit_about(box, lit, apron)
        light = _samples(_at(source, near, 1) / brightest, fine)
        radius = float(np.average(_at(blur, near), weights=_at(source, near) + SMALLEST))
        pupil = _Pupil.of(aperture, fine, radius, box, near, apron)
        factor: NDArray[np.float32] | float = 1.0
        if sharp is not None:
            plain = _Pupil.of(aperture, fine, 0.0, box, near, apron)
            shown = _samples(_at(image, near, 1) / brightest, fine)
            factor = _factor(_pixels(plain.mean(shown), fine), _pixels(pupil.mean(light), fine))
            if np.isnan(factor).any():
                light, pupil, factor = shown, plain, 1.0
        surface = _Surface.of(light, key, near, fine)
        total = np.zeros([fine * (side.stop - side.start) + 2 for side in box], np.float32)
        for part in weights_of(aperture.patterns):
            field = pupil.passes(surface.scatters())
            total += np.float32(part) * (field.real**2 + field.imag**2)
        seen[box] = brightest * factor * _pixels(total, fine)

    with ThreadPoolExecutor(_AT_ONCE) as threads:  # NumPy and SciPy run beside each other
        deque(threads.map(fill, _windows(lit, apron, fine)), maxlen=0)
    return seen


def _fineness(aperture: Aperture) -> int:
    """Samples per pixel's side, by Nyquist for the intensity; refuses what is too much work."""
    fine = max(2, int(np.ceil(2.0 / aperture.resolution_px)))
    if fine > _MOST_FINE:
        raise InputError(
            f"speckled: {fine} grains to a pixel's side are too many to simulate, and their"
            f" contrast is {aperture.contrast:.2g}; leave speckle out, or make f_number larger"
        )
    if aperture.patterns > _MOST_PATTERNS:
        raise InputError(
            f"speckled: {aperture.patterns:.3g} patterns that add are too many to simulate, and"
            f" their contrast is {aperture.contrast:.2g}; leave speckle out, or make linewidth_nm,"
            " roughness_um or modes smaller"
        )
    if aperture.grain_px > _LARGEST_PX:
        raise InputError(
            f"speckled: grains of {aperture.grain_px:.3g} px are too large to simulate; make"
            f" f_number or wavelength_nm smaller (up to {_LARGEST_PX} px)"
        )
    return fine


def _factor(wanted: NDArray[np.float32], made: NDArray[np.float32]) -> NDArray[np.float32]:
    """What makes one mean image of another; NaN where blur alone can't have made it."""
    factor = np.clip(wanted / np.maximum(made, _FAINT * wanted.max() + SMALLEST), 0.0, _MOST_FACTOR)
    missed = np.abs(factor * made - wanted).sum()
    return factor if missed <= _MISSED * wanted.sum() else np.full_like(factor, np.nan)


def _blur_of(blur_px: ArrayLike, shape: tuple[int, ...]) -> Array:
    """Radius of each pixel's blur, (H, W), checked."""
    blur = numbers_of("speckled: blur_px", blur_px)
    most = min(shape, default=0) / 2.0 + 1.0
    if blur.shape not in ((), shape) or not np.all((blur >= 0.0) & (blur <= most)):
        raise InputError(
            f"speckled: blur_px is {short(blur_px)}; give a radius in px, or an image of radii of"
            f" shape {shape}, from 0 up to half the image"
        )
    return np.broadcast_to(blur, shape)


def _windows(lit: NDArray[np.bool_], apron: int, fine: int) -> Iterator[Box]:
    """Boxes that hold all pixels within an apron of lit ones: strips across the longer side."""
    rows, columns = (np.flatnonzero(lit.any(axis=axis)) for axis in (1, 0))
    if np.ptp(rows) > np.ptp(columns):
        yield from ((rows, columns) for columns, rows in _windows(lit.T, apron, fine))
        return
    height, width = lit.shape
    side = max(_WINDOW, 2 * apron)
    most = max(_MOST_SAMPLES // (fine**2 * (side + 2 * apron)) - 2 * apron, _BLOCK[0], apron)
    first, last = max(columns[0] - apron, 0), min(columns[-1] + apron + 1, width)
    for left in range(first - first % side, last, side):
        strip = lit[rows[0] : rows[-1] + 1, max(left - apron, 0) : left + side + apron]
        found = rows[0] + np.flatnonzero(strip.any(axis=1))
        for run in np.split(found, np.flatnonzero(np.diff(found) > 2 * apron) + 1):
            if run.size:
                top, bottom = max(run[0] - apron, 0), min(run[-1] + apron + 1, height)
                for high in range(top, bottom, min(most, side)):
                    low = min(high + min(most, side), bottom)
                    yield slice(high, low), slice(max(left, first), min(left + side, last))


def _lit_about(box: Box, lit: NDArray[np.bool_], apron: int) -> Box:
    """The box of what is lit within an apron of a window; beyond the image as on its borders."""
    near = _at(lit, box, apron)
    rows, columns = (
        slice(side.start - apron + int(found[0]), side.start - apron + int(found[-1]) + 1)
        for side, axis in zip(box, (1, 0), strict=True)
        if (found := np.flatnonzero(near.any(axis=axis))).size
    )
    return rows, columns


def _at(image: NDArray, box: Box, margin: int = 0) -> NDArray:
    """An image in a box that may reach beyond it, where it goes on as on its borders."""
    inside = (
        np.clip(np.arange(side.start - margin, side.stop + margin), 0, size - 1)
        for side, size in zip(box, image.shape, strict=True)
    )
    return image[np.ix_(*inside)]


@dataclass(frozen=True)
class _Surface:
    """The lit part of a rough surface: blocks with random numbers of their own, by counters.

    Attributes
    ----------
    amplitude : ndarray of float32
        Of the light in its samples.
    blocks : list
        Of each lit block the samples, where they lie in the block, and the generator.
    shape : tuple of int
        Samples of a block, as real and imaginary parts.
    """

    amplitude: NDArray[np.float32]
    blocks: list[tuple[Box, Box, np.random.Generator]]
    shape: tuple[int, int]

    @staticmethod
    def of(light: NDArray[np.float32], key: int, near: Box, fine: int) -> _Surface:
        """From the light in the samples of a box of pixels."""
        amplitude = np.sqrt(light)
        height, width = (fine * size for size in _BLOCK)
        rows = _cut(fine * near[0].start, len(amplitude), height)
        columns = _cut(fine * near[1].start, amplitude.shape[1], width)
        blocks = [
            ((v, u), (of_v, of_u), _numbers_of(key, row, column))
            for (row, v, of_v), (column, u, of_u) in product(rows, columns)
            if amplitude[v, u].any()
        ]
        return _Surface(amplitude, blocks, (height, 2 * width))

    def scatters(self) -> NDArray[np.complex64]:
        """The field of the next pattern: circular complex Gaussian, by its light."""
        field = np.zeros(self.amplitude.shape, np.complex64)
        for here, within, numbers in self.blocks:
            drawn = numbers.standard_normal(self.shape, np.float32).view(np.complex64)
            np.multiply(self.amplitude[here], drawn[within], out=field[here])
        return field


def _cut(start: int, many: int, size: int) -> list[tuple[int, slice, slice]]:
    """Numbers of the blocks that hold so many samples from `start` on, which they hold and where.

    The samples are counted from `start`, and from the block's own first.
    """
    cuts = []
    for number in range(start // size, (start + many - 1) // size + 1):
        first = number * size - start
        low, high = max(first, 0), min(first + size, many)
        cuts.append((number, slice(low, high), slice(low - first, high - first)))
    return cuts


def _numbers_of(key: int, row: int, column: int) -> np.random.Generator:
    """Random numbers of one block of the surface; its row and its column may be below 0."""
    counter = np.array([0, 0, row % 2**64, column % 2**64], np.uint64)
    return np.random.Generator(np.random.Philox(key=key, counter=counter))


@dataclass(frozen=True)
class _Pupil:
    """How the aperture passes a field from one box to another, by Fourier transforms.

    Attributes
    ----------
    sizes : tuple of int
        Samples of the transforms: nothing comes round from within an apron.
    kept : tuple of ndarray
        Numbers of the frequencies, of rows and of columns, that the aperture lets through.
    factors : ndarray
        What it makes of each of them, so that the light keeps its power.
    wanted : tuple of ndarray
        Numbers of the window's samples, and of one more on each side.
    """

    sizes: list[int]
    kept: list[NDArray[np.intp]]
    factors: NDArray[np.complex64]
    wanted: list[NDArray[np.intp]]

    @classmethod
    def of(
        cls, aperture: Aperture, fine: int, blur_px: float, box: Box, near: Box, apron: int
    ) -> _Pupil:
        """From the lit pixels near a window to the window; defocus is a phase on the pupil."""
        both = list(zip(box, near, strict=True))
        reach = (max(to.stop - by.start, by.stop - to.start) + apron for to, by in both)
        sizes = [next_fast_len(fine * pixels) for pixels in reach]
        wanted = [
            np.arange(fine * (to.start - by.start) - 1, fine * (to.stop - by.start) + 1) % size
            for (to, by), size in zip(both, sizes, strict=True)
        ]
        cutoff = 0.5 / aperture.resolution_px
        frequencies = [fftfreq(size) * fine for size in sizes]
        kept = [np.flatnonzero(np.abs(each) <= cutoff) for each in frequencies]
        v, u = (each[of] ** 2 for each, of in zip(frequencies, kept, strict=True))
        square = v[:, None] + u
        factors = (square <= cutoff**2) * np.exp(1j * np.pi * blur_px / cutoff * square)
        factors *= np.sqrt(0.5 * sizes[0] * sizes[1] / np.sum(square <= cutoff**2))
        return cls(sizes, kept, factors.astype(np.complex64), wanted)

    def passes(self, field: NDArray[np.complex64]) -> NDArray[np.complex64]:
        """The field behind the aperture, at the window's samples.

        Only frequencies that pass are transformed in both directions.
        """
        (height, width), (v, u), (rows, columns) = self.sizes, self.kept, self.wanted
        spectrum = fft(fft(field, height, axis=0)[v], width, axis=1)[:, u] * self.factors
        of_rows = np.zeros((v.size, width), np.complex64)
        of_rows[:, u] = spectrum
        of_columns = np.zeros((height, columns.size), np.complex64)
        of_columns[v] = ifft(of_rows, axis=1, overwrite_x=True)[:, columns]
        return ifft(of_columns, axis=0, overwrite_x=True)[rows]

    def mean(self, light: NDArray[np.float32]) -> NDArray[np.float32]:
        """Mean intensity over all surfaces, at the window's samples, of light in the samples."""
        all_of_them = np.zeros(self.sizes, np.complex64)
        all_of_them[np.ix_(*self.kept)] = self.factors
        point = ifft2(all_of_them)
        spread = 2.0 * (point.real**2 + point.imag**2)
        seen = irfft2(rfft2(light, self.sizes) * rfft2(spread), self.sizes)
        return np.maximum(seen, 0.0)[np.ix_(*self.wanted)]


def _samples(light: Array, fine: int) -> NDArray[np.float32]:
    """Light in the samples of pixels (h, w), of which the outer ones only serve the others."""
    return _finer(_finer(light, fine).T, fine).T.astype(np.float32)


def _pixels(samples: NDArray[np.float32], fine: int) -> NDArray[np.float32]:
    """Light of pixels by their samples and one more on each side."""
    return _integrated(_integrated(samples, fine).T, fine).T


def _finer(image: Array, fine: int) -> Array:
    """Split each row but the outer ones in `fine` whose mean it is, smoothly and not below 0.

    The running sum is interpolated by monotone cubics (Fritsch and Butland 1984): between rows its
    slope is their harmonic mean. In closed form, as rows are as far apart as others.
    """
    s = (np.arange(fine + 1) / fine)[:, None]
    of_row, of_slope, of_next = (
        fine * np.diff(basis, axis=0)
        for basis in (s**2 * (3.0 - 2.0 * s), s * (1.0 - s) ** 2, s**2 * (s - 1.0))
    )
    both = image[:-1] + image[1:]
    slope = 2.0 * image[:-1] * image[1:] / np.where(both > 0.0, both, 1.0)
    row, before, after = image[1:-1, None], slope[:-1, None], slope[1:, None]
    parts = of_row * row + of_slope * before + of_next * after
    return np.maximum(parts, 0.0).reshape(fine * len(row), -1)


def _integrated(samples: NDArray, fine: int) -> NDArray:
    """Mean of each `fine` rows between the outer two: midpoint rule with its h^2 term, i''/24."""
    inner = samples[1:-1].reshape(-1, fine, samples.shape[1])
    slopes = np.diff(samples, axis=0)[::fine]  # at the pixels' borders
    return np.maximum(inner.mean(axis=1) + np.diff(slopes, axis=0) / np.float32(24 * fine), 0.0)


@public
def diffraction_blur(image: ArrayLike, aperture: Aperture) -> Array:
    """An image (H, W) of incoherent light behind an aperture: what speckle is in the mean.

    Its spectrum times the transfer function of a round aperture, the overlap of two discs: Goodman
    2017, "Introduction to Fourier optics", 7.3.  Beyond the image's borders it is dark.

    Parameters
    ----------
    image : array_like of shape (H, W)
    aperture : Aperture

    Raises
    ------
    InputError
        If the image has another shape, or a number is not finite.
    """
    image = image_of("diffraction_blur: the image", image)
    if not isinstance(aperture, Aperture):
        raise InputError(f"diffraction_blur: aperture is {short(aperture)}; give an Aperture")
    if not image.size:
        return image
    apron = int(np.ceil(_APRON_GRAINS * aperture.grain_px)) + 2
    shape = [next_fast_len(size + apron, real=True) for size in image.shape]
    square = fftfreq(shape[0])[:, None] ** 2 + rfftfreq(shape[1]) ** 2
    part = np.minimum(np.sqrt(square) * aperture.resolution_px, 1.0)
    passed = 2.0 / np.pi * (np.arccos(part) - part * np.sqrt(1.0 - part**2))
    spectrum = rfft2(image, shape, workers=-1) * passed
    seen = irfft2(spectrum, shape, workers=-1)[: image.shape[0], : image.shape[1]]
    return np.maximum(seen, 0.0) if image.min() >= 0.0 else seen


def broad_line_noise_px(aperture: Aperture, width_px: float) -> float:
    """Standard deviation of each column's centre of gravity of a line much broader than a speckle.

    `width_px` is the Gaussian line's standard deviation in the image.  A column holds independent
    grains of length S = integral of the intensity's correlation along v, averaged over the pixel's
    width: var = S w/(4 sqrt(pi)), from S integral of x^2 I^2 over (integral of I)^2 with
    I = exp(-x^2/(2 w^2)), over the number of patterns (the correlation: Goodman 2007, 4.4).  The
    noise grows with the line's width.  Along v, |2 J1/r|^2 adds up to 4 H1(2x)/x^2, H1 Struve's:
    the diffraction image of a line.
    """

    def line_spread(u: float) -> float:
        x = np.pi * u / aperture.resolution_px
        return float(4.0 * struve(1, 2.0 * x) / x**2) if x > 1e-6 else 32.0 / (3.0 * np.pi)

    edges = np.clip(np.array([0.0, 1.0, 4.0, 16.0]) * aperture.resolution_px, 0.0, 1.0)
    overlap = _integral(lambda u: 2.0 * (1.0 - u) * line_spread(u), [*edges, 1.0])
    length = aperture.resolution_px / np.pi * overlap
    return float(np.sqrt(length * width_px / (4.0 * np.sqrt(np.pi)) / aperture.patterns))
