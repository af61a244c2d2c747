"""Where a sensor is put over a part, and with which lens, so that it sees what its laser lights.

The sensor's frame: origin where the middle of its line falls, y along the line, z up.
"""

from __future__ import annotations

import math
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.new_scene.options import NewScene
from virtual_sensor.imaging.new_scene.part import NewPart
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]

LENSES_MM = (4, 6, 8, 12, 16, 25, 35, 50, 75, 100, 150)
"""Focal lengths of lenses that are sold."""

PIXEL_UM = 3.45
"""Pitch of a camera's pixels, by default."""

_FILM = "2448x2048"
_X, _Y, _Z = np.eye(3)
_SAMPLES = 201  # of a line
_ASIDE = 1e-6  # of the part's size: a cut through none of its vertices
_FILMS_DEEP = 4.0  # focal length by the film's width, by default
_FILM_USED = 0.85  # by what is lit
_PART_LIT = 0.8  # of the part's breadth, by default
_LINE_PX = 4.0  # radius of the line, by default
_SHEETS = 33  # that are tried where there is no surface in the middle
_ABOUT_AS_MUCH = 0.9
_BEFORE_APEX = 0.95  # of the way from the line to where a fan's light would cross
_MOST_PX = 100_000


@dataclass(frozen=True)
class Placement:
    """A sensor over a part: one value for each of its parameters.

    Attributes
    ----------
    at_mm : ndarray of shape (3,)
    alphas, tilts, offsets_mm : tuple of float
        Of the cameras, and of the lasers.
    size_px : tuple of int
        Of the film.
    pixel_um, focal_mm, distance_mm : float
    line_length_mm, line_radius_mm, laser_distance_mm : float
    chosen : tuple of str
        What was not given, by the names of `NewScene`.
    aside : bool
        Whether the line was put beside the middle, where there is no surface.
    """

    at_mm: Array
    alphas: tuple[float, ...]
    tilts: tuple[float, ...]
    offsets_mm: tuple[float, ...]
    size_px: tuple[int, int]
    pixel_um: float
    focal_mm: float
    distance_mm: float
    line_length_mm: float
    line_radius_mm: float
    laser_distance_mm: float
    chosen: tuple[str, ...]
    aside: bool = False


def placed(part: NewPart, said: NewScene) -> Placement:
    """A sensor over a part, as it is told, and as it suits the part where nothing is told.

    Raises
    ------
    InputError
        If the laser's sheet misses the part.
    """
    chosen: dict[str, float] = {}
    size_px, pixel_um = film_of(said.film or _FILM), said.pixel_um or PIXEL_UM
    film_mm = size_px[0] * pixel_um / 1000.0, size_px[1] * pixel_um / 1000.0
    alphas, (tilts, offsets) = said.alpha or (30.0,), _lasers(said)
    turn, beta = said.turn or 0.0, 0.0 if part.radius_mm else said.beta or 0.0  # round its axis
    at, aside = _at(part, turn, said)
    frame = _frame(at, beta, turn)
    sheet = _towards(frame, tilts[0])
    profile = LitProfile.of(part.corners_mm, sheet)
    if not profile.met:
        low, high = (_point(corner) for corner in part.box_mm)
        raise InputError(
            f"--at {_point(at)}: the laser's sheet misses the part there; its box is from {low} to"
            f" {high} mm"
        )
    if (length := said.line_length_mm) is None:
        lit = profile.t_mm[np.isfinite(profile.height_mm)]
        span = profile.longest[1] if aside else float(np.ptp(lit))
        length = _PART_LIT * span
        if said.focal_length_mm and said.distance_mm:
            seen_mm = film_mm[0] * said.distance_mm / said.focal_length_mm
            length = min(length, _FILM_USED * seen_mm)
        length = chosen["line_length_mm"] = rounded(length, up=False)
    lit_mm = profile.points_mm(sheet, length)
    views = [_towards(frame, tilts[0] + alpha) for alpha in alphas]
    focal, distance = said.focal_length_mm, said.distance_mm
    if focal is None:
        focal = _lens_of(film_mm[0])
        if distance is not None:
            enough = [f for f in LENSES_MM if _needed_mm(views, lit_mm, f, film_mm) <= distance]
            focal = float(max(enough, default=LENSES_MM[0]))
        chosen["focal_length_mm"] = focal
    if distance is None:
        needed = max(_needed_mm(views, lit_mm, focal, film_mm), part.size_mm)
        distance = chosen["distance_mm"] = rounded(needed, up=True)
    if (radius := said.line_radius_mm) is None:
        radius = _LINE_PX * distance * pixel_um / 1000.0 / focal
        radius = chosen["line_radius_mm"] = rounded(radius)
    laser_distance = distance
    if said.fan:
        apex = length / 2.0 / math.tan(math.radians(said.fan) / 2.0)
        laser_distance = min(distance, rounded(_BEFORE_APEX * apex, up=False))
    sensor = alphas, tilts, offsets, size_px, pixel_um, focal, distance
    return Placement(at, *sensor, length, radius, laser_distance, tuple(chosen), aside)


def film_of(text: str) -> tuple[int, int]:
    """Width and height in pixels."""
    found = re.fullmatch(r"\s*(\d{1,6})\s*[x×*,]\s*(\d{1,6})\s*", text)
    width, height = map(int, found.groups()) if found else (0, 0)
    if not (0 < width <= _MOST_PX and 0 < height <= _MOST_PX):
        raise InputError(f"--film {text[:40]}: give width x height in pixels, such as 2448x2048")
    return width, height


def _lasers(said: NewScene) -> tuple[tuple[float, ...], tuple[float, ...]]:
    """Tilts and offsets of the lasers, as many of each."""
    tilts, offsets = said.tilt or (0.0,), said.laser_offset_mm or (0.0,)
    count = max(len(tilts), len(offsets))
    if {len(tilts), len(offsets)} - {1, count}:
        raise InputError("--tilt, --laser-offset: give one of either for each laser")
    tilts, offsets = (each * count if len(each) == 1 else each for each in (tilts, offsets))
    if len({*zip(tilts, offsets, strict=True)}) < count:
        raise InputError("--tilt, --laser-offset: two lasers make the same line; move one of them")
    if len({*said.alpha}) < len(said.alpha):
        raise InputError("--alpha: two cameras stand at the same place; turn one of them")
    return tilts, offsets


def _at(part: NewPart, turn: float, said: NewScene) -> tuple[Array, bool]:
    """Where the line's middle falls, and whether it had to be put beside the part's middle.

    As it is told, on the surface where no height is; else on the surface under the middle of the
    part's box.  Where there is none, as over a bore, the nearest sheet that lights about as much in
    one stretch as any other does, and the middle of that stretch.
    """
    digits = max(4 - math.floor(math.log10(part.size_mm)), 0)
    middle = np.mean(part.box_mm, axis=0)
    if said.at_mm is not None and len(said.at_mm) == 3:
        return np.array(said.at_mm), False
    if said.at_mm is not None:
        middle[:2] = said.at_mm
    frame = _frame(middle, 0.0, turn)
    profile = LitProfile.of(part.corners_mm, frame)
    if said.at_mm is not None or profile.over_part:
        height = profile.middle_height_mm if profile.met else 0.0
        return np.round(frame.to_world(np.array([[0.0, 0.0, height]]))[0], digits) + 0.0, False
    across = frame.to_local(part.corners_mm.reshape(-1, 3))[:, 0]
    bodies = frame.to_local(part.corners_mm.mean(axis=1))
    nearest = bodies[np.argmin(np.linalg.norm(bodies[:, :2], axis=1)), 0]  # if all others miss
    offsets = [*np.linspace(across.min(), across.max(), _SHEETS)[1:-1], nearest]
    sheets = [_frame(frame.to_world(np.array([[x, 0.0, 0.0]]))[0], 0.0, turn) for x in offsets]
    profiles = [LitProfile.of(part.corners_mm, sheet) for sheet in sheets]
    most = said.line_length_mm or np.inf
    lit = np.array([min(each.longest[1], most) if each.met else 0.0 for each in profiles])
    if not lit.any():  # of a flat sheet that the light grazes
        return middle, False
    good = np.flatnonzero(lit >= _ABOUT_AS_MUCH * lit.max())
    best = int(min(good, key=lambda i: (round(abs(offsets[i]), 6), -offsets[i])))
    t = profiles[best].longest[0]
    height = float(np.interp(t, profiles[best].t_mm, profiles[best].height_mm))
    place = sheets[best].to_world(np.array([[0.0, t, height]]))[0]
    return np.round(place, digits) + 0.0, True


def _frame(at_mm: Array, beta: float, turn: float) -> Pose:
    """The frame of a sensor that is turned by beta round its x-axis, then round the vertical."""
    return Pose(Pose.turn(turn, _Z).rotation @ Pose.turn(beta, _X).rotation, at_mm)


def _towards(frame: Pose, angle: float) -> Pose:
    """The frame, turned round the line: its z points to a device that is so many degrees aside."""
    return Pose(frame.rotation @ Pose.turn(angle, _Y).rotation, frame.origin_mm)


@dataclass(frozen=True)
class LitProfile:
    """What a sheet of parallel light lights of a part, in the sheet's frame.

    Attributes
    ----------
    t_mm : ndarray of shape (N,)
        Along the line, over all that the sheet's plane cuts.
    height_mm : ndarray of shape (N,)
        Towards the light; NaN where the plane meets nothing.
    """

    t_mm: Array
    height_mm: Array

    @staticmethod
    def of(corners_mm: Array, sheet: Pose) -> LitProfile:
        """Cut triangles (M, 3, 3) by the plane through a frame's origin, across its x."""
        local = sheet.to_local(corners_mm.reshape(-1, 3)).reshape(-1, 3, 3)
        local[:, :, 0] -= _ASIDE * np.ptp(local[:, :, 1])
        x = local[:, :, 0]
        start = local[(x.min(axis=1) < 0.0) & (x.max(axis=1) > 0.0)]
        step = np.roll(start, -1, axis=1) - start
        with np.errstate(divide="ignore", invalid="ignore"):
            share = -start[:, :, 0] / step[:, :, 0]
            places = start + share[:, :, None] * step
        crossed = (share > 0.0) & (share < 1.0)
        whole = crossed.sum(axis=1) == 2
        cut = places[whole][crossed[whole]].reshape(-1, 2, 3)
        if not len(cut):
            return LitProfile(np.empty(0), np.empty(0))
        (y0, z0), (y1, z1) = (cut[:, end, 1:].T for end in (0, 1))
        t = np.linspace(cut[:, :, 1].min(), cut[:, :, 1].max(), _SAMPLES)
        height = np.full(_SAMPLES, np.nan)
        for number, place in enumerate(t):
            over = (np.minimum(y0, y1) <= place) & (place <= np.maximum(y0, y1)) & (y0 != y1)
            if over.any():
                along = (place - y0[over]) / (y1 - y0)[over]
                height[number] = np.max(z0[over] + along * (z1 - z0)[over])
        return LitProfile(t, height)

    @property
    def met(self) -> bool:
        """Whether the plane meets the part."""
        return bool(np.isfinite(self.height_mm).any())

    @property
    def over_part(self) -> bool:
        """Whether there is a surface at t = 0."""
        if not (self.met and self.t_mm[0] <= 0.0 <= self.t_mm[-1]):
            return False
        return bool(np.isfinite(self.height_mm[np.argmin(np.abs(self.t_mm))]))

    @property
    def longest(self) -> tuple[float, float]:
        """Middle and length, mm, of the longest stretch that is lit without a gap."""
        lit = np.concatenate([[False], np.isfinite(self.height_mm), [False]])
        start, end = np.flatnonzero(np.diff(lit)).reshape(-1, 2).T
        best = int(np.argmax(end - start))
        first, last = self.t_mm[start[best]], self.t_mm[end[best] - 1]
        return float((first + last) / 2.0), float(last - first)

    @property
    def middle_height_mm(self) -> float:
        """Height at t = 0; where nothing is there, the median of all."""
        if self.over_part:
            return float(self.height_mm[np.argmin(np.abs(self.t_mm))])
        return float(np.nanmedian(self.height_mm))

    def points_mm(self, sheet: Pose, length_mm: float) -> Array:
        """What is lit (N, 3) by a line of a length, world."""
        lit = np.isfinite(self.height_mm) & (np.abs(self.t_mm) <= length_mm / 2.0)
        t, height = self.t_mm[lit], self.height_mm[lit]
        return sheet.to_world(np.column_stack([np.zeros_like(t), t, height]))


def _lens_of(film_mm: float) -> float:
    """The lens that sees a field of about a quarter of its distance."""
    return float(min(LENSES_MM, key=lambda lens: abs(math.log(lens / (_FILMS_DEEP * film_mm)))))


def _needed_mm(
    views: Sequence[Pose], lit_mm: Array, focal_mm: float, film_mm: tuple[float, float]
) -> float:
    """From which distance cameras see points (N, 3), with something to spare.

    `views` are frames whose z point to the cameras, and whose y are along u of the images.
    """
    needed = 0.0
    for view in views:
        across, along, height = view.to_local(lit_mm).T
        for side, film in ((along, film_mm[0]), (across, film_mm[1])):
            slope = _FILM_USED * film / 2.0 / focal_mm
            needed = max(needed, float(np.max(np.abs(side) / slope + height, initial=0.0)))
    return needed


def rounded(value: float, up: bool | None = None, digits: int = 2) -> float:
    """A positive number to so many digits: the nearest, or the next above or below."""
    unit = 10.0 ** (math.floor(math.log10(value)) - digits + 1)
    count = round(value / unit) if up is None else math.floor(value / unit + 1e-9)
    if up and count * unit < value * (1.0 - 1e-9):
        count += 1
    return float(f"{count * unit:.12g}")


def _point(place: Array) -> str:
    return ",".join(f"{float(value):.4g}" for value in place)
