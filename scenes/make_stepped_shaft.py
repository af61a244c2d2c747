"""Writes meshes/stepped_shaft.ply, the part of stepped_shaft.xml: run it to make the mesh again."""

from itertools import pairwise
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

AXIS_Z_MM = -13.5
FACETS = 512  # round the circle: they lie 0.25 um inside it at most

# Diameters in mm from x to the next x: seat, shoulder, groove and journal meet under the laser.
SECTIONS = ((-85.0, 20.0), (-50.0, 27.0), (0.3, 26.0), (1.0, 24.0), (2.6, 25.0), (40.0, 20.0))
END_X_MM = 85.0


def profile() -> NDArray[np.float64]:
    """Outline (x, r) of the shaft in mm, from the axis at one end to the axis at the other."""
    x = np.append([start for start, _ in SECTIONS], END_X_MM)
    radius = np.array([diameter / 2.0 for _, diameter in SECTIONS])
    inner = np.column_stack([np.repeat(x, 2)[1:-1], np.repeat(radius, 2)])
    return np.vstack([[x[0], 0.0], inner, [x[-1], 0.0]])


def revolved(outline: NDArray[np.float64]) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Revolve an outline (x, r) about the shaft's axis.

    Returns
    -------
    vertices : ndarray of shape (V, 8)
        Position in the world, mm, unit normal, and texture coordinates (u, v), mm: u round the
        shaft from its top line, which is the lay of a turned surface; v is x on cylinders, and
        goes on along the outline on steps.  Edges are sharp: each straight segment of the outline
        has vertices of its own.  The seam lies at the bottom line.
    faces : ndarray of shape (F, 3)
        Triangles, anticlockwise seen from outside.
    """
    angle = 2.0 * np.pi * np.append(np.arange(FACETS), FACETS // 2) / FACETS
    around = np.column_stack([0.0 * angle, np.sin(angle), np.cos(angle)])
    angle[FACETS // 2 + 1 :] -= 2.0 * np.pi
    here = np.arange(FACETS)
    there = (here + 1) % FACETS
    here[FACETS // 2] = FACETS  # the seam's other side
    vertices: list[NDArray[np.float64]] = []
    faces: list[NDArray[np.int64]] = []
    for start, end in pairwise(outline):
        first = len(vertices) * 2 * len(angle)
        length, middle = np.linalg.norm(end - start), (start[1] + end[1]) / 2.0
        along, outward = (end - start) / length
        normals = along * around - [outward, 0.0, 0.0]
        rings = [[x, 0.0, AXIS_Z_MM] + r * around for x, r in (start, end)]
        texture = [
            np.column_stack([middle * angle, np.full_like(angle, v)])
            for v in (start[0], start[0] + length)
        ]
        rows = [np.hstack(each) for each in zip(rings, [normals, normals], texture, strict=True)]
        vertices.append(np.vstack(rows))
        a, b, c, d = here, there, here + len(angle), there + len(angle)
        if start[1] > 0.0:
            faces.append(first + np.column_stack([a, c, b]))
        if end[1] > 0.0:
            faces.append(first + np.column_stack([b, c, d]))
    return np.vstack(vertices).astype(np.float32), np.vstack(faces).astype(np.int32)


def write_ply(path: Path, vertices: NDArray[np.float32], faces: NDArray[np.int32]) -> None:
    """Write a binary PLY file; vertices have places, normals, and texture coordinates or none."""
    names = ("x", "y", "z", "nx", "ny", "nz", "u", "v")[: vertices.shape[1]]
    properties = "".join(f"property float {name}\n" for name in names)
    header = (
        "ply\nformat binary_little_endian 1.0\n"
        f"element vertex {len(vertices)}\n{properties}"
        f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    )
    rows = np.zeros(len(faces), np.dtype([("count", "u1"), ("vertices", "<i4", 3)]))
    rows["count"], rows["vertices"] = 3, faces
    path.write_bytes(header.encode() + vertices.astype("<f4").tobytes() + rows.tobytes())


if __name__ == "__main__":
    write_ply(Path(__file__).parent / "meshes" / "stepped_shaft.ply", *revolved(profile()))
