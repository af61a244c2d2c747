"""The trial: every detector on every image, in parallel, the same whatever the number of cores."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass
from multiprocessing import get_context
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from virtual_sensor import interrupts
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.metrology.detectors import NAMES, find_detector
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine
from virtual_sensor.studies.provenance import made_with
from virtual_sensor.studies.trial.images import Condition, TrialImage, frame_line
from virtual_sensor.studies.trial.scores import Score, phase_bias, score_all, score_drawn

Array = NDArray[np.float64]
Report = Callable[[str, float], None]

WIDTHS_PX = (0.5, 0.7, 1.0, 1.5, 2.0, 3.0, 4.0, 6.0)
ELECTRONS = (200.0, 632.0, 2000.0, 6320.0, 20_000.0)
DARK_NOISES_E = (2.0, 10.0)
PHASE_WIDTHS_PX = (0.7, 1.0, 1.5, 2.0, 3.0)
TROUBLED_WIDTHS_PX, TROUBLED_ELECTRONS = (1.0, 2.0, 4.0), 6320.0
FRAME_PEAKS_E = (30.0, 300.0, 3000.0)
SCENE = "hot_cylinder"
_FILM_PX, _QUICK_FILM_PX = 1024, 384
_FRAMES_SHARE = 0.1  # of the time


@dataclass(frozen=True)
class Trial:
    """What came out.

    Attributes
    ----------
    scores : list of Score
    phases : dict
        (detector, width) to the bias at `PHASES`, px.
    seed, columns : int
        With which it can be repeated.
    machine : dict
    seconds : float
    """

    scores: list[Score]
    phases: dict[tuple[str, float], Array]
    seed: int
    columns: int
    machine: dict[str, Any]
    seconds: float

    @property
    def detectors(self) -> list[str]:
        """Names, in the order in which they were asked for."""
        return list(dict.fromkeys(each.detector for each in self.scores))

    def of(self, kind: str) -> list[Score]:
        """The scores of one kind of image."""
        return [each for each in self.scores if each.condition.kind == kind]


def conditions(quick: bool) -> list[Condition]:
    """The drawn images: widths x signals x noises, and each trouble at some widths."""
    widths = (1.0, 2.0, 4.0) if quick else WIDTHS_PX
    signals = (200.0, 2000.0, 20_000.0) if quick else ELECTRONS
    noises = DARK_NOISES_E[:1] if quick else DARK_NOISES_E
    clean = [Condition("clean", w, n, d) for d in noises for w in widths for n in signals]
    troubled = TROUBLED_WIDTHS_PX[1:2] if quick else TROUBLED_WIDTHS_PX
    kinds = ("saturated", "speckle", "ambient light")
    return clean + [
        Condition(kind, width, TROUBLED_ELECTRONS, DARK_NOISES_E[0])
        for kind in kinds
        for width in troubled
    ]


def trial(
    detectors: Sequence[str] = (),
    seed: int = 0,
    columns: int = 2000,
    quick: bool = False,
    frames: bool = True,
    workers: int | None = None,
    report: Report = lambda stage, fraction: None,
) -> Trial:
    """Try detectors.

    Parameters
    ----------
    detectors : sequence of str
        Ours by name, or a user's (see `metrology.detectors`); by default all of ours.
    seed : int
        Of all images.
    columns : int
        Of each drawn image.
    quick : bool
        Few images, small frames.
    frames : bool
        Whether to render the part cold and hot too.
    workers : int, optional
        Processes; by default one a core.
    report : callable

    Raises
    ------
    InputError
        Where a detector is not known, or a number is out of its range.
    """
    began = time.perf_counter()
    names = list(dict.fromkeys(detectors)) or list(NAMES)
    if columns < 100 or seed < 0:
        raise InputError(f"trial: columns is {columns}, seed {seed}; give 100 or more, 0 or more")
    for name in names:
        if name not in NAMES:
            find_detector(name)  # is there such a one?
    report("rendering the part", 0.0)
    rendered = list(_frames(quick, seed, report)) if frames else []
    drawn = conditions(quick)
    widths = PHASE_WIDTHS_PX[1:4:2] if quick else PHASE_WIDTHS_PX
    scores: dict[int, Score] = {}
    phases: dict[tuple[str, float], Array] = {}
    with _pool(workers) as pool:
        with interrupts.deaf_children():
            work = {}
            for number, condition in enumerate(drawn):
                arguments = (names, condition, columns, (seed, number))
                work[pool.submit(score_drawn, *arguments)] = number
            for number, (condition, image) in enumerate(rendered, len(drawn)):
                work[pool.submit(score_all, names, condition, image)] = number
            pairs = [(name, width) for name in names for width in widths]
            later = {pool.submit(phase_bias, *pair): pair for pair in pairs}
        waited: list[Future] = [*work, *later]
        for done, future in enumerate(as_completed(waited)):
            if future in later:
                phases[later[future]] = future.result()
                told = "sub-pixel phases"
            else:
                first = work[future] * len(names)
                scores |= dict(enumerate(future.result(), first))
                told = f"{scores[first].condition.kind} lines"
            report(told, _FRAMES_SHARE + (1.0 - _FRAMES_SHARE) * (done + 1) / len(waited))
    ordered = [scores[number] for number in sorted(scores)]
    in_order = {key: phases[key] for key in later.values()}
    return Trial(
        ordered, in_order, seed, columns, made_with().to_dict(), time.perf_counter() - began
    )


def _frames(quick: bool, seed: int, report: Report) -> Iterator[tuple[Condition, TrialImage]]:
    """The part cold and hot, rendered; each at some exposures."""
    film = _QUICK_FILM_PX if quick else _FILM_PX
    scene = load_scene(SCENE, width=film, height=film, line_radius=0.1 * 2048 / film)
    states = (("cold frame", scene.cold()), ("hot frame", scene))
    for number, (kind, state) in enumerate(states):
        report(f"rendering the {kind}", 0.5 * number * _FRAMES_SHARE)
        frame = render_frame(state)
        truth = TrueLine.of_coordinates(frame.coordinates()[:, :, 0], state.sensor.laser.radius_mm)
        width = float(np.nanmedian(line_centres(frame.radiance).width))
        for peak in FRAME_PEAKS_E[1:2] if quick else FRAME_PEAKS_E:
            condition = Condition.of_peak(kind, round(width, 2), peak, DARK_NOISES_E[0])
            yield condition, frame_line(condition, frame, truth, (seed, number, int(peak)))


def _pool(workers: int | None) -> ProcessPoolExecutor:
    # Started anew: a fork would take the engine's threads along, which do not survive it.
    return ProcessPoolExecutor(
        workers or len(os.sched_getaffinity(0)), get_context("spawn"), _alone, (os.getpid(),)
    )


def _alone(parent: int) -> None:
    """One thread for each process, as times are of one core; none outlives this one."""
    interrupts.tie_to_parent(parent)
    cv2.setNumThreads(1)
    threadpool_limits(1)
