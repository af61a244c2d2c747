"""What `detect` writes: tables, points, pictures and a page, of whatever name and content."""

import csv
import json
import os
import re
import sys
from dataclasses import replace

import cv2
import numpy as np
import pytest
from artificial import line_image, paper_sensor
from data_dictionary import undocumented
from image_makers import ROW, picture, write_exr
from typer.testing import CliRunner

from virtual_sensor.cli.commands import app
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.image_files import find_images
from virtual_sensor.metrology.calibration import calibration_of, calibration_text
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.detectors import NAMES
from virtual_sensor.reporting import detect as reporting
from virtual_sensor.reporting.pictures import draw_picture
from virtual_sensor.studies.detect import Settings, detect

NASTY = (b"\xff\xe9 a\nb", b"$\\frac$ \x1b[31m" + "线".encode(), b"<script>alert('1')</script>")


def run(*arguments):
    return CliRunner().invoke(app, ["detect", *map(str, arguments)])


def rows(path):
    with path.open(encoding="utf-8") as file:
        return list(csv.DictReader(file))


def shots(folder):
    """Images of such names, and one of a plain one."""
    data = cv2.imencode(".png", picture(255, np.uint8))[1].tobytes()
    for name in (b"plain", *NASTY):
        (folder / os.fsdecode(name.replace(b"/", b"") + b".png")).write_bytes(data)
    return find_images([folder])[0]


@pytest.fixture
def undrawn(monkeypatch):
    """Commands that draw one panel only: of each image a picture's time is saved."""
    monkeypatch.setattr(
        reporting, "draw_picture", lambda title, panels, columns: draw_picture(title, panels[:1])
    )


def test_an_image_is_a_table_a_picture_a_page_and_a_summary(tmp_path):
    """The centres in the CSV are the line's, to what its grey steps allow."""
    cv2.imwrite(str(tmp_path / "line8.png"), picture(255, np.uint8))
    ended = run(tmp_path / "line8.png", "-o", tmp_path / "out")
    assert ended.exit_code == 0, ended.output
    found = rows(tmp_path / "out" / "line8.csv")
    assert [row["status"] for row in found] == ["ok"] * 90
    np.testing.assert_allclose([float(row["row_px"]) for row in found], ROW, atol=0.01)
    assert (tmp_path / "out" / "line8.png").stat().st_size > 20_000
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["images"]["line8"]["centres"] == 90
    assert summary["images"]["line8"]["median_width_px"] == pytest.approx(2.0, abs=0.02)
    assert summary["settings"]["detector"] == "gaussian"
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("<img ") == 6
    assert undocumented(tmp_path / "out", reporting.FILES) == []
    assert "90 line centres of 90 columns" in page


def test_exr_frames_of_ours_give_points_by_the_calibration_beside_them(
    tmp_path, undrawn, unpainted_test
):
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
    assert undocumented(tmp_path / "out", reporting.FILES) == []


def test_a_folder_is_taken_whole_and_peaks_and_detectors_are_passed_on(
    tmp_path, undrawn, unpainted_test
):
    """Two lines that stand upright in two images, found by rows, two peaks each.

    The lower one is none of the path's, but for who takes the highest peaks.
    """
    both = line_image(ROW, 2.0, 200.0) + line_image(np.full(90, 52.0), 2.0, 90.0)
    for name in ("a.png", "b.png"):
        cv2.imwrite(str(tmp_path / name), both.T.astype(np.uint8))
    (tmp_path / "notes.txt").write_text("no image")
    asked = ("--along", "rows", "--peaks", 2, "--detector", "fir8")
    for choose, status in (("highest", "ok"), ("path", "ghost")):
        ended = run(tmp_path / "b.png", *asked, "--choose", choose, "-o", tmp_path / choose)
        assert ended.exit_code == 0, ended.output
        found = [
            r for r in rows(tmp_path / choose / "b.csv") if r["peak"] == "1" and r["column_px"]
        ]
        assert len(found) > 80
        assert {row["status"] for row in found} == {status}
        np.testing.assert_allclose([float(row["column_px"]) for row in found], 52.0, atol=0.1)
    ended = run(tmp_path, *asked, "-o", tmp_path / "out")
    page = (tmp_path / "out" / "report.html").read_text()
    assert "Line centres in 2 images" in page
    assert "fir8, along rows, peaks 2" in page
    for name in "ab":
        (target,) = re.findall(rf'<a href="#([^"]*)">{name}</a>', page)
        assert f'<section id="{target}">' in page


@pytest.mark.parametrize("detector", ["steger", "numpy:nanargmax", "test_detect:brightest"])
def test_any_detector_works_from_the_command_line(
    tmp_path, detector, monkeypatch, undrawn, unpainted_test
):
    """Ours, and a user's own in the working folder; one that is unfit is refused."""
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
    shown = run("--help").output
    assert [name for name in NAMES if name not in shown] == []


def test_images_without_a_line_are_written_and_end_with_status_3(tmp_path, undrawn):
    """The table, the picture and the page say so; one image with a line among them is a success."""
    cv2.imwrite(str(tmp_path / "dark.png"), np.zeros((40, 50), np.uint8))
    cv2.imwrite(str(tmp_path / "line.png"), picture(255, np.uint8))
    for detector, reason in (("gaussian", ": 50 no peak"), ("steger", "")):
        out = tmp_path / detector
        ended = run(tmp_path / "dark.png", "--detector", detector, "-o", out)
        assert ended.exit_code == 3, ended.output
        said = f"No line centre was found{reason}."
        for text in (ended.output, (out / "report.html").read_text(encoding="utf-8")):
            assert said in text.replace("\N{NO-BREAK SPACE}", " ")
        assert not any(row["status"] == "ok" for row in rows(out / "dark.csv"))
        assert (out / "dark.png").stat().st_size > 5_000
    ended = run(tmp_path / "dark.png", tmp_path / "line.png", "-o", tmp_path / "both")
    assert ended.exit_code == 0, ended.output


def test_a_name_of_a_file_is_refused_for_the_folder_of_results(tmp_path):
    """Rationale: who asks for a picture or a workbook would find a folder of that name."""
    cv2.imwrite(str(tmp_path / "line.png"), picture(255, np.uint8))
    for name in ("found.jpg", "line.xlsx", "centres.csv"):
        ended = run(tmp_path / "line.png", "-o", tmp_path / name)
        assert isinstance(ended.exception, InputError)
        assert f"name a folder, such as -o {tmp_path / name.split('.')[0]}" in str(ended.exception)
        assert not (tmp_path / name).exists()


def test_clipped_centres_and_ghosts_are_told_from_others(tmp_path, undrawn):
    """A ghost has a place and is missing; a clipped centre counts, and is said to be clipped."""
    cv2.imwrite(str(tmp_path / "a.png"), picture(255, np.uint8))
    (found,) = detect([tmp_path / "a.png"], Settings())
    status = found.line.status.copy()
    status[:10], status[10:15], status[15:40] = Status.GHOST, Status.NO_PEAK, Status.CLIPPED
    found = replace(found, line=found.line.judged(status))
    out = tmp_path / "out"
    summary = reporting.save([found], [found.path], Settings(), out, "detect a.png")
    told = rows(out / "a.csv")
    assert [row["found"] for row in told] == ["0"] * 15 + ["1"] * 75
    assert [bool(row["row_px"]) for row in told] == [True] * 10 + [False] * 5 + [True] * 75
    assert summary.images["a"].along == "columns"
    page = (out / "report.html").read_text().replace("\N{NO-BREAK SPACE}", " ")
    assert "75 line centres (25 clipped) of 90 columns" in page
    assert "Without a centre: 10 ghost, 5 no peak." in page
    assert "75 (25 clipped)" in page
    shown = reporting._View(found)
    np.testing.assert_allclose(shown.ghosts[:, 1], ROW[:10], atol=0.02)
    assert len(shown.good) == 75


def test_folders_go_on_without_what_cannot_be_used(tmp_path, undrawn, unpainted_test):
    """A line for each of them, on the screen, on the page and in JSON; the status is 1.

    Where none can be used there are no results.
    """
    folder = tmp_path / "shots"
    folder.mkdir()
    whole = cv2.imencode(".jpg", picture(255, np.uint8))[1].tobytes()
    for name, data in (("a.jpg", whole), ("b", whole), ("cut.jpg", whole[:400]), ("no.png", b"?")):
        (folder / name).write_bytes(data)
    ended = run(folder, "-o", tmp_path / "out")
    assert ended.exit_code == 1, ended.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert {*summary["images"]} == {"a", "b"}
    assert [name.removeprefix(f"{folder}/") for name in summary["skipped"]] == ["cut.jpg", "no.png"]
    page = (tmp_path / "out" / "report.html").read_text()
    for text in (page, ended.output):
        assert "2 images could not be used." in text.replace("\N{NO-BREAK SPACE}", " ")
    assert "begins like none of PNG" in page
    assert not (tmp_path / "out" / "cut.csv").exists()
    ended = run(folder / "cut.jpg", folder / "no.png", "-o", tmp_path / "none")
    assert isinstance(ended.exception, InputError)
    assert "no.png: begins like" in str(ended.exception)
    assert "nor can the other image be used" in str(ended.exception)
    assert not (tmp_path / "none").exists()


def test_other_light_is_subtracted_by_dark_frames(tmp_path, undrawn, unpainted_test):
    """One for all, which may lie among the images; of a folder that of the name, or none."""
    other = 100 * (np.arange(64) > 32)[:, None] * np.ones((1, 90))
    for name, image in (("1.png", 0.5 * picture(255, float) + other), ("off.png", other)):
        cv2.imwrite(str(tmp_path / name), image.astype(np.uint8))
    ended = run(tmp_path, "--dark", tmp_path / "off.png", "-o", tmp_path / "out")
    assert ended.exit_code == 0, ended.output
    found = rows(tmp_path / "out" / "1.csv")
    np.testing.assert_allclose([float(row["row_px"]) for row in found], ROW, atol=0.02)
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert summary["dark"] == str(tmp_path / "off.png")
    (tmp_path / "dark").mkdir()
    for name in ("1.png", "2.png"):
        cv2.imwrite(str(tmp_path / "dark" / name), other.astype(np.uint8))
    ended = run(
        tmp_path / "1.png",
        tmp_path / "off.png",
        "--dark",
        tmp_path / "dark",
        "-o",
        tmp_path / "two",
    )
    assert "off.png" in ended.output
    assert "has no dark frame of its name" in " ".join(ended.output.split())
    ended = run(tmp_path / "1.png", "--dark", tmp_path / "1.png", "-o", tmp_path / "own")
    assert "is its own dark frame" in str(ended.exception)


def test_a_calibration_of_another_size_is_refused(tmp_path):
    """Points from the wrong camera would look right."""
    cv2.imwrite(str(tmp_path / "line.png"), picture(255, np.uint8))
    (tmp_path / "c.yaml").write_text(calibration_text(calibration_of(paper_sensor()), "c.yaml"))
    ended = run(tmp_path / "line.png", "--calibration", tmp_path / "c.yaml", "-o", tmp_path / "out")
    assert "90 x 64 px, but the calibration is of 2048 x 2048" in str(ended.exception)
    assert not (tmp_path / "out").exists()


def test_notes_are_said_once_for_all_images_and_stay_in_the_summary(
    tmp_path, undrawn, unpainted_test
):
    """What each file's reader assumed, what a folder held besides, on the screen and in JSON."""
    folder = tmp_path / "shots"
    folder.mkdir()
    for name in "abc":
        cv2.imwrite(str(folder / f"{name}.png"), picture(4095, np.uint16) << 4)
    (folder / "list.txt").touch()
    ended = run(folder, "--bits", 12, "-o", tmp_path / "out")
    assert ended.exit_code == 0, ended.output
    summary = json.loads((tmp_path / "out" / "summary.json").read_text())
    assert [summary["images"][name]["centres"] for name in "abc"] == [90, 90, 90]
    left_out, down = summary["notes"]
    assert left_out == f"{folder}: left out, as no images known here: list.txt."
    assert down.startswith(f"{folder / 'a.png'} and 2 more: its 12 bits lie at the top of 16")
    for note in (left_out, down):
        assert ended.output.count(f"Note: {note}") == 1


def test_no_saturation_beyond_what_a_file_can_hold(tmp_path, undrawn, unpainted_test):
    """8 bits clip at 255 whatever the camera is said to have; nan is no level at all."""
    clipped = np.minimum(2 * picture(255, np.uint8).astype(int), 255).astype(np.uint8)
    cv2.imwrite(str(tmp_path / "a.png"), clipped)
    for option, value, says in (
        ("--bits", 12, "8 bits, not the 12"),
        ("--saturation", 4e3, "4000"),
    ):
        ended = run(tmp_path / "a.png", option, value, "-o", tmp_path / option)
        summary = json.loads((tmp_path / option / "summary.json").read_text())
        assert summary["images"]["a"]["statuses"] == {"clipped": 90}
        assert says in ended.output
    for option in ("saturation", "noise", "gain", "min-amplitude", "max-width"):
        ended = run(tmp_path / "a.png", f"--{option}", "nan", "-o", tmp_path / "nan")
        assert isinstance(ended.exception, InputError), option
        assert "nan" in str(ended.exception)
    ended = run(tmp_path / "a.png", "--peaks", 10**9, "-o", tmp_path / "nan")
    assert "peaks must be a whole number from 1 to 100, not 1000000000" in str(ended.exception)


def test_what_a_calibration_leaves_open_is_noted(tmp_path, undrawn, unpainted_test):
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


def test_names_of_every_kind_are_drawn_and_written(tmp_path, undrawn):
    """Bytes that are no UTF-8, formulas, letters that the font lacks, control characters, HTML."""
    paths = shots(tmp_path)
    paths.append(paths[-1])
    found = detect(paths, Settings())
    summary = reporting.save(found, paths, Settings(), tmp_path / "out", "the <command>")
    assert len(summary.images) == len(NASTY) + 2
    for shown in summary.images:
        assert (tmp_path / "out" / f"{shown}.png").stat().st_size > 5_000
        assert shown.isprintable()
    page = (tmp_path / "out" / "report.html").read_text(encoding="utf-8")
    assert "<script" not in page
    assert "the &lt;command&gt;" in page
    files = json.loads((tmp_path / "out" / "summary.json").read_text(encoding="utf-8"))["images"]
    assert [each["file"] for each in files.values()] == [str(path) for path in paths]


def test_pages_open_in_a_browser_whatever_the_names(tmp_path, faults_of, undrawn):
    """Of one image and of several: pictures are there, links lead somewhere, nothing runs."""
    paths = shots(tmp_path)
    for some in (paths, paths[:1]):
        out = tmp_path / f"of_{len(some)}"
        reporting.save(detect(some, Settings()), some, Settings(), out, "<command>")
        assert faults_of(out / "report.html") == []


def test_of_many_images_the_page_shows_one_panel_each(
    tmp_path, undrawn, unpainted_test, monkeypatch
):
    """Rationale: a page of hundreds of pictures could not be opened; their files have them all."""
    monkeypatch.setattr(reporting, "MOST_WHOLE_PICTURES", 1)
    for name in ("a b", "a-b"):
        cv2.imwrite(str(tmp_path / f"{name}.png"), picture(255, np.uint8))
    paths, _ = find_images([tmp_path])
    seen = []
    reporting.save(
        *(detect(paths, Settings()), paths, Settings(), tmp_path / "out", "detect"),
        report=lambda stage, fraction: seen.append((stage, fraction)),
    )
    page = (tmp_path / "out" / "report.html").read_text()
    assert page.count("<img ") == 2
    assert 'href="a%20b.png"' in page
    assert len(set(re.findall(r'<section id="([^"]*)"', page))) == 5
    assert seen == [("a b", 0.0), ("a b", 0.5), ("a-b", 1.0)]


def test_pixels_are_square_or_the_title_says_how_they_are_stretched(tmp_path, unpainted_test):
    """Rationale: lines of 2048 x 40 px were drawn in any shape, and looked rough."""
    drawn = []

    def checked(title, panels, columns):
        from matplotlib.figure import Figure

        for panel in panels[:3]:
            axes = Figure().add_subplot()
            panel.draw(axes)
            stretch = re.search(r"([uv]) stretched ([\d.]+) x", panel.title)
            across = 1.0 if not stretch else float(stretch[2])
            aspect = axes.get_aspect()
            assert max(aspect, 1.0 / aspect) == pytest.approx(across, rel=0.05)
            assert bool(stretch) != ("square pixels" in panel.title)
            drawn.append((stretch or " ")[0][:1])
        return draw_picture(title, panels[:1])

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(reporting, "draw_picture", checked)
        lying = line_image(np.full(900, 200.0), 2.0, 200.0, height=400).astype(np.uint8)
        for name, image in (("lying", lying), ("upright", lying.T)):
            cv2.imwrite(str(tmp_path / "a.png"), image)
            (found,) = detect(
                [tmp_path / "a.png"], Settings(along="columns" if name == "lying" else "rows")
            )
            reporting.draw(found, name, Settings())
    assert drawn == [" ", "v", " ", " ", "u", " "]
