"""Steps, periods and samples that keep a tolerance of the decoded projector pixels, in few images.

What formulas say is weighed first, without an image of a pattern: noise of the camera (Surrel
1997), rounding by the projector's bits, the ripple that its gamma leaves, and wrong fringe orders.
Then the cheapest codec that does is rendered with more and more samples, beside a search of rays:
that shows what samples, ray maps and the projector itself leave.
"""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.devices.patterns import Uniform
from virtual_sensor.devices.projector import Projector
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.fringe_recording import FringeRecording
from virtual_sensor.imaging.render import render
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.imaging.sequence import render_sequence
from virtual_sensor.metrology.fringes.decoded import FringeStatus
from virtual_sensor.metrology.fringes.phase_shift import PhaseShift
from virtual_sensor.metrology.truth import rms
from virtual_sensor.optics.projector_pixels import (
    ProjectorPixelStatus,
    pixel_grid,
    projector_pixels,
)
from virtual_sensor.records import Record

Array = NDArray[np.float64]
Report = Callable[[str, float], None]

STEPS = (3, 4, 5, 6, 8, 12, 16)
FINEST_PX = (64.0, 32.0, 16.0, 8.0)
RATIOS = (16.0, 8.0, 4.0)
"""Of a period to the next one."""
SAMPLES = (1, 4, 9, 16)
"""Samples per pixel that are tried, fewest first."""

MOST_WRONG = 1e-4
"""Share of the fringe orders that may be wrong."""

_NEAR = 0.7  # of the image's size: a period so long is its last but one
_LEAST_LIGHT = 0.04  # of the brightest pixel's: what is darker is not decoded
_LEAST_CONTRAST = 0.3  # of the finest fringes: below it, what is left is no sine
_SEARCHED = 900  # pixels, on a grid


@dataclass(frozen=True)
class FringeChoice(Record):
    """Steps, periods and samples, and why.

    Attributes
    ----------
    codec : str
        As `codec_of` takes it.
    images : int
        That it takes.
    spp : int
        Samples per pixel.
    estimate_px : dict of float
        Parts of the estimated error, px of the projector, rms.
    why : list of str
        What was weighed, in words.
    """

    codec: str
    images: int
    spp: int
    estimate_px: dict[str, float]
    why: list[str]

    @property
    def error_px(self) -> float:
        """All parts together."""
        return math.hypot(*self.estimate_px.values())

    def __str__(self) -> str:
        parts = ", ".join(f"{name} {px:.2g}" for name, px in self.estimate_px.items() if px)
        return (
            f"codec {self.codec}, spp {self.spp}: about {self.error_px:.2g} px of the projector"
            f" ({parts or 'nothing'}), {self.images} images"
        )


def choose_fringes(
    scene: Scene,
    tolerance_px: float,
    *,
    recording: FringeRecording | None = None,
    axes: str = "uv",
    report: Report = lambda stage, fraction: None,
) -> FringeChoice:
    """The codec with the fewest images, and the fewest samples, that keep a tolerance.

    Parameters
    ----------
    scene : Scene
        With one camera and one projector.
    tolerance_px : float
        Of the decoded columns and rows: px of the projector, rms over the pixels that are decoded.
    recording : FringeRecording, optional
        Whose noise is weighed; by default as the scene's camera says, none if it has no sensor.
    axes : str
        "uv", "u" or "v".
    report : callable

    Raises
    ------
    InputError
        If the tolerance is no positive number, or nothing keeps it: then it names what errs most.
    """
    if not (np.isfinite(tolerance_px) and tolerance_px > 0.0):
        raise InputError(f"--tolerance {tolerance_px}: give a positive number of px")
    report("light of an all-white image", 0.0)
    light, noise = _light(scene, recording or FringeRecording())
    predicted = sorted(
        _candidates(scene, light, noise, axes),
        key=lambda each: (each.images, each.error_px),
    )
    enough = [each for each in predicted if each.error_px <= tolerance_px]
    if not enough:
        best = min(predicted, key=lambda each: each.error_px, default=None)
        if best is None:
            raise InputError(
                f"--tolerance {tolerance_px:g} px: at this noise no fringe order is sure; expose"
                " longer (--electrons, --exposure)"
            )
        raise InputError(f"--tolerance {tolerance_px:g} px: {_remedy(best)}; the best is {best}")
    found = enough[0]
    for number, spp in enumerate(SAMPLES):
        report(f"{spp} samples per pixel beside a search", (number + 1) / (len(SAMPLES) + 1))
        left_px = _rendered_px(scene, found.codec, spp)
        # Which holds what bits and gamma do, too.
        parts = {"noise": found.estimate_px["noise"], "rendering": left_px}
        words = (
            f"{spp} sample{'s' * (spp != 1)} per pixel and the projector's pixels: {left_px:.2g} px"
        )
        tried = replace(found, spp=spp, estimate_px=parts, why=[*found.why, words])
        if tried.error_px <= tolerance_px:
            return tried
    by_projector = replace(found, estimate_px=found.estimate_px | {"rendering": left_px})
    remedy = _remedy(by_projector)
    raise InputError(f"--tolerance {tolerance_px:g} px: {remedy}; the best is {tried}")


def _remedy(choice: FringeChoice) -> str:
    """What errs most, and what to do about it."""
    most = max(choice.estimate_px, key=lambda name: choice.estimate_px[name])
    remedy = {
        "noise": "the camera's noise errs most: expose longer (--electrons, --exposure)",
        "bits": "the projector's bits err most: take more of them (-D bits)",
        "gamma": "the projector's gamma errs most: linearise it (-D gamma=1)",
        "rendering": "the projector's square pixels err most: -D pixels=false shows none,"
        " -D defocus=0.5 smooths them",
    }
    return remedy[most]


def _light(scene: Scene, recording: FringeRecording) -> tuple[Array, Noise | None]:
    """Light (N,) of an all-white image in the pixels that are bright enough, the brightest's 1.

    And the noise with which it is recorded.
    """
    name = scene.projector_name
    white = scene.projector.with_pattern(Uniform(1.0))
    image = render(replace(scene.only(None, name), sources={name: white}), spp=1)
    brightest = float(image.max())
    light = np.asarray(image, float) / (brightest or 1.0)
    light = light[light > _LEAST_LIGHT]
    if not light.size:
        raise InputError(f"{scene.path}: the camera sees no light of the projector")
    sensor = recording.of(scene)
    if sensor is None:
        return light, None
    return light, Noise(recording.electrons_of(scene, brightest), sensor.dark_noise_e)


def _candidates(
    scene: Scene, light: Array, noise: Noise | None, axes: str
) -> Iterator[FringeChoice]:
    """Codecs whose orders are sure, with what formulas say of their errors."""
    projector, width = scene.projector, footprint_px(scene)
    size = max(n for n, axis in zip(projector.size, "uv", strict=True) if axis in axes)
    for steps, finest, ratio in itertools.product(STEPS, FINEST_PX, RATIOS):
        periods = list(itertools.takewhile(lambda p: p < _NEAR * size, _growing(finest, ratio)))
        codec = PhaseShift(
            size_px=projector.size, steps=steps, periods_px=(*periods, float(size)), axes=axes
        )
        contrast = contrast_of(projector, finest, width)
        if contrast < _LEAST_CONTRAST:
            continue
        noise_rad = phase_noise(codec, light, contrast, noise)
        if float(np.mean(codec.wrong_order(noise_rad))) > MOST_WRONG:
            continue
        per_rad = finest / (2.0 * np.pi)
        parts = {
            "noise": per_rad * rms(noise_rad),
            "bits": per_rad * _rounding(codec, projector.bits) / contrast,
            "gamma": per_rad * gamma_ripple(steps, projector.gamma) / np.sqrt(2.0),
        }
        words = f"{codec.text}: " + ", ".join(f"{k} {v:.2g} px" for k, v in parts.items())
        yield FringeChoice(codec.text, len(codec), SAMPLES[0], parts, [words])


def _growing(first: float, ratio: float) -> Iterator[float]:
    return (first * ratio**k for k in itertools.count())


def footprint_px(scene: Scene) -> float:
    """Width of what a camera pixel sees, in px of the projector, about the middle of its image."""
    projector, camera = scene.projector, scene.camera
    target = projector.target_mm
    across = target + np.array([[0.0], [1.0]]) * projector.pose.rotation[:, 0]
    per_mm = float(np.linalg.norm(np.diff(projector.family.project(across), axis=0)))
    return per_mm * float(camera.pixel_mm(target))


def contrast_of(projector: Projector, period_px: float, width_px: float = 0.0) -> float:
    """Amplitude of fringes over that of a perfect projector's in a point.

    Contrast, defocus, and the mean over a camera's pixel take some.
    """
    blur = math.exp(-2.0 * (math.pi * projector.defocus_px / period_px) ** 2)
    return (1.0 - 1.0 / projector.contrast) * blur * float(np.sinc(width_px / period_px))


class Noise(NamedTuple):
    """Electrons of the brightest pixel, and the standard deviation of a dark one's."""

    electrons: float
    dark_e: float


def phase_noise(codec: PhaseShift, light: Array, contrast: float, noise: Noise | None) -> Array:
    """Standard deviation (N,) of phases in rad: shot and read noise, mean over the phase."""
    if noise is None:
        return np.zeros_like(light)
    mean = 0.5 * noise.electrons * light
    sigma = np.sqrt(mean + noise.dark_e**2)
    return codec.sigma_phase(sigma, contrast * mean)


def _rounding(codec: PhaseShift, bits: int) -> float:
    """Phase noise in rad of grey values that are rounded to so many bits; 0: of none.

    Opposite steps, which an even number has, are rounded the opposite way: half of them count.
    """
    if not bits:
        return 0.0
    white = float(codec.sigma_phase(1.0 / math.sqrt(12.0) / (2.0**bits - 1.0), 0.5))
    return white if codec.steps % 2 else math.sqrt(2.0) * white


def gamma_ripple(steps: int, gamma: float) -> float:
    """Amplitude in rad of the ripple that a projector's gamma leaves in N steps.

    With ((1 + cos phi)/2)^g the harmonics are p_k/p_1 = prod_{j=2..k} (g - j + 1)/(g + j), and the
    ripple, at N phi, is |p_{N-1} - p_{N+1}|/p_1.
    """

    def harmonic(k: int) -> float:
        return math.prod((gamma - j + 1.0) / (gamma + j) for j in range(2, k + 1))

    return abs(harmonic(steps - 1) - harmonic(steps + 1))


def _rendered_px(scene: Scene, codec: str, spp: int) -> float:
    """Decoded minus searched pixels, without noise, px of the projector, rms over the axes."""
    from virtual_sensor.metrology.fringes.codecs import codec_of

    patterns = codec_of(codec, scene.projector.size)
    frames = render_sequence(scene, patterns.patterns, spp=spp)
    decoded = patterns.decode(
        frames.radiance, noise=0.0, border_px=scene.projector.blurred_border_px
    )
    pixel = pixel_grid(scene.camera.size, _SEARCHED)
    found = projector_pixels(scene, pixel)
    u, v = pixel.T
    error = decoded.pixel[v, u] - found.projector_pixel
    good = (decoded.status[v, u] == FringeStatus.OK) & (found.status == ProjectorPixelStatus.OK)
    if not good.any():
        raise InputError(
            f"{scene.path}: no pixel is decoded and found by a search, with which a tolerance could"
            " be judged; give a finer film (-D width, height)"
        )
    return rms(error[good])
