"""A planar target for calibration: its marks, in a camera's image and in the projector's."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, ClassVar

import cv2
import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import number_within, numbers_of, one_of, points_of, whole_number
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, tally
from virtual_sensor.errors import InputError, short
from virtual_sensor.metrology.covariance import SIGMA_BY_MEDIAN
from virtual_sensor.statuses import StatusEnum

Array = NDArray[np.float64]

KINDS = ("checkerboard", "dots")

_MARGIN = 1.5  # pitches from the outer marks to the target's edge
_SEARCHED_PX = 1200  # longer side of an image in which OpenCV searches
_BLURS = 1.0 / 10.0, 1.0 / 6.0  # pitches, of a corner's two Gaussian kernels
_LEAST_DOT = 20.0  # area in px, for OpenCV's search
_DOT_WINDOW, _RING = 0.48, 0.36  # pitches: the ground around a dot
_LEAST_GROUND = 12  # pixels
_MOST_STEPS, _SOLVED_PX = 20, 1e-4
_ITERATIONS = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 1e-2)
_PHASE_WINDOW = 0.42
_LEAST_WINDOW_PX = 3
_REACH = 0.6  # pitches round a mark that must be in the image
_FAINT = 0.3  # contrast of a mark, by the median of all
_NEAR = 0.4  # pitches that a mark lies from where it is expected, at most
_OVERSAMPLED = 8  # samples per texel of a drawn target, each way
_MOST_POINTS = 2500  # of a window, that phases are interpolated from
_FEW = 0.5  # share of a window's pixels that must have phases
_ROBUST = 5.0  # standard deviations, of pixels on the marks' edges


class MarkStatus(StatusEnum):
    """Whether a mark of a target takes part in a calibration, and if not, why."""

    FOUND = 0, "The mark has its pixel, and the projector's pixel where that was asked for."
    OUTSIDE = 1, "The mark lies outside the image, or its border cuts it: move the target."
    NOT_FOUND = (
        2,
        "No mark was found where the others expect it: look for what hides it or glares.",
    )
    DARK = 3, "The mark has little contrast: give it more light, or expose longer."
    NO_PHASE = (
        4,
        "The projector's phases are not known around the mark; its camera pixel takes part: "
        "move the target to where the projector lights it.",
    )
    OUTLIER = (
        5,
        "The mark is far from where the fit has it, and was left out: where many are, look for a "
        "target that moved or is not flat.",
    )


@public
@dataclass(frozen=True)
class CalibrationTarget(Displayed):
    """A plate with marks on a grid: inner corners of a checkerboard, or centres of dots.

    Its frame: origin in the middle of the marks, x along the rows, y along the columns, z into the
    plate; so x is to the right and y down for who looks at its face.

    Attributes
    ----------
    kind : str
        "checkerboard" or "dots".
    columns, rows : int
        Marks along x and y.
    pitch_mm : float
        From a mark to the next: the side of a square.
    dark, bright : float
        Reflectance of what is black and white; the projector's phases need some light from both.
    """

    kind: str = "checkerboard"
    columns: int = 11
    rows: int = 9
    pitch_mm: float = 4.0
    dark: float = 0.15
    bright: float = 0.75

    def __post_init__(self) -> None:
        one_of("CalibrationTarget: kind", self.kind, KINDS)
        for name in ("columns", "rows"):
            whole_number(f"CalibrationTarget: {name}", getattr(self, name), 3, 200)
        number_within("CalibrationTarget: pitch_mm", self.pitch_mm, 1e-6, 1e6, "mm, positive")
        for name in ("dark", "bright"):
            advice = "a reflectance from 0 to 1"
            number_within(f"CalibrationTarget: {name}", getattr(self, name), 0.0, 1.0, advice)
        if not self.dark < self.bright:
            raise InputError("CalibrationTarget: dark is not below bright; give it darker")

    def _line(self) -> str:
        return listed(f"{self.kind} of {self.columns} x {self.rows} marks", f"{self.pitch_mm:g} mm")

    @property
    def points_mm(self) -> Array:
        """The marks row by row, (N, 3), z = 0."""
        middle = (np.array([self.columns, self.rows]) - 1) / 2.0
        grid = np.stack(np.meshgrid(np.arange(self.columns), np.arange(self.rows)), axis=-1)
        places = (grid.reshape(-1, 2) - middle) * self.pitch_mm
        return np.column_stack([places, np.zeros(len(places))])

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the plate."""
        width, height = (n - 1 + 2.0 * _MARGIN for n in (self.columns, self.rows))
        return width * self.pitch_mm, height * self.pitch_mm

    @property
    def dot_radius_mm(self) -> float:
        """Of a dot; a quarter of the pitch."""
        return self.pitch_mm / 4.0

    def drawn(self, texels_per_pitch: int = 128) -> NDArray[np.float32]:
        """Reflectance of the plate, (H, W): rows along y, each texel's mean."""
        fine = texels_per_pitch * _OVERSAMPLED
        tile = (np.arange(fine) + 0.5) / fine - 0.5  # pitches from a mark, half of one each way
        x, y = np.meshgrid(tile, tile)
        if self.kind == "dots":
            black = np.hypot(x, y) < self.dot_radius_mm / self.pitch_mm
        else:
            black = (x < 0.0) == (y < 0.0)
        shape = (texels_per_pitch, _OVERSAMPLED, texels_per_pitch, _OVERSAMPLED)
        share = black.reshape(shape).mean(axis=(1, 3))
        column, row = np.arange(self.columns), np.arange(self.rows)
        if self.kind == "dots":
            tiles = np.tile(share, (self.rows, self.columns))
        else:  # squares of neighbours meet: each other mark has the colours the other way
            odd = (row[:, None] + column) % 2
            both = np.stack([share, 1.0 - share])[odd]
            tiles = both.transpose(0, 2, 1, 3).reshape(self.rows * texels_per_pitch, -1)
            half = texels_per_pitch // 2  # the outer squares are whole
            tiles = np.pad(tiles, half, mode="edge")
        margin = round(_MARGIN * texels_per_pitch) - texels_per_pitch // 2
        margin -= 0 if self.kind == "dots" else texels_per_pitch // 2
        share = np.pad(tiles, margin)
        return (self.bright + (self.dark - self.bright) * share).astype(np.float32)


@dataclass(frozen=True)
class Marks(Displayed):
    """Where N marks of a target are.

    Attributes
    ----------
    pixel : ndarray of shape (N, 2)
        (u, v), px; NaN unless found.
    status : ndarray of shape (N,)
        `MarkStatus`.
    """

    _field_units: ClassVar = {"pixel": "px"}
    _statuses: ClassVar = {"status": MarkStatus}
    _by_row: ClassVar = True

    pixel: Array
    status: NDArray[np.uint8]

    def _line(self) -> str:
        return tally(self.status, MarkStatus.FOUND)


@public
def find_marks(
    image: ArrayLike, target: CalibrationTarget, expected_px: ArrayLike | None = None
) -> Marks:
    """Find a target's marks in an image, to hundredths of a pixel.

    Parameters
    ----------
    image : array_like of shape (H, W)
        In any unit; what is not finite counts as black.
    target : CalibrationTarget
    expected_px : array_like of shape (N, 2), optional
        (u, v) within half a pitch of the marks, where they are known; then a part of the target is
        enough.  By default OpenCV searches the whole target, all of whose marks must be in the
        image (`findChessboardCornersSB`, `findCirclesGrid`).  A target that looks the same when it
        is turned may be found so: a calibration does not depend on it.

    Returns
    -------
    Marks
        In the order of `target.points_mm`.

    Raises
    ------
    InputError
        If it is no image, or the expected pixels are not as many as marks.

    Notes
    -----
    A corner is the saddle point of the blurred image, which perspective does not move: two straight
    edges cross there.  (`cornerSubPix`, from which the search starts, errs by 0.04 px where edges
    are sharp.)  A dot's centre is that of its area, less the shift of an ellipse's centre in
    perspective (Heikkila 2000, IEEE Trans. PAMI 22, 1066).
    """
    grey = numbers_of("find_marks: image", image)
    if grey.ndim != 2 or min(grey.shape) < 2 * _LEAST_WINDOW_PX:
        raise InputError(f"find_marks: the image has the shape {grey.shape}; give (H, W)")
    _check_target("find_marks", target)
    count = target.columns * target.rows
    finite = np.isfinite(grey)
    low, high = np.percentile(grey[finite], [0.1, 99.9]) if finite.any() else (0.0, 0.0)
    none = Marks(np.full((count, 2), np.nan), np.full(count, MarkStatus.NOT_FOUND, np.uint8))
    if expected_px is None:
        if not high > low:
            return none
        scaled = np.clip((np.where(finite, grey, low) - low) / (high - low), 0.0, 1.0)
        found = _searched(np.round(255.0 * scaled).astype(np.uint8), target)
        if found is None:
            return none
        start = _face_up(found, target)
    else:
        start = points_of("find_marks: expected_px", expected_px, 2)
        if start.shape != (count, 2):
            raise InputError(
                f"find_marks: expected_px has the shape {start.shape}; give ({count}, 2)"
            )
        if not high > low:
            return none
    level = ((np.where(finite, grey, low) - low) / (high - low)).astype(np.float32)
    return _refined(level, target, start)


def _check_target(asker: str, target: Any) -> None:
    if not isinstance(target, CalibrationTarget):
        raise InputError(f"{asker}: target is {short(target)}; give a CalibrationTarget")


def _searched(image: NDArray[np.uint8], target: CalibrationTarget) -> Array | None:
    """The marks of a whole target (N, 2), to a pixel or so; None where OpenCV finds none."""
    factor = min(1.0, _SEARCHED_PX / max(image.shape))
    if factor < 1.0:
        image = cv2.resize(image, None, fx=factor, fy=factor, interpolation=cv2.INTER_AREA)
    size = target.columns, target.rows
    try:
        if target.kind == "checkerboard":
            flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_EXHAUSTIVE
            found, places = cv2.findChessboardCornersSB(image, size, flags=flags)
        else:
            parameters = cv2.SimpleBlobDetector_Params()
            parameters.minArea = _LEAST_DOT
            parameters.maxArea = image.size / (2.0 * target.columns * target.rows)
            parameters.minDistBetweenBlobs = 3.0
            detector = cv2.SimpleBlobDetector_create(parameters)
            for flags in (0, cv2.CALIB_CB_CLUSTERING):
                flags |= cv2.CALIB_CB_SYMMETRIC_GRID
                found, places = cv2.findCirclesGrid(image, size, flags=flags, blobDetector=detector)
                if found:
                    break
    except cv2.error:  # of images in which it can't search
        return None
    if not found:
        return None
    actual = np.array(image.shape[::-1]) / np.round(np.array(image.shape[::-1]) / factor)
    return (np.asarray(places, float).reshape(-1, 2) + 0.5) / actual - 0.5


def _face_up(places: Array, target: CalibrationTarget) -> Array:
    """Marks that are found in some order, in that of a target seen from its face."""
    grid = places.reshape(target.rows, target.columns, 2)
    along, down = grid[0, -1] - grid[0, 0], grid[-1, 0] - grid[0, 0]
    mirrored = along[0] * down[1] - along[1] * down[0] < 0.0
    return (grid[:, ::-1] if mirrored else grid).reshape(-1, 2)


def _refined(level: NDArray[np.float32], target: CalibrationTarget, start: Array) -> Marks:
    """Marks from pixels near them."""
    plane = _Plane.of(target, start)
    count, (height, width) = len(start), level.shape
    pixel, status = np.full((count, 2), np.nan), np.full(count, MarkStatus.NOT_FOUND, np.uint8)
    if plane is None:
        return Marks(pixel, status)
    scale = plane.scale()
    pitch, expected = _shorter(scale), plane.pixels(plane.places)
    near = np.linalg.norm(start - expected, axis=1) < _NEAR * pitch  # OpenCV's dots may be others
    start = np.where(near[:, None], start, expected)
    reach = np.maximum(_REACH * pitch, _LEAST_WINDOW_PX)[:, None]
    inside = np.all((start >= reach) & (start <= [width - 1, height - 1] - reach), axis=1)
    status[~inside] = MarkStatus.OUTSIDE
    refine = _corner if target.kind == "checkerboard" else _dot
    contrast = np.full(count, np.nan)
    for i in np.flatnonzero(inside):
        pixel[i] = refine(level, start[i], scale[i])
    moved = np.linalg.norm(pixel - start, axis=1)
    near = inside & (moved < _NEAR * pitch)
    again = _Plane.of(target, np.where(near[:, None], pixel, np.nan))
    if again is None:
        return Marks(np.full((count, 2), np.nan), status)
    near &= np.linalg.norm(pixel - again.pixels(again.places), axis=1) < _NEAR * pitch
    for i in np.flatnonzero(near):
        contrast[i] = again.contrast(level, int(i))
    typical = float(np.nanmedian(np.abs(contrast)))
    faint = near & ~(np.abs(contrast) >= _FAINT * typical)
    wrong = near & ~faint & ~(again.sign(contrast) > 0.0)
    status[near], status[faint] = MarkStatus.FOUND, MarkStatus.DARK
    status[wrong] = MarkStatus.NOT_FOUND
    found = status == MarkStatus.FOUND
    if target.kind == "dots":
        pixel = pixel - again.shifts()
    return Marks(np.where(found[:, None], pixel, np.nan), status)


def _shorter(scale: Array) -> Any:
    """Distance between neighbouring lines of marks, px, the shorter, by derivatives (..., 2, 2)."""
    return np.abs(np.linalg.det(scale)) / np.linalg.norm(scale, axis=-2).max(axis=-1)


def _corner(level: NDArray[np.float32], start: Array, scale: Array) -> Array:
    """The saddle point of an image that is blurred by the difference of two Gaussian kernels.

    The crossing of two edges looks the same when it is turned by 180 degrees about itself, and so
    the gradient of its blurred image is nil there, whatever the angle of the edges.  That of even
    light that grows along the image is nil everywhere with this kernel.
    """
    pitch = _shorter(scale)
    sigmas = [max(share * pitch, 1.0) for share in _BLURS]
    reach = max(int(_NEAR * pitch), _LEAST_WINDOW_PX)
    place = np.array(start, np.float32).reshape(1, 1, 2)
    place = cv2.cornerSubPix(level, place, (reach, reach), (-1, -1), _ITERATIONS).ravel()
    half, place = int(np.ceil(3.5 * sigmas[1])), place.astype(float)
    for _ in range(_MOST_STEPS):
        window, first = _window(level, place, half)
        if window is None:
            return np.full(2, np.nan)
        gradient, hessian = np.zeros(2), np.zeros((2, 2))
        for sigma, sign in zip(sigmas, (1.0, -1.0), strict=True):
            offset = np.arange(2 * half + 1) + first[:, None] - place[:, None]
            blur = np.exp(-0.5 * (offset / sigma) ** 2)
            blur /= blur.sum(axis=1, keepdims=True)
            slope = blur * offset / sigma**2
            slope -= blur * slope.sum(axis=1, keepdims=True)  # even light has none
            (x0, y0), (x1, y1) = blur, slope
            x2, y2 = blur * ((offset / sigma) ** 2 - 1.0) / sigma**2
            gradient += sign * np.array([y0 @ window @ x1, y1 @ window @ x0])
            mixed = y1 @ window @ x1
            hessian += sign * np.array([[y0 @ window @ x2, mixed], [mixed, y2 @ window @ x0]])
        if not np.linalg.det(hessian) < 0.0:  # no saddle
            return np.full(2, np.nan)
        step = np.linalg.solve(hessian, gradient)
        place = place - step * min(1.0, pitch / 8.0 / np.linalg.norm(step))
        if np.linalg.norm(step) < _SOLVED_PX:
            return place
    return np.full(2, np.nan)


def _dot(level: NDArray[np.float32], start: Array, scale: Array) -> Array:
    """The middle of the area that is darker than the ground around it."""
    half = int(np.ceil(_DOT_WINDOW * np.linalg.norm(scale, axis=1).max()))
    place, to_plate = np.asarray(start, float), np.linalg.inv(scale)
    for _ in range(_MOST_STEPS):
        window, first = _window(level, place, half)
        if window is None:
            return np.full(2, np.nan)
        y, x = np.mgrid[: 2 * half + 1, : 2 * half + 1]
        x, y = x + first[0] - place[0], y + first[1] - place[1]
        distance = np.linalg.norm(np.stack([x, y], axis=-1) @ to_plate.T, axis=-1)
        ring = (distance > _RING) & (distance < _DOT_WINDOW)
        ring &= window > np.mean(np.percentile(window, [2.0, 98.0]))  # it may not be in the middle
        if ring.sum() < _LEAST_GROUND:
            return np.full(2, np.nan)
        plane = np.stack([np.ones_like(x), x, y], axis=-1)
        ground = plane @ np.linalg.lstsq(plane[ring], window[ring], rcond=None)[0]
        share = np.where(distance < _RING, 1.0 - window / np.maximum(ground, 1e-6), 0.0)
        share = np.where(share > 0.02 * share.max(), share, 0.0)
        if not (total := share.sum()) > 0.0:
            return np.full(2, np.nan)
        step = np.array([(share * x).sum() / total, (share * y).sum() / total])
        place = place + step
        if np.linalg.norm(step) < _SOLVED_PX:
            return place
    return place if np.linalg.norm(step) < 0.01 else np.full(2, np.nan)


def _window(level: NDArray[np.float32], place: Array, half: int) -> tuple[Any, Array]:
    """The image around a place, and the pixel where it starts; None where it is cut."""
    first = np.round(place).astype(int) - half
    if (first < 0).any() or (first + 2 * half >= level.shape[::-1]).any():
        return None, first
    window = level[first[1] : first[1] + 2 * half + 1, first[0] : first[0] + 2 * half + 1]
    return window.astype(float), first


@dataclass(frozen=True)
class _Plane:
    """The homography from a target, in pitches, to pixels."""

    target: CalibrationTarget
    places: Array  # (N, 2), pitches
    matrix: Array

    @staticmethod
    def of(target: CalibrationTarget, pixel: Array) -> _Plane | None:
        """By the marks that are known; None of fewer than four, or none that make one."""
        places = target.points_mm[:, :2] / target.pitch_mm
        known = np.isfinite(pixel).all(axis=1)
        if known.sum() < 4:
            return None
        matrix = cv2.findHomography(places[known], pixel[known], cv2.LMEDS)[0]
        good = matrix is not None and np.isfinite(matrix).all() and np.linalg.det(matrix) != 0.0
        return _Plane(target, places, matrix) if good else None

    def pixels(self, places: Array) -> Array:
        """Pixels (..., 2) of places on the target, pitches."""
        seen = np.concatenate([places, np.ones((*places.shape[:-1], 1))], axis=-1) @ self.matrix.T
        found: Array = seen[..., :2] / seen[..., 2:]
        return found

    def scale(self) -> Array:
        """Derivatives of the pixel at each mark by x and y on the target: (N, 2, 2), px/pitch."""
        seen = np.column_stack([self.places, np.ones(len(self.places))]) @ self.matrix.T
        pixel, depth = seen[:, :2] / seen[:, 2:], seen[:, 2]
        by = self.matrix[:2, :2] - pixel[:, :, None] * self.matrix[2, :2]
        return by / depth[:, None, None]

    def contrast(self, level: NDArray[np.float32], number: int) -> float:
        """How much brighter what should be bright is than what should be dark around a mark."""
        if self.target.kind == "dots":
            around = np.array([[0.42, 0.0], [-0.42, 0.0], [0.0, 0.42], [0.0, -0.42]])
            bright = self._levels(level, self.places[number] + around)
            return float(bright.mean() - self._levels(level, self.places[number : number + 1])[0])
        around = 0.3 * np.array([[-1.0, -1.0], [1.0, 1.0], [1.0, -1.0], [-1.0, 1.0]])
        a, b, c, d = self._levels(level, self.places[number] + around)
        return float((c + d - a - b) / 2.0)

    def sign(self, contrast: Array) -> Array:
        """Positive where the contrast is of the kind that a mark of this place has."""
        if self.target.kind == "dots":
            return np.sign(contrast)
        columns = self.target.columns
        number = np.arange(len(contrast))
        odd = (number // columns + number % columns) % 2
        colour = np.sign(contrast) * np.where(odd == 1, -1.0, 1.0)
        return colour * np.sign(np.nansum(colour))  # turned, it may start with the other colour

    def shifts(self) -> Array:
        """From the image of a dot's centre to the centre of its image, (N, 2), px."""
        radius = self.target.dot_radius_mm / self.target.pitch_mm
        inverse = np.linalg.inv(self.matrix)
        x, y = self.places.T
        circle = np.zeros((len(x), 3, 3))
        circle[:, 0, 0] = circle[:, 1, 1] = 1.0
        circle[:, 0, 2] = circle[:, 2, 0] = -x
        circle[:, 1, 2] = circle[:, 2, 1] = -y
        circle[:, 2, 2] = x**2 + y**2 - radius**2
        dual = np.linalg.inv(inverse.T @ circle @ inverse)
        return dual[:, :2, 2] / dual[:, 2:, 2] - self.pixels(self.places)

    def _levels(self, level: NDArray[np.float32], places: Array) -> Array:
        at = self.pixels(places).astype(np.float32)
        return cv2.remap(
            level, at[None, :, 0], at[None, :, 1], cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE
        )[0]


@public
def projector_marks(
    marks: Marks, target: CalibrationTarget, column: ArrayLike, row: ArrayLike
) -> Marks:
    """The projector's pixels at marks that a camera sees, by decoded fringes around them.

    Parameters
    ----------
    marks : Marks
        Of the camera, from `find_marks`.
    target : CalibrationTarget
    column, row : array_like of shape (H, W)
        Projector px that each camera pixel sees, NaN where it has none: of `DecodedFringes`.

    Returns
    -------
    Marks
        `pixel` in the projector; a mark that the camera did not find keeps its status.

    Notes
    -----
    Within a window of most of a pitch, each coordinate is fitted by a quadratic polynomial of the
    camera's pixel, which a plane's homography is to 1e-4 px there; its value at the mark is taken
    (compare the local homographies of Moreno and Taubin 2012, 3DIMPVT).  Pixels on the edges of
    marks, whose light comes from one side of the pixel, are left out as outliers.
    """
    _check_target("projector_marks", target)
    count = target.columns * target.rows
    if not isinstance(marks, Marks) or marks.pixel.shape != (count, 2):
        raise InputError(f"projector_marks: marks is {short(marks)}; give {count} of find_marks")
    images = [numbers_of(f"projector_marks: {n}", v) for n, v in (("column", column), ("row", row))]
    if images[0].ndim != 2 or images[0].shape != images[1].shape:
        shapes = " and ".join(f"{each.shape}" for each in images)
        raise InputError(f"projector_marks: column and row are {shapes}; give (H, W) of both")
    decoded = np.stack(images, axis=-1)
    pixel, status = np.full(marks.pixel.shape, np.nan), marks.status.copy()
    plane = _Plane.of(target, marks.pixel)
    seen = np.flatnonzero(status == MarkStatus.FOUND)
    if plane is None:
        return Marks(pixel, status)
    pitch = _shorter(plane.scale())
    for i in seen:
        pixel[i] = _interpolated(decoded, marks.pixel[i], float(pitch[i]) * _PHASE_WINDOW)
    status[seen[~np.isfinite(pixel[seen, 0])]] = MarkStatus.NO_PHASE
    return Marks(pixel, status)


def _interpolated(decoded: Array, at: Array, half: float) -> Array:
    """Decoded coordinates (2,) at a pixel, by a polynomial of those around it; NaN of too few."""
    half = max(half, _LEAST_WINDOW_PX)
    stride = max(1, int(np.ceil(2.0 * half / np.sqrt(_MOST_POINTS))))
    low = np.maximum(np.ceil(at - half), 0).astype(int)
    high = np.minimum(np.floor(at + half) + 1, decoded.shape[1::-1]).astype(int)
    window = decoded[low[1] : high[1] : stride, low[0] : high[0] : stride]
    y, x = np.mgrid[low[1] : high[1] : stride, low[0] : high[0] : stride]
    known = np.isfinite(window).all(axis=2)
    if known.sum() < max(12.0, _FEW * (2.0 * half / stride) ** 2):
        return np.full(2, np.nan)
    x, y = (x[known] - at[0]) / half, (y[known] - at[1]) / half
    by = np.column_stack([np.ones_like(x), x, y, x**2, x * y, y**2])
    values, used = window[known], np.ones(len(x), bool)
    if not (np.abs([x.mean(), y.mean()]) < 0.3).all():  # the mark lies at the edge of what is lit
        return np.full(2, np.nan)
    for _ in range(3):
        found = np.linalg.lstsq(by[used], values[used], rcond=None)[0]
        off = np.abs(values - by @ found).max(axis=1)
        spread = SIGMA_BY_MEDIAN * np.median(off[used])
        keep = off <= _ROBUST * max(spread, 1e-9)
        if keep.sum() < 12 or (keep == used).all():
            break
        used = keep
    return found[0]
