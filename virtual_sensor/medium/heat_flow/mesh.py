r"""The mesh round a cylinder: an O-grid of `blockMesh` blocks, finest at wall and plume.

In the plane across the axis (y >= 0), z up::

    t0---t1------t2          b3-b2: the ring's outer square, from c0-c3 on the cylinder
    |above|aboveOut|
    b3---b2------r2          Behind the end face a disc of four blocks, with the core q0-q3,
    | top/  |      |         fills what the cylinder leaves open.
    c3-c2 s |sideOut
     (  i   |      |
    c0-c1 d |      |
    | low\  |      |
    b0---b1------r1
    |below|belowOut|
    d0---d1------d2
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow.setup import HeatFlow

TOP_MM = 305.0
SECTION_MM = 5.0  # thickness of the one layer of cells of a section

Point = tuple[float, float]
Corner = tuple[str, int]  # a point's name and the layer's face along x


@dataclass(frozen=True)
class Division:
    """How an edge is divided: number of cells, and last cell's length over the first one's."""

    cells: int
    ratio: float = 1.0

    def reversed(self) -> Division:
        """The same, from the other end."""
        return Division(self.cells, 1.0 / self.ratio)

    @classmethod
    def between(cls, length: float, first: float, last: float) -> Division:
        """Cells that grow geometrically from `first` to `last` over `length`, roughly."""
        if max(first, last) >= length:
            raise InputError(
                f"cells would grow to {max(first, last):.3g} mm where there are {length:.3g} mm;"
                " give a smaller cell width"
            )
        growth = (length - first) / (length - last)
        even = abs(growth - 1.0) < 1e-9
        cells = length / first if even else 1.0 + math.log(last / first) / math.log(growth)
        return cls(max(round(cells), 2), last / first)


@dataclass(frozen=True)
class Block:
    """A block's quadrilateral across x, anticlockwise seen from +x, divided along both edges."""

    name: str
    corners: tuple[str, str, str, str]
    first: Division
    second: Division


@dataclass(frozen=True)
class CylinderMesh:
    """Points (y, z) in mm, blocks, faces along x and what lies between them."""

    radius_mm: float
    points: dict[str, Point]
    faces_mm: tuple[float, ...]
    layers: tuple[Division, ...]
    blocks: tuple[Block, ...]
    disc: tuple[Block, ...]  # in the second layer only

    @property
    def cells(self) -> int:
        """How many there are."""
        plane = [sum(b.first.cells * b.second.cells for b in self.blocks)] * len(self.layers)
        plane[-1] += sum(b.first.cells * b.second.cells for b in self.disc)
        return sum(n * layer.cells for n, layer in zip(plane, self.layers, strict=True))

    @property
    def wall_faces_mm(self) -> NDArray[np.float64]:
        """Distance of the ring's cell faces from the wall, where the ring is narrowest; mm."""
        radial = self.blocks[0].second
        thickness = radial.ratio ** (np.arange(radial.cells) / (radial.cells - 1))
        return self.radius_mm * thickness.cumsum() / thickness.sum()


def cylinder_mesh(flow: HeatFlow) -> CylinderMesh:
    """Lay out the mesh: cells `flow.cell_mm` wide across the plume, the others in proportion.

    Raises
    ------
    InputError
        If there is no room for cells so wide.
    """
    R, c = flow.radius_mm, flow.cell_mm
    axis, square, wide = -R, 2.0 * R, max(60.0, 4.5 * R)
    low, s, q = axis - square - 20.0, R / math.sqrt(2.0), 0.4 * R
    points = {
        **{"c0": (0.0, axis - R), "c1": (s, axis - s), "c2": (s, axis + s), "c3": (0.0, axis + R)},
        **_square("b", square, axis),
        **{"d0": (0.0, low), "d1": (square, low), "d2": (wide, low)},
        **{"r1": (wide, axis - square), "r2": (wide, axis + square)},
        **{"t0": (0.0, TOP_MM), "t1": (square, TOP_MM), "t2": (wide, TOP_MM)},
    }
    across = Division.between(square, c, 2.5 * c)
    beside = Division(max(round(2.0 * square / (2.0 * c)), 2))
    radial = Division.between(square - R, 0.35 * c, 2.0 * c)
    above = Division.between(TOP_MM - axis - square, 2.0 * c, 9.0 * c)
    outward = Division.between(wide - square, 2.5 * c, 8.0 * c)
    below = Division.between(20.0, 2.0 * c, 4.0 * c)
    blocks = (
        Block("ringTop", ("c3", "c2", "b2", "b3"), across, radial),
        Block("ringSide", ("c2", "c1", "b1", "b2"), beside, radial),
        Block("ringLow", ("c1", "c0", "b0", "b1"), across.reversed(), radial),
        Block("above", ("b3", "b2", "t1", "t0"), across, above),
        Block("aboveOut", ("b2", "r2", "t2", "t1"), outward, above),
        Block("sideOut", ("b1", "r1", "r2", "b2"), outward, beside),
        Block("below", ("d0", "d1", "b1", "b0"), across, below.reversed()),
        Block("belowOut", ("d1", "d2", "r1", "b1"), outward, below.reversed()),
    )
    if flow.section:
        return CylinderMesh(R, points, (0.0, SECTION_MM), (Division(1),), blocks, ())

    half, air = flow.length_mm / 2.0, 65.0
    along = Division.between(half, min(14.0 * c, half / 4.0), 2.5 * c)
    beyond = Division.between(air, 2.5 * c, 14.0 * c)
    inward = Division(max(round((R - q) / (1.2 * c)), 2))
    disc = (
        Block("discCore", ("q0", "q1", "q2", "q3"), across, beside),
        Block("discTop", ("q3", "q2", "c2", "c3"), across, inward),
        Block("discSide", ("q2", "q1", "c1", "c2"), beside, inward),
        Block("discLow", ("q1", "q0", "c0", "c1"), across.reversed(), inward),
    )
    points |= _square("q", q, axis)
    return CylinderMesh(R, points, (0.0, half, half + air), (along, beyond), blocks, disc)


def _square(name: str, half: float, axis: float) -> dict[str, Point]:
    """Corners of half a square round the axis, from the lowest upwards."""
    places = ((0.0, axis - half), (half, axis - half), (half, axis + half), (0.0, axis + half))
    return {f"{name}{i}": place for i, place in enumerate(places)}


def block_mesh_dict(mesh: CylinderMesh) -> str:
    """The body of `system/blockMeshDict`."""
    number = {
        (name, k): i
        for i, (k, name) in enumerate(
            (k, n) for k in range(len(mesh.faces_mm)) for n in mesh.points
        )
    }
    R = mesh.radius_mm
    vertices = []
    for (name, k), i in number.items():
        y, z = mesh.points[name]
        vertices.append(f"({mesh.faces_mm[k]:g} {y:.6f} {z:.6f})    // {i}: {name}")
    blocks = []
    for k, along in enumerate(mesh.layers):
        for block in mesh.blocks + (mesh.disc if k == 1 else ()):
            a, b, c, d = ((number[p, k], number[p, k + 1]) for p in block.corners)
            each = (along, block.first, block.second)
            blocks.append(
                f"hex {listed((*a, *b[::-1], *d, *c[::-1]))} {listed(one.cells for one in each)}"
                f" simpleGrading {listed(one.ratio for one in each)}    // {block.name}"
            )
    across, up = R * math.cos(3 * math.pi / 8), R * math.sin(3 * math.pi / 8)
    arcs = (("c3", "c2", across, up), ("c2", "c1", R, 0.0), ("c1", "c0", across, -up))
    edges = [
        f"arc {number[start, k]} {number[end, k]} ({x:g} {y:.6f} {z - R:.6f})"
        for k, x in enumerate(mesh.faces_mm)
        for start, end, y, z in arcs
    ]
    patches = (
        (name, kind, [[number[corner] for corner in face] for face in faces])
        for name, kind, faces in _patches(mesh)
    )
    return dictionary(vertices, blocks, edges, patches)


def dictionary(
    vertices: Sequence[str],
    blocks: Sequence[str],
    edges: Sequence[str],
    patches: Iterable[tuple[str, str, Sequence[Sequence[int]]]],
) -> str:
    """The body of `system/blockMeshDict`: its lists' entries; patches by name, type and faces."""
    lines = ["scale 0.001;", ""]
    for name, entries in (("vertices", vertices), ("blocks", blocks), ("edges", edges)):
        lines += [name, "(", *(f"    {entry}" for entry in entries), ");", ""]
    lines += ["boundary", "("]
    for name, kind, faces in patches:
        lines += [f"    {name}", "    {", f"        type {kind};", "        faces", "        ("]
        lines += [*(f"            {listed(face)}" for face in faces), "        );", "    }"]
    return "\n".join([*lines, ");", ""])


def _patches(mesh: CylinderMesh) -> Iterator[tuple[str, str, list[tuple[Corner, ...]]]]:
    """Name, type and faces of each boundary."""
    layers = range(len(mesh.layers))

    def sides(*edges: tuple[str, str], layers: range = layers) -> list[tuple[Corner, ...]]:
        return [((a, k), (b, k), (b, k + 1), (a, k + 1)) for a, b in edges for k in layers]

    def across(blocks: tuple[Block, ...], k: int) -> list[tuple[Corner, ...]]:
        return [tuple((corner, k) for corner in block.corners) for block in blocks]

    wall = sides(("c3", "c2"), ("c2", "c1"), ("c1", "c0"), layers=range(1))
    middle = sides(("b3", "t0"), ("c3", "b3"), ("c0", "b0"), ("b0", "d0"))
    border = sides(("d0", "d1"), ("d1", "d2"), ("d2", "r1"), ("r1", "r2"), ("r2", "t2"))
    last = len(mesh.layers)
    if mesh.disc:
        wall += across(mesh.disc, 1)
        middle += sides(("q0", "c0"), ("q3", "q0"), ("c3", "q3"), layers=range(1, 2))
        border += across(mesh.blocks + mesh.disc, last)
    yield "part", "wall", wall
    yield "open", "patch", border
    yield "top", "patch", sides(("t0", "t1"), ("t1", "t2"))
    yield "mirrorY", "symmetryPlane", middle
    if mesh.disc:
        yield "mirrorX", "symmetryPlane", across(mesh.blocks, 0)
    else:
        yield "sectionBack", "empty", across(mesh.blocks, 0)
        yield "sectionFront", "empty", across(mesh.blocks, last)


def listed(values: Iterable[float]) -> str:
    """Numbers as a list of OpenFOAM's."""
    return "(" + " ".join(f"{v:.6g}" for v in values) + ")"
