"""From a solver's samples to a regular grid; and which of its nodes lie inside the solid.

- Grids: cubic splines along each axis (SciPy). A grid's own nodes keep their values.
- Meshes: VTK (`mesh_values.sample`).
- Points without cells: Delaunay's tetrahedra (`scattered`) are the cells.

No value is beyond the range of the solver's own. A node has none where the file has NaN or where
there is no cell.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np
from scipy import ndimage
from scipy.interpolate import make_interp_spline

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports import mesh_values, scattered
from virtual_sensor.medium.imports.placement import Geometry
from virtual_sensor.medium.imports.sources import Cloud, Grid, Mesh
from virtual_sensor.medium.solid import fill_solid

THINNEST = 3  # nodes: what is thinner and has no value is a hole in the data, not a part

Report = Callable[[float], None]


def resample(
    geometry: Geometry,
    values: np.ndarray,
    axes: Sequence[np.ndarray],
    report: Report = lambda fraction: None,
) -> np.ndarray:
    """Interpolate to the nodes of a grid.

    Parameters
    ----------
    geometry : Grid, Cloud or Mesh
        In mm. What is flat along x is a cross-section: it is the same at every x.
    values : ndarray
        Its values, NaN where there are none.
    axes : sequence of three ndarray
        The nodes' coordinates, mm.
    report : callable, optional
        Called with the fraction done.

    Returns
    -------
    ndarray of shape (nx, ny, nz)
        NaN where there are no data.

    Raises
    ------
    InputError
        If the points span no volume.
    """
    flat = is_flat(geometry, 0)
    at = (np.zeros(1), *axes[1:]) if flat else tuple(axes)
    if isinstance(geometry, Grid):
        found = _on_grid(geometry.axes, values, at, flat)
    elif isinstance(geometry, Cloud):
        mesh, known = scattered.triangulated(geometry.points, values, flat)
        report(0.3)
        found = mesh_values.sample(mesh, known, at, lambda fraction: report(0.3 + 0.7 * fraction))
        found[scattered.nearest_is_blank(geometry.points, values, at, flat)] = np.nan
    else:
        mesh = geometry
        if flat:
            mesh, values = mesh_values.centre_section(mesh, values)
        found = mesh_values.sample(mesh, values, at, report)
    # Cubic and gradient terms overshoot where a layer or front is no wider than the cells.
    found = np.clip(found, np.nanmin(values), np.nanmax(values))
    return np.broadcast_to(found, tuple(len(axis) for axis in axes)).copy()


def is_flat(geometry: Geometry, axis: int) -> bool:
    """Whether the data are a cross-section, one layer thick along an axis."""
    if isinstance(geometry, Grid):
        return len(geometry.axes[axis]) == 1
    if isinstance(geometry, Mesh):
        points = geometry.cells.cell_centers().points
        extent = np.ptp(geometry.cells.points, axis=0).max()
    else:
        points = geometry.points
        extent = np.ptp(points, axis=0).max()
    return bool(np.ptp(points[:, axis]) < 1e-5 * extent)


def solid_of(
    missing: np.ndarray,
    axes: Sequence[np.ndarray],
    open_faces: Sequence[tuple[bool, bool]],
    most: int,
) -> np.ndarray:
    """Find the solid among the nodes without a value; refuse holes in the data.

    The solid meets no open face of the grid, and is at least `THINNEST` nodes thick. Along x, the
    part's axis, it may pass through the whole field.

    Parameters
    ----------
    missing : ndarray of bool of shape (nx, ny, nz)
        Nodes that have no value.
    axes : sequence of three ndarray
        The nodes' coordinates, mm.
    open_faces : sequence of three pairs of bool
        Whether the first and the last face along each axis is a border of the data, not a mirror
        plane or the end of a cross-section.
    most : int
        So many enclosed regions may be solid.

    Returns
    -------
    ndarray of bool of shape (nx, ny, nz)

    Raises
    ------
    InputError
        If a region without values is not enclosed or too thin, or there are too many.
    """
    solid = np.zeros(missing.shape, dtype=bool)
    bodies = []
    for region, place in _regions(missing):
        where = _where(place, axes, region)
        along_x = place[0] == slice(0, missing.shape[0]) and all(open_faces[0])
        faces = ((False, False), *open_faces[1:]) if along_x else open_faces
        if _is_open(place, missing.shape, faces):
            raise InputError(
                f"{region.sum()} nodes {where} have no data, and are open to the field's border: a "
                "hole in the light path? Give a --box inside the data; if it is the part, say "
                "--solid cylinder:RADIUS"
            )
        if min(_thickness(place, missing.shape, faces)) < THINNEST:
            raise InputError(
                f"{region.sum()} nodes {where} have no data, too few for a part: a hole in the "
                "light path; fill it, or leave it out with --box"
            )
        solid[place] |= region
        bodies.append(where)
    if len(bodies) > most:
        raise InputError(
            f"no data in {len(bodies)} enclosed regions, {'; '.join(bodies)}: a part, or a hole in "
            "the light path? Say --solid enclosed if all are parts, or fill the hole"
        )
    return solid


def _regions(flags: np.ndarray) -> list[tuple[np.ndarray, tuple[slice, ...]]]:
    """Connected regions: each in its bounding box, and that box."""
    labels, _ = ndimage.label(flags, np.ones((3, 3, 3)))
    places = ndimage.find_objects(labels)
    return [(labels[place] == i + 1, place) for i, place in enumerate(places)]


def _is_open(
    place: tuple[slice, ...], shape: Sequence[int], open_faces: Sequence[tuple[bool, bool]]
) -> bool:
    return any(
        (first and s.start == 0) or (last and s.stop == n)
        for s, n, (first, last) in zip(place, shape, open_faces, strict=True)
    )


def _thickness(
    place: tuple[slice, ...], shape: Sequence[int], open_faces: Sequence[tuple[bool, bool]]
) -> list[int]:
    """Extent of a region in nodes, with its mirror image at a face that is not open."""
    return [
        (s.stop - s.start) * (1 + ((s.start == 0 and not first) or (s.stop == n and not last)))
        for s, n, (first, last) in zip(place, shape, open_faces, strict=True)
    ]


def _where(place: tuple[slice, ...], axes: Sequence[np.ndarray], region: np.ndarray) -> str:
    """A region's place in mm."""
    ends = [(n, a[s.start], a[s.stop - 1]) for n, a, s in zip("xyz", axes, place, strict=True)]
    if region.sum() == 1:
        return f"at ({', '.join(f'{low:.4g}' for _, low, _ in ends)}) mm"
    return f"in {', '.join(f'{n} {low:.4g} to {high:.4g}' for n, low, high in ends)} mm"


def _on_grid(
    nodes: Sequence[np.ndarray], values: np.ndarray, axes: Sequence[np.ndarray], flat: bool
) -> np.ndarray:
    """Cubic splines along each axis; NaN where the nearest node is NaN."""
    result = np.asarray(values, dtype=np.float64)
    missing = ~np.isfinite(result)
    if missing.any():
        spacing = np.array([np.median(np.diff(a)) if len(a) > 1 else 1.0 for a in nodes])
        result = fill_solid(result, missing, spacing)
    for i, (old, new) in enumerate(zip(nodes, axes, strict=True)):
        if (i == 0 and flat) or (len(old) == len(new) and np.allclose(old, new, rtol=0, atol=1e-9)):
            continue
        if len(old) < 2:
            raise InputError(f"the data have one node along {'xyz'[i]}; see --axes")
        spline = make_interp_spline(old, result, k=min(3, len(old) - 1), axis=i)
        result = np.moveaxis(spline(new), i, i)
        middles = 0.5 * (old[1:] + old[:-1])
        missing = missing.take(np.searchsorted(middles, new), axis=i)
    return np.where(missing, np.nan, result)
