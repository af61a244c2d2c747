"""The command: what it writes, what it says when it can't, and what it leaves when it is killed."""

import csv
import json
import re
import resource
import signal
import subprocess
import sys
import threading
from importlib import metadata
from pathlib import Path

import cv2
import numpy as np
import OpenEXR
import pytest
from command_line import command

from virtual_sensor.reporting import measure as results

# What pictures show, tests/reporting looks at.
pytestmark = pytest.mark.usefixtures("unpainted")

HOT_FILM = ["-D", "width=512", "-D", "height=512", "-D", "spp=4"]
COLD_FILM = ["-D", "width=256", "-D", "height=256", "-D", "spp=1", "-D", "line_radius=0.5"]
COLD = ["cold_cylinder", *COLD_FILM]
FILES = {
    *("cold.exr", "cold.png", "line_cold.csv", "points_cold.ply"),
    *("hot.exr", "hot.png", "line_hot.csv", "points_hot.ply"),
    *(
        "probe_rays.csv",
        "dense_search.csv",
        "report.png",
        "report.html",
        "summary.json",
        "table.md",
    ),
    "calibration.yaml",
}


def refusal(*arguments):
    """Run a command that is refused in one line; give the line."""
    status, out, err = command(*arguments)
    assert (status, out) == (2, "")
    assert err.startswith("Error: ")
    assert err.count("\n") == 1
    return err


def table(path):
    """Columns of a CSV file: numbers as an array, with NaN for empty cells, else text."""
    with path.open(encoding="utf-8", newline="") as file:
        header, *rows = csv.reader(file)
    columns = {}
    for name, cells in zip(header, zip(*rows, strict=True), strict=True):
        try:
            columns[name] = np.array([float(cell or "nan") for cell in cells])
        except ValueError:
            columns[name] = np.array(cells)
    return columns


@pytest.fixture
def here(tmp_path, monkeypatch):
    """An empty folder to stand in."""
    monkeypatch.chdir(tmp_path)
    return tmp_path


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    """Folder of a hot cylinder's measurement on a small film, and what was said."""
    folder = tmp_path_factory.mktemp("measure") / "measured"
    status, out, err = command("measure", "hot_cylinder", *HOT_FILM, "-D", "beta=15", "-o", folder)
    assert (status, err) == (0, "")
    return folder, out


@pytest.fixture(scope="module")
def summary(measured):
    """The measurement's figures."""
    return json.loads((measured[0] / "summary.json").read_text(encoding="utf-8"))


FIELD = ["field info", "field import", "field simulate", "field convergence"]


@pytest.mark.parametrize("name", ["measure", "search", "burst", "sweep", "doctor", *FIELD])
def test_help_shows_examples(name):
    """Rationale: an example is what is copied first."""
    status, out, _ = command(*name.split(), "--help")
    assert status == 0
    examples = out.partition("Examples:")[2]
    assert len(re.findall(rf"virtual-sensor [^\n]*\b{name}\b", examples)) >= 2


def test_help_shows_the_first_command_to_type():
    """Rationale: the bare command is what is typed before anything is read."""
    for arguments in ([], ["--help"]):
        assert "virtual-sensor measure hot_cylinder" in command(*arguments)[1]


def test_the_version_is_told():
    """Rationale: the first question to anybody who reports a fault."""
    assert command("--version")[1] == f"virtual-sensor {metadata.version('virtual-sensor')}\n"


def test_the_doctor_finds_this_machine_fit():
    """Rationale: with an engine that runs these tests it must not find fault."""
    status, out, _ = command("doctor")
    assert status == 0
    assert out.startswith("This machine can run virtual-sensor.\n")


@pytest.mark.parametrize(
    ("arguments", "told"),
    [
        ("measure nope", "nope: .*cold_cylinder, .*hot_cylinder, stepped_shaft"),
        ("search nope.xml", r"nope\.xml: .*cold_cylinder, .*hot_cylinder, stepped_shaft"),
        ("measure hot_cylinder -D beta", "-D beta: write it as NAME=VALUE, such as -D beta=15"),
        ("measure hot_cylinder -D =15", "-D =15: write it as NAME=VALUE"),
        (
            "search hot_cylinder -D bate=15",
            "^Error: hot_cylinder: no parameter 'bate'; the scene has: along, alpha, beam_quality",
        ),
        ("search hot_cylinder -D temperature=-300", "below absolute zero .* give .* in degC"),
        (
            "search hot_cylinder -D temperature=1000",
            r"1000C.*\.nc: there is no such field.*1250C",
        ),
        ("measure hot_cylinder -D beta=120", "under the floor .* turn the sensor less"),
        ("search cold_cylinder -D alpha=0", "turn the camera out of the plane"),
        ("search cold_cylinder --method old", "--method old: choose paper, newton or tabulated"),
        ("search cold_cylinder -y 1 -y nan", r"y are \[1\.0, nan\]; give finite numbers in mm"),
        ("search cold_cylinder -y 1 --rays 5", "-y and --rays: choose one of them"),
        ("--variant scalar_rgb search cold_cylinder", "scalar_rgb"),
        ("measure cold_cylinder -o file/results", "file/results: can't be written"),
        ("search cold_cylinder -o /proc/nowhere.csv", "/proc/nowhere.csv: can't be written"),
        ("measure cold_cylinder -o file --overwrite", "file: is not a folder; name another"),
        ("search cold_cylinder -o . --overwrite", "is not a file; name another"),
    ],
)
def test_a_users_slip_is_told_in_one_line_with_the_remedy(here, arguments, told):
    """Rationale: a traceback says whose fault it is, and it says it wrongly."""
    Path("file").touch()
    assert re.search(told, refusal(*arguments.split()))
    assert list(here.iterdir()) == [here / "file"]


@pytest.mark.parametrize("words", ["measure", "measure a b", "search a --rays few", "mesure a"])
def test_a_command_line_that_makes_no_sense_exits_with_2(words):
    """Rationale: the shell's convention, and the same as for our own refusals."""
    status, out, err = command(*words.split())
    assert (status, out) == (2, "")
    assert "Traceback" not in err


@pytest.mark.parametrize("name", ["measure", "search"])
def test_existing_results_are_refused_before_any_work(here, monkeypatch, name):
    """Rationale: to compute for a minute and then refuse to write is a minute lost."""
    monkeypatch.setattr(
        "virtual_sensor.imaging.scene.load_scene", lambda *_, **__: pytest.fail("work was begun")
    )
    Path("old").write_text("old")
    told = refusal(name, "hot_cylinder", "-o", "old")
    assert "old: exists; name another with -o, or say --overwrite" in told
    assert Path("old").read_text() == "old"


def test_the_probe_rays_of_a_scene_are_all_found(here):
    """Rationale: the search's default, by the paper's search with its r_max of 1 um."""
    status, out, _ = command("search", "hot_cylinder")
    assert status == 0
    assert out.count(" found ") == 9
    status, out, _ = command("search", "hot_cylinder", "-o", "runs/rays[a].csv")
    assert status == 0
    end = r"[\d.]+ (ms|s|min) in all; 9 of 9 rays found, table in runs/rays\[a\].csv\n"
    assert re.fullmatch(end, out)
    rays = table(here / "runs" / "rays[a].csv")
    np.testing.assert_allclose(rays["y_mm"], np.linspace(-9.79, 9.79, 9), atol=0.05)
    assert rays["distance_um"].max() < 1.0
    assert set(rays["status"]) == {"found"}


def test_both_searches_find_the_same_pixels(here):
    """Rationale: they share the march and nothing else; 1 um is 1/22 px."""
    for method in ("paper", "newton"):
        command("search", "hot_cylinder", "--method", method, "--rays", 5, "-o", f"{method}.csv")
    paper, newton = table(here / "paper.csv"), table(here / "newton.csv")
    np.testing.assert_allclose(paper["y_mm"], [-11.0, -5.5, 0.0, 5.5, 11.0])
    for axis in "uv":
        apart = np.abs(paper[f"pixel_{axis}"] - newton[f"pixel_{axis}"])
        assert apart.max() < 1.05e-3 / 22e-3


def test_rays_are_searched_where_the_user_says(here):
    """Rationale: -y repeats, takes negative numbers, and keeps their order; misses are rows too."""
    command("search", "cold_cylinder", "-y", "-5", "-y", "3", "-y", "14", "-o", "rays.csv")
    rays = table(here / "rays.csv")
    np.testing.assert_array_equal(rays["y_mm"], [-5.0, 3.0, 14.0])
    assert list(rays["status"]) == ["found", "found", "laser_missed"]
    assert np.isnan(rays["pixel_u"][2])
    np.testing.assert_allclose(rays["laser_point_mm_y"][:2], [-5.0, 3.0], atol=1e-9)


def test_a_measurement_writes_all_its_files(measured):
    """Rationale: the set is what the README promises; and no temporary file is among them."""
    folder, out = measured
    assert {path.name for path in folder.iterdir()} == FILES
    assert {path.name for path in folder.parent.iterdir()} == {"measured"}
    assert f"results in {folder}, open {folder}/report.html first\n" in out
    for picture in ("report.png", "cold.png"):
        assert cv2.imread(str(folder / picture), cv2.IMREAD_UNCHANGED) is not None


@pytest.mark.parametrize("state", ["cold", "hot"])
def test_the_frame_opens_with_its_ground_truth(measured, state):
    """Rationale: EXR for other programs: named float channels, and how the frame was made."""
    with OpenEXR.File(str(measured[0] / f"{state}.exr"), separate_channels=True) as file:
        header = dict(file.header())
        channels = {name: channel.pixels for name, channel in file.channels().items()}
    assert header["virtual_sensor/beta"] == "15"
    assert header["virtual_sensor/state"] == state
    assert set(channels) == {
        *("Y", "point.X", "point.Y", "point.Z", "depth.Z", "laser.a", "laser.b", "lit"),
    }
    assert {(c.dtype.name, c.shape) for c in channels.values()} == {("float32", (512, 512))}
    lit = channels["lit"] == 1.0
    assert lit.any()
    assert np.isfinite(channels["point.X"][lit]).all()
    assert np.isnan(channels["point.X"][~lit]).all()
    radius = np.hypot(channels["point.Y"], channels["point.Z"] + 13.5)[lit]
    np.testing.assert_allclose(radius, 13.5, atol=1e-4)


def test_the_pictures_use_all_of_their_16_bits(measured):
    """Rationale: cold and hot share one white, the brighter one's maximum, to be comparable."""
    frames, pictures = {}, {}
    for state in ("cold", "hot"):
        with OpenEXR.File(str(measured[0] / f"{state}.exr"), separate_channels=True) as file:
            frames[state] = file.channels()["Y"].pixels
        pictures[state] = cv2.imread(str(measured[0] / f"{state}.png"), cv2.IMREAD_UNCHANGED)
        assert pictures[state].dtype == np.uint16
    assert max(picture.max() for picture in pictures.values()) == 65535
    white = max(frame.max() for frame in frames.values())
    for state, picture in pictures.items():
        np.testing.assert_allclose(picture, frames[state] / white * 65535.0, atol=0.51)


@pytest.mark.parametrize("state", ["cold", "hot"])
def test_line_points_and_summary_agree(measured, summary, state):
    """Rationale: one result in three files."""
    line = table(measured[0] / f"line_{state}.csv")
    found = line["status"] == "ok"
    assert found.sum() == summary["states"][state]["line_status"]["ok"] > 200
    np.testing.assert_array_equal(line["column_px"], np.arange(512))
    assert np.isnan(line["row_px"][~found]).all()
    header, _, body = (measured[0] / f"points_{state}.ply").read_bytes().partition(b"end_header\n")
    assert f"element vertex {found.sum()}\n".encode() in header
    cloud = np.frombuffer(body, "<f4").reshape(-1, 4)
    points = np.stack([line[f"point_mm_{axis}"] for axis in "xyz"], axis=1)
    np.testing.assert_allclose(cloud[:, :3], points[found], atol=1e-5)
    np.testing.assert_allclose(cloud[:, 3], line["amplitude"][found], rtol=1e-6)


def test_searched_rays_are_written_for_both_states(measured):
    """Rationale: A is cold, B is hot, as in the paper; at beta = 15 all rays are seen."""
    probes, dense = (table(measured[0] / f"{name}.csv") for name in ("probe_rays", "dense_search"))
    assert (len(probes["y_mm"]), len(dense["y_mm"])) == (9, 401)
    for state in ("cold", "hot"):
        for status in ("status", "paper_status"):
            assert set(probes[f"{status}_{state}"]) == {"found"}
        assert set(dense[f"status_{state}"]) == {"found"}
    A, B = (
        np.stack([probes[f"incidence_{state}_mm_{axis}"] for axis in "xyz"], axis=1)
        for state in ("cold", "hot")
    )
    apart = 1e3 * (B - A)
    np.testing.assert_allclose(apart[:, 1], probes["incidence_shift_um_y"], atol=1e-3)
    lengths = np.linalg.norm(apart, axis=1)
    np.testing.assert_allclose(lengths, probes["incidence_shift_um_norm"], atol=1e-3)


def test_the_summary_has_the_figures(measured, summary):
    """Rationale: what a script reads to decide whether a measurement is sound."""
    assert summary["scene"].endswith("hot_cylinder.xml")
    assert summary["parameters"]["beta"] == "15"
    assert summary["notes"] == []
    for state in summary["states"].values():
        agreement = state["line_minus_search"]
        assert 0.0 < agreement["rms_px"] < agreement["largest_px"] < 0.01
        assert agreement["compared"] == agreement["expected"]
        assert state["paper_search"]["found"] == 9
    assert summary["probe_rays"]["largest_cold_error_um"] < 1e-6
    said = measured[1]
    for name, state in summary["states"].items():
        assert re.search(rf"{name} +│ +{state['section']['rms_um']:.3g} ", said)
        assert re.search(rf"{name} +│ +{state['line_minus_search']['rms_px']:.4f} ", said)


def test_overwriting_leaves_nothing_of_the_measurement_before(here):
    """Rationale: hot.exr of yesterday beside cold.exr of today would be read as one."""
    Path("measured").mkdir()
    Path("measured/summary.json").write_text("{}")
    Path("measured/hot.exr").touch()
    status, _, err = command("measure", *COLD, "--overwrite")
    assert (status, err) == (0, "")
    assert {path.name for path in here.iterdir()} == {"measured"}
    names = {path.name for path in Path("measured").iterdir()}
    assert names == {name for name in FILES if "hot" not in name}


def test_a_line_that_no_column_resolves_is_told_with_the_reason(here):
    """Rationale: a table of nan alone leaves a user puzzled; the line is narrower than a pixel."""
    status, out, _ = command("measure", *COLD, "-D", "line_radius=0.1", "-o", "coarse")
    assert status == 3
    assert not re.search(r"\bnan\b", out + Path("coarse/table.md").read_text())
    assert re.search(r"Note: cold: no line centres, .*too_narrow; .*wider line", out)


def test_a_disk_that_fills_up_is_told_in_one_line_and_keeps_the_old_results(here, monkeypatch):
    """Rationale: the frames are the largest files; OpenEXR reports the fault in its own words."""
    Path("measured").mkdir()
    Path("measured/summary.json").write_text("old")
    write_exr, ended = results.write_exr, threading.Event()

    def write_on_a_full_disk(*arguments):
        limits = resource.getrlimit(resource.RLIMIT_FSIZE)
        resource.setrlimit(resource.RLIMIT_FSIZE, (2000, limits[1]))
        try:
            write_exr(*arguments)
        finally:
            resource.setrlimit(resource.RLIMIT_FSIZE, limits)
            ended.set()

    monkeypatch.setattr(results, "write_exr", write_on_a_full_disk)
    # The limit holds for all threads: what is written beside the frame waits until it is over.
    for beside in ("save_png", "write_ply"):
        monkeypatch.setattr(results, beside, lambda *given, **also: ended.wait(120))
    told = refusal("measure", *COLD, "--overwrite")
    assert told.startswith("Error: measured/cold.exr: can't be written (")
    assert "Make room" in told
    assert {path.name for path in here.iterdir()} == {"measured"}
    assert [path.read_text() for path in Path("measured").iterdir()] == ["old"]


MEASURE_AND_WAIT = """
import sys, time
from virtual_sensor import cli
from virtual_sensor.reporting import measure
def wait(*_):
    print("writing", flush=True)
    time.sleep(60)
measure.picture = wait
cli.main()
"""


@pytest.mark.slow
@pytest.mark.parametrize(
    ("blow", "status"), [("SIGINT", 130), ("SIGTERM", 143), ("SIGKILL", -signal.SIGKILL)]
)
def test_a_killed_run_leaves_no_results_and_does_not_hinder_the_next(here, blow, status):
    """Rationale: Ctrl-C, a batch queue's limit, the out-of-memory killer: half is written then.

    Where the run can, it cleans up; from SIGKILL a hidden folder stays behind.
    """
    line = [sys.executable, "-c", MEASURE_AND_WAIT, "measure", *COLD]
    pipe = subprocess.PIPE
    with subprocess.Popen(line, stdout=pipe, stderr=pipe, text=True) as run:
        assert run.stdout.readline() == "writing\n"
        run.send_signal(getattr(signal, blow))
        out, err = run.communicate()
    name = {"SIGINT": "Ctrl-C", "SIGTERM": "SIGTERM"}.get(blow)
    said = f"Stopped by {name}; no results are written.\n" if name else ""
    assert (run.returncode, out.strip(), err) == (status, "", said)
    left = [path.name for path in here.iterdir()]
    assert len(left) == (blow == "SIGKILL")
    assert all(name.startswith(".measured.") for name in left)
    if left:
        assert command("measure", *COLD)[0] == 0
        assert Path("measured/summary.json").exists()
