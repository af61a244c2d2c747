"""What a new scene can be told: the options of `virtual-sensor new` and of `new_scene`."""

import dataclasses
from dataclasses import dataclass
from typing import Any

UPWARD: dict[str, tuple[str, float]] = {
    "z": ("z", 0.0),
    "-z": ("x", 180.0),
    "y": ("x", 90.0),
    "-y": ("x", -90.0),
    "x": ("y", -90.0),
    "-x": ("y", 90.0),
}
"""Axes of a part that may be up, and the turn that makes each the world's z: axis and degrees."""

SPELT = {"in": "inch", "ft": "foot"}
"""Units as people may write them, and as they are called here."""

_LIST = {"repeated": True}


@dataclass(frozen=True)
class NewScene:
    """A part and the sensor over it; what is not given is chosen so that it suits the part.

    Lengths in mm, angles in degrees.

    Attributes
    ----------
    part : str, optional
        File of the part, STL, OBJ, PLY or 3MF, which is copied beside the scene; or one that is
        installed, bracket.stl or gear_blank.stl; by default a cylinder.
    unit : str, optional
        Of the lengths in the part's file: um, mm, cm, m, in, ft; by default mm.
    up : str
        Axis of the part that points upwards: z, -z, y, -y, x, -x.
    diameter_mm : float, optional
        Of the cylinder, where there is no part, mm; by default 27.
    length_mm : float, optional
        Of the cylinder, mm; by default 170.
    focal_length_mm : float, optional
        Of the camera's lens, mm; by default about four times the film's width, 35.
    pixel_um : float, optional
        Pitch of the camera's pixels, um; by default 3.45.
    film : str, optional
        Pixels of the camera, width by height; by default 2448x2048.
    f_number : float, optional
        Of the camera's lens, its focal length by its pupil, such as 8; by default a pinhole, which
        is sharp everywhere.
    focus_distance_mm : float, optional
        From the lens to what is in focus, mm; by default the line's middle.
    sensor_tilt : str, optional
        Of the camera's sensor, degrees, or laser_plane: so that the laser's plane is in focus.
    distortion : str, optional
        Of the camera's lens: OpenCV's coefficients, "k1, k2, p1, p2, ...".
    calibration : str, optional
        File of the camera's matrix, distortion and size, as OpenCV and ROS write it; it is copied
        beside the scene, and has the place of film, focal length and distortion.
    sensor_model : str, optional
        Image sensor that frames are recorded with: cmos_5um5, cmos_3um45, profile_sensor, or a data
        sheet, TOML, which is copied beside the scene; its pixels are the camera's by default.
    exposure : str, optional
        Of recorded frames, such as 2ms; by default automatic.
    distance_mm : float, optional
        Working distance, from the camera to the line, mm; by default so that the camera sees what
        is lit of the part.
    alpha : tuple of float
        Triangulation angle between the laser and the camera, degrees, by default 30; one for each
        camera, repeated for several.
    tilt : tuple of float
        Laser or projector from the vertical, degrees, by default 0; one for each, repeated for
        several.
    laser_offset_mm : tuple of float
        Laser beside the middle, across its line, mm, by default 0; one for each laser.
    beta : float, optional
        The whole sensor round the x-axis, degrees; by default 0.
    turn : float, optional
        The whole sensor round the vertical, degrees; by default 0, the line along y.
    at_mm : tuple of two or three float, optional
        X,Y,Z of the line's middle in the scene's world, mm, that is after unit and up; X,Y alone:
        on the part's surface there. By default on the surface under the middle of the part's box;
        where there is none, as over a bore, beside it, where the line lights a good part.
    projector : bool
        A projector stands in the laser's place, for `fringes`: its image covers what the camera
        sees.
    line_length_mm : float, optional
        Of the laser's line, mm; by default four fifths of the part.
    line_radius_mm : float, optional
        Half the line's width, to 1/e^2, mm; by default four pixels.
    fan : float, optional
        Full fan angle of the laser, degrees; by default 0, a sheet of parallel light.
    wavelength_nm : float, optional
        Of the laser, nm; by default 532.
    material : str, optional
        Of the part: the name of one that is installed, such as ground_steel or oxide_scale, or a
        file with Mitsuba's BSDF, which is copied beside the scene. By default diffuse: the surface
        scatters evenly, as if it were painted.
    roughness : float, optional
        Of bare steel, alpha of GGX, from 0.05, shiny, to 0.5, dull; without a material, that of
        ground_steel.
    max_depth : int, optional
        Of light's path: by default 2, direct light; 3, with one reflection between surfaces, which
        shows a shiny part's ghosts; 4, with two.
    indirect_samples : int, optional
        Points of the lit stripe for each sample of light that is reflected in between; by default
        8.
    temperature_c : float, optional
        Of a hot part, degC: its glow can then be switched on by the parameter `emissivity`.
    field : str, optional
        Hot air round it: a field file (.nc), or one that is installed. By default light runs
        straight.
    from_scene : str, optional
        Copy this scene, with its fields and meshes; the other options change its parameters.
    """

    part: str | None = None
    unit: str | None = None
    up: str = "z"
    diameter_mm: float | None = None
    length_mm: float | None = None
    focal_length_mm: float | None = None
    pixel_um: float | None = None
    film: str | None = None
    f_number: float | None = None
    focus_distance_mm: float | None = None
    sensor_tilt: str | None = None
    distortion: str | None = None
    calibration: str | None = None
    sensor_model: str | None = None
    exposure: str | None = None
    distance_mm: float | None = None
    alpha: tuple[float, ...] = dataclasses.field(default=(), metadata=_LIST)
    tilt: tuple[float, ...] = dataclasses.field(default=(), metadata=_LIST)
    laser_offset_mm: tuple[float, ...] = dataclasses.field(default=(), metadata=_LIST)
    beta: float | None = None
    turn: float | None = None
    at_mm: tuple[float, ...] | None = dataclasses.field(default=None, metadata={"counts": (2, 3)})
    projector: bool = False
    line_length_mm: float | None = None
    line_radius_mm: float | None = None
    fan: float | None = None
    wavelength_nm: float | None = None
    material: str | None = None
    roughness: float | None = None
    max_depth: int | None = None
    indirect_samples: int | None = None
    temperature_c: float | None = None
    field: str | None = None
    from_scene: str | None = dataclasses.field(default=None, metadata={"flag": "--from"})

    @property
    def given(self) -> dict[str, Any]:
        """What was said, by the names of the attributes."""
        return {
            each.name: value
            for each in dataclasses.fields(self)
            if (value := getattr(self, each.name)) not in (None, (), each.default)
        }
