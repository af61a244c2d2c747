"""The `refractive` integrator: what a camera sees through air of varying refractive index."""

from collections.abc import Callable
from functools import cached_property
from pathlib import Path
from typing import Any

import numpy as np
from virtual_sensor_plugins.exposure import ONE_FRAME, Exposure, own_sampler
from virtual_sensor_plugins.glow import Glow
from virtual_sensor_plugins.laser_line import SourceEmitter, laser_of
from virtual_sensor_plugins.lit_pixels import (
    Account,
    LitPixels,
    Sight,
    centre_rays,
    find_lit_pixels,
    guess_from,
    rows,
)
from virtual_sensor_plugins.tabulated import Elsewhere, lit_pixels_and_tables, merged

from virtual_sensor.arrays import at_least
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.files import exists
from virtual_sensor.medium.description import MediumDescription
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.eikonal import LAST_PIECE_MM, March, Straight, bend
from virtual_sensor.optics.illumination import Illumination, LightStatus, illuminate
from virtual_sensor.optics.ray_maps import NoMapError
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.surfaces import SceneSurface
from virtual_sensor.optics.transports import Transport

_LONGEST_NAME = 100  # of a file, in a message that names several places
_MOST_STEPS = 40_000  # of a march: twice the default, for rays aslant through the field

# Samples in flight at once: enough to fill the cores, and progress is seen.
_LANES = {"marched": 1 << 17, "tabulated": 1 << 20, "elsewhere": 1 << 22}


class Refractive(mi.SamplingIntegrator):
    """Direct light only, along bent rays: from the laser to the surface, from there to the camera.

    ===============  ==========  ==================================================================
    Property         Default     Meaning
    ===============  ==========  ==================================================================
    field            (none)      NetCDF file of the air; without one, light runs straight
    time             ""          Flow time, s, in a field with a time axis; empty: its last
    widen            1           Factor by which the field is stretched along y; 1: none
    blur             0           Then: standard deviation of a Gaussian blur in y and z, mm; 0: none
    wavelength       532         Vacuum wavelength of the light, nm
    transport        "tabulated" From tables of the bent rays; "marched": each sample's rays are
                                 marched, its laser ray found by Newton; "first_order": so, but
                                 deflected as if it ran straight; "straight": no refraction
    tolerance        0.003       Largest error of the tables, px
    interpolation    "cubic"     Of the field: "cubic" or "linear"
    dimensions       3           Of the field; 2: its section x = 0, extruded along x
    step             2           Step of the march, mm
    method           "leapfrog"  "leapfrog", "sharma" or "rk4"
    precision        "single"    "single" or "double"
    ===============  ==========  ==================================================================

    Limits: no interreflection.  Light of emitters other than `laser_line` runs straight from the
    emitter to the surface, and bent from there to the camera.  The factor n^2 in the conservation
    of radiance, 5e-4 at most in hot air, is left out.  Where the laser is the only light, samples
    are spent on the pixels that it reaches and on no others.
    """

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        name = str(props.get("field", ""))
        try:
            self.air = MediumDescription(
                _beside_scene(name) if name else None,
                _instant(str(props.get("time", ""))),
                widen=float(props.get("widen", 1.0)),
                blur_mm=float(props.get("blur", 0.0)),
                wavelength_nm=float(props.get("wavelength", 532.0)),
                interpolation=str(props.get("interpolation", "cubic")),
                dimensions=int(props.get("dimensions", 3)),
            )
        except InputError as error:
            raise InputError(f"refractive: {error}") from None
        if "way" in props:
            raise InputError(
                "refractive: 'way' is called 'transport' now, and its \"exact\" is \"marched\";"
                ' put <string name="transport" value="..."/> in its place'
            )
        try:
            march = March(
                step_mm=float(props.get("step", 2.0)),
                method=str(props.get("method", "leapfrog")),
                precision=str(props.get("precision", "single")),
                max_steps=_MOST_STEPS,
            )
            name_of_transport = str(props.get("transport", "tabulated"))
            tolerance_px = float(props.get("tolerance", 0.003))
            self.transport = Transport(name_of_transport, march, tolerance_px)
        except InputError as error:
            raise InputError(f"refractive: {error}") from None
        self.glows = True

    @cached_property
    def field(self) -> IndexField | None:
        """The air: what was given, else what the scene's file says."""
        return self.air.read()

    def given(self, field: IndexField | None, transport: Transport, glows: bool) -> "Refractive":
        """An integrator for this air and transport; `glows`: whether what can glow does."""
        other = mi.load_dict({"type": "refractive"})
        other.field, other.transport, other.glows = field, transport, glows
        return other

    @property
    def _refracting(self) -> IndexField | None:
        """The air that bends light; an InputError if the march can't get through it."""
        if self.transport.name == "straight":
            return None
        try:
            self.transport.march.check(self.field)
        except InputError as error:
            raise InputError(f"refractive: {error} (step)") from None
        return self.field

    def look(self, scene: mi.Scene, ray: Any, guess: Any = None, active: Any = True) -> Sight:
        """Follow camera rays to the surface and find the laser's light there, by marching."""
        surface, march = SceneSurface(scene), self.transport.march
        line = Straight.through(ray.o, ray.d, march)
        field = self._refracting
        bent = bend(field, surface, line, march, active=active)
        hit = active & (bent.status == int(RayStatus.HIT))
        point, heading = bent.position(line), dr.normalize(bent.tangent(line))
        dr.eval(point, heading, hit)  # else what uses them would march again
        family = laser_of(scene).source.family
        light = illuminate(family, field, surface, point, march, guess=guess, active=hit)
        return Sight(point, heading, hit, light)

    def sample(
        self, scene: mi.Scene, sampler: mi.Sampler, ray: Any, medium: Any = None, active: Any = True
    ) -> tuple[Any, Any, list[Any]]:
        """Radiance along camera rays."""
        sight = self.look(scene, ray, active=active)
        return self.radiance(scene, sampler, sight), sight.hit, []

    def radiance(self, scene: mi.Scene, sampler: mi.Sampler, sight: Sight) -> Any:
        """Radiance in W/(mm^2 sr) that leaves the points seen towards the camera."""
        heading = mi.Vector3f(sight.heading)
        last = mi.RayDifferential3f(mi.Point3f(sight.point) - heading * LAST_PIECE_MM, heading)
        return self._shaded(scene, sampler, last, sight.hit, sight.light)[0]

    def _shaded(
        self, scene: mi.Scene, sampler: mi.Sampler, ray: Any, active: Any, light: Any
    ) -> tuple[Any, Any]:
        """Radiance against rays that run straight from here on, and which of them meet a surface.

        `light` is the laser's where they do; None: it does not get there.
        """
        si = scene.ray_intersect(ray, active)
        valid = active & si.is_valid()
        bsdf, context = si.bsdf(ray), mi.BSDFContext()
        si.wi = dr.select(valid, si.wi, -ray.d)  # what meets nothing sees the environment
        others = self._other_lights(scene)
        radiance = mi.Spectrum(0.0)
        if others:
            seen, shines = si.emitter(scene), mi.Bool(True)
            for emitter in self._cold(scene):
                shines &= seen != mi.EmitterPtr(emitter)
            radiance += seen.eval(si, shines)
        for emitter in [laser_of(scene), *others]:
            if isinstance(emitter, Glow):  # it is seen, and lights nothing else
                continue
            if isinstance(emitter, SourceEmitter):
                if light is None:
                    continue
                toward, lit = -mi.Vector3f(light.heading), valid
                weight = mi.Spectrum(self.irradiance(scene, light))
            else:
                ds, weight = emitter.sample_direction(si, sampler.next_2d(valid), valid)
                toward, lit = ds.d, valid & (ds.pdf > 0.0)
                lit &= ~scene.ray_test(si.spawn_ray_to(ds.p), lit)
            value = bsdf.eval(context, si, si.to_local(toward), lit) * weight
            radiance += dr.select(lit, value, 0.0)
        return radiance, valid

    def irradiance(self, scene: mi.Scene, light: Illumination) -> Any:
        """The laser's, square to its light, W/mm^2; nil where it does not arrive."""
        return laser_of(scene).irradiance(light.s, light.t, light.concentration)

    def glow(self, scene: mi.Scene) -> float:
        """Radiance of the scene's brightest glowing surface, W/(mm^2 sr); 0 if none glows."""
        lights = self._other_lights(scene)
        return max((e.radiance for e in lights if isinstance(e, Glow)), default=0.0)

    def _other_lights(self, scene: mi.Scene) -> list[Any]:
        """The emitters beside the laser that shine: a cold part does not glow."""
        dark = [laser_of(scene), *self._cold(scene)]
        return [e for e in scene.emitters() if e not in dark]

    def _cold(self, scene: mi.Scene) -> list[Glow]:
        """The surfaces that would glow, but are cold or have no emissivity."""
        glows = [e for e in scene.emitters() if isinstance(e, Glow)]
        return [e for e in glows if not (self.glows and e.radiance > 0.0)]

    def lit_pixels(self, scene: mi.Scene, sensor: mi.Sensor) -> LitPixels:
        """The pixels that the laser reaches, with the truth at their centres."""
        account = Account(self.transport.name)
        if self.transport.name in ("tabulated", "straight"):
            try:
                found = lit_pixels_and_tables(
                    scene,
                    sensor,
                    laser_of(scene),
                    self._refracting,
                    self.transport.march,
                    self.transport.tolerance_px,
                    account,
                )
            except NoMapError as why:
                account = Account("marched", str(why), march_px=account.march_px)
            else:
                if found:
                    return found
                dark = at_least(1, np.zeros(0, np.uint32))
                return LitPixels(dark, self.look(scene, centre_rays(sensor, dark)), account)
        return find_lit_pixels(
            scene, sensor, laser_of(scene), lambda ray: self.look(scene, ray), account
        )

    def render(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor | int = 0,
        seed: int = 0,
        spp: int = 0,
        develop: bool = True,
        evaluate: bool = True,
        lit: LitPixels | None = None,
        progress: Callable[[float], None] | None = None,
    ) -> Any:
        """Mitsuba's `render`; a frame at a time, whatever the thread.

        `lit` spares looking for the lit pixels if they are known, and keeps account; `progress` is
        told the fraction done.
        """
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        sampler = own_sampler(sensor, spp)
        with ONE_FRAME:
            lit = lit or self.lit_pixels(scene, sensor)
            film = sensor.film()
            film.prepare([])
            film.put_block(self._exposed(scene, sensor, sampler, seed, lit, progress))
            if not develop:
                return None
            image = film.develop()
            dr.eval(image)
            return image

    def _exposed(
        self,
        scene: mi.Scene,
        sensor: mi.Sensor,
        sampler: mi.Sampler,
        seed: int,
        lit: LitPixels,
        progress: Callable[[float], None] | None,
    ) -> Any:
        """The block of a frame's samples."""
        width, height = (int(n) for n in sensor.film().crop_size())
        laser_alone = not self._other_lights(scene)
        count = lit.index.size if laser_alone else width * height
        exposure = Exposure(sensor, sampler, seed, count, progress)
        every = np.arange(width * height, dtype=np.uint32)

        def by_marching(ray: Any, row: Any, pixel: Any) -> tuple[Any, Any]:
            sight = self.look(scene, ray)
            return self.radiance(scene, sampler, sight), sight.hit

        def by_guess(ray: Any, row: Any, pixel: Any) -> tuple[Any, Any]:
            centre = rows(lit.sight.light, row)
            sight = self.look(scene, ray, guess_from(centre))
            # A guess from a dark centre beside a step leads astray; a folded one stays dark.
            folded = centre.status == int(LightStatus.FOLDED)
            sure = dr.isfinite(centre.s) & (sight.light.status == int(LightStatus.LIT))
            doubtful = sight.hit & ~sure & ~folded
            dr.eval(sight, doubtful)
            sight = self._marched_again(scene, ray, sight, doubtful)
            return dr.select(folded, 0.0, self.radiance(scene, sampler, sight)), sight.hit

        def by_tables(ray: Any, row: Any, pixel: Any) -> tuple[Any, Any]:
            sight = self._tabulated(scene, ray, lit)
            return self.radiance(scene, sampler, sight), sight.hit

        if lit.tables is not None:
            exposure.add(lit.index, by_tables, _LANES["tabulated"])
        elif laser_alone:
            exposure.add(lit.index, by_guess, _LANES["marched"])
        else:
            exposure.add(every, by_marching, _LANES["marched"])
        if lit.tables is not None and not laser_alone:
            rest = np.delete(every, lit.index)
            try:
                bent = Elsewhere(scene, sensor, self._refracting, self.transport.march).bent
            except NoMapError as why:
                lit.account.reason = f"pixels without laser light were marched: {why}"
                exposure.add(rest, by_marching, _LANES["marched"])
            else:

                def by_tangents(ray: Any, row: Any, pixel: Any) -> tuple[Any, Any]:
                    return self._shaded(scene, sampler, bent(ray, pixel), True, None)

                exposure.add(rest, by_tangents, _LANES["elsewhere"])
        return exposure.block

    def _tabulated(self, scene: mi.Scene, ray: Any, lit: LitPixels) -> Sight:
        """What rays see by the tables; those of which these can't tell are marched, and counted."""
        sight, doubtful = lit.tables.look(ray)
        lit.account.samples += dr.width(doubtful)
        lit.account.marched += int(dr.count(doubtful)[0])
        return self._marched_again(scene, ray, sight, doubtful)

    def _marched_again(self, scene: mi.Scene, ray: Any, sight: Sight, doubtful: Any) -> Sight:
        """The sight with its doubtful rows marched, without a guess."""
        if not dr.any(doubtful):
            return sight
        which = dr.compress(doubtful)
        return merged(sight, which, self.look(scene, rows(ray, which)))

    def to_string(self) -> str:
        """Its own values, for Mitsuba's scene listing."""
        return f"Refractive[{self.transport.march}, field={self.air.path}]"


def _instant(text: str) -> float | None:
    """A flow time in s; None of an empty text."""
    try:
        return float(text) if text else None
    except ValueError:
        raise InputError(
            f"refractive: 'time' must be a flow time in s, or empty for the last, not \"{text}\""
        ) from None


def _beside_scene(name: str) -> Path:
    """A file's path where the scene says so: in its folder, its <path>s, or where one stands."""
    resolver = mi.file_resolver()
    found = Path(str(resolver.resolve(name)))
    if exists(found) or found.is_absolute():
        return found.absolute()
    mitsubas = Path(mi.__file__).parent
    folders = [folder for each in resolver if (folder := Path(str(each)).absolute()) != mitsubas]
    shown = name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..."
    places = list(dict.fromkeys(folder / shown for folder in folders))
    beside = [place.parent for place in places if exists(place.parent)]
    present = sorted({file.name for folder in beside for file in folder.glob("*.nc")})
    others = "".join(f"; nor is there {place}" for place in places[1:])
    raise InputError(
        f"refractive: 'field': {places[0]}: there is no such file{others}; there"
        f" {'are ' + ', '.join(present) if present else 'is no .nc file'}"
    )


mi.register_integrator("refractive", Refractive)
