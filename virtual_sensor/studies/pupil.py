"""Blur through air: what the pupil of a lens does to a laser line in cold air and in hot.

From the ray search through points of the pupil, without any image: where the line's centre of
gravity is beside the line of a pinhole, how wide the pupil makes it, and the lens that the air is.
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from virtual_sensor.arrays import numbers_of
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.optics.lens import Lens
from virtual_sensor.optics.pupil_search import PupilPixels, PupilStatus, pupil_search
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.records import Table

Array = NDArray[np.float64]

F_NUMBERS = (4.0, 8.0, 16.0)
POINTS = 24
"""Of the pupil, by default: the shift by them is within 0.001 px of that by 64."""

_RAYS, _IMAGE_MM = 45, 75.0
_LEAST_POINTS = 5


@dataclass(frozen=True)
class BlurTable(Table):
    """A laser line through a lens of one f-number, a row for each ray of the laser.

    Attributes
    ----------
    y_mm : ndarray of shape (N,)
        The ray's place along the line.
    pinhole_px : mapping of ndarray of shape (N, 2)
        Where a pinhole sees its light, cold and hot.
    shift_px : mapping of ndarray of shape (N,)
        By how much the line's centre of gravity through the lens is below the pinhole's line, in
        the column in which the pinhole sees the ray.
    spread_px : mapping of ndarray of shape (N,)
        Standard deviation of the rows in which points of the pupil see the line in this column.
    focus_shift_mm : ndarray of shape (N, 2)
        By how much farther than what is lit the lens is to be focused for the hot air between, to
        be sharp along u, and along v.
    left_px : ndarray of shape (N,)
        Standard deviation of a point's hot image, along u and v together, that no focusing and no
        astigmatic lens would take away.
    """

    y_mm: Array
    pinhole_px: Annotated[dict[str, Array], "cold", "hot"]
    shift_px: Annotated[dict[str, Array], "cold", "hot"]
    spread_px: Annotated[dict[str, Array], "cold", "hot"]
    focus_shift_mm: Array
    left_px: Array


@dataclass(frozen=True)
class PupilStudy(Displayed):
    """What lenses of several f-numbers do to a line, cold and hot.

    Attributes
    ----------
    f_number : ndarray of shape (F,)
    lenses : tuple of F Lens
    lines : tuple of F BlurTable
    notes : tuple of str
    """

    f_number: Array
    lenses: tuple[Lens, ...]
    lines: tuple[BlurTable, ...]
    notes: tuple[str, ...] = ()

    def _line(self) -> str:
        hot = [np.nanmax(np.abs(line.shift_px["hot"])) for line in self.lines]
        shifts = zip(self.f_number, hot, strict=True)
        return listed(*(f"f/{n:g}: up to {shift:.2g} px beside a pinhole" for n, shift in shifts))

    def _columns(self) -> dict[str, Any]:
        each = [line.columns() for line in self.lines]
        count = [len(line.y_mm) for line in self.lines]
        found: dict[str, Any] = {"f_number": np.repeat(self.f_number, count)}
        return found | {name: np.concatenate([line[name] for line in each]) for name in each[0]}


def blur_through_air(
    scene: Scene,
    f_numbers: ArrayLike = F_NUMBERS,
    y_mm: ArrayLike | None = None,
    points: int = POINTS,
    progress: Callable[[float], None] | None = None,
) -> PupilStudy:
    """Study the blur of a scene's laser line in cold air and in its own.

    Parameters
    ----------
    scene : Scene
        With one camera and one laser line.  Where the camera has a lens, its image distance, focus
        and tilt are taken; else it is focused on the middle of the line, and its image distance is
        what the pixels' pitch says, or the paper's 75 mm.
    f_numbers : array_like of shape (F,)
    y_mm : array_like of shape (N,), optional
        Places along the line; by default 45 over all of it.
    points : int
        Of the pupil.
    progress : callable, optional
        Called with the fraction done.

    Raises
    ------
    InputError
        If there is no air to compare with, or a number can't be used.
    """
    if scene.medium is None:
        raise InputError("blur_through_air: the scene has no hot air; give one that has (field)")
    if points < _LEAST_POINTS:
        raise InputError(
            f"blur_through_air: points is {points}; give at least {_LEAST_POINTS}, by which the"
            " air's lens is known"
        )
    if y_mm is None:
        y_mm = np.linspace(-0.5, 0.5, _RAYS) * scene.laser.length_mm
    y, f_number = numbers_of("y_mm", y_mm), np.atleast_1d(numbers_of("f_numbers", f_numbers))
    airs = {"cold": scene.with_medium(None), "hot": scene}
    found = {air: ray_search(each, y, "newton") for air, each in airs.items()}
    chief = {air: each.pixel for air, each in found.items()}
    lenses = tuple(_lens(scene, found["cold"].laser_point_mm, float(n)) for n in f_number)
    lines = []
    for number, lens in enumerate(lenses):
        seen = {}
        for part, (air, each) in enumerate(airs.items()):
            done = (2 * number + part) / (2 * len(lenses))

            def tell(share: float, done: float = done) -> None:
                if progress:
                    progress(done + share / (2 * len(lenses)))

            seen[air] = pupil_search(each, y, points=points, lens=lens, progress=tell)
        rows = {air: each.rows_at(chief[air][:, 0]) for air, each in seen.items()}
        lines.append(
            BlurTable(
                y_mm=y,
                pinhole_px=chief,
                shift_px={air: row - chief[air][:, 1] for air, (row, _) in rows.items()},
                spread_px={air: spread for air, (_, spread) in rows.items()},
                **_air_lens(scene.camera, seen["cold"], seen["hot"]),
            )
        )
    return PupilStudy(f_number, lenses, tuple(lines), tuple(scene.loading_notes))


def _lens(scene: Scene, at_mm: Array, f_number: float) -> Lens:
    """The camera's lens at another f-number; or one focused on the middle of points (N, 3)."""
    camera = scene.camera
    if (own := camera.lens) is not None:
        lengths = own.image_distance_mm, own.focus_distance_mm
        return Lens.of_f_number(*lengths, f_number, own.sensor_tilt_deg)
    depth = camera.pose.to_local(at_mm)[:, 2]
    lit = depth[np.isfinite(depth)]
    if not lit.size:
        raise InputError("blur_through_air: no ray of the laser meets the part; choose others (y)")
    image_mm = camera.image_distance_mm or _IMAGE_MM
    return Lens.of_f_number(image_mm, float(lit[len(lit) // 2]), f_number)


def _air_lens(camera: Pinhole, cold: PupilPixels, hot: PupilPixels) -> dict[str, Array]:
    """How far the air moves the focus, and what remains of hot images when that is mended.

    Pixels go with the place A in the pupil as M A: the thin lens has M = f (1/g - 1/z), in px, and
    what hot air adds to 1/g is a lens of its own, another along u than along v.
    """
    focal_px = np.abs(np.diag(camera.matrix)[:2])
    depth = camera.pose.to_local(cold.laser_point_mm)[:, 2]
    linear, left = {}, np.full(len(depth), np.nan)
    for air, seen in {"cold": cold, "hot": hot}.items():
        away = (seen.pixels - seen.pixel) / focal_px
        whole = seen.status == PupilStatus.FOUND
        known = np.where(whole[None, :, None], away, 0.0)
        by_place = np.linalg.lstsq(seen.at_mm, known.reshape(len(away), -1))[0]
        beside = known - (seen.at_mm @ by_place).reshape(known.shape)
        by_place = by_place.reshape(2, -1, 2)
        along = np.stack([by_place[0, :, 0], by_place[1, :, 1]], axis=1)
        linear[air] = np.where(whole[:, None], along, np.nan)
        left = np.where(whole, np.sqrt(((beside * focal_px) ** 2).sum(axis=2).mean(axis=0)), np.nan)
    more = linear["hot"] - linear["cold"]
    return {
        "focus_shift_mm": 1.0 / (1.0 / depth[:, None] - more) - depth[:, None],
        "left_px": left,
    }
