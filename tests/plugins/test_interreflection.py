"""Light by reflections between surfaces: against form factors, and against Mitsuba's `path`."""

from dataclasses import replace

import numpy as np
import pytest
from virtual_sensor_plugins.exposure import ONE_FRAME
from virtual_sensor_plugins.interreflection import Stripe
from virtual_sensor_plugins.renderer import Prepared

import virtual_sensor as vs
from virtual_sensor.engine import mi
from virtual_sensor.imaging.render import arrangement

HEIGHT_MM, LENGTH_MM = 5.0, 20.0  # of the lit line over the corner, and along it
SIZE, HALF_MM = 48, 6.0

# A corner of two walls: the floor z = 0 with a line along x, and the wall y = 0, which a camera
# sees square on and no laser ray reaches.
CORNER = f"""<scene version="3.0.0">
    <default name="depth" value="3"/><default name="samples" value="4"/>
    <default name="radius" value="0.2"/><default name="dots" value=""/>
    <default name="eye" value="0, 300, 6.5"/>
    <integrator type="refractive"><integer name="max_depth" value="$depth"/>
        <integer name="indirect_samples" value="$samples"/></integrator>
    <sensor type="perspective">
        <float name="fov" value="{2.0 * np.degrees(np.arctan(HALF_MM / 300.0))}"/>
        <transform name="to_world">
            <lookat origin="$eye" target="0, 0, 6.5" up="0, 0, 1"/></transform>
        <film type="hdrfilm">
            <integer name="width" value="{SIZE}"/><integer name="height" value="{SIZE}"/>
            <string name="pixel_format" value="luminance"/><rfilter type="box"/></film>
        <sampler type="independent"><integer name="sample_count" value="4"/></sampler>
    </sensor>
    <emitter type="laser_line" id="laser">
        <float name="length" value="{LENGTH_MM}"/><float name="radius" value="$radius"/>
        <string name="dots" value="$dots"/><float name="power" value="0.1"/>
        <transform name="to_world"><lookat origin="0, {HEIGHT_MM}, 300"
            target="0, {HEIGHT_MM}, 0" up="1, 0, 0"/></transform>
    </emitter>
    OTHER
    BSDF
    <shape type="rectangle"><transform name="to_world"><scale value="15"/>
        <translate y="15"/></transform><ref id="grey"/></shape>
    <shape type="rectangle"><transform name="to_world"><scale value="15"/>
        <rotate x="1" angle="-90"/><translate z="15"/></transform><ref id="grey"/></shape>
</scene>"""
METAL = """<bsdf type="roughconductor" id="grey"><float name="alpha" value="0.3"/>
    <string name="distribution" value="ggx"/></bsdf>"""
GREY = '<bsdf type="diffuse" id="grey"><float name="reflectance" value="0.5"/></bsdf>'


@pytest.fixture(name="corner")
def fixture_corner(tmp_path):
    """Load that scene."""

    def load(bsdf=GREY, other="", **parameters):
        path = tmp_path / "corner.xml"
        path.write_text(CORNER.replace("BSDF", bsdf).replace("OTHER", other), encoding="utf-8")
        return vs.load_scene(path, **parameters)

    return load


def indirect(scene, seed=0, moments=False, source="laser", **other):
    """(B, 1 or 5, H, W) by a source."""
    with ONE_FRAME:
        given = replace(arrangement(scene), **{"max_depth": 3, **other})
        return Prepared.of(given).indirect(seed, moments=moments)[source]


def wall_mm():
    """X and z of the pixels' centres on the wall."""
    across = (np.arange(SIZE) + 0.5) / SIZE * 2.0 * HALF_MM - HALF_MM
    return -across[None, :], 6.5 - across[:, None]


def by_a_line(x, z, length=LENGTH_MM, power=0.1, albedo=0.5):
    """Radiance of the wall by a thin line on the floor: its form factor, integrated along it."""
    near = HEIGHT_MM**2 + z**2

    def part(end):
        away = end - x
        return away / (2.0 * near * (near + away**2)) + np.arctan(away / near**0.5) / (
            2.0 * near**1.5
        )

    along = part(length / 2.0) - part(-length / 2.0)
    exitance = albedo * power / length
    return albedo / np.pi * exitance / np.pi * HEIGHT_MM * z * along


def test_two_diffuse_walls_transfer_by_their_form_factor(corner):
    """A wide sheet's light, shared by its width, is the line's to second order in it."""
    layers = indirect(corner(), moments=True)
    expected = by_a_line(*wall_mm())
    radiance = layers[0, 0]
    assert abs(radiance.sum() / expected.sum() - 1.0) < 0.003
    seen = radiance.reshape(8, 6, 8, 6).sum((1, 3)) / expected.reshape(8, 6, 8, 6).sum((1, 3))
    np.testing.assert_allclose(seen, 1.0, atol=0.05)
    s, t = layers[0, 1:3].sum((1, 2)) / radiance.sum()
    assert abs(s) < 0.02
    assert abs(t) < 0.3


SCREEN = """<shape type="rectangle"><transform name="to_world"><scale x="40" y="1"/>
    <rotate x="1" angle="-90"/><translate y="2.5"/></transform>
    <bsdf type="diffuse"/></shape>"""


def test_a_screen_between_line_and_wall_throws_its_shadow(corner):
    """It stands half way, 1 mm high: the wall is dark to a height of 2 mm, and lit above it."""
    scene = corner(other=SCREEN)
    expected, (_, z) = by_a_line(*wall_mm()), wall_mm()
    light = indirect(scene)[0, 0]
    dark, lit = ((low < z) & (z < high) for low, high in ((1.1, 1.85), (2.25, 9.0)))
    assert not np.any(light[dark.ravel()])
    assert light[lit.ravel()].sum() == pytest.approx(expected[lit.ravel()].sum(), rel=0.01)


def test_light_that_no_chance_finds_is_connected_whole(corner, monkeypatch):
    """Where refraction moves light farther than the sources' margins, only connections have it."""
    monkeypatch.setattr(Stripe, "_near", lambda self, beam, frame, point: mi.Mask(False))
    light, expected = indirect(corner())[0, 0], by_a_line(*wall_mm())
    assert abs(light.sum() / expected.sum() - 1.0) < 0.02


HALF_MIRROR = """<bsdf type="blendbsdf" id="grey"><float name="weight" value="0.5"/>
    <bsdf type="conductor"><string name="material" value="none"/></bsdf>
    <bsdf type="diffuse"/></bsdf>"""


def test_a_mirror_shows_the_line_as_by_mitsubas_path(corner):
    """The camera looks down: what the wall mirrors of the floor has the line's image."""
    scene = corner(HALF_MIRROR, radius=1.0, eye="0, 230, 206.5")
    own = np.mean([indirect(scene, seed)[0, 0] for seed in range(2)], axis=0)
    direct = vs.render(corner(HALF_MIRROR, radius=1.0, eye="0, 230, 206.5", depth=2))
    path = mi.load_dict({"type": "path", "max_depth": 3, "rr_depth": 99})
    stock = np.array(mi.render(scene.mitsuba, integrator=path, spp=256))[:, :, 0] - direct
    assert own.max() > 20.0 * np.median(own)
    assert own.sum() == pytest.approx(stock.sum(), rel=0.02)


def test_mitsubas_render_has_the_reflected_light_too(corner):
    """On the film, alone or beside direct light, and with a depth of 2 none."""
    scene = corner()
    on_film = np.array(mi.render(scene.mitsuba, seed=3))[:, :, 0]
    np.testing.assert_allclose(on_film, indirect(scene, seed=3)[0, 0], rtol=1e-5)
    groove = vs.load_scene("v_groove", width=48, height=48, spp=4, line_radius=1, max_depth=3)
    on_film = np.array(mi.render(groove.mitsuba, seed=3))[:, :, 0]
    np.testing.assert_allclose(on_film, vs.render(groove, seed=3), rtol=1e-4, atol=1e-9)
    assert on_film.max() > 10.0 * np.median(on_film)
    assert not np.any(np.array(mi.render(corner(depth=2).mitsuba)))


OTHER = f"""<emitter type="laser_line" id="dots"><string name="dots" value="-1, 2"/>
    <float name="length" value="8"/><float name="radius" value="0.4"/>
    <float name="power" value="0.3"/><transform name="to_world">
        <lookat origin="0, {2 * HEIGHT_MM}, 300" target="0, {2 * HEIGHT_MM}, 0" up="1, 0, 0"/>
    </transform></emitter>"""


def test_each_of_two_lasers_has_its_own_light_and_rays(corner):
    """As if it shone alone: radiance, and whence it comes."""
    both, alone = corner(other=OTHER), corner()
    layers = indirect(both, moments=True)
    expected = by_a_line(*wall_mm())
    # In two frames: two lasers leave either half of the samples.
    more = indirect(both, seed=1)[0, 0]
    assert abs((layers[0, 0] + more).sum() / (2.0 * expected.sum()) - 1.0) < 0.025
    assert np.array_equal(indirect(alone, seed=7), indirect(alone, seed=7))
    dots = indirect(both, moments=True, source="dots")[0]
    _, t = dots[1:3].sum(axis=(1, 2)) / dots[0].sum()
    assert t == pytest.approx(0.5, abs=0.1)  # of dots at -1 and 2
    deviation = np.sqrt(dots[4].sum() / dots[0].sum() - t**2)
    assert deviation == pytest.approx(1.5, abs=0.1)


def test_a_depth_that_cannot_be_is_refused(corner):
    """With what to give in its place."""
    for value, why in ((1, "give 2 for direct light"), (-1, "any number"), (0, "from 2 to 32")):
        with pytest.raises(vs.InputError, match=f"refractive: .*max_depth.*{why}"):
            corner(depth=value)
    with pytest.raises(vs.InputError, match="'indirect_samples' must be a whole number from 1"):
        corner(samples=0)


def blocks(images):
    """Sums over squares of 8 pixels: (N, 36) of images (N, H, W)."""
    parts = images.reshape(len(images), SIZE // 8, 8, SIZE // 8, 8)
    return parts.sum((2, 4)).reshape(len(images), -1)


def test_metal_walls_shine_as_by_mitsubas_path(corner):
    """`path` finds a wide stripe by chance alone, and shades it by the laser's own emitter.

    The first bounce, and the first two, agree within the noise in each of 36 squares.
    """
    scene = corner(METAL, radius=2.0)
    own = np.array([indirect(scene, seed, max_depth=4)[:, 0] for seed in range(8)])
    for bounces in (1, 2):
        path = mi.load_dict({"type": "path", "max_depth": bounces + 2, "rr_depth": 99})
        stock = [
            np.array(mi.render(scene.mitsuba, integrator=path, spp=64, seed=seed))[:, :, 0]
            for seed in range(8)
        ]
        one, other = blocks(own[:, :bounces].sum(axis=1)), blocks(np.array(stock))
        noise = np.hypot(one.std(axis=0, ddof=1), other.std(axis=0, ddof=1)) / len(stock) ** 0.5
        z = (one.mean(axis=0) - other.mean(axis=0)) / noise
        assert np.abs(z).max() < 5.0
        assert abs(z.mean()) < 0.5
        assert 0.6 < z.std() < 1.6
        assert abs(one.sum() / other.sum() - 1.0) < 0.03


SPHERE = """<scene version="3.0.0">
    <integrator type="refractive"/>
    <sensor type="perspective"><float name="fov" value="30"/>
        <transform name="to_world">
            <lookat origin="0, 60, 0" target="0, -100, 0" up="0, 0, 1"/></transform>
        <film type="hdrfilm"><integer name="width" value="32"/><integer name="height" value="32"/>
            <string name="pixel_format" value="luminance"/><rfilter type="box"/></film>
        <sampler type="independent"/>
    </sensor>
    <emitter type="laser_line" id="laser">
        <float name="length" value="40"/><float name="radius" value="3"/>
        <float name="power" value="0.1"/><float name="distance" value="150"/>
        <transform name="to_world"><lookat origin="0, 0, 50" target="0, 0, -100" up="1, 0, 0"/>
        </transform>
    </emitter>
    <shape type="sphere"><float name="radius" value="100"/>
        <boolean name="flip_normals" value="true"/>
        <bsdf type="diffuse"><float name="reflectance" value="0.8"/></bsdf></shape>
</scene>"""


def test_each_bounce_in_an_integrating_sphere_has_its_albedo_more(tmp_path):
    """In a sphere every place sheds as much light on every other: L = albedo^(b+1) P / (pi A)."""
    path = tmp_path / "sphere.xml"
    path.write_text(SPHERE, encoding="utf-8")
    light = indirect(vs.load_scene(path), max_depth=5, indirect_samples=16)[:, 0]
    bounce = np.arange(1, 4)
    expected = 0.8 ** (bounce + 1) * 0.1 / (np.pi * 4.0 * np.pi * 100.0**2)
    np.testing.assert_allclose(light.mean(axis=(1, 2)), expected, rtol=5e-3)


def test_rays_that_lit_a_point_are_found_from_it_again_in_hot_air():
    """Followed through the air from the laser, and sought from the point by the tables of light.

    Which rays they are, how bright, and how densely points lie there, by which both are weighed.
    """
    scene = vs.load_scene("hot_cylinder", width=64, height=64, max_depth=3)
    with ONE_FRAME:
        given = arrangement(scene)
        beam = Prepared.of(given)._beam("laser")
        stripe = Stripe(given.scene, (beam,), given.refracting, given.transport.march, seed=0)
        points = stripe.generations[0]
        (caught,) = stripe.lights(points.si, mi.Mask(True))
    which = np.array(caught.which)
    assert which.size > 0.95 * points.s.numpy().size
    lit = np.array([points.s, points.t]).T[which]
    found = np.array(caught.coordinates).T
    straight = beam.source.family.coordinates(np.transpose(points.si.p)[which])[:, :2]
    off, bent = (np.median(np.abs(each - lit), axis=0) for each in (found, straight))
    assert np.all(off < 0.01 * bent)
    density, power = np.array(points.density)[which], np.array(points.power)[0, which]
    assert np.median(np.array(caught.density) / density) == pytest.approx(1.0, abs=1e-3)
    shown = np.array(caught.irradiance) / (power * density)  # the same for all points
    np.testing.assert_allclose(np.quantile(shown, [0.1, 0.9]), np.median(shown), rtol=0.01)
