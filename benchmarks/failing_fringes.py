"""Where fringes fail: noise, motion, gamma, edges, dark and clipped pixels, missing images.

Drawn images of 128 x 128 pixels of a round part, white 1; a column with the status OK that is off
by more than a bound is wrong.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from numpy.typing import NDArray
from worsening import Case, Outcome, judged

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.medium.air_model import AirModel
from virtual_sensor.metrology.air_estimate import estimate_air
from virtual_sensor.metrology.fringes.codecs import codec_of
from virtual_sensor.metrology.fringes.decoded import FringeStatus
from virtual_sensor.metrology.observations import Observation
from virtual_sensor.optics.projector_pixels import projector_pixels
from virtual_sensor.studies.chart.fringes import PROJECTOR_PX, columns, drawn

Array = NDArray[np.float64]
Images = NDArray[np.float32]

SIDE = 128
WRONG_PX = 0.1
"""Of the projector: systematic errors; a wrong fringe order is off by a whole period."""
MIXED_PX = 0.25
HALF_PERIOD_PX = 8.0

_PHASE = "phase 4 16,128,1280 u"
_CODECS = {
    "4 steps, periods 16, 128 and 1280 px": _PHASE,
    "4 steps, beats of 16, 18 and 20.86 px": "phase 4 16,18,20.86 u heterodyne",
    "4 steps of 16 px and Gray code": "phase 4 16 u gray",
    "Gray code": "gray u",
}
_STEPS = {f"{n} steps": f"phase {n} 16,128,1280 u" for n in (3, 4, 5, 8)}


def cases() -> Iterator[Case]:
    """All of them."""
    here = f"{SIDE} x {SIDE} drawn pixels; wrong is a column off by more than"
    orders = f"{here} half a period of 16 px"
    for words, text in _CODECS.items():
        yield Case(
            "noise",
            words,
            (0.01, 0.02, 0.05, 0.1, 0.2, 0.5),
            "of white, standard deviation of grey values",
            partial(_noisy, text),
            orders,
            "a note says how many orders are likely wrong; expose longer, or take more steps",
            share=2e-3,
        )
    for words, text in _STEPS.items():
        yield Case(
            "gamma of the projector",
            words,
            (1.01, 1.02, 1.05, 1.1, 1.2, 1.5, 2.2),
            "exponent",
            partial(_with_gamma, text),
            f"{here} {WRONG_PX:g} px",
            "take more steps, or linearise the projector",
            silent=True,
        )
    for words, text in _STEPS.items():
        yield Case(
            "air or part moves between the images",
            words,
            (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0),
            "px of the projector, standard deviation",
            partial(_moving, text),
            f"{here} {WRONG_PX:g} px, the mean over the images being right",
            "take more steps, or fewer images",
            silent=True,
        )
    for words in ("4 steps, periods 16, 128 and 1280 px", "Gray code"):
        text = _CODECS[words]
        yield Case(
            "a step in depth",
            words,
            (0.1, 0.3, 1.0, 3.0, 10.0, 30.0),
            "px of the projector that columns jump by within a pixel",
            partial(_step, text),
            f"{SIDE} pixels that mix both sides; wrong is a column off both by more than"
            f" {1.0 if text.startswith('gray') else MIXED_PX:g} px",
            "smaller steps are smooth to the decoder",
            share=0.02,
        )
        yield Case(
            "dark pixels",
            words,
            (0.3, 0.1, 0.03, 0.01, 0.003),
            "of the brightest pixels' light, noise 0.2 % of white",
            partial(_dark, text),
            orders,
            "expose longer, or twice",
        )
        yield Case(
            "clipped pixels",
            words,
            (1.0, 1.02, 1.05, 1.1, 1.3, 2.0),
            "times too long an exposure",
            partial(_clipped, text),
            f"{here} {1.0 if text.startswith('gray') else WRONG_PX:g} px",
            "expose less",
        )
        yield Case(
            "an image is missing",
            words,
            (0.0, 1.0),
            "images",
            partial(_missing, text),
            "one sequence",
        )
        yield Case(
            "grey values that are not numbers",
            words,
            (0.0, 1.0),
            "images with a hole",
            partial(_hole, text),
            f"{here} {1.0 if text.startswith('gray') else WRONG_PX:g} px",
        )
    yield Case(
        "air of another family",
        "air found from the epipolar residual of one pose",
        (0.25, 0.5, 1.0, 2.0, 4.0, 8.0),
        "mm of blur that the model does not know",
        _blurred,
        "144 pixels of fringe_cylinder, noise 0.02 px; scale and width are found; wrong is a point"
        " off by 0.1 px",
        "a small residual proves nothing: measure from two poses",
    )


def _outcome(
    text: str,
    images: Images,
    column: Array,
    wrong_px: float,
    some: Any = slice(None),
    **options: Any,
) -> Outcome:
    """What becomes of drawn columns; a note on wrong orders reports them all."""
    decoded = codec_of(text, PROJECTOR_PX).decode(images, **options)
    assert decoded.column is not None
    error = np.abs(decoded.column - column)
    found = judged(decoded.status[some].ravel(), [FringeStatus.OK], error[some].ravel(), wrong_px)
    if not any("order" in note for note in decoded.notes):
        return found
    every = np.ones(found.reported.shape, bool)
    return Outcome(every, ~every, ["a note on wrong orders"], 0.0)


def _noisy(text: str, noise: float) -> Outcome:
    column = columns(SIDE)
    return _outcome(text, drawn(text, column, noise), column, HALF_PERIOD_PX, noise=noise)


def _with_gamma(text: str, gamma: float) -> Outcome:
    column = columns(SIDE)
    return _outcome(text, drawn(text, column, gamma=gamma), column, WRONG_PX, noise=0.0)


def _moving(text: str, shift_px: float) -> Outcome:
    """Each image is drawn on columns that are shifted a little."""
    column, codec = columns(SIDE), codec_of(text, PROJECTOR_PX)
    shift = np.random.default_rng(2).normal(size=len(codec))
    shift = shift_px * (shift - shift.mean()) / shift.std()
    row = np.zeros_like(column)
    images = [p.grey(column + d, row) for p, d in zip(codec.patterns, shift, strict=True)]
    steps = int(text.split()[1])
    return _outcome(
        text,
        np.stack(images).astype(np.float32),
        column + shift[:steps].mean(),
        WRONG_PX,
        noise=0.0,
    )


def _step(text: str, jump_px: float) -> Outcome:
    """Half of the pixels in a column of the image see one side of an edge, half the other."""
    column = columns(SIDE)
    middle = SIDE // 2
    column[:, middle:] += jump_px
    other = column.copy()
    other[:, middle] -= jump_px
    images = 0.5 * (drawn(text, column) + drawn(text, other))
    gray = text.startswith("gray")
    decoded = codec_of(text, PROJECTOR_PX).decode(images, noise=0.0)
    assert decoded.column is not None
    at = np.s_[:, middle]
    here, sides = decoded.column[at], (column[at], other[at])
    error = np.minimum(*(np.abs(here - side) for side in sides))
    return judged(decoded.status[at], [FringeStatus.OK], error, 1.0 if gray else MIXED_PX)


def _dark(text: str, light: float) -> Outcome:
    column = columns(SIDE)
    reflected = np.where(np.arange(SIDE) < SIDE // 2, 1.0, light)
    images = drawn(text, column) * reflected.astype(np.float32)
    images += np.random.default_rng(3).normal(0.0, 2e-3, images.shape).astype(np.float32)
    dark = np.s_[:, SIDE // 2 + 4 :]
    return _outcome(text, images, column, HALF_PERIOD_PX, dark, noise=2e-3)


def _clipped(text: str, factor: float) -> Outcome:
    column = columns(SIDE)
    images = np.minimum(0.99 * factor * drawn(text, column), 1.0)
    wrong_px = 1.0 if text.startswith("gray") else WRONG_PX
    return _outcome(text, images, column, wrong_px, noise=0.0, saturation=1.0)


def _missing(text: str, count: float) -> Outcome:
    column = columns(SIDE)
    images = drawn(text, column)[int(count) :]
    try:
        codec_of(text, PROJECTOR_PX).decode(images, noise=0.0)
    except InputError:
        return Outcome(np.ones(1, bool), np.zeros(1, bool), ["InputError"], 0.0)
    return Outcome(np.zeros(1, bool), np.zeros(1, bool), (), 0.0)


def _hole(text: str, count: float) -> Outcome:
    column = columns(SIDE)
    images = drawn(text, column)
    images[: int(count), 40:60, 40:60] = np.nan
    wrong_px = 1.0 if text.startswith("gray") else WRONG_PX
    hole = np.s_[40:60, 40:60]
    return _outcome(text, images, column, wrong_px, hole, noise=0.0)


# ------------------------------------------------------------------------------ the air


@cache
def _scene() -> Scene:
    return load_scene("fringe_cylinder")


def _blurred(blur_mm: float) -> Outcome:
    """Points through air that is found in a family without the true one's blur."""
    scene, noise_px = _scene(), 0.02
    model = AirModel.of(scene.medium)
    u, v = (
        each.ravel() for each in np.meshgrid(np.linspace(620, 1420, 12), np.linspace(300, 1800, 12))
    )
    found = projector_pixels(scene.with_medium(model.at(blur=blur_mm)), np.stack([u, v], axis=1))
    s, t = scene.projector.family.of_pixels(found.projector_pixel)
    pixel = np.stack([u, v], axis=1)
    air = estimate_air(Observation(scene, pixel, noise_px, s, t), scene.medium)
    off_mm = np.linalg.norm(air.points[0].point_mm - found.point_mm, axis=1)
    error = off_mm / scene.camera.pixel_mm(found.point_mm)
    reported = np.full(len(error), air.chi2 > 0.5)
    names: Sequence[str] = ["a residual beyond the noise"] * bool(reported.any())
    wrong = ~reported & ~(error <= 0.1)
    return Outcome(reported, wrong, names, 0.0 if reported.all() else float(error.max()))
