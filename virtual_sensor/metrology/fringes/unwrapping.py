"""Fringe orders: which of many equal periods a phase is in.

Temporal unwrapping goes along a chain of phases from the coarsest, which spans the image once, to
the finest: each finds the order of the next.  A phase of the chain is one that was measured, or the
beat of several, with whole coefficients: so hierarchical and heterodyne unwrapping are one.
Phases are in turns, 0 to 1.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import islice, pairwise, product

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.sparse.csgraph import dijkstra
from scipy.special import erfc

from virtual_sensor.display import Displayed

Array = NDArray[np.float64]
Turns = NDArray[np.float32]

_MOST_CANDIDATES = 400  # beats that are tried
_STEEP = 8.0  # power of a link's gain that a path sums up: the worst link decides
_NEGLIGIBLE = 0.01  # weight of a period beside the finest that would add nothing


@dataclass(frozen=True)
class Chain(Displayed):
    """Phases from coarse to fine; each is a sum of measured ones with whole coefficients.

    Attributes
    ----------
    periods_px : ndarray of shape (F,)
        Of the measured phases, the finest first.
    links : ndarray of int of shape (L, F)
        Coefficients of the measured phases, the coarsest link first, the finest period last.
    """

    periods_px: Array
    links: NDArray[np.int64]

    @property
    def frequencies(self) -> Array:
        """Of the links (L,), turns per px."""
        found: Array = self.links @ (1.0 / self.periods_px)
        return found

    @property
    def range_px(self) -> float:
        """Length over which coordinates are unambiguous: the coarsest link's period."""
        return float(1.0 / self.frequencies[0])

    @property
    def gains(self) -> Array:
        """Noise of each order (L - 1,), in rad per rad of noise of each measured phase."""
        f = self.frequencies
        passed = (f[1:] / f[:-1])[:, None] * self.links[:-1] - self.links[1:]
        found: Array = np.linalg.norm(passed, axis=1)
        return found

    def wrong_order(self, sigma_phase: ArrayLike) -> Array:
        """Probability that an order is wrong, for noise of the phases in rad, of any shape.

        With two periods of ratio r it is erfc(pi/(sqrt(2) sigma sqrt(1 + r^2))) for normal errors
        of the phases.  An arctangent's have longer tails: the sums' noise brings it beyond an
        angle a where it crosses the line in that direction, sin(a) away.
        """
        margin = np.sin(np.pi / np.maximum(self.gains, 2.0)) / np.sqrt(2.0)
        with np.errstate(divide="ignore"):
            right = 1.0 - erfc(margin / np.asarray(sigma_phase, float)[..., None])
        found: Array = 1.0 - right.prod(axis=-1)
        return found

    def orders(self, turns: Sequence[Turns], size: int) -> tuple[Array, Turns]:
        """Unwrap phases.

        Parameters
        ----------
        turns : sequence of F arrays
            Measured phases from the border of the projector's image on, of one shape.
        size : int
            Of the image in px: about its middle the coarsest link is taken as unambiguous.

        Returns
        -------
        length : ndarray
            From the image's border, in periods of the finest.
        disagreement : ndarray
            Largest distance of a link from the order that it was given, in half periods: 0 to 1.
        """
        f = self.frequencies
        low = 0.5 * (size * f[0] - 1.0)
        place = self._link(0, turns)
        place = place - np.floor(place - np.float32(low))
        worst = np.zeros_like(place)
        for number in range(1, len(self.links)):
            here = self._link(number, turns)
            expected = place * np.float32(f[number] / f[number - 1]) - here
            order = np.rint(expected)
            expected -= order
            np.maximum(worst, np.abs(expected, out=expected), out=worst)
            place = here + (order if number < len(self.links) - 1 else order.astype(float))
        return place.astype(float, copy=False), 2.0 * worst

    def _link(self, number: int, turns: Sequence[Turns]) -> Turns:
        """A link's phase in turns, from 0 to 1 if it is a measured one."""
        parts = [(n, t) for n, t in zip(self.links[number], turns, strict=True) if n]
        (first, phase), *others = parts
        if not others and first == 1:
            return phase
        total = np.float32(first) * phase
        for factor, other in others:
            total += np.float32(factor) * other
        return total - np.floor(total)

    @property
    def weights(self) -> Array:
        """Of the periods (F,) in the mean coordinate: as 1/period^2, where that adds something."""
        weight = self.periods_px**-2.0
        weight[weight < _NEGLIGIBLE * weight[0]] = 0.0
        return weight / weight.sum()

    def mean_length(self, turns: Sequence[Turns], finest: Array) -> Array:
        """Weighted mean of the lengths by all periods, in px; `finest` is that of `orders`."""
        length = finest * self.periods_px[0]
        mean = length
        each = zip(self.weights, self.periods_px, turns, strict=True)
        for weight, period, phase in islice(each, 1, None):
            if weight:
                off = phase - length / period
                off -= np.rint(off)
                mean = mean + (weight * period) * off
        return mean


def hierarchical(periods_px: Sequence[float]) -> Chain:
    """The chain from the longest period to the shortest."""
    periods = np.array(sorted(periods_px))
    return Chain(periods, np.eye(len(periods), dtype=np.int64)[::-1])


def heterodyne(periods_px: Sequence[float], size: int) -> Chain | None:
    """The chain of beats with the least noise whose coarsest spans the image; None if none does.

    Beats have coefficients -2 to 2, of many periods -1 to 1.  The path through them is the one
    whose noisiest link is quietest.
    """
    periods = np.array(sorted(periods_px))
    count = len(periods)
    most = 2 if 5**count <= 2 * _MOST_CANDIDATES else 1
    factors = np.array(list(product(range(-most, most + 1), repeat=count)))
    frequencies = factors @ (1.0 / periods)
    finest = 1.0 / periods[0]
    useful = (frequencies > 1e-9 * finest) & (frequencies <= finest * (1.0 + 1e-9))
    useful &= np.gcd.reduce(factors, axis=1) == 1
    factors, frequencies = factors[useful], frequencies[useful]
    # Those with few terms are the least noisy.
    kept = np.argsort(np.abs(factors).sum(axis=1), kind="stable")[:_MOST_CANDIDATES]
    factors, frequencies = factors[kept], frequencies[kept]
    spans = frequencies * size <= 1.0 + 1e-9
    if not spans.any():
        return None
    ratio = frequencies[None, :] / frequencies[:, None]
    squares = np.sum(factors.astype(float) ** 2, axis=1)
    gain2 = ratio**2 * squares[:, None] + squares - 2.0 * ratio * (factors @ factors.T)
    finer = ratio > 1.0 + 1e-9
    cost = np.where(finer, np.maximum(gain2, 1e-9) ** (0.5 * _STEEP), 0.0)
    end = int(np.flatnonzero((factors == np.eye(count, dtype=int)[0]).all(axis=1))[0])
    path = _path(cost, spans, end)
    worst = max((gain2[a, b] for a, b in pairwise(path)), default=1.0)
    # As few links as there can be of that noise: each takes time.
    usable = finer & (gain2 <= 1.1 * worst)
    path = _path(np.where(usable, 1.0 + gain2 / worst, 0.0), spans, end)
    return Chain(periods, factors[path])


def _path(cost: Array, starts: NDArray[np.bool_], end: int) -> list[int]:
    """The cheapest path of nodes from any of the starts to the end; no link costs 0."""
    length, before = dijkstra(cost.T, indices=end, return_predecessors=True)
    path = [int(np.argmin(np.where(starts, length, np.inf)))]
    while path[-1] != end:
        path.append(int(before[path[-1]]))
    return path
