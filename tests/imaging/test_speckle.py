"""Speckle against Goodman's statistics, the incoherent image, and the height noise it makes."""

from dataclasses import replace

import numpy as np
import pytest
from artificial import dot_image, line_image
from scipy.integrate import dblquad
from scipy.special import j1, jv, kolmogorov

from virtual_sensor.errors import InputError
from virtual_sensor.imaging import speckle
from virtual_sensor.imaging.image_blur import defocus_blur
from virtual_sensor.imaging.speckle import (
    Aperture,
    broad_line_noise_px,
    diffraction_blur,
    speckled,
)


def slow(*values):
    """Parameters of a case that the default suite leaves out."""
    return pytest.param(*values, marks=pytest.mark.slow)


def airy(x):
    """|2 J1(pi x)/(pi x)|^2 of distances in lambda N."""
    x = np.where(np.abs(x) < 1e-9, 1e-9, x) * np.pi
    return (2.0 * j1(x) / x) ** 2


def transfer(x):
    """Incoherent transfer function of a round aperture, of frequencies in 1/(lambda N)."""
    x = np.clip(x, 0.0, 1.0)
    return 2.0 / np.pi * (np.arccos(x) - x * np.sqrt(1.0 - x**2))


def dorsch_limit_um(contrast, wavelength_nm, observation_aperture, triangulation_deg):
    """Height noise of a laser spot that is broad beside the grains, in um, whatever its size.

    delta z = C lambda/(2 pi sin(u_obs) sin(theta)): Dorsch, Hausler and Herrmann 1994, "Laser
    triangulation: fundamental uncertainty in distance measurement", Appl. Opt. 33, 1306.  C is the
    speckle's contrast before the pixels integrate it, sin(u_obs) the aperture on the side of the
    object, m/(2 N (1 + m)) at magnification m, theta the angle between the two axes.

    For the spot's centre of gravity the model here gives var(x) = C^2 A integral of x^2 I^2 over
    (integral of I)^2, with the grains' area A = (4/pi)(lambda N)^2 (Goodman 2007, 4.6).  An evenly
    lit disc of radius R has A/(4 pi), R falling out: with sin(u) = 1/(2 N), Dorsch's formula to the
    factor.  A round Gaussian spot has A/(8 pi), 1/sqrt(2) of the formula's noise.  A spot or line
    thin beside the diffraction has *less*, in proportion to its width: a point's image is Airy's,
    which is nowhere but in its place.  A long line has more than a spot of its width, as each
    column is measured alone: `broad_line_noise_px`.
    """
    sine = np.sin(np.radians(triangulation_deg))
    return contrast * wavelength_nm * 1e-3 / (2.0 * np.pi * observation_aperture * sine)


def with_grain(grain_px, **others):
    """Aperture whose grain has this radius."""
    return Aperture(grain_px / Aperture(1.0).grain_px, **others)


def scatter_of_contrast(aperture, size):
    """Relative standard error of a contrast measured on `size` pixels.

    1/sqrt(M) for M independent exponential values, less for milder laws; a value is as long as the
    area of the covariance, (4/pi)(lambda N)^2 whatever the pixel, over the variance.
    """
    area = 4.0 / np.pi * aperture.resolution_px**2 / aperture.polarisations
    return np.sqrt(max(area / aperture.contrast**2, 1.0) / size)


def correlation(grey, lags):
    """Correlation of the grey values' deviations along the rows, relative to the squared mean."""
    relative = grey / grey.mean() - 1.0
    return [np.mean(relative[:, : grey.shape[1] - k] * relative[:, k:]) for k in range(lags)]


@pytest.mark.parametrize("grain_px", [0.5, 1.0, 2.0, slow(6.0)])
def test_contrast_of_even_light_is_what_aperture_and_pixel_make_it(grain_px):
    """Theory by a double integral over the pixel; measured to four standard errors."""
    aperture = with_grain(grain_px)
    n = aperture.resolution_px
    expected, _ = dblquad(
        lambda y, x: 4.0 * (1.0 - x) * (1.0 - y) * airy(np.hypot(x, y) / n), 0, 1, 0, 1
    )
    assert aperture.contrast == pytest.approx(np.sqrt(expected), rel=1e-3)
    shape = (500, 900) if grain_px > 4.0 else (300, 500)
    grey = speckled(np.full(shape, 3.0), aperture, seed=1)
    error = scatter_of_contrast(aperture, grey.size)
    assert error < 0.01
    assert grey.std() / grey.mean() == pytest.approx(aperture.contrast, rel=4.0 * error)
    assert grey.mean() == pytest.approx(3.0, rel=4.0 * error)


def test_light_that_is_depolarised_has_less_contrast():
    """Two patterns that add: 1/sqrt(2) of it."""
    both = Aperture(16.0, polarisations=2)
    assert both.contrast == pytest.approx(Aperture(16.0).contrast / np.sqrt(2.0))
    grey = speckled(np.ones((300, 500)), both, seed=2)
    error = scatter_of_contrast(both, grey.size)
    assert grey.std() / grey.mean() == pytest.approx(both.contrast, rel=4.0 * error)
    assert grey.mean() == pytest.approx(1.0, rel=4.0 * error)


def test_large_grains_are_distributed_as_fully_developed_speckle():
    """Kolmogorov and Smirnov, three grains apart: exponential; not so with two polarisations."""
    apart = 18
    for polarisations, side, likely in ((1, 504, True), (2, 456, False)):
        aperture = with_grain(6.0, polarisations=polarisations)
        grey = speckled(np.ones((side, side)), aperture, seed=3)[::apart, ::apart].ravel()
        below = np.arange(grey.size + 1) / grey.size
        expected = 1.0 - np.exp(-np.sort(grey))
        distance = np.max(np.maximum(below[1:] - expected, expected - below[:-1]))
        probability = kolmogorov(np.sqrt(grey.size) * distance)
        assert probability > 0.01 if likely else probability < 1e-6


@pytest.mark.parametrize("grain_px", [1.9, slow(6.0)])
def test_grains_are_correlated_as_a_round_aperture_makes_them(grain_px):
    """Goodman 2007, 4.4: |2 J1/x|^2, here averaged over both pixels."""
    aperture = with_grain(grain_px)
    grey = speckled(np.ones((500, 500)), aperture, seed=4)
    fine = np.arange(-64, 65) / 64.0
    triangle = 1.0 - np.abs(fine)
    weight = np.outer(triangle, triangle)
    error = 2.0 * scatter_of_contrast(aperture, grey.size)  # of the variance
    measured = correlation(grey, 16)
    for lag in range(16):
        x, y = np.meshgrid(fine + lag, fine)
        expected = (weight * airy(np.hypot(x, y) / aperture.resolution_px)).sum() / weight.sum()
        assert measured[lag] == pytest.approx(expected, abs=4.0 * error)


@pytest.mark.slow
def test_the_public_package_pyspeckle_agrees_on_the_grains(monkeypatch):
    """Its patterns, made by another method, by its own estimators: contrast and correlation."""
    pyspeckle = pytest.importorskip("pyspeckle", reason="pip install '.[test]'")
    size, resolution = 300, 6  # pixels, pixels per lambda N
    drawn = np.random.RandomState(5).rand
    monkeypatch.setattr(np.random, "rand", drawn)  # theirs takes no seed
    theirs = pyspeckle.create_Exponential(size, resolution, shape="ellipse")
    ours = speckled(np.ones((size, size)), Aperture(resolution * 5.5 / 0.532), seed=5)

    def measured(grey):
        _, contrast = pyspeckle.local_contrast_2D(grey, np.ones((3, 3)))
        rows = [pyspeckle.autocorrelation(row) for row in grey]
        return contrast, np.mean(rows, axis=0)[:12]

    (contrast, along), (their_contrast, their_along) = measured(ours), measured(theirs)
    error = np.sqrt(2.0) * scatter_of_contrast(Aperture(resolution * 5.5 / 0.532), size**2)
    assert contrast == pytest.approx(their_contrast, rel=4.0 * error)
    np.testing.assert_allclose(along, their_along, atol=4.0 * error)


@pytest.mark.parametrize(
    ("f_number", "width"), [(5.6, 0.5), slow(5.6, 1.5), slow(16.0, 0.5), slow(16.0, 1.5)]
)
def test_the_mean_of_many_frames_is_the_incoherent_image(f_number, width):
    """The line blurred by diffraction and integrated once: neither broadened, shifted nor dimmed.

    Truth from a line drawn 32 times finer, through the aperture's incoherent transfer function.
    """
    aperture = Aperture(f_number)
    height, fine, centre = 60, 32, 30.3
    frames = 10 if f_number < 10.0 else 40
    image = line_image(np.full(800, centre), width, 100.0, height=height)
    rows = np.array([speckled(image, aperture, seed).mean(axis=1) for seed in range(frames)])
    drawn = line_image(centre * fine + (fine - 1) / 2.0, width * fine, 1.0, height=height * fine)
    frequency = np.fft.rfftfreq(4 * drawn.size) * fine
    passed = transfer(frequency * aperture.resolution_px)
    seen = np.fft.irfft(np.fft.rfft(drawn[:, 0], 4 * drawn.size) * passed)[: drawn.size]
    seen = seen.reshape(height, fine).sum(axis=1) * image[:, 0].sum() / drawn.sum()
    error = rows.std(axis=0) / np.sqrt(frames)
    np.testing.assert_allclose(rows.mean(axis=0), seen, atol=4.5 * error.max() + 0.03 * seen.max())
    assert rows.sum(axis=1).mean() == pytest.approx(seen.sum(), rel=0.01)


def test_windows_show_no_seams(monkeypatch):
    """Memory's limit may cut the frame where it will: the surface is the same.

    Of another surface the image would differ by 1.2 rms.
    """
    aperture, image = Aperture(16.0), np.ones((120, 300))
    whole = speckled(image, aperture, seed=7)
    for name in ("_WINDOW", "_MOST_SAMPLES"):
        monkeypatch.setattr(speckle, name, 1)
    cut = speckled(image, aperture, seed=7)
    assert np.abs(cut - whole).max() > 0.0
    assert np.sqrt(np.mean((cut - whole) ** 2)) < 0.2  # 1 % of the light: from beyond the apron


def test_a_surface_at_rest_keeps_its_scatterers_whatever_light_falls_on_it():
    """A crossing line, another window or one thread: the pixels lit as before look as before."""
    aperture, line = Aperture(16.0), line_image(np.full(700, 30.0), 3.0, height=200)
    alone = speckled(line, aperture, 8)
    crossed = line.copy()
    crossed[:, 600:620] += line.max()
    shorter = line.copy()
    shorter[:, :5] = 0.0
    for other, far in ((crossed, slice(0, 540)), (shorter, slice(60, 700))):
        change = (speckled(other, aperture, 8) - alone)[:, far]
        assert np.abs(change).max() < 0.2 * line.max()
        assert change.std() < 0.02 * alone[:, far].std()


def test_the_number_of_threads_changes_no_bit(monkeypatch):
    """Each window is a thing of its own."""
    image = line_image(np.full(700, 30.0), 3.0, height=60)
    many = speckled(image, Aperture(16.0), 5)
    monkeypatch.setattr(speckle, "_AT_ONCE", 1)
    assert speckled(image, Aperture(16.0), 5).tobytes() == many.tobytes()


def test_lines_along_rows_and_columns_are_equally_noisy():
    """Windows lie across the longer side, whichever it is."""
    aperture, image = Aperture(16.0), line_image(np.full(4000, 30.0), 3.0, height=60)
    flat, upright = speckled(image, aperture, 8), speckled(image.T, aperture, 8).T
    assert np.corrcoef(flat.ravel(), upright.ravel())[0, 1] < 0.9
    for row in (28, 32):
        assert flat[row].mean() == pytest.approx(upright[row].mean(), rel=0.06)
        assert flat[row].std() == pytest.approx(upright[row].std(), rel=0.12)


def test_wavelengths_that_see_depth_have_the_contrast_of_waves_added_one_by_one():
    """Scatterers at random depths, lines of a spectrum, both drawn: nothing of the formula."""
    rng = np.random.default_rng(3)
    depth_um, linewidth_nm, wavelength_nm = 20.0, 2.0, 660.0
    lines = rng.normal(wavelength_nm, linewidth_nm / 2.3548, 60)
    heights = rng.normal(0.0, depth_um, (1500, 60))
    power = np.zeros(len(heights))
    for line in lines:  # light goes down and up
        waves = np.exp(4j * np.pi * heights / (line * 1e-3)).sum(axis=1)
        power += np.abs(waves) ** 2 / (lines.size * heights.shape[1])
    measured = power.std() / power.mean()
    aperture = Aperture(1000.0, wavelength_nm, linewidth_nm=linewidth_nm, roughness_um=depth_um)
    assert 0.6 < measured < 0.9
    assert aperture.contrast == pytest.approx(measured, rel=0.05)


def test_patterns_that_add_lower_the_contrast_and_leave_the_grains():
    """A number of patterns that is not whole, too."""
    coherent = with_grain(2.0)
    part = with_grain(2.0, modes=1.3, polarisations=2)
    assert part.patterns == pytest.approx(2.6)
    assert part.contrast == pytest.approx(coherent.contrast / np.sqrt(2.6))
    fully, partly = (speckled(np.ones((400, 500)), each, seed=4) for each in (coherent, part))
    error = scatter_of_contrast(coherent, fully.size)
    assert partly.std() / partly.mean() == pytest.approx(part.contrast, rel=4.0 * error)
    assert partly.mean() == pytest.approx(1.0, rel=4.0 * error)
    along, other = (np.divide(correlation(grey, 4), grey.var()) for grey in (fully, partly))
    np.testing.assert_allclose(along, other, atol=8.0 * error)


def test_defocus_blurs_the_mean_and_leaves_the_grains_of_even_light():
    """The coherent image of a point out of focus is a disc, but for its diffraction."""
    aperture, radius = Aperture(5.6), 6.0
    even = speckled(np.ones((400, 500)), aperture, 1, blur_px=radius)
    sharp = speckled(np.ones((400, 500)), aperture, 1)
    error = scatter_of_contrast(aperture, even.size)
    assert even.std() == pytest.approx(sharp.std(), rel=6.0 * error)
    along, other = (np.divide(correlation(grey, 4), grey.var()) for grey in (even, sharp))
    np.testing.assert_allclose(along, other, atol=8.0 * error)
    line = line_image(np.full(2000, 30.0), 1.0, height=60)
    profile = np.mean([speckled(line, aperture, k, radius).mean(axis=1) for k in range(4)], axis=0)
    rows = np.arange(60) - 30.0
    of_disc = np.sqrt(np.maximum(radius**2 - rows**2, 0.0))
    seen = np.convolve(line[:, 0], of_disc / of_disc.sum())[30:90]
    np.testing.assert_allclose(profile, seen, atol=0.08 * seen.max())


@pytest.mark.parametrize(("f_number", "width"), [(8.0, 4.0), slow(16.0, 8.0), slow(4.0, 3.0)])
def test_a_broad_lines_centre_of_gravity_is_as_noisy_as_its_grains_are_few(f_number, width):
    """No detector of the package is in this: sums over the columns of 4,000 columns."""
    aperture = Aperture(f_number)
    height = int(16 * width)
    image = line_image(np.full(4000, height / 2.0), width, 100.0, height=height)
    grey = speckled(image, aperture, seed=6)
    v = np.arange(height)[:, None] - height / 2.0
    centre = (grey * v).sum(axis=0) / grey.sum(axis=0)
    assert centre.std() == pytest.approx(broad_line_noise_px(aperture, width), rel=0.06)


def test_a_line_of_large_grains_is_as_noisy_as_an_airy_line_spread_makes_it():
    """The integral of |2 J1/x|^2 along a line is 32/(3 pi); half the variance when depolarised."""
    aperture = Aperture(2000.0)
    length = 32.0 / (3.0 * np.pi**2) * aperture.resolution_px
    expected = np.sqrt(length * 5e3 / (4.0 * np.sqrt(np.pi)))
    assert broad_line_noise_px(aperture, 5e3) == pytest.approx(expected, rel=1e-3)
    both = Aperture(2000.0, polarisations=2)
    assert broad_line_noise_px(both, 5e3) == pytest.approx(expected / np.sqrt(2.0), rel=1e-3)


def spots_noise(aperture, spot, seeds, side=600):
    """Noise of the centres of gravity of a frame's spots, in parts of Dorsch's formula.

    sin(u') = 1/(2 N) on the side of the image; theta = 90 degrees: along the sensor.  By moments,
    E[X^2]^(1/2)/E[P], X = integral of x I and P of I, for which theory needs no approximation.
    Returned with its standard error.
    """
    reach = len(spot) // 2
    many = side // len(spot)
    across, power = [], []
    for seed in seeds:
        grey = speckled(np.tile(spot, (many, many)), aperture, seed)
        cells = grey.reshape(many, len(spot), many, len(spot))
        along = np.arange(len(spot)) - reach
        across += [np.einsum("ivju,v->ij", cells, along), np.einsum("ivju,u->ij", cells, along)]
        power.append(cells.sum(axis=(1, 3)))
    contrast = 1.0 / np.sqrt(aperture.polarisations)
    limit = dorsch_limit_um(contrast, 532.0, 1.0 / (2.0 * aperture.f_number), 90.0)
    square = np.square(across)
    ratio = np.sqrt(square.mean()) / np.mean(power) * aperture.pixel_um / limit
    return ratio, 0.5 * ratio * square.std() / square.mean() / np.sqrt(square.size)


def pupil_noise(covariance, resolution_px):
    """The same by theory, from the covariance of Im(S* dS/dk), S the field in the pupil.

    X is its integral over the pupil, so that E[X^2]/E[P]^2 is the integral of the covariance times
    the transfer function, over the pupil's area.  For a spot of degree of coherence mu(k) in the
    pupil the covariance is (mu_v^2 - mu mu_vv)/2, here averaged over the direction v.
    """
    edge = 2.0 * np.pi / resolution_px  # of the transfer function, the pupil's diameter
    k = (np.arange(200_000) + 0.5) / 200_000 * edge
    total = np.sum(2.0 * np.pi * k * covariance(k) * transfer(k / edge)) * (k[1] - k[0])
    return np.sqrt(total / (np.pi * edge**2 / 4.0)) / (resolution_px / np.pi)


def of_a_disc(radius):
    """Of mu = 2 J1(x)/x, x = R k: mu'' + mu'/k from Bessel's equation."""

    def covariance(k):
        x = radius * k
        mu, slope = 2.0 * j1(x) / x, -2.0 * jv(2, x) / x
        curvature = -mu - 2.0 * slope / x  # mu'' + mu'/x, as mu'' + 3 mu'/x + mu = 0
        return radius**2 * (slope**2 - mu * curvature) / 4.0

    return covariance


@pytest.mark.parametrize(
    ("grain_px", "polarisations", "radius"), [(1.0, 1, 10.0), slow(2.0, 2, 14.0)]
)
def test_a_disc_has_the_height_noise_of_dorsch_hausler_and_herrmann(
    grain_px, polarisations, radius
):
    """Dorsch et al. 1994: C lambda/(2 pi sin u sin theta), whatever the spot's size.

    In this model it's a large, evenly lit disc that has it to the factor, although the pixels
    integrate much of the contrast away; a smaller one has a little less.
    """
    aperture = with_grain(grain_px, polarisations=polarisations)
    expected = pupil_noise(of_a_disc(radius), aperture.resolution_px)
    assert 0.85 < expected < 1.0
    assert pupil_noise(of_a_disc(400.0), aperture.resolution_px) == pytest.approx(1.0, rel=0.02)
    fine = (np.arange(8) + 0.5) / 8.0 - 0.5
    edge = np.arange(-int(1.5 * radius + 10), int(1.5 * radius + 10) + 1)
    v, u = np.meshgrid(*2 * [(edge[:, None] + fine).ravel()], indexing="ij")
    disc = (np.hypot(u, v) <= radius).reshape(edge.size, 8, edge.size, 8).mean(axis=(1, 3))
    ratio, error = spots_noise(aperture, disc, seeds=(9, 10, 11))
    assert error < 0.03
    assert ratio == pytest.approx(expected, abs=3.5 * error)


@pytest.mark.parametrize("width", [slow(0.25), 0.5, slow(2.0)])
def test_a_round_gaussian_spot_has_less_and_a_point_none(width):
    """Width (standard deviation) in lambda N: 1/sqrt(2) of Dorsch's when large, then ever less.

    The degree of coherence in the pupil is exp(-w^2 k^2/2), the covariance w^2 exp(-w^2 k^2)/2.
    """
    aperture = Aperture(16.0 if width > 1.0 else 28.0)
    w = width * aperture.resolution_px
    expected = pupil_noise(lambda k: 0.5 * w**2 * np.exp(-((w * k) ** 2)), aperture.resolution_px)
    if width == 2.0:
        assert expected == pytest.approx(1.0 / np.sqrt(2.0), rel=0.1)
    else:
        assert expected < width / np.sqrt(2.0) * np.pi
    reach = int(5.0 * w + 6.0 * aperture.resolution_px)
    spot = dot_image([(reach, reach)], w, shape=(2 * reach + 1, 2 * reach + 1))
    ratio, error = spots_noise(aperture, spot, seeds=(10, 11, 12))
    assert error < 0.05
    assert ratio == pytest.approx(expected, abs=3.5 * error)


def test_a_line_out_of_focus_keeps_the_mean_of_its_frame_and_has_the_grains_of_the_sharp_one():
    """The frame is moved by 0.4 px beside the blurred sharp one, as hot air moves it."""
    aperture, radius = Aperture(5.6), 5.0
    sharp = line_image(np.full(1500, 30.0), 1.0, 100.0, height=60)
    frame = defocus_blur(line_image(np.full(1500, 30.4), 1.0, 100.0, height=60), radius)
    v = np.arange(60)[:, None]
    near = np.abs(v - 30) < 12

    def centres(grey):
        return (v * grey * near).sum(axis=0) / (grey * near).sum(axis=0)

    seen = speckled(frame, aperture, 3, radius, sharp)
    mean = diffraction_blur(frame, aperture)
    np.testing.assert_allclose(seen.mean(axis=1), mean[:, 700], atol=0.08 * mean.max())
    rows = np.average(v[:, 0] * near[:, 0], weights=(seen * near).mean(axis=1))
    assert rows == pytest.approx(30.4, abs=0.1)
    of_sharp = centres(speckled(sharp, aperture, 3, radius)).std()
    assert centres(seen).std() == pytest.approx(of_sharp, rel=0.1)
    assert centres(speckled(frame, aperture, 3)).std() < 0.75 * of_sharp
    shifted = np.roll(frame, 15, axis=0)  # no blur of the sharp one
    np.testing.assert_array_equal(
        speckled(shifted, aperture, 3, radius, sharp)[40:50, 300:600] > 0.0, True
    )
    assert speckled(shifted, aperture, 3, radius, sharp)[:25].max() < 0.1 * mean.max()


def test_a_surface_that_moves_during_the_exposure_has_the_contrast_of_its_instants_mean():
    """Frames of one surface, moved pixel by pixel, and their mean."""
    aperture, path = with_grain(2.0), 8
    still = speckled(np.ones((400, 500)), aperture, 1)
    instants = np.linspace(0.0, path, 33)
    frequency = np.fft.rfftfreq(500)
    steps = np.exp(2j * np.pi * frequency * instants[:, None])
    steps[[0, -1]] *= 0.5
    mean = np.fft.irfft(np.fft.rfft(still, axis=1) * steps.sum(axis=0) / 32.0, 500, axis=1)
    moved = aperture.moved(path)
    assert 2.0 < moved.patterns < 6.0
    error = scatter_of_contrast(moved, mean.size)
    # Large grains: the pixels' own integration is in both.
    assert mean.std() / mean.mean() == pytest.approx(moved.contrast, rel=4.0 * error + 0.05)
    assert aperture.moved(0.0).patterns == pytest.approx(1.0)
    assert replace(aperture, modes=3.0).moved(path).patterns == pytest.approx(3.0 * moved.patterns)
    far = aperture.moved(400.0).patterns  # ends do not matter: the path over the grain's length
    assert far == pytest.approx(
        400.0 / (32.0 / (3.0 * np.pi**2) * aperture.resolution_px), rel=0.03
    )


def test_diffraction_alone_is_the_mean_of_speckle_and_keeps_the_light():
    """A point's image is Airy's: its first dark ring is 1.22 lambda N away, and 84 % lie within."""
    aperture = with_grain(8.0)
    point = np.zeros((401, 401))
    point[200, 200] = 1.0
    seen = diffraction_blur(point, aperture)
    v, u = np.mgrid[-200:201, -200:201]
    lit = seen[np.hypot(u, v) < 8.0].sum()
    assert lit == pytest.approx(0.838, abs=0.01)
    assert seen[200, 208] < 1e-3 * seen[200, 200]
    assert seen.sum() == pytest.approx(1.0, abs=0.05)  # tails leave the image
    assert diffraction_blur(np.zeros((0, 3)), aperture).shape == (0, 3)


@pytest.mark.parametrize("f_number", [16.0, 22.0, 32.0])
def test_contrast_and_correlation_are_those_of_real_frames_at_once(f_number):
    """Of real lines: contrast 0.24-0.33, half correlation 1-2.5 px, centre 0.16-0.40 px rms.

    A diode of 2 nm and 2.25 modes, paper or paint that is lit 30 um deep and depolarises, a core
    of 2 px; the centre of gravity of each column within 10 px of the line.
    """
    light = {"linewidth_nm": 2.0, "roughness_um": 30.0, "polarisations": 2, "modes": 2.25}
    aperture = Aperture(f_number, magnification=0.25, **light)
    grey = speckled(line_image(np.full(4000, 30.0), 2.0, height=60), aperture, 1)
    peak = grey[30]
    assert 0.25 < peak.std() / peak.mean() < 0.33
    along = np.divide(correlation(peak[None], 5), peak.var() / peak.mean() ** 2)
    half = np.interp(0.5, along[::-1], np.arange(5.0)[::-1])
    assert 1.0 < half < 2.5
    v = np.arange(60)[:, None] - 30.0
    near = grey * (np.abs(v) <= 10.0)
    assert 0.16 < np.std((near * v).sum(axis=0) / near.sum(axis=0)) < 0.40


def test_seeds_repeat_to_the_bit_and_dark_stays_dark():
    """The same seed is the same surface."""
    image = np.zeros((200, 90))
    image[90:100] = 5.0
    first, again, other = (speckled(image, Aperture(16.0), seed) for seed in (1, 1, 2))
    assert first.tobytes() == again.tobytes()
    assert not np.allclose(first, other)
    assert first[:40].max() == 0.0
    assert first.min() >= 0.0
    assert not speckled(np.zeros((5, 5)), Aperture(8.0)).any()


def test_the_unit_of_the_image_does_not_matter():
    """Radiance as in W/(mm^2 sr) or in electrons: single precision's range suffices."""
    image = line_image(np.full(50, 30.0), 2.0, height=60)
    faint, strong = (speckled(image * unit, Aperture(8.0), 1) / unit for unit in (1e-60, 1e60))
    np.testing.assert_allclose(faint, strong, rtol=1e-4, atol=1e-4)


@pytest.mark.parametrize(
    ("make", "says"),
    [
        (lambda: Aperture(0.0), "f_number is 0.0"),
        (lambda: Aperture(np.nan), "f_number is nan"),
        (
            lambda: Aperture(8.0, polarisations=3),
            "must be a whole number from 1 to 2",
        ),
        (lambda: speckled(np.full((4, 4), -1.0), Aperture(8.0)), "finite numbers from 0 on"),
        (lambda: speckled(np.full((4, 4), np.nan), Aperture(8.0)), "finite numbers from 0 on"),
        (lambda: speckled(np.ones(4), Aperture(8.0)), "height, width"),
        (lambda: speckled(np.ones((4, 4)), Aperture(0.5)), "leave speckle out"),
        (lambda: speckled(np.ones((4, 4)), Aperture(8.0, modes=1e3)), "too many to simulate"),
        (lambda: speckled(np.ones((4, 4)), Aperture(9e4)), "px are too large to simulate"),
        (lambda: Aperture(8.0, roughness_um=-1.0), "roughness_um is -1.0; give it from 0 to"),
        (lambda: Aperture(8.0, modes=0.5), "modes is 0.5; give it from 1 to"),
        (lambda: speckled(np.ones((4, 4)), Aperture(8.0), blur_px=-1.0), "blur_px is -1.0; give"),
        (lambda: speckled(np.ones((4, 4)), Aperture(8.0), blur_px=[1.0]), "an image of radii"),
    ],
)
def test_what_can_not_be_is_refused(make, says):
    """In words that name the number."""
    with pytest.raises(InputError, match=says):
        make()
