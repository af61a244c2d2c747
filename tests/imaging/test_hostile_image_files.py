"""Image files that are damaged, or claim more than there is: one line, no crash."""

import struct

import cv2
import numpy as np
import OpenEXR
import PIL.Image
import pytest
import tifffile
from image_makers import (
    GREY8,
    GREY16,
    RNG,
    chunk,
    exr,
    packed_tiff,
    png,
    tag,
    tiff,
)

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.image_files import read_image


def huge(path, ending):
    """A header that claims 10^6 x 10^6 px, and little behind it."""
    side = 10**6
    if ending == "png":
        image = png(path, GREY8).read_bytes()
        header = struct.pack(">II", side, side) + image[24:29]
        path.write_bytes(image[:8] + chunk(b"IHDR", header) + image[33:])
    elif ending == "tif":
        data = packed_tiff(path, GREY8, 8).read_bytes()
        data = data.replace(tag(256, 90), tag(256, side)).replace(tag(257, 64), tag(257, side))
        path.write_bytes(data.replace(tag(278, 64), tag(278, side)))
    elif ending == "exr":
        data = exr(path, {"Y": GREY8.astype("f4")}).read_bytes()
        path.write_bytes(data.replace(struct.pack("<2i", 89, 63), struct.pack("<2i", side, side)))
    elif ending == "bmp":
        data = cv2.imencode(".bmp", GREY8)[1].tobytes()
        path.write_bytes(data[:18] + struct.pack("<2i", side, side) + data[26:])
    else:
        PIL.Image.fromarray(GREY8).save(path)
        data = path.read_bytes()
        path.write_bytes(data.replace(struct.pack(">2H", 64, 90), b"\xff\xff\xff\xff"))
    return path


@pytest.mark.parametrize("ending", ["png", "tif", "exr", "bmp", "jpg"])
def test_sizes_that_no_memory_holds_are_refused(tmp_path, ending):
    """By the header, before any pixel is asked for."""
    with pytest.raises(InputError, match=rf"huge\.{ending}: "):
        read_image(huge(tmp_path / f"huge.{ending}", ending))


def test_damaged_pngs_and_tiffs_are_refused(tmp_path):
    """A flipped bit, strips that aren't there: no black rows in place of what is lost."""
    data = bytearray(png(tmp_path / "a.png", RNG.integers(0, 255, (64, 90), "u1")).read_bytes())
    data[len(data) // 2] ^= 8
    (tmp_path / "a.png").write_bytes(data)
    for options in ({}, {"compression": "lzw"}, {"compression": "zlib"}):
        whole = tiff(tmp_path / "a.tif", GREY16, rowsperstrip=8, **options).read_bytes()
        (tmp_path / "a.tif").write_bytes(whole[:-40])
        for name in ("a.png", "a.tif"):
            with pytest.raises(InputError, match=name):
                read_image(tmp_path / name)
    tiff(tmp_path / "b.tif", np.stack([GREY8] * 4), photometric="separated")
    (tmp_path / "c.tif").write_bytes(
        packed_tiff(tmp_path / "c.tif", GREY8, 8).read_bytes().replace(tag(262, 1), tag(262, 32803))
    )
    for name, kind in (("b.tif", "of SEPARATED"), ("c.tif", "of CFA")):
        with pytest.raises(InputError, match=kind):
            read_image(tmp_path / name)


def test_damaged_exr_files_are_refused_in_silence(tmp_path, capfd):
    """OpenEXR goes on without the part that it can't read, and says so on the terminal only."""
    values = RNG.random(GREY8.shape).astype("f4")
    parts = [
        OpenEXR.Part({"name": name, "type": OpenEXR.scanlineimage}, {name: values})
        for name in ("Y", "Z")
    ]
    OpenEXR.File(parts).write(str(tmp_path / "a.exr"))
    data = (tmp_path / "a.exr").read_bytes()
    (tmp_path / "a.exr").write_bytes(data[: len(data) * 9 // 10])
    with pytest.raises(InputError, match=r"a\.exr: its pixels are damaged"):
        read_image(tmp_path / "a.exr", "Y")
    assert capfd.readouterr() == ("", "")


def test_a_piz_exr_that_claims_more_than_its_last_block_holds_is_refused(tmp_path):
    """Rationale: OpenEXR decodes pixels of a window enlarged within a block that are none."""
    path = tmp_path / "a.exr"
    for height, width, kind in ((60, 29, "f2"), (33, 64, "f4"), (1, 40, "u4"), (31, 40, "f2")):
        for grey in (RNG.random((height, width)) * 99.0, np.zeros((height, width))):
            grey = np.where(grey < 90.0, 0.0, grey).astype(kind)  # runs, as dark images have
            exr(path, {"Y": grey}, compression=OpenEXR.PIZ_COMPRESSION)
            np.testing.assert_array_equal(read_image(path).pixels, grey)
            data = path.read_bytes()
            begin = data.index(b"dataWindow\0box2i\0") + len(b"dataWindow\0box2i\0") + 4
            for more in ((0, 1), (1, 0), (-1, 0)):
                right, bottom = width - 1 + more[0], height - 1 + more[1]
                window = struct.pack("<4i", 0, 0, right, bottom)
                path.write_bytes(data[:begin] + window + data[begin + 16 :])
                with pytest.raises(InputError, match=r"claims more pixels|damaged|OpenEXR"):
                    read_image(path)


def test_a_tiff_that_claims_more_rows_than_its_strips_hold_is_refused(tmp_path, capfd):
    """Absent strips are no black rows; nor does a library print what it misses of a PNG."""
    data = packed_tiff(tmp_path / "a.tif", GREY8, 8).read_bytes()
    (tmp_path / "a.tif").write_bytes(data.replace(tag(257, 64), tag(257, 6400)))
    image = png(tmp_path / "a.png", GREY8).read_bytes()
    header = chunk(b"IHDR", struct.pack(">II", 90, 65) + image[24:29])
    (tmp_path / "a.png").write_bytes(image[:8] + header + image[33:])
    for name in ("a.tif", "a.png"):
        with pytest.raises(InputError, match=name):
            read_image(tmp_path / name)
    assert capfd.readouterr() == ("", "")


def test_an_image_without_samples_is_refused(tmp_path):
    """A TIFF of 0 samples in a pixel."""
    path = packed_tiff(tmp_path / "a.tif", GREY8, 8)
    path.write_bytes(path.read_bytes().replace(tag(277, 1), tag(277, 0)))
    with pytest.raises(InputError, match=r"a\.tif: says it has 90 x 64 x 0 px"):
        read_image(path)


def test_a_tiff_whose_next_page_is_cut_off_is_refused(tmp_path):
    """The first page is whole; that there was another, only its offset says."""
    path = tmp_path / "a.tif"
    with tifffile.TiffWriter(path) as file:
        for image in (GREY8, GREY8):
            file.write(image, photometric="minisblack")
    with tifffile.TiffFile(path) as file:
        second = file.pages[1].offset
    data = path.read_bytes()
    for cut in (second, second + 20):
        path.write_bytes(data[:cut])
        with pytest.raises(InputError, match=r"a\.tif"):
            read_image(path)


def test_tags_of_another_kind_than_theirs_are_refused(tmp_path):
    """An orientation of two numbers, a largest value in letters."""
    for tags in ((274, "H", 2, (1, 3), True), (281, "s", 0, "bright", True)):
        path = tiff(tmp_path / "a.tif", GREY8, extratags=[tags])
        with pytest.raises(InputError, match=r"a\.tif: can't be read as TIFF"):
            read_image(path)
