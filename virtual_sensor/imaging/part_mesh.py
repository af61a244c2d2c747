"""The part of a loaded scene as one mesh of triangles in the world: what other solvers take.

============================  =====================================================================
Shape of the scene            What becomes of it
============================  =====================================================================
ply, obj, stl, cube, any      its triangles, where its `to_world` puts them
other mesh
cylinder                      a prism of 96 sides whose ends are closed
sphere                        1,280 triangles
disk, rectangle               its triangles, unless it lies on the end of a cylinder
instances, curves, others     refused
============================  =====================================================================

Where some shapes glow and some do not, the hot part is those that glow.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.glow import Glow

from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.imaging.scene_file import shortened

if TYPE_CHECKING:
    from trimesh import Trimesh

Array = NDArray[np.float64]

_SIDES = 96
_SAME_MM = 1e-3  # float32 leaves so much doubt of a place


def part_mesh(scene: Scene) -> tuple[Trimesh, tuple[str, ...]]:
    """The surface of a scene's part in the world, mm, and notes on what is not of it.

    Faces point outwards where a body's surface is closed.

    Raises
    ------
    InputError
        If a shape has no mesh, or none is left.
    """
    import trimesh

    shapes = list(scene.mitsuba.shapes())
    glowing = [shape for shape in shapes if isinstance(shape.emitter(), Glow)]
    hot = glowing or shapes
    notes = []
    if len(hot) < len(shapes):
        cold = ", ".join(_name(shape) for shape in shapes if shape not in glowing)
        notes.append(f"left out of the air, since they do not glow: {shortened(cold)}")
    ends: list[Array] = []
    meshes = []
    for shape in sorted(hot, key=_flat):  # ends of cylinders are known before their disks
        mesh = _mesh(scene, shape)
        if _flat(shape) and any(_lies_on(mesh.vertices, end) for end in ends):
            continue
        if _kind(shape) == "Cylinder":
            ends += [mesh.vertices[:_SIDES], mesh.vertices[_SIDES : 2 * _SIDES]]
        meshes.append(mesh)
    part = trimesh.util.concatenate(meshes)
    part.merge_vertices(digits_vertex=4)
    part.update_faces(part.nondegenerate_faces())
    return part, tuple(notes)


def _kind(shape: Any) -> str:
    return str(shape).split("[", 1)[0].strip()


def _name(shape: Any) -> str:
    return shape.id() or _kind(shape).lower()


def _flat(shape: Any) -> bool:
    return _kind(shape) in ("Disk", "Rectangle")


def _mesh(scene: Scene, shape: Any) -> Trimesh:
    """A shape's triangles in the world."""
    import trimesh

    if isinstance(shape, mi.Mesh):
        held = mi.traverse(shape)
        vertices = np.array(held["vertex_positions"], float).reshape(-1, 3)
        return trimesh.Trimesh(vertices, np.array(held["faces"]).reshape(-1, 3), process=False)
    if (kind := _kind(shape)) not in _UNIT_MESHES:
        raise InputError(
            f"{scene.path}: the shape {_name(shape)} is a {kind.lower()}, whose air can't be"
            " simulated; give its surface as a mesh (STL, OBJ or PLY)"
        )
    vertices, faces = _UNIT_MESHES[kind]()
    place = np.array(mi.traverse(shape)["to_world"].matrix, float).reshape(4, 4)
    return trimesh.Trimesh(vertices @ place[:3, :3].T + place[:3, 3], faces, process=False)


def _circle(height: float = 0.0) -> Array:
    angle = np.linspace(0.0, 2.0 * np.pi, _SIDES, endpoint=False)
    # As much area as the circle: the part gives off as much heat.
    size = np.sqrt(2.0 * np.pi / _SIDES / np.sin(2.0 * np.pi / _SIDES))
    return size * np.stack([np.cos(angle), np.sin(angle), 0.0 * angle], axis=1) + np.array(
        [0.0, 0.0, height]
    )


def _fan(circle: NDArray[np.int64], middle: int) -> NDArray[np.int64]:
    return np.stack([circle, np.roll(circle, -1), np.full_like(circle, middle)], axis=1)


def _cylinder() -> tuple[Array, NDArray[np.int64]]:
    low, high = np.arange(_SIDES), np.arange(_SIDES, 2 * _SIDES)
    next_low, next_high = np.roll(low, -1), np.roll(high, -1)
    vertices = np.concatenate([_circle(), _circle(1.0), [[0, 0, 0], [0, 0, 1]]])
    sides = [
        np.stack([low, next_low, next_high], axis=1),
        np.stack([low, next_high, high], axis=1),
    ]
    ends = [_fan(low, 2 * _SIDES)[:, ::-1], _fan(high, 2 * _SIDES + 1)]
    return vertices, np.concatenate([*sides, *ends])


def _disk() -> tuple[Array, NDArray[np.int64]]:
    return np.concatenate([_circle(), [[0, 0, 0]]]), _fan(np.arange(_SIDES), _SIDES)


def _rectangle() -> tuple[Array, NDArray[np.int64]]:
    corners = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]], float)
    return corners, np.array([[0, 1, 2], [0, 2, 3]])


def _sphere() -> tuple[Array, NDArray[np.int64]]:
    import trimesh

    mesh = trimesh.creation.icosphere(subdivisions=3)
    return np.asarray(mesh.vertices), np.asarray(mesh.faces)


_UNIT_MESHES: dict[str, Callable[[], tuple[Array, NDArray[np.int64]]]] = {
    "Cylinder": _cylinder,
    "Disk": _disk,
    "Rectangle": _rectangle,
    "Sphere": _sphere,
}
"""By Mitsuba's kinds of shapes: vertices and faces before `to_world`."""


def _lies_on(points: Array, end: Array) -> bool:
    """Whether points (N, 3) lie on the flat end, with corners (M, 3), of a cylinder."""
    middle = end.mean(axis=0)
    normal = np.cross(end[0] - middle, end[len(end) // 4] - middle)
    normal /= np.linalg.norm(normal)
    radius = np.linalg.norm(end - middle, axis=1).max()
    offset = points - middle
    across = np.linalg.norm(offset, axis=1).max()
    return bool(np.abs(offset @ normal).max() < _SAME_MM and across < radius + _SAME_MM)
