r"""Writes meshes/bearing_ring.ply, the part of bearing_ring.xml: run it to make the mesh again.

r 30  __        __     shoulders, chamfers of 1 mm
     /  \      /  \    raceway of a ball of 12.7 mm, 3 mm deep
    |    `----'    |
22.5|______________|   bore
   y -10          10
"""

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_scenes.make_stepped_shaft import write_ply

BORE_MM, SHOULDER_MM, HALF_WIDTH_MM, CHAMFER_MM = 22.5, 30.0, 10.0, 1.0  # radii, but the last two
RACEWAY_MM, DEPTH_MM = 6.6, 3.0  # radius of the raceway's section, 0.52 of the ball's diameter
FINE, COARSE = (24.0, 0.75), 4.0  # facets round the ring, degrees: near its top line, and beyond
ARC_DEG = 1.2  # of the raceway's section


def profile() -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Strips of the outline: points (N, 2) of (y, r), mm, and their outward normals (N, 2).

    They follow one another with the ring on their right, from the bore's middle and back to it.
    """
    half_groove = np.sqrt(RACEWAY_MM**2 - (RACEWAY_MM - DEPTH_MM) ** 2)
    end = np.degrees(np.arcsin(half_groove / RACEWAY_MM))
    angle = np.radians(np.linspace(-end, end, 2 * round(end / ARC_DEG) + 1))
    arc = np.column_stack([np.sin(angle), -np.cos(angle)])
    raceway = [0.0, SHOULDER_MM - DEPTH_MM + RACEWAY_MM] + RACEWAY_MM * arc
    side = HALF_WIDTH_MM, SHOULDER_MM - CHAMFER_MM
    left = [(0.0, BORE_MM), (-side[0], BORE_MM), (-side[0], side[1])]
    left += [(-side[0] + CHAMFER_MM, SHOULDER_MM), (-half_groove, SHOULDER_MM)]
    right = [(-y, r) for y, r in reversed(left)]
    strips = []
    for corners in (left, right):
        for points in map(np.array, pairwise(corners)):
            along = (points[1] - points[0]) / np.linalg.norm(points[1] - points[0])
            strips.append((points, np.tile([-along[1], along[0]], (2, 1))))
    return [*strips[: len(left) - 1], (raceway, -arc), *strips[len(left) - 1 :]]


def around() -> NDArray[np.float64]:
    """Angles round the ring from its top line, rad, from its bottom line round to that."""
    fine = np.arange(-FINE[0], FINE[0] + FINE[1] / 2.0, FINE[1])
    rest = np.linspace(FINE[0], 180.0, round((180.0 - FINE[0]) / COARSE) + 1)[1:]
    return np.radians(np.concatenate([-rest[::-1], fine, rest]))


def revolved() -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Revolve the outline about the ring's axis, which is along y.

    Returns
    -------
    vertices : ndarray of shape (V, 8)
        Position in the world, mm, unit normal, and texture coordinates (u, v), mm: u round the ring
        from its top line, which is the lay of its surface, v along the outline from the raceway's
        middle.
    faces : ndarray of shape (F, 3)
        Triangles, anticlockwise seen from outside.
    """
    angle = around()
    out = np.column_stack([np.sin(angle), 0.0 * angle, np.cos(angle)])
    axis = np.array([0.0, 1.0, 0.0])
    vertices: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    whole = sum(np.linalg.norm(np.diff(p, axis=0), axis=1).sum() for p, _ in profile())
    v = -whole / 2.0
    here = np.arange(len(angle) - 1)
    for points, normals in profile():
        middle = points[:, 1].mean()
        lengths = np.append(0.0, np.linalg.norm(np.diff(points, axis=0), axis=1)).cumsum()
        for (y, r), (n_y, n_r), length in zip(points, normals, lengths, strict=True):
            place = [0.0, 0.0, -SHOULDER_MM] + r * out + y * axis
            texture = np.column_stack([middle * angle, np.full_like(angle, v + length)])
            vertices.append(np.hstack([place, n_r * out + n_y * axis, texture]))
        v += lengths[-1]
        for row in range(len(vertices) - len(points), len(vertices) - 1):
            a, b = row * len(angle) + here, row * len(angle) + here + 1
            c, d = a + len(angle), b + len(angle)
            faces += [np.column_stack([a, b, c]), np.column_stack([b, d, c])]
    return np.vstack(vertices).astype(np.float32), np.vstack(faces).astype(np.int32)


if __name__ == "__main__":
    write_ply(Path(__file__).parent / "meshes" / "bearing_ring.ply", *revolved())
