"""Writes meshes/v_groove.ply, the part of v_groove.xml: run it to make the mesh again."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_scenes.make_stepped_shaft import write_ply

DEPTH_MM = 8.0  # of the groove, whose walls are at right angles
THICKNESS_MM = 12.0  # of the plates
WIDTH_MM = 60.0  # of both together, along y
LENGTH_MM = 80.0  # along x


def profile() -> NDArray[np.float64]:
    """Outline (y, z) of the plates in mm, anticlockwise seen from +x, closed."""
    half = WIDTH_MM / 2.0
    top = [(half, 0.0), (DEPTH_MM, 0.0), (0.0, -DEPTH_MM), (-DEPTH_MM, 0.0), (-half, 0.0)]
    below = [(-half, -THICKNESS_MM), (half, -THICKNESS_MM)]
    return np.array([*top, *below, top[0]])


def extruded(outline: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Extrude an outline (y, z) along x.

    Returns
    -------
    vertices : ndarray of shape (V, 8)
        Position in the world, mm, unit normal, and texture coordinates (u, v), mm: u along x,
        which is the lay of the surface, v along the outline from the groove's root.  Edges are
        sharp.
    faces : ndarray of shape (F, 3)
        Triangles, anticlockwise seen from outside.
    """
    ends = np.array([-LENGTH_MM / 2.0, LENGTH_MM / 2.0])
    to_root = np.linalg.norm(np.diff(outline[:3], axis=0), axis=1).sum()
    vertices, faces, along = [], [], -float(to_root)
    for start, end in pairwise(outline):
        length = float(np.linalg.norm(end - start))
        normal = [0.0, (end - start)[1] / length, -(end - start)[0] / length]
        faces.append(4 * len(vertices) + np.array([(0, 2, 1), (1, 2, 3)]))
        quad = [
            [x, *point, *normal, x, v]
            for point, v in ((start, along), (end, along + length))
            for x in ends
        ]
        vertices.append(quad)
        along += length
    corners = len(outline) - 1
    for x, order in zip(ends, (-1, 1), strict=True):
        first = 4 * corners + (corners if x > 0 else 0)
        cap = [[x, *point, np.sign(x), 0.0, 0.0, *point] for point in outline[:-1]]
        vertices.append(cap)
        # From the root (2), which sees all corners.
        fan = [(2, a % corners, (a + 1) % corners) for a in range(3, corners + 1)]
        faces.append(first + np.array(fan)[:, ::order])
    return np.vstack(vertices).astype(np.float32), np.vstack(faces).astype(np.int32)


if __name__ == "__main__":
    write_ply(Path(__file__).parent / "meshes" / "v_groove.ply", *extruded(profile()))
