"""The `refractive` integrator: what a camera sees through air of varying refractive index."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

from virtual_sensor_plugins.laser_line import LaserLineEmitter
from virtual_sensor_plugins.lit_pixels import (
    LitPixels,
    Sight,
    film_place,
    film_rays,
    find_lit_pixels,
    rows,
)

from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError
from virtual_sensor.medium.broadening import blurred, widened
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.eikonal import LAST_PIECE_MM, March, Straight, bend
from virtual_sensor.optics.illumination import Illumination, illuminate
from virtual_sensor.optics.ray_status import RayStatus
from virtual_sensor.optics.surfaces import SceneSurface

_LANES = 1 << 17  # samples in flight at once: enough to fill the cores, and progress is seen


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
    way              "exact"     Each sample's rays are marched, its laser ray found by Newton
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
        time_s = _instant(str(props.get("time", "")))
        self.widen = float(props.get("widen", 1.0))
        self.blur_mm = float(props.get("blur", 0.0))
        self.wavelength_nm = float(props.get("wavelength", 532.0))
        way = str(props.get("way", "exact"))
        if way != "exact":
            raise InputError(f'refractive: \'way\' must be "exact", not "{way}"')
        try:
            self.march = March(
                step_mm=float(props.get("step", 2.0)),
                method=str(props.get("method", "leapfrog")),
                precision=str(props.get("precision", "single")),
            )
        except InputError as error:
            raise InputError(f"refractive: {error}") from None
        if time_s is not None and not name:
            raise InputError("refractive: 'time' is one of a field's; give the 'field', or no time")
        if not name and (self.widen, self.blur_mm) != (1.0, 0.0):
            raise InputError(
                "refractive: 'widen' and 'blur' are of a field; give the 'field', or neither"
            )
        self.field_file = _beside_scene(name) if name else None
        self.field = self._air(self.field_file, time_s) if self.field_file else None

    def _air(self, file: Path, time_s: float | None) -> IndexField:
        air = IndexField.read(file, wavelength_nm=self.wavelength_nm, time_s=time_s)
        try:
            return blurred(widened(air, self.widen), self.blur_mm)
        except InputError as error:
            raise InputError(f"refractive: {error}") from None

    def at(self, time_s: float) -> "Refractive":
        """The same integrator in the air of another instant of its field's file, as broad."""
        if self.field_file is None:
            raise InputError("refractive: there is no 'field' to have instants; give it one")
        other = self.with_field(self._air(self.field_file, time_s))
        other.field_file, other.widen, other.blur_mm = self.field_file, self.widen, self.blur_mm
        return other

    def with_field(self, field: IndexField | None) -> "Refractive":
        """The same integrator in other air, taken as it is; None: light runs straight."""
        march = self.march
        choices = {"step": march.step_mm, "method": march.method, "precision": march.precision}
        other = mi.load_dict({"type": "refractive", "wavelength": self.wavelength_nm, **choices})
        other.field = field
        return other

    def look(self, scene: mi.Scene, ray: Any, guess: Any = None, active: Any = True) -> Sight:
        """Follow camera rays to the surface and find the laser's light there."""
        surface = SceneSurface(scene)
        line = Straight.through(ray.o, ray.d, self.march)
        bent = bend(self.field, surface, line, self.march, active=active)
        hit = active & (bent.status == int(RayStatus.HIT))
        point, heading = bent.position(line), dr.normalize(bent.tangent(line))
        dr.eval(point, heading, hit)  # else what uses them would march again
        line_laser = laser_of(scene).line
        light = illuminate(
            line_laser, self.field, surface, point, self.march, guess=guess, active=hit
        )
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
        si = scene.ray_intersect(last, sight.hit)
        valid = sight.hit & si.is_valid()
        bsdf, context = si.bsdf(last), mi.BSDFContext()
        si.wi = dr.select(valid, si.wi, -heading)  # what meets nothing sees the environment
        radiance = si.emitter(scene).eval(si)
        for emitter in scene.emitters():
            if isinstance(emitter, LaserLineEmitter):
                light = sight.light
                toward, lit = -mi.Vector3f(light.heading), valid
                weight = mi.Spectrum(emitter.irradiance(light.a, light.b, light.concentration))
            else:
                ds, weight = emitter.sample_direction(si, sampler.next_2d(valid), valid)
                toward, lit = ds.d, valid & (ds.pdf > 0.0)
                lit &= ~scene.ray_test(si.spawn_ray_to(ds.p), lit)
            value = bsdf.eval(context, si, si.to_local(toward), lit) * weight
            radiance += dr.select(lit, value, 0.0)
        return radiance

    def lit_pixels(self, scene: mi.Scene, sensor: mi.Sensor) -> LitPixels:
        """The pixels that the laser reaches, with the truth at their centres."""
        return find_lit_pixels(scene, sensor, laser_of(scene), lambda ray: self.look(scene, ray))

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
        """Mitsuba's `render`.

        `lit` spares looking for the lit pixels if they are known; `progress` is told the fraction
        done.
        """
        if isinstance(sensor, int):
            sensor = scene.sensors()[sensor]
        film, sampler = sensor.film(), sensor.sampler()
        if spp:
            sampler.set_sample_count(spp)
        spp = sampler.sample_count()
        film.prepare([])
        block = film.create_block()
        lit = lit or self.lit_pixels(scene, sensor)
        width, height = (int(n) for n in film.crop_size())
        laser_alone = all(isinstance(e, LaserLineEmitter) for e in scene.emitters())
        count = lit.index.size if laser_alone else width * height
        dr.eval(numbers := mi.UInt32(lit.index) + dr.opaque(mi.UInt32, 0))
        # Each pixel's samples are summed in their order: added to the film one by one, as other
        # filters and spectra need it, the last bits would depend on which thread comes first.
        own_pixel = film.rfilter().is_box_filter() and not mi.is_spectral
        chunk = max(1, _LANES // spp)
        for number, first in enumerate(range(0, count, chunk)):
            # What changes from chunk to chunk is opaque, so that one kernel serves them all.
            index = dr.repeat(dr.arange(mi.UInt32, min(chunk, count - first)), spp)
            index += dr.opaque(mi.UInt32, first)
            guess = None
            if laser_alone:
                guess = _guess(rows(lit.sight.light, index))
                index = dr.gather(mi.UInt32, numbers, index)
            sampler.set_samples_per_wavefront(spp)
            shuffled = seed + number * 0x9E3779B9 & 0xFFFFFFFF
            sampler.seed(dr.opaque(mi.UInt32, shuffled), dr.width(index))
            place = film_place(film, index, sampler.next_2d())
            aperture = sampler.next_2d() if sensor.needs_aperture_sample() else mi.Point2f(0.5)
            ray, weight = film_rays(sensor, place, aperture)
            sight = self.look(scene, ray, guess)
            value = self.radiance(scene, sampler, sight) * weight
            alpha = dr.select(sight.hit, mi.Float(1.0), 0.0)
            if own_pixel:
                value, alpha = (dr.block_sum(v, spp) / spp for v in (value, alpha))
                pixel = dr.gather(mi.UInt32, index, dr.arange(mi.UInt32, dr.width(alpha)) * spp)
                place = film_place(film, pixel, mi.Point2f(0.5))
            block.put(place, ray.wavelengths, value, alpha)
            dr.eval(block.tensor())
            if progress:
                dr.sync_thread()
                progress(min(1.0, (first + chunk) / count))
        film.put_block(block)
        return film.develop() if develop else None

    def to_string(self) -> str:
        """Its own values, for Mitsuba's scene listing."""
        return f"Refractive[{self.march}, field={self.field_file}]"


def laser_of(scene: mi.Scene) -> LaserLineEmitter:
    """The scene's only laser line generator."""
    found = [e for e in scene.emitters() if isinstance(e, LaserLineEmitter)]
    if len(found) != 1:
        raise InputError(
            f'{len(found)} emitters of type "laser_line"; a scene for the refractive integrator has'
            " exactly one"
        )
    return found[0]


def _instant(text: str) -> float | None:
    """A flow time in s; None of an empty text."""
    try:
        return float(text) if text else None
    except ValueError:
        raise InputError(
            f"refractive: 'time' must be a flow time in s, or empty for the last, not \"{text}\""
        ) from None


def _beside_scene(name: str) -> Path:
    """A file's path where the scene says so, or in the scene's own folder."""
    resolver = mi.file_resolver()
    found = Path(str(resolver.resolve(name)))
    return (found if found.is_file() else Path(str(resolver[0])) / name).absolute()


def _guess(light: Illumination) -> tuple[Any, Any, tuple[Any, Any, Any, Any]]:
    """What is known near samples, from the light at their pixels' centres; straight if nothing."""
    sound = dr.isfinite(light.a)
    identity = (1.0, 0.0, 0.0, 1.0)
    jacobian = (dr.select(sound, j, i) for j, i in zip(light.jacobian, identity, strict=True))
    return *(dr.select(sound, shift, 0.0) for shift in light.shift), tuple(jacobian)


mi.register_integrator("refractive", Refractive)
