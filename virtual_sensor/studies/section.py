"""The section that a laser plane cuts out of a part, and how far measured points are from it."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.display import Displayed, listed, span
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.metrology.truth import rms
from virtual_sensor.optics.ray_search import incidence_points
from virtual_sensor.records import Record

Array = NDArray[np.float64]

_RAYS = 2001
_BESIDE = 0.05  # of the line on either side: hot air moves its ends
_SLACK = 0.5  # of a chord
_STEEPEST = 11.4  # depth over length along the line: from 85 degrees on it is a step of the part


@dataclass(frozen=True)
class Section(Displayed):
    """Where straight light of the sheet's middle meets a part.

    Attributes
    ----------
    laser : LaserLine
    point_mm : ndarray of shape (N, 2)
        Along the line and away from the laser, in its plane, in order along the line.
    joined : ndarray of bool of shape (N,)
        Whether the surface goes on from a point to the next one: there is no step between them.
    """

    laser: LaserLine
    point_mm: Array
    joined: NDArray[np.bool_]

    def _line(self) -> str:
        across, away = self.point_mm.T
        spans = span("along", across, "mm"), span("away", away, "mm")
        return listed(f"{len(self.point_mm)} points", *spans)

    def _columns(self) -> dict[str, Any]:
        along, away = self.point_mm.T
        return {"along_mm": along, "away_mm": away, "joined": self.joined}

    def along_mm(self, points_mm: Array) -> Array:
        """Position (M,) along the line of world points (M, 3), as of probe rays."""
        return self.laser.family.coordinates(points_mm)[..., 1]

    def distance_um(self, points_mm: Array) -> Array:
        """Distance (M,) of world points (M, 3) of the laser's plane: positive outside the part.

        NaN of points that are, and of those before which the surface ends: at an edge of the part.
        """
        distance = np.full(len(points_mm), np.nan)
        good = np.isfinite(points_mm).all(axis=1)
        if not good.any() or len(self.point_mm) < 2:
            return distance
        points = self.laser.pose.to_local(points_mm[good])[:, 1:]
        chord = np.diff(self.point_mm, axis=0)
        length = np.linalg.norm(chord, axis=1)
        sagitta = self._sagitta_mm(chord, length)
        _, nearest = cKDTree(self.point_mm).query(points)
        best = np.full(len(points), np.inf)
        for first in (nearest - 1, nearest):  # to the point before the nearest one, and after it
            i = first.clip(0, len(chord) - 1)
            along = chord[i] / length[i, None]
            offset = points - self.point_mm[i]
            share = np.sum(offset * along, axis=1) / length[i]
            outside = along[:, 1] * offset[:, 0] - along[:, 0] * offset[:, 1]
            outside -= 4.0 * sagitta[i] * share * (1.0 - share)
            # Before an edge of two chords the point may be a little beyond both.
            before = (share >= -_SLACK) & (share <= 1.0 + _SLACK) & self.joined[i]
            better = before & (np.abs(outside) < np.abs(best))
            best[better] = outside[better]
        distance[good] = np.where(np.isfinite(best), UM_PER_MM * best, np.nan)
        return distance

    def _sagitta_mm(self, chord: Array, length: Array) -> Array:
        """By how much the surface rises above the middle of each chord (N - 1,)."""
        unit = chord / length[:, None]
        turn = unit[:-1, 0] * unit[1:, 1] - unit[:-1, 1] * unit[1:, 0]
        turn[~(self.joined[:-2] & self.joined[1:-1])] = np.nan
        beside = np.stack([np.append(np.nan, turn), np.append(turn, np.nan)])
        known = np.isfinite(beside)
        mean = np.where(known, beside, 0.0).sum(axis=0) / np.maximum(known.sum(axis=0), 1)
        return length * mean / 8.0


def true_section(scene: Scene) -> Section:
    """The section of a scene's part."""
    laser = scene.sensor.laser
    ends = np.array([laser.extent[0][1], laser.extent[1][1]])
    beside = _BESIDE * max(np.ptp(ends), laser.length_mm)
    rays = np.linspace(ends[0] - beside, ends[1] + beside, _RAYS)
    points = laser.pose.to_local(incidence_points(scene.cold(), rays))[:, 1:]
    found = np.isfinite(points).all(axis=1)
    along, depth = np.diff(points, axis=0).T
    joined = np.append(np.abs(depth) <= _STEEPEST * np.abs(along), False)
    return Section(laser, points[found], joined[found])


def longest_gap(line_mm: Array, measured_mm: Array) -> tuple[float, float]:
    """Ends of the longest stretch of a line, through places on it, on which none is measured.

    The places are in their order along the line; NaN where there is no line: no stretch leads over
    that. NaN where no place on the line is known.
    """
    measured = measured_mm[np.isfinite(measured_mm)]
    longest = np.nan, np.nan
    for run in np.ma.clump_unmasked(np.ma.masked_invalid(line_mm)):
        first, last = line_mm[run].min(), line_mm[run].max()
        ends = np.sort(np.concatenate([measured.clip(first, last), [first, last]]))
        at = int(np.diff(ends).argmax())
        if not ends[at + 1] - ends[at] <= longest[1] - longest[0]:
            longest = float(ends[at]), float(ends[at + 1])
    return longest


@dataclass(frozen=True)
class SectionErrors(Record):
    """How far the measured section is from the true one: positive outside the part.

    Attributes
    ----------
    points : int
        Measured points whose distance is known.
    edge_points : int
        Those at an edge of the part, where the true section ends: they have none.
    mean_um, rms_um : float
        Mean and root mean square of their distances.
    largest_um : float
        The distance that is largest in magnitude.
    largest_y_mm : float
        Where that is: y along the line, from its middle, where the laser's axis meets the part.
    """

    points: int
    edge_points: int
    mean_um: float
    rms_um: float
    largest_um: float
    largest_y_mm: float


class Known(Protocol):
    """What points can be compared with: a `Section`, say."""

    def distance_um(self, points_mm: Array) -> Array:
        """Distances (N,) of world points, positive outside; NaN where there are none."""

    def along_mm(self, points_mm: Array) -> Array:
        """Their positions (N,) along the line."""


def section_errors(section: Known, points_mm: Array) -> SectionErrors:
    """The figures of measured points (N, 3); those that are NaN don't count."""
    measured = points_mm[np.isfinite(points_mm).all(axis=1)]
    distance = section.distance_um(measured)
    good = np.isfinite(distance)
    edges = int(np.sum(~good))
    if not good.any():
        return SectionErrors(0, edges, *[float("nan")] * 4)
    distance, y = distance[good], section.along_mm(measured[good])
    at = int(np.abs(distance).argmax())
    return SectionErrors(
        len(distance),
        edges,
        float(distance.mean()),
        rms(distance),
        float(distance[at]),
        round(float(y[at]), 4) + 0.0,  # no digits that mean nothing, such as of -1e-8
    )
