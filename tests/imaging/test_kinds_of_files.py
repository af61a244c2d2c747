"""What kind of image a file is, its content says: WebP, PGM and others, by whatever name.

The files are made by OpenCV, by Pillow, or by hand after Netpbm's own description.
"""

from io import BytesIO

import cv2
import numpy as np
import PIL.Image
import pytest
from image_makers import GREY8, GREY12, exr, picture, png, tiff

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.image_files import find_images, read_image

COLOUR8 = np.dstack([GREY8, GREY8 // 2, GREY8[::-1]])
HEIGHT, WIDTH = GREY8.shape


def digits(image):
    return b"\n".join(b" ".join(b"%d" % value for value in np.ravel(row)) for row in image) + b"\n"


def netpbm():
    """Of each kind its bytes, the pixels, and where they are clipped."""
    size = b"%d %d" % (WIDTH, HEIGHT)
    twelve, bitmap = GREY12.astype(">u2").tobytes(), GREY8 > 99
    pam = b"P7\nWIDTH %d\nHEIGHT %d\nDEPTH %d\nMAXVAL 255\nTUPLTYPE %s\nENDHDR\n"
    yield b"P5 %s 255\n" % size + GREY8.tobytes(), GREY8, 255.0
    yield b"P5\n# by a camera\n%s\n# 12 bits\n4095\n" % size + twelve, GREY12, 4095.0
    yield (
        b"P5\n%s\n4000\n" % size + np.minimum(GREY12, 4000).astype(">u2").tobytes(),
        (np.minimum(GREY12, 4000)),
        4000.0,
    )
    yield b"P2\n%s\n4095\n# digits\n" % size + digits(GREY12), GREY12, 4095.0
    yield b"P2\n%s\n250\n" % size + digits(np.minimum(GREY8, 250)), np.minimum(GREY8, 250), 250.0
    yield b"P4\n%s\n" % size + np.packbits(~bitmap, axis=1).tobytes(), bitmap * 255, 255.0
    yield b"P1\n%s\n" % size + digits(~bitmap).replace(b" ", b""), bitmap * 255, 255.0
    yield b"P6 %s 255\n" % size + COLOUR8.tobytes(), COLOUR8[..., 2], 255.0
    yield b"P3 %s 255\n" % size + digits(COLOUR8), COLOUR8[..., 2], 255.0
    yield pam % (WIDTH, HEIGHT, 3, b"RGB") + COLOUR8.tobytes(), COLOUR8[..., 2], 255.0
    grey_alpha = np.dstack([GREY8, 0 * GREY8 + 255])
    yield pam % (WIDTH, HEIGHT, 2, b"GRAYSCALE_ALPHA") + grey_alpha.tobytes(), GREY8, 255.0
    floats = GREY8.astype("f4") / 7
    yield b"Pf\n%s\n-2.5\n" % size + floats[::-1].astype("<f4").tobytes(), floats, None
    yield b"Pf\n%s\n1.0\n" % size + floats[::-1].astype(">f4").tobytes(), floats, None


def test_netpbm_of_every_kind_has_the_grey_values_that_it_says(tmp_path):
    """Bytes, digits, floats; the largest value is where the camera clips; cut ones are refused."""
    for number, (data, expected, largest) in enumerate(netpbm()):
        path = tmp_path / f"{number}.pnm"
        path.write_bytes(data)
        channel = "blue" if data[:2] in (b"P6", b"P3") or b"TUPLTYPE RGB" in data else None
        read = read_image(path, channel)
        np.testing.assert_array_equal(read.pixels, expected, err_msg=f"{data[:20]}")
        assert read.largest == largest, data[:20]
        for cut in (len(data) * 2 // 3, 9):
            path.write_bytes(data[:cut])
            with pytest.raises(InputError, match=rf"{number}\.pnm: "):
                read_image(path)
    for header in (b"P5 4 0 255\n", b"P5 4 4 99999\n", b"Pf 4 4 e\n", b"P5 99999999 9999999 9\n"):
        path.write_bytes(header + bytes(64))
        with pytest.raises(InputError, match=rf"{path.name}: "):
            read_image(path)


def encoded(kind, image, **options):
    """By Pillow."""
    file = BytesIO()
    PIL.Image.fromarray(image).save(file, kind, **options)
    return file.getvalue()


def test_a_file_is_what_its_content_is(tmp_path):
    """No ending, another's ending: it is read, and what its name says is noted."""
    exr(tmp_path / "a", {"Y": GREY8.astype("f4")})
    tiff(tmp_path / "b", GREY8)
    files = {
        "PNG": cv2.imencode(".png", GREY8)[1].tobytes(),
        "BMP": cv2.imencode(".bmp", GREY8)[1].tobytes(),
        "WebP": encoded("WEBP", GREY8, lossless=True),
        "JPEG 2000": encoded("JPEG2000", GREY8, irreversible=False),
        "GIF": encoded("GIF", GREY8),
        "Sun raster": cv2.imencode(".ras", GREY8)[1].tobytes(),
        "Netpbm": b"P5 %d %d 255\n" % (WIDTH, HEIGHT) + GREY8.tobytes(),
        "OpenEXR": (tmp_path / "a").read_bytes(),
        "TIFF": (tmp_path / "b").read_bytes(),
    }
    for kind, data in files.items():
        for name in ("image", "image.jpg", "image.dat"):
            (tmp_path / name).write_bytes(data)
            read = read_image(tmp_path / name)
            np.testing.assert_array_equal(read.pixels, GREY8, err_msg=kind)
            said = any(f"is a{'n' * (kind == 'OpenEXR')} {kind}, what" in n for n in read.notes)
            assert said == (name == "image.jpg"), (kind, read.notes)
        (tmp_path / "cut").write_bytes(data[: len(data) * 2 // 3])
        with pytest.raises(InputError, match="cut: "):
            read_image(tmp_path / "cut")
    assert {p.name for p in find_images([tmp_path])[0]} == {
        *("a", "b", "cut", "image", "image.dat", "image.jpg")
    }
    (tmp_path / "empty.png").touch()
    with pytest.raises(InputError, match=r"empty\.png: is empty"):
        read_image(tmp_path / "empty.png")


def test_lossy_and_moving_pictures_are_noted(tmp_path):
    """Of a WebP or GIF that moves the first frame is read; colours of fewer pixels are told."""
    two = {"save_all": True, "append_images": [PIL.Image.fromarray(GREY8[::-1])]}
    cases = {
        "moving.webp": (encoded("WEBP", GREY8, lossless=True, **two), "has 2 frames"),
        "moving.gif": (encoded("GIF", GREY8, **two), "has 2 frames"),
        "lossy.webp": (encoded("WEBP", GREY8, quality=95), "if it was not saved without loss"),
        "a.avif": (encoded("AVIF", GREY8, quality=95), "if it was not saved without loss"),
        "half.jpg": (encoded("JPEG", COLOUR8, subsampling=2), "its colours have fewer pixels"),
    }
    for name, (data, note) in cases.items():
        (tmp_path / name).write_bytes(data)
        read = read_image(tmp_path / name, "green" if name.startswith("half") else None)
        assert any(note in each for each in read.notes), (name, read.notes)
        if name != "half.jpg":
            assert np.abs(read.pixels.astype(int) - GREY8).max() < 30, name


def test_radiance_files_are_read_as_floats(tmp_path):
    """RGBE keeps 8 bits of the brightest colour, and clips nowhere."""
    values = np.dstack([GREY8, GREY8 / 2, GREY8 / 4]).astype("f4")
    path = tmp_path / "a.hdr"
    path.write_bytes(cv2.imencode(".hdr", values[..., ::-1])[1].tobytes())
    read = read_image(path, "red")
    assert read.largest is None
    np.testing.assert_allclose(read.pixels, GREY8, atol=1.0)
    claims = path.read_bytes().replace(b"-Y %d +X %d" % (HEIGHT, WIDTH), b"-Y 999999 +X 999999")
    path.write_bytes(claims)
    with pytest.raises(InputError, match="says it has 999999 x 999999 px"):
        read_image(path)


def test_phones_turn_pictures_and_webp_says_so_too(tmp_path):
    """EXIF's orientation, in every kind that has it."""
    exif = PIL.Image.Exif()
    exif[0x0112] = 6
    for kind, ending in (("JPEG", "jpg"), ("WEBP", "webp"), ("PNG", "png")):
        path = tmp_path / f"a.{ending}"
        path.write_bytes(encoded(kind, GREY8, exif=exif, quality=95))
        read = read_image(path)
        assert np.abs(read.pixels.astype(int) - np.rot90(GREY8, -1)).max() < 12, kind
        assert "is turned as its orientation tag (6) says" in read.notes[-1]


def test_a_png_of_rubbish_behind_its_sign_is_refused(tmp_path):
    """Signs of each kind, and nothing that fits them behind."""
    whole = png(tmp_path / "a.png", picture(255, np.uint8)).read_bytes()
    signs = (whole[:8], b"II*\0", b"\xff\xd8\xff", b"v/1\x01", b"RIFF\0\0\0\0WEBP", b"GIF89a")
    signs += (b"#?RADIANCE\n", b"\x59\xa6\x6a\x95", b"\0\0\0\x0cjP  \r\n\x87\n", b"P7\n", b"P6\n")
    for sign in (*signs, b"BM" + bytes(12) + b"\x28\0\0\0", b"\0\0\0\x1cftypavif"):
        (tmp_path / "rubbish").write_bytes(sign + b"this is no image" * 9)
        with pytest.raises(InputError, match="rubbish: "):
            read_image(tmp_path / "rubbish")


def test_pictures_with_loss_are_clipped_where_their_pixels_pile_up(tmp_path):
    """A camera's white is no 255 once it is coded; a bright sheet of all grey values is none."""
    beside = np.linspace(0.0, 230.0, WIDTH) * np.ones((HEIGHT, 1))  # of all grey values
    line = np.where(picture(3 * 245, float) > 30.0, picture(3 * 245, float), beside)
    sheet = np.where(picture(255, float) > 99.0, 150.0 + 100.0 * beside / 230.0, beside)
    for name, image, piled in (("clipped", np.minimum(line, 245.0), True), ("sheet", sheet, False)):
        path = tmp_path / f"{name}.jpg"
        path.write_bytes(encoded("JPEG", np.rint(image).astype(np.uint8), quality=90))
        read = read_image(path)
        assert any("pile up from" in note for note in read.notes) == piled, name
        assert (235.0 < read.largest < 246.0) if piled else read.largest == 255.0
    path = tmp_path / "exact.png"
    path.write_bytes(encoded("PNG", np.rint(np.minimum(line, 245.0)).astype(np.uint8)))
    assert read_image(path).largest == 255.0
