"""A frame: from a scene with its air, camera, sources and transport to radiance."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from types import MappingProxyType
from typing import Any

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins import glow
from virtual_sensor_plugins.drift import Drift, Widened
from virtual_sensor_plugins.exposure import Exposure, own_sampler, shared_sampler
from virtual_sensor_plugins.interreflection import (
    INDIRECT_SAMPLES,
    MOMENTS,
    TILE_PX,
    Beam,
    Reflected,
    Stripe,
    tiles_of,
)
from virtual_sensor_plugins.lit_pixels import (
    FIRST_MARGIN_MM,
    Columns,
    LitPixels,
    RenderReport,
    find_lit_pixels,
    units_per_mm,
)
from virtual_sensor_plugins.pupil import Pupil
from virtual_sensor_plugins.views import StraightSight, View
from virtual_sensor_plugins.whole_film import WholeFilm

from virtual_sensor.arrays import in_own_memory
from virtual_sensor.devices.camera import LensCamera
from virtual_sensor.devices.device import Device
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import Field
from virtual_sensor.optics.illumination import Illumination
from virtual_sensor.optics.lens import PupilPoint
from virtual_sensor.optics.ray_families import Pinhole
from virtual_sensor.optics.ray_maps import NoMapError
from virtual_sensor.optics.sources import Source
from virtual_sensor.optics.surfaces import SceneSurface, own_variant, slab
from virtual_sensor.optics.transports import Marched, Sight, Transport

# Samples in flight at once: enough to fill the cores, and progress is seen.
_LANES = {"marched": 1 << 17, "tabulated": 1 << 20, "whole film": 1 << 23, "reflected": 1 << 18}
_INDIRECT_SPP = 4  # samples of a pixel for its indirect light

DIRECT = 2
"""The `max_depth` of direct light: a segment to the surface, and one to the camera."""

Fluxes = Callable[[Any, Any, Any], Sequence[Any]]
"""From a source's (s, t) and depth to its flux in each frame; one alone is that of all."""

_FAR_MM = 20.0  # Mitsuba's float32 hits from nearer are good to 0.03 um
_NEAR_MM = 1.0
_ASIDE_MM = 1e-3


def devices_of(scene: mi.Scene) -> dict[str, Device]:
    """The devices of a scene's emitters that are such, by their names."""
    return {emitter.id(): emitter.source for emitter in scene.emitters() if is_source(emitter)}


def steady(device: Device) -> Fluxes:
    """The flux of a device that is the same in each frame."""
    return lambda s, t, depth: [device.flux(s, t, depth)]


def is_source(emitter: mi.Emitter) -> bool:
    """Whether an emitter's light is followed along bent rays: it is a plugin over a device."""
    return hasattr(emitter, "source")


@dataclass(frozen=True, eq=False)
class Arrangement:
    """What a frame is made of.

    Attributes
    ----------
    scene : mitsuba.Scene
        Its shapes, and its emitters that are no sources.
    sensor : mitsuba.Sensor
        Its film and sampler.
    camera : Pinhole or None
        The sensor's rays; None: they are Mitsuba's.
    sources : Mapping
        Devices by name.  Others of the scene do not shine.
    medium : Field or None
        None: light runs straight.
    transport : Transport
    hot : bool
        Whether surfaces glow, those that can.
    drift_mm : float
        How far camera and sources may be on their way from there while the film is exposed.
    max_depth : int
        Of light's path, in segments: 2 is direct light, 3 has one reflection between.
    indirect_samples : int
        Points of the lit stripe for each sample of a pixel's indirect light.
    """

    scene: mi.Scene
    sensor: mi.Sensor
    camera: Pinhole | None
    sources: Mapping[str, Device]
    medium: Field | None
    transport: Transport
    hot: bool = True
    drift_mm: float = 0.0
    max_depth: int = DIRECT
    indirect_samples: int = INDIRECT_SAMPLES

    def __post_init__(self) -> None:
        own_variant(self.scene)

    @cached_property
    def view(self) -> View:
        """The camera's rays through its film."""
        return View(self.sensor, self.camera)

    @cached_property
    def pupil(self) -> tuple[PupilPoint, ...]:
        """The points of the camera's lens that a frame is rendered through; none of a pinhole."""
        camera = self.camera
        if not isinstance(camera, LensCamera) or not camera.blurs:
            return ()
        assert camera.lens is not None
        places = camera.lens.pupil(camera.sub_pupils)
        return tuple(PupilPoint.of(camera, camera.lens, at) for at in places)

    @cached_property
    def surface(self) -> SceneSurface:
        """What rays meet."""
        return SceneSurface(self.scene)

    @cached_property
    def straight(self) -> StraightSight:
        """What the camera would see if light ran straight."""
        return StraightSight(self.view, self.surface)

    @cached_property
    def lamps(self) -> list[mi.Emitter]:
        """The emitters beside the sources that shine: a cold part does not glow."""
        cold = self.cold
        return [e for e in self.scene.emitters() if not is_source(e) and e not in cold]

    @cached_property
    def cold(self) -> list[mi.Emitter]:
        """The surfaces that would glow, but are cold or have no emissivity."""
        glows = [e for e in self.scene.emitters() if isinstance(e, glow.Glow)]
        return [e for e in glows if not (self.hot and e.radiance > 0.0)]

    @property
    def glow(self) -> float:
        """Radiance of the brightest glowing surface, W/(mm^2 sr); 0 if none glows."""
        return max((e.radiance for e in self.lamps if isinstance(e, glow.Glow)), default=0.0)

    @property
    def refracting(self) -> Field | None:
        """The air that bends light."""
        return None if self.transport.name == "straight" else self.medium

    @property
    def searched(self) -> Mapping[str, Source]:
        """The sources, with room for the drift."""
        if not self.drift_mm:
            return self.sources
        drifting = {}
        for name, source in self.sources.items():
            per_mm = units_per_mm(source, self.surface)
            drifting[name] = Widened.of(source, self.drift_mm, per_mm)
        return drifting

    @property
    def marched(self) -> Marched:
        """All sources' light by marching."""
        march = self.transport.march
        return Marched(self.refracting, self.surface, tuple(self.sources.values()), march)

    # ---------------------------------------------------------------- radiance

    def draws(self, sampler: mi.Sampler) -> list[Any]:
        """What the lamps' samples need of chance."""
        return [sampler.next_2d() for e in self.lamps if not isinstance(e, glow.Glow)]

    def radiances(self, sight: Sight, fluxes: Sequence[Fluxes], draws: list[Any]) -> list[Any]:
        """Radiance in W/(mm^2 sr) that leaves what is seen towards the camera, in each frame.

        Parameters
        ----------
        sight : Sight
        fluxes : sequence of Fluxes
            Of the sources, in the order of its lights.
        draws : list
        """
        si, direction, valid = sight.met(self.scene)
        lights = list(zip(fluxes, sight.lights, strict=True))
        return self._shaded(si, direction, valid, lights, draws)

    def radiance_along(self, ray: Any, draws: list[Any]) -> tuple[list[Any], Any]:
        """The lamps' radiance against straight rays, and which of these meet a surface."""
        si = self.met_along(ray)
        valid = si.is_valid()
        return self._shaded(si, ray.d, valid, [], draws), valid

    def met_along(self, ray: Any) -> Any:
        """What straight rays meet.

        From afar, Mitsuba's float32 puts hits inside a cylinder, where no lamp shines: those rays
        start again close to what they meet.  So does the ray in some millions that slips through
        the seam of two triangles, and meets the next face from behind, a micrometre aside.
        """
        low, high = (dr.opaque(mi.Point3f(corner)) for corner in self.surface.corners)
        enters, _ = slab(ray.o, ray.d, (low, high))
        start = dr.maximum(enters - _NEAR_MM, 0.0)
        near = mi.Ray3f(ray(start), ray.d)
        si = self.scene.ray_intersect(near)
        again = si.is_valid() & ((si.t > _FAR_MM) | _from_behind(si, near))
        return dr.if_stmt((near, si), again, self.met_closer, lambda near, si: si)

    def met_closer(self, ray: Any, si: Any) -> Any:
        """What rays meet that start again close to it; from aside, if they met it from behind."""
        aside = dr.select(_from_behind(si, ray), _ASIDE_MM, 0.0) * mi.Frame3f(ray.d).s
        again = mi.Ray3f(ray.o + aside, ray.d)
        met = self.scene.ray_intersect_preliminary(again)
        ahead = dr.select(met.is_valid(), dr.maximum(met.t - _NEAR_MM, 0.0), 0.0)
        return self.scene.ray_intersect(mi.Ray3f(again(ahead), ray.d))

    def _shaded(
        self,
        si: Any,
        direction: Any,
        valid: Any,
        lights: list[tuple[Fluxes, Illumination]],
        draws: list[Any],
    ) -> list[Any]:
        bsdf, context = si.bsdf(), mi.BSDFContext()
        si.wi = dr.select(valid, si.wi, -direction)  # what meets nothing sees the environment
        radiance = mi.Spectrum(0.0)
        flags = mi.EmitterFlags.Surface, mi.EmitterFlags.Infinite
        if any(mi.has_flag(e.flags(), flag) for e in self.lamps for flag in flags):
            seen, shines = si.emitter(self.scene), mi.Bool(True)
            for emitter in self.cold:
                shines &= seen != mi.EmitterPtr(emitter)
            radiance += seen.eval(si, shines)
        radiances = [radiance]
        for fluxes, light in lights:
            value = bsdf.eval(context, si, si.to_local(-mi.Vector3f(light.heading)), valid)
            shed = []
            for flux in fluxes(light.s, light.t, light.depth):
                irradiance = mi.Spectrum(mi.Float(flux * light.concentration))
                shed.append(dr.select(valid, value * irradiance, 0.0))
            radiances = _summed(radiances, shed)
        lamps = [e for e in self.lamps if not isinstance(e, glow.Glow)]  # a glow lights nothing
        for emitter, draw in zip(lamps, draws, strict=True):
            ds, weight = emitter.sample_direction(si, draw, valid)
            lit = valid & (ds.pdf > 0.0)
            value = bsdf.eval(context, si, si.to_local(ds.d), lit) * weight
            lit &= dr.any(value != 0.0)  # else a shadow makes no difference
            lit &= ~self.scene.ray_test(si.spawn_ray_to(ds.p), lit)
            radiances = _summed(radiances, [dr.select(lit, value, 0.0)])
        return radiances


def _summed(one: list[Any], other: list[Any]) -> list[Any]:
    """Radiances of each frame; one alone is that of all."""
    frames = max(len(one), len(other))
    one, other = (each * frames if len(each) == 1 else each for each in (one, other))
    return [a + b for a, b in zip(one, other, strict=True)]


def _from_behind(si: Any, ray: Any) -> Any:
    return dr.dot(si.n, ray.d) > 0.0


@dataclass(frozen=True, eq=False)
class Prepared:
    """What frames of an arrangement need, whatever their samples.

    Attributes
    ----------
    arrangement : Arrangement
    lit : LitPixels
        As the chief rays see them: the truth of a frame.
    pupil : Pupil or None
        What a lens sees; None: the chief rays alone.
    """

    arrangement: Arrangement
    lit: LitPixels
    pupil: Pupil | None = None

    @staticmethod
    def of(arrangement: Arrangement, column: Columns | None = None) -> "Prepared":
        """Find the lit pixels, all or those of some columns, and what traces their samples."""
        light = arrangement.medium, arrangement.searched, arrangement.transport
        given = *light, column, arrangement.drift_mm
        lit, points = find_lit_pixels(arrangement.straight, *given), arrangement.pupil
        if not points:
            return Prepared(arrangement, lit)
        return Prepared(arrangement, lit, Pupil.of(arrangement.straight, points, lit, *given))

    def seen(self, drift: Drift | None = None) -> tuple[NDArray[np.uint32], Sight | None]:
        """Pixels that may be lit, and what is seen at their centres; None if there are none.

        With a drift: those of its rows, from where the camera is then.
        """
        lit, view = self.lit, self.arrangement.view
        if drift is None:
            return lit.index, lit.sight
        row = view.row_of(lit.index)
        index = lit.index[(row >= drift.rows.start) & (row < drift.rows.stop)]
        if not index.size:
            return index, None
        at = in_own_memory(view.row_of(index), mi.Float)
        sight, _ = lit.tracer.sight(drift.ray(view.centres(index), at))
        of_names = tuple(self.arrangement.sources[name] for name in lit.names)
        return index, replace(sight, lights=drift.lights(sight.lights, of_names, sight.point, at))

    @cached_property
    def film(self) -> tuple[WholeFilm | None, str]:
        """For the lamps' light in pixels that no source lights; else why these are marched."""
        return self._film_of(self.arrangement.straight, self.lit)

    def _film_of(self, straight: StraightSight, lit: LitPixels) -> tuple[WholeFilm | None, str]:
        arrangement = self.arrangement
        if isinstance(lit.tracer, Marched) and lit.names:
            return None, ""
        try:
            march, field = arrangement.transport.march, arrangement.refracting
            return WholeFilm.of(straight, field, march), ""
        except NoMapError as why:
            return None, f"pixels without light of a source were marched: {why}"

    def exposed(
        self,
        spp: int,
        seed: int,
        progress: Callable[[float], None] | None = None,
        others: bool = True,
        on_film: bool = False,
        frames: int = 1,
        fluxes: Mapping[str, Fluxes] = MappingProxyType({}),
        drift: Drift | None = None,
    ) -> tuple[Exposure, RenderReport]:
        """Samples of frames, and how they were made.

        Through a lens, the samples of a pixel are shared by the points of its pupil; each has one
        at least.

        Parameters
        ----------
        spp : int
            Samples per pixel; 0: as many as the scene's sampler has.
        seed : int
        progress : callable, optional
            Called with the fraction done.
        others : bool
            Whether pixels that no source lights are exposed too, if there are lamps.
        on_film : bool
            Whether the image is to be on the sensor's film.
        frames : int
            How many are made of the same rays.
        fluxes : Mapping
            By name, of the sources that differ from frame to frame.
        drift : Drift, optional
            Where camera and sources are meanwhile, no farther off than the arrangement's, and which
            rows are exposed; others stay dark.
        """
        arrangement, lit = self.arrangement, self.lit
        view, sampler = arrangement.view, own_sampler(arrangement.sensor, spp)
        others = others and bool(arrangement.lamps)
        if self.pupil is not None:
            through = tuple(each.lit.index.size for each in self.pupil.points)
            pixels = sum(through) + (len(through) * view.pixels if others else 0)
            sampler = shared_sampler(sampler, len(through))
            kind = on_film, frames, len(through)
            exposure = Exposure(view, sampler, seed, pixels, progress, *kind, drift)
            return exposure, self._expose_pupil(exposure, others, fluxes)
        pixels = lit.index.size + (view.pixels if others else 0)
        exposure = Exposure(view, sampler, seed, pixels, progress, on_film, frames, drift=drift)
        report = lit.report
        if others:
            film, why = self.film
            dark = None if exposure.overwrites else _without(lit.index, view.pixels)
            self._expose_others(exposure, dark, film)
            report = replace(report, reason=why or report.reason)
        samples, marched = self._expose_lit(exposure, lit, fluxes)
        return exposure, replace(report, samples=samples, marched_samples=marched)

    @property
    def bounces(self) -> int:
        """Reflections in between that frames have at most."""
        return self.arrangement.max_depth - DIRECT

    def bounced_light(self, seed: int, of_lit: bool = False) -> NDArray[np.float32]:
        """The radiance (H, W) of the sources' light that is reflected in between.

        With `of_lit` in pixels alone that sources light.
        """
        by_source = self.indirect(seed, of_lit=of_lit).values()
        light: NDArray[np.float32] = np.sum([each[:, 0].sum(axis=0) for each in by_source], axis=0)
        return light

    def indirect(
        self,
        seed: int,
        progress: Callable[[float], None] | None = None,
        moments: bool = False,
        of_lit: bool = False,
    ) -> dict[str, NDArray[np.float32]]:
        """Light of the sources by reflections between surfaces, apart from direct light.

        Its pixels have samples of their own, few of them: it changes less from place to place.
        With `of_lit` those alone have it that are lit.

        Returns
        -------
        dict of ndarray of shape (B, 1, H, W)
            By the sources' names: radiance by one reflection between, by two, ...  With `moments`
            (B, 5, H, W): radiance, and radiance times s, t, s^2 and t^2 of the rays that make it.
        """
        arrangement = self.arrangement
        view, names = arrangement.view, tuple(arrangement.sources)
        bounces, numbers = self.bounces, MOMENTS if moments else 1
        shape = bounces, len(names), numbers, view.height, view.width
        if bounces < 1 or not names:
            return {name: np.zeros((bounces, *shape[2:]), np.float32) for name in names}
        beams = tuple(self._beam(name) for name in names)
        march = arrangement.transport.march
        stripe = Stripe(arrangement.scene, beams, arrangement.refracting, march, seed, bounces)
        reflected = Reflected(stripe, arrangement.indirect_samples, moments)
        # Independent: other samplers' numbers, taken one by one, are not so of each other.
        sampler = mi.load_dict({"type": "independent", "sample_count": _INDIRECT_SPP})
        points = self.pupil.points if self.pupil is not None else ()
        sights = [(each.straight, each.lit) for each in points]
        sights = sights or [(arrangement.straight, self.lit)]
        passes = len(sights)
        if passes > 1:
            sampler.set_sample_count(1)
        exposure = Exposure(
            view, sampler, seed, passes * view.pixels, progress, False, reflected.layers, passes
        )
        for number, (straight, lit) in enumerate(sights):
            place = {"through": straight.view} if points else {}
            pixels = lit.index if of_lit else None
            self._expose_reflected(exposure, reflected, straight, lit, pixels, number, **place)
        images = exposure.images().reshape(shape)
        return {name: images[:, i] for i, name in enumerate(names)}

    def _beam(self, name: str) -> Beam:
        """A source's light, as what reflects it needs it."""
        arrangement, lit = self.arrangement, self.lit
        source, march = arrangement.sources[name], arrangement.transport.march
        marched = Marched(arrangement.refracting, arrangement.surface, (source,), march)
        if name not in lit.names:
            margin = FIRST_MARGIN_MM * units_per_mm(source, arrangement.surface)
            return Beam(name, source, marched, margin)
        tracer, at = lit.tracer, lit.names.index(name)
        if isinstance(tracer, Marched):
            return Beam(name, source, marched, lit.margins[name])
        one = replace(tracer, maps=(tracer.maps[at],), pads=(tracer.pads[at],), marched=marched)
        return Beam(name, source, one, lit.margins[name])

    def _expose_reflected(
        self,
        exposure: Exposure,
        reflected: Reflected,
        straight: StraightSight,
        lit: LitPixels,
        pixels: NDArray[np.uint32] | None,
        stream: int,
        **place: Any,
    ) -> None:
        """Expose pixels, or all, to the sources' reflected light."""
        arrangement, view = self.arrangement, straight.view
        film, _ = self._film_of(straight, lit)
        marched = replace(arrangement.marched, sources=())

        def met(ray: Any, pixel: Any) -> tuple[Any, Any]:
            if film is not None:
                si = arrangement.met_along(film.bent(ray, pixel))
                return si, si.is_valid()
            si, _, valid = marched.hits(ray).met(arrangement.scene)
            return si, valid

        tiles, probes = tiles_of(view.width, view.height)
        seen, valid = met(view.centres(probes), in_own_memory(probes, mi.UInt32))
        dr.eval(seen, valid)
        choices = reflected.choices(seen, valid, tiles, exposure.sampler.clone())
        across, width = (dr.opaque(mi.UInt32, n) for n in (tiles[1], view.width))

        def by_reflections(ray: Any, row: Any, pixel: Any) -> tuple[list[Any], Any]:
            si, valid = met(ray, pixel)
            tile = pixel // width // TILE_PX * across + pixel % width // TILE_PX
            return reflected.radiances(si, valid, choices, tile, exposure.sampler), valid

        exposure.add(pixels, by_reflections, _LANES["reflected"], stream, **place)

    def _expose_pupil(
        self, exposure: Exposure, others: bool, fluxes: Mapping[str, Fluxes]
    ) -> RenderReport:
        """Expose the pixels through each point of the pupil, and say how."""
        assert self.pupil is not None
        samples, marched, why = 0, 0, ""
        view, between = self.arrangement.view, exposure.sampler.sample_count() ** -0.5
        for number, each in enumerate(self.pupil.points):
            u, v = (float(between * shift) for shift in each.shift)
            place: dict[str, Any] = {"through": each.view, "shift": (u, v)}
            if others:
                film, why = self._film_of(each.straight, each.lit)
                dark = _without(each.lit.index, view.pixels)
                self._expose_others(exposure, dark, film, 2 * number + 1, **place)
            elif exposure.on_film:
                dark = np.setdiff1d(self.pupil.lit, each.lit.index)
                exposure.add(dark, _unlit, _LANES["tabulated"], **place)
            spent = self._expose_lit(exposure, each.lit, fluxes, 2 * number, **place)
            samples, marched = samples + spent[0], marched + spent[1]
        report = self.pupil.report(self.lit.report)
        report = replace(report, reason=why or report.reason)
        return replace(report, samples=samples, marched_samples=marched)

    def _expose_lit(
        self,
        exposure: Exposure,
        lit: LitPixels,
        fluxes: Mapping[str, Fluxes],
        stream: int = 0,
        **place: Any,
    ) -> tuple[int, int]:
        """Expose pixels that are lit, by samples of which so many are searched and marched."""
        arrangement, samples, marched = self.arrangement, 0, 0
        of_lights = [fluxes.get(name, steady(arrangement.sources[name])) for name in lit.names]
        marches = isinstance(lit.tracer, Marched)

        def by_tracer(ray: Any, row: Any, pixel: Any) -> tuple[list[Any], Any]:
            nonlocal samples, marched
            draws = arrangement.draws(exposure.sampler)
            near = dr.gather(Sight, lit.sight, row) if marches and lit.sight else None
            sight, count = lit.tracer.sight(ray, near)
            samples, marched = samples + dr.width(row), marched + count
            if (drift := exposure.drift) is not None:
                of_names = tuple(arrangement.sources[name] for name in lit.names)
                at = arrangement.view.row_of(pixel)
                sight.lights = drift.lights(sight.lights, of_names, sight.point, at)
            return arrangement.radiances(sight, of_lights, draws), sight.hit

        lanes = _LANES["marched" if marches else "tabulated"]
        exposure.add(lit.index, by_tracer, lanes, stream, **place)
        return samples, marched

    def _expose_others(
        self,
        exposure: Exposure,
        pixels: NDArray[np.uint32] | None,
        film: WholeFilm | None,
        stream: int = 1,
        **place: Any,
    ) -> None:
        """Expose pixels, or all, to the light of the lamps alone."""
        arrangement = self.arrangement
        marched = replace(arrangement.marched, sources=())

        def by_tangents(ray: Any, row: Any, pixel: Any) -> tuple[list[Any], Any]:
            assert film is not None
            draws = arrangement.draws(exposure.sampler)
            return arrangement.radiance_along(film.bent(ray, pixel), draws)

        def by_marching(ray: Any, row: Any, pixel: Any) -> tuple[list[Any], Any]:
            draws = arrangement.draws(exposure.sampler)
            sight = marched.hits(ray)
            return arrangement.radiances(sight, [], draws), sight.hit

        if film is None:
            exposure.add(pixels, by_marching, _LANES["marched"], stream, **place)
        else:
            exposure.add(pixels, by_tangents, _LANES["whole film"], stream, **place)


def _unlit(ray: Any, row: Any, pixel: Any) -> tuple[list[Any], Any]:
    """Of pixels without light."""
    return [dr.zeros(mi.Spectrum, dr.width(row))], dr.zeros(mi.Bool, dr.width(row))


def _without(lit: NDArray[np.uint32], pixels: int) -> NDArray[np.uint32]:
    """All pixels but those that are lit."""
    dark = np.ones(pixels, bool)
    dark[lit] = False
    return np.flatnonzero(dark).astype(np.uint32)
