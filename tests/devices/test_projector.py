"""Projectors: their power, their pixels against OpenCV's, and what makes their light imperfect."""

from dataclasses import replace

import cv2
import numpy as np
import pytest
from scipy.special import erf

from virtual_sensor.devices.patterns import Checker, GrayBit, Picture, Sine, Uniform
from virtual_sensor.devices.projector import Projector
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_families import Pinhole, Sheet, Telecentric
from virtual_sensor.poses import Pose

SIZE = 128, 80
POSE = Pose.turn(30.0, (1.0, 2.0, 3.0), (10.0, 20.0, 30.0))
PINHOLE = Pinhole(np.array([[640.0, 0.0, 60.0], [0.0, 640.0, 70.0], [0.0, 0.0, 1.0]]), POSE, SIZE)
PARALLEL = Telecentric(np.array([[20.0, 0.0, 63.5], [0.0, 20.0, 39.5], [0, 0, 1.0]]), POSE, SIZE)
COEFFICIENTS = np.array(
    [-0.3, 0.2, 0.01, -0.02, 0.05, 0.03, -0.02, 0.01, 1e-3, 2e-3, -1e-3, 3e-3, 0.02, -0.03]
)
RANDOM = np.random.default_rng(2)


def all_light(projector: Projector, cells: int = 500) -> float:
    """The flux of all rays, W."""
    low, high = projector.extent
    s, t = (a + (b - a) * (np.arange(cells) + 0.5) / cells for a, b in zip(low, high, strict=True))
    flux = projector.flux(*np.meshgrid(s, t))
    return float(flux.mean() * np.prod(high - low))


def test_the_flux_of_all_rays_is_the_power() -> None:
    """Whatever the lens: distorted or out of focus light is lost nowhere."""
    for family in (PINHOLE, PARALLEL, replace(PINHOLE, distortion=COEFFICIENTS)):
        for blur in (0.0, 2.0):
            projector = Projector(family, power_w=0.3, defocus_px=blur)
            assert all_light(projector) == pytest.approx(0.3, rel=2e-3), family
    half = Projector(PINHOLE, Checker(8.0), power_w=0.3)
    assert all_light(half) == pytest.approx(0.15, rel=2e-3)


def test_pixels_are_those_of_opencv_in_numpy_as_in_dr_jit() -> None:
    points = RANDOM.uniform([-0.1, -0.1, 1.0], [0.1, 0.1, 1.0], (200, 3))
    for count in (0, 4, 5, 8, 12, 14):
        family = replace(PINHOLE, distortion=COEFFICIENTS[:count])
        projector, none = Projector(family), np.zeros(3)
        expected = cv2.projectPoints(points, none, none, family.matrix, family.distortion)[0][:, 0]
        s, t = points[:, 0], points[:, 1]
        assert np.abs(np.stack(projector.pixels_of(s, t), 1) - expected).max() < 1e-9, count
        jitted = projector.pixels_of(mi.Float(s), mi.Float(t))
        assert np.abs(np.stack([np.array(x) for x in jitted], 1) - expected).max() < 1e-4, count
        back = np.stack(projector.rays_of(*expected.T), 1)
        assert np.abs(back - points[:, :2]).max() < 1e-9, count


def test_light_per_ray_follows_the_distortion() -> None:
    """A pixel's share is the same wherever the lens puts it: against the area that it fills."""
    projector = Projector(replace(PINHOLE, distortion=COEFFICIENTS), power_w=1.0)
    for u, v in ((0.0, 0.0), (90.0, 20.0), (127.0, 79.0)):
        corners = np.stack(
            projector.rays_of(
                u + np.array([-0.5, 0.5, 0.5, -0.5]), v + np.array([-0.5, -0.5, 0.5, 0.5])
            ),
            1,
        )
        area = cv2.contourArea(corners.astype(np.float32) * 1e3) * 1e-6
        s, t = projector.rays_of(u, v)
        assert projector.density(s, t) * area == pytest.approx(1.0 / (128 * 80), rel=1e-3)


def test_square_pixels_show_the_grey_at_their_centres() -> None:
    fringe = Sine("u", 10.0)
    stairs, smooth = Projector(PINHOLE, fringe), Projector(PINHOLE, fringe, pixels=False)
    u = np.array([-0.5, -0.49, 3.2, 3.49, 3.51, 127.49])
    v = np.full_like(u, 40.0)
    assert np.array_equal(stairs.shown(u, v), fringe.grey(np.array([0, 0, 3, 3, 4, 127.0]), v))
    assert np.array_equal(smooth.shown(u, v), fringe.grey(u, v))
    outside = np.array([-0.51, 127.5, 500.0, np.nan])
    for projector in (stairs, smooth):
        assert np.array_equal(projector.shown(outside, 0.0 * outside), np.zeros(4))
    assert replace(smooth, defocus_px=1.0).shown(outside[2:], v[:2]) == pytest.approx([0.0, 0.0])


def test_contrast_gamma_and_bits() -> None:
    u, v = np.arange(128.0), np.zeros(128)
    ramp = Picture(np.tile(np.linspace(0.0, 1.0, 128), (80, 1)))
    grey = ramp.values[0]
    shown = Projector(PINHOLE, ramp, contrast=50.0, gamma=2.2).shown(u, v)
    assert shown == pytest.approx(0.02 + 0.98 * grey**2.2)
    assert shown.max() / shown.min() == pytest.approx(50.0)
    rounded = Projector(PINHOLE, ramp, bits=3).shown(u, v)
    assert np.unique(rounded) == pytest.approx(np.arange(8) / 7)
    assert np.abs(rounded - grey).max() <= 0.5 / 7 + 1e-12


def test_defocus_blurs_by_a_gaussian() -> None:
    """Of a fringe it leaves exp(-2 pi^2 sigma^2/period^2); an edge becomes an error function."""
    u = np.linspace(40.0, 80.0, 301)
    v = np.full_like(u, 40.0)
    for sigma in (0.3, 1.0, 2.5):
        fringe = Projector(PINHOLE, Sine("u", 16.0), pixels=False, defocus_px=sigma)
        left = np.exp(-2.0 * np.pi**2 * sigma**2 / 256.0)
        expected = 0.5 + 0.5 * left * np.cos(2.0 * np.pi * (u + 0.5) / 16.0)
        assert np.abs(fringe.shown(u, v) - expected).max() < 1e-4
        white = Projector(PINHOLE, defocus_px=sigma)
        border = np.linspace(-3.0, 3.0, 61)
        edge = 0.5 + 0.5 * erf((border + 0.5) / (np.sqrt(2.0) * sigma))
        assert np.abs(white.shown(border, 0.0 * border + 40.0) - edge).max() < 2e-4
        assert np.abs(white.shown(0.0 * border + 60.0, border) - edge).max() < 2e-4


def test_defocus_of_what_varies_along_both_axes() -> None:
    """The same bits once by the row's table and once, as an image, by the plane's."""
    bit = GrayBit("u", 2)
    by_row = Projector(PINHOLE, bit, defocus_px=1.5)
    by_plane = replace(by_row, pattern=Picture(bit.image(SIZE)))
    u, v = RANDOM.uniform(-6.0, 134.0, 900), RANDOM.uniform(-6.0, 86.0, 900)
    expected = by_row.shown(u, v)
    assert np.abs(by_plane.shown(u, v) - expected).max() < 0.01
    assert np.array(by_row.shown(mi.Float(u), mi.Float(v))) == pytest.approx(expected, abs=1e-4)


def test_the_extent_holds_all_light() -> None:
    for family in (PINHOLE, PARALLEL, replace(PINHOLE, distortion=COEFFICIENTS)):
        projector = Projector(family)
        low, high = projector.extent
        s, t = (RANDOM.uniform(2 * a - b, 2 * b - a, 4000) for a, b in zip(low, high, strict=True))
        lit = projector.flux(s, t) > 0.0
        assert np.all(projector.reaches(s, t)[lit])
        assert lit.mean() > 0.08
        for one, end in ((s, 0), (t, 1)):
            assert low[end] <= one[lit].min() <= low[end] + 0.1 * (high - low)[end]
        assert not projector.reaches(np.array([np.nan]), np.array([0.0]))[0]
        margin = tuple(0.5 * (high - low))
        assert projector.reaches(s, t, margin).mean() > 1.5 * projector.reaches(s, t).mean()


def test_what_can_not_be_is_refused() -> None:
    for change, said in (
        ({"pattern": Picture(np.zeros((80, 127)))}, "127 x 80 px"),
        ({"pattern": "white"}, "Pattern"),
        ({"family": Sheet(POSE, 300.0)}, "no pixels"),
        ({"power_w": 0.0}, "power_w"),
        ({"contrast": 0.5}, "contrast"),
        ({"gamma": np.nan}, "gamma"),
        ({"bits": 40}, "bits"),
        ({"defocus_px": -1.0}, "defocus_px"),
        ({"pixels": 1}, "pixels"),
    ):
        with pytest.raises(InputError, match=said):
            replace(Projector(PINHOLE, Uniform()), **change)
    folded = Projector(replace(PINHOLE, distortion=np.array([-60.0, 0.0, 0.0, 0.0])))
    with pytest.raises(InputError, match="folds"):
        _ = folded.extent
