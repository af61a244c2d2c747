"""What a tolerance chooses for fringes: formulas beside decoders and recorded images."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

import virtual_sensor as vs
from virtual_sensor.cli.commands import app
from virtual_sensor.devices.projector import Projector
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.fringe_recording import FringeRecording
from virtual_sensor.metrology.fringes.phase_shift import PhaseShift
from virtual_sensor.studies.fringes import measure, tolerance
from virtual_sensor.studies.fringes.tolerance import (
    Noise,
    _candidates,
    choose_fringes,
    contrast_of,
    gamma_ripple,
    phase_noise,
)

SIDE = 128


@pytest.fixture(scope="module")
def scene():
    """The cold scene of few pixels, patterns without square pixels."""
    return vs.load_scene("fringe_cylinder", width=SIDE, height=SIDE, pixels="false", field="")


def test_the_ripple_of_gamma_is_that_of_decoded_phases():
    """Rationale: facts name 0.030 rad of 3 steps at 1.1, 0.0142 of 4 at 1.5, 0.0035 of 5."""
    for steps, gamma, largest in ((3, 1.1, 0.030), (4, 1.5, 0.0142), (5, 1.5, 0.0035)):
        assert gamma_ripple(steps, gamma) == pytest.approx(largest, rel=0.1)
        codec = PhaseShift(size_px=(256, 8), steps=steps, periods_px=(256.0,), axes="u")
        u = np.linspace(8.0, 247.0, 400)[None].repeat(8, 0)
        images = np.stack([p.grey(u, 0.0 * u) for p in codec.patterns])
        error = codec.decode(images**gamma, noise=0.0, edges=False).column - u
        assert np.abs(error).max() * 2 * np.pi / 256 == pytest.approx(largest, rel=0.1)


def test_the_noise_of_a_phase_is_that_of_recorded_steps():
    """Rationale: shot and read noise in electrons, by drawing them."""
    light, steps, electrons = np.array([0.3]), 5, 2000.0
    rng, phi = np.random.default_rng(5), np.linspace(0.0, 2 * np.pi, 20_000)
    angle = 2 * np.pi * np.arange(steps)[:, None] / steps
    mean = electrons * light * (0.5 + 0.5 * np.cos(phi - angle))
    seen = rng.poisson(mean) + rng.normal(0.0, vs.ImageSensor().dark_noise_e, mean.shape)
    found = np.angle(np.sum(seen * np.exp(1j * angle), axis=0))
    spread = np.std(np.angle(np.exp(1j * (found - phi))))
    codec = PhaseShift(steps=steps)
    assert phase_noise(codec, light, 1.0, Noise(electrons, 2.4))[0] == pytest.approx(
        spread, rel=0.02
    )


def test_defocus_and_contrast_take_amplitude_off():
    """Rationale: a Gaussian's transfer is exp(-2 pi^2 sigma^2/lambda^2), by convolving a sine."""
    family = vs.load_scene("fringe_cylinder").projector.family
    blurred = Projector(family, defocus_px=2.0, contrast=5.0)
    x, at = np.arange(-64.0, 64.0, 0.01), np.arange(-10.0, 10.0, 0.01)
    weight = np.exp(-0.5 * (at / 2.0) ** 2)
    sine = np.convolve(np.cos(2 * np.pi * x / 16), weight / weight.sum(), "valid")
    assert contrast_of(blurred, 16.0) == pytest.approx(0.8 * sine.max(), rel=1e-3)
    within = np.cos(2 * np.pi * (np.arange(500) + 0.5 - 250) * 5.0 / 500 / 16)  # of 5 px
    assert contrast_of(Projector(family), 16.0, 5.0) == pytest.approx(within.mean(), rel=1e-3)


def test_bits_and_gamma_err_as_decoded_steps_do(scene):
    """Rationale: what is estimated is rms, in px; by rounding and bending the steps themselves."""
    u, finest = np.linspace(100.0, 800.0, 20_000), 64.0
    for steps, changed in ((3, {"gamma": 1.5}), (4, {"bits": 8}), (5, {"bits": 8})):
        projector = replace(scene.projector, **changed)
        told = next(
            each.estimate_px
            for each in _candidates(
                replace(scene, sources={"projector": projector}), np.ones(1), None, "u"
            )
            if each.codec.startswith(f"phase {steps} {finest:g},")
        )
        angle = 2 * np.pi * np.arange(steps)[:, None] / steps
        grey = 0.5 + 0.5 * np.cos(2 * np.pi * u / finest - angle)
        grey = np.rint(255.0 * grey) if "bits" in changed else grey**1.5
        error = np.angle(np.sum(grey * np.exp(1j * (angle - 2 * np.pi * u / finest)), axis=0))
        (name,) = changed
        observed = np.sqrt(np.mean(error**2)) * finest / (2 * np.pi)
        assert told[name] == pytest.approx(observed, rel=0.15), name


def test_orders_stay_sure_and_periods_span_the_axis(scene, monkeypatch):
    """Rationale: at 300 electrons 64 and 1280 px would do for the noise, with 2 % of wrong orders.

    By erfc(pi/(sqrt(2) sigma sqrt(1 + 20^2))), sigma = sqrt(2/3)/sqrt(150) rad.
    """
    monkeypatch.setattr(tolerance, "_rendered_px", lambda *now: 1e-3)
    assert choose_fringes(scene, 0.05, axes="v").codec == "phase 3 64,800 v"
    found = choose_fringes(scene, 3.0, recording=FringeRecording(electrons=300), axes="u")
    assert found.codec != "phase 3 64,1280 u"


def test_a_tolerance_takes_the_fewest_images_that_do(scene, monkeypatch):
    """Rationale: without noise 3 steps of 2 periods do; with it, finer fringes and more steps."""
    monkeypatch.setattr(tolerance, "_rendered_px", lambda *now: 1e-3)
    free = choose_fringes(scene, 0.05)
    assert (free.codec, free.images, free.spp) == ("phase 3 64,1280 uv", 12, 1)
    images = [free.images // 2]
    for tolerance_px in (0.3, 0.1, 0.06):
        found = choose_fringes(
            scene, tolerance_px, recording=FringeRecording(electrons=10_000), axes="u"
        )
        assert found.error_px <= tolerance_px
        images.append(found.images)
    assert images == sorted(images)
    assert images[0] < images[-1]
    assert "noise" in f"{found}"


def test_what_is_chosen_keeps_the_tolerance(scene):
    """Rationale: the estimate is checked on recorded images, which it does not see."""
    chosen = choose_fringes(scene, 0.1, recording=FringeRecording(electrons=8000), axes="u")
    codec = vs.codec_of(chosen.codec, scene.projector.size)
    frames = vs.render_sequence(scene, codec.patterns, spp=chosen.spp)
    camera = vs.ImageSensor(dsnu_e=0.0, prnu=0.0)
    grey = vs.grey_values(frames.radiance, camera, seed=3, peak_e=8000)
    noisy, clean = codec.decode(grey, sensor=camera), codec.decode(frames.radiance, noise=0.0)
    both = noisy.ok & clean.ok
    spread = np.std((noisy.column - clean.column)[both])
    told = chosen.estimate_px["noise"]  # of dim pixels at the limb too, of which here many are lost
    assert 0.5 * told < spread < 1.05 * told <= 0.105


def test_a_tolerance_that_nothing_keeps_names_what_errs_most(scene, monkeypatch):
    """Rationale: the remedy is another one for noise, gamma and square pixels."""
    with pytest.raises(InputError, match="positive number"):
        choose_fringes(scene, -1.0)
    with pytest.raises(InputError, match="expose"):
        choose_fringes(scene, 1e-4, recording=FringeRecording(electrons=1000))
    monkeypatch.setattr(tolerance, "_rendered_px", lambda *now: 0.2)
    with pytest.raises(InputError, match="square pixels"):
        choose_fringes(scene, 0.1)
    size = {"width": SIDE, "height": SIDE, "field": ""}
    with pytest.raises(InputError, match="more of them"):
        choose_fringes(vs.load_scene("fringe_cylinder", bits=3, **size), 1e-3)
    monkeypatch.setattr(tolerance, "STEPS", (3,))
    with pytest.raises(InputError, match="linearise"):
        choose_fringes(vs.load_scene("fringe_cylinder", gamma=2.2, **size), 0.1)


@pytest.mark.usefixtures("unpainted_test")
def test_the_command_measures_with_what_was_chosen(tmp_path, monkeypatch):
    """Rationale: a choice is printed with its reasons, and stands in the results."""
    monkeypatch.setattr(measure, "SEARCHED", 200)
    words = f"fringes fringe_cylinder -D width={SIDE} -D height={SIDE} -D pixels=false --cold"
    words = [*words.split(), "--tolerance", "0.2", "-o", str(tmp_path / "fringed")]
    done = CliRunner().invoke(app, words)
    assert done.exit_code == 0, done.output
    assert "codec phase 3 64,1280 uv, spp 1" in done.output
    figures = json.loads((tmp_path / "fringed/summary.json").read_text(encoding="utf-8"))
    assert figures["codec"] == "phase 3 64,1280 uv"
    both = CliRunner().invoke(app, [*words, "--overwrite", "--spp", "4"])
    assert "leave out" in str(both.exception)
