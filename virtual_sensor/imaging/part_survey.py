"""What there is to know of a part before it is measured: its place, its faults, its facets.

A mesh is only looked at: nothing of it is mended, and what is found is said with its remedy.

Vertices at the same place are one.  Two faces at an edge *agree* if they run along it in opposite
directions; faces that agree are a body, and a body's outside is where its volume is positive, or in
a sheet where more of its area faces.  A body within another is a hollow, and its faces look in.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import one_of
from virtual_sensor.calls import public
from virtual_sensor.display import Displayed, listed, place
from virtual_sensor.errors import InputError
from virtual_sensor.files import path_of
from virtual_sensor.imaging.part_kinds import check_kind
from virtual_sensor.imaging.parts import Part, read_part
from virtual_sensor.records import Record

Array = NDArray[np.float64]
Indices = NDArray[np.int64]
Vector = tuple[float, float, float]

UNITS_MM = {"um": 1e-3, "mm": 1.0, "cm": 10.0, "m": 1e3, "inch": 25.4, "foot": 304.8}
"""Units of length that a part's file may be in, and their millimetres."""

SHARP_DEG = 29.0
"""An edge at which the surface bends by more is one of the part itself, not of its facets."""

_ALIKE = 3.0  # bends of one curved surface differ by a factor of so much
_CLOSED = 0.05  # of a body's area, summed as vectors: a closed one's is 0
_PLAUSIBLE_MM = 1.0, 2000.0  # longest edge of a part before such a sensor
_SMALLEST, _LARGEST = 0.05, 200.0  # size of a part in fields of view that is not doubted...
_FITTING = 0.2, 20.0  # ...and that speaks for a unit
_ON_MM, _BESIDE, _TINY = 1e-3, 1e-2, 1e-30  # of a facet: above it, beside it, its area
_ROUNDED_UM = 1.0  # is told
_RINGS = 3  # of neighbours that a facet's estimate looks at
_NO_WIDTH = 1e-6  # of the part's size: float32 leaves a crack of so much at a T-junction
_HASH = np.array([0x9E3779B97F4A7C15, 0xC2B2AE3D27D4EB4F, 0x165667B19E3779F9], np.uint64)


@dataclass(frozen=True)
class PartSurvey(Record):
    """A part's place, its faults and its facets; lengths in the part's own frame, in mm.

    Attributes
    ----------
    lowest_mm, highest_mm : tuple of float
        Corners of its bounding box.
    top_mm : tuple of float
        Point of the surface under the middle of the box, seen from above; where there is none, as
        in a bore, the middle of the upward face that is nearest.
    triangles : int
    holes : int
        Gaps that are wider than rounding; the border of a sheet is none.
    flipped_faces : int
        Triangles that are turned inside out.
    double_faces : int
        Triangles that lie on another one with the same corners.
    facet_error_um : float
        Estimate of how far facets lie beside the curved surface that they stand for, at most.
    notes : tuple of str
        Faults, each with its remedy.
    """

    lowest_mm: Vector
    highest_mm: Vector
    top_mm: Vector
    triangles: int
    holes: int
    flipped_faces: int
    double_faces: int
    facet_error_um: float
    notes: tuple[str, ...]

    def _line(self) -> str:
        size = " x ".join(f"{length:.4g}" for length in self.size_mm)
        faults = {
            "holes": self.holes,
            "flipped faces": self.flipped_faces,
            "double faces": self.double_faces,
        }
        counts = ", ".join(f"{number} {name}" for name, number in faults.items() if number)
        facets = f"facets cost {self.facet_error_um:.3g} µm"
        faces = f"{self.triangles} triangles"
        found = counts or ("see its notes" if self.notes else "no faults")
        return listed(f"{size} mm", f"top {place(self.top_mm)}", faces, facets, found)

    @property
    def size_mm(self) -> Vector:
        """Of the bounding box."""
        x, y, z = (high - low for low, high in zip(self.lowest_mm, self.highest_mm, strict=True))
        return x, y, z


@public
def survey(path: Path | str, unit: str = "mm") -> PartSurvey:
    """Survey a part's file: its size, its faults, and what its facets cost.

    Parameters
    ----------
    path : Path or str
        A file that a scene's shape may name; its suffix says what kind it is.
    unit : str
        Of the lengths in the file, one of `UNITS_MM`.

    Raises
    ------
    InputError
        If the file can't be read, or is no part that can be measured.
    """
    path = path_of("survey: path", path)
    one_of("unit", unit, UNITS_MM)
    kind = check_kind(path)
    if kind == "3mf" and unit != "mm":
        raise InputError(f"{path}: a 3MF file has its unit in it; leave out the unit {unit}")
    part = read_part(path, kind)
    found = survey_part(replace(part, vertices=part.vertices * UNITS_MM[unit]))
    doubt = unit_note(found.size_mm) if unit == "mm" and kind != "3mf" else ""
    notes = [*part.notes, *(f"{path}: {note}" for note in (doubt, *found.notes) if note)]
    return replace(found, notes=tuple(notes))


def survey_part(part: Part) -> PartSurvey:
    """Survey a part that was read; the notes don't name its file."""
    mesh = Mesh.of(part.vertices, part.faces)
    corners = part.vertices[part.faces]
    low, high = corners.min(axis=(0, 1)), corners.max(axis=(0, 1))
    return PartSurvey(
        _vector(low),
        _vector(high),
        _vector(_top(corners, (low + high) / 2.0)),
        len(part.faces),
        len(mesh.gaps),
        int(mesh.flipped.sum()),
        mesh.double_faces,
        float(1e3 * mesh.facet_error_mm.max(initial=0.0)),
        tuple(_faults(mesh)),
    )


def faults(part: Part) -> list[str]:
    """Notes of what is wrong with a part, each with its remedy; they don't name its file."""
    return _faults(Mesh.of(part.vertices, part.faces))


def plausible(size_mm: Sequence[float], unit: str = "mm") -> bool:
    """Whether a part's size, as if its file were in mm, is one of a part in another unit."""
    low, high = _PLAUSIBLE_MM
    return low <= max(size_mm) * UNITS_MM[unit] <= high


def likely_unit(size_mm: Sequence[float]) -> str:
    """The unit that a file seems to be in, one of `UNITS_MM`, by its part's size as if in mm."""
    return next((unit for unit in ("mm", "m", "um") if plausible(size_mm, unit)), "mm")


def unit_note(size_mm: Sequence[float]) -> str:
    """A note of a part whose file seems to be in another unit than mm; "" if it does not."""
    if (unit := likely_unit(size_mm)) == "mm":
        return ""
    size = " x ".join(f"{length:.4g}" for length in size_mm)
    words = {"m": "metres", "um": "micrometres"}[unit]
    return (
        f"the part is {size} mm: is its file in {words}? then say --unit {unit}"
        f' (Python: unit="{unit}")'
    )


def scale_note(size_mm: float, field_of_view_mm: float) -> str:
    """A note of a part whose size does not go with a field of view; "" if it does.

    Parameters
    ----------
    size_mm : float
        Of the part, its longest edge.
    field_of_view_mm : float
        Longest edge of what the camera sees at the part's distance.
    """
    if _SMALLEST * field_of_view_mm < size_mm < _LARGEST * field_of_view_mm:
        return ""
    fitting = [
        f'<scale value="{factor:g}"/> if its file is in {name}'
        for name, factor in (("m", 1e3), ("cm", 10.0), ("inches", 25.4), ("um", 1e-3))
        if _FITTING[0] < size_mm * factor / field_of_view_mm < _FITTING[1]
    ]
    remedy = f" Give its to_world a {' or a '.join(fitting)}" if fitting else ""
    return (
        f"the part is {size_mm:.3g} mm in size, and the camera sees {field_of_view_mm:.3g} mm"
        f" there; lengths are in mm: is it at the right scale?{remedy}"
    )


def facet_error_mm(vertices_mm: Array, faces: Indices, points_mm: Array) -> float:
    """How far the facets that points (N, 3) lie on are beside a curved surface, at most.

    An estimate, see `Mesh.facet_error_mm`; 0 where no point lies on a facet.
    """
    corner, met = vertices_mm[faces], np.zeros(len(faces), bool)
    low, high = corner.min(axis=1) - _ON_MM, corner.max(axis=1) + _ON_MM

    def within(places: Array, of: Indices) -> Indices:
        reached = (low[of] <= places.max(axis=0)) & (high[of] >= places.min(axis=0))
        return of[np.all(reached, axis=1)]

    along_line = within(points_mm, np.arange(len(faces)))
    for point in points_mm:
        near = within(point[None], along_line)
        to = corner[near] - point
        parts = np.cross(to, np.roll(to, -1, axis=1))  # twice the areas that the point cuts
        whole = parts.sum(axis=1)
        area = np.linalg.norm(whole, axis=1)
        height = np.abs(np.einsum("ni,ni->n", to[:, 0], whole)) / np.maximum(area, _TINY)
        weights = np.einsum("npi,ni->np", parts, whole) / np.maximum(area, _TINY)[:, None] ** 2
        met[near[(height < _ON_MM) & np.all(weights > -_BESIDE, axis=1)]] = True
    if not met.any():
        return 0.0
    mesh, around = Mesh.of(vertices_mm, faces), met
    for _ in range(_RINGS):
        touched = np.zeros(len(mesh.places_mm), bool)
        touched[mesh.faces[around]] = True
        around = np.any(touched[mesh.faces], axis=1)
    estimated = replace(mesh, faces=mesh.faces[around]).facet_error_mm
    return float(estimated[met[around]].max())


def _vector(place: Array) -> Vector:
    x, y, z = (float(value) for value in place)
    return x, y, z


def _faults(mesh: "Mesh") -> list[str]:
    notes, count, gaps = [], len(mesh.faces), mesh.gaps
    if gaps:
        width, place = max(gaps, key=lambda gap: gap[0])
        x, y, z = place
        holes = "1 hole" if len(gaps) == 1 else f"{len(gaps)} holes"
        notes.append(
            f"it has {holes}, up to {width:.3g} mm wide near ({x:.4g}, {y:.4g}, {z:.4g}); light"
            " that falls in meets the backs of faces: close them in the program that made the file,"
            " unless they lie out of sight"
        )
    flipped = int(mesh.flipped.sum())
    if flipped:
        all_of_them = "all" if flipped == count else f"{flipped} of"
        notes.append(
            f"{all_of_them} its {count} triangles are turned inside out, and black from outside:"
            " recalculate the normals in the program that made the file, or put the part's <bsdf>"
            ' into <bsdf type="twosided">'
        )
    if mesh.double_faces:
        notes.append(
            f"{mesh.double_faces} of its triangles lie on others with the same corners, and which"
            " of them is seen is chance: remove double faces in the program that made the file"
        )
    far = float(np.abs(mesh.places_mm).max())
    rounding_um = 1e3 * float(np.spacing(np.float32(far)))
    if rounding_um > _ROUNDED_UM:
        notes.append(
            f"it reaches {far:.3g} mm from the origin, where the renderer's float32 rounds places"
            f" to {rounding_um:.2g} um: move it to the origin"
        )
    return notes


@dataclass(frozen=True)
class Mesh(Displayed):
    """Triangles that know their neighbours.

    Attributes
    ----------
    places_mm : ndarray of shape (N, 3)
        Vertices, each place once.
    faces : ndarray of int of shape (M, 3)
        Their corners, of all triangles of the part.
    """

    places_mm: Array
    faces: Indices

    @staticmethod
    def of(vertices_mm: Array, faces: Indices) -> "Mesh":
        """A mesh whose vertices at the same place, in float32, are merged."""
        places = vertices_mm - vertices_mm.min(axis=0)
        bits = (places.astype(np.float32) + np.float32(0.0)).view(np.uint32).astype(np.uint64)
        mixed = (bits * _HASH).sum(axis=1, dtype=np.uint64)
        mixed ^= mixed >> np.uint64(29)
        _, first, same = np.unique(mixed, return_index=True, return_inverse=True)
        return Mesh(vertices_mm[first], same[faces])

    @cached_property
    def size_mm(self) -> float:
        """Diagonal of its bounding box."""
        return float(np.linalg.norm(np.ptp(self.places_mm, axis=0)))

    @cached_property
    def area_vectors(self) -> Array:
        """Of each triangle (M, 3): along its normal, as long as its area."""
        corner = self.places_mm[self.faces]
        return np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0]) / 2.0

    @cached_property
    def areas(self) -> Array:
        """Of each triangle (M,)."""
        return np.linalg.norm(self.area_vectors, axis=1)

    @cached_property
    def double_faces(self) -> int:
        """Triangles with the same corners as another, beyond the first of each."""
        ordered = np.sort(self.faces[self._whole], axis=1).astype(np.uint64)
        mixed = np.sort((ordered * _HASH).sum(axis=1, dtype=np.uint64))
        return int(np.sum(mixed[1:] == mixed[:-1]))

    @cached_property
    def _whole(self) -> NDArray[np.bool_]:
        """Triangles of three different corners (M,)."""
        a, b, c = self.faces.T
        return (a != b) & (b != c) & (c != a)

    @cached_property
    def _edges(self) -> tuple[Indices, Indices, NDArray[np.bool_]]:
        """Half edges, 3 face + corner that they start at.

        Those that are alone (B,), pairs of those that meet (P, 2), and whether each pair agrees.
        """
        half = (3 * np.flatnonzero(self._whole)[:, None] + np.arange(3)).ravel()
        start, end = self.start_of(half), self.end_of(half)
        key = np.minimum(start, end) * len(self.places_mm) + np.maximum(start, end)
        order = np.argsort(key)
        half, key = half[order], key[order]
        begins = np.flatnonzero(np.diff(key, prepend=-1))
        sizes = np.diff(begins, append=len(key))
        two = begins[sizes == 2]
        pairs = np.stack([half[two], half[two + 1]], axis=1)
        agree = self.start_of(pairs[:, 0]) == self.end_of(pairs[:, 1])
        return half[begins[sizes == 1]], pairs, agree

    def start_of(self, half: Indices) -> Indices:
        """Vertices that half edges start at."""
        return self.faces.ravel()[half]

    def end_of(self, half: Indices) -> Indices:
        """Vertices that half edges end at."""
        return self.faces.ravel()[half - half % 3 + (half + 1) % 3]

    @cached_property
    def _bodies(self) -> tuple[int, Indices, NDArray[np.int8]]:
        """How many bodies there are, each triangle's (M,), and +1 or -1 so that they agree."""
        _, pairs, agree = self._edges
        count, face = len(self.faces), pairs // 3
        sign = np.ones(count, np.int8)
        if not agree.all():  # each face twice, as it is and turned: those that agree are joined
            turned = np.where(agree, 0, count)
            one = np.concatenate([face[:, 0], face[:, 0] + count])
            other = np.concatenate([face[:, 1] + turned, face[:, 1] + count - turned])
            _, label = _components(2 * count, one, other)
            sign[label[:count] > label[count:]] = -1
        bodies, body = _components(count, face[:, 0], face[:, 1])
        return bodies, body, sign

    @cached_property
    def flipped(self) -> NDArray[np.bool_]:
        """Triangles (M,) that are turned inside out."""
        bodies, body, sign = self._bodies

        def total(weights: Array) -> Array:
            return np.bincount(body, weights, bodies).astype(float)

        start = self.places_mm[self.faces[:, 0]]
        middle = (
            np.stack([total(column) for column in start.T], 1) / total(np.ones(len(body)))[:, None]
        )
        third = np.einsum("fi,fi->f", self.area_vectors, start - middle[body]) / 3.0
        volume = total(sign * third)
        net = np.stack([total(sign * column) for column in self.area_vectors.T], axis=1)
        area, kept = total(self.areas), total(sign * self.areas)
        closed = np.linalg.norm(net, axis=1) <= _CLOSED * area
        outward = np.where(closed, np.sign(volume), np.sign(kept))
        inwards = np.flatnonzero(closed & (volume * np.sign(kept) < 0.0))
        turned = np.where(closed, outward, 0.0)[body] * sign.astype(float)
        cavities = inwards[self._enclosed(inwards, turned)]
        outward[cavities] = np.sign(kept[cavities])
        return (sign * outward[body] < 0.0) & (self.areas > 0.0)

    def _enclosed(self, inner: Indices, sign: Array) -> NDArray[np.bool_]:
        """Which bodies lie within an odd number of others, whose triangles have a sign (M,).

        By the solid angle (van Oosterom, Strackee 1983) of those in whose box they lie.
        """
        bodies, body, _ = self._bodies
        low, high = np.full((bodies, 3), np.inf), np.full((bodies, 3), -np.inf)
        for corner in self.faces.T if len(inner) else ():
            np.minimum.at(low, body, self.places_mm[corner])
            np.maximum.at(high, body, self.places_mm[corner])
        found = np.zeros(len(inner), bool)
        for number, each in enumerate(inner):
            around = np.all((low < low[each]) & (high > high[each]), axis=1)[body]
            if around.any():
                place = self.places_mm[self.faces[np.argmax(body == each), 0]]
                a, b, c = np.moveaxis(self.places_mm[self.faces[around]] - place, 1, 0)
                la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
                over = np.einsum("fi,fi->f", a, np.cross(b, c))
                under = la * lb * lc + lc * np.einsum("fi,fi->f", a, b)
                under += la * np.einsum("fi,fi->f", b, c) + lb * np.einsum("fi,fi->f", c, a)
                turns = np.sum(sign[around] * np.arctan2(over, under)) / (2.0 * np.pi)
                found[number] = round(float(turns)) % 2 == 1
        return found

    @cached_property
    def gaps(self) -> list[tuple[float, Array]]:
        """Width, mm, and middle (3,) of each hole."""
        alone, _, _ = self._edges
        if not len(alone):
            return []
        start, end = self.start_of(alone), self.end_of(alone)
        _, of_vertex = _components(len(self.places_mm), start, end)
        loop = np.unique(of_vertex[start], return_inverse=True)[1]
        places = self.places_mm
        count = np.bincount(loop)
        middle = np.stack([np.bincount(loop, places[start][:, i]) / count for i in range(3)], 1)
        one, other = places[start] - middle[loop], places[end] - middle[loop]
        twice = np.cross(one, other)
        area = np.stack([np.bincount(loop, twice[:, i]) for i in range(3)], 1) / 2.0
        length = np.bincount(loop, np.linalg.norm(other - one, axis=1)).astype(float)
        width = 4.0 * np.linalg.norm(area, axis=1) / length  # a round hole's diameter
        wide = width > _NO_WIDTH * self.size_mm
        border = self._borders(alone, loop, length)
        return [(float(width[i]), middle[i]) for i in np.flatnonzero(wide & ~border)]

    def _borders(self, alone: Indices, loop: Indices, length: Array) -> NDArray[np.bool_]:
        """Which loops are the outer border of a sheet: all its faces look to one side."""
        bodies, body, sign = self._bodies
        vectors = sign[:, None] * self.area_vectors
        net = np.stack([np.bincount(body, column, bodies) for column in vectors.T], axis=1)
        forward = np.einsum("fi,fi->f", vectors, net[body])
        sheet = np.ones(bodies, bool)
        sheet[body[(forward <= 0.0) & (self.areas > 0.0)]] = False
        of_loop = np.zeros(len(length), np.int64)
        of_loop[loop] = body[alone // 3]
        border = np.zeros(len(length), bool)
        for each in np.unique(of_loop[sheet[of_loop]]):
            own = np.flatnonzero(of_loop == each)
            border[own[np.argmax(length[own])]] = True
        return border

    @cached_property
    def facet_error_mm(self) -> Array:
        """Estimate of how far each triangle (M,) lies beside the curved surface it stands for.

        Across an edge that looks smooth the surface bends by an angle `bend`, spread over the
        triangles' heights `across`: curved by bend/across it leaves a facet of that width by
        bend * across / 8.  A quadratic surface over a triangle leaves it at the middle of an edge
        by an eighth of the sum of bend * across at the other two, and at the centroid by a ninth of
        the sum at all three; the largest counts.
        """
        if not len(self.faces):
            return np.zeros(0)
        sagging = self._sagging()
        at_middles = (sagging.sum(axis=1, keepdims=True) - sagging) / 8.0
        at_centroid = sagging.sum(axis=1) / 9.0
        return np.maximum(np.abs(at_middles).max(axis=1), np.abs(at_centroid))

    def _sagging(self) -> Array:
        """Bend times across at the three edges of triangles (M, 3).

        Positive at convex edges, 0 at those that don't look smooth.
        """
        _, pairs, agree = self._edges
        one, other = pairs.T
        corner = self.places_mm[self.faces]
        edge = (np.roll(corner, -1, axis=1) - corner).reshape(-1, 3)
        with np.errstate(divide="ignore", invalid="ignore"):
            normal = self.area_vectors / self.areas[:, None]
            length = np.sqrt(np.einsum("hi,hi->h", edge, edge)).reshape(-1, 3)
            height = (2.0 * self.areas[:, None] / length).ravel()
            behind = normal[other // 3] * np.where(agree, 1.0, -1.0)[:, None]
            from_apex = edge[one - one % 3 + (one + 2) % 3]
            sine = np.einsum("pi,pi->p", from_apex, behind) / height[one]
            cosine = np.einsum("pi,pi->p", normal[one // 3], behind)
            # of the two heights the harmonic mean: a plate beside a narrow facet is not bent
            across = 2.0 / (1.0 / height[one] + 1.0 / height[other])
            gentle = cosine > np.cos(np.radians(SHARP_DEG))  # and not NaN
        one, other = one[gentle], other[gentle]
        bend, twin, sagging = np.zeros(len(edge)), np.full(len(edge), -1), np.zeros(len(edge))
        bend[one] = bend[other] = np.arcsin(np.clip(sine[gentle], -1.0, 1.0))
        twin[one], twin[other] = other, one
        smooth = _continued(bend, twin)
        smooth &= smooth[twin] & (twin >= 0)
        sagging[one] = sagging[other] = bend[one] * across[gentle]
        return np.where(smooth, sagging, 0.0).reshape(-1, 3)


def _continued(bend: Array, twin: Indices) -> NDArray[np.bool_]:
    """Whether the surface bends on alike behind the triangle of each half edge (3 M,).

    At another edge of it, or, across one that is flat in comparison, of the next triangle.
    """
    smooth = np.zeros(len(bend), bool)

    def look(half: Indices, other: Indices) -> None:
        here, there = bend[half], bend[other]
        alike = (here * there > 0.0) & (abs(there) * _ALIKE >= abs(here))
        smooth[half[alike & (abs(there) <= abs(here) * _ALIKE)]] = True

    for step in (1, 2):
        half = np.flatnonzero(~smooth & (bend != 0.0))
        look(half, half - half % 3 + (half + step) % 3)
    for step in (1, 2):
        half = np.flatnonzero(~smooth & (bend != 0.0))
        other = half - half % 3 + (half + step) % 3
        flat = (abs(bend[other]) * _ALIKE < abs(bend[half])) & (twin[other] >= 0)
        half, behind = half[flat], twin[other[flat]]
        for further in (1, 2):
            look(half, behind - behind % 3 + (behind + further) % 3)
    return smooth


def _components(count: int, one: Indices, other: Indices) -> tuple[int, Indices]:
    """Connected components of a graph: how many, and the number of each node's."""
    from scipy.sparse import coo_array  # most scenes have no such part
    from scipy.sparse.csgraph import connected_components

    graph = coo_array((np.ones(len(one), np.int8), (one, other)), (count, count))
    found, label = connected_components(graph, directed=False)
    return int(found), label.astype(np.int64)


def _top(corner: Array, middle: Array) -> Array:
    """The highest point of triangles (M, 3, 3) under a place, or the nearest face's centroid."""
    plane = corner[:, :, :2] - middle[:2]
    following = np.roll(plane, -1, axis=1)
    cross = plane[:, :, 0] * following[:, :, 1] - plane[:, :, 1] * following[:, :, 0]
    area = cross.sum(axis=1)
    under = np.all(cross >= 0.0, axis=1) | np.all(cross <= 0.0, axis=1)
    under &= area != 0.0
    if under.any():
        weight = np.roll(cross[under], -1, axis=1) / area[under, None]
        height = float((weight * corner[under, :, 2]).sum(axis=1).max())
        return np.array([middle[0], middle[1], height])
    upward = np.flatnonzero(area > 0.0) if np.any(area > 0.0) else np.arange(len(corner))
    centroid = corner[upward].mean(axis=1)
    nearest = int(np.argmin(np.linalg.norm(centroid[:, :2] - middle[:2], axis=1)))
    return np.asarray(centroid[nearest])
