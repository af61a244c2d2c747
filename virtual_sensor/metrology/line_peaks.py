"""Sub-pixel centres of a laser line, by any detector: image in, `LineCentres` out.

A smoothed copy shows where the line is; its centre comes from the untouched pixels, so that the
filter cannot shift it.
"""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import uniform_filter1d

from virtual_sensor.arrays import LARGEST, number_within, one_of, whole_number
from virtual_sensor.calls import public
from virtual_sensor.metrology.centres import LineCentres, Status, is_found, is_measured
from virtual_sensor.metrology.clipped_fits import clipping_level, fit_clipped, is_unsure
from virtual_sensor.metrology.continued_lines import off_the_line
from virtual_sensor.metrology.detectors import (
    COLUMNWISE,
    NAMES,
    STEGER,
    Estimate,
    Foreign,
    by_foreign,
    find_detector,
)
from virtual_sensor.metrology.line_choice import lies_along_rows, with_line_first
from virtual_sensor.metrology.line_ends import among_cuts, line_ends
from virtual_sensor.metrology.line_profiles import (
    MIN_SIGMA_PX,
    REACH,
    Array,
    Index,
    Noise,
    Peaks,
    Profile,
    by_width,
    checked_image,
    coarse_search,
    find_peaks,
    grey_value_facts,
    linear_of,
    noise_beside,
    saturation_level,
    window,
)
from virtual_sensor.metrology.line_shapes import Shapes, shapes
from virtual_sensor.metrology.reflectance_edges import Line, correct_edges
from virtual_sensor.metrology.ridges import ridges
from virtual_sensor.metrology.scatter import with_scatter

ALONG = ("columns", "rows", "auto")
CHOICES = ("path", "highest")

MOST_PEAKS = 100  # of a column
MOST_SIGMA_PX = 1e4
EXTREME = 1e12  # grey values beyond it, or below its inverse, are brought to about 1 first
IN_VIEW = 2.5  # a line counts as seen when so many sigma either side lie in the image
MAX_RESIDUAL = 0.15  # rms misfit, relative to the amplitude, that is still a line
MAX_APART_PX = 0.02  # of a detector's centre and the Gaussian's, and so many of its sigma
APART = 4.0
NEIGHBOURS = 65  # columns in which most centres must have a sigma
SAME_HEIGHT = 0.7  # from which on a second peak may be the line as well


@public
def line_centres(
    image: ArrayLike,
    method: str | Foreign = "gaussian",
    *,
    along: str = "columns",
    peaks: int = 1,
    choose: str = "path",
    min_amplitude: float = 0.01,
    saturation: float | None = None,
    max_sigma: float = 32.0,
    noise: float | None = None,
    gain: float = 0.0,
    sensor: Any = None,
) -> LineCentres:
    """Find the centres of a laser line in an image.

    Parameters
    ----------
    image : array_like of shape (H, W)
        Grey values, a `Frame`, or a `RecordedFrame`, which knows its noise, gain and saturation.
        NaN and infinity mark missing pixels, as a NumPy mask does.
    method : str or callable
        "gaussian" fits a pixel-integrated Gaussian on a level background by least squares in a
        window that follows its width, "weighted_gaussian" with weights by the measured grey values,
        "max_likelihood" under shot and read noise, where it attains the Cramer-Rao bound (give
        `noise` and `gain`).  In closed form: "log_parabola" (three-point Gaussian), "parabola",
        "linear_interpolation", "centre_of_gravity", "fir4" and "fir8" (Blais and Rioux).
        "steger" finds ridges of any direction.  Or a user's own: see `metrology.detectors`.
    along : {"columns", "rows", "auto"}
        Whether the line crosses each column (it lies flat in the image), or each row; "auto": which
        of them show more of it.
    peaks : int
        So many are sought in each column, up to 100.  With more than one the arrays have shape
        (peaks, W): the line comes first, then the highest of the rest, which are GHOST unless they
        are as good as the line.
    choose : {"path", "highest"}
        What is the line where columns have several peaks: the path across all columns that
        continues best, by peaks that are high and narrow (see `metrology.line_choice`), or the
        highest of each column.  With one peak, a column that shows a ghost alone is GHOST.
    min_amplitude : float
        Smallest height of a line, relative to the highest in the image.  What stands out by less
        than six sigma of the smoothed noise is no line either.
    saturation : float, optional
        Grey value from which on pixels are clipped: 4095 for a 12-bit camera.  By default the
        largest value of a uint8 or uint16 image, or what `read_image` says; others have none.  Flat
        tops below it show that pixels are clipped there already.  A clipped line's centre comes
        from its flanks, by a censored fit, whatever the method.
    max_sigma : float
        Broadest line in px; broader peaks are POOR_FIT.
    noise : float, optional
        Standard deviation of the grey values beside the line.  By default it is taken from the
        image, and a fit's from its residuals.
    gain : float
        Growth of the noise's variance per unit of signal: EMVA 1288's K, in grey values per
        electron; 1 for an image in electrons; 0, none, where only read noise counts.
    sensor : ImageSensor, optional
        That took the image: it knows `noise`, `gain` and `saturation`, where they are not given.

    Returns
    -------
    LineCentres
        Of shape (W,), or (H,) along rows, or (peaks, W); of "steger": (N,).

    Raises
    ------
    InputError
        Where the image is not a grey image of a known type, or an option is out of its range.
    """
    image = linear_of(image)
    told = grey_value_facts("line_centres: sensor", image, sensor)
    clipped = saturation_level(image, told.get("saturation") if saturation is None else saturation)
    image = checked_image(image)
    one_of("line_centres: along", along, ALONG)
    one_of("line_centres: choose", choose, CHOICES)
    peaks = whole_number("line_centres: peaks", peaks, 1, MOST_PEAKS)
    below_1, beyond_least = np.nextafter([1.0, MIN_SIGMA_PX], [0.0, 1.0])
    min_amplitude = number_within(
        "line_centres: min_amplitude", min_amplitude, 0.0, below_1, "it 0 <= ... < 1"
    )
    max_sigma = number_within(
        "line_centres: max_sigma",
        max_sigma,
        beyond_least,
        MOST_SIGMA_PX,
        f"it above {MIN_SIGMA_PX} px, and up to {MOST_SIGMA_PX:g}",
    )
    gain = number_within("line_centres: gain", gain, 0.0, LARGEST, "grey values per electron >= 0")
    gain, noise = gain or told.get("gain", 0.0), told.get("noise") if noise is None else noise
    if noise is not None:
        noise = number_within("line_centres: noise", noise, 0.0, LARGEST, "grey values >= 0")
    if along == "auto":
        along = ALONG[method != STEGER and lies_along_rows(image, noise, min_amplitude)]
    if along == "rows":
        image = np.ascontiguousarray(image.T)

    if isinstance(method, str) and method in NAMES:
        path = choose == "path"
        line = _ours(image, method, peaks, path, min_amplitude, clipped, max_sigma, noise, gain)
    else:
        line = by_foreign(image, method if callable(method) else find_detector(method))
    return line.transposed if along == "rows" else line


def _ours(
    image: NDArray,
    method: str,
    peaks: int,
    path: bool,
    min_amplitude: float,
    saturation: float,
    max_sigma: float,
    noise: float | None,
    gain: float,
) -> LineCentres:
    """By one of our own detectors, in a unit in which no square is too large or too small."""
    finite = np.isfinite(image)
    filled = image if finite.all() else np.where(finite, image, image[finite].min(initial=0))
    largest = max(abs(float(filled.max())), abs(float(filled.min())))
    unit = 1.0
    if largest > 0.0 and not 1.0 / EXTREME < largest < EXTREME:
        unit = largest
        image, filled = (values.astype(float) / unit for values in (image, filled))
    # More than any signal is enough, and stays a number.
    dark = noise_beside(filled, None if noise is None else min(float(noise) / unit, EXTREME))
    given = Noise(dark, min(float(gain) / unit, EXTREME), noise is not None or gain > 0.0)
    limits = min_amplitude, clipping_level(filled, saturation / unit), max_sigma
    if method == STEGER:
        line = ridges(image, given, *limits)
    else:
        seen = finite.any(axis=0)
        line = _columnwise(image, filled, seen, COLUMNWISE[method], given, peaks, path, *limits)
    return replace(line, amplitude=line.amplitude * unit, background=line.background * unit)


def _columnwise(
    image: NDArray,
    filled: NDArray,
    seen: NDArray[np.bool_],
    estimate: Estimate,
    noise: Noise,
    count: int,
    path: bool,
    min_amplitude: float,
    saturation: float,
    max_sigma: float,
) -> LineCentres:
    coarse = coarse_search(filled, noise.dark, min_amplitude)
    peaks, ghosts = find_peaks(coarse, max_sigma, count), np.zeros((count, seen.size), bool)
    if path:
        peaks, ghost = with_line_first(peaks, count, SAME_HEIGHT, coarse, max_sigma)
        ghosts[peaks.rank, peaks.column] = ghost
    if count > 1:  # neighbours of one line beside each other
        peaks = peaks.take(np.lexsort((peaks.column, peaks.rank)))
    status = np.full((count, seen.size), Status.NO_PEAK, np.uint8)
    status[:, ~seen] = Status.BAD_PIXELS
    screened = _screen(image, peaks, saturation, max_sigma)
    status[peaks.rank, peaks.column] = screened
    lines = np.full((len(Line._fields), count, seen.size), np.nan)
    uneven = np.zeros(status.shape)
    lines[:, peaks.rank, peaks.column] = peaks.row, peaks.sigma, peaks.amplitude, peaks.background
    clipped, peaks = (peaks.take(screened == each) for each in (Status.SATURATED, Status.OK))

    found = np.full((len(Profile._fields), count, seen.size), np.nan)
    shape = shapes(filled, peaks, noise, max_sigma)
    for chosen in by_width(shape.peaks.sigma):  # a broad peak widens no other's window
        group = shape.peaks.take(chosen)
        profile = estimate(filled, group, noise, max_sigma)
        status[group.rank, group.column] = _judge(
            image, profile, noise, Shapes._make((group, *(part[chosen] for part in shape[1:])))
        )
        found[:, group.rank, group.column] = profile
    at = shape.peaks
    lines[:, at.rank, at.column] = at.row, at.sigma, at.amplitude, at.background
    uneven[at.rank, at.column] = shape.uneven
    uncertain = found[1].copy()  # by how much the amplitude may change from column to column
    first = uneven[0], status[0], found[:, 0]  # of the line: ghosts stay as they are
    correct_edges(image, Line(*lines[:, 0]), *first, noise, saturation)
    if clipped.row.size:
        profile, verdict, height_error = fit_clipped(filled, clipped, noise, saturation, max_sigma)
        status[clipped.rank, clipped.column] = verdict
        found[:, clipped.rank, clipped.column] = profile
        uncertain[clipped.rank, clipped.column] = height_error * profile.sigma
        cut_off = np.flatnonzero(status[0] == Status.CLIPPED)
        clear = (status[0] == Status.OK) & ~ghosts[0]
        doubt = off_the_line(found[0, 0], clear, cut_off, lines[1, 0, cut_off])
        found[1, 0, cut_off] = np.hypot(found[1, 0, cut_off], doubt)
        status[0, cut_off[is_unsure(*found[1:3, 0, cut_off])]] = Status.SATURATED

    there = is_found(status) | (status == Status.CUT)
    found[:, ~there] = np.nan
    row, error, width, amplitude, _ = found
    ends = line_ends((status != Status.NO_PEAK) & seen, row, uncertain, width, amplitude)
    status[ends & there] = Status.LINE_END
    status[among_cuts(status, width)] = Status.CUT
    status[ghosts & is_found(status)] = Status.GHOST
    found[:, ~(is_measured if count > 1 else is_found)(status)] = np.nan
    if count == 1:
        found, status = found[:, 0], status[0]
    row, error, width, amplitude, background = found
    error[_known_by_chance(error, is_found(status))] = np.nan
    error = with_scatter(error, width, is_found(status), noise.known)
    column, along = np.broadcast_to(np.arange(seen.size), status.shape), np.full(status.shape, 90.0)
    return LineCentres(column, row, error, width, amplitude, background, along, status)


def _known_by_chance(sigma: Array, found: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Where most of the neighbours have no sigma: those that have one are a biased choice."""
    known, there = (
        uniform_filter1d(values.astype(float), NEIGHBOURS, axis=-1, mode="constant")
        for values in (np.isfinite(sigma), found)
    )
    return known < 0.5 * there


def _screen(image: NDArray, at: Peaks, saturation: float, max_sigma: float) -> Index:
    """Status of each peak before any fit: (L,)."""
    bad = np.zeros((2, at.row.size), bool)
    doubtful = ~(image.max(axis=0) < saturation) | ~np.isfinite(image.min(axis=0))
    some = np.flatnonzero(doubtful[at.column])
    if some.size:
        here = at.take(some)
        rows, inside, values = window(image, here)
        near = inside & (np.abs(rows - here.row) <= REACH * np.maximum(here.sigma, 1.0))
        wrong = np.stack([~np.isfinite(values), values >= saturation])
        bad[:, some] = (near & wrong).any(axis=1)
    reasons = {
        Status.BAD_PIXELS: bad[0],
        Status.SATURATED: bad[1] & (at.second <= SAME_HEIGHT),
        Status.AT_BORDER: (at.peak == 0) | (at.peak == len(image) - 1),
        Status.POOR_FIT: at.sigma > max_sigma,
        Status.DOUBLED: at.second > SAME_HEIGHT,
    }
    return np.select(list(reasons.values()), list(reasons), Status.OK)


def _judge(image: NDArray, profile: Profile, noise: Noise, shape: Shapes) -> Index:
    """Status of each fitted peak: (L,)."""
    at = shape.peaks
    found = np.isfinite(profile.row)
    row = np.where(found, profile.row, at.row)
    margin = IN_VIEW * at.sigma
    in_view = (row - margin >= -0.5) & (row + margin <= len(image) - 0.5)
    spread = np.sqrt(noise.variance(at.amplitude, at.column))
    misfit = at.residual > MAX_RESIDUAL * at.amplitude + 2.0 * np.maximum(spread, at.speckle)
    apart = np.abs(row - at.row) > MAX_APART_PX + APART * shape.noisy * profile.row_error
    width_error = np.sqrt(at.sigma) * np.maximum(spread, at.residual) / at.amplitude
    narrow = np.where(found, profile.sigma, at.sigma) - width_error < MIN_SIGMA_PX
    reasons = (
        # In noise a line too narrow may seem broad enough.
        (Status.TOO_NARROW, narrow),
        (Status.AT_BORDER, ~in_view),
        (Status.CUT, shape.sharp & (shape.skewed | shape.flat | apart | misfit)),
        (Status.POOR_FIT, ~found),
        (Status.DOUBLED, shape.flat & ~shape.skewed),
        (Status.SKEWED, shape.skewed | apart),  # of a symmetric line all centres are the same
        (Status.POOR_FIT, misfit),
    )
    return np.select([is_so for _, is_so in reasons], [why for why, _ in reasons], Status.OK)
