"""The `refractive` integrator: what a camera sees through air of varying refractive index."""

from functools import cached_property
from typing import Any

import numpy as np
from virtual_sensor_plugins.exposure import ONE_FRAME
from virtual_sensor_plugins.interreflection import INDIRECT_SAMPLES
from virtual_sensor_plugins.properties import folders_of_files, optional
from virtual_sensor_plugins.renderer import DIRECT, Arrangement, Prepared, devices_of, steady
from virtual_sensor_plugins.views import camera_of

from virtual_sensor.arrays import whole_number
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError, naming
from virtual_sensor.medium.description import MediumDescription
from virtual_sensor.medium.find_field import find_field
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.rays import March
from virtual_sensor.optics.transports import Transport
from virtual_sensor.poses import Pose, keeps_lengths

_MOST_DEPTH = 32
_MOST_SAMPLES = 4096
_MOST_STEPS = 40_000  # of a march: twice the default, for rays aslant through the field


class Refractive(mi.SamplingIntegrator):
    """Light along bent rays: from the laser to the surface, from there to the camera.

    With a `max_depth` above 2 the sources' light is reflected between surfaces too.

    ================  ==========  ==================================================================
    Property          Default     Meaning
    ================  ==========  ==================================================================
    field             (none)      NetCDF file of the air, or the name of a field that comes with the
                                  program; without one, light runs straight
    time              ""          Flow time, s, in a field with a time axis; empty: its last
    widen             1           Factor by which the field is stretched along y; 1: none
    blur              0           Then: standard deviation of a Gaussian blur in y and z, mm; 0:
                                  none
    pressure          ""          Of the air, Pa, which n - 1 goes with; empty: as the field has it
    wavelength        532         Vacuum wavelength of the light, nm
    transport         "tabulated" From tables of the bent rays; "marched": each sample's rays are
                                  marched, its laser ray found by Newton; "first_order": so, but
                                  deflected as if it ran straight; "straight": no refraction
    tolerance         0.003       Largest error of the tables, px
    interpolation     "cubic"     Of the field: "cubic" or "linear"
    dimensions        3           Of the field; 2: its section x = 0, extruded along x
    to_world          (none)      Rotations and translations of the field, such as its part's
    step              2           Step of the march, mm
    method            "leapfrog"  "leapfrog", "sharma" or "rk4"
    precision         "single"    "single" or "double"
    max_depth         2           Segments of light's path: 2 is direct light; 3 has one reflection
                                  between surfaces, 4 two
    indirect_samples  8           Points of the lit stripe for each sample of indirect light
    ================  ==========  ==================================================================

    Limits: reflected light runs straight from surface to surface, and that of lamps and glow is not
    reflected again.  Light of emitters other than `laser_line` runs straight from the
    emitter to the surface, and bent from there to the camera.  The factor n^2 in the conservation
    of radiance, 5e-4 at most in hot air, is left out.  Where the laser is the only light, samples
    are spent on the pixels that it reaches and on no others.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        if "way" in props:
            raise InputError(
                "refractive: 'way' is called 'transport' now, and its \"exact\" is \"marched\";"
                ' put <string name="transport" value="..."/> in its place'
            )
        name = str(props.get("field", ""))
        with naming("refractive"):
            self.air = MediumDescription(
                find_field(name, folders_of_files()).absolute() if name else None,
                optional(props, "time", "a flow time in s, or empty for the last"),
                widen=float(props.get("widen", 1.0)),
                blur_mm=float(props.get("blur", 0.0)),
                pressure_pa=optional(props, "pressure", "of air in Pa, or empty for the field's"),
                wavelength_nm=float(props.get("wavelength", 532.0)),
                interpolation=str(props.get("interpolation", "cubic")),
                dimensions=int(props.get("dimensions", 3)),
                pose=_pose(props),
            )
            march = March(
                step_mm=float(props.get("step", 2.0)),
                method=str(props.get("method", "leapfrog")),
                precision=str(props.get("precision", "single")),
                max_steps=_MOST_STEPS,
            )
            name_of_transport = str(props.get("transport", "tabulated"))
            tolerance_px = float(props.get("tolerance", 0.003))
            self.transport = Transport(name_of_transport, march, tolerance_px)
            self.max_depth = _max_depth(int(props.get("max_depth", DIRECT)))
            self.indirect_samples = int(props.get("indirect_samples", INDIRECT_SAMPLES))
            whole_number("'indirect_samples'", self.indirect_samples, 1, _MOST_SAMPLES)

    @cached_property
    def medium(self) -> IndexField | None:
        """The air, as the scene's file says."""
        return self.air.read()

    def arrangement(self, scene: mi.Scene, sensor: mi.Sensor) -> Arrangement:
        """What a frame of a scene is made of, from Mitsuba's scene alone."""
        medium, transport = self.medium, self.transport
        with naming("refractive"):
            transport.check(medium)
        camera, sources = camera_of(sensor), devices_of(scene)
        return Arrangement(
            scene,
            sensor,
            camera,
            sources,
            medium,
            transport,
            max_depth=self.max_depth,
            indirect_samples=self.indirect_samples,
        )

    def sample(
        self, scene: mi.Scene, sampler: mi.Sampler, ray: Any, medium: Any = None, active: Any = True
    ) -> tuple[Any, Any, list[Any]]:
        """Radiance along camera rays, by marching."""
        arrangement = self.arrangement(scene, scene.sensors()[0])
        sight, _ = arrangement.marched.sight(ray)
        fluxes = [steady(device) for device in arrangement.sources.values()]
        radiance, *_ = arrangement.radiances(sight, fluxes, arrangement.draws(sampler))
        return radiance, active & sight.hit, []

    def render(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
    ) -> Any:
        """Mitsuba's `render`; a frame at a time, whatever the thread."""
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        with ONE_FRAME:
            prepared = Prepared.of(self.arrangement(scene, sensor))
            exposure, _ = prepared.exposed(spp, seed, on_film=True)
            if prepared.bounces:
                exposure.brighten(prepared.bounced_light(seed))
            return exposure.developed(develop=develop)

    def to_string(self) -> str:
        """Its own values, for Mitsuba's scene listing."""
        return f"Refractive[{self.transport.march}, field={self.air.path}]"


def _max_depth(depth: int) -> int:
    """How many segments light's path has at most."""
    if depth == 1:
        raise InputError("'max_depth' is 1, by which surfaces are dark; give 2 for direct light")
    if depth < 0:
        raise InputError(
            f"'max_depth' is {depth}, light of any number of reflections, which can't be rendered"
            f" here; give 2 for direct light, 3 for one reflection between, up to {_MOST_DEPTH}"
        )
    return whole_number("'max_depth'", depth, DIRECT, _MOST_DEPTH)


def _pose(props: mi.Properties) -> Pose | None:
    """Where the field is moved; None if it stays where its file has it."""
    if "to_world" not in props:
        return None
    matrix = np.asarray(props["to_world"].matrix, float).reshape(4, 4)
    if np.array_equal(matrix, np.eye(4)):
        return None
    if not keeps_lengths(matrix[:3, :3]) or np.linalg.det(matrix) < 0.0:
        raise InputError(
            "'to_world' does more than turn and move, which air can't; give rotations and"
            " translations alone"
        )
    return Pose.from_matrix(matrix)


mi.register_integrator("refractive", Refractive)
