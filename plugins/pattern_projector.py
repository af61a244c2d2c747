"""The emitter `pattern_projector`: an inverse camera that throws a pattern."""

import math

import numpy as np
from virtual_sensor_plugins.laser_line import SourceEmitter
from virtual_sensor_plugins.refractive import folders_of_files
from virtual_sensor_plugins.views import OURS_FROM_MITSUBAS

from virtual_sensor.devices.patterns import pattern_of
from virtual_sensor.devices.projector import Projector
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError, naming
from virtual_sensor.optics.ray_families import Pinhole, PixelFamily
from virtual_sensor.poses import Pose, keeps_lengths

_LARGEST = 1e30  # float32 ends at 3e38
_MOST_PX = 1 << 16
_FOV_AXES = ("x", "y", "diagonal", "smaller", "larger")


class PatternProjector(SourceEmitter):
    """A projector: it throws a pattern from a projection centre, as a camera sees, turned round.

    ========================  ========  ========================================================
    Property                  Default   Meaning
    ========================  ========  ========================================================
    to_world                  (needed)  As a camera's: z forward, x left, y up
    width                     1280      Of the image, px
    height                    800       Of the image, px
    fov                       (needed)  Field of view, degrees
    fov_axis                  "x"       Of the field of view: "x", "y", "diagonal", "smaller" or
                                        "larger"
    principal_point_offset_x  0         By which part of the image's width it is moved, as a
                                        camera's
    principal_point_offset_y  0         By which part of its height
    pattern                   "white"   "white", "black", "uniform LEVEL", "sine u|v PERIOD PHASE"
                                        (px, rad), "gray u|v BIT", "checker SQUARE" (px), "stripe
                                        u|v MIDDLE WIDTH" (px), or an image file of its size
    pixels                    true      It has square pixels; false: the pattern is shown as it is,
                                        between pixel centres too
    power                     1         Of an all-white image, W
    ========================  ========  ========================================================
    """

    def __init__(self, props: mi.Properties) -> None:
        with naming("pattern_projector"):
            size = _whole(props, "width", 1280), _whole(props, "height", 800)
            projector = Projector(
                _family(props, size),
                pattern_of(str(props.get("pattern", "white")), tuple(folders_of_files())),
                power_w=_positive(props, "power", 1.0),
                pixels=bool(props.get("pixels", True)),
            )
            assert projector.extent  # folds are refused here
        super().__init__(props, projector)
        # Tables go to Dr.Jit's memory now: within a kernel that is being recorded none can.
        dr.eval(projector.flux(dr.zeros(mi.Float, 2), dr.zeros(mi.Float, 2)))


def _family(props: mi.Properties, size: tuple[int, int]) -> PixelFamily:
    """The projector's rays and pixels."""
    width, height = size
    if "fov" not in props:
        raise InputError("the property 'fov' is missing; give the field of view in degrees")
    fov = float(props["fov"])
    if not 0.0 < fov < 180.0:
        raise InputError(f"'fov' is {fov:g} degrees; give an angle above 0 and below 180")
    axis = str(props.get("fov_axis", "x"))
    if axis not in _FOV_AXES:
        raise InputError(f"'fov_axis' is \"{axis}\"; give one of {', '.join(_FOV_AXES)}")
    across = {
        "x": width,
        "y": height,
        "diagonal": math.hypot(width, height),
        "smaller": min(size),
        "larger": max(size),
    }[axis]
    focal_px = across / 2.0 / math.tan(math.radians(fov) / 2.0)
    # Mitsuba's pixel i reaches from i to i + 1, ours has its centre at i; its shift moves the film.
    shift = (_finite(props, f"principal_point_offset_{name}", 0.0) for name in "xy")
    centre = [n * (0.5 - by) - 0.5 for n, by in zip(size, shift, strict=True)]
    matrix = np.array([[focal_px, 0.0, centre[0]], [0.0, focal_px, centre[1]], [0.0, 0.0, 1.0]])
    return Pinhole(matrix, _pose(props), size)


def _pose(props: mi.Properties) -> Pose:
    """Pose of the lens in our convention: x along u, y along v, z forward."""
    if "to_world" not in props:
        raise InputError("the property 'to_world' is missing; give where it stands, by a <lookat>")
    matrix = np.asarray(props["to_world"].matrix, float).reshape(4, 4)
    if not np.isfinite(matrix).all():
        raise InputError("'to_world' is no rotation; give a <lookat> whose up and direction differ")
    if not keeps_lengths(matrix[:3, :3]):
        raise InputError(
            "'to_world' scales or shears, which a projector can't; give rotations and translations"
            " alone, and its image's size by 'fov'"
        )
    pose = Pose.from_matrix(matrix)
    return Pose(pose.rotation @ OURS_FROM_MITSUBAS, pose.origin_mm)


def _whole(props: mi.Properties, name: str, default: int) -> int:
    value = int(props.get(name, default))
    if not 1 <= value <= _MOST_PX:
        raise InputError(f"'{name}' is {value} px; give a whole number from 1 to {_MOST_PX}")
    return value


def _finite(props: mi.Properties, name: str, default: float) -> float:
    value = float(props.get(name, default))
    if not abs(value) < _LARGEST:
        raise InputError(f"'{name}' is {value:g}; give a finite number")
    return value


def _positive(props: mi.Properties, name: str, default: float) -> float:
    value = float(props.get(name, default))
    if not 1.0 / _LARGEST < value < _LARGEST:
        raise InputError(f"'{name}' must be a positive number, not {value:g}")
    return value


mi.register_emitter("pattern_projector", PatternProjector)
