"""Images tell whether they are in a codec's order, what is missing and what is spare."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.metrology.fringes.frame_order import (
    RIGHT,
    check_order,
    disorder_of,
    missing_patterns,
    order_named,
    orders_of,
    same_images,
    spare_images,
    witnesses,
)

CODECS = ("phase 4 16,128,1280 uv", "phase 3 80,1280 u", "phase 5 80 v gray", "gray u")


def shots(text):
    """A codec and noisy 8-bit images of a shaded surface that sees all of the projector's image."""
    codec = vs.codec_of(text)
    rng = np.random.default_rng(6)
    v, u = np.mgrid[:60, :80]
    shade = rng.uniform(100.0, 200.0, u.shape)
    greys = [np.asarray(p.grey(15.9 * u + 3.0, 13.1 * v + 2.0)) for p in codec.patterns]
    noisy = (10.0 + shade * grey + rng.normal(0.0, 2.0, u.shape) for grey in greys)
    return codec, [np.clip(np.rint(image), 0, 255) for image in noisy]


def test_the_right_order_is_right_and_others_are_found():
    for text in CODECS:
        codec, images = shots(text)
        right = check_order(codec, images)
        assert right.disorder < RIGHT
        assert right.order is None
        assert not right.words
        for name, order in orders_of(codec):
            assert order_named(codec, name) == order
            if "backwards" in name:  # it may be the right one, mirrored
                continue
            shot = [images[order.index(n)] for n in range(len(order))]
            found = check_order(codec, shot)
            assert found.disorder > RIGHT, (text, name)
            assert found.order == order, (text, name)


def test_two_exchanged_images_are_named():
    codec, images = shots("phase 4 80,1280 u")
    images[1], images[6] = images[6], images[1]
    found = check_order(codec, images)
    assert found.order == (0, 6, 2, 3, 4, 5, 1, 7)
    assert "'u 80 px, step 2 of 4' and 'u 1280 px, step 3 of 4' exchanged" in found.words


def test_what_is_missing_or_spare_is_named():
    codec, images = shots("phase 4 80,1280 u")
    for gap in (0, 3, 6):
        names = missing_patterns(codec, images[:gap] + images[gap + 1 :])
        assert names == (codec.names[gap],)
    white = np.full_like(images[0], 255.0)
    assert spare_images(codec, [*images[:3], white, *images[3:]]) == (3,)
    assert spare_images(codec, [white, 0.0 * white, *images]) == (0, 1)
    assert spare_images(codec, images[:1]) == ()
    codec, images = shots("gray u")
    assert missing_patterns(codec, images[:5] + images[6:]) == codec.names[4:6]


def test_another_first_phase_is_found():
    """Rationale: of sines instead of cosines all columns would be wrong, and none would say so."""
    for text in ("phase 4 16,128,1280 u", "phase 3 80 v gray"):
        for start in ("180deg", "-90deg", "90deg"):
            codec, images = shots(f"{text} {start}")
            assert check_order(codec, images).disorder < RIGHT
            found = check_order(vs.codec_of(text), images)
            assert found.codec == codec
            assert f"they fit '{codec.text}'" in found.words


def test_steps_may_run_the_other_way():
    """Rationale: the literature writes cos(phi + theta) as often; columns would be mirrored."""
    for steps, first, said in (
        (4, 0.0, "steps-backwards"),
        (3, -120.0, "uv -120deg' with --order steps-backwards"),
        (3, 120.0, "uv 120deg' with --order steps-backwards"),
        (5, -90.0, "uv -90deg' with --order steps-backwards"),
    ):
        codec = vs.PhaseShift(steps=steps, periods_px=(16.0, 128.0, 1280.0))
        v, u = np.mgrid[:60, :80] * np.array([13.1, 15.9])[:, None, None] + 2.0
        images = [
            90.0 + 70.0 * np.cos(2.0 * np.pi * ((x + 0.5) / period + k / steps) + start)
            for x in (u, v)
            for period in (16.0, 128.0, 1280.0)
            for k in range(steps)
            for start in [np.radians(first)]
        ]
        found = check_order(codec, images)
        assert said in found.words, (steps, first)
        fitting = found.codec or codec
        assert found.order is not None
        decoded = fitting.decode([images[n] for n in found.order], edges=False)
        np.testing.assert_allclose(decoded.column, u, atol=1e-3)
        np.testing.assert_allclose(decoded.row, v, atol=1e-3)


def test_images_that_show_the_same_are_found():
    images = shots("phase 8 80,1280 u")[1]
    assert same_images(images) is None
    again = images[3] + np.random.default_rng(7).normal(0.0, 2.0, images[3].shape)
    assert same_images([*images[:4], again, *images[5:]]) == (3, 4)
    assert same_images([images[0], images[1], images[0]]) == (0, 2)


def test_clipped_pixels_are_no_witnesses():
    codec, images = shots("phase 4 80,1280 u")
    clipped = [np.minimum(1.5 * image, 160.0) for image in images]
    assert check_order(codec, clipped).disorder > RIGHT
    assert check_order(codec, clipped, 160.0).disorder < RIGHT


def test_where_images_cannot_tell_nothing_is_said():
    codec, images = shots("phase 3 16 u none")
    assert check_order(codec, images[::-1]).order is None
    assert missing_patterns(codec, images[1:]) == ()
    dark = [0.0 * image for image in images]
    assert np.isnan(disorder_of(codec, witnesses(dark), (0, 1, 2)))
    assert check_order(codec, dark).words == ""
    noise = list(np.random.default_rng(7).uniform(0.0, 255.0, (12, 60, 80)))
    found = check_order(vs.codec_of("phase 4 u"), noise)
    assert found.order is None
    assert "contradict" in found.words


def test_orders_are_named_or_numbered():
    codec = vs.codec_of("phase 3 16,1280 u")
    assert order_named(codec, "usual") == tuple(range(6))
    assert order_named(codec, "2,1,3, 4,5,6") == (1, 0, 2, 3, 4, 5)
    assert order_named(codec, "coarse-first") == (3, 4, 5, 0, 1, 2)
    for wrong in ("1,2", "1,1,2,3,4,5", "sideways", ""):
        assert order_named(codec, wrong) is None
    for text in CODECS:
        assert len({order for _, order in orders_of(vs.codec_of(text))}) >= 2


@pytest.mark.parametrize("count", [0, 1])
def test_few_pixels_are_no_witnesses(count):
    codec = vs.codec_of("phase 3 16,1280 u")
    assert np.isnan(disorder_of(codec, np.ones((6, count)), tuple(range(6))))
