"""Random numbers by place: each pixel's depend on seed, frame, row and column, and on nothing else.

A counter is enciphered (Philox, Salmon et al. 2011): no state is handed on, so that pixels are the
same to the bit in whatever order, in however many threads or processes, and in whatever size of
image they are drawn.  Two uniform numbers make two normal ones (Box and Muller 1958), and a normal
one makes a Poisson one, by the inverse of its distribution: more light on a pixel never makes fewer
electrons there, and changes no other pixel.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr

from virtual_sensor.arrays import whole_number
from virtual_sensor.errors import InputError, short
from virtual_sensor.seeds import LARGEST_SEED

Floats = NDArray[np.float32]

_MANY = np.float32(32.0)  # electrons, from which on 1 of 10,000 numbers is wrong, by 1
_SOME = np.float32(4.0)  # from which on the expansion is right to _UNSURE, but for its tails
_TAIL, _UNSURE = np.float32(2.5), np.float32(0.07)


class PixelNoise:
    """Normal random numbers of a sensor's pixels.

    Parameters
    ----------
    seed : int, (int, int) or numpy.random.Generator
        Also with the number of the frame; a generator is asked for a seed.  None: any.
    part : int
        Of what the seed makes: parts have numbers of their own.
    """

    def __init__(self, seed: Any, part: int) -> None:
        self._frame = 0
        if isinstance(seed, np.random.Generator):
            seed = int(seed.integers(LARGEST_SEED))
        elif isinstance(seed, tuple):
            if len(seed) != 2:
                raise InputError(f"seed is {short(seed)}; give one, or (seed, number of the frame)")
            seed, self._frame = seed[0], whole_number("seed: frame", seed[1], 0, LARGEST_SEED)
        if seed is not None:
            seed = whole_number("seed", seed, 0, LARGEST_SEED)
        words = np.random.SeedSequence(seed, spawn_key=(part,)).generate_state(2, np.uint64)
        self._key = tuple(words.tolist())

    def normals(
        self, rows: range, width: int, frame: int = 0, pair: int = 0
    ) -> tuple[Floats, Floats]:
        """Two independent normal numbers (H, W) of each pixel of some rows; another `pair`, others.

        They have 24 bits: none is beyond 5.8 sigma.
        """
        shape = len(rows), width
        bits = np.random.Philox(key=self._key)
        rng, state = np.random.Generator(bits), bits.state
        counter = state["state"]["counter"]
        uniform = np.empty((2, *shape), np.float32)
        for place, numbers in enumerate(uniform):
            for row, values in zip(rows, numbers, strict=True):
                counter[:] = 0, row, self._frame + frame, 2 * pair + place
                bits.state = state
                rng.random(dtype=np.float32, out=values)
        radius, angle = uniform
        np.subtract(1.0, radius, out=radius)  # above 0
        np.log(radius, out=radius)
        radius *= np.float32(-2.0)
        np.sqrt(radius, out=radius)
        angle *= np.float32(2.0 * np.pi)
        first, second = np.cos(angle), np.sin(angle)
        first *= radius
        second *= radius
        return first, second


def poisson(mean: Floats, normal: Floats) -> Floats:
    """Poisson numbers of a mean, float32, by as many normal numbers.

    The quantile of a normal number: by its asymptotic expansion (Giles 2016, ACM Algorithm 955,
    equation 6), where that can't be wrong; else by the sum of the probabilities.
    """
    many = np.maximum(mean, _SOME)
    root = np.sqrt(many)
    square = normal * normal
    found = square * np.float32(1 / 270) + np.float32(7 / 810)
    found *= square
    found -= np.float32(8 / 405)
    found /= root
    found -= normal * (square * np.float32(1 / 72) + np.float32(1 / 36))
    found /= root
    found += square * np.float32(1 / 6) + np.float32(1 / 3)
    found += root * normal
    found += many
    np.maximum(found, 0.0, out=found)
    few = mean < _MANY
    if not few.any():
        return np.floor(found, out=found)
    few &= (mean < _SOME) | (abs(normal) > _TAIL) | (abs(found - np.rint(found)) < _UNSURE)
    few &= mean > 0.0
    np.floor(found, out=found)
    found *= mean > 0.0
    found[few] = _few(mean[few].astype(float), normal[few].astype(float))
    return found


def _few(mean: NDArray[np.float64], normal: NDArray[np.float64]) -> NDArray[np.float64]:
    """The least number whose probability and that of all below is the normal one's share."""
    found = np.zeros_like(mean)
    probability = np.exp(-mean)
    over = ndtr(normal)
    over -= probability
    number = 0
    while np.any(more := over > 0.0):
        number += 1
        found += more
        probability *= mean
        probability /= number
        over -= probability
    return found
