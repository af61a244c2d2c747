"""The trial: every detector on every image, in parallel, the same whatever the number of cores."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Future, ProcessPoolExecutor, as_completed
from dataclasses import dataclass, replace
from multiprocessing import get_context
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor import interrupts
from virtual_sensor.arrays import number_within
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, nearest
from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.metrology.detectors import NAMES, STEGER, find_detector
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine
from virtual_sensor.records import record_columns
from virtual_sensor.studies.machine import Machine, machine
from virtual_sensor.studies.pareto import not_beaten
from virtual_sensor.studies.trial.hard import Sample, hard_frames
from virtual_sensor.studies.trial.images import (
    AMOUNTS,
    KINDS,
    STATED,
    Condition,
    TrialImage,
    frame_line,
)
from virtual_sensor.studies.trial.scores import (
    Phases,
    Score,
    alone_on_a_core,
    phase_bias,
    score_all,
    score_drawn,
)

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
_NEAR = 1.1  # times the bound
_FAILS = 0.05  # of the columns
_WIDTHS_PX, _PEAKS = (0.3, 8.0), (10.0, 50_000.0)  # of a task, at least and at most


@dataclass(frozen=True)
class Trial(Displayed):
    """What came out.

    Attributes
    ----------
    scores : tuple of Score
        Of each detector on each image.
    phases : Phases
    samples : tuple of Sample
        Parts of the hard frames, to look at.
    task : Condition
        The line and camera that a detector is to be chosen for.
    seed, columns : int
        With which it can be repeated.
    machine : Machine
        What the times were measured on.
    time_s : float
    """

    scores: tuple[Score, ...]
    phases: Phases
    samples: tuple[Sample, ...]
    task: Condition
    seed: int
    columns: int
    machine: Machine
    time_s: float

    def _line(self) -> str:
        best = self.recommended
        words = f"recommended: {best.detector}" if best else ""
        count = f"{len(self.detectors)} detectors on {self.columns} columns each"
        return listed(count, words, f"{self.time_s:.3g} s")

    def _columns(self) -> dict[str, Any]:
        return record_columns(Score, self.scores)

    @property
    def detectors(self) -> list[str]:
        """Names, in the order in which they were asked for."""
        return list(dict.fromkeys(each.detector for each in self.scores))

    def of(self, *kinds: str) -> list[Score]:
        """The scores of some kinds of images."""
        return [each for each in self.scores if each.kind in kinds]

    @property
    def breaches(self) -> list[Score]:
        """Scores of detectors that promise more than they keep, the worst first.

        More than 1 % of a line's columns have a centre that is OK, and off by more than six of its
        own sigmas.
        """
        broken = [each for each in self.scores if each.breaks_the_rule]
        return sorted(broken, key=lambda each: -each.wrong_share)

    @property
    def recommended(self) -> Score | None:
        """For the task: of the detectors within a tenth of its bound the fastest.

        If none is, the most accurate one; None if none is sound.
        """
        sound = [each for each in self.of("task") if is_sound(each)]
        near = [each for each in sound if each.ratio <= _NEAR]
        if near:
            return min(near, key=lambda each: each.time_us)
        return min(sound, key=lambda each: each.rms_px, default=None)


def is_sound(score: Score) -> bool:
    """Whether a detector finds a centre in nearly all columns, and is right there."""
    return bool(np.isfinite(score.rms_px)) and score.lost_share + score.outlier_share < _FAILS


def front(scores: Sequence[Score]) -> list[Score]:
    """The sound ones that no other beats in both time and error, the fastest first."""
    return not_beaten(filter(is_sound, scores), lambda each: (each.time_us, each.rms_px))


def conditions(task: Condition, quick: bool) -> list[Condition]:
    """The drawn images: the task, widths x signals x noises, and each trouble at some widths."""
    widths = (1.0, 2.0, 4.0) if quick else WIDTHS_PX
    signals = (200.0, 2000.0, 20_000.0) if quick else ELECTRONS
    noises = DARK_NOISES_E[:1] if quick else DARK_NOISES_E
    clean = [Condition("clean", w, n, d) for d in noises for w in widths for n in signals]
    troubled = TROUBLED_WIDTHS_PX[1:2] if quick else TROUBLED_WIDTHS_PX
    kinds = ("saturated", "speckle", "ambient light")
    troubles = [
        Condition(kind, width, TROUBLED_ELECTRONS, DARK_NOISES_E[0])
        for kind in kinds
        for width in troubled
    ]
    return [*clean, *troubles, replace(task, kind="task")]


def kinds_of(names: Sequence[str]) -> tuple[str, ...]:
    """The kinds of images that names stand for: a kind, "hard" for all hard frames; () for all.

    Raises
    ------
    InputError
        Where there is no such kind.
    """
    groups = {"hard": tuple(AMOUNTS)}
    groups |= {kind.removesuffix(" frame"): (kind,) for kind in KINDS}
    groups |= {kind: (kind,) for kind in KINDS}
    found: dict[str, None] = {}
    for name in names:
        key = " ".join(name.lower().replace("_", " ").split())
        if key not in groups:
            raise InputError(
                f"trial: no images of the kind '{name}'; take {', '.join(KINDS)}, or hard"
                f"{nearest(key, [*groups])}"
            )
        found |= dict.fromkeys(groups[key])
    return tuple(found) or KINDS


def trial(
    detectors: Sequence[str] = (),
    task: Condition = STATED,
    seed: int = 0,
    columns: int = 2000,
    quick: bool = False,
    frames: bool = True,
    kinds: Sequence[str] = (),
    workers: int | None = None,
    report: Report = lambda stage, fraction: None,
) -> Trial:
    """Try detectors.

    Parameters
    ----------
    detectors : sequence of str
        Ours by name, or a user's (see `metrology.detectors`); by default all of ours.
    task : Condition
        The line and camera that a detector is to be chosen for.
    seed : int
        Of all images.
    columns : int
        Of each drawn image.
    quick : bool
        Few images, small frames.
    frames : bool
        Whether to render too: the part cold and hot, and hard frames.
    kinds : sequence of str
        Images that are wanted besides the task's, by default all: see `KINDS`; "hard" stands for
        all hard frames.
    workers : int, optional
        Processes; by default one for each core.
    report : callable
        Gets what is being done, and the fraction done.

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
    number_within("trial: width of the line", task.width_px, *_WIDTHS_PX, "0.3 to 8 px")
    number_within("trial: electrons at the peak", task.peak_electrons, *_PEAKS, "10 to 50000")
    number_within("trial: read noise", task.read_noise_electrons, 0.0, 1000.0, "0 to 1000 e")
    wanted = kinds_of(kinds)
    report("rendering the part", 0.0)
    rendered = list(_frames(quick, seed, task, wanted, report)) if frames else []
    drawn = [each for each in conditions(task, quick) if each.kind in ("task", *wanted)]
    widths = PHASE_WIDTHS_PX[1:4:2] if quick else PHASE_WIDTHS_PX
    pairs = [(name, width) for name in names for width in widths if "clean" in wanted]
    with _pool(workers) as pool:
        with interrupts.deaf_children():
            images = {
                pool.submit(score_drawn, names, each, columns, (seed, number)): each.kind
                for number, each in enumerate(drawn)
            }
            images |= {pool.submit(score_all, names, *each): each[0].kind for each in rendered}
            biases = {pool.submit(phase_bias, *pair): pair for pair in pairs}
        work: list[Future] = [*images, *biases]
        for done, future in enumerate(as_completed(work), 1):
            future.result()  # what failed ends the trial at once
            stage = f"{images[future]} lines" if future in images else "sub-pixel phases"
            report(stage, _FRAMES_SHARE + (1.0 - _FRAMES_SHARE) * done / len(work))
    return Trial(
        scores=tuple(score for future in images for score in future.result()),
        phases=Phases.of({pair: future.result() for future, pair in biases.items()}),
        samples=_samples(names, rendered),
        task=drawn[-1],
        seed=seed,
        columns=columns,
        machine=machine(),
        time_s=time.perf_counter() - began,
    )


def _frames(
    quick: bool, seed: int, task: Condition, kinds: tuple[str, ...], report: Report
) -> Iterator[tuple[Condition, TrialImage]]:
    """The part cold and hot, rendered; each at some exposures, or by the task's sensor at its.

    Then the hard frames.
    """
    yield from _part(quick, seed, task, kinds, report)

    def say(stage: str) -> None:
        report(stage, 0.5 * _FRAMES_SHARE)

    yield from hard_frames(quick, seed, task.sensor, kinds, say)


def _part(
    quick: bool, seed: int, task: Condition, kinds: tuple[str, ...], report: Report
) -> Iterator[tuple[Condition, TrialImage]]:
    peaks = FRAME_PEAKS_E[1:2] if quick else FRAME_PEAKS_E
    noise_e = DARK_NOISES_E[0]
    if task.sensor:
        peaks, noise_e = (task.peak_electrons,), task.read_noise_electrons
    film = _QUICK_FILM_PX if quick else _FILM_PX
    scene = load_scene(SCENE, width=film, height=film, line_radius=0.1 * 2048 / film)
    states = (("cold frame", scene.cold()), ("hot frame", scene))
    for number, (kind, state) in enumerate(states):
        if kind not in kinds:
            continue
        report(f"rendering the {kind}", 0.5 * number * _FRAMES_SHARE)
        frame = render_frame(state)
        truth = TrueLine.of_frame(frame)
        line = line_centres(frame.radiance)
        width = float(np.median(line.width[line.found]))
        for peak in peaks:
            condition = Condition.of_peak(kind, round(width, 2), peak, noise_e, task.sensor)
            yield condition, frame_line(condition, frame, truth, (seed, number, int(peak)))


def _samples(
    names: Sequence[str], rendered: Sequence[tuple[Condition, TrialImage]]
) -> tuple[Sample, ...]:
    """Of each kind of hard frame the hardest, with what a detector that searches columns finds."""
    by_column = (name for name in (NAMES[0], *names) if name in names and name != STEGER)
    detector = next(by_column, names[0])
    hardest = {at.kind: (at, image) for at, image in rendered if at.kind in AMOUNTS}
    return tuple(Sample.of(at, image, detector) for at, image in hardest.values())


def _pool(workers: int | None) -> ProcessPoolExecutor:
    # Spawned: the engine's threads do not survive a fork.
    cores = workers or len(os.sched_getaffinity(0))
    return ProcessPoolExecutor(cores, get_context("spawn"), alone_on_a_core, (os.getpid(),))
