"""Panel "fringes": error of decoded projector columns against time, by codec, and by samples.

Drawn images with noise show what steps, periods and codes do; a rendered sequence of the hot scene
shows what samples and transports do, without noise.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.imaging.sequence import render_sequence
from virtual_sensor.metrology.fringes.codecs import codec_of
from virtual_sensor.metrology.fringes.decoded import DecodedFringes, FringeStatus
from virtual_sensor.metrology.truth import rms
from virtual_sensor.optics.projector_pixels import (
    ProjectorPixelStatus,
    pixel_grid,
    projector_pixels,
)
from virtual_sensor.studies.chart.benchmark import Configuration, Score, Task

Array = NDArray[np.float64]

SCENE = "fringe_cylinder"
PROJECTOR_PX = (1280, 800)
NOISE = 0.01
"""Of drawn images, whose white is 1: that of 10,000 electrons."""

GAMMA = 1.5

CODECS = (
    *(f"phase {steps} 16,128,1280 u" for steps in (3, 4, 6, 8, 12, 16)),
    *(f"phase 4 {periods} u" for periods in ("8,64,1280", "32,320,1280", "64,1280")),
    "phase 4 16,18,20.86 u heterodyne",
    "phase 4 16 u gray",
    "gray u",
    "single 16 u",
)
QUICK_CODECS = CODECS[1], "gray u"
SAMPLES = (1, 4, 9, 16)

_KINDS = {"phase": "phase shifting", "gray": "Gray code", "single": "one image"}
_PX_PER_COLUMN = 2.13  # of the camera's pixels, on the scene's part
_UM_PER_COLUMN = 46.9
_DRAWN_PX, _QUICK_DRAWN_PX = 512, 128
_FILM_PX, _QUICK_FILM_PX = 1024, 256
_SEARCHED = 1600  # of the film's pixels, on a grid
_RENDERED = "phase 4 16,128,1280 u"


def tasks(quick: bool = False) -> Iterator[Task]:
    """Drawn images with noise, of a projector with gamma, and a rendered sequence of the scene."""
    side, codecs = (_QUICK_DRAWN_PX, QUICK_CODECS) if quick else (_DRAWN_PX, CODECS)
    yield _drawn(side, codecs, f"noise of {NOISE:.0%} of white", noise=NOISE)
    if not quick:
        yield _drawn(side, codecs, f"a projector of gamma {GAMMA:g}", gamma=GAMMA)
    yield _rendered(_QUICK_FILM_PX if quick else _FILM_PX, SAMPLES[:1] if quick else SAMPLES)


def columns(side: int) -> Array:
    """Columns (side, side) of the projector's image, as a round part has them."""
    v, u = np.mgrid[:side, :side] / side
    bent: Array = 200.0 + 800.0 * u + 60.0 * np.sin(2.0 * v + u) - 80.0 * (v - 0.5) ** 2
    return bent


def drawn(text: str, column: Array, noise: float = 0.0, gamma: float = 1.0) -> NDArray[np.float32]:
    """Images (K, H, W) of a codec's patterns on columns (H, W), white 1, with noise."""
    codec, rng = codec_of(text, PROJECTOR_PX), np.random.default_rng(0)
    row = np.zeros_like(column)
    images = np.stack([np.asarray(p.grey(column, row), np.float32) for p in codec.patterns])
    images = np.maximum(images, 0.0) ** np.float32(gamma)
    return images + rng.normal(0.0, noise, images.shape).astype(np.float32) if noise else images


def _drawn(
    side: int, codecs: tuple[str, ...], words: str, noise: float = 0.0, gamma: float = 1.0
) -> Task:
    column = columns(side)

    def score(decoded: DecodedFringes) -> Score:
        return _score(decoded, np.s_[:], column)

    def prepare(text: str) -> Callable[[], DecodedFringes]:
        images = drawn(text, column, noise, gamma)
        return partial(codec_of(text, PROJECTOR_PX).decode, images, noise=noise)

    choices = [_configuration(text, partial(prepare, text)) for text in codecs]
    name = f"columns decoded in drawn images, {words}"
    return Task(name, "the columns that were drawn", column.size, score, choices)


def _rendered(film_px: int, samples: tuple[int, ...]) -> Task:
    scene = load_scene(SCENE, width=film_px, height=film_px, pixels="false")
    pixel = pixel_grid(scene.camera.size, _SEARCHED)
    found = projector_pixels(scene, pixel)
    u, v = pixel.T
    # Of coarse films no pixel is even enough for the mean over it to be its centre's.
    good = found.status == ProjectorPixelStatus.OK
    good = good if good.any() else np.isfinite(found.projector_pixel[:, 0])
    column = found.projector_pixel[good, 0]

    def score(decoded: DecodedFringes) -> Score:
        return _score(decoded, (v[good], u[good]), column)

    choices = [
        Configuration(
            f"{transport}_sequence",
            transport,
            partial(_sequence, scene, transport, spp),
            {"samples_per_pixel": spp},
            {"codec": _RENDERED},
        )
        for transport in ("tabulated", "marched")
        for spp in (samples if transport == "tabulated" else samples[:1])
    ]
    name = f"a rendered sequence of {film_px} px, hot, and its decoding"
    return Task(name, "the search of rays", film_px**2, score, choices)


def _sequence(scene: Scene, transport: str, spp: int) -> Callable[[], DecodedFringes]:
    codec = codec_of(_RENDERED, scene.projector.size)
    here = scene.with_transport(scene.transport.by(transport))

    def work() -> DecodedFringes:
        frames = render_sequence(here, codec.patterns, spp=spp)
        return codec.decode(frames.radiance, noise=0.0)

    return work


def _configuration(text: str, prepare: Callable[[], Any]) -> Configuration:
    kind, *words = text.split()
    chosen: dict[str, Any] = {"images": len(codec_of(text, PROJECTOR_PX))}
    if kind == "phase":
        chosen |= {"steps": int(words[0]), "periods_px": words[1]}
    name = "_".join([kind, *words[3:]])
    return Configuration(name, _KINDS[kind], prepare, chosen, {"codec": text})


def _score(decoded: DecodedFringes, some: Any, column: Array) -> Score:
    """Errors of the columns in some pixels, NaN where nothing was decoded."""
    assert decoded.column is not None
    lost = decoded.status[some] != FringeStatus.OK
    error = np.where(lost, np.nan, decoded.column[some] - column).ravel()
    sigma, note = decoded.sigma_column, ""
    if sigma is not None and np.nanmax(sigma, initial=0.0) > 0.0:
        note = f"predicts {_PX_PER_COLUMN * rms(sigma.astype(float)):.2g} px"
    return Score(_PX_PER_COLUMN * error, _UM_PER_COLUMN * error, int(lost.sum()), note)
