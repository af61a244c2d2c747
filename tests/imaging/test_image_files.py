"""What an image file says of itself is heeded or noted: files by the formats' own libraries."""

import struct

import cv2
import Imath
import numpy as np
import OpenEXR
import PIL.Image
import PIL.ImageOps
import pytest
import tifffile
from image_makers import (
    COLOUR16,
    GREY8,
    GREY12,
    GREY16,
    exr,
    packed_tiff,
    picture,
    png,
    tag,
    tiff,
)

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.image_files import find_images, read_image


def same(path, expected, *notes, largest=..., **options):
    """The image is what is expected, and each note says its word."""
    read = read_image(path, **options)
    np.testing.assert_array_equal(read.pixels, expected)
    if largest is not ...:
        assert read.largest == largest
    assert len(read.notes) == len(notes), read.notes
    for note, word in zip(read.notes, notes, strict=True):
        assert note.startswith(f"{path}: ")
        assert word in note
    return read


@pytest.mark.parametrize("bits", [10, 12, 14])
@pytest.mark.parametrize("order", ["<", ">"])
def test_packed_tiffs_have_the_grey_values_and_the_clipping_of_their_bits(tmp_path, bits, order):
    """Not shifted up to 16 bits, as OpenCV does; what is clipped at 2^bits - 1 is known by that."""
    values = picture(2**bits - 1, "u2")
    same(packed_tiff(tmp_path / "a.tif", values, bits, order), values, largest=2**bits - 1)
    same(tmp_path / "a.tif", values, largest=2**bits - 1, bits=bits)


def test_bits_at_the_top_of_sixteen_are_brought_down(tmp_path):
    """Shifted up or multiplied, by PNG's sBIT or as the user says; never clipped by the shift."""
    shifted = png(tmp_path / "shifted.png", GREY12 << 4)
    scaled = png(tmp_path / "scaled.png", np.rint(GREY12 * (65535 / 4095)).astype("u2"))
    for path in (shifted, scaled):
        same(path, GREY12, "brought down", largest=4095, bits=12)
    said = png(tmp_path / "said.png", GREY12 << 4, (b"sBIT", b"\x0c"))
    same(said, GREY12, "brought down", largest=4095)
    same(said, GREY12, "has 12 bits, not the 14", "brought down", largest=4095, bits=14)
    read = same(shifted, GREY12 << 4)  # nobody says so: as they are, but clipped where they clip
    assert read.largest == (2**12 - 1) << 4
    clipped = png(tmp_path / "clipped.png", np.minimum(2 * GREY12, 4095) << 4)
    same(clipped, np.minimum(2 * GREY12, 4095) << 4, "clipped from 65520", largest=65520)


def test_a_file_of_sixteen_bits_that_ends_where_a_camera_clips_is_asked_about(tmp_path):
    """Rationale: rewritten by OpenCV a 12-bit image has no text of its bits."""
    for bits in (10, 12, 14):
        values = np.array([[0, 2**bits - 2, 2**bits - 1]], np.uint16)
        question = f"no value above {2**bits - 1}: is it of a camera of {bits} bits?"
        same(png(tmp_path / "a.png", values), values, question, largest=65535)
        same(tmp_path / "a.png", values, largest=2**bits - 1, bits=bits)
        same(png(tmp_path / "b.png", values - (values > 0)), values - (values > 0), largest=65535)


def test_grey_values_beyond_the_bits_that_are_said_are_noted(tmp_path):
    """Values that no camera of so many bits can give count as clipped; fewer bits stay fewer."""
    same(tiff(tmp_path / "a.tif", GREY16), GREY16, "above 4095", largest=4095, bits=12)
    same(tiff(tmp_path / "b.tif", GREY8), GREY8, "has 8 bits, not the 12", largest=255, bits=12)
    dim = np.uint16(16) * (GREY8 // 2)
    same(png(tmp_path / "c.png", dim), dim, "multiples of 16", largest=4095, bits=12)
    unit = (GREY8 / 255).astype("f4")
    same(tiff(tmp_path / "d.tif", unit), unit, "floats from 0 to 1", largest=4095, bits=12)
    same(tmp_path / "d.tif", unit, largest=None)


def test_white_is_zero_is_heeded_at_every_depth(tmp_path):
    """The grey values are turned round within their bits; floats have no white to begin from."""
    for name, image in (("8", GREY8), ("16", GREY16)):
        path = tiff(tmp_path / f"{name}.tif", ~image, photometric="miniswhite")
        same(path, image, "white is zero")
    values = packed_tiff(tmp_path / "p.tif", 4095 - GREY12, 12)
    values.write_bytes(values.read_bytes().replace(tag(262, 1), tag(262, 0)))
    same(values, GREY12, "white is zero", largest=4095)
    bilevel = tiff(tmp_path / "1.tif", GREY8 < 128, photometric="miniswhite")
    same(bilevel, GREY8 >= 128, "white is zero", largest=1)
    unfit = tiff(tmp_path / "f.tif", GREY8.astype("f4"), photometric="miniswhite")
    with pytest.raises(InputError, match="white is zero, but its pixels are float32"):
        read_image(unfit)


@pytest.mark.parametrize("planar", ["contig", "separate"])
def test_planes_of_a_tiff_are_its_colours(tmp_path, planar):
    """Red is red, whether the file holds pixel by pixel or plane by plane."""
    image = COLOUR16 if planar == "contig" else np.moveaxis(COLOUR16, -1, 0)
    path = tiff(tmp_path / "a.tif", image, photometric="rgb", planarconfig=planar)
    for number, names in enumerate((("red", "R", "r"), ("green", "G"), ("blue", "B"))):
        for name in names:
            same(path, COLOUR16[:, :, number], channel=name)
    same(path, COLOUR16[:, :, 2], "its blue channel is read, that of 405 nm", wavelength_nm=405.0)


@pytest.mark.parametrize(
    "options",
    [
        {"byteorder": ">"},
        {"bigtiff": True},
        {"tile": (16, 32)},
        {"rowsperstrip": 7},
        *({"compression": name, "predictor": p} for name in ("lzw", "zlib") for p in (False, True)),
        {"compression": "packbits"},
        {"compression": "zstd"},
    ],
)
def test_tiffs_of_every_making_are_read(tmp_path, options):
    """Byte orders, tiles, strips and compressions that lose nothing."""
    for image in (GREY8, GREY16, GREY8.astype("f4") / 3):
        same(tiff(tmp_path / "a.tif", image, **options), image)


def test_numbers_of_every_type_keep_their_value(tmp_path):
    """Half, signed and 32-bit integers become floats; what floats can't hold is refused."""
    signed = GREY16.astype("i4") - 20000
    for kind in ("f2", "f4", "f8", "i1", "i2", "i4", "u4"):
        values = (signed // 512 if kind in ("i1", "f2") else signed // 2).astype(kind)
        path = tiff(tmp_path / f"{kind}.tif", values)
        read = same(path, values)
        assert read.pixels.dtype.kind == "f"
        bits = {"i1": 7, "i2": 15, "i4": 31, "u4": 32}.get(kind)
        assert read.largest == (bits and 2.0**bits - 1.0)
    for kind in ("u8", "c8"):
        with pytest.raises(InputError, match="its pixels are"):
            read_image(tiff(tmp_path / f"{kind}.tif", signed.astype(kind)))
    for kind in ("f2", "u4"):
        same(exr(tmp_path / f"{kind}.exr", {"Y": (GREY16 // 64).astype(kind)}), GREY16 // 64)


@pytest.mark.parametrize("orientation", range(1, 9))
def test_orientation_is_heeded_alike_in_every_format(tmp_path, orientation):
    """Turned as Pillow turns it, and noted: TIFF's tag, EXIF in PNG and JPEG."""
    said = PIL.Image.Exif()
    said[0x0112] = orientation
    image = PIL.Image.fromarray(GREY8)
    image.save(tmp_path / "a.png", exif=said)
    image.save(tmp_path / "a.jpg", exif=said, quality=95)
    tiff(tmp_path / "a.tif", GREY8, extratags=[(274, "H", 1, orientation, True)])
    turned = ["orientation"] * (orientation > 1)
    with PIL.Image.open(tmp_path / "a.jpg") as stored:
        expected = np.asarray(PIL.ImageOps.exif_transpose(stored))
    assert expected.shape == (GREY8.shape if orientation < 5 else GREY8.T.shape)
    same(tmp_path / "a.jpg", expected, "is a JPEG", *turned)
    with PIL.Image.open(tmp_path / "a.png") as stored:
        expected = np.asarray(PIL.ImageOps.exif_transpose(stored))
    for name in ("a.png", "a.tif"):
        same(tmp_path / name, expected, *turned)


def test_further_pages_and_frames_are_noted(tmp_path):
    """The first full image is read; a thumbnail before it is none."""
    pages = tmp_path / "pages.tif"
    with tifffile.TiffWriter(pages) as file:
        file.write(GREY8[::4, ::4].copy(), subfiletype=1, photometric="minisblack")
        file.write(GREY8, photometric="minisblack")
        file.write(GREY8[::-1].copy(), photometric="minisblack")
    same(pages, GREY8, "has 3 pages")
    tifffile.imwrite(tmp_path / "imagej.tif", np.stack([GREY8] * 4), imagej=True)
    same(tmp_path / "imagej.tif", GREY8, "has 4 pages")
    frames = [PIL.Image.fromarray(image) for image in (GREY8, GREY8[::-1])]
    frames[0].save(tmp_path / "a.png", save_all=True, append_images=frames[1:])
    same(tmp_path / "a.png", GREY8, "has 2 frames")


def test_alpha_and_samples_without_a_meaning_are_left_out_and_noted(tmp_path):
    """Or asked for by their number; an alpha channel that hides nothing needs no word."""
    see_through = np.dstack([COLOUR16, GREY16])
    path = tiff(tmp_path / "a.tif", see_through, photometric="rgb", extrasamples=["unassalpha"])
    same(path, COLOUR16[:, :, 1], "alpha", channel="green")
    opaque = np.dstack([GREY8, GREY8, GREY8, 0 * GREY8 + 255])
    same(png(tmp_path / "a.png", opaque), GREY8)
    opaque[..., 3] = GREY8
    same(png(tmp_path / "b.png", opaque), GREY8, "alpha")
    PIL.Image.fromarray(np.dstack([GREY8, GREY8[::-1]])).save(tmp_path / "la.png")
    same(tmp_path / "la.png", GREY8, "alpha")
    two = tiff(tmp_path / "b.tif", np.stack([GREY8, GREY8 // 2]), planarconfig="separate")
    with pytest.raises(InputError, match="say which channel: grey, 2"):
        read_image(two)
    same(two, GREY8 // 2, channel="2")


def test_palettes_are_colours(tmp_path):
    """An index is no grey value: a grey palette turned round turns the image back."""
    palette = np.tile(np.arange(255, -1, -1), (3, 1))
    path = tiff(
        tmp_path / "a.tif",
        255 - GREY8,
        photometric="palette",
        colormap=(palette * 257).astype("u2"),
    )
    same(path, GREY8 * np.uint16(257))
    image = PIL.Image.fromarray(255 - GREY8).convert("P")
    image.putpalette(palette.T.astype("u1").ravel().tolist())
    image.save(tmp_path / "a.png")
    same(tmp_path / "a.png", GREY8)


def test_pngs_of_every_kind_are_read(tmp_path):
    """Few bits are spread; interlaced ones come whole; a profile that isn't applied is noted."""
    image = PIL.Image.fromarray(GREY8 >= 128)
    image.save(tmp_path / "1.png")
    same(tmp_path / "1.png", 255 * (GREY8 >= 128), "1 bits are spread")
    same(png(tmp_path / "g.png", GREY8, (b"gAMA", struct.pack(">I", 45455))), GREY8, "gamma")
    cv2.imwrite(str(tmp_path / "c.png"), COLOUR16[..., ::-1])
    same(tmp_path / "c.png", COLOUR16[..., 2], channel="blue")
    same(tmp_path / "c.png", COLOUR16[..., 0], channel="R")


def test_bmps_are_read_from_either_end(tmp_path):
    """Bottom row first, as most are written, or top row first: a negative height."""
    data = cv2.imencode(".bmp", np.dstack([GREY8] * 3))[1].tobytes()
    up = tmp_path / "up.bmp"
    up.write_bytes(data)
    same(up, GREY8)
    down = tmp_path / "down.bmp"
    down.write_bytes(data[:22] + struct.pack("<i", -len(GREY8)) + data[26:])
    same(down, GREY8[::-1])


def test_jpegs_are_read_and_their_loss_is_noted(tmp_path):
    """Grey or by a colour; of CMYK there is no grey; a cut one is refused."""
    PIL.Image.fromarray(GREY8).save(tmp_path / "a.jpg", quality=100)
    read = read_image(tmp_path / "a.jpg")
    assert np.abs(read.pixels.astype(int) - GREY8).max() <= 3
    assert "JPEG" in read.notes[0]
    red = np.dstack([GREY8, 0 * GREY8, 0 * GREY8])
    PIL.Image.fromarray(red).save(tmp_path / "b.jpeg", quality=100, subsampling=0)
    assert np.abs(read_image(tmp_path / "b.jpeg", "red").pixels.astype(int) - GREY8).max() <= 6
    PIL.Image.fromarray(red).convert("CMYK").save(tmp_path / "c.jpg")
    with pytest.raises(InputError, match="is CMYK"):
        read_image(tmp_path / "c.jpg")
    whole = (tmp_path / "a.jpg").read_bytes()
    (tmp_path / "d.jpg").write_bytes(whole[: len(whole) * 9 // 10])
    with pytest.raises(InputError, match=r"d\.jpg: can't be read"):
        read_image(tmp_path / "d.jpg")


def test_missing_pixels_of_a_tiff_are_missing(tmp_path):
    """GDAL's mark for no data: NaN, whatever the type."""
    values = GREY16.astype("f4")
    values[:5] = -9999.0
    path = tiff(tmp_path / "a.tif", values, extratags=[(42113, "s", 0, "-9999", True)])
    expected = values.copy()
    expected[:5] = np.nan
    same(path, expected)
    brightest = GREY8.max()
    whole = np.where(brightest == GREY8, np.nan, GREY8)
    mark = (42113, "s", 0, str(brightest), True)
    same(tiff(tmp_path / "c.tif", GREY8, extratags=[mark]), whole, largest=255)
    white = tiff(tmp_path / "d.tif", ~GREY8, photometric="miniswhite", extratags=[mark])
    same(white, GREY8, "white is zero", "mark for missing")
    path = tiff(tmp_path / "b.tif", GREY8, extratags=[(281, "H", 1, 100, True)])
    same(path, GREY8, "says its largest value is 100", largest=255)


@pytest.mark.parametrize(("left", "top"), [(30, 20), (-7, 3), (0, 0), (-4, -2)])
def test_an_exr_files_data_window_is_heeded(tmp_path, left, top):
    """Pixels stand where the display window has them; beside the data they are missing."""
    height, width = GREY8.shape
    values = GREY8.astype("f4")
    ends = np.array([left + width - 1, top + height - 1], "i4")
    shown = (np.array([0, 0], "i4"), np.array([99, 79], "i4"))
    data = (np.array([left, top], "i4"), ends)
    expected = np.full((80, 100), np.nan)
    for v in range(80):
        for u in range(100):
            if 0 <= v - top < height and 0 <= u - left < width:
                expected[v, u] = values[v - top, u - left]
    for kind in (OpenEXR.scanlineimage, OpenEXR.tiledimage):
        options = {"dataWindow": data, "displayWindow": shown, "type": kind}
        if kind == OpenEXR.tiledimage:
            options["tiles"] = OpenEXR.TileDescription()
            options["tiles"].xSize = options["tiles"].ySize = 32
        same(exr(tmp_path / "a.exr", {"Y": values}, **options), expected, "data window")


def test_all_parts_of_an_exr_are_searched_for_a_channel(tmp_path):
    """By its name, with its part's where two have one; what isn't read is noted."""
    values = {name: GREY8.astype("f4") * k for k, name in enumerate("ABC", 1)}

    def part(name, channels):
        return OpenEXR.Part({"name": name, "type": OpenEXR.scanlineimage}, channels)

    path = tmp_path / "a.exr"
    parts = [part("depth", {"Z": values["A"]}), part("line", {"Y": values["B"]})]
    OpenEXR.File(parts).write(str(path))
    same(path, values["B"], "has 2 parts; 'line' is read, not depth")
    for channel, expected in (("Y", "B"), ("Z", "A"), ("line.Y", "B"), ("depth.Z", "A")):
        same(path, values[expected], channel=channel)
    with pytest.raises(InputError, match="has no channel 'R'; take Z, Y"):
        read_image(path, "R")
    parts = [part("left", {"Y": values["A"]}), part("right", {"Y": values["B"]})]
    OpenEXR.File(parts).write(str(path))
    with pytest.raises(InputError, match=r"say which channel: left\.Y, right\.Y"):
        read_image(path)
    same(path, values["B"], channel="right.Y")


def test_folders_give_all_images_and_name_what_is_left_out(tmp_path):
    """JPEGs among TIFFs are read; folders named like images, and other files, are noted."""
    folder = tmp_path / "shots"
    (folder / "old.png").mkdir(parents=True)
    for name in ("a.tif", "b.jpg", "c.PNG", "notes.txt", "d.npy", ".hidden.txt"):
        (folder / name).touch()
    paths, notes = find_images([folder])
    assert [p.name for p in paths] == ["a.tif", "b.jpg", "c.PNG"]
    assert notes == (f"{folder}: left out, as no images known here: d.npy, notes.txt, old.png.",)


def test_what_else_the_table_names(tmp_path):
    """Each row of the docstring that no other test goes through."""
    values = GREY8.astype("f4")
    wide = exr(tmp_path / "wide.exr", {"Y": values}, pixelAspectRatio=2.0)
    same(wide, values, "not square")
    layered = exr(tmp_path / "layers.exr", {"left.Y": values, "right.Y": values / 2})
    same(layered, values / 2, channel="right.Y")
    clear = dict.fromkeys("RGB", values) | {"A": values}
    same(exr(tmp_path / "alpha.exr", clear), values, "alpha")
    same(exr(tmp_path / "only.exr", {"A": values}), values)
    coloured = np.dstack([GREY8] * 3)
    lossy = tiff(tmp_path / "jpeg.tif", coloured, photometric="rgb", compression="jpeg")
    read = read_image(lossy, "green")
    assert np.abs(read.pixels.astype(int) - GREY8).max() <= 3
    assert "may lose" in read.notes[0]
    with tifffile.TiffWriter(tmp_path / "sub.tif") as file:
        file.write(GREY8, photometric="minisblack", subifds=1)
        file.write(GREY8[::2, ::2].copy(), photometric="minisblack", subfiletype=1)
    same(tmp_path / "sub.tif", GREY8, "within its page")
    volume = np.stack([GREY8] * 16)
    refused = {
        "is a volume": tiff(tmp_path / "v.tif", volume, volumetric=True, tile=(16, 16, 16)),
        "of YCBCR": tiff(tmp_path / "y.tif", coloured, photometric="ycbcr"),
        "of CIELAB": tiff(tmp_path / "l.tif", coloured, photometric="cielab"),
        "begins like none of": tmp_path / "image.npy",
    }
    np.save(refused["begins like none of"], GREY8)
    for says, path in refused.items():
        with pytest.raises(InputError, match=says):
            read_image(path)


def test_exr_files_that_are_deep_or_subsampled_are_refused(tmp_path):
    """Several values in a pixel, or one for several pixels: there is no grey image in them."""
    deep = np.empty(GREY8.shape, object)
    for place in np.ndindex(GREY8.shape):
        deep[place] = np.ones(2, "f4")
    options = {"type": OpenEXR.deepscanline, "compression": OpenEXR.ZIPS_COMPRESSION}
    with pytest.raises(InputError, match="is deep"):
        read_image(exr(tmp_path / "deep.exr", {"Z": deep}, **options))
    path, header = tmp_path / "chroma.exr", OpenEXR.Header(*GREY8.T.shape)
    half = Imath.PixelType(Imath.PixelType.HALF)
    header["channels"] = {"Y": Imath.Channel(half, 1, 1), "RY": Imath.Channel(half, 2, 2)}
    pixels = {"Y": GREY8.astype("f2").tobytes(), "RY": GREY8[::2, ::2].astype("f2").tobytes()}
    file = OpenEXR.OutputFile(str(path), header)
    file.writePixels(pixels)
    file.close()
    same(path, GREY8)
    with pytest.raises(InputError, match="subsampled"):
        read_image(path, "RY")


def test_places_that_are_not_there_are_refused(tmp_path):
    """Names that no system takes, links to nowhere: the same line."""
    (tmp_path / "link.png").symlink_to("nowhere")
    for name in ("missing.png", "x" * 5000, "a\0b.png", "link.png", "link.png/a.png"):
        with pytest.raises(InputError, match="no such image or folder"):
            find_images([tmp_path / name])
