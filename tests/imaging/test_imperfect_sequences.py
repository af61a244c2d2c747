"""What is not ideal in a sequence displaces phases as known formulas say.

Frames are decoded here by the plain sum over N steps; the formulas' sources are in the explanation
of fringes.  A plane is lit from the side, so that columns and phases differ from pixel to pixel.
"""

import numpy as np
import pytest
from swaying_plume import plume_kelvin

import virtual_sensor as vs
from virtual_sensor.devices.patterns import Sine
from virtual_sensor.imaging.render import arrangement
from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity

PLANE = """<scene version="3.0.0">
    <default name="fov" value="4.6"/> <default name="spp" value="4"/>
    <default name="height" value="64"/> <default name="turn" value="0"/>
    <default name="pixels" value="false"/> <default name="gamma" value="1"/>
    <default name="bits" value="0"/> <default name="defocus" value="0"/>
    <integrator type="refractive"/>
    <sensor type="perspective"><float name="fov" value="$fov"/>
    <transform name="to_world"><lookat origin="1, 2, 300" target="1, 2, 0" up="$turn, 1, 0"/>
    </transform><film type="hdrfilm"><integer name="width" value="96"/>
    <integer name="height" value="$height"/>
    <string name="pixel_format" value="luminance"/><rfilter type="box"/></film>
    <sampler type="stratified"><integer name="sample_count" value="$spp"/>
    <boolean name="jitter" value="false"/></sampler></sensor>
    <emitter type="pattern_projector"><float name="fov" value="11.42"/>
    <boolean name="pixels" value="$pixels"/> <float name="gamma" value="$gamma"/>
    <integer name="bits" value="$bits"/> <float name="defocus" value="$defocus"/>
    <transform name="to_world"><lookat origin="-150, 0, 260" target="0, 0, 0" up="0, 1, 0"/>
    </transform></emitter>
    <shape type="rectangle"><transform name="to_world"><scale value="40"/></transform>
    <bsdf type="diffuse"><float name="reflectance" value="0.5"/></bsdf></shape>
</scene>"""
ANY = np.linspace(0.0, 16.0, 4001)


@pytest.fixture(scope="module")
def load(tmp_path_factory):
    path = tmp_path_factory.mktemp("plane") / "plane.xml"
    path.write_text(PLANE, encoding="utf-8")
    return lambda **parameters: vs.load_scene(path, **parameters)


def steps(number, period_px, axis="u"):
    return [Sine(axis, period_px, 2.0 * np.pi * k / number) for k in range(number)]


def decoded(images):
    """N/2 B exp(i phi) of N equal steps, (H, W)."""
    turned = np.exp(2j * np.pi * np.arange(len(images)) / len(images))
    return np.tensordot(turned, np.asarray(images, float), 1)


def phase_of(column, period_px):
    return 2.0 * np.pi * (column + 0.5) / period_px


def beside(found, phase):
    """By how much a complex signal is turned beside phases, rad."""
    return np.angle(found * np.exp(-1j * phase))


def rms(errors):
    return float(np.sqrt(np.mean(np.square(errors))))


def test_gamma_errs_as_its_harmonics_say(load):
    """The largest error in rad, of Lambert-like light ((1 + cos phi)/2)^gamma."""
    table = {
        (1.1, 3): 0.030,
        (1.1, 4): 0.0058,
        (1.1, 5): 0.0019,
        (1.5, 3): 0.139,
        (1.5, 4): 0.0142,
        (2.2, 3): 0.291,
        (2.2, 4): 0.0106,
    }
    for gamma in (1.1, 1.5, 2.2):
        wanted = [number for each, number in table if each == gamma]
        patterns = [pattern for number in wanted for pattern in steps(number, 256.0)]
        frames = vs.render_sequence(load(gamma=gamma), patterns)
        phase = phase_of(frames.projector_pixel[..., 0], 256.0)
        assert np.ptp(phase) > 2.2 * np.pi
        first = 0
        for number in wanted:
            error = beside(decoded(frames.radiance[first : first + number]), phase)
            known = table[gamma, number]
            last_digit = 0.0005 if known > 0.02 else 0.00005
            assert np.abs(error).max() == pytest.approx(known, rel=0.02, abs=last_digit)
            first += number


def staircase(covers_px, period_px, shown):
    """Errors of phases in rad where a pixel covers so much of what a projector shows."""
    within = (np.arange(400) + 0.5) / 400.0 - 0.5
    column = ANY[:, None] * period_px / 16.0 + covers_px * within
    return beside(shown(column).mean(axis=1), phase_of(ANY * period_px / 16.0, period_px))


def test_square_pixels_and_bits_err_as_staircases_averaged_over_a_cameras_pixels(load):
    """Rationale: how much of it is left depends on how many of them a camera pixel covers."""

    def of_pixels(column):
        return np.exp(1j * phase_of(np.rint(column), 16.0))

    def of_bits(column):
        theta = 2.0 * np.pi * np.arange(4) / 4
        grey = 0.5 + 0.5 * np.cos(phase_of(column, 64.0)[..., None] - theta)
        return np.rint(grey * 7.0) @ np.exp(1j * theta)

    for fov, parameters, period, shown in (
        (0.4, {"pixels": "true"}, 16.0, of_pixels),
        (1.2, {"pixels": "true"}, 16.0, of_pixels),
        (1.2, {"bits": 3}, 64.0, of_bits),
    ):
        frames = vs.render_sequence(
            load(fov=fov, spp=256, height=8, **parameters), steps(4, period)
        )
        column = frames.projector_pixel[..., 0]
        error = beside(decoded(frames.radiance), phase_of(column, period))
        covers = float(np.abs(np.diff(column, axis=1)).mean())
        expected = rms(staircase(covers, period, shown))
        assert expected * period / (2.0 * np.pi) > 0.02
        whole = np.ptp(column) // period * period  # equally many of each phase
        some = column < column.min() + whole
        assert rms(error[some]) == pytest.approx(expected, rel=0.05), (fov, parameters)


def test_defocus_lowers_the_modulation_and_moves_no_phase(load):
    """By exp(-2 (pi sigma/lambda)^2): a Gaussian's transfer."""
    sharp = decoded(vs.render_sequence(load(), steps(4, 64.0)).radiance)
    blurred = decoded(vs.render_sequence(load(defocus=8), steps(4, 64.0)).radiance)
    expected = np.exp(-2.0 * (np.pi * 8.0 / 64.0) ** 2)
    np.testing.assert_allclose(np.abs(blurred) / np.abs(sharp), expected, rtol=2e-3)
    assert np.abs(np.angle(blurred / sharp)).max() < 1e-3


def test_noise_of_the_camera_errs_as_surrel_says(load):
    """Read noise: sqrt(2/N) sigma/B.  Shot noise: sqrt(2 A/N)/B of electrons."""
    clean = {"prnu": 0.0, "dsnu_e": 0.0, "bit_depth": 16, "black_level": 1000.0}
    for number in (3, 4, 8):
        radiance = vs.render_sequence(load(), steps(number, 64.0)).radiance
        ideal = decoded(radiance)
        scale = 4000.0 / radiance.max()
        mean_e = scale * radiance.mean(axis=0)
        modulation_e = scale * 2.0 / number * np.abs(ideal)
        for camera, sigma_e in (
            (vs.ImageSensor(gain=5.0, dark_noise_e=300.0, full_well_e=1e6, **clean), 300.0),
            (vs.ImageSensor(gain=5.0, dark_noise_e=0.0, full_well_e=1e6, **clean), None),
        ):
            noisy = decoded(vs.grey_values(radiance, camera, number, peak_e=4000.0))
            known = np.hypot(sigma_e, np.sqrt(mean_e)) if sigma_e else np.sqrt(mean_e)
            expected = np.sqrt(2.0 / number) * known / modulation_e
            assert rms(np.angle(noisy / ideal) / expected) == pytest.approx(1.0, rel=0.03)


def test_rounding_errs_by_more_than_white_noise_where_twice_the_mean_is_whole(load):
    """At 8 bits, A = 127.5, B = 102 by 0.0029 rad (N = 4), 0.0021 (8); white: sqrt(2/N/12)/B.

    Rationale: opposite steps, A + x and A - x, are rounded alike then, as they are where twice the
    mean is whole; where it is not, the errors are as good as independent.
    """
    camera = vs.ImageSensor(
        quantum_efficiency=1.0,
        gain=1e-9,
        dark_noise_e=0.0,
        full_well_e=1e12,
        bit_depth=8,
        black_level=20.0,
        dsnu_e=0.0,
        prnu=0.0,
    )
    for number, whole in ((4, 0.0029), (8, 0.0021)):
        frames = vs.render_sequence(load(turn=0.3), steps(number, 64.0)).radiance
        mean = frames.mean(axis=0)
        wave = (frames - mean) / (2.0 / number * np.abs(decoded(frames)))
        even = 107.5 + 102.0 * wave  # black is at 20
        shade = np.linspace(0.96, 1.0, 96)  # A and B between whole numbers
        white = float(np.sqrt(2.0 / number / 12.0) / 102.0)
        for light, known in ((even, whole), (even * shade, white)):
            error = np.angle(decoded(vs.grey_values(1e9 * light, camera)) / decoded(light))
            assert rms(error * light.mean(axis=0) / 107.5) == pytest.approx(known, rel=0.05)


def test_a_glow_that_changes_in_a_sequence_adds_its_own_first_harmonic():
    """Light L_k beside A + B cos(phi - theta_k) turns the sum over the steps."""
    small = {"width": 64, "height": 64, "spp": 4, "pixels": "false", "field": ""}
    scenes = [
        vs.load_scene("fringe_cylinder", emissivity=0.8, temperature=1000 + 40 * k, **small)
        for k in range(4)
    ]
    dark = vs.render_sequence(scenes[0].cold(), steps(4, 128.0))
    frames = vs.render_sequence(scenes[0], steps(4, 128.0), scenes=scenes)
    glow = np.array([arrangement(scene).glow for scene in scenes])
    assert glow[3] > 2.0 * glow[0] > 0.0
    ideal, found = decoded(dark.radiance), decoded(frames.radiance)
    lit = np.abs(ideal) > 0.3 * np.abs(ideal).max()
    added = np.exp(2j * np.pi * np.arange(4) / 4) @ glow
    expected = np.imag(added * np.exp(-1j * np.angle(ideal[lit])) / np.abs(ideal[lit]))
    assert 1e-3 < np.abs(expected).max() < 0.1
    error = np.angle(found[lit] / ideal[lit])
    np.testing.assert_allclose(error, expected, atol=0.05 * np.abs(expected).max())


@pytest.mark.slow
def test_air_that_moves_between_the_steps_ripples_at_twice_the_phase(tmp_path):
    """Phases e_k beside the first step's give (1/N) sum e_k (1 - cos(2 phi - 2 theta_k)).

    They are those of the marched search in the air of each step; light that the air concentrates
    is taken out by white frames.
    """
    stored = np.linspace(0.0, 0.3, 4)
    kelvin = np.array([plume_kelvin(shift) for shift in (0.0, 3.0, 6.0, -3.0)])
    air = GriddedQuantity("temperature", kelvin, [-96.0, -24.0, -16.0], [12.0, 1.5, 8.0], stored)
    write_quantity(tmp_path / "air.nc", air)
    small = {"width": 64, "height": 64, "spp": 4, "pixels": "false", "tolerance": 2e-4}
    scene = vs.load_scene("fringe_cylinder", field=tmp_path / "air.nc", **small)
    period, moved = 240.0, [scene.at(time_s) for time_s in stored]
    patterns = [each for step in steps(4, period, "v") for each in (step, "white")]
    frames = vs.render_sequence(scene, patterns, scenes=[each for each in moved for _ in "ab"])
    assert frames.traces == 4
    v, u = (some.ravel() for some in np.mgrid[4:60:5, 16:48:3])
    pixel = np.stack([u, v], axis=1).astype(float)
    row = np.array([vs.projector_pixels(each, pixel).projector_pixel[:, 1] for each in moved])
    phase = phase_of(row, period)
    later, theta = phase - phase[0], 2.0 * np.pi * np.arange(4)[:, None] / 4
    even = later.mean(axis=0)
    ripple = -(later * np.cos(2.0 * phase[0] - 2.0 * theta)).mean(axis=0)
    with np.errstate(invalid="ignore"):
        found = decoded(frames.radiance[::2] / frames.radiance[1::2])[v, u]
    still = decoded(vs.render_sequence(moved[0], steps(4, period, "v")).radiance)[v, u]
    error = np.angle(found / still)
    known = np.isfinite(even + error)
    assert known.sum() > 100
    assert rms(ripple[known]) > 0.003
    assert rms((error - even - ripple)[known]) < 0.05 * rms(ripple[known])
