"""A PNG holds grey values as a camera gives them, and says so: read by other libraries."""

import cv2
import numpy as np
import PIL.Image
import pytest
from image_makers import GREY8, GREY12, GREY16, png

import virtual_sensor as vs
from virtual_sensor.errors import InputError

NAN = float("nan")


def test_grey_values_are_stored_as_they_are(tmp_path):
    """Rationale: who reads a Mono12 camera's file by OpenCV expects 0 ... 4095, of 8 bits 255."""
    cases = [(8, GREY8), (10, GREY12 >> 2), (12, GREY12), (16, GREY16), (1, GREY8 > 99)]
    for bits, image in cases:
        grey = image.astype(np.int64)
        path = vs.save_png(grey, tmp_path / f"{bits}.png", bits=bits)
        stored = cv2.imread(str(path), cv2.IMREAD_UNCHANGED)
        assert stored.dtype == (np.uint8 if bits <= 8 else np.uint16)
        np.testing.assert_array_equal(stored, grey)
        with PIL.Image.open(path) as header:
            header.load()  # checks each chunk's sum
            assert header.info["Camera bits"] == f"{bits}"
            assert header.info["White level"] == f"{2**bits - 1}, stored as it is"
        read = vs.read_image(path)
        np.testing.assert_array_equal(read.pixels, grey)
        assert (read.largest, read.notes) == (2**bits - 1, ())


def test_floats_are_scaled_to_a_stated_white(tmp_path):
    """Rationale: two frames are compared by one white; without one, nothing is clipped."""
    light = np.array([[0.0, 0.5, 1.0], [2.0, 3.0, 0.25]])
    stated = vs.read_image(vs.save_png(light, tmp_path / "a.png", 12, white=2.0))
    assert stated.pixels.tolist() == [[0, 1024, 2048], [4095, 4095, 512]]
    own = vs.read_image(vs.save_png(light.astype(np.float16), f"{tmp_path}/b.png"))
    assert own.pixels.max() == round(0.9 * 4095)
    assert own.pixels[0, 2] == round(0.3 * 4095)
    with PIL.Image.open(tmp_path / "b.png") as header:
        assert header.info["White level"] == "4095 is 3.33333333 of the image"
    dark = vs.read_image(vs.save_png(np.zeros((2, 3)), tmp_path / "c.png", 8))
    assert not dark.pixels.any()


def test_what_a_png_cant_hold_is_told(tmp_path):
    """Rationale: a wrong file is found out a week later, in the results."""
    grey, light = GREY12.astype(int), np.ones((4, 5))
    refused = {
        "2 pixels that are NaN or infinite": (np.where(np.eye(2), np.inf, 0.0), "a.png"),
        "negative values, down to -1": (grey - 1 - grey.min(), "a.png"),
        "negative values, down to -0.5": (light - 1.5, "a.png"),
        "up to 4096, but 12 bits end at 4095": (np.full((2, 2), 4096), "a.png"),
        "(2, 2, 3); give (height, width); of a colour image": (np.zeros((2, 2, 3), int), "a.png"),
        "shape (0,)": ([], "a.png"),
        "of type bool": (light > 0.5, "a.png"),
        "of type <U5": ("a.png", "a.png"),
        "end it with .png": (light, "a.tif"),
        "path is 5": (light, 5),
    }
    for words, (image, name) in refused.items():
        with pytest.raises(InputError) as told:
            vs.save_png(image, tmp_path / name if isinstance(name, str) else name)
        assert words in str(told.value)
    for words, options in {
        "bits must be a whole number from 1 to 16, not 17": {"bits": 17},
        "bits must be a whole number from 1 to 16, not 12.0": {"bits": 12.0},
        "white is 0.0; give a level above 0": {"white": 0.0},
        "white is nan": {"white": NAN},
    }.items():
        with pytest.raises(InputError, match=words):
            vs.save_png(light, tmp_path / "a.png", **options)
    with pytest.raises(InputError, match="white is of floats"):
        vs.save_png(grey, tmp_path / "a.png", white=4095)
    assert not list(tmp_path.iterdir())


def test_a_frames_image_is_saved_and_its_line_found_again(tmp_path):
    """Rationale: the clipping of 12 bits is known from the file, not from 16 bits' 65535."""
    v = np.arange(64.0)[:, None]
    line = np.repeat(2.0 * np.exp(-(((v - 30.3) / 2.0) ** 2) / 2.0), 40, 1)
    read = vs.read_image(vs.save_png(line, tmp_path / "line.png", white=1.9))
    assert set(vs.Status.of(vs.line_centres(read).status)) == {vs.Status.CLIPPED}
    read = vs.read_image(vs.save_png(line, tmp_path / "line.png"))
    found = vs.line_centres(read)
    assert (found.status == vs.Status.OK).all()
    assert np.abs(found.row - 30.3).max() < 0.002


def test_only_such_bits_are_taken_as_a_file_can_have(tmp_path):
    """Rationale: the text may be another program's."""
    for said, largest in {
        "12": 4095,
        "0": 65535,
        "17": 65535,
        "9" * 9999: 65535,
        "²": 65535,
    }.items():
        text = f"Camera bits\0{said}".encode("latin-1")
        assert vs.read_image(png(tmp_path / "a.png", GREY12, (b"tEXt", text))).largest == largest
