"""A burst's files, picture and page say what it measured, and where it sways most."""

import csv
import json

import cv2
import numpy as np
import OpenEXR
import pytest
from command_line import command
from data_dictionary import undocumented
from matplotlib.figure import Figure
from swaying_plume import FILM, swaying_scene

from virtual_sensor.errors import NothingFoundError
from virtual_sensor.files import folder_written_whole
from virtual_sensor.reporting import burst as module
from virtual_sensor.reporting.burst import (
    FILES,
    FrameFiles,
    draw,
    draw_views,
    lead,
    save,
    table,
)
from virtual_sensor.studies.burst import burst

FRAMES = 4


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """Folder of a burst's results."""
    return tmp_path_factory.mktemp("burst")


@pytest.fixture(scope="module")
def result(folder):
    """A burst whose frames are written."""
    scene = swaying_scene(folder.parent / "sway.nc")
    return burst(scene, None, 0.5, FRAMES, each_frame=FrameFiles(folder, scene))


@pytest.fixture(scope="module")
def written(result, folder):
    """The folder, with all files in it."""
    save(result, folder, "virtual-sensor burst '<script>'")
    return folder


@pytest.fixture(scope="module")
def pictures(result, without_paint):
    """Its pictures: the figures, and some frames; those in its folder are painted."""
    with without_paint():
        return draw(result), draw_views(result)


@pytest.fixture
def drawn(pictures, monkeypatch):
    """The pictures are not drawn again."""
    monkeypatch.setattr(module, "draw", lambda *_: pictures[0])
    monkeypatch.setattr(module, "draw_views", lambda *_: pictures[1])


def rows_of(path):
    """Rows of a CSV file, by column."""
    with path.open(encoding="utf-8", newline="") as file:
        return list(csv.DictReader(file))


def test_every_file_is_written_and_listed(written, faults_of):
    """Rationale: what no dictionary lists is guessed at, and a page must have no faults."""
    names = {str(p.relative_to(written)) for p in written.rglob("*") if p.is_file()}
    assert {name for name in names if not name.startswith("frames/")} == {
        *("sway.csv", "probe_rays.csv", "frames.csv", "sway.ply"),
        *("report.png", "report.html", "summary.json"),
    }
    assert undocumented(written, FILES) == []
    assert faults_of(written / "report.html") == []
    assert "<script>" not in (written / "report.html").read_text(encoding="utf-8").lower()


def test_frames_are_named_by_their_instants_and_hold_the_frame(written, result):
    """Rationale: of 100 frames one is looked for by its time; PNG and EXR show the same light."""
    stems = [f"{i:04d}_{t:.6f}s" for i, t in enumerate(result.time_s)]
    images = written / "frames"
    assert {p.name for p in images.iterdir()} == {f"{s}.{e}" for s in stems for e in ("exr", "png")}
    whites = []
    for stem in stems:
        with OpenEXR.File(str(images / f"{stem}.exr")) as file:
            radiance = file.channels()["Y"].pixels
            assert float(file.header()["virtual_sensor/time"]) == pytest.approx(
                float(stem[5:-1]), abs=1e-6
            )
        grey = cv2.imread(str(images / f"{stem}.png"), cv2.IMREAD_UNCHANGED)
        assert grey.dtype == np.uint16
        whites.append(65535.0 * radiance.max() / grey.max())
    np.testing.assert_allclose(whites, whites[0], rtol=1e-4)


def test_the_tables_are_the_files(written, result):
    """Rationale: what is drawn and what is written are the same numbers."""
    rows = rows_of(written / "sway.csv")
    for name, values in result.sway_table.columns().items():
        if values.dtype.kind == "f":
            cells = np.array([float(row[name] or "nan") for row in rows])
            np.testing.assert_allclose(cells, values, rtol=1e-9)
    summary = json.loads((written / "summary.json").read_text(encoding="utf-8"))
    assert summary["frames"] == FRAMES
    assert summary["line"]["height_um"]["largest"] == result.summary.line.height_um.largest


def test_the_lead_names_the_largest_sway_and_where(result):
    """Rationale: the one figure that a user runs a burst for, beside the error that stays."""
    line = result.sway_table
    at = int(np.nanargmax(line.std_height_um))
    words = lead(result.summary)
    assert f"up to {line.std_height_um[at]:.3g} µm" in words
    assert f"at y = {line.y_mm[at]:.3g} mm" in words
    assert f"is {line.static_error_um[at]:.3g} µm there" in words
    assert [row[0] for row in table(result.summary).rows][2] == "line: measured height, µm"


def test_the_largest_sway_is_drawn_whether_or_not_every_frame_has_it():
    """Rationale: it was left out where one frame has no centre, and said in the summary only."""
    frames = np.array([4, 4, 3, 4, 2])
    std = np.array([1.0, 2.0, 9.0, 3.0, np.nan])
    line = type("Line", (), {"frames": frames})
    axes = Figure().add_subplot()
    module._std(axes, line, np.arange(5.0), std, "µm", "y in mm")
    drawn = {(x, y) for each in axes.lines for x, y in zip(*each.get_data(), strict=True)}
    assert {(float(i), value) for i, value in enumerate(std[:4])} <= drawn
    assert [text.get_text() for text in axes.texts] == ["largest: 9 µm, in 3 of 4 frames"]
    assert "not in every frame" in axes.get_xlabel()
    assert axes.get_ylim()[1] > 9.0


def test_pictures_have_words_for_who_cannot_see_them(pictures):
    """Rationale: a page is read aloud, too."""
    for picture in pictures:
        assert all(panel.alt and panel.png for panel in picture.panels)
    assert pictures[1].panels[0].title == "At 5.5 s, and minus the mean"


def test_an_interrupted_burst_leaves_nothing(result, tmp_path, monkeypatch):
    """Rationale: Ctrl-C while the page is drawn, when the tables are written already."""

    def interrupted(*_):
        raise KeyboardInterrupt

    monkeypatch.setattr(module, "draw", interrupted)
    with pytest.raises(KeyboardInterrupt), folder_written_whole(tmp_path / "sway") as place:
        save(result, place, "c")
    assert list(tmp_path.iterdir()) == []


def test_the_command_passes_on_what_is_asked_for(result, drawn, tmp_path, monkeypatch):
    """Rationale: its work is tested above; here, that the options reach it and its answer the user.

    Results that are there are not replaced.
    """
    asked = []

    def answered(scene, start_s, duration_s, frames, report, y_mm, **more):
        asked.append((scene.parameters["field"], start_s, duration_s, frames, y_mm, list(more)))
        return result

    monkeypatch.setattr("virtual_sensor.studies.burst.burst", answered)
    file, place = str(result.scene.air.path), tmp_path / "sway"
    words = ["burst", "hot_cylinder", "-D", f"field={file}", "-o", place]
    options = ["--start", "5.5", "--duration", "0.5", "--frames", "5", "-y", "-1", "-y", "2"]
    status, out, err = command(*words, *options)
    assert (status, err) == (0, "")
    assert asked == [(file, 5.5, 0.5, 5, [-1.0, 2.0], ["recording"])]
    assert lead(result.summary) in out
    assert (place / "sway.csv").exists()
    status, _, err = command(*words)
    assert (status, len(asked)) == (2, 1)
    assert "--overwrite" in err


def test_a_frame_without_a_line_ends_the_command_with_status_3(monkeypatch, tmp_path):
    """Rationale: a script tells what was not found from what was given wrongly."""

    def nothing(*_, **__):
        raise NothingFoundError("scene.xml: no line in the frame")

    monkeypatch.setattr("virtual_sensor.studies.burst.burst", nothing)
    status, _, err = command("burst", "hot_cylinder", "-o", tmp_path / "sway")
    assert (status, err) == (3, "Error: scene.xml: no line in the frame\n")
    assert not (tmp_path / "sway").exists()


def test_the_command_writes_the_frames_that_are_asked_for(result, drawn, tmp_path):
    """Rationale: they are written while the burst goes on, and move along with its results."""
    film = [word for name, value in FILM.items() for word in ("-D", f"{name}={value}")]
    words = ["burst", "hot_cylinder", "-D", f"field={result.scene.air.path}", *film, "-D", "spp=1"]
    words += ["--duration", "0.5", "--frames", "3", "--images", "-o", tmp_path / "sway"]
    assert command(*words)[0] == 0
    names = [path.name for path in (tmp_path / "sway/frames").glob("*.exr")]
    assert sorted(names) == [f"000{i}_{t:.6f}s.exr" for i, t in enumerate((5.5, 5.75, 6.0))]
