"""How a detector does on an image of known truth."""

from __future__ import annotations

import time
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.metrology.drawn_lines import line_shares
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.truth import TrueLine, compare_line, rms
from virtual_sensor.studies.trial.images import Condition, TrialImage, drawn_line

Array = NDArray[np.float64]

OUTLIER_PX, OUTLIER_BOUNDS = 0.5, 6.0  # an outlier is farther off than both
PHASES = np.linspace(-0.5, 0.5, 41)
_ENDS_PX = 3.5  # columns next to a line's ends are lit in part: their truth is of another place
_RUNS = 3


@dataclass(frozen=True)
class Score:
    """One detector on one image; outliers are counted, and are not in bias, std and rms.

    Attributes
    ----------
    detector : str
    condition : Condition
    bias_px, std_px, rms_px : float
    predicted_px : float
        Rms of the sigma that the detector predicts for the centres counted; NaN if it can't.
    bound_px : float
        Rms of the Cramer-Rao bound over the columns; NaN where noise is not all.
    outliers, failures : float
        Shares of the columns with a line: wrong though OK; without a centre.
    columns : int
        With a line.
    seconds : float
        Of a column.
    """

    detector: str
    condition: Condition
    bias_px: float
    std_px: float
    rms_px: float
    predicted_px: float
    bound_px: float
    outliers: float
    failures: float
    columns: int
    seconds: float


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
    took = []
    for _ in range(_RUNS):
        began = time.perf_counter()
        line = line_centres(image.grey, detector, **image.options)
        took.append(time.perf_counter() - began)
    errors = compare_line(line, image.truth, end_px=_ENDS_PX)
    bound = image.bound_px[np.rint(errors.column).astype(int)]
    least = np.maximum(OUTLIER_PX, OUTLIER_BOUNDS * np.nan_to_num(bound))
    wild = np.abs(errors.error_px) > least
    good, told = errors.error_px[~wild], errors.sigma[~wild]
    with_sigma = np.isfinite(told)
    return Score(
        detector,
        condition,
        bias_px=float(good.mean()) if good.size else np.nan,
        std_px=float(good.std()) if good.size else np.nan,
        rms_px=rms(good),
        predicted_px=rms(told) if with_sigma.sum() > 0.5 * with_sigma.size else np.nan,
        bound_px=rms(image.bound_px[image.truth.columns(_ENDS_PX)]),
        outliers=float(wild.sum() / errors.expected),
        failures=errors.lost.size / errors.expected,
        columns=errors.expected,
        seconds=min(took) / image.grey.shape[1],
    )


def phase_bias(detector: str, width_px: float) -> Array:
    """Bias (41,) in px at the sub-pixel phases `PHASES`, without any noise; NaN where it fails."""
    repeats = 41  # a detector that looks along the line too needs one that is straight
    bias = np.full(PHASES.size, np.nan)
    for number, phase in enumerate(PHASES):
        truth = np.full(repeats, 40.0 + phase)
        image = 1e4 * line_shares(truth, width_px, 81)[0]
        errors = compare_line(line_centres(image, detector), TrueLine.of_rows(truth))
        middle = errors.error_px[np.rint(errors.column) == repeats // 2]
        bias[number] = middle[0] if middle.size else np.nan
    return bias
