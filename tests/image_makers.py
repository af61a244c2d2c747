"""Small image files of every format, by the formats' own libraries or by hand."""

import struct
import zlib

import cv2
import numpy as np
import OpenEXR
import tifffile
from artificial import line_image

ROW = 30.0 + 0.05 * np.arange(90)
RNG = np.random.default_rng(5)


def picture(top, dtype):
    return np.rint(line_image(ROW, 2.0, 0.8 * top, background=0.02 * top)).astype(dtype)


def write_exr(path, channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))


GREY8, GREY12, GREY16 = picture(255, "u1"), picture(4095, "u2"), picture(65535, "u2")
COLOUR16 = np.stack([GREY16, GREY16 // 3, GREY16[::-1]], axis=-1)


def tiff(path, image, **options):
    tifffile.imwrite(path, image, photometric=options.pop("photometric", "minisblack"), **options)
    return path


def packed(values, bits):
    """Rows of so many bits each, one behind the other, the highest first: TIFF 6.0, section 1."""
    planes = values[..., None] >> np.arange(bits - 1, -1, -1) & 1
    return np.packbits(planes.reshape(len(values), -1).astype("u1"), axis=1)


def packed_tiff(path, values, bits, order="<"):
    """A TIFF written by hand: one strip, no compression."""
    data = packed(values, bits).tobytes()
    height, width = values.shape
    tags = [(256, width), (257, height), (258, bits), (259, 1), (262, 1), (273, 8 + 2 + 9 * 12 + 4)]
    tags += [(277, 1), (278, height), (279, len(data))]
    head = (b"II" if order == "<" else b"MM") + struct.pack(order + "HI", 42, 8)
    entries = b"".join(struct.pack(order + "HHII", tag, 4, 1, value) for tag, value in tags)
    directory = struct.pack(order + "H", len(tags)) + entries + bytes(4)
    path.write_bytes(head + directory + data)
    return path


def tag(number, value):
    return struct.pack("<HHII", number, 4, 1, value)


def chunk(name, data):
    return struct.pack(">I", len(data)) + name + data + struct.pack(">I", zlib.crc32(name + data))


def png(path, image, *chunks):
    """By OpenCV, with chunks of one's own behind its header."""
    data = cv2.imencode(".png", image)[1].tobytes()
    path.write_bytes(data[:33] + b"".join(chunk(*each) for each in chunks) + data[33:])
    return path


def exr(path, channels, **header):
    OpenEXR.File({"type": OpenEXR.scanlineimage, **header}, channels).write(str(path))
    return path
