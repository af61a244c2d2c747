"""Patterns: against OpenCV's own, in Dr.Jit as in NumPy, and what is refused."""

import cv2
import numpy as np
import pytest

from virtual_sensor.devices.patterns import (
    Checker,
    GrayBit,
    Pattern,
    Picture,
    Sine,
    Stripe,
    Uniform,
    pattern_of,
)
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError

SIZE = 60, 44
RANDOM = np.random.default_rng(1)
PATTERNS = (
    Uniform(0.25),
    Sine("u", 16.0, 0.5),
    Sine("v", 7.0, 0.0, 0.4, 0.3),
    GrayBit("u", 2),
    GrayBit("v", 0, inverted=True),
    Checker(5.0),
    Stripe("v", 20.0, 4.0),
    Picture(RANDOM.random(SIZE[::-1])),
)


def test_gray_code_is_that_of_opencv() -> None:
    size = 100, 60
    _, images = cv2.structured_light.GrayCodePattern.create(*size).generate()
    bits = [(axis, bit) for axis, count in (("u", 7), ("v", 6)) for bit in reversed(range(count))]
    ours = [GrayBit(axis, bit, inverted) for axis, bit in bits for inverted in (False, True)]
    assert len(ours) == len(images)
    for pattern, image in zip(ours, images, strict=True):
        assert np.array_equal(255 * pattern.image(size), image), pattern


def test_fields_and_stripes_begin_and_end_at_the_pixels_that_are_counted() -> None:
    """Of whole pixels by repeating them; a stripe's middle is a pixel's centre, or a border."""
    fields = np.array([[1.0, 0.0, 1.0], [0.0, 1.0, 0.0]])
    assert np.array_equal(Checker(4.0).image((12, 8)), np.kron(fields, np.ones((4, 4))))
    border = Checker(4.0).grey(np.array([-0.4, 3.4, 3.6]), np.zeros(3))
    assert border.tolist() == [1.0, 1.0, 0.0]
    for middle, lit in ((5.0, [4, 5, 6]), (6.5, [5, 6, 7, 8])):
        for axis in ("u", "v"):
            image = Stripe(axis, middle, float(len(lit))).image((12, 12))
            line = image[3] if axis == "u" else image[:, 3]
            assert np.flatnonzero(line).tolist() == lit
            assert image.sum() == 12 * len(lit)


def test_a_period_as_wide_as_the_image_spans_it_once() -> None:
    width = 64
    fringe = Sine("u", width, mean=0.5, amplitude=0.25)
    assert fringe.grey(np.array([-0.5, width - 0.5]), np.zeros(2)) == pytest.approx([0.75, 0.75])
    assert fringe.grey(np.array([width / 2 - 0.5]), np.zeros(1)) == pytest.approx([0.25])
    # N equal steps: the phase by least squares.
    angles = 2.0 * np.pi * np.arange(5) / 5
    steps = np.array([Sine("u", 16.0, angle).image((16, 1))[0] for angle in angles])
    phase = np.angle(np.exp(1j * angles) @ steps)
    turns = phase / (2.0 * np.pi) - (np.arange(16) + 0.5) / 16.0
    assert np.abs(turns - np.round(turns)).max() < 1e-12


def test_dr_jit_shows_what_numpy_shows() -> None:
    u = RANDOM.uniform(-4.0, SIZE[0] + 3.0, 500)
    v = RANDOM.uniform(-4.0, SIZE[1] + 3.0, 500)
    for pattern in PATTERNS:
        expected = pattern.grey(u, v)
        assert expected.shape == u.shape
        assert expected.min() >= 0.0
        assert expected.max() <= 1.0
        for kind, error in ((mi.Float64, 1e-12), (mi.Float, 2e-4)):
            found = np.array(pattern.grey(kind(u), kind(v)))
            if error == 2e-4:  # float32 rounds places beside an edge to its other side
                assert np.mean(np.abs(found - expected) > error) < 0.005, pattern
            else:
                assert found == pytest.approx(expected, abs=error), pattern


def test_a_picture_has_its_values_at_pixel_centres_and_reads_nothing_beside() -> None:
    values = RANDOM.random((3, 4))
    picture = Picture(values)
    assert np.array_equal(picture.image((4, 3)), values)
    middle = picture.grey(np.array([0.5]), np.array([1.5]))
    assert middle == pytest.approx(values[1:3, :2].mean())
    far = picture.grey(np.array([-1e9, 1e9, np.inf]), np.array([1.0, 2.0, -np.inf]))
    assert far == pytest.approx([values[1, 0], values[2, 3], values[0, 3]])
    assert np.isnan(picture.grey(np.array([np.nan]), np.array([0.0]))).all()
    nan = mi.Float(np.array([np.nan, 0.0], np.float32))
    assert np.isnan(np.array(picture.grey(nan, 0.0 * nan))[0])
    one = Picture(np.array([[0.5]]))
    assert one.grey(np.array([0.0, 7.0]), np.array([3.0, 0.0])) == pytest.approx([0.5, 0.5])


def test_texts_say_patterns_whole() -> None:
    for pattern in PATTERNS:
        if not isinstance(pattern, Picture):
            assert pattern_of(pattern.text) == pattern
    assert pattern_of("white") == Uniform(1.0)
    assert pattern_of("sine u 16") == Sine("u", 16.0)
    assert pattern_of(PATTERNS[1]) is PATTERNS[1]


def test_image_files_of_8_and_16_bits(tmp_path) -> None:
    for kind in (np.uint8, np.uint16):
        most = np.iinfo(kind).max
        whole = (most * PATTERNS[-1].values).astype(kind)
        file = tmp_path / f"{kind.__name__}.png"
        cv2.imwrite(str(file), whole)
        for given in (str(file), file, file.name):
            picture = pattern_of(given, (tmp_path,))
            assert isinstance(picture, Picture)
            assert np.array_equal(most * picture.values, whole)
    cv2.imwrite(str(tmp_path / "rgb.png"), np.dstack([whole // 256] * 3).astype(np.uint8))
    assert pattern_of(tmp_path / "rgb.png") == Picture((whole // 256) / 255)


def test_what_is_no_pattern_is_refused_with_what_there_is(tmp_path) -> None:
    (tmp_path / "empty.png").touch()
    colour = np.zeros((4, 4, 3), np.uint8)
    colour[..., 1] = 9
    cv2.imwrite(str(tmp_path / "colour.png"), colour)
    cv2.imwrite(str(tmp_path / "bright.tif"), np.full((4, 4), 2.0, np.float32))
    for text, said in (
        ("sine w 3", "axis is 'w'"),
        ("sine u", "sine u|v PERIOD"),
        ("sine u 0", "from 0.001"),
        ("sine u 1e-300", "from 0.001"),
        ("sine u 16 1e300", "rad"),
        ("checker inf", "square_px"),
        ("stripe v nan 3", "middle_px"),
        ("long" * 2000, "image file"),
        ("zero\0byte", "image file"),
        ("bright.tif", "bright.tif: Picture: its values go up to 2"),
        ("sine u nan", "period_px"),
        ("sine u 16 0 .5 .6", "at most 0.5"),
        ("gray u 3.5", "whole number"),
        ("gray u 3 up", "inverted"),
        ("uniform 2", "from 0"),
        ("sin u 16", "did you mean 'sine'"),
        ("", "one of: white"),
        ("none.png", "image file"),
        ("colour.png", "colour"),
        ("empty.png", "no image"),
        (3, "its text"),
    ):
        with pytest.raises(InputError, match=None) as caught:
            pattern_of(text, (tmp_path,))
        assert said in str(caught.value), text
    for values in ([[2.0]], [[-1.0]], [[np.nan]], [], [1.0]):
        with pytest.raises(InputError):
            Picture(values)


def test_every_pattern_says_what_it_is() -> None:
    assert (
        repr(Sine("u", 16.0)) == "Sine: axis u, period_px 16, phase_rad 0, mean 0.5, amplitude 0.5"
    )
    assert repr(PATTERNS[-1]) == "Picture: 60 x 44 px"
    assert all(isinstance(pattern, Pattern) for pattern in PATTERNS)
