"""Emitters of devices with a ray family, and `laser_line`: a thin sheet of laser light, or dots."""

from typing import Any

import numpy as np
from virtual_sensor_plugins.properties import pose_of, positive
from virtual_sensor_plugins.refractive import folders_of_files

from virtual_sensor.devices.coherence import Coherence
from virtual_sensor.devices.device import Device
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.devices.laser_profile import (
    Focus,
    MeasuredProfile,
    profile_of,
    uniformity_of,
)
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError, naming
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.ray_families import Sheet

_FARTHEST_MM = 1e6  # float32 places are good to 0.06 mm there
_MOST_DOTS = 1000


class SourceEmitter(mi.Emitter):
    """A device with a ray family as an emitter: one ray lights a point, with the device's flux.

    Geometric light, without diffraction.  Where it runs straight, any Mitsuba integrator can use it
    (`sample_direction`); through hot air use the `refractive` integrator.

    Parameters
    ----------
    props : mi.Properties
    source : Device
    """

    def __init__(self, props: mi.Properties, source: Device) -> None:
        super().__init__(props)
        self.source = source
        self.m_flags = mi.EmitterFlags.DeltaDirection

    def sample_direction(
        self, it: mi.Interaction3f, sample: mi.Point2f, active: Any = True
    ) -> tuple[mi.DirectionSample3f, Any]:
        """Light at a point by the straight ray; the only direction there is."""
        frame = FamilyFrame.of(self.source.family, mi.Array3f, opaque=False)
        s, t, depth = frame.coordinates(mi.Array3f(it.p))
        heading = frame.heading(*frame.family.slope(s, t))
        cosine = dr.dot(frame.z, heading)
        spread = dr.abs(frame.family.spread(s, t, depth)) * cosine
        ds = dr.zeros(mi.DirectionSample3f)
        ds.d = -mi.Vector3f(heading)
        ds.dist = depth / cosine
        ds.p = mi.Point3f(it.p + ds.d * ds.dist)
        ds.n = mi.Normal3f(heading)
        ds.pdf = 1.0
        ds.delta = True
        ds.emitter = mi.EmitterPtr(self)
        lit = active & (spread > 0.0) & (ds.dist > 0.0)
        return ds, mi.Spectrum(self.source.flux(s, t, depth) / spread) & lit

    def eval(self, si: mi.SurfaceInteraction3f, active: Any = True) -> Any:
        """Nothing: the device itself is not seen."""
        return mi.Spectrum(0.0)

    def pdf_direction(self, it: Any, ds: Any, active: Any = True) -> Any:
        """Nil: a single direction can't be met by chance."""
        return mi.Float(0.0)

    def bbox(self) -> mi.ScalarBoundingBox3f:
        """The origin of the family's frame."""
        origin = self.source.family.pose.origin_mm
        return mi.ScalarBoundingBox3f(mi.ScalarPoint3f(*map(float, origin)))

    def to_string(self) -> str:
        """Its own values, for Mitsuba's scene listing."""
        return f"{type(self).__name__}[{self.source}]"


class LaserLineEmitter(SourceEmitter):
    """Laser line generator: by default Gaussian across the sheet, even along the line.

    The sheet keeps its thickness, unless it has a focus: a beam_quality or a rayleigh_length.

    ===============  ===========  ==============================================================
    Property         Default      Meaning
    ===============  ===========  ==============================================================
    to_world         (needed)     Exit of the generator: z forward, y along the line, x across
    distance         300          From the exit to the reference plane, mm
    length           (needed)     Length of the line in the reference plane, mm
    radius           (needed)     1/e^2 radius across the sheet, mm: with a focus, in its waist; of
                                  a profile's table it can be left out
    power            1            Total power, W
    fan              0            Full fan angle in the laser plane, degrees; 0 is telecentric
    dots             (none)       Positions along the line, mm, as "0, -1.25": round Gaussian beams
                                  of the same radius, sharing the power, in place of the line
    profile          "gaussian"   Across the sheet: "gaussian"; "tails POWER RADIUS", part of the
                                  power in a wider Gaussian and its radius in radii of the core, as
                                  "tails 0.12 2.5"; "super ORDER", exp(-2 abs(x/radius)^ORDER); or a
                                  file whose rows are a distance in mm and an intensity
    uniformity       1            Along the line: intensity at its ends over that in the middle, a
                                  parabola between; or a file whose rows are a place and an
                                  intensity, the first and the last of the line's ends
    waist_distance   (distance)   Of a focus: from the exit to the sheet's waist, mm
    beam_quality     (none)       Of a focus: M^2, 1 of an ideal beam; the Rayleigh length follows
                                  from it, the radius and the wavelength; empty: no focus
    wavelength       532          Of its light, nm: for the beam_quality
    rayleigh_length  (none)       Of a focus: in place of the beam_quality, mm from the waist to
                                  where the radius has grown by sqrt(2)
    linewidth        0            Full width of its spectrum at half the height, nm: with the
                                  roughness it weakens the speckle of recorded frames
    roughness        0            Of the lit surface, for its speckle alone: Rq, or how deep light
                                  goes into paint or paper, um
    polarisations    1            2: the lit surface depolarises, so that two patterns add
    modes            1            Of the laser, incoherent to each other, whose patterns add
    ===============  ===========  ==============================================================
    """

    def __init__(self, props: mi.Properties) -> None:
        with naming("laser_line"):
            source = _laser_of(props)
        super().__init__(props, source)
        # Tables go to Dr.Jit's memory now: within a kernel that is being recorded none can.
        zeros = dr.zeros(mi.Float, 2)
        dr.eval(source.flux(zeros, zeros, zeros))


def _laser_of(props: mi.Properties) -> LaserLine:
    """The laser line that an element describes."""
    length, fan_deg = _length(props, "length"), float(props.get("fan", 0.0))
    if not 0.0 <= fan_deg < 170.0:
        raise InputError(
            f"'fan' is {fan_deg:g} degrees; give a full angle from 0 (telecentric) up to 170"
        )
    fan_per_mm = float(2.0 * np.tan(np.radians(fan_deg) / 2.0) / length)
    pose = pose_of(props, "'length', 'radius' and 'distance'")
    sheet = Sheet(pose, _length(props, "distance", 300.0), fan_per_mm)
    if fan_per_mm * sheet.distance_mm >= 1.0:
        raise InputError(
            f"a 'fan' of {fan_deg:g} degrees would start in front of the exit; make 'fan' or"
            " 'distance' smaller, or 'length' larger"
        )
    folders = tuple(folders_of_files())
    profile = profile_of(str(props.get("profile", "")), folders)
    measured_mm = profile.radius_mm if isinstance(profile, MeasuredProfile) else None
    radius = _length(props, "radius", measured_mm)
    if measured_mm and radius > length:
        raise InputError(
            f"the line is {length:g} mm long, and its profile's radius is {radius:.4g} mm; give the"
            " places of its table in mm, or 'radius' too"
        )
    return LaserLine(
        sheet,
        length_mm=length,
        radius_mm=radius,
        power_w=positive(props, "power", 1.0),
        dots_mm=_positions(str(props.get("dots", ""))),
        profile=profile,
        uniformity=uniformity_of(str(props.get("uniformity", "")), folders),
        focus=_focus(props, sheet.distance_mm, radius),
        coherence=Coherence(
            polarisations=props.get("polarisations", 1),
            linewidth_nm=props.get("linewidth", 0.0),
            roughness_um=props.get("roughness", 0.0),
            modes=props.get("modes", 1.0),
        ),
    )


def _focus(props: mi.Properties, distance_mm: float, radius_mm: float) -> Focus | None:
    """The focus that an element describes, if it has one."""
    waist_mm = _number(props, "waist_distance", "a positive number of mm", distance_mm)
    quality = _number(props, "beam_quality", "M^2, from 1 on, or leave it empty")
    rayleigh_mm = _number(props, "rayleigh_length", "a positive number of mm, or leave it empty")
    wavelength_nm = positive(props, "wavelength", 532.0)
    if quality and rayleigh_mm:
        raise InputError("has both 'beam_quality' and 'rayleigh_length'; give one")
    if quality:
        if quality < 1.0:
            raise InputError(f"'beam_quality' is {quality:g}; give M^2, a number from 1 on")
        return Focus.of_beam(waist_mm or distance_mm, radius_mm, wavelength_nm, quality)
    if rayleigh_mm:
        return Focus(waist_mm or distance_mm, rayleigh_mm)
    if waist_mm != distance_mm:
        raise InputError(
            "has a 'waist_distance' and no 'beam_quality', 1 of an ideal beam, and no"
            " 'rayleigh_length'; give one of them, as the focus depends on it"
        )
    return None


def _number(
    props: mi.Properties, name: str, advice: str, default: float | None = None
) -> float | None:
    """A number that may be left empty."""
    text = str(props.get(name, "")).strip()
    if not text:
        return default
    try:
        value = float(text)
    except ValueError:
        value = np.nan
    if not 0.0 < value <= _FARTHEST_MM:
        raise InputError(f"'{name}' is {text[:40]}; give {advice}")
    return value


def _length(props: mi.Properties, name: str, default: float | None = None) -> float:
    """A length in mm."""
    if default is None and name not in props:
        raise InputError(f"the property '{name}' is missing; give it in mm")
    value = positive(props, name, default)
    if value > _FARTHEST_MM:
        raise InputError(f"'{name}' is {value:g} mm; give at most {_FARTHEST_MM:g} mm")
    return value


def _positions(text: str) -> np.ndarray:
    try:
        places = np.array([float(word) for word in text.replace(",", " ").split()])
    except ValueError:
        places = np.array([np.nan])
    if not np.isfinite(places).all():
        raise InputError(
            f'\'dots\' must list positions in mm, such as "0, -1.25", not "{text[:80]}"'
        )
    if places.size > _MOST_DOTS:
        raise InputError(f"{places.size} 'dots'; give at most {_MOST_DOTS}")
    if np.abs(places).max(initial=0.0) > _FARTHEST_MM:
        raise InputError(f"'dots' lie beyond {_FARTHEST_MM:g} mm; give them in mm")
    return places


mi.register_emitter("laser_line", LaserLineEmitter)
