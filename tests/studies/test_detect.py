"""Users' images: every kind is read, what is found is in files, what can't be read is told."""

import csv
import json
import os
import sys

import cv2
import numpy as np
import OpenEXR
import pytest
from artificial import line_image, paper_sensor
from typer.testing import CliRunner

from virtual_sensor.cli.commands import app
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.image_files import find_images, read_image
from virtual_sensor.metrology.calibration import calibration_of, calibration_text
from virtual_sensor.metrology.detectors import NAMES
from virtual_sensor.studies.detect import detect
from virtual_sensor.studies.detect_results import names_of, save_detected
from virtual_sensor.studies.tables import write_json

ROW = 30.0 + 0.05 * np.arange(90)


def picture(top, dtype):
    return np.rint(line_image(ROW, 2.0, 0.8 * top, background=0.02 * top)).astype(dtype)


def write_exr(path, channels):
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    OpenEXR.File(header, channels).write(str(path))


def run(*arguments):
    return CliRunner().invoke(app, ["detect", *map(str, arguments)])


def rows(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


@pytest.mark.parametrize(
    ("name", "image", "options"),
    [
        ("line8.png", picture(255, np.uint8), ()),
        ("line16.png", picture(65535, np.uint16), ()),
        ("line12.tif", picture(4095, np.uint16), ("--bits", 12)),
        ("line8.tiff", picture(255, np.uint8), ()),
        ("float.tif", picture(255, np.float32) / 255, ()),
        ("line.bmp", picture(255, np.uint8), ()),
    ],
)
def test_pngs_and_tiffs_of_every_depth_are_read(tmp_path, name, image, options):
    """The centres in the CSV are the line's, to what its grey steps allow."""
    cv2.imwrite(str(tmp_path / name), image)
    ended = run(tmp_path / name, "-o", tmp_path / "out", *options)
    assert ended.exit_code == 0, ended.output
    stem = name.split(".")[0]
    found = rows(tmp_path / "out" / f"{stem}.csv")
    assert [row["status"] for row in found] == ["ok"] * 90
    np.testing.assert_allclose([float(row["row"]) for row in found], ROW, atol=0.01)
    assert (tmp_path / "out" / f"{stem}.png").stat().st_size > 20_000
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["images"][stem]["ok"] == 90


def test_exr_frames_of_ours_give_points_by_the_calibration_beside_them(tmp_path):
    """Centres, undistorted and triangulated, as PLY; the depth is the laser plane's."""
    sensor = paper_sensor()
    image = np.zeros((2048, 2048), np.float32)
    image[1000:1090, 900:990] = line_image(ROW, 2.0, height=90)
    truth = np.zeros_like(image)
    write_exr(tmp_path / "frame.exr", {"Y": image, "depth.Z": truth})
    text = calibration_text(calibration_of(sensor), "c.yaml")
    (tmp_path / "c.yaml").write_text(text)
    ended = run(
        tmp_path / "frame.exr", "--calibration", tmp_path / "c.yaml", "-o", tmp_path / "out"
    )
    assert ended.exit_code == 0, ended.output
    found = [row for row in rows(tmp_path / "out" / "frame.csv") if row["status"] == "ok"]
    points = np.array([[float(row[f"point_mm_{axis}"]) for axis in "xyz"] for row in found])
    normal, offset = sensor.laser.plane
    np.testing.assert_allclose(points @ normal, offset, atol=1e-9)
    assert (tmp_path / "out" / "frame.ply").read_bytes().startswith(b"ply")


def test_a_folder_is_taken_whole_and_peaks_ways_and_detectors_are_passed_on(tmp_path):
    """Two lines that stand upright in two images, found by rows, two peaks each."""
    both = line_image(ROW, 2.0, 200.0) + line_image(np.full(90, 52.0), 2.0, 90.0)
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), both.T.astype(np.uint8))
    (tmp_path / "notes.txt").write_text("no image")
    ended = run(
        tmp_path, "--along", "rows", "--peaks", 2, "--detector", "fir8", "-o", tmp_path / "out"
    )
    assert ended.exit_code == 0, ended.output
    assert "2 images" in ended.output
    found = [
        r for r in rows(tmp_path / "out" / "b.csv") if r["peak"] == "1" and r["status"] == "ok"
    ]
    assert len(found) > 80
    np.testing.assert_allclose([float(row["column"]) for row in found], 52.0, atol=0.1)


@pytest.mark.parametrize("detector", ["steger", "numpy:nanargmax", "test_detect:brightest"])
def test_any_detector_works_from_the_command_line(tmp_path, detector, monkeypatch):
    """Ours, and a user's own in the working folder; one that is unfit is told so."""
    monkeypatch.chdir(tmp_path)
    monkeypatch.setattr(sys, "path", list(sys.path))
    (tmp_path / "test_detect_mine.py").write_text("def brightest(i): return i.argmax(axis=0)\n")
    cv2.imwrite(str(tmp_path / "line.png"), picture(255, np.uint8))
    name = detector.replace("test_detect:", "test_detect_mine:")
    ended = run(tmp_path / "line.png", "--detector", name, "-o", tmp_path / "out")
    if detector.startswith("numpy"):
        assert isinstance(ended.exception, InputError)
        assert "give a row for each of the 90 columns" in str(ended.exception)
        assert not (tmp_path / "out").exists()
    else:
        assert ended.exit_code == 0, ended.output


def test_the_help_names_every_detector():
    """It's written by hand, so that asking for help imports none of them."""
    told = run("--help").output
    assert [name for name in NAMES if name not in told] == []


def test_an_image_without_a_line_gives_a_table_without_centres(tmp_path):
    """And a picture: a black frame is no error."""
    cv2.imwrite(str(tmp_path / "dark.png"), np.zeros((40, 50), np.uint8))
    for detector in ("gaussian", "steger"):
        ended = run(tmp_path / "dark.png", "--detector", detector, "-o", tmp_path / detector)
        assert ended.exit_code == 0, ended.output
        assert not any(row["status"] == "ok" for row in rows(tmp_path / detector / "dark.csv"))


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
    with pytest.raises(InputError, match=r"green\.png: is a colour image; say which --channel"):
        read_image(tmp_path / "green.png")
    with pytest.raises(InputError, match="no channel 'violet'"):
        read_image(tmp_path / "green.png", "violet")
    write_exr(tmp_path / "c.exr", {n: grey.astype(np.float32) * (n == "R") for n in "RGB"})
    for name in ("R", "red"):
        np.testing.assert_array_equal(read_image(tmp_path / "c.exr", name).pixels, grey)
    write_exr(tmp_path / "same.exr", {n: grey.astype(np.float32) for n in "RGB"})
    np.testing.assert_array_equal(read_image(tmp_path / "same.exr").pixels, grey)
    with pytest.raises(InputError, match="say which --channel"):
        read_image(tmp_path / "c.exr")


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


def test_a_calibration_of_another_size_is_refused(tmp_path):
    """Points from the wrong camera would look right."""
    cv2.imwrite(str(tmp_path / "line.png"), picture(255, np.uint8))
    (tmp_path / "c.yaml").write_text(calibration_text(calibration_of(paper_sensor()), "c.yaml"))
    ended = run(tmp_path / "line.png", "--calibration", tmp_path / "c.yaml", "-o", tmp_path / "out")
    assert "90 x 64 px, but the calibration is of 2048 x 2048" in str(ended.exception)
    assert not (tmp_path / "out").exists()


def test_notes_are_said_once_for_all_images_and_stay_in_the_summary(tmp_path):
    """What each file's reader assumed, what a folder held besides, on the screen and in JSON."""
    folder = tmp_path / "shots"
    folder.mkdir()
    for name in "abc":
        cv2.imwrite(str(folder / f"{name}.png"), picture(4095, np.uint16) << 4)
    (folder / "list.txt").touch()
    ended = run(folder, "--bits", 12, "-o", tmp_path / "out")
    assert ended.exit_code == 0, ended.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [summary["images"][name]["ok"] for name in "abc"] == [90, 90, 90]
    left_out, down = summary["notes"]
    assert left_out == f"{folder}: left out, as no images known here: list.txt."
    assert down.startswith(f"{folder / 'a.png'} and 2 more: its 12 bits lie at the top of 16")
    for note in (left_out, down):
        assert ended.output.count(f"Note: {note}") == 1


def test_a_line_that_stands_is_told_from_one_that_is_not_there(tmp_path):
    """Few columns show it, but the rows do: a hint, both ways; none where all is well or dark."""
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
        path, options = tmp_path / "a.png", {"along": along}
        hint = (f"{path}: shows its line along the {better}: give --along {better}.",)
        notes = detect([path], "gaussian", options, None, None, lambda *_: None)
        assert notes == hint * bool(better)


def test_no_saturation_beyond_what_a_file_can_hold(tmp_path):
    """8 bits clip at 255 whatever the camera is said to have; nan is no level at all."""
    clipped = np.minimum(2 * picture(255, np.uint8).astype(int), 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), clipped)
    for option, value, says in (
        ("--bits", 12, "8 bits, not the 12"),
        ("--saturation", 4e3, "4000"),
    ):
        ended = run(tmp_path / "a.png", option, value, "-o", tmp_path / option)
        summary = json.loads((tmp_path / option / "summary.json").read_text())
        assert summary["images"]["a"]["saturated"] == 90
        assert says in ended.output
    for option in ("saturation", "noise", "gain", "min-amplitude", "max-width"):
        ended = run(tmp_path / "a.png", f"--{option}", "nan", "-o", tmp_path / "nan")
        assert isinstance(ended.exception, InputError), option
        assert "nan" in str(ended.exception)
    ended = run(tmp_path / "a.png", "--peaks", 10**9, "-o", tmp_path / "nan")
    assert "peaks is 1000000000; give a whole number, 1 to 100" in str(ended.exception)


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


def test_what_a_calibration_leaves_open_is_noted(tmp_path):
    """Names that are taken for others, elements that are not used: on the screen and in JSON."""
    text = calibration_text(calibration_of(paper_sensor()), "c.json")
    known = json.loads(text) | {"image_width": 90, "image_height": 64, "reprojection_error": 0.1}
    known["R"], known["T"] = known.pop("rotation"), known.pop("translation")
    (tmp_path / "c.json").write_text(json.dumps(known))
    cv2.imwrite(str(tmp_path / "line.png"), picture(255, np.uint8))
    ended = run(tmp_path / "line.png", "--calibration", tmp_path / "c.json", "-o", tmp_path / "out")
    notes = json.loads((tmp_path / "out" / "summary.json").read_text())["notes"]
    assert [note.split(": ", 1)[1] for note in notes] == [
        "'R' is taken as 'rotation'.",
        "'T' is taken as 'translation'.",
        "not used: 'reprojection_error'.",
    ]
    assert all(note in ended.output for note in notes)


def test_names_of_every_kind_are_drawn(tmp_path):
    """Bytes that are no UTF-8, formulas, letters that the font lacks, control characters."""
    folder = tmp_path / "shots"
    folder.mkdir()
    data = cv2.imencode(".png", picture(255, np.uint8))[1].tobytes()
    names = [b"\xff\xe9 a\nb", b"$\\frac$ \x1b[31m" + "线".encode()]
    for name in names:
        (folder / f"{os.fsdecode(name)}.png").write_bytes(data)
    paths, _ = find_images([folder])
    found = []
    detect(paths, "gaussian", {}, None, None, lambda each, number: found.append(each))
    for shown, each in zip(names_of([*paths, paths[-1]]), [*found, found[-1]], strict=True):
        save_detected(each, shown, tmp_path)
        assert (tmp_path / f"{shown}.png").stat().st_size > 20_000
        assert shown.isprintable()
    assert len(found) == len(names)
    write_json(tmp_path / "paths.json", paths := [str(path) for path in paths])
    assert json.loads((tmp_path / "paths.json").read_text()) == paths
