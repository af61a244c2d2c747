"""The `laser_line` emitter: a thin sheet of laser light, or a row of laser dots."""

from typing import Any

import numpy as np

from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.illumination import LaserFrame
from virtual_sensor.optics.sensor_model import LaserLine, Pose
from virtual_sensor.optics.surfaces import own_variant

_FARTHEST_MM = 1e6  # float32 places are good to 0.06 mm there
_SQUARE = 1e-4  # a rotation's axes are of length 1 and square to each other, but for rounding
_MOST_DOTS = 1000


class LaserLineEmitter(mi.Emitter):
    """Laser line generator: Gaussian across the sheet, even along the line.

    Geometric light: the sheet keeps its thickness (no diffraction, no focus).

    ============  ==========  ==================================================================
    Property      Default     Meaning
    ============  ==========  ==================================================================
    to_world      (needed)    Exit of the generator: z forward, y along the line, x across
    distance      300         From the exit to the reference plane, mm
    length        (needed)    Length of the line in the reference plane, mm
    radius        (needed)    1/e^2 radius across the sheet, mm
    power         1           Total power, W
    fan           0           Full fan angle in the laser plane, degrees; 0 is telecentric
    dots          (none)      Positions along the line, mm, as "0, -1.25": round Gaussian beams of
                              the same radius, sharing the power, in place of the line
    ============  ==========  ==================================================================

    Where light runs straight, any Mitsuba integrator can use it (`sample_direction`); through hot
    air use the `refractive` integrator.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.line = LaserLine(
            pose=_pose(props),
            distance_mm=_positive(props, "distance", 300.0),
            length_mm=_positive(props, "length"),
            radius_mm=_positive(props, "radius"),
            power_w=_positive(props, "power", 1.0),
            fan_deg=float(props.get("fan", 0.0)),
            dots_mm=_positions(str(props.get("dots", ""))),
        )
        if not 0.0 <= self.line.fan_deg < 170.0:
            raise InputError(
                f"laser_line: 'fan' is {self.line.fan_deg:g} degrees; give a full angle from 0"
                " (telecentric) up to 170"
            )
        if self.line.fan_per_mm * self.line.distance_mm >= 1.0:
            raise InputError(
                f"laser_line: a 'fan' of {self.line.fan_deg:g} degrees would start in front of the"
                " exit; make 'fan' or 'distance' smaller, or 'length' larger"
            )
        self.m_flags = mi.EmitterFlags.DeltaDirection

    def irradiance(self, a: Any, b: Any, concentration: Any) -> Any:
        """Flux density in W/mm^2 square to the light, by `Illumination`'s numbers; none for NaN."""
        line, w = self.line, self.line.radius_mm
        if line.dots_mm.size:
            peak = line.power_w / line.dots_mm.size * 2.0 / (np.pi * w**2)
            along = sum(dr.exp(-2.0 * dr.square((b - float(y)) / w)) for y in line.dots_mm)
        else:
            peak = line.power_w / line.length_mm * np.sqrt(2.0 / np.pi) / w
            along = dr.select(dr.abs(b) <= line.length_mm / 2.0, 1.0, 0.0)
        profile = dr.exp(-2.0 * dr.square(a / w)) * along
        value = mi.Float(float(peak) * profile * concentration)
        return dr.select(self.reaches(a, b), value, 0.0)

    def reaches(self, a: Any, b: Any, margin_mm: tuple[float, float] = (0.0, 0.0)) -> Any:
        """Mask of the coordinates with light that counts, or near it; NaN has none."""
        return self.line.reaches(a, b, margin_mm)

    @property
    def extent(self) -> tuple[np.ndarray, np.ndarray]:
        """Lowest and highest (a, b) in mm with light that counts, each of shape (2,)."""
        radius = self.line.reach_mm
        if self.line.dots_mm.size:
            ends = self.line.dots_mm.min() - radius, self.line.dots_mm.max() + radius
        else:
            ends = -self.line.length_mm / 2.0, self.line.length_mm / 2.0
        return np.array([-radius, ends[0]]), np.array([radius, ends[1]])

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: Any = True
    ) -> tuple[mi.DirectionSample3f, Any]:
        """Light at a point by the straight laser ray; the only direction there is."""
        frame = LaserFrame.of(self.line, mi.Array3f)
        point = mi.Array3f(it.p)
        a, b = frame.straight(point)
        depth = frame.coordinates(point)[2]
        heading = frame.rays(a, b)[1]
        cosine = dr.dot(frame.axis, heading)
        spread = (1.0 + frame.fan_per_mm * depth) * cosine
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = -mi.Vector3f(heading)
        ds.dist = (frame.distance_mm + depth) / cosine
        ds.p = mi.Point3f(it.p + ds.d * ds.dist)
        ds.n = mi.Normal3f(heading)
        ds.pdf = 1.0
        ds.delta = True
        ds.emitter = mi.EmitterPtr(self)
        lit = active & (spread > 0.0) & (ds.dist > 0.0)
        return ds, mi.Spectrum(self.irradiance(a, b, dr.rcp(spread))) & lit

    def eval(self, si: mi.SurfaceInteraction3f, active: Any = True) -> Any:
        """Nothing: the generator itself is not seen."""
        return mi.Spectrum(0.0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Nil: a single direction can't be met by chance."""
        return mi.Float(0.0)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        """The exit's middle."""
        return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(*map(float, self.line.pose.origin_mm)))

    def to_string(self) -> str:
        """Its own values, for Mitsuba's scene listing."""
        return f"LaserLine[{self.line}]"


def laser_of(scene: mi.Scene) -> LaserLineEmitter:
    """The scene's only laser line generator.

    Raises
    ------
    InputError
        If there is none, or several.
    EngineError
        If the scene is another Mitsuba variant's.
    """
    own_variant(scene)
    found = [e for e in scene.emitters() if isinstance(e, LaserLineEmitter)]
    if len(found) != 1:
        raise InputError(
            f'{len(found)} emitters of type "laser_line"; a scene for the refractive integrator has'
            " exactly one"
        )
    return found[0]


def _pose(props: mi.Properties) -> Pose:
    """Where the exit stands: a rotation and a place, since what else it is told it can't do."""
    matrix = np.asarray(props["to_world"].matrix, float).reshape(4, 4)
    axes = matrix[:3, :3]
    if not np.isfinite(matrix).all():
        raise InputError(
            "laser_line: 'to_world' is no rotation; give a <lookat> whose up and direction differ"
        )
    if not np.allclose(axes.T @ axes, np.eye(3), atol=_SQUARE):
        raise InputError(
            "laser_line: 'to_world' scales or shears, which a laser can't; give rotations and"
            " translations alone, and its size by 'length', 'radius' and 'distance'"
        )
    return Pose.from_matrix(matrix)


def _positive(props: mi.Properties, name: str, default: float | None = None) -> float:
    if default is None and name not in props:
        raise InputError(f"laser_line: the property '{name}' is missing; give it in mm")
    value = float(props.get(name, default))
    if not 1e-30 < value < 1e30:  # of float32
        raise InputError(f"laser_line: '{name}' must be a positive number, not {value:g}")
    if name != "power" and value > _FARTHEST_MM:
        raise InputError(f"laser_line: '{name}' is {value:g} mm; give at most {_FARTHEST_MM:g} mm")
    return value


def _positions(text: str) -> np.ndarray:
    try:
        places = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        places = np.array([np.nan])
    if not np.isfinite(places).all():
        raise InputError(
            f'laser_line: \'dots\' must list positions in mm, such as "0, -1.25", not "{text[:80]}"'
        )
    if places.size > _MOST_DOTS:
        raise InputError(f"laser_line: {places.size} 'dots'; give at most {_MOST_DOTS}")
    if np.abs(places).max(initial=0.0) > _FARTHEST_MM:
        raise InputError(f"laser_line: 'dots' lie beyond {_FARTHEST_MM:g} mm; give them in mm")
    return places


mi.register_emitter("laser_line", LaserLineEmitter)
