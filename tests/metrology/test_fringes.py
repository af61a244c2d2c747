"""Decoders of fringes: exact without noise, as noisy as the formulas say, and never silently wrong.

The formulas are those of the literature on phase shifting, and figures that were computed for this
project by other programs: see each test.
"""

import cv2
import numpy as np
import pytest
from scipy.special import erfc

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.metrology.fringes.unwrapping import hierarchical

OK = vs.FringeStatus.OK


def places(height=120, width=160, size=(1280, 800)):
    """Projector columns and rows that camera pixels see: all of the image, slightly bent."""
    v, u = np.mgrid[:height, :width].astype(float)
    s, t = (u + 0.5) / width, (v + 0.5) / height
    column = size[0] * (s + 0.01 * np.sin(np.pi * s) * t) - 0.5
    return column, size[1] * (t + 0.01 * np.sin(np.pi * t) * s) - 0.5


def seen(codec, column, row, mean=100.0, amplitude=80.0):
    """Images (K, H, W) of a codec's patterns: drawn by formula, not by the patterns."""
    images = []
    for name in codec.names:
        x = column if name[0] == "u" else row
        if "step" in name:
            period, k, n = (float(name.split()[i]) for i in (1, 4, 6))
            turns = (x + 0.5) / period + codec.first_phase_deg / 360.0 - (k - 1) / n
            images.append(np.cos(2 * np.pi * turns))
        elif "bit" in name:
            number = np.floor(x + 0.5).astype(int)
            lit = (number ^ (number >> 1)) >> int(name.split()[3]) & 1
            images.append((2.0 * lit - 1.0) * (-1.0 if "inverted" in name else 1.0))
        else:
            level = {"white": 1.0, "black": -1.0}.get(name.split()[1])
            images.append(
                np.cos(2 * np.pi * (x + 0.5) / float(name.split()[1]))
                if level is None
                else np.full(x.shape, level)
            )
    return mean + amplitude * np.stack(images)


def error_of(decoded, column, row):
    """Of all that is decoded: what is found minus what is true."""
    pairs = ((decoded.column, column), (decoded.row, row))
    return np.concatenate(
        [(found - true)[decoded.ok] for found, true in pairs if found is not None]
    )


def test_patterns_are_what_the_formulas_draw():
    """Rationale: the convention of phases, bits and borders is one for projector and decoder."""
    v, u = np.mgrid[:11, :21].astype(float)
    for text in ("phase 5 16,21 uv 30deg", "phase 3 12 uv gray", "gray uv", "gray u single"):
        codec = vs.codec_of(text, (21, 11))
        drawn = seen(codec, u, v, 0.5, 0.5)
        np.testing.assert_allclose([p.image((21, 11)) for p in codec.patterns], drawn, atol=1e-12)
        assert vs.codec_of(codec.text, codec.size_px) == codec


def test_columns_and_rows_are_found_without_noise():
    column, row = places()
    for text in (
        "phase 3 uv",
        "phase 4 16,128,1280 uv",
        "phase 16 20 v gray",
        "phase 5 37 uv gray",
        "phase 4 16,18.51,21.62 uv heterodyne",
        "phase 4 1280,16,128 vu",
        "phase 3 uv -90deg",
    ):
        codec = vs.codec_of(text)
        decoded = codec.decode(seen(codec, column, row))
        assert np.mean(decoded.ok) == 1.0, text
        assert np.abs(error_of(decoded, column, row)).max() < 2e-5, text
        assert decoded.absolute
        assert not decoded.notes


def test_gray_code_is_opencvs():
    """Expected behaviour: OpenCV's patterns are ours in the same order, and its decoder agrees."""
    size = (70, 45)
    codec = vs.GrayCode(size_px=size)
    oracle = cv2.structured_light.GrayCodePattern_create(*size)
    _, drawn = oracle.generate()
    ours = [255 * pattern.image(size) for pattern in codec.patterns]
    np.testing.assert_array_equal(np.array(drawn), ours)
    images = np.stack(drawn)[:, :20, :30]
    decoded = codec.decode(images)
    for v, u in ((0, 0), (3, 29), (19, 7)):
        failed, pixel = oracle.getProjPixel(list(images), u, v)
        assert not failed
        assert (decoded.column[v, u], decoded.row[v, u]) == pixel == (u, v)
    np.testing.assert_allclose(np.unique(decoded.sigma_column), np.sqrt(1 / 12), rtol=1e-6)


def test_gray_code_of_more_projector_pixels_than_a_camera_tells_is_named():
    """Rationale: box means over 4.2 px invert the stripes of 2 px; each pixel looks as sure."""
    codec = vs.GrayCode(size_px=(1280, 800), axes="u")
    within = (np.arange(21) - 10.0) / 21.0
    for width_px, noted in ((4.2, True), (1.2, False)):
        column = 200.0 + width_px * np.arange(200.0)
        fine = column[:, None] + width_px * within
        images = seen(codec, fine, fine).mean(axis=2)[:, None, :].repeat(5, axis=1)
        decoded = codec.decode(images, noise=0.1)
        error = decoded.column - column
        assert (np.nanstd(error) > 1.2 * float(np.nanmedian(decoded.sigma_column))) == noted
        assert any("pixels along u" in note for note in decoded.notes) == noted


def test_unwrapping_in_space_lacks_whole_periods_and_says_so():
    column, row = places()
    for text, most in (("phase 4 64 uv spatial", 1e-4), ("single 64 uv", 16.0)):
        codec = vs.codec_of(text)
        decoded = codec.decode(seen(codec, column, row))
        assert not decoded.absolute
        assert "but for whole periods" in repr(decoded)
        for found, true in ((decoded.column, column), (decoded.row, row)):
            turns = (found - true)[decoded.ok] / 64.0
            assert np.abs(turns - np.rint(np.median(turns))).max() < most / 64.0
    inner = np.s_[30:-30, 30:-30]  # of one image, where the spectrum's ends don't reach
    turns = (decoded.column - column)[inner] / 64.0
    assert np.abs(turns - np.rint(np.median(turns))).max() < 0.01


def test_noise_passes_on_as_surrel_says():
    """sigma_phi = sqrt(2/N) sigma/B: predicted over observed, N = 3 to 16; and combined periods."""
    rng = np.random.default_rng(1)
    column, row = places(200, 300)
    for steps in range(3, 17):
        codec = vs.PhaseShift(steps=steps, periods_px=(20.0,), axes="u", unwrap="gray")
        images = seen(codec, column, row)
        decoded = codec.decode(images + rng.normal(0.0, 2.0, images.shape), noise=2.0, edges=False)
        expected = np.sqrt(2.0 / steps) * 2.0 / 80.0 * 20.0 / (2 * np.pi)
        found = error_of(decoded, column, row)
        found = found[np.abs(found) < 10.0]
        assert np.std(found) == pytest.approx(expected, rel=0.02)
        assert np.sqrt(np.nanmean(decoded.sigma_column**2)) == pytest.approx(expected, rel=0.02)
    codec = vs.codec_of("phase 4 16,18.51,21.62 u heterodyne")
    images = seen(codec, column, row)
    decoded = codec.decode(images + rng.normal(0.0, 0.5, images.shape), noise=0.5, edges=False)
    of_each = np.sqrt(0.5) * 0.5 / 80.0 * np.array([16, 18.51, 21.62]) / (2 * np.pi)
    expected = np.sum(of_each**-2.0) ** -0.5
    assert np.std(error_of(decoded, column, row)) == pytest.approx(expected, rel=0.02)
    assert np.nanmedian(decoded.sigma_column) == pytest.approx(expected, rel=0.02)


def test_noise_is_seen_in_the_images():
    """Expected behaviour: without being told, sigmas are as if the noise had been."""
    rng = np.random.default_rng(2)
    column, row = places()
    for text, kind in (("phase 4 uv", float), ("phase 3 uv", float), ("phase 5 uv", np.uint8)):
        codec = vs.codec_of(text)
        images = seen(codec, column, row)
        images = images + rng.normal(0.0, 1.5, images.shape)
        images = images if kind is float else np.rint(images).astype(kind)
        assert codec.decode(images).noise == pytest.approx(1.5, rel=0.03), text
    dim = 1.0 + 5.0 * seen(codec, column, row, 0.5, 0.5) + rng.normal(0.0, 1.5, images.shape)
    dim = np.clip(np.rint(dim), 0, 255).astype(np.uint8)
    assert codec.decode(dim).noise == pytest.approx(1.5, rel=0.15)


def test_gammas_harmonics_are_no_noise():
    """Rationale: they were, and of a projector with gamma a third of the pixels was lost to noise.

    Of ((1 + cos phi)/2)^2 what four steps leave over is cos(2 phi)/8.
    """
    rng = np.random.default_rng(3)
    v, u = np.mgrid[:120, :160].astype(float)
    column, row = 200.0 + 2.7 * u + 0.05 * v, 100.0 + 2.3 * v
    codec = vs.codec_of("phase 4 u")
    images = 20.0 + 200.0 * seen(codec, column, row, 0.5, 0.5) ** 2
    decoded = codec.decode(images + rng.normal(0.0, 1.5, images.shape), edges=False)
    assert decoded.noise == pytest.approx(1.5, rel=0.05)
    assert decoded.ok.mean() > 0.99
    assert any("by the projector's gamma" in note for note in decoded.notes)
    linear = 20.0 + 200.0 * seen(codec, column, row, 0.5, 0.5)
    decoded = codec.decode(linear + rng.normal(0.0, 1.5, images.shape), edges=False)
    assert not decoded.notes


def test_shot_noise_of_three_steps_depends_on_the_phase():
    """sqrt(2 A/N)/B on average; at N = 3 it varies 1.5-fold with the phase, at 4 by under 3 %."""
    rng = np.random.default_rng(3)
    column, row = np.broadcast_to(np.linspace(-0.5, 15.4, 9)[None], (6000, 9)), np.zeros((6000, 9))
    for steps, spread in ((3, 1.5), (4, 1.0), (6, 1.0)):
        codec = vs.PhaseShift(size_px=(16, 1), steps=steps, periods_px=(16,), axes="u")
        images = 200.0 + rng.poisson(seen(codec, column, row, 1000.0, 800.0))  # black is at 200
        decoded = codec.decode(images, noise=0.0, gain=1.0, black=200.0, edges=False)
        error = (decoded.column - column + 8.0) % 16.0 - 8.0
        observed = np.nanstd(error, axis=0)
        predicted = np.sqrt(np.nanmean(decoded.sigma_column**2, axis=0))
        np.testing.assert_allclose(predicted, observed, rtol=0.04)
        mean = np.sqrt(2 * 1000.0 / steps) / 800.0 * 16.0 / (2 * np.pi)
        assert np.sqrt(np.mean(predicted[:-1] ** 2)) == pytest.approx(mean, rel=0.03)
        assert predicted.max() / predicted.min() == pytest.approx(spread, rel=0.04)


def test_rounding_to_8_bits_is_not_white():
    """B = 102: 0.0029 rad for N = 4 (0.0020 if white), 0.0021 for 8 (0.0014): computed."""
    column, row = places(400, 500)
    for steps, sigma_rad in ((4, 0.0029), (8, 0.0021)):
        codec = vs.PhaseShift(size_px=(1280, 800), steps=steps, periods_px=(1280,), axes="u")
        images = np.rint(seen(codec, column, row, 128.0, 102.0)).astype(np.uint8)
        decoded = codec.decode(images, noise=0.0)
        per_rad = 1280.0 / (2 * np.pi)
        observed = np.std(error_of(decoded, column, row)) / per_rad
        assert observed == pytest.approx(sigma_rad, rel=0.03)
        assert np.nanmedian(decoded.sigma_column) / per_rad == pytest.approx(observed, rel=0.05)


def test_gamma_makes_ripples_as_its_harmonics_say():
    """Largest error in rad of ((1 + cos phi)/2)^g: a table from its Fourier series."""
    phase = np.linspace(0.0, 2 * np.pi, 4000)[None]
    table = {
        1.1: {3: 0.030, 4: 0.0058, 5: 0.0019, 8: 0.0002},
        1.5: {3: 0.139, 4: 0.0142, 5: 0.0035, 8: 0.0003},
        2.2: {3: 0.291, 4: 0.0106, 5: 0.0013, 8: 4e-5},
    }
    for gamma, by_steps in table.items():
        for steps, largest in by_steps.items():
            codec = vs.PhaseShift(size_px=(16, 1), steps=steps, periods_px=(16,), axes="u")
            images = (seen(codec, 16.0 * phase / (2 * np.pi) - 0.5, phase, 0.5, 0.5)) ** gamma
            decoded = codec.decode(images, edges=False)
            error = decoded.phase["u"] - phase
            error = np.abs((error + np.pi) % (2 * np.pi) - np.pi).max()
            digits = 0.5 * 10.0 ** np.floor(np.log10(largest)) / (10 if largest > 0.01 else 1)
            assert error == pytest.approx(largest, rel=0.02, abs=digits), (gamma, steps)


def test_wrong_orders_are_as_frequent_as_the_formula_says():
    """P = erfc(pi/(sqrt(2) sigma sqrt(1 + r^2))), of periods of ratio r: 0.0012 for r = 8, 0.12.

    So it is for phases with normal errors.  Those of noisy images have longer tails: 0.0015.
    """
    rng = np.random.default_rng(4)
    column, row = places(500, 800, (128, 80))
    codec = vs.PhaseShift(size_px=(128, 80), periods_px=(16, 128), axes="u")
    turns = np.stack([((column + 0.5) / period) for period in (16.0, 128.0)])
    for ratio in (2.0, 8.0):
        assert hierarchical((16.0, 16.0 * ratio)).gains == pytest.approx([np.hypot(1.0, ratio)])
    inner = (column > 12.0) & (column < 116.0)  # at the borders a period follows the last
    for sigma_rad, formula in ((0.12, 0.0012), (0.16, None), (0.2, None)):
        normal = erfc(np.pi / (np.sqrt(2.0) * sigma_rad * np.sqrt(65.0)))
        assert formula is None or normal == pytest.approx(formula, rel=0.03)
        noisy = (turns + rng.normal(0.0, sigma_rad / (2 * np.pi), turns.shape)) % 1.0
        length, _ = hierarchical((16.0, 128.0)).orders(list(noisy.astype(np.float32)), 128)
        wrong = np.mean(np.abs(length * 16.0 - 0.5 - column)[inner] > 8.0)
        assert wrong == pytest.approx(normal, rel=0.1), sigma_rad
        expected = codec.wrong_order(sigma_rad)
        assert 1.05 * normal < expected < 1.4 * normal
        noise = sigma_rad * 80.0 / np.sqrt(0.5)
        images = seen(codec, column, row)
        images = images + rng.normal(0.0, noise, images.shape)
        decoded = codec.decode(images, noise=noise, most_disagreement=1.0, edges=False)
        wrong = np.mean(np.abs(decoded.column - column)[inner & decoded.ok] > 8.0)
        assert wrong == pytest.approx(expected, rel=0.1), sigma_rad
        assert decoded.wrong_orders == pytest.approx(expected, rel=0.15)
        assert "wrong fringe order" in decoded.notes[0]
        sieved = codec.decode(images, noise=noise, edges=False)
        assert np.mean(np.abs(sieved.column - column)[inner & sieved.ok] > 8.0) < 0.5 * expected


def test_pixels_that_stand_alone_have_wrong_orders_too():
    """Rationale: where no neighbour is decoded, a pixel's own sigma tells."""
    codec = vs.PhaseShift(axes="u")
    images = seen(codec, *places(60, 60))
    lone = np.zeros((60, 60), bool)
    lone[::3, ::3] = True
    images[:, ~lone] = np.nan
    decoded = codec.decode(images, noise=15.0, edges=False)
    whole = codec.decode(seen(codec, *places(60, 60)), noise=15.0, edges=False)
    assert np.array_equal(decoded.ok, lone)
    assert decoded.wrong_orders == pytest.approx(whole.wrong_orders, rel=0.1)
    assert whole.wrong_orders > 1e-3


def test_what_moves_between_the_steps_makes_a_ripple_of_twice_the_phase():
    """Dphi = (1/N) sum e_k (1 - cos(2 phi - 2 theta_k)), to first order in the shifts e_k."""
    phase = np.linspace(0.3, 6.0, 500)[None]
    shift = 0.02 * np.random.default_rng(5).normal(size=6)
    angle = 2 * np.pi * np.arange(6) / 6
    codec = vs.PhaseShift(size_px=(16, 1), steps=6, periods_px=(16,), axes="u")
    images = np.stack([1.0 + np.cos(phase + e - a) for e, a in zip(shift, angle, strict=True)])
    error = codec.decode(images, edges=False).phase["u"] - phase
    ripple = [e * (1.0 - np.cos(2 * phase - 2 * a)) for e, a in zip(shift, angle, strict=True)]
    assert np.abs(error - np.mean(ripple, axis=0)).max() < 0.05 * np.abs(error).max()


def test_each_pixel_says_why_it_has_no_coordinate():
    column, row = places()
    codec = vs.PhaseShift()
    images = seen(codec, column, row)
    images[:, 10:30, 10:40] = 0.0  # a shadow
    images[:, 40:60, 10:40] = 100.0  # other light alone
    images[3, 70:80, 20:30] = 255.0
    images[5, 90, 50] = np.nan
    images[3, 95, 50], images[15, 95, 50] = 255.0, np.nan
    images[12:, 85:93, 10:30] = 100.0 + 0.01 * (images[12:, 85:93, 10:30] - 100.0)  # rows alone
    step = column.copy()
    step[:, 100:] += 7.3  # a step of the surface
    images[:, :, 99:] = seen(codec, step, row)[:, :, 99:]
    images[:12, 100:110, 60:64] = seen(codec, column + 40.0, row)[:12, 100:110, 60:64]
    images[4:8, 100:110, 60:64] = seen(codec, column, row)[4:8, 100:110, 60:64]
    for some in (np.s_[:4, 112:, 60:70], np.s_[:4, 112:, 71:80]):  # but for a strip up to the end
        images[some] = seen(codec, column + 40.0, row)[some]
    decoded = codec.decode(images, saturation=255.0)
    status = decoded.status
    assert (status[11:29, 11:39] == vs.FringeStatus.BLACK).all()
    assert (status[41:59, 11:39] == vs.FringeStatus.LOW_MODULATION).all()
    assert (status[9, 9:41] == vs.FringeStatus.EDGE).all()
    assert (status[70:80, 20:30] == vs.FringeStatus.SATURATED).all()
    assert status[90, 50] == status[95, 50] == vs.FringeStatus.NOT_FINITE
    assert (status[86:92, 11:29] == vs.FringeStatus.LOW_MODULATION).all()
    assert (status[:8, 99:101] == vs.FringeStatus.EDGE).all()
    assert (status[101:109, 61:63] == vs.FringeStatus.ORDER).all()
    assert (status[113:, 70] == vs.FringeStatus.EDGE).all()
    assert (status[:8, 102:150] == OK).all()
    for values in (decoded.column, decoded.row, decoded.sigma_column, decoded.sigma_row):
        assert np.array_equal(np.isfinite(values), status == OK)
    beyond = codec.decode(seen(codec, column, row + 300.0))
    assert (beyond.status[row > 510.0] == vs.FringeStatus.OUTSIDE).all()
    bordered = codec.decode(seen(codec, column, row), border_px=20.0)
    middle = (np.abs(row - 399.5) < 380.0) & (np.abs(column - 639.5) < 620.0)
    assert np.array_equal(bordered.ok, middle)
    shaded = codec.decode(images + 50.0, black=50.0).status
    assert (shaded[11:29, 11:39] == vs.FringeStatus.BLACK).all()
    faint = seen(codec, column, row, amplitude=1.0)  # and beside no stronger ones
    assert not codec.decode(faint, noise=5.0).ok.any()


def test_between_two_steps_nothing_is_sure():
    """Rationale: of one good pixel between two edges no neighbour says whether it is one."""
    column, row = places()
    column[:, 100:] += 7.3
    column[:, 103:] += 7.3
    status = vs.PhaseShift().decode(seen(vs.PhaseShift(), column, row)).status
    assert (status[:, 99:104] == vs.FringeStatus.EDGE).all()
    assert (status[:, 105:150] == OK).all()


def test_gray_code_knows_its_noise_and_what_is_clipped():
    column, row = places()
    rng = np.random.default_rng(8)
    for text, seen_noise in (("gray uv", 1.5), ("gray u single", 0.0)):
        codec = vs.codec_of(text)
        images = seen(codec, column, row)
        images = images + rng.normal(0.0, 1.5, images.shape)
        images[4:6, 10:20, 10:20] = 255.0
        decoded = codec.decode(images, saturation=255.0)
        assert decoded.noise == pytest.approx(seen_noise, rel=0.05)
        assert np.median(decoded.modulation) == pytest.approx(80.0, rel=0.04)
        clipped = decoded.status[10:20, 10:20] == vs.FringeStatus.SATURATED
        assert clipped.all() == (text == "gray uv")  # a single bit of two is decoded


def test_gray_code_that_does_not_fit_the_phase_is_named():
    """Rationale: a part that moved in between by 6 px gives some pixels the period beside."""
    column, row = places()
    codec = vs.codec_of("phase 4 16 u gray")
    images = seen(codec, column, row)
    images[4:] = seen(codec, column + 6.0, row)[4:]
    decoded = codec.decode(images, edges=False)
    assert 0.3 < np.mean(decoded.status == vs.FringeStatus.ORDER) < 0.7
    assert np.abs(decoded.column - column)[decoded.ok].max() < 1e-4


def test_one_image_scatters_as_it_says():
    """Noise on one image, beside the same without: what the window lets through."""
    v, u = np.mgrid[:200, :160].astype(float)
    column = 300.0 + 4.8 * u + 0.02 * v
    codec = vs.codec_of("single 16 u")
    images = seen(codec, column, column)
    noise = np.random.default_rng(9).normal(0.0, 2.0, images.shape)
    noisy = images + noise
    noisy[0, 3, 4] = np.nan
    decoded = codec.decode(noisy, noise=2.0)
    inner = np.s_[20:-20, 20:-20]  # beside what the missing pixel spoils
    scatter = np.std((decoded.column - codec.decode(images, noise=0.0).column)[inner])
    assert np.nanmedian(decoded.sigma_column) == pytest.approx(scatter, rel=0.15)
    assert np.median(decoded.modulation[inner]) == pytest.approx(80.0, rel=0.02)
    assert decoded.status[3, 4] == vs.FringeStatus.NOT_FINITE
    wide = vs.codec_of("single 256 u")  # whose own second differences are small
    assert wide.decode(seen(wide, column, column) + noise).noise == pytest.approx(2.0, rel=0.1)


def test_images_may_come_as_they_are():
    """Expected behaviour: lists, integers, masks, one row, and images without any fringe."""
    column, row = places(7, 9)
    codec = vs.PhaseShift(axes="u")
    images = seen(codec, column, row)
    assert codec.decode(list(images)).ok.all()
    assert codec.decode(np.rint(images).astype(np.int32)).ok.all()
    assert codec.decode(images[:, :1]).ok.all()
    hidden = np.ma.MaskedArray(images, np.zeros(images.shape, bool))
    hidden[2, 3, 4] = np.ma.masked
    assert codec.decode(hidden).status[3, 4] == vs.FringeStatus.NOT_FINITE
    for blank in (np.zeros_like(images), np.full_like(images, np.nan), np.full_like(images, 7.0)):
        assert not codec.decode(blank).ok.any()
        assert not vs.codec_of("single 16 u").decode(blank[:1]).ok.any()
        assert not vs.codec_of("gray u").decode(np.repeat(blank[:1], 22, 0)).ok.any()
    camera = vs.ImageSensor()
    grey = np.rint(images + camera.black_level).astype(np.uint16)
    grey[2, 3, 4] = camera.white
    decoded = codec.decode(grey, sensor=camera)
    assert decoded.noise == pytest.approx(0.37 * 2.4)
    assert decoded.status[3, 4] == vs.FringeStatus.SATURATED


def test_what_cannot_be_decoded_is_refused():
    for options, words in (
        (
            {"periods_px": (16, 128)},
            "longest, 128 px, is shorter than the image's 1280 columns",
        ),
        ({"periods_px": (16, 17), "unwrap": "heterodyne"}, "no beat of 16, 17 px is as long"),
        ({"periods_px": (16, 128), "unwrap": "gray"}, "takes one period"),
        ({"periods_px": (16, 16, 1280)}, "is there twice"),
        ({"periods_px": (1.0, 1280)}, "periods from 2 px on"),
        ({"steps": 2}, "steps must be a whole number from 3"),
        ({"axes": "w"}, "axes is 'w'"),
        ({"size_px": 5}, "size_px is 5"),
        ({"unwrap": "spacial"}, "did you mean 'spatial'"),
    ):
        with pytest.raises(InputError, match=words):
            vs.PhaseShift(**options)
    for text, words in (
        ("fase 4", "did you mean 'phase'"),
        ("phase 4 16 16", "more than"),
        ("gray 4", "no numbers"),
        ("phase 4 uv u", "'u' after 'uv'"),
    ):
        with pytest.raises(InputError, match=words):
            vs.codec_of(text)
    codec = vs.PhaseShift(axes="u")
    with pytest.raises(InputError, match="11 images, but 'phase 4 16,128,1280 u' has 12 patterns"):
        codec.decode(np.zeros((11, 4, 5)))
    with pytest.raises(InputError, match="of different sizes"):
        codec.decode([np.zeros((4, 5))] * 11 + [np.zeros((5, 4))])


def test_a_projectors_square_pixels_are_no_edges():
    """Rationale: their steps are everywhere; without noise each would look like a part's edge."""
    v, u = np.mgrid[:80, :120]
    smooth = 300.0 + 0.37 * u + 0.05 * v + 20.0 * (u >= 70)
    codec = vs.PhaseShift(axes="u")
    for samples in (1, 2, 4):
        of_each = [np.rint(smooth + 0.37 * (k + 0.5) / samples) for k in range(samples)]
        images = np.mean([seen(codec, each, each) for each in of_each], axis=0)
        decoded = codec.decode(images)
        assert decoded.ok[:, :69].all()
        assert decoded.ok[:, 71:].all()
        assert (decoded.status[:, 69:71] == vs.FringeStatus.EDGE).all()
