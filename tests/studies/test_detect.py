"""Users' images: every kind is read, and what can't be read is refused in a line."""

import os

import cv2
import numpy as np
import pytest
from image_makers import ROW, picture, write_exr
from typer.testing import CliRunner

from virtual_sensor.cli.commands import app
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.image_files import find_images, read_image
from virtual_sensor.studies.detect import Settings, detect, joined_notes


def run(*arguments):
    return CliRunner().invoke(app, ["detect", *map(str, arguments)])


def test_pngs_and_tiffs_of_every_depth_are_read(tmp_path):
    """The centres are the line's, to what the file's grey steps allow."""
    for name, image, bits in (
        ("line8.png", picture(255, np.uint8), None),
        ("line16.png", picture(65535, np.uint16), None),
        ("line12.tif", picture(4095, np.uint16), 12),
        ("line8.tiff", picture(255, np.uint8), None),
        ("float.tif", picture(255, np.float32) / 255, None),
        ("line.bmp", picture(255, np.uint8), None),
    ):
        cv2.imwrite(str(tmp_path / name), image)
        (found,) = detect([tmp_path / name], Settings(bits=bits))
        assert found.summary.statuses == {"ok": 90}, name
        np.testing.assert_allclose(found.centres.row_px, ROW, atol=0.01, err_msg=name)


def test_colours_are_asked_for_by_name(tmp_path):
    """A laser is of one colour; a grey picture saved as colour needs no word."""
    grey = picture(255, np.uint8)
    colour = np.stack([0 * grey, grey, 0 * grey], axis=-1)
    cv2.imwrite(str(tmp_path / "green.png"), colour)
    cv2.imwrite(str(tmp_path / "grey.png"), np.stack([grey] * 3, axis=-1))
    cv2.imwrite(str(tmp_path / "alpha.png"), np.stack([grey] * 4, axis=-1))
    np.testing.assert_array_equal(read_image(tmp_path / "green.png", "green").pixels, grey)
    np.testing.assert_array_equal(read_image(tmp_path / "grey.png").pixels, grey)
    np.testing.assert_array_equal(read_image(tmp_path / "alpha.png").pixels, grey)
    with pytest.raises(InputError, match="no channel 'violet'"):
        read_image(tmp_path / "green.png", "violet")
    write_exr(tmp_path / "c.exr", {n: grey.astype(np.float32) * (n == "R") for n in "RGB"})
    for name in ("R", "red"):
        np.testing.assert_array_equal(read_image(tmp_path / "c.exr", name).pixels, grey)
    write_exr(tmp_path / "same.exr", {n: grey.astype(np.float32) for n in "RGB"})
    np.testing.assert_array_equal(read_image(tmp_path / "same.exr").pixels, grey)
    write_exr(tmp_path / "d.exr", {n: grey.astype(np.float32) * (n == "a") for n in "ab"})
    with pytest.raises(InputError, match="say which channel: a, b"):
        read_image(tmp_path / "d.exr")


def test_the_colour_of_an_image_is_that_of_the_laser_or_of_the_line(tmp_path):
    """A clipped line is white, with a coloured rim; a background of another colour misleads nobody.

    Light that is lost in what the laser scatters is sought in the next colour; a line of no colour
    is read from the green, of which sensors have the most pixels.
    """
    line = np.minimum(3 * picture(255, np.uint8).astype(int), 255)
    faint = line // 3
    for number, name in enumerate(("red", "green", "blue")):
        planes = [np.minimum(line, 250) * 9 // 10 if n == number else faint for n in range(3)]
        others = [n for n in range(3) if n != number]
        planes[others[0]] = np.minimum(planes[others[0]] + 120, 255)  # the part's own colour
        path = tmp_path / f"{name}.png"
        cv2.imwrite(str(path), np.stack(planes[::-1], axis=-1).astype(np.uint8))
        read = read_image(path)
        assert read.channel == name
        assert f"its {name} channel is read, in which a line stands out most" in read.notes[-1]
    scattered = np.where(line > 20, 255, 180)  # the laser's light about a line that is clipped
    clipped = np.stack([line // 2, np.minimum(line, 255), scattered], axis=-1).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "clipped.png"), clipped)
    assert read_image(tmp_path / "clipped.png").channel == "green"
    white = np.stack([line, line - line // 50, line], axis=-1).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "white.png"), white)
    assert read_image(tmp_path / "white.png").channel == "green"
    for nm, name in ((405, "blue"), (450, "blue"), (520, "green"), (532, "green"), (660, "red")):
        assert read_image(tmp_path / "white.png", wavelength_nm=nm).channel == name
    assert read_image(tmp_path / "white.png", "red", wavelength_nm=405).channel == "red"
    huge = np.full(line.shape, 3e38, np.float32)
    huge[3, 4:6] = np.nan, np.inf
    write_exr(tmp_path / "huge.exr", {"R": huge, "G": huge / 2, "B": 0 * picture(255, np.float32)})
    assert read_image(tmp_path / "huge.exr").channel in ("red", "green")
    flat = np.zeros((1, 3_000_000, 3), np.uint8)
    flat[..., 0] = 200
    cv2.imwrite(str(tmp_path / "flat.ppm"), flat)
    assert read_image(tmp_path / "flat.ppm").channel == "green"
    with pytest.raises(InputError, match=r"wavelength_nm is 0\.532; give it in nm"):
        read_image(tmp_path / "white.png", wavelength_nm=0.532)


@pytest.mark.parametrize("ending", ["png", "tif", "exr", "bmp"])
@pytest.mark.parametrize("part", [0.0, 0.02, 0.5, 0.97])
def test_truncated_files_are_refused(tmp_path, ending, part, capfd):
    """Empty, cut short, cut at the end: a line with the file's name, not half an image."""
    whole = tmp_path / f"whole.{ending}"
    if ending == "exr":
        write_exr(whole, {"Y": picture(255, np.float32)})
    else:
        cv2.imwrite(str(whole), picture(255, np.uint8))
    data = whole.read_bytes()
    cut = tmp_path / f"cut.{ending}"
    cut.write_bytes(data[: int(part * len(data))])
    with pytest.raises(InputError, match=rf"cut\.{ending}"):
        read_image(cut)
    assert "Traceback" not in capfd.readouterr().err


def test_files_that_are_no_images_are_refused(tmp_path):
    """Rubbish, another type, none at all, a folder without any."""
    for name in ("rubbish.png", "rubbish.tif", "rubbish.exr", "text.jpeg"):
        (tmp_path / name).write_bytes(b"this is no image" * 10)
        with pytest.raises(InputError, match=name.split(".")[0]):
            read_image(tmp_path / name)
    (tmp_path / "empty").mkdir()
    with pytest.raises(InputError, match="holds no image"):
        find_images([tmp_path / "empty"])
    with pytest.raises(InputError, match="no such image"):
        find_images([tmp_path / "missing.png"])


def test_a_line_that_stands_is_told_from_one_that_is_not_there(tmp_path):
    """Few columns show it, but the rows do: a hint; none where all is well or dark."""
    lying = picture(255, np.uint8)
    cases = {
        ("lying", "columns"): None,
        ("lying", "rows"): "columns",
        ("standing", "columns"): "rows",
        ("standing", "rows"): None,
        ("clipped", "columns"): "rows",
        ("dark", "columns"): None,
    }
    clipped = np.minimum(2 * lying.astype(int), 255).astype(np.uint8).T
    images = {"lying": lying, "standing": lying.T, "clipped": clipped, "dark": 0 * lying}
    for (name, along), better in cases.items():
        cv2.imwrite(str(tmp_path / "a.png"), images[name])
        path = tmp_path / "a.png"
        hint = (f"{path}: shows its line along the {better}: give --along {better}.",)
        (found,) = detect([path], Settings(along=along))
        notes = joined_notes([(path, found.remarks)])
        assert notes == hint * bool(better)


def test_pipes_devices_and_folders_named_like_images_are_refused(tmp_path):
    """At once: whoever opens a pipe waits for a writer."""
    os.mkfifo(tmp_path / "a.png")
    (tmp_path / "b.tif").mkdir()
    (tmp_path / "c.exr").symlink_to("/dev/zero")
    os.mkfifo(tmp_path / "c.yaml")
    for name, says in (("a.png", "is a pipe"), ("b.tif", "is a folder"), ("c.exr", "is a device")):
        with pytest.raises(InputError, match=says):
            read_image(tmp_path / name)
    ended = run(tmp_path / "a.png", "--calibration", tmp_path / "c.yaml", "-o", tmp_path / "out")
    assert "c.yaml: is a pipe" in str(ended.exception)


def test_where_one_colour_is_clipped_too_far_another_gives_the_centre(tmp_path):
    """Rationale: the laser's own colour glows all over a bright part, whose line is green's."""
    lit = picture(255, np.uint8)
    red, green = lit.copy(), lit // 5
    red[:45, 50:], green[:, 50:] = 255, lit[:, 50:] // 2
    cv2.imwrite(str(tmp_path / "a.png"), np.dstack([0 * red, green, red]))
    (found,) = detect([tmp_path / "a.png"], Settings(along="columns"))
    np.testing.assert_allclose(found.line.row[found.line.found], ROW[found.line.found], atol=0.05)
    assert found.line.found.mean() > 0.9
    assert any("centres of its green channel" in remark for remark in found.remarks)
    (alone,) = detect([tmp_path / "a.png"], Settings(along="columns", channel="red"))
    assert alone.line.found.mean() < 0.6
