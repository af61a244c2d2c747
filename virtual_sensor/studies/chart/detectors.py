"""Panel "lines": line detectors, error of the centre against time per column."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.imaging.render import render
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.drawn_lines import line_shares
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine, compare_line, rms
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.chart.rung import Report, Rung, timed
from virtual_sensor.studies.measure import searched_line

Array = NDArray[np.float64]

SCENE = "hot_cylinder"
HEIGHT_PX = 128
_COLUMNS, _QUICK_COLUMNS = 2048, 256
_FILM_PX, _QUICK_FILM_PX = 2048, 512
_FIELD_OF_VIEW_UM = 45_056.0
_ENDS_PX = 3.0  # next to the line's ends, whose columns are partly lit
_RUNS, _QUICK_RUNS = 5, 1


@dataclass(frozen=True)
class Task:
    """An image with its truth.

    Attributes
    ----------
    image : ndarray of shape (H, W)
    truth : TrueLine
    settings : dict
    reference : str
    um_per_px : float
        On the part; NaN where there is none.
    """

    image: NDArray[np.float32]
    truth: TrueLine
    settings: dict[str, Any]
    reference: str
    um_per_px: float


def rungs(report: Report, quick: bool = False) -> list[Rung]:
    """Find the line in images of known truth, with every detector there is.

    Parameters
    ----------
    report : callable
    quick : bool
        Small images, few of them.
    """
    tasks = [*_gaussians(quick), _frame(quick)]
    work = [(task, method) for task in tasks for method in COLUMNWISE]
    found = []
    for number, (task, method) in enumerate(work):
        report(f"lines: {method}", number / len(work))
        found.append(_measured(task, method, _QUICK_RUNS if quick else _RUNS))
    return found


def gaussian_lines(
    centre: Array, sigma: float | Array, height: int = HEIGHT_PX, amplitude: float | Array = 1.0
) -> Array:
    """Image (height, W) of Gaussian lines at rows `centre` (W,), integrated over each pixel."""
    return amplitude * np.sqrt(2.0 * np.pi) * sigma * line_shares(centre, sigma, height)[0]


def _gaussians(quick: bool) -> Iterator[Task]:
    """Pixel-integrated Gaussians at random sub-pixel places, in white noise."""
    rng = np.random.default_rng(7)
    columns = _QUICK_COLUMNS if quick else _COLUMNS
    for sigma in (2.0,) if quick else (0.6, 1.0, 2.0, 3.5, 6.0):
        for noise in (0.0, 0.02) if quick else (0.0, 0.005, 0.02, 0.1):
            centre = rng.uniform(-2.0, 2.0, columns) + HEIGHT_PX / 2.0
            image = gaussian_lines(centre, sigma)
            image += rng.normal(0.0, noise, image.shape)
            yield Task(
                image.astype(np.float32),
                TrueLine.of_rows(centre),
                {"sigma_px": sigma, "noise": noise},
                f"drawn lines of sigma {sigma:g} px, noise {noise:.1%} of their height",
                np.nan,
            )


def _frame(quick: bool) -> Task:
    """The hot scene as it is rendered by default, against the ray search."""
    film = _QUICK_FILM_PX if quick else _FILM_PX
    scene = load_scene(SCENE, width=film, height=film)
    half = 0.5 * scene.sensor.laser.length_mm
    found = ray_search(scene, np.linspace(-half, half, 401), "newton")
    return Task(
        np.asarray(render(scene), np.float32),
        searched_line(scene, found),
        {"scene": SCENE, "film": film},
        f"Newton's search, in a rendered frame of {film} px",
        _FIELD_OF_VIEW_UM / film,
    )


def _measured(task: Task, method: str, runs: int) -> Rung:
    """Time a detector, and judge it in the columns that have a line."""
    line = line_centres(task.image, method)
    seconds = timed(lambda: line_centres(task.image, method), runs)
    errors = compare_line(line, task.truth, end_px=_ENDS_PX)
    lost = [f"{Status(s).name} {np.sum(errors.lost == s)}" for s in np.unique(errors.lost)]
    return Rung(
        panel="lines",
        name=method,
        settings=task.settings,
        error_px=errors.rms_px,
        largest_px=errors.largest_px,
        error_um=errors.rms_px * task.um_per_px,
        seconds=seconds / task.image.shape[1],
        item="column",
        items=errors.expected,
        failed=errors.lost.size,
        reference=task.reference,
        note="; ".join([f"states {rms(errors.sigma):.2g} px", *lost]),
    )
