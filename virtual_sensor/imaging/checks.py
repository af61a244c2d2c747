"""Is the scene one that can be measured?  Asked before any light is followed through the field."""

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.triangulation import check_geometry
from virtual_sensor.optics.ray_search import SearchStatus, ray_search
from virtual_sensor.optics.sensor_model import SensorModel
from virtual_sensor.optics.trace import to_vectors

Array = NDArray[np.float64]

JUMP_TOLD_PX = 0.003
"""A border jump that moves the image by more than this is told of..."""
JUMP_REFUSED_PX = 0.1
"""...and one that moves it by more than this is refused."""

_INSIDE_MM = 1e-4
_ELEMENT = {"camera": "<sensor>", "laser": '<emitter type="laser_line">'}
_FIELD = '<integrator type="refractive">: the field'


def check_scene(scene: Scene) -> list[str]:
    """Check geometry and field of a scene.

    Returns
    -------
    list of str
        What the user should know, though it can be measured.

    Raises
    ------
    InputError
        Naming the file, the element and the remedy.
    """
    try:
        check_geometry(scene.sensor)
        _check_places(scene)
        y, line = _line_on_part(scene)
        return _check_field(scene.field, scene.sensor, y, line) if scene.field else []
    except InputError as error:
        raise InputError(f"{scene.path}: {error}") from None


def _check_places(scene: Scene) -> None:
    sensor = scene.sensor
    for name, pose in (("camera", sensor.camera.pose), ("laser", sensor.laser.pose)):
        x, y, z = pose.origin_mm
        place = f"{_ELEMENT[name]}: the {name} at ({x:.1f}, {y:.1f}, {z:.1f}) mm"
        forward = to_vectors(pose.rotation[:, 2][None])
        if np.any(np.array(scene.surface.starts_inside(to_vectors(pose.origin_mm[None]), forward))):
            raise InputError(f"{place} is inside the part; move it out (to_world)")
        if scene.field and z < scene.field.box[0, 2]:
            floor = scene.field.box[0, 2]
            raise InputError(
                f"{place} is under the floor of the air's field, z = {floor:g} mm; turn the sensor"
                " less (beta, tilt, alpha)"
            )


def _line_on_part(scene: Scene) -> tuple[Array, Array]:
    """Laser rays' y (N,) and points (N, 3) on the part, by straight light; some in the picture."""
    laser = scene.sensor.laser
    y = laser.dots_mm if laser.dots_mm.size else np.linspace(-0.5, 0.5, 33) * laser.length_mm
    found = ray_search(scene.cold(), y, k_stop=1, method="paper", r_max_um=np.inf)
    met = found.status != SearchStatus.LASER_MISSED
    if not met.any():
        raise InputError(
            f"{_ELEMENT['laser']}: the laser misses the part; turn it (to_world, tilt) or move the"
            " part"
        )
    outside, hidden = (
        found.status[met] == reason
        for reason in (SearchStatus.OUTSIDE_IMAGE, SearchStatus.UNDERCUT)
    )
    if np.all(outside | hidden):
        raise InputError(
            f"{_ELEMENT['camera']}: "
            + (
                "the part hides the laser line from the camera; turn the camera (to_world, alpha)"
                if hidden.any()
                else "the camera's image does not hold the laser line; turn the camera (to_world,"
                " alpha) or widen its fov"
            )
        )
    return y[met], found.laser_point_mm[met]


def _check_field(field: IndexField, sensor: SensorModel, y_mm: Array, line_mm: Array) -> list[str]:
    """The field must hold the lit part of the surface and fade where light enters."""
    low, high = field.box
    outside = np.any((line_mm < low) | (line_mm > high), axis=1)
    if outside.any():
        x, y, z = line_mm[outside][0]
        raise InputError(
            f"{_FIELD} from {_point(low)} to {_point(high)} mm does not cover the light path: the"
            f" laser meets the part at {_point((x, y, z))} mm; give a larger field"
        )
    told = []
    laser_mm, _ = sensor.laser.rays(0.0, y_mm)
    for name, origin_mm in (("camera", sensor.camera.pose.origin_mm), ("laser", laser_mm)):
        shift_px, jump, place = _border_shift(field, sensor, origin_mm, line_mm)
        text = (
            f"{_FIELD} does not fade to ambient where the {name}'s light enters it, at"
            f" {_point(place)} mm: a jump of {jump:.1e} in n - 1, which moves the image by about"
            f" {shift_px:.2g} px"
        )
        if shift_px > JUMP_REFUSED_PX:
            raise InputError(f"{text}; give a field that reaches further out")
        if shift_px > JUMP_TOLD_PX:
            told.append(text)
    return told


def _border_shift(
    field: IndexField, sensor: SensorModel, origin_mm: Array, line_mm: Array
) -> tuple[float, float, Array]:
    """Largest shift in px that refraction at the field's border would give, its jump and place.

    Snell's law for a small jump: the ray turns by jump * tan(angle of incidence).
    """
    ray = line_mm - origin_mm
    distance = np.linalg.norm(ray, axis=1)
    with np.errstate(divide="ignore", invalid="ignore"):
        faces = (np.where(ray >= 0.0, field.box[0], field.box[1]) - origin_mm) / ray
    axis = np.nanargmax(faces, axis=1)
    along = np.clip(np.nanmax(faces, axis=1), 0.0, 1.0)
    place = origin_mm + along[:, None] * ray
    inner = np.clip(place, field.box[0] + _INSIDE_MM, field.box[1] - _INSIDE_MM)
    jump = np.where(along > 0.0, np.abs(field.refractivity(inner) - field.ambient), 0.0)
    cosine = np.abs(ray[np.arange(len(ray)), axis]) / distance
    turn = jump * np.sqrt(1.0 - cosine**2) / np.maximum(cosine, 1e-3)
    depth = sensor.camera.pose.to_local(line_mm)[:, 2]
    shift = turn * (1.0 - along) * distance * sensor.camera.matrix[0, 0] / depth
    worst = int(np.argmax(shift))
    return float(shift[worst]), float(jump[worst]), place[worst]


def _point(xyz: Array | tuple[float, ...]) -> str:
    return "(" + ", ".join(f"{float(v):.4g}" for v in xyz) + ")"
