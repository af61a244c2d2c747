"""The emitter `pattern_projector`: an inverse camera that throws a pattern."""

import math

import numpy as np
from virtual_sensor_plugins.laser_line import SourceEmitter
from virtual_sensor_plugins.properties import (
    distortion_of,
    finite,
    folders_of_files,
    listed_file,
    pose_of,
    positive,
    refuse_both,
)
from virtual_sensor_plugins.views import OURS_FROM_MITSUBAS

from virtual_sensor.arrays import one_of
from virtual_sensor.devices.patterns import pattern_of
from virtual_sensor.devices.photometry import watts_of
from virtual_sensor.devices.projector import Projector
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError, naming
from virtual_sensor.optics.ray_families import Pinhole, PixelFamily, Telecentric
from virtual_sensor.poses import Pose

_MM_PER_UM = 1e-3
_MOST_PX = 1 << 16


class PatternProjector(SourceEmitter):
    """A projector: it throws a pattern from a projection centre, as a camera sees, turned round.

    ========================  =========  =======================================================
    Property                  Default    Meaning
    ========================  =========  =======================================================
    to_world                  (needed)   As a camera's: z forward, x left, y up; the calibration's
                                         if it is left out
    width                     1280       Of the image, px
    height                    800        Of the image, px
    fov                       (needed)   Field of view, degrees; in its place focal_length with
                                         pixel, a telecentric image_width, or a calibration
    fov_axis                  "x"        Of the field of view: "x", "y", "diagonal", "smaller" or
                                         "larger"
    focal_length              (none)     Of the lens, mm
    pixel                     (none)     Pitch of the micromirrors, um
    telecentric               false      Its light is parallel
    image_width               (none)     Of a telecentric projector: width of its image, mm
    principal_point_offset_x  0          By which part of the image's width it is moved, as a
                                         camera's
    principal_point_offset_y  0          By which part of its height
    distortion                ""         OpenCV's coefficients, "k1, k2, p1, p2, k3 ...": 4, 5, 8,
                                         12 or 14 of them; empty: none
    calibration               (none)     File of the projector's matrix, size and distortion, and of
                                         its pose: of a camera with a projector, or of the projector
                                         alone as OpenCV has a camera
    pattern                   "white"    "white", "black", "uniform LEVEL", "sine u|v PERIOD PHASE"
                                         (px, rad), "gray u|v BIT", "checker SQUARE" (px), "stripe
                                         u|v MIDDLE WIDTH" (px), or an image file of its size
    pixels                    true       It has square pixels; false: the pattern is shown as it is,
                                         between pixel centres too
    contrast                  0          Light of white over light of black; 0: black is dark
    gamma                     1          Light goes with the grey value to this power
    bits                      0          To so many bits grey values are rounded; 0: not at all
    defocus                   0          Standard deviation of the image's blur, px
    power                     1          Of an all-white image, W
    lumen                     (none)     In its place: luminous flux, lm, of light of its wavelength
    wavelength                532        Of its light, nm: what lumen are depends on it
    ========================  =========  =======================================================
    """

    def __init__(self, props: mi.Properties) -> None:
        with naming("pattern_projector"):
            family = _family(props)
            contrast = finite(props, "contrast", 0.0)
            projector = Projector(
                family,
                pattern_of(str(props.get("pattern", "white")), tuple(folders_of_files())),
                power_w=_power_w(props),
                pixels=bool(props.get("pixels", True)),
                contrast=contrast or math.inf,
                gamma=finite(props, "gamma", 1.0),
                bits=int(props.get("bits", 0)),
                defocus_px=finite(props, "defocus", 0.0),
            )
            assert projector.extent  # folds are refused here
        super().__init__(props, projector)
        # Tables go to Dr.Jit's memory now: within a kernel that is being recorded none can.
        dr.eval(projector.flux(dr.zeros(mi.Float, 2), dr.zeros(mi.Float, 2)))


def _power_w(props: mi.Properties) -> float:
    """Of an all-white image."""
    if "lumen" not in props:
        return positive(props, "power", 1.0)
    if "power" in props:
        raise InputError("has both 'power' and 'lumen'; give one")
    return watts_of(positive(props, "lumen"), positive(props, "wavelength", 532.0))


def _family(props: mi.Properties) -> PixelFamily:
    """The projector's rays and pixels."""
    if "calibration" in props:
        return _calibrated(props, str(props["calibration"]))
    size = _whole(props, "width", 1280), _whole(props, "height", 800)
    if "to_world" not in props:
        raise InputError("the property 'to_world' is missing; give where it stands, by a <lookat>")
    pose, distortion = _pose(props), distortion_of(str(props.get("distortion", "")))
    # Mitsuba's pixel i reaches from i to i + 1, ours has its centre at i; its shift moves the film.
    shift = (finite(props, f"principal_point_offset_{name}", 0.0) for name in "xy")
    centre = [n * (0.5 - by) - 0.5 for n, by in zip(size, shift, strict=True)]
    per_unit, kind = _scale(props, size)
    matrix = np.array([[per_unit, 0.0, centre[0]], [0.0, per_unit, centre[1]], [0.0, 0.0, 1.0]])
    return kind(matrix, pose, size, distortion)


def _scale(props: mi.Properties, size: tuple[int, int]) -> tuple[float, type[PixelFamily]]:
    """Pixels per unit of the coordinates, and what kind of projector it is."""
    given = [name for name in ("fov", "focal_length", "image_width") if name in props]
    telecentric = bool(props.get("telecentric", False))
    if len(given) != 1 or telecentric != (given == ["image_width"]):
        raise InputError(
            f"has {' and '.join(map(repr, given)) or 'no field of view'}"
            f"{' and is telecentric' * telecentric}; give 'fov' in degrees, or 'focal_length' in mm"
            " with 'pixel' in um, or, of a telecentric one, 'image_width' in mm"
        )
    if "fov_axis" in props and given != ["fov"]:
        raise InputError("has a 'fov_axis' and no 'fov' that it is of; take it out")
    if telecentric:
        return size[0] / positive(props, "image_width"), Telecentric
    if "focal_length" in props:
        if "pixel" not in props:
            raise InputError(
                "has 'focal_length' but no 'pixel'; give the pitch of its pixels in um"
            )
        pitch_mm = positive(props, "pixel") * _MM_PER_UM
        return positive(props, "focal_length") / pitch_mm, Pinhole
    fov = float(props["fov"])
    if not 0.0 < fov < 180.0:
        raise InputError(f"'fov' is {fov:g} degrees; give an angle above 0 and below 180")
    width, height = size
    across = {
        "x": width,
        "y": height,
        "diagonal": math.hypot(width, height),
        "smaller": min(size),
        "larger": max(size),
    }
    axis = one_of("'fov_axis'", str(props.get("fov_axis", "x")), across)
    return across[axis] / 2.0 / math.tan(math.radians(fov) / 2.0), Pinhole


def _calibrated(props: mi.Properties, name: str) -> Pinhole:
    """The projector that a calibration file describes."""
    from virtual_sensor.devices.calibration_files import (  # which few scenes have
        ALSO_OF_BOTH,
        CalibrationFile,
        camera_in,
        read_camera_and_projector,
    )

    clash = (
        *(
            "width",
            "height",
            "fov",
            "fov_axis",
            "focal_length",
            "image_width",
            "distortion",
            "telecentric",
        ),
        *("principal_point_offset_x", "principal_point_offset_y"),
    )
    refuse_both(props, "calibration", clash)
    path = listed_file("calibration", name)
    file = CalibrationFile.read(path, ALSO_OF_BOTH)
    if file.find("projector_matrix") is None:
        projector = camera_in(CalibrationFile.read(path))
    else:
        _, projector, _ = read_camera_and_projector(path)
    if projector.fisheye:
        raise InputError(
            f"{path}: is of a fisheye, which a projector can't be; give OpenCV's usual lens"
        )
    return projector.with_pose(_pose(props)) if "to_world" in props else projector


def _pose(props: mi.Properties) -> Pose:
    """Pose of the lens in our convention: x along u, y along v, z forward."""
    pose = pose_of(props, "'fov'")
    return Pose(pose.rotation @ OURS_FROM_MITSUBAS, pose.origin_mm)


def _whole(props: mi.Properties, name: str, default: int) -> int:
    value = int(props.get(name, default))
    if not 1 <= value <= _MOST_PX:
        raise InputError(f"'{name}' is {value} px; give a whole number from 1 to {_MOST_PX}")
    return value


mi.register_emitter("pattern_projector", PatternProjector)
