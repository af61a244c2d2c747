"""Phase shifting: sinusoidal fringes in N equal steps, of one or several periods.

Step k of N shows A + B cos(phi - 2 pi k/N).  The arctangent of the two sums that least squares
give is the phase; its noise is sigma_phi = sqrt(2/N) sigma/B (Surrel 1997, Applied Optics 36, 271).
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import number_within, one_of, whole_number
from virtual_sensor.calls import public
from virtual_sensor.devices.patterns import AXES, GrayBit, Pattern, Sine
from virtual_sensor.errors import InputError, short
from virtual_sensor.metrology.fringes.codec import (
    NOISIEST_PHASE_RAD,
    AxisBlock,
    Block,
    Codec,
    Found,
    GreyNoise,
    checked_axes,
    checked_size,
    described,
    unwrap_in_space,
)
from virtual_sensor.metrology.fringes.gray_code import position
from virtual_sensor.metrology.fringes.unwrapping import Chain, heterodyne, hierarchical

UNWRAP = ("hierarchical", "heterodyne", "gray", "spatial", "none")
SPATIAL = ("spatial", "none")

_FINEST_PX, _RATIO, _MOST_RATIO = 16.0, 8.0, 16.0
_FEWEST_STEPS, _MOST_STEPS, _MOST_PERIODS = 3, 64, 6
_LONGEST_PX = 1e6
_MISFIT = 2.0  # noises: what steps leave over beyond it is no noise
_NO_COSINE = 0.01  # of the modulation: what steps leave over below it does no harm
_MOST_WRONG = 1e-3  # share of the fringe orders that goes without a note
_SAMPLE_PX = 40_000
_TURN = 2.0 * math.pi


@public
@dataclass(frozen=True, kw_only=True)
class PhaseShift(Codec):
    """Sinusoidal fringes in N steps, of one or several periods along one axis or both.

    Step k, from 0 on, shows 0.5 + 0.5 cos(2 pi (x + 0.5)/period + first phase - 2 pi k/N).
    The images are those of the columns first (axes "uv"), period by period as given, step by step;
    with "gray" the bits follow an axis's steps, the coarsest first.

    Attributes
    ----------
    size_px : tuple of int
        (W, H) of the projector.
    steps : int
        N, from 3 on.  Four and more pass on shot noise evenly, more of them suffer less from gamma.
    periods_px : tuple of float or None
        Of the fringes.  By default 16 px, then each 8 times the last, up to the whole image.
    axes : str
        "uv": columns and rows; "u" or "v": one of them.
    unwrap : str
        How the fringe order is found.  "hierarchical": by the periods, the longest of which spans
        the image; "heterodyne": by their beats; "gray": by Gray code, with the shortest period
        alone; "spatial": from pixel to pixel, but for whole periods; "none": not at all.
    first_phase_deg : float
        Of all fringes at the image's left or top border, in the first step: -90 of sines.
    """

    size_px: tuple[int, int] = (1280, 800)
    steps: int = 4
    periods_px: tuple[float, ...] | None = None
    axes: str = "uv"
    unwrap: str = "hierarchical"
    first_phase_deg: float = 0.0

    def __post_init__(self) -> None:
        size = checked_size(self.size_px)
        axes = checked_axes(self.axes)
        steps = whole_number("steps", self.steps, _FEWEST_STEPS, _MOST_STEPS)
        one_of("unwrap", self.unwrap, UNWRAP)
        number_within("first_phase_deg", self.first_phase_deg, -360.0, 360.0, "-360 to 360 degrees")
        periods = self._checked_periods(max(size[AXES.index(axis)] for axis in axes))
        given = {"size_px": size, "axes": axes, "steps": steps, "periods_px": periods}
        for name, value in given.items():
            object.__setattr__(self, name, value)
        if self.unwrap not in SPATIAL:
            self.chains  # noqa: B018  refuse what can't be unwrapped

    def _checked_periods(self, size: int) -> tuple[float, ...]:
        given: Any = self.periods_px
        usual = default_periods(size)
        if given is None:
            return usual if self.unwrap == "hierarchical" else usual[:1]
        given = given if isinstance(given, Sequence) or np.ndim(given) else (given,)
        advice = f"periods from 2 px on, such as {_listed(usual)}"
        if isinstance(given, str) or not 1 <= len(given) <= _MOST_PERIODS:
            raise InputError(f"periods_px is {short(given)}; give 1 to {_MOST_PERIODS} {advice}")
        periods = tuple(
            number_within("periods_px", each, 2.0, _LONGEST_PX, advice) for each in given
        )
        if len(set(periods)) < len(periods):
            raise InputError(f"periods_px is {short(given)}: one is there twice; leave it out")
        if len(periods) > 1 and self.unwrap in ("gray", *SPATIAL):
            raise InputError(
                f"periods_px: unwrap '{self.unwrap}' takes one period; give the shortest,"
                f" {min(periods):g}, or unwrap='hierarchical'"
            )
        return periods

    @cached_property
    def chains(self) -> dict[str, Chain]:
        """How each axis is unwrapped in time.

        Raises
        ------
        InputError
            If it can't be, with the remedy.
        """
        found = {}
        for axis in self.axes:
            size = self.axis_px(axis)
            if self.unwrap == "gray":
                found[axis] = hierarchical(self._periods)
                continue
            what = f"the image's {size} {'columns' if axis == 'u' else 'rows'}"
            if self.unwrap == "heterodyne":
                chain = heterodyne(self._periods, size)
                if chain is None:
                    raise InputError(
                        f"periods_px: no beat of {_listed(self._periods)} px is as long as {what};"
                        " take periods nearer to each other (their product over their difference is"
                        f" the beat), add one, or one of {size:g} px with unwrap='hierarchical'"
                    )
            else:
                chain = hierarchical(self._periods)
                if chain.range_px < size:
                    raise InputError(
                        f"periods_px: the longest, {chain.range_px:g} px, is shorter than {what};"
                        f" add one of {size:g} px, or take unwrap='heterodyne', 'gray' or 'spatial'"
                    )
            found[axis] = chain
        return found

    @property
    def _periods(self) -> tuple[float, ...]:
        assert self.periods_px is not None
        return self.periods_px

    def _line(self) -> str:
        periods = f"{self.steps} steps of {_listed(self._periods)} px"
        return described(self, periods, f"axes {self.axes}", self.unwrap)

    @property
    def text(self) -> str:
        """The codec as `codec_of` takes it."""
        how = "" if self.unwrap == "hierarchical" else f" {self.unwrap}"
        periods = ",".join(f"{each:.12g}" for each in self._periods)
        start = f" {self.first_phase_deg:.12g}deg" if self.first_phase_deg else ""
        return f"phase {self.steps} {periods} {self.axes}{how}{start}"

    def _patterns_of(self, axis: Any) -> Iterator[tuple[str, Pattern]]:
        for period in self._periods:
            for k in range(self.steps):
                name = f"{axis} {period:g} px, step {k + 1} of {self.steps}"
                yield name, Sine(axis, period, _TURN * k / self.steps - self._first_rad)
        for bit in self.bits_of(axis):
            yield f"{axis} Gray bit {bit}", GrayBit(axis, bit)

    def bits_of(self, axis: str) -> range:
        """Of the Gray code of an axis, the coarsest first: stripes of half a period at most."""
        if self.unwrap != "gray":
            return range(0)
        size, period = self.axis_px(axis), min(self._periods)
        finest = max(0, math.floor(math.log2(period)) - 1)
        return range(max((size - 1).bit_length(), finest + 1) - 1, finest - 1, -1)

    @property
    def _first_rad(self) -> float:
        return math.radians(self.first_phase_deg)

    @property
    def _finest_first(self) -> list[int]:
        return sorted(range(len(self._periods)), key=lambda i: self._periods[i])

    @cached_property
    def _sums(self) -> NDArray[np.float32]:
        """Sums (3 F, F N) over an axis's images: mean, B cos phi and B sin phi of each period."""
        angle = _TURN * np.arange(self.steps) / self.steps - self._first_rad
        each = np.stack([np.ones(self.steps), 2.0 * np.cos(angle), 2.0 * np.sin(angle)])
        order = np.eye(len(self._periods))[self._finest_first]
        found: NDArray[np.float32] = np.kron(order, each / self.steps).astype(np.float32)
        return found

    def sigma_phase(self, noise: ArrayLike, modulation: ArrayLike) -> NDArray[np.float64]:
        """Standard deviation of a phase in rad, for that of grey values and the modulation."""
        with np.errstate(divide="ignore"):
            return (
                math.sqrt(2.0 / self.steps)
                * np.asarray(noise, float)
                / np.asarray(modulation, float)
            )

    def wrong_order(self, sigma_phase: ArrayLike) -> NDArray[np.float64]:
        """Probability that the fringe order of a coordinate is wrong, for phases' noise in rad.

        With Gray code, or without temporal unwrapping, it is 0.
        """
        axis = self.axes[0]
        if self.unwrap in ("gray", *SPATIAL):
            return np.zeros(np.shape(sigma_phase))
        return self.chains[axis].wrong_order(sigma_phase)

    def _decode_axis(self, axis: str, block: Block, noise: GreyNoise) -> AxisBlock:
        size = self.axis_px(axis)
        fringes = len(self._periods) * self.steps
        grey = block.astype(np.float32, copy=False)
        sums = (self._sums @ grey[:fringes]).reshape(len(self._periods), 3, -1)
        mean, cosine, sine = sums.swapaxes(0, 1)
        turns = np.arctan2(sine, cosine)
        turns *= np.float32(1.0 / _TURN)
        turns += turns < 0.0
        modulation = np.hypot(cosine, sine)
        average = mean[0] if len(mean) == 1 else mean.mean(axis=0)
        variance = self._variance(average, cosine, sine, modulation, noise)
        disagreement = None
        periods = np.array(sorted(self._periods), np.float32)
        if self.unwrap in SPATIAL:
            length = turns[0].astype(float) * periods[0]
            weights = np.ones(1)
        elif self.unwrap == "gray":
            coarse, _ = position(grey[fringes:] > average, self.bits_of(axis))
            expected = coarse / periods[0] - turns[0]
            order = np.rint(expected)
            disagreement = 2.0 * np.abs(expected - order)
            length = (turns[0] + order.astype(float)) * periods[0]
            weights = np.ones(1)
        else:
            chain = self.chains[axis]
            finest, disagreement = chain.orders(list(turns), size)
            length = chain.mean_length(list(turns), finest)
            weights = chain.weights
            length = _within(length, chain, size)
        passed = np.zeros_like(average)
        for n, weight in enumerate(weights):
            if weight:
                passed += np.float32((weight * periods[n] / _TURN) ** 2) * variance[n]
        return AxisBlock(
            coordinate=length - 0.5,
            sigma=np.sqrt(passed),
            modulation=modulation[0],
            mean=average,
            phase=np.float32(_TURN) * turns[0],
            disagreement=disagreement,
            drowned=variance.max(axis=0) > NOISIEST_PHASE_RAD**2,
        )

    def _variance(
        self,
        mean: NDArray[Any],
        cosine: NDArray[Any],
        sine: NDArray[Any],
        modulation: NDArray[Any],
        noise: GreyNoise,
    ) -> NDArray[Any]:
        """Of each period's phase (F, P), in rad^2."""
        grey = noise.variance(mean)
        if noise.step and not self.steps % 2:
            grey = grey + np.float32(noise.step**2 / 12.0) * _opposite(mean, noise)
        square = modulation**2
        found = (2.0 / self.steps) * grey / square
        if noise.gain and self.steps == 3:
            turned = np.arctan2(sine, cosine) + np.float32(self._first_rad)
            found = found - (noise.gain / 3.0) * np.cos(3.0 * turned) / modulation
        return np.maximum(found, 0.0)

    def _clipped(self, block: Block, saturation: float) -> NDArray[np.bool_]:
        fringes = len(self._periods) * self.steps
        found: NDArray[np.bool_] = block[:fringes].max(axis=0) >= saturation
        return found

    def _seen_noise(self, stack: NDArray[Any], light: GreyNoise, clipped: float) -> GreyNoise:
        """From what the fit of steps, and of the periods' means, leaves over.

        Of that, noise differs from pixel to pixel along both axes.  What gamma, glow and motion
        leave follows the fringes, and is not noise: without it, sigma and what drowns are right.
        """
        from scipy.stats import chi2

        rows, columns, weights = _patches(stack.shape[1:])
        noise: list[NDArray[Any]] = []
        whole: list[NDArray[Any]] = []
        for axis in self.axes:
            fringes = len(self._periods) * self.steps
            images = stack[self.images_of(axis)][:fringes]
            grey = images[:, rows, columns].astype(float)
            each = np.kron(np.eye(len(self._periods)), self._model)
            design = np.concatenate([np.ones((fringes, 1)), each], axis=1)
            free = fringes - np.linalg.matrix_rank(design)
            if free < 1:
                return light
            good = (np.isfinite(grey) & (grey < clipped)).all(axis=(0, 1))
            if light.step:  # nor clipped below
                good &= (grey[:, len(weights) // 2] > 0.0).all(axis=0)
            grey = grey[:, :, good]
            over = np.linalg.svd(design)[0][:, -free:].T
            noise.append(np.mean((over @ np.einsum("p,kpn->kn", weights, grey)) ** 2, axis=0))
            whole.append(np.mean((over @ grey[:, len(weights) // 2]) ** 2, axis=0))
        usual = chi2.median(free) / free
        variance, misfit = (_usual(np.concatenate(each)) / usual for each in (noise, whole))
        return replace(light.as_seen(variance), misfit=math.sqrt(misfit))

    @property
    def _model(self) -> NDArray[np.float64]:
        """Cosine and sine (N, 2) of the steps."""
        angle = _TURN * np.arange(self.steps) / self.steps
        return np.stack([np.cos(angle), np.sin(angle)], axis=1)

    @property
    def absolute(self) -> bool:
        """Whether coordinates are the projector's own, not lacking whole periods."""
        return self.unwrap not in SPATIAL

    def _unwrap_space(self, found: Found, status: NDArray[np.uint8]) -> None:
        if self.unwrap == "spatial":
            unwrap_in_space(found, status, self._periods[0], self.size_px)

    def _doubts(
        self, found: Found, ok: NDArray[np.bool_], light: GreyNoise
    ) -> tuple[float, tuple[str, ...]]:
        if not ok.any():
            return 0.0, ()
        notes = []
        fringes = float(np.median(found.modulation[ok]))
        noise = math.hypot(light.read, light.step / math.sqrt(12.0))
        if light.misfit > max(_MISFIT * noise, _NO_COSINE * fringes):
            notes.append(
                f"The steps leave {light.misfit:.2g} grey values over, where the noise is"
                f" {noise:.2g}: they are no cosines, by the projector's gamma, light that changes,"
                " or motion. Of that the predicted errors know nothing; with more steps, gamma does"
                " less harm."
            )
        if self.unwrap in ("gray", *SPATIAL):
            return 0.0, tuple(notes)
        share = 0.0
        for axis, sigma in found.sigma.items():
            chain = self.chains[axis]
            per_rad = float(np.sqrt(np.sum((chain.weights * chain.periods_px) ** 2))) / _TURN
            # Each pixel's own modulation is as noisy as its phase: its neighbours' counts.
            usual = cv2.medianBlur(np.where(ok, sigma, np.float32(1e9)), 5)[ok]
            beside = np.where(usual < 1e9, usual, sigma[ok])  # its own where it is alone
            some = beside[:: max(1, beside.size // _SAMPLE_PX)]
            share += float(np.mean(chain.wrong_order(some / per_rad)))
        if share > _MOST_WRONG:
            notes.append(
                f"By the noise, {share:.1%} of the pixels are expected in a wrong fringe order:"
                " take more steps, more light, or periods nearer to each other."
            )
        return share, tuple(notes)


def _patches(shape: tuple[int, ...]) -> tuple[NDArray[np.int64], NDArray[np.int64], Block]:
    """Rows and columns (9, P) of 3 x 3 pixels about some, and weights (9,) of unit norm.

    They see noise, but nothing that is even along rows or columns (Immerkaer 1996, Computer Vision
    and Image Understanding 64, 300).  In images narrower than three pixels each stands for itself.
    """
    height, width = shape
    bend = np.array([1.0, -2.0, 1.0]) if min(shape) > 2 else np.ones(1)
    reach = len(bend) // 2
    inner = np.array([height - 2 * reach, width - 2 * reach])
    pixels = int(np.prod(inner))
    some = np.linspace(0, pixels - 1, min(pixels, _SAMPLE_PX)).astype(np.int64)
    row, column = np.divmod(some, inner[1])
    down, right = np.indices((len(bend), len(bend))).reshape(2, -1, 1)
    weights = np.outer(bend, bend).ravel()
    return row + down, column + right, weights / np.linalg.norm(weights)


def _usual(squares: NDArray[Any]) -> float:
    """Median of those that are not 0."""
    lit = squares[squares > 0.0]
    return float(np.median(lit)) if lit.size else 0.0


def default_periods(size: int) -> tuple[float, ...]:
    """Periods for an image of so many px: 16, each next 8 times as long, the last all of it."""
    periods = [min(_FINEST_PX, float(size))]
    while size > _MOST_RATIO * periods[-1]:
        periods.append(_RATIO * periods[-1])
    return (*periods, float(size)) if periods[-1] < size else tuple(periods)


def _within(length: NDArray[np.float64], chain: Chain, size: int) -> NDArray[np.float64]:
    """Lengths beyond the image brought back by the range, where that is whole periods."""
    count = chain.range_px / chain.periods_px
    if chain.range_px < 2.0 * size and np.abs(count - np.rint(count)).max() < 1e-6:
        beyond = (length < 0.0) | (length > size)
        back = chain.range_px * np.rint((length - 0.5 * size) / chain.range_px)
        length = np.where(beyond, length - back, length)
    return length


def _opposite(mean: NDArray[Any], noise: GreyNoise) -> NDArray[Any]:
    """How opposite steps' roundings add up in their difference, -1 to 1 of their variance.

    A + B cos and A - B cos are rounded the opposite way where 2 A is whole; noise undoes that.
    """
    part = 2.0 * mean / np.float32(noise.step)
    part = part - np.floor(part)
    faded = math.exp(-((_TURN * noise.read / noise.step) ** 2))
    found: NDArray[Any] = (1.0 - 6.0 * part + 6.0 * part**2) * np.float32(faded)
    return found


def _listed(periods: Sequence[float]) -> str:
    return ", ".join(f"{each:g}" for each in periods)
