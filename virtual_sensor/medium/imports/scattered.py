"""Points without cells: Delaunay's tetrahedra between them (Qhull, through SciPy), as a mesh.

The tetrahedra fill the convex hull of the points, and so bridge the solid, whose inside has none.
One is a bridge, and left out, if its circumsphere, which is empty of points, has more than `BRIDGE`
times the radius that is usual at each of its corners: the lower quartile there, which bridges do
not raise. Neighbours of a bridge with more than `BANK` times that radius go with it. So a part must
be some `BRIDGE` times as thick as the points are apart to be recognised; `--solid` names others.
Flat tetrahedra at the hull are left out too: a field's box must stay inside the points.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from scipy import sparse
from scipy.sparse.csgraph import connected_components
from scipy.spatial import Delaunay, QhullError, cKDTree

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.meshes import pyvista
from virtual_sensor.medium.imports.sources import Mesh

BRIDGE, BANK = 3.0, 1.6
FLAT = 1e-6  # height by width: points of a lattice are often on one sphere, four in a plane
CHUNK = 200_000  # nodes at a time


def triangulated(points: np.ndarray, values: np.ndarray, flat: bool) -> tuple[Mesh, np.ndarray]:
    """Join points to tetrahedra, or to triangles of a cross-section at x = 0.

    Parameters
    ----------
    points : ndarray of shape (N, 3)
        In mm; of points that are there twice the mean value is taken.
    values : ndarray of shape (N,)
        NaN where there is none.
    flat : bool
        Whether all points lie in the plane x = 0.

    Returns
    -------
    mesh : Mesh
    values : ndarray
        At its points.

    Raises
    ------
    InputError
        If the points span no volume or area, or PyVista is not installed.
    """
    pv = pyvista()
    known = np.isfinite(values)
    places, same = np.unique(points[known][:, flat:], axis=0, return_inverse=True)
    means = np.bincount(same.ravel(), values[known]) / np.bincount(same.ravel())
    middle = places.mean(axis=0)
    try:
        mesh = Delaunay(places - middle)
    except (QhullError, ValueError) as error:
        raise InputError(
            f"{len(places)} points span no {'area' if flat else 'volume'}; export more of them"
        ) from error
    simplices = mesh.simplices[_sound(mesh)]
    if flat:
        places = np.column_stack([np.zeros(len(places)), places])
    kind = pv.CellType.TRIANGLE if flat else pv.CellType.TETRA
    cells = pv.UnstructuredGrid({kind: simplices}, places)
    return Mesh(cells, at_cells=False), means


def nearest_is_blank(
    points: np.ndarray, values: np.ndarray, axes: Sequence[np.ndarray], flat: bool
) -> np.ndarray:
    """Whether a grid's nodes are nearer to a point without a value than to one with; its shape."""
    known = np.isfinite(values)
    shape = tuple(len(axis) for axis in axes)
    blank = np.zeros(np.prod(shape), dtype=bool)
    if known.all():
        return blank.reshape(shape)
    with_value, without = (cKDTree(points[k][:, flat:]) for k in (known, ~known))
    for start in range(0, len(blank), CHUNK):
        index = np.unravel_index(np.arange(start, min(start + CHUNK, len(blank))), shape)
        at = np.stack([axis[i] for axis, i in zip(axes, index, strict=True)], axis=1)[:, flat:]
        blank[start : start + CHUNK] = without.query(at)[0] < with_value.query(at)[0]
    return blank.reshape(shape)


def _sound(mesh: Delaunay) -> np.ndarray:
    """Which tetrahedra or triangles neither bridge a gap between the points nor are flat."""
    points, simplices = mesh.points, mesh.simplices
    edges = points[simplices[:, 1:]] - points[simplices[:, :1]]
    squares = (edges**2).sum(axis=2)
    if points.shape[1] == 2:
        (a, b), (aa, bb) = np.moveaxis(edges, 1, 0), squares.T
        height = a[:, 0] * b[:, 1] - a[:, 1] * b[:, 0]
        radius = np.sqrt(aa * bb * ((a - b) ** 2).sum(axis=1))
    else:
        (a, b, c), (aa, bb, cc) = np.moveaxis(edges, 1, 0), squares.T
        bc, ca, ab = np.cross(b, c), np.cross(c, a), np.cross(a, b)
        height = (a * bc).sum(axis=1)
        radius = np.linalg.norm(aa[:, None] * bc + bb[:, None] * ca + cc[:, None] * ab, axis=1)
    least = FLAT * squares.max(axis=1) ** (0.5 * points.shape[1])
    flat = abs(height) <= least
    radius = 0.5 * radius / np.maximum(abs(height), least)

    each = np.repeat(np.where(flat, np.inf, radius), simplices.shape[1])
    order = np.lexsort((each, simplices.ravel()))
    count = np.bincount(simplices.ravel(), minlength=len(points))
    quartile = np.minimum(np.cumsum(count) - count + count // 4, len(order) - 1)
    ratio = radius / each[order[quartile]][simplices].max(axis=1)

    wide = ~flat & (ratio > BANK)
    number = np.cumsum(wide) - 1
    one, side = np.nonzero(wide[:, None] & (mesh.neighbors >= 0) & wide[mesh.neighbors])
    pairs = (number[one], number[mesh.neighbors[one, side]])
    graph = sparse.coo_array((np.ones(len(one)), pairs), shape=(wide.sum(), wide.sum()))
    groups, group = connected_components(graph, directed=False)
    widest = np.zeros(groups)
    np.maximum.at(widest, group, ratio[wide])
    bridge = np.zeros(len(simplices), dtype=bool)
    bridge[wide] = widest[group] > BRIDGE
    return ~flat & ~bridge
