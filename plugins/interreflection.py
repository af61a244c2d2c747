"""Light that is reflected between surfaces before the camera sees it: ghosts of a laser line.

A camera path seldom meets a stripe of laser light by chance.  So the *lit stripe* is sampled: rays
of each source, drawn by their flux, are followed through the air to the points that they light, and
what a camera ray sees is connected to some of these by straight segments (next event estimation;
Veach, Robust Monte Carlo Methods for Light Transport Simulation, 1997).  Which ones is chosen by
what their unshadowed light would make in a tile of the image (importance resampling of Talbot,
Cline and Egbert, 2005, for the shadow ray).  Light that a ray drawn by the surface's reflection
meets in the stripe is weighed against that by the balance heuristic: in a corner, where connections
are short, it takes over.
"""

from collections.abc import Iterator
from dataclasses import dataclass, fields, is_dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import GOLDEN, in_own_memory
from virtual_sensor.devices.device import Device
from virtual_sensor.engine import dr, mi
from virtual_sensor.optics.eikonal import Field
from virtual_sensor.optics.family_frames import FamilyFrame
from virtual_sensor.optics.rays import March
from virtual_sensor.optics.surfaces import SceneSurface
from virtual_sensor.optics.transports import Marched, Tracer, opaque

Array = NDArray[np.float64]

INDIRECT_SAMPLES = 8
"""Points of the lit stripe for each sample of a pixel's indirect light, by default."""

TILE_PX = 8
"""Side of a tile of the image whose pixels choose among the stripe's bins alike."""

MOMENTS = 5
"""Radiance, and radiance times s, t, s^2 and t^2 of the source's rays that make it."""

_BINS, _IN_BIN = 64, 128  # of a source's light along t; lit points in each
_ACROSS, _ALONG = 32, 4096  # cells of a table of flux: the fewest and the most of a coordinate
_EVEN = 0.1  # of the light is drawn as if it were even: the table sees only some places
_CHOSEN_EVENLY = 0.2  # of the bins
_PROBES = 2  # camera rays of a tile that show which bins light it
_LANES = 1 << 20
_THREE = np.ones((3, 3), np.uint8)
_LEAST = 1e-30
_SEED = 0x57121
_STEPS = 0.8191725133961645, 0.6710436067037893, 0.5497004779019703  # of a lattice in 3D


@dataclass(frozen=True, eq=False)
class FluxTable:
    """How a source's light is spread over its coordinates: constant in each cell of a table.

    Attributes
    ----------
    low, cell : ndarray of shape (2,)
        Lowest (s, t), and a cell's size.
    density : ndarray of shape (T, S)
        Per unit of both coordinates, of the integral 1.
    """

    low: Array
    cell: Array
    density: Array

    @staticmethod
    def of(source: Device, depth_mm: float) -> "FluxTable":
        """By the source's flux at a depth."""
        low, high = (np.asarray(end, float) for end in source.extent)
        size = high - low
        shape = np.clip(_ACROSS * size / size.min(), _ACROSS, _ALONG).astype(int)
        cell = size / shape
        # Twice along each coordinate: a dot may lie on a border.
        s, t = (np.arange(2 * count) + 0.5 for count in shape)
        s = low[0] + np.tile(s * cell[0] / 2.0, t.size).reshape(t.size, -1)
        t = low[1] + np.repeat(t * cell[1] / 2.0, s.shape[1]).reshape(s.shape)
        flux = np.asarray(source.flux(s.ravel(), t.ravel(), np.full(s.size, depth_mm)), float)
        flux = flux.reshape(shape[1], 2, shape[0], 2).mean(axis=(1, 3))
        mass = flux.sum()
        even = np.full_like(flux, 1.0 / flux.size)
        share = (1.0 - _EVEN) * flux / mass + _EVEN * even if mass > 0.0 else even
        return FluxTable(low, cell, share / cell.prod())

    def rays(self, count: int, shift: Array) -> tuple[Array, Array, Array]:
        """(s, t) of `count` rays in the order of t, drawn by the light, and the density there.

        Even shares of the light along t, golden sections of it across: a lattice, moved by `shift`.
        """
        number = np.arange(count)
        u = (number + shift[0]) / count
        v = (number * GOLDEN + shift[1]) % 1.0
        row, within_t = _drawn(self._share_along, u)
        share = np.cumsum(self.density[row], axis=1)
        share /= share[:, -1:]
        column = (share <= v[:, None]).sum(axis=1)
        column = np.minimum(column, share.shape[1] - 1)
        here = np.take_along_axis(share, column[:, None], 1)[:, 0]
        before = np.where(column, np.take_along_axis(share, column[:, None] - 1, 1)[:, 0], 0.0)
        within_s = (v - before) / (here - before)
        s = self.low[0] + (column + within_s) * self.cell[0]
        t = self.low[1] + (row + within_t) * self.cell[1]
        return s, t, self.density[row, column]

    @property
    def _share_along(self) -> Array:
        """Of the light, up to the end of each row of cells."""
        along = np.cumsum(self.density.sum(axis=1))
        return np.asarray(along / along[-1])


def _drawn(share: Array, u: Array) -> tuple[NDArray[np.intp], Array]:
    """Cells of a running share that hold u, and where in them."""
    cell = np.minimum(np.searchsorted(share, u, side="right"), share.size - 1)
    before = np.where(cell, share[cell - 1], 0.0)
    return cell, (u - before) / (share[cell] - before)


class _Table:
    """A `FluxTable` for Dr.Jit."""

    def __init__(self, table: FluxTable) -> None:
        self._low, self._per_unit = opaque(table.low), opaque(1.0 / table.cell)
        rows, columns = table.density.shape
        self._size = dr.opaque(mi.UInt32, columns), dr.opaque(mi.UInt32, rows)
        self._density = in_own_memory(table.density.ravel(), mi.Float)
        along = np.append(0.0, table._share_along)
        self._share = in_own_memory(along, mi.Float)

    def at(self, s: Any, t: Any) -> tuple[Any, Any]:
        """Density per unit of both coordinates, and the bin along t."""
        parts = zip((s, t), self._low, self._per_unit, strict=True)
        places = [(x - low) * per_unit for x, low, per_unit in parts]
        last = [mi.Float(n) - 1.0 for n in self._size]
        column, row = (
            mi.UInt32(dr.clip(dr.floor(x), 0.0, end)) for x, end in zip(places, last, strict=True)
        )
        density = dr.gather(mi.Float, self._density, row * self._size[0] + column)
        share = dr.gather(mi.Float, self._share, row)
        share = dr.lerp(share, dr.gather(mi.Float, self._share, row + 1), places[1] - row)
        return density, mi.UInt32(dr.clip(share * _BINS, 0.0, _BINS - 1.0))


@dataclass(frozen=True, eq=False)
class Beam:
    """A source, as far as its reflected light needs it.

    Attributes
    ----------
    name : str
    source : Device
    tracer : Tracer
        Of this source alone.
    margin : ndarray of shape (2,)
        By how much refraction may move its light, in its coordinates: what lies farther from it is
        not asked for light.
    """

    name: str
    source: Device
    tracer: Tracer
    margin: Array


@dataclass(frozen=True, eq=False)
class Points:
    """Points of surfaces that sources light, directly or by reflections; in the order of bins.

    Attributes
    ----------
    si : SurfaceInteraction3f
        Its `wi` is where the light comes from.
    s, t : scalar
        Of the source's rays.
    power : spectrum
        Of the light on one point, over the cosine that irradiance has there.
    density : scalar
        How densely points are drawn there, if all bins were drawn alike: points per mm^2 of the
        stripe, or of a surface that is lit from the point before; 0 where no ray of a camera's can
        find the same light.
    """

    si: Any
    s: Any
    t: Any
    power: Any
    density: Any


class Stripe:
    """Points that sources light, bin by bin of the light along t, and source by source.

    Parameters
    ----------
    scene : mitsuba.Scene
    beams : sequence of Beam
    medium : Field or None
    march : March
    seed : int
    bounces : int
        How many generations of points are found: those that sources light, those that are lit from
        these, ...
    """

    def __init__(
        self,
        scene: mi.Scene,
        beams: tuple[Beam, ...],
        medium: Field | None,
        march: March,
        seed: int,
        bounces: int = 1,
    ) -> None:
        self.scene, self.beams = scene, beams
        self.bins = _BINS * len(beams)
        random = np.random.default_rng([seed, _SEED])
        surface = SceneSurface(scene)
        middle = np.asarray(surface.corners, float).reshape(2, 3).mean(axis=0)
        self._tables, parts = [], []
        for beam in beams:
            depth = float(beam.source.family.coordinates(middle[None])[0, 2])
            table = FluxTable.of(beam.source, depth)
            self._tables.append(_Table(table))
            marched = Marched(medium, surface, (beam.source,), march)
            rays = table.rays(_BINS * _IN_BIN, random.random(2))
            parts.append(self._lit(beam, marched, rays, self._tables[-1]))
        self.generations = [parts[0] if len(parts) == 1 else _joined(parts)]
        for _ in range(1, bounces):
            self.generations.append(self._lit_from(self.generations[-1], random))

    def _lit(self, beam: Beam, marched: Marched, rays: tuple[Array, ...], table: _Table) -> Points:
        """The points that rays of a source light."""
        source, frame = beam.source, FamilyFrame.of(beam.source.family, mi.Array3f)
        s, t, drawn = (in_own_memory(each, mi.Float) for each in rays)
        origin, direction, _ = frame.rays(s, t)
        sight = marched.hits(mi.Ray3f(mi.Point3f(origin), mi.Vector3f(direction)))
        si, heading, met = sight.met(self.scene)
        si.wi = si.to_local(-heading)
        lean = dr.abs(dr.dot(si.n, heading))
        lit = met & (lean > 0.0)
        depth = frame.local(mi.Array3f(si.p))[2]
        power = mi.Spectrum(dr.select(lit, source.flux(s, t, depth) / (drawn * lean), 0.0))
        light = beam.tracer.lights(mi.Array3f(si.p), lit)[0]
        concentration = mi.Float(light.concentration)
        found = lit & self._near(beam, frame, si.p) & (concentration > 0.0)
        density = dr.select(found, table.at(s, t)[0] * concentration * lean * _BINS, 0.0)
        points = Points(si, s, t, power, density)
        dr.eval(points)
        return points

    def _lit_from(self, points: Points, random: np.random.Generator) -> Points:
        """The points that light of others meets, by a ray drawn by the reflection of each."""
        si, number = points.si, np.arange(dr.width(points.s))
        chance = random.random(3)
        one, *two = (
            in_own_memory((number * step + first) % 1.0, mi.Float)
            for step, first in zip(_STEPS, chance, strict=True)
        )
        lit = dr.any(points.power != 0.0)
        context = mi.BSDFContext(mi.TransportMode.Importance)
        sample, weight = si.bsdf().sample(context, si, one, mi.Point2f(*two), lit)
        heading = si.to_world(sample.wo)
        lit &= dr.any(weight != 0.0)
        met = self.scene.ray_intersect(si.spawn_ray(heading), lit)
        lit &= met.is_valid()
        lean = dr.abs(dr.dot(met.n, heading))
        lit &= lean > 0.0
        arrives = dr.abs(dr.dot(si.n, -si.to_world(si.wi)))  # of the light before
        power = points.power * weight * (arrives / lean)
        met.wi = dr.select(lit, met.to_local(-heading), mi.Vector3f(0.0, 0.0, 1.0))
        delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        density = dr.select(delta, dr.inf, sample.pdf * lean / dr.square(met.t))
        reflected = Points(met, points.s, points.t, dr.select(lit, power, 0.0), density)
        dr.eval(reflected)
        return reflected

    def _near(self, beam: Beam, frame: FamilyFrame, point: Any) -> Any:
        """Whether points may be lit, by the straight ray through them."""
        s, t, depth = frame.coordinates(mi.Array3f(point))
        ahead = depth > 0.0
        return ahead & beam.source.reaches(s, t, opaque(beam.margin), depth)

    def lights(self, met: Any, active: Any) -> Iterator["Caught"]:
        """The sources' light on what rays meet, source by source; of the rays that may be lit."""
        for number, (beam, table) in enumerate(zip(self.beams, self._tables, strict=True)):
            frame = FamilyFrame.of(beam.source.family, mi.Array3f)
            near = active & self._near(beam, frame, met.p)
            dr.eval(near)
            which = dr.compress(near)
            if not dr.width(which):
                continue
            si = dr.gather(mi.SurfaceInteraction3f, met, which)
            light = beam.tracer.lights(mi.Array3f(si.p), dr.full(mi.Mask, True, dr.width(which)))[0]
            heading, concentration = mi.Vector3f(light.heading), mi.Float(light.concentration)
            flux = beam.source.flux(mi.Float(light.s), mi.Float(light.t), mi.Float(light.depth))
            lit = (concentration > 0.0) & (flux > 0.0)
            s, t = (dr.select(lit, mi.Float(each), 0.0) for each in (light.s, light.t))
            density, place = table.at(s, t)
            yield Caught(
                number,
                which,
                si,
                heading,
                (s, t),
                dr.select(lit, flux * concentration, 0.0),
                density * concentration * dr.abs(dr.dot(si.n, heading)) * _BINS,
                place + number * _BINS,
            )


@dataclass(frozen=True, eq=False)
class Caught:
    """Light of a source on what rays have met by chance.

    Attributes
    ----------
    number : int
        The source's.
    which : UInt32
        The rays.
    si : SurfaceInteraction3f
    heading : vector
        Of the light.
    coordinates : tuple of two scalars
        s and t of the source's rays.
    irradiance : scalar
        Square to the light, W/mm^2.
    density : scalar
        As that of `Points`.
    place : UInt32
        The bin.
    """

    number: int
    which: Any
    si: Any
    heading: Any
    coordinates: tuple[Any, Any]
    irradiance: Any
    density: Any
    place: Any


def _joined(trees: list[Any]) -> Any:
    """Dr.Jit's arrays of several sources, one after the other."""
    if is_dataclass(trees[0]):
        names = [field.name for field in fields(trees[0])]
        parts = (_joined([getattr(tree, name) for tree in trees]) for name in names)
        return Points(*parts)
    widths = [dr.width(tree) for tree in trees]
    whole, first = dr.zeros(type(trees[0]), sum(widths)), 0
    for tree, count in zip(trees, widths, strict=True):
        dr.scatter(whole, tree, dr.arange(mi.UInt32, count) + first)
        first += count
    dr.eval(whole)
    return whole


class Choice:
    """How likely bins are drawn, by rows; the last row's are all alike.

    Parameters
    ----------
    probability : ndarray of shape (R, bins)
    """

    def __init__(self, probability: NDArray[np.floating]) -> None:
        bins = probability.shape[1]
        probability = np.append(probability, np.full((1, bins), 1.0 / bins), axis=0)
        share = np.cumsum(probability, axis=1, dtype=float)
        share[:, -1] = 2.0
        self.bins, self.even = bins, dr.opaque(mi.UInt32, len(probability) - 1)
        self.share, self.probability = (
            in_own_memory(each.astype(np.float32).ravel(), mi.Float)
            for each in (share, probability)
        )

    def drawn(self, row: Any, u: Any) -> tuple[Any, Any]:
        """The bin that holds u in a row, and how likely it is."""
        first, found = row * self.bins, mi.UInt32(0)
        step = 1 << (self.bins - 1).bit_length() >> 1
        while step:
            last = found + (step - 1)
            inside = last < self.bins
            beyond = dr.gather(mi.Float, self.share, first + last, inside) <= u
            found = dr.select(inside & beyond, found + step, found)
            step >>= 1
        return found, dr.gather(mi.Float, self.probability, first + found)

    def of_bin(self, row: Any, number: Any) -> Any:
        """How likely a bin is."""
        return dr.gather(mi.Float, self.probability, row * self.bins + number)


@dataclass(frozen=True, eq=False)
class _Joint:
    """A surface that light of points is connected to.

    Attributes
    ----------
    si : SurfaceInteraction3f
    bsdf : BSDFPtr
    active : mask
    choice : Choice
    row : UInt32
        Of the choice.
    rival : Choice or None
        Of the points of the next generation, in the stead of what is met here by chance; None: of
        those that are seen.
    tile : UInt32
        Its row.
    found : scalar
        How densely this surface is met by chance, per mm^2 of it.
    """

    si: Any
    bsdf: Any
    active: Any
    choice: Choice
    row: Any
    rival: Choice | None = None
    tile: Any = None
    found: Any = None


class Reflected:
    """Light that reaches points by reflections.

    Light by b reflections is found in two ways, each of which is good where the other is not:
    what is seen is connected to points of the generation b - 1; or a ray drawn by its reflection
    meets a surface, and this is connected to points of the generation b - 2, or lit by the source.

    Parameters
    ----------
    stripe : Stripe
    samples : int
        Points for each connection.
    moments : bool
        Whether which rays make the light is found too.
    """

    def __init__(self, stripe: Stripe, samples: int, moments: bool) -> None:
        self.stripe, self.moments = stripe, moments
        self.bounces = len(stripe.generations)
        self._count = dr.opaque(mi.UInt32, samples)
        self._alike = Choice(np.zeros((0, stripe.bins)))

    @property
    def layers(self) -> int:
        """Numbers for each sample: (bounces, sources, 1 or `MOMENTS`), the last fastest."""
        return self.bounces * len(self.stripe.beams) * (MOMENTS if self.moments else 1)

    def radiances(
        self, si: Any, active: Any, choices: list[Choice], row: Any, sampler: mi.Sampler
    ) -> list[Any]:
        """Layers of the radiance that leaves what is seen.

        Parameters
        ----------
        si : SurfaceInteraction3f
        active : mask
        choices : list of Choice
            For each generation of points.
        row : UInt32
            Of the choices.
        sampler : mi.Sampler
        """
        layers = [mi.Spectrum(0.0) for _ in range(self.layers)]
        context, bsdf = mi.BSDFContext(), si.bsdf()
        for bounce, choice in enumerate(choices):
            joint = _Joint(si, bsdf, active, choice, row)
            self._connect(layers, bounce, bounce, joint, mi.Spectrum(1.0), sampler)
        sample, weight = bsdf.sample(context, si, sampler.next_1d(), sampler.next_2d(), active)
        go = active & dr.any(weight != 0.0)
        met = self.stripe.scene.ray_intersect(si.spawn_ray(si.to_world(sample.wo)), go)
        go &= met.is_valid()
        met.wi = dr.select(go, met.wi, mi.Vector3f(0.0, 0.0, 1.0))
        through = dr.select(go, weight, 0.0)
        delta = mi.has_flag(sample.sampled_type, mi.BSDFFlags.Delta)
        lean = dr.abs(dr.dot(met.n, met.to_world(met.wi)))
        found = dr.select(delta, dr.inf, sample.pdf * lean / dr.square(met.t))
        for bounce in range(1, self.bounces):
            even = dr.full(mi.UInt32, 0, dr.width(go)) + self._alike.even
            rival = choices[bounce], row, found
            joint = _Joint(met, met.bsdf(), go, self._alike, even, *rival)
            self._connect(layers, bounce, bounce - 1, joint, through, sampler)
        dr.eval(layers, met, go, through, found, row)
        self._catch(layers, met, go, through, found, choices[0], row)
        return layers

    def _connect(
        self,
        layers: list[Any],
        bounce: int,
        generation: int,
        joint: _Joint,
        through: Any,
        sampler: mi.Sampler,
    ) -> None:
        """Add light of points of a generation."""
        points = self.stripe.generations[generation]
        bins, within, among = (sampler.next_1d() for _ in range(3))
        # A pixel's samples share out the bins.
        own = dr.arange(mi.UInt32, dr.width(joint.si)) % sampler.sample_count()
        bins = (mi.Float(own) + bins) / sampler.sample_count()
        value, index = self.connected(points, generation, joint, bins, within, among)
        s, t = (dr.gather(mi.Float, each, index) for each in (points.s, points.t))
        self._put(layers, bounce, index // (_BINS * _IN_BIN), through * value, s, t)

    def _catch(
        self,
        layers: list[Any],
        met: Any,
        active: Any,
        through: Any,
        found: Any,
        choice: Choice,
        row: Any,
    ) -> None:
        """Add the sources' light that rays have met by chance."""
        context, count = mi.BSDFContext(), dr.width(met)
        for light in self.stripe.lights(met, active):
            si, which = light.si, light.which
            value = si.bsdf().eval(context, si, si.to_local(-light.heading))
            value *= light.irradiance * dr.gather(mi.Spectrum, through, which)
            drawn = mi.Float(self._count) * light.density
            drawn *= choice.of_bin(dr.gather(mi.UInt32, row, which), light.place)
            own = dr.gather(mi.Float, found, which)
            value *= dr.select(dr.isfinite(own), own / (own + drawn), 1.0)
            all_of = [dr.zeros(kind, count) for kind in (mi.Spectrum, mi.Float, mi.Float)]
            for whole, part in zip(all_of, (value, *light.coordinates), strict=True):
                dr.scatter(whole, part, which)
            self._put(layers, 0, mi.UInt32(light.number), *all_of)

    def _put(self, layers: list[Any], bounce: int, number: Any, value: Any, s: Any, t: Any) -> None:
        """Add light of sources to the layers."""
        size = MOMENTS if self.moments else 1
        for source in range(len(self.stripe.beams)):
            own = value
            if len(self.stripe.beams) > 1:
                own = dr.select(number == source, value, 0.0)
            first = (bounce * len(self.stripe.beams) + source) * size
            for i, times in zip(range(size), (1.0, s, t, s * s, t * t), strict=False):
                layers[first + i] = layers[first + i] + own * times

    def connected(
        self, points: Points, generation: int, joint: _Joint, bins: Any, within: Any, among: Any
    ) -> tuple[Any, Any]:
        """Light by one of some points of a generation, drawn by what each makes unshadowed.

        What is left to chance, each from 0 to 1: where the points lie among the bins, and within
        them, and which of them is drawn.  Returns the radiance that leaves the joint, and the
        point's number.
        """

        def another(j: Any, among: Any, total: Any, score: Any, value: Any, index: Any) -> Any:
            u = (mi.Float(j) + bins) / mi.Float(self._count)
            v = within + mi.Float(j) * GOLDEN
            k, made = self._one(points, generation, joint, u, v)
            grey = dr.mean(made, axis=0)
            total = total + grey
            part = dr.select(grey > 0.0, grey / total, 0.0)
            taken = among < part
            among = dr.select(taken, among / part, (among - part) / (1.0 - part))
            return (
                j + 1,
                among,
                total,
                dr.select(taken, grey, score),
                dr.select(taken, made, value),
                dr.select(taken, k, index),
            )

        start = mi.UInt32(0), among, mi.Float(0.0), mi.Float(0.0), mi.Spectrum(0.0), mi.UInt32(0)
        _, _, total, score, value, index = dr.while_loop(
            start, lambda j, *_: j < self._count, another
        )
        lit = joint.active & (total > 0.0)
        place = dr.gather(mi.Point3f, points.si.p, index)
        lit &= ~self.stripe.scene.ray_test(joint.si.spawn_ray_to(place), lit)
        value = dr.select(lit, value * (total / score), 0.0)
        return value / mi.Float(self._count), index

    def _one(
        self, points: Points, generation: int, joint: _Joint, u: Any, v: Any
    ) -> tuple[Any, Any]:
        """One of the points, and the unshadowed light that it makes over its chance."""
        si, context = joint.si, mi.BSDFContext()
        place, chance = joint.choice.drawn(joint.row, u)
        within = mi.UInt32(dr.minimum((v - dr.floor(v)) * _IN_BIN, _IN_BIN - 1.0))
        k = place * _IN_BIN + within
        lit = dr.gather(mi.SurfaceInteraction3f, points.si, k)
        power = dr.gather(mi.Spectrum, points.power, k)
        away = lit.p - si.p
        square = dr.squared_norm(away)
        go = joint.active & dr.any(power != 0.0) & (square > 0.0)
        heading = away * dr.rsqrt(square)
        value, pdf = joint.bsdf.eval_pdf(context, si, si.to_local(heading), go)
        go &= dr.any(value != 0.0)
        source = mi.Vector3f(lit.wi)  # a copy: it is to be another
        lit.wi = lit.to_local(-heading)
        lean = dr.abs(dr.dot(lit.n, heading))
        count = mi.Float(self._count)
        value *= lit.bsdf().eval(context, lit, source, go)
        if joint.rival is None:
            density = dr.gather(mi.Float, points.density, k)
            drawn = count * chance * density * square
            other = pdf * lean
            if generation:  # by as many points of this generation's sources
                other *= count / self.stripe.bins
            sure = ~(dr.isfinite(density) & (density > 0.0))
        else:
            lit.wi = source
            back = lit.bsdf().pdf(context, lit, lit.to_local(-heading), go)
            drawn = count * chance * joint.found * square
            other = count * joint.rival.of_bin(joint.tile, place) * back
            other *= dr.abs(dr.dot(si.n, heading))
            sure = ~dr.isfinite(joint.found)
        weight = dr.select(sure, 1.0, drawn / dr.maximum(drawn + other, _LEAST))
        value *= weight * power * lean / (square * chance * _BINS)
        return k, dr.select(go, value, 0.0)

    def choices(
        self, seen: Any, active: Any, tiles: tuple[int, int], sampler: mi.Sampler
    ) -> list[Choice]:
        """Which bins light tiles of the image, by what some rays of each see (`tiles_of`)."""
        return [
            self._choice(self._by_bins(number, seen, active, sampler), tiles)
            for number in range(self.bounces)
        ]

    def _choice(self, light: NDArray[np.float32], tiles: tuple[int, int]) -> Choice:
        """By the light of each bin, (rays, bins)."""
        light = light.reshape(tiles[0] * tiles[1], _PROBES, -1).max(axis=1)
        # What a tile's other pixels see is like what the next ones' rays see.
        beside = np.stack([cv2.dilate(each.reshape(tiles), _THREE).ravel() for each in light.T], 1)
        beside = cv2.dilate(beside.reshape(-1, _BINS), _THREE[:1]).reshape(light.shape)
        total = beside.sum(axis=1, keepdims=True)
        even = 1.0 / self.stripe.bins
        share = np.divide(beside, total, out=np.full_like(beside, even), where=total > 0.0)
        return Choice((1.0 - _CHOSEN_EVENLY) * share + _CHOSEN_EVENLY * even)

    def _by_bins(
        self, generation: int, seen: Any, active: Any, sampler: mi.Sampler
    ) -> NDArray[np.float32]:
        """Unshadowed light by one point of each bin, (rays, bins)."""
        bins, rays, alike = self.stripe.bins, dr.width(active), self._alike
        light = np.zeros((rays, bins), np.float32)
        chunk, points = max(1, _LANES // bins), self.stripe.generations[generation]
        for first in range(0, rays, chunk):
            count = min(chunk, rays - first)
            lane = dr.arange(mi.UInt32, count * bins)
            ray = lane // bins + dr.opaque(mi.UInt32, first)
            sampler.seed(dr.opaque(mi.UInt32, first + 1), count * bins)
            si = dr.gather(mi.SurfaceInteraction3f, seen, ray)
            go = dr.gather(mi.Mask, active, ray)
            u, v = (mi.Float(lane % bins) + 0.5) / bins, sampler.next_1d()
            joint = _Joint(si, si.bsdf(), go, alike, alike.even)
            _, made = self._one(points, generation, joint, u, v)
            grey = dr.mean(made, axis=0)
            light[first : first + count] = grey.numpy().reshape(count, bins)
        return light


def tiles_of(width: int, height: int) -> tuple[tuple[int, int], NDArray[np.uint32]]:
    """Rows and columns of an image's tiles, and the numbers of some pixels of each, in order."""
    tiles = -(-height // TILE_PX), -(-width // TILE_PX)
    within = (np.arange(_PROBES) + 0.5) / _PROBES * TILE_PX
    down, across = within.astype(int), (within[::-1] + TILE_PX / 2.0).astype(int) % TILE_PX
    row, column = np.meshgrid(*(np.arange(n) * TILE_PX for n in tiles), indexing="ij")
    rows = np.minimum(row[..., None] + down, height - 1)
    columns = np.minimum(column[..., None] + across, width - 1)
    return tiles, (rows * width + columns).ravel().astype(np.uint32)
