"""Lines over edges of the reflectance, drawn finely and blurred numerically, of known truth."""

import numpy as np
import pytest
from artificial import line_image
from scipy.ndimage import gaussian_filter1d

import virtual_sensor as vs
from virtual_sensor.metrology import line_peaks
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.detectors import COLUMNWISE
from virtual_sensor.metrology.edge_fits import ROW, Window, _variances, fit_edge, modelled
from virtual_sensor.metrology.line_peaks import line_centres

FINE = 16
NEAR = 4.0  # sigma from the edge: columns that are an edge's


def over_edge(sigma, ratio, *, blur=0.3, far=5.0, near=-5.0, width=400, height=72, slope=0.02):
    """A line that a lens blurs, over an edge that crosses it slowly: image, rows, sigmas to it.

    The reflectance is 1 below the edge and 1/ratio above it; `blur` is that of the lens in px,
    `sigma` the line's with it.
    """
    u = np.arange(width)
    row = height / 2.0 + slope * (u - width / 2.0)
    away = np.interp(u, [0.15 * width, 0.85 * width], [far, near])
    v = ((np.arange(height * FINE) + 0.5) / FINE - 0.5)[:, None]
    lit = np.exp(-0.5 * (v - row) ** 2 / (sigma**2 - blur**2))
    bright = np.clip((v - row - away * sigma) * FINE + 0.5, 0.0, 1.0)
    lit *= (1.0 / ratio + (1.0 - 1.0 / ratio) * bright) * sigma / np.sqrt(sigma**2 - blur**2)
    image = gaussian_filter1d(lit, blur * FINE, axis=0)
    return image.reshape(height, FINE, width).mean(axis=1), row, away


def noisy(image, noise, seed=0, **_):
    return image + np.random.default_rng(seed).normal(0.0, noise, image.shape)


def assert_right(line, row, away, case):
    """As the centres of an edge's columns are to be: found, right, and as sure as they are."""
    near = np.abs(away) < NEAR
    found = line.found & near
    error = np.abs(line.row - row)[found]
    assert found.sum() > 0.9 * near.sum(), case
    assert np.mean(error < 3.0 * line.sigma[found]) > 0.98, case
    actual = max(np.sqrt(np.mean(error**2)), np.median(error) / 0.6745)
    assert np.median(line.sigma[found]) < 2.0 * actual, case
    assert np.mean(line.status[np.abs(away) < 2.0] == Status.CORRECTED) > 0.85, case


def test_centres_over_an_edge_are_right_or_say_so():
    """From 2:1 to 10:1, sharp or blurred by the lens, the noise given or not; and upside down."""
    cases = (
        (2.0, 2.0, 0.3, 0.01, False),
        (2.0, 2.0, 1.0, 0.01, True),
        (2.0, 10.0, 1.0, 0.003, False),
        (3.0, 10.0, 0.5, 0.01, True),
    )
    for case in cases:
        sigma, ratio, blur, noise, given = case
        image, row, away = over_edge(sigma, ratio, blur=blur)
        image = noisy(image, noise)
        line = line_centres(image, **({"noise": noise} if given else {}))
        assert_right(line, row, away, case)
    turned = line_centres(image[::-1], noise=noise)
    both = line.found & turned.found
    assert both.mean() > 0.98
    np.testing.assert_allclose(71.0 - turned.row[both], line.row[both], atol=0.2)


def test_it_does_not_depend_on_the_detector_nor_on_the_direction_of_the_search():
    image, _, away = over_edge(2.0, 10.0)
    image = noisy(image, 0.01)
    one = line_centres(image)
    for method in ("centre_of_gravity", "parabola"):
        line = line_centres(image, method)
        corrected = (line.status == Status.CORRECTED) & (one.status == Status.CORRECTED)
        assert corrected.sum() > 0.85 * np.sum(np.abs(away) < 2.0), method
        np.testing.assert_allclose(line.row[corrected], one.row[corrected], atol=0.05)
    rows = line_centres(np.ascontiguousarray(image.T), along="rows")
    np.testing.assert_allclose(rows.column, one.row, atol=1e-6)
    np.testing.assert_array_equal(rows.status, one.status)


@pytest.mark.slow
def test_a_rendered_part_with_a_painted_edge():
    """Round, so that the line bends, and grazed by the edge; the truth is the plain part's line."""
    size = {"width": 512, "height": 512, "line_radius": 0.5, "spp": 16}
    truth = line_centres(vs.render(vs.load_scene("cold_cylinder", **size)))
    paint = {"material": "painted_edge", "edge_angle": 3, "dark_reflectance": 0.25}
    image = vs.render(vs.load_scene("cold_cylinder", **paint, **size))
    line = line_centres(noisy(image, 0.005 * image.max()))
    there = truth.found & line.found
    assert there.sum() > 0.98 * truth.found.sum()
    assert np.sum(line.status == Status.CORRECTED) > 150
    error = np.abs(line.row - truth.row)[there]
    assert np.mean(error < 3.0 * line.sigma[there]) > 0.98
    assert np.sqrt(np.mean(error**2)) < 0.05


@pytest.mark.slow
def test_shot_noise_speckle_and_whole_grey_values():
    """As cameras have them: the noise that the residuals show is the one that counts."""
    image, row, away = over_edge(1.5, 4.0)
    assert_right(line_centres(noisy(image, 0.03)), row, away, "narrow, and much noise")
    image, row, away = over_edge(2.5, 5.0, width=600)
    rng = np.random.default_rng(2)
    electrons = rng.poisson(4000.0 * image) + rng.normal(0.0, 5.0, image.shape)
    assert_right(line_centres(electrons, noise=5.0, gain=1.0), row, away, "shot noise")
    assert_right(line_centres(electrons), row, away, "shot noise, unknown")
    grey = np.rint(200.0 * image + rng.normal(10.0, 1.0, image.shape)).astype(np.uint8)
    assert_right(line_centres(grey), row, away, "8 bits")
    grains = gaussian_filter1d(rng.gamma(8.0, 1.0 / 8.0, image.shape), 0.4, axis=0)
    assert_right(line_centres(noisy(image * grains, 0.005)), row, away, "speckle")


def test_an_edge_along_the_whole_line():
    """Without columns that show the line's own width; it comes near and goes away again."""
    image, row, away = over_edge(2.0, 4.0, far=1.0, near=-1.0)
    image = noisy(image, 0.003)
    assert_right(line_centres(image), row, away, "all along")


def test_what_is_no_edge_is_not_corrected():
    """A second line, a step of the background, a cut, a skewed profile, a stripe, or nothing."""
    u, v = np.arange(400), np.arange(72)[:, None]
    row = 36.0 + 0.01 * u
    line = line_image(row, 2.0, height=72)
    crossing = row + np.linspace(-15.0, 15.0, u.size)
    z = (v - row) / 2.0
    others = {
        "second line beside it": line + line_image(row + 4.0, 2.0, 0.3 * np.ones(400), height=72),
        "second line across it": line + line_image(crossing, 2.0, 0.3 * np.ones(400), height=72),
        "step of the background": line + 0.3 * (v > crossing),
        "cut by an edge": line * (v < row + np.linspace(10.0, -2.0, u.size)),
        "lopsided": line * (1.0 + 0.06 * np.sin(u / 127.0) * (z**3 - 3.0 * z)),
        "thin line that wanders across it": line
        + line_image(row + np.linspace(-4.0, 4.0, u.size), 1.0, 0.3 * np.ones(400), height=72),
        "dark stripe": line * (1.0 - 0.7 * (np.abs(v - crossing) < 1.0)),
        "clean": line,
        "fading": line * np.exp(-u / 200.0),
    }
    for what, image in others.items():
        status = line_centres(noisy(image, 0.01)).status
        assert not np.any(status == Status.CORRECTED), what


def test_a_profile_that_hot_air_skews_through_a_lens_keeps_its_statuses(monkeypatch):
    """Rays through a wide pupil are off by the square of their place in it: no edge does that."""
    u, pupil = np.arange(400), np.linspace(-1.0, 1.0, 33)
    row, bent = 36.0 + 0.01 * u, 5.0 * np.sin(u / 40.0)
    image = np.mean([line_image(row + bent * x**2, 1.5, height=72) for x in pupil], axis=0)
    image[:, (u < 40) | (u > 360)] = 0.0
    images = image, noisy(image, 0.003)
    lines = [line_centres(each) for each in images]
    monkeypatch.setattr(line_peaks, "correct_edges", lambda *_: None)
    for line, each in zip(lines, images, strict=True):
        assert np.sum(line.status == Status.SKEWED) > 30
        np.testing.assert_array_equal(line.status, line_centres(each).status)


def test_clean_lines_are_as_they_were(monkeypatch):
    """To the last bit, for every detector."""
    row = 36.0 + 3.0 * np.sin(np.arange(300) / 60.0)
    image = noisy(line_image(row, 2.0, height=72), 0.01)
    lines = {method: line_centres(image, method) for method in COLUMNWISE}
    monkeypatch.setattr(line_peaks, "correct_edges", lambda *_: None)
    for method, line in lines.items():
        before = line_centres(image, method)
        for name in ("row", "sigma", "status"):
            np.testing.assert_array_equal(getattr(line, name), getattr(before, name), method)


def test_an_unresolved_trouble_makes_sigma_larger(monkeypatch):
    """A lopsided misfit of many columns that no edge explains: OK, and less sure."""
    row = 36.0 + 0.01 * np.arange(400)
    ghost = line_image(row + 3.0, 2.0, 0.15 * np.ones(400), height=72)
    image = noisy(line_image(row, 2.0, height=72) + ghost, 0.02)
    line = line_centres(image)
    monkeypatch.setattr(line_peaks, "correct_edges", lambda *_: None)
    before = line_centres(image)
    found = line.found & before.found
    assert found.sum() > 100
    error = np.abs(line.row - row)[found]
    assert np.mean(error > 3.0 * before.sigma[found]) > 0.5
    assert np.mean(error < 3.0 * line.sigma[found]) > 0.98


def test_the_model_is_the_blurred_line_and_has_its_centroid():
    """Drawn finely and blurred numerically; Curless and Levoy's shift of the centroid."""
    sigma, blur, ratio = 2.0, 0.8, 10.0
    image, row, away = over_edge(sigma, ratio, blur=blur, far=1.0, near=-1.0, slope=0.0, width=20)
    own_width = np.sqrt(sigma**2 - blur**2)
    place = row + away * sigma
    edge = (place * sigma**2 - row * blur**2) / own_width**2
    own = np.array([0 * row, 0 * row - 0.5 * np.log(ratio), row, 0 * row + np.log(sigma), edge])
    shared = np.log([ratio, np.sqrt((blur * sigma / own_width) ** 2 - 0.15**2)])
    rows = np.broadcast_to(np.arange(len(image))[:, None], image.shape)
    np.testing.assert_allclose(modelled(rows, own, shared)[0], image, atol=2e-3)
    middle = np.abs(away) < 0.05
    own[4] = row
    signal = modelled(rows, own, np.log([ratio, 1e-3]))[0]
    shift = (signal * rows).sum(axis=0) / signal.sum(axis=0) - row
    expected = sigma * np.sqrt(2.0 / np.pi) * (1.0 - 1.0 / ratio) / (1.0 + 1.0 / ratio)
    np.testing.assert_allclose(shift[~middle], expected, atol=0.02)


def test_derivatives_and_the_rows_variance_are_those_of_the_dense_problem():
    rng = np.random.default_rng(0)
    rows = np.arange(24)[:, None] + np.zeros((1, 7), int)
    own = np.array([np.zeros(7), np.zeros(7), 12.0 + rng.uniform(-0.5, 0.5, 7), np.full(7, 0.7)])
    own = np.vstack([own, 12.0 + np.linspace(-3.0, 3.0, 7)])
    shared = np.array([1.0, -0.3])
    _, by_own, by_shared = modelled(rows, own, shared)
    for which in range(1, 5):
        step = np.zeros_like(own)
        step[which] = 1e-5
        ends = (modelled(rows, own + sign * step, shared)[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(by_own[which], np.subtract(*ends) / 2e-5, atol=1e-8)
    for which in range(2):
        step = 1e-5 * np.eye(2)[which]
        ends = (modelled(rows, own, shared + sign * step)[0] for sign in (1.0, -1.0))
        np.testing.assert_allclose(by_shared[which], np.subtract(*ends) / 2e-5, atol=1e-8)

    band, border = np.zeros((11, 35)), rng.normal(size=(35, 2))
    dense = rng.normal(size=(35, 35))
    dense = dense @ dense.T
    apart = np.abs(np.subtract.outer(np.arange(35), np.arange(35)))
    dense = np.where(apart <= 10, dense, 0.0) + 80.0 * np.eye(35)
    for above in range(11):
        band[10 - above, above:] = np.diag(dense, above)
    corner = 50.0 * np.eye(2)
    found, of_ratio = _variances(band, border, corner)
    inverse = np.linalg.inv(np.block([[dense, border], [border.T, corner]]))
    np.testing.assert_allclose(found, np.diag(inverse)[ROW:35:5])
    assert of_ratio == pytest.approx(inverse[35, 35])


def test_a_fit_from_afar_comes_to_the_truth():
    image, row, away = over_edge(2.0, 3.0, width=120)
    rows = np.rint(row).astype(int) + np.arange(-11, 12)[:, None]
    values = noisy(image, 0.003)[rows, np.arange(120)]
    own = np.array([0 * row, 0 * row, row + 0.5, 0 * row + np.log(2.2), row + 2.0 * away + 1.0])
    window = Window(rows, values, np.ones(rows.shape, bool))
    fit = fit_edge(window, own, np.log([1.8, 0.5]), np.full(rows.shape, 0.003**2))
    assert np.exp(fit.shared[0]) == pytest.approx(3.0, rel=0.02)
    error = (fit.own[ROW] - row) / fit.row_error
    assert np.sqrt(np.mean(error**2)) == pytest.approx(1.0, abs=0.3)


def test_a_fit_of_noise_that_is_said_to_have_none_fails_without_an_error():
    """Rationale: rounding makes the normal matrix indefinite, which Cholesky's method refuses."""
    rows = np.arange(15)[:, None] + np.zeros(24, int)
    values = np.random.default_rng(0).normal(size=rows.shape)
    own = np.repeat([[0.0], [0.0], [7.0], [9.0], [7.5]], 24, axis=1)
    window = Window(rows, values, np.ones(rows.shape, bool))
    fit = fit_edge(window, own, np.array([1.0, 0.0]), np.full(rows.shape, 1e-30))
    assert np.isinf(fit.ratio_error)
    assert np.isinf(fit.row_error).all()
