"""Images with the laser on minus one with it off: other light leaves, noise and clipping stay."""

import numpy as np
import PIL.Image
import pytest
from artificial import line_image

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.dark_images import find_dark
from virtual_sensor.imaging.image_files import Image

RNG = np.random.default_rng(7)
ROW = 30.0 + 0.05 * np.arange(90)
AMBIENT = 20.0 + 80.0 * (np.arange(64)[:, None] > 32) * (np.arange(90) % 30 > 10)
LINE = line_image(ROW, 2.0, 120.0)


def shots(spread=0.0, **known):
    """Laser on, and off: the part's own edges lie in the line."""
    on, off = (
        np.rint(np.clip(level + RNG.normal(0.0, spread, AMBIENT.shape), 0, 255)).astype(np.uint8)
        for level in (LINE + AMBIENT, AMBIENT)
    )
    return Image(on, 255.0, (), known), Image(off, 255.0, (), known)


def test_edges_of_other_light_leave_no_bias():
    """Rationale: they lie in the line, and shift its centre by tenths of a pixel."""
    on, off = shots()
    alone = vs.line_centres(on)
    line = vs.line_centres(vs.difference(on, off))
    assert line.found.all()
    np.testing.assert_allclose(line.row, ROW, atol=0.01)
    lit = AMBIENT.max(axis=0) > 50.0
    wrong = ~alone.found | (np.abs(alone.row - ROW) > 0.05)
    assert wrong[lit].mean() > 0.9


def test_noise_is_that_of_both_and_of_the_other_light():
    """Against the spread of differences: read noise 2, a gain of 0.5 in a light of 20."""
    pair = vs.difference(*shots(np.sqrt(2.0**2 + 0.5 * 20.0), noise=2.0, gain=0.5, black=0.0))
    beside = pair.pixels[:20].astype(float)
    assert pair.detector_options["noise"] == pytest.approx(beside.std(), rel=0.1)
    assert pair.detector_options["gain"] == 0.5


def test_what_the_laser_clips_is_clipped_in_the_difference():
    """At the white level of both, whatever the other light is; what that clips alone is unknown."""
    on, off = shots()
    bright = Image(np.minimum(2 * on.pixels.astype(int), 255).astype(np.uint8), 255.0)
    off.pixels[5, 5] = 255
    pair = vs.difference(bright, off)
    clipped, unknown = bright.pixels == 255, off.pixels == 255
    assert clipped.sum() > 100
    np.testing.assert_array_equal(pair.pixels >= pair.largest, clipped & ~unknown)
    np.testing.assert_array_equal(np.isnan(pair.pixels), unknown)


def test_a_clipped_lamp_in_both_images_is_no_line():
    """Rationale: it looks like one that is over-exposed, and has no laser light at all."""
    rng = np.random.default_rng(3)
    lamp = line_image(np.full(90, 50.0), 2.5, 900.0)
    both = (
        np.clip(light + rng.normal(10.0, 1.5, lamp.shape), 0, 255).astype(np.uint8)
        for light in (LINE + lamp, lamp)
    )
    line = vs.line_centres(vs.difference(*(Image(each, 255.0) for each in both)))
    assert line.found.mean() > 0.95
    np.testing.assert_allclose(line.row[line.found], ROW[line.found], atol=0.3)
    assert not np.any(line.status == vs.Status.CLIPPED)


def test_an_image_is_not_its_own_dark_frame():
    on, _ = shots()
    with pytest.raises(InputError, match="same image as its dark frame; give one with the laser"):
        vs.difference(on, Image(on.pixels.copy(), 255.0))


def test_images_that_do_not_go_together_are_refused_or_noted(tmp_path):
    """Sizes, exposures that EXIF says, lamps that were switched on in between."""
    on, off = shots()
    with pytest.raises(InputError, match=r"is 90 x 64 px, but its dark frame is 89 x 64 px"):
        vs.difference(on, Image(off.pixels[:, 1:], 255.0))
    with pytest.raises(InputError, match=r"difference: off is None; give an image"):
        vs.difference(on, None)
    lamp = Image(np.minimum(on.pixels.astype(int) + AMBIENT, 255).astype(np.uint8), 255.0)
    (note,) = vs.difference(lamp, off).notes
    assert "the image has 2 times the light of its dark frame" in note
    assert vs.difference(on, off).notes == ()
    for name, seconds in (("on", 0.01), ("off", 0.02)):
        exif = PIL.Image.Exif()
        exif[0x0112] = 1  # Pillow writes none without such a tag
        exif.get_ifd(0x8769)[0x829A] = seconds
        PIL.Image.fromarray(on.pixels).save(tmp_path / f"{name}.png", exif=exif)
    with pytest.raises(InputError, match=r"exposure is 0\.01 s, but its dark frame's 0\.02 s"):
        vs.difference(*(vs.read_image(tmp_path / f"{name}.png") for name in ("on", "off")))


def test_dark_frames_are_found_by_name(tmp_path):
    """One for all; in a folder that of the same name, whatever its ending."""
    for name in ("1.png", "2.tif", "only/dark.png", "many/1.png", "many/2.jpg"):
        (tmp_path / name).parent.mkdir(exist_ok=True)
        (tmp_path / name).write_bytes(b"\x89PNG\r\n\x1a\n")
    paths = [tmp_path / "1.png", tmp_path / "2.tif", tmp_path / "3.png"]
    assert find_dark(tmp_path / "1.png", paths) == dict.fromkeys(paths, tmp_path / "1.png")
    assert find_dark(tmp_path / "only", paths) == dict.fromkeys(paths, tmp_path / "only/dark.png")
    many = [tmp_path / "many" / name for name in ("1.png", "2.jpg")]
    assert find_dark(tmp_path / "many", paths) == dict(zip(paths, many, strict=False))
