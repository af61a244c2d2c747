"""How a detector does on an image of known truth."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray
from threadpoolctl import threadpool_limits

from virtual_sensor import interrupts
from virtual_sensor.metrology.centres import LineCentres, Status
from virtual_sensor.metrology.drawn_lines import line_shares
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import FINE_PX, TrueLine, compare_line, rms
from virtual_sensor.records import Table
from virtual_sensor.studies.trial.images import AMOUNTS, Condition, TrialImage, drawn_line

Array = NDArray[np.float64]

OUTLIER_PX, OUTLIER_BOUNDS = 0.5, 6.0  # an outlier is farther off than both
WRONG_SIGMAS, MOST_WRONG = 6.0, 0.01
"""No centre that is OK may be off by more of its own sigmas, but in so many columns."""
PHASES = np.linspace(-0.5, 0.5, 41)
_ENDS_PX = 3.5  # columns next to a line's ends are lit in part: their truth is of another place
_WITH_GHOSTS = ("ghostly frame", "spattered frame")
_PEAKS, _APART = 3, 4.0  # sought there; line widths from which on a place is beside it
_RUNS, _MOST_RUNS, _TASK_S = 3, 30, 0.5


@dataclass(frozen=True)
class Score(Condition):
    """One detector on one image; outliers are counted, and are not in bias, std and rms.

    Attributes
    ----------
    detector : str
        Its name.
    bias_px, std_px, rms_px : float
        Of the errors: mean, standard deviation, root mean square.
    predicted_px : float
        Rms of the sigma that the detector predicts for the centres counted; NaN if it can't.
    bound_px : float
        Rms of the Cramer-Rao bound over the columns; NaN where noise is not all.
    outlier_share, lost_share : float
        Of the columns with a line: wrong though OK; without a centre.
    wrong_share, marked_wrong_share : float
        Of them: OK, yet off by more than six of the sigmas that the detector predicts for it
        (and 0.02 px), or OK where there is no line. Where it predicts no error it promises none.
        Likewise of centres that are marked as worth less: CLIPPED and CORRECTED.
    ghosts : int
        Places beside the line that it gives in a ghostly or spattered frame, asked for three peaks
        of a column.
    ghost_share : float
        Of them: those that it labels GHOST, and does not take for the line.
    columns : int
        With a line.
    time_us : float
        Processor time of a column.
    """

    detector: str
    bias_px: float
    std_px: float
    rms_px: float
    predicted_px: float
    bound_px: float
    outlier_share: float
    lost_share: float
    wrong_share: float
    marked_wrong_share: float
    ghosts: int
    ghost_share: float
    columns: int
    time_us: float

    @property
    def condition(self) -> Condition:
        """What the image is like."""
        numbers = self.width_px, self.column_electrons, self.read_noise_electrons
        return Condition(self.kind, *numbers, sensor=self.sensor, amount=self.amount)

    @property
    def ratio(self) -> float:
        """The error over its bound."""
        return self.rms_px / self.bound_px

    @property
    def right_share(self) -> float:
        """Of the columns with a line: those whose centre is no outlier."""
        return max(1.0 - self.outlier_share - self.lost_share, 0.0)

    @property
    def sigma_ratio(self) -> float:
        """The error that the detector predicts over the one that it makes."""
        return self.predicted_px / self.rms_px

    @property
    def breaks_the_rule(self) -> bool:
        """Whether more than 1 % of the columns are OK, and farther off than it says: six sigmas."""
        return self.wrong_share > MOST_WRONG


def score_drawn(
    detectors: list[str], condition: Condition, columns: int, seed: tuple[int, ...]
) -> list[Score]:
    """Draw a line, and score every detector on it."""
    return score_all(detectors, condition, drawn_line(condition, columns, seed))


def score_all(detectors: list[str], condition: Condition, image: TrialImage) -> list[Score]:
    """Every detector on the same image."""
    return [score(name, condition, image) for name in detectors]


def score(detector: str, condition: Condition, image: TrialImage) -> Score:
    """Find the line's centres and set them beside the truth."""
    took: list[float] = []
    enough_s = _TASK_S if condition.kind == "task" else 0.0  # a detector is chosen by its time
    runs = 1 if condition.kind in AMOUNTS else _RUNS
    while len(took) < runs or (sum(took) < enough_s and len(took) < _MOST_RUNS):
        began = time.process_time()
        line = line_centres(image.grey, detector, **image.options)
        took.append(time.process_time() - began)
    errors = compare_line(line, image.truth, end_px=_ENDS_PX)
    bound = image.bound_px[np.rint(errors.column).astype(int)]
    least = np.maximum(OUTLIER_PX, OUTLIER_BOUNDS * np.nan_to_num(bound))
    wild = np.abs(errors.error_px) > least
    beside, labelled = _ghosts(detector, condition, image)
    good, sigma = errors.error_px[~wild], errors.sigma[~wild]
    with_sigma = np.isfinite(sigma)
    return Score(
        **asdict(condition),
        detector=detector,
        bias_px=float(good.mean()) if good.size else np.nan,
        std_px=float(good.std()) if good.size else np.nan,
        rms_px=rms(good),
        predicted_px=rms(sigma) if with_sigma.sum() > 0.5 * with_sigma.size else np.nan,
        bound_px=rms(image.bound_px[image.truth.columns(_ENDS_PX)]),
        outlier_share=float(wild.sum() / errors.expected),
        lost_share=errors.lost.size / errors.expected,
        wrong_share=_wrong(line, (Status.OK,), image),
        marked_wrong_share=_wrong(line, (Status.CLIPPED, Status.CORRECTED), image),
        ghosts=beside,
        ghost_share=labelled / beside if beside else np.nan,
        columns=errors.expected,
        time_us=1e6 * min(took) / image.grey.shape[1],
    )


def _wrong(line: LineCentres, of: tuple[Status, ...], image: TrialImage) -> float:
    """Centres of such statuses that are off by more than they say, over the line's columns."""
    others = line.found & ~np.isin(line.status, of)
    alone = replace(line, status=np.where(others, Status.NO_PEAK, line.status).astype(np.uint8))
    errors = compare_line(alone, image.truth, end_px=_ENDS_PX)
    claimed = np.maximum(WRONG_SIGMAS * errors.sigma, FINE_PX)  # NaN claims nothing
    wrong = np.abs(errors.error_px) > claimed
    return float(wrong.sum() + errors.stray_centres) / errors.expected


def _ghosts(detector: str, condition: Condition, image: TrialImage) -> tuple[int, int]:
    """Places that a detector gives beside the line, and those of them labelled GHOST."""
    if condition.kind not in _WITH_GHOSTS:
        return 0, 0
    several = line_centres(image.grey, detector, peaks=_PEAKS, **image.options)
    column = np.clip(np.rint(several.column).astype(int), 0, image.grey.shape[1] - 1)
    away = np.abs(several.row - image.truth.centres().row[column])
    beside = away > _APART * condition.width_px  # not where either is unknown
    is_ghost = several.status == Status.GHOST
    return int((beside & (is_ghost | several.found)).sum()), int((beside & is_ghost).sum())


@dataclass(frozen=True)
class Phases(Table):
    """Bias of the detectors, without any noise, at sub-pixel places of the line.

    Attributes
    ----------
    detector : sequence of str
        Its name.
    width_px : sequence of float
        Standard deviation of the line's profile.
    phase_px : sequence of float
        Of the line's middle from that of a pixel.
    bias_px : sequence of float
        NaN where the detector fails.
    """

    detector: Sequence[str]
    width_px: Sequence[float]
    phase_px: Sequence[float]
    bias_px: Sequence[float]

    @classmethod
    def of(cls, bias_px: Mapping[tuple[str, float], Array]) -> Phases:
        """The biases (41,) at `PHASES`, by detector and width, as a table."""
        pairs = [pair for pair in bias_px for _ in PHASES]
        return cls(
            detector=[name for name, _ in pairs],
            width_px=[width for _, width in pairs],
            phase_px=[phase for _ in bias_px for phase in PHASES.tolist()],
            bias_px=[bias for values in bias_px.values() for bias in values.tolist()],
        )

    def at(self, detector: str, width_px: float) -> Array:
        """Phase and bias (2, N) of a detector for a line."""
        rows = zip(self.detector, self.width_px, self.phase_px, self.bias_px, strict=True)
        return np.array([(x, y) for d, w, x, y in rows if (d, w) == (detector, width_px)]).T


def phase_bias(detector: str, width_px: float) -> Array:
    """Bias (41,) in px at the sub-pixel phases `PHASES`, without any noise; NaN where it fails."""
    repeats = 41  # one that uses neighbouring columns needs one that is straight
    bias = np.full(PHASES.size, np.nan)
    for number, phase in enumerate(PHASES):
        truth = np.full(repeats, 40.0 + phase)
        image = 1e4 * line_shares(truth, width_px, 81)[0]
        errors = compare_line(line_centres(image, detector), TrueLine.of_rows(truth))
        middle = errors.error_px[np.rint(errors.column) == repeats // 2]
        bias[number] = middle[0] if middle.size else np.nan
    return bias


def alone_on_a_core(parent: int) -> None:
    """One thread for each process, as times are of one core; it ends with its parent."""
    interrupts.tie_to_parent(parent)
    cv2.setNumThreads(1)
    threadpool_limits(1)
