"""From a solver's frame to the world's: axes, origin, scale, mirror planes, and the output grid."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports import mesh_values
from virtual_sensor.medium.imports.meshes import moved
from virtual_sensor.medium.imports.sources import Cloud, Grid, Mesh
from virtual_sensor.medium.netcdf_elements import UNEVEN
from virtual_sensor.medium.spline import MIN_NODES

Geometry = Grid | Cloud | Mesh
SMALLEST_MM, LARGEST_MM = 2.0, 20e3  # of a field that light is bent in
LARGEST_SCALE = 1e9
REFLECTED = 4  # layers of data beyond a mirror plane
MOST_NODES = 50_000_000  # 400 MB


@dataclass(frozen=True)
class Frame:
    """How a solver's frame lies in the world's.

    Attributes
    ----------
    axis : tuple of three int
        Which axis of the source becomes the world's x, y and z.
    sign : tuple of three int
        1, or -1 where the direction is reversed.
    origin_mm : tuple of three float
        Point of the source that becomes the world's origin, mm, along the source's axes.
    scale : float
        Factor on all lengths.
    """

    axis: tuple[int, ...] = (0, 1, 2)
    sign: tuple[int, ...] = (1, 1, 1)
    origin_mm: tuple[float, ...] = (0.0, 0.0, 0.0)
    scale: float = 1.0

    @classmethod
    def parse(cls, axes: str, origin_mm: Sequence[float], scale: float) -> Frame:
        """Make one of text such as ``x,-y,z`` or ``y,z,x``.

        Raises
        ------
        InputError
            If an axis is missing or there twice, or the scale is not positive.
        """
        entries = re.findall(r"([-+]?)([xyz])", axes)
        if axes.replace(" ", "") != ",".join(s + a for s, a in entries) or sorted(
            a for _, a in entries
        ) != ["x", "y", "z"]:
            raise InputError(
                f"--axes {axes}: name each axis of the source once, in the order of the world's x, "
                "y, z, such as y,z,x or x,-y,z"
            )
        if not 1.0 / LARGEST_SCALE <= scale <= LARGEST_SCALE:
            raise InputError(
                f"--scale {scale:g}: give a positive factor, {1.0 / LARGEST_SCALE:g} to"
                f" {LARGEST_SCALE:g}"
            )
        return cls(
            tuple("xyz".index(a) for _, a in entries),
            tuple(-1 if s == "-" else 1 for s, _ in entries),
            tuple(origin_mm),
            scale,
        )

    def place(
        self, geometry: Geometry, values: np.ndarray, unit_mm: float
    ) -> tuple[Geometry, np.ndarray]:
        """Express a geometry, given in `unit_mm`, in world coordinates, mm.

        Returns
        -------
        geometry : Grid, Cloud or Mesh
        values : ndarray
            In the world's order of axes, if it is a grid.
        """

        def along(i: int, coordinates: np.ndarray) -> np.ndarray:
            shifted = np.asarray(coordinates, dtype=np.float64) * unit_mm - origin[i]
            return self.sign[i] * self.scale * shifted

        origin = [self.origin_mm[a] for a in self.axis]
        if isinstance(geometry, Grid):
            axes = [along(i, geometry.axes[a]) for i, a in enumerate(self.axis)]
            down = tuple(i for i, a in enumerate(axes) if len(a) > 1 and self.sign[i] < 0)
            axes = [axis[::-1] if i in down else axis for i, axis in enumerate(axes)]
            return Grid((axes[0], axes[1], axes[2])), np.flip(values.transpose(self.axis), down)
        old = geometry.points if isinstance(geometry, Cloud) else geometry.cells.points
        points = np.stack([along(i, old[:, a]) for i, a in enumerate(self.axis)], axis=1)
        if isinstance(geometry, Cloud):
            return Cloud(points), values
        return Mesh(moved(geometry.cells, points), geometry.at_cells), values


def bounds(geometry: Geometry) -> np.ndarray:
    """Lowest and highest coordinates; shape (2, 3)."""
    if isinstance(geometry, Grid):
        return np.array([[axis[0] for axis in geometry.axes], [axis[-1] for axis in geometry.axes]])
    if isinstance(geometry, Cloud):
        return np.array([geometry.points.min(axis=0), geometry.points.max(axis=0)])
    return np.reshape(geometry.cells.bounds, (3, 2)).T


def distances(geometry: Geometry) -> np.ndarray:
    """Typical distance of the samples along each axis, mm; shape (3,)."""
    if isinstance(geometry, Grid):
        return np.array([np.median(np.diff(a)) if len(a) > 1 else 0.0 for a in geometry.axes])
    if isinstance(geometry, Mesh):
        return mesh_values.cell_sizes(geometry)
    extent = np.ptp(geometry.points, axis=0)
    filled = extent > 1e-6 * extent.max()
    volume = np.prod(extent[filled]) / len(geometry.points)
    return np.where(filled, volume ** (1.0 / filled.sum()), 0.0)


def is_sized(box: np.ndarray) -> bool:
    """Whether an extent (2, 3) in mm is one that light is sent through."""
    return bool(SMALLEST_MM <= np.max(box[1] - box[0]) <= LARGEST_MM)


def check_size(box: np.ndarray, units: str) -> None:
    """Refuse an extent that is a factor of 1000 beyond what light is sent through.

    Raises
    ------
    InputError
        It names the likely units.
    """
    size = box[1] - box[0]
    shown = " x ".join(f"{s:.4g}" for s in size)
    if size.max() < SMALLEST_MM:
        raise InputError(
            f"the data span {shown} mm when read in {units}: coordinates in m, said to be in mm? "
            "Say --length-units m (or --scale 1000)"
        )
    if size.max() > LARGEST_MM:
        raise InputError(
            f"the data span {shown} mm when read in {units}: coordinates in mm, said to be in m? "
            "Say --length-units mm (or --scale 0.001)"
        )


def unfold(
    geometry: Geometry, values: np.ndarray, axis: int, flat_x: bool
) -> tuple[Geometry, np.ndarray]:
    """Reflect the samples near a mirror plane, so that none has its end there.

    Parameters
    ----------
    geometry : Grid, Cloud or Mesh
        On one side of the plane through 0; those on the negative side are put on the positive.
    values : ndarray
        Its values.
    axis : int
        0, 1 or 2: the plane's normal.
    flat_x : bool
        Whether the data are a cross-section, which is even about x = 0 as it stands.

    Raises
    ------
    InputError
        If there are data on both sides, or none near the plane.
    """
    if axis == 0 and flat_x:
        return geometry, values
    name, step = "xyz"[axis], distances(geometry)[axis]
    low, high = bounds(geometry)[:, axis]
    if low < -step and high > step:
        raise InputError(
            f"--mirror {name}: the data lie on both sides of {name} = 0, from {low:.4g} to "
            f"{high:.4g} mm; leave the mirror out, or give --origin a point in its plane"
        )
    if min(abs(low), abs(high)) > 1.01 * step:
        raise InputError(
            f"--mirror {name}: the data, from {low:.4g} to {high:.4g} mm, do not reach the plane "
            f"{name} = 0; give --origin a point in it"
        )
    if abs(low) > abs(high):
        turned = Frame(sign=tuple(-1 if i == axis else 1 for i in range(3)))
        geometry, values = turned.place(geometry, values, 1.0)
    if isinstance(geometry, Mesh):
        return mesh_values.reflected(geometry, values, axis, REFLECTED * step)
    if isinstance(geometry, Cloud):
        along = geometry.points[:, axis]
        near = (along < REFLECTED * step) & (along > 0.01 * step)
        image = geometry.points[near] * np.where(np.arange(3) == axis, -1.0, 1.0)
        return Cloud(np.concatenate([geometry.points, image])), np.append(values, values[near])
    nodes = geometry.axes[axis]
    inner = nodes > -0.01 * step
    nodes, values = nodes[inner], values.compress(inner, axis)
    near = nodes > 0.01 * step
    nodes = np.where(near, nodes, 0.0)
    axes = list(geometry.axes)
    axes[axis] = np.concatenate([-nodes[near][::-1], nodes])
    image = np.flip(values.compress(near, axis), axis)
    return Grid((axes[0], axes[1], axes[2])), np.concatenate([image, values], axis=axis)


def output_axes(
    geometry: Geometry,
    mirror: Sequence[bool],
    box_mm: Sequence[float] | None,
    spacing_mm: Sequence[float] | None,
    along_x_mm: Sequence[float] | None,
) -> tuple[np.ndarray, ...]:
    """Coordinates of the output grid's nodes.

    Parameters
    ----------
    geometry : Grid, Cloud or Mesh
        In world coordinates, unfolded. Its own nodes are taken if they are evenly spaced and
        nothing else is given.
    mirror : sequence of three bool
        Axes that begin at 0.
    box_mm : sequence of six float, optional
        x0, x1, y0, y1, z0, z1; else the data's extent.
    spacing_mm : sequence of three float, optional
        At most this between nodes; else the data's median distance.
    along_x_mm : sequence of two float, optional
        Extent of a cross-section along x.

    Returns
    -------
    tuple of three ndarray
        Equally spaced, at least `MIN_NODES` along each axis.

    Raises
    ------
    InputError
        If a box is empty or beyond the data, or the grid is too coarse or too large.
    """
    has = bounds(geometry).T
    steps = distances(geometry)
    axes = []
    for i, name in enumerate("xyz"):
        ends = has[i].round(4)  # float32 coordinates
        if i == 0 and along_x_mm is not None:
            ends = np.array(along_x_mm, dtype=np.float64)
            steps[0] = (ends[1] - ends[0]) / (MIN_NODES - 1)
        if mirror[i]:
            ends[0] = 0.0
        limits = ends.copy()
        if box_mm is not None:
            ends = np.array(box_mm[2 * i : 2 * i + 2], dtype=np.float64)
        slack = 1e-6 * (limits[1] - limits[0])
        if ends[0] < limits[0] - slack or ends[1] > limits[1] + slack or not ends[0] < ends[1]:
            raise InputError(
                f"the box runs from {ends[0]:g} to {ends[1]:g} mm along {name}, the data from "
                f"{limits[0]:g} to {limits[1]:g} mm; give a --box inside them"
            )
        if mirror[i] and ends[0] != 0.0:
            raise InputError(f"--mirror {name}: the box must begin at 0 along {name}")
        own = geometry.axes[i] if isinstance(geometry, Grid) else np.zeros(0)
        own = own[own >= ends[0] - slack]
        if len(own) >= MIN_NODES and box_mm is None and spacing_mm is None:
            even = np.linspace(own[0], own[-1], len(own))
            if own[0] <= ends[0] + slack and abs(own - even).max() < UNEVEN * (even[1] - even[0]):
                axes.append(even)
                continue
        step = spacing_mm[i] if spacing_mm is not None else steps[i]
        if not step > 0.0:
            raise InputError(f"its cells have no extent along {name}; give a --spacing")
        steps_of_it = min((ends[1] - ends[0]) / step, MOST_NODES)
        count = max(int(np.ceil(steps_of_it - UNEVEN)) + 1, 2)
        axes.append(np.linspace(ends[0], ends[1], count))
    shape = [len(axis) for axis in axes]
    shown = " x ".join(map(str, shape))
    if min(shape) < MIN_NODES:
        raise InputError(
            f"the grid would have {shown} nodes, and needs {MIN_NODES} along each axis; give a "
            "smaller --spacing"
        )
    if np.prod(shape, dtype=float) > MOST_NODES:
        raise InputError(
            f"the grid would have {shown} nodes; give a wider --spacing (0.8 mm across a plume is "
            "enough) or a smaller --box"
        )
    return tuple(axes)
