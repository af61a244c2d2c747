"""Results come whole or not at all, whatever goes wrong, and what was there before stays."""

import errno
import os
import resource
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR
import pytest

from virtual_sensor import files
from virtual_sensor.errors import InputError
from virtual_sensor.files import (
    RESULTS_SIGN,
    check_output,
    folder_written_whole,
    readable,
    settle,
    written_whole,
)


@pytest.fixture
def results(tmp_path):
    """A folder of earlier results."""
    folder = tmp_path / "measured"
    folder.mkdir()
    (folder / RESULTS_SIGN).write_text("earlier")
    return folder


def contents(folder):
    """Files below a folder, hidden ones too, with what is in them."""
    files = (p for p in folder.rglob("*") if p.is_file())
    return {str(p.relative_to(folder)): p.read_bytes() for p in files}


@contextmanager
def no_file_longer_than(size):
    """The system refuses to write on, as when the disk is full; Python ignores the signal."""
    soft, hard = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, hard))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, (soft, hard))


def fill_too_much(path):
    with written_whole(path) as temporary, no_file_longer_than(1000):
        temporary.write_bytes(bytes(2000))


def fill_too_much_exr(path):
    image = np.random.default_rng(1).random((64, 64), np.float32)
    with written_whole(path) as temporary, no_file_longer_than(1000):
        OpenEXR.File({"type": OpenEXR.scanlineimage}, {"Y": image}).write(str(temporary))


def test_a_file_appears_only_when_it_is_complete(tmp_path):
    """Rationale: a reader that watches the folder must never open half a file."""
    path = tmp_path / "line.csv"
    with written_whole(path) as temporary:
        temporary.write_text("u,v\n")
        assert not path.exists()
    assert contents(tmp_path) == {"line.csv": b"u,v\n"}


def test_a_file_that_fails_leaves_the_old_one(tmp_path):
    """Rationale: a bug or Ctrl-C half way must not cost the last good result."""
    path = tmp_path / "line.csv"
    path.write_text("old")

    def interrupted():
        with written_whole(path) as temporary:
            temporary.write_text("half")
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        interrupted()
    assert contents(tmp_path) == {"line.csv": b"old"}


@pytest.mark.parametrize("fill", [fill_too_much, fill_too_much_exr])
def test_a_full_disk_is_an_error_that_keeps_the_old_file(tmp_path, fill):
    """Rationale: disks fill up; OpenEXR raises RuntimeError then, where Python raises OSError."""
    path = tmp_path / "frame.exr"
    path.write_text("old")
    with pytest.raises(InputError, match=r"frame\.exr: can't be written .*too large.* Make room"):
        fill(path)
    assert contents(tmp_path) == {"frame.exr": b"old"}


def test_a_new_file_has_the_mode_of_any_other(tmp_path):
    """Rationale: temporary files are private; a colleague must be able to read a result."""
    (tmp_path / "usual").touch()
    with written_whole(tmp_path / "line.csv") as temporary:
        temporary.touch()
    with folder_written_whole(tmp_path / "measured") as folder:
        (folder / "line.csv").touch()
    (tmp_path / "usual folder").mkdir()
    for ours, usual in [("line.csv", "usual"), ("measured", "usual folder")]:
        assert (tmp_path / ours).stat().st_mode == (tmp_path / usual).stat().st_mode


def test_what_is_no_file_is_not_replaced(tmp_path):
    """Rationale: `-o /dev/null --overwrite` by root would replace the device for everybody."""
    device = tmp_path / "device"
    os.mkfifo(device)
    for write in (
        lambda: check_output(device, overwrite=True),
        lambda: written_whole(device).__enter__(),
    ):
        with pytest.raises(InputError, match="device: is not a file; name another"):
            write()
    assert list(tmp_path.iterdir()) == [device]


def test_a_link_is_followed(tmp_path, results):
    """Rationale: people link their results to a larger disk, and the link must survive."""
    folder_link, file_link = tmp_path / "folder link", tmp_path / "file link"
    folder_link.symlink_to(results)
    file_link.symlink_to(results / "line.csv")
    with folder_written_whole(folder_link, overwrite=True) as folder:
        (folder / "hot.csv").touch()
    with written_whole(file_link) as temporary:
        temporary.write_text("new")
    assert folder_link.is_symlink()
    assert file_link.is_symlink()
    assert contents(results) == {"hot.csv": b"", "line.csv": b"new"}


def test_a_folder_appears_only_when_it_is_complete_and_with_its_parents(tmp_path):
    """Rationale: a folder that exists is a folder that can be used."""
    path = tmp_path / "runs" / "today" / "measured"
    with folder_written_whole(path) as folder:
        (folder / "line.csv").write_text("u,v\n")
        assert not path.exists()
    assert contents(tmp_path) == {"runs/today/measured/line.csv": b"u,v\n"}


def test_an_existing_folder_is_refused_and_stays(results):
    """Rationale: results of an hour ago must not be lost to a habit."""
    with (
        pytest.raises(InputError, match=r"measured: exists; .* -o, or say --overwrite"),
        folder_written_whole(results),
    ):
        pytest.fail("the work was begun")
    assert contents(results) == {RESULTS_SIGN: b"earlier"}


def test_overwriting_replaces_the_folder_as_a_whole(results):
    """Rationale: files of two measurements in one folder would be read as one measurement."""
    (results / "hot.png").touch()
    with folder_written_whole(results, overwrite=True) as folder:
        (folder / RESULTS_SIGN).write_text("new")
        assert (results / RESULTS_SIGN).read_text() == "earlier"
    assert contents(results.parent) == {f"measured/{RESULTS_SIGN}": b"new"}


def test_overwriting_spares_a_folder_that_holds_anything_else(tmp_path):
    """Rationale: `-o ~ --overwrite` must not empty a home directory."""
    (tmp_path / "thesis.tex").write_text("years of work")
    with pytest.raises(InputError, match=f"no {RESULTS_SIGN}"):
        check_output(tmp_path, overwrite=True, folder=True)
    empty = tmp_path / "empty"
    empty.mkdir()
    check_output(empty, overwrite=True, folder=True)


def test_an_output_of_the_other_kind_is_refused(tmp_path, results):
    """Rationale: a folder can't take the place of a file, nor the reverse."""
    file = tmp_path / "file"
    file.touch()
    with pytest.raises(InputError, match="file: is not a folder"):
        check_output(file, overwrite=True, folder=True)
    with pytest.raises(InputError, match="measured: is not a file"):
        check_output(results, overwrite=True)


@pytest.mark.parametrize("folder", [False, True])
@pytest.mark.parametrize("place", ["file/deeper", "/proc/nowhere", "x" * 300])
def test_a_place_that_can_not_be_written_is_refused_beforehand(
    tmp_path, monkeypatch, place, folder
):
    """Rationale: to learn after the computation that its result has no place is a waste."""
    monkeypatch.chdir(tmp_path)
    Path("file").touch()
    with pytest.raises(InputError, match=f"^{place}: can't be written .* choose a place"):
        check_output(Path(place), overwrite=False, folder=folder)
    writing = folder_written_whole if folder else written_whole
    with pytest.raises(InputError, match=f"^{place}: can't be written"), writing(Path(place)):
        pytest.fail("the work was begun")
    assert contents(tmp_path) == {"file": b""}


def test_a_place_that_can_be_written_is_left_as_it_was(tmp_path):
    """Rationale: the check itself must leave no trace, parents of the output included."""
    check_output(tmp_path / "a" / "b" / "c", overwrite=False, folder=True)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("fill", [fill_too_much, fill_too_much_exr])
def test_a_disk_that_fills_up_half_way_leaves_the_old_folder(results, fill):
    """Rationale: the error names the user's own folder, not the hidden one that is filled first."""

    def measure_again():
        with folder_written_whole(results, overwrite=True) as folder:
            (folder / "line.csv").write_text("complete")
            fill(folder / "hot.exr")

    with pytest.raises(InputError, match=f"^{results}/hot.exr: can't be written .* Make room"):
        measure_again()
    assert contents(results.parent) == {f"measured/{RESULTS_SIGN}": b"earlier"}


def test_a_folder_that_can_not_be_moved_into_place_gives_way_to_the_old_one(results, monkeypatch):
    """Rationale: between the two renames the old results are nowhere; they must come back."""
    move = Path.replace

    def fail_at_the_second(self, target):
        if self.name == "new":
            raise OSError(errno.ENOSPC, "No space left on device")
        return move(self, target)

    monkeypatch.setattr(Path, "replace", fail_at_the_second)
    with (
        pytest.raises(InputError, match="No space left on device"),
        folder_written_whole(results, overwrite=True),
    ):
        pass
    assert contents(results.parent) == {f"measured/{RESULTS_SIGN}": b"earlier"}


def test_a_folder_that_comes_into_being_meanwhile_is_kept(tmp_path):
    """Rationale: two runs into one new folder: the second to end must not destroy the first's."""
    path = tmp_path / "measured"

    def write(text, meanwhile=lambda: None):
        with folder_written_whole(path) as folder:
            (folder / RESULTS_SIGN).write_text(text)
            meanwhile()

    with pytest.raises(InputError, match="not empty"):
        write("second", meanwhile=lambda: write("first"))
    assert contents(tmp_path) == {f"measured/{RESULTS_SIGN}": b"first"}


WRITE_AND_WAIT = """
import sys, time
from pathlib import Path
from virtual_sensor.files import folder_written_whole
with folder_written_whole(Path(sys.argv[1]), overwrite=True) as folder:
    (folder / "summary.json").write_text("half")
    print("writing", flush=True)
    time.sleep(60)
"""


def test_a_run_killed_half_way_leaves_the_old_folder_and_does_not_hinder_the_next(results):
    """Rationale: kill -9 leaves no chance to clean up."""
    command = [sys.executable, "-c", WRITE_AND_WAIT, str(results)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout.readline() == "writing\n"
        run.kill()
    assert run.returncode == -signal.SIGKILL
    assert contents(results) == {RESULTS_SIGN: b"earlier"}
    with folder_written_whole(results, overwrite=True) as folder:
        (folder / RESULTS_SIGN).write_text("new")
    assert contents(results) == {RESULTS_SIGN: b"new"}


def test_only_regular_files_are_readable(tmp_path):
    """A FIFO or a device blocks whoever opens it; a link to a file is as good as the file."""
    (tmp_path / "file").touch()
    (tmp_path / "link").symlink_to("file")
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "loop").symlink_to("loop")
    for name in ("file", "link"):
        assert readable(tmp_path / name) == tmp_path / name
    unfit = {"pipe": "is a pipe", "/dev/zero": "is a device", ".": "is a folder"}
    unfit |= {"missing": "can't be read", "loop": "can't be read", "a\0b": "can't be read"}
    for name, says in unfit.items():
        with pytest.raises(InputError, match=says):
            readable(tmp_path / name)


@pytest.fixture
def told(caplog):
    """What was logged, as text."""
    caplog.set_level("WARNING", "virtual_sensor")
    return lambda: [record.getMessage() for record in caplog.records]


def overwrite(folder, text="new"):
    with folder_written_whole(folder, overwrite=True) as new:
        (new / RESULTS_SIGN).write_text(text)


KILLED = """
import os, sys
from pathlib import Path
from virtual_sensor import files

where, results = sys.argv[1], Path(sys.argv[2])
move = Path.replace

def once(self, target):
    move(self, target)
    if self == results:
        os._exit(9)

if where == "between the renames":
    files._exchanged = lambda one, other: False
    Path.replace = once
with files.folder_written_whole(results, overwrite=True) as new:
    (new / "summary.json").write_text("new")
    if where == "half way":
        os._exit(9)
"""


def killed(where, results):
    """Overwrite results in a process that ends as by kill -9."""
    ended = subprocess.run([sys.executable, "-c", KILLED, where, str(results)])
    assert ended.returncode == 9


def hidden(folder):
    return [path.name for path in folder.iterdir() if path.name.startswith(".")]


def test_there_is_no_moment_without_results_while_they_are_replaced(results, monkeypatch):
    """Rationale: a run was killed between two renames, and the results were nowhere."""
    if not files._exchanged(results, results.with_name("measured")):
        pytest.skip("this system can't exchange two folders")
    moves = []
    move = Path.replace
    monkeypatch.setattr(
        Path, "replace", lambda self, to: moves.append((self, Path(to))) or move(self, to)
    )
    overwrite(results)
    assert contents(results.parent) == {f"measured/{RESULTS_SIGN}": b"new"}
    assert results not in [source for source, _ in moves]


@pytest.mark.parametrize("again", ["check", "write", "refuse"])
def test_results_hidden_between_two_renames_come_back_with_the_next_run(results, told, again):
    """Rationale: where two folders can't change places in one step, kill -9 leaves none."""
    killed("between the renames", results)
    assert not results.exists()
    if again == "check":
        check_output(results, overwrite=True, folder=True)
    elif again == "refuse":
        with pytest.raises(InputError, match="exists"):
            check_output(results, overwrite=False, folder=True)
    else:
        overwrite(results)
    expected = b"new" if again == "write" else b"earlier"
    assert contents(results.parent) == {f"measured/{RESULTS_SIGN}": expected}
    assert hidden(results.parent) == []
    assert [text.split(": ")[1] for text in told()] == [
        "results that a killed run had moved are back here"
    ]


def test_what_a_killed_run_left_is_removed_by_the_next_and_told(results, told):
    """Rationale: a disk must not fill with halves that nobody sees."""
    killed("half way", results)
    [left] = hidden(results.parent)
    assert left.startswith(".measured.")
    check_output(results.parent / "other", overwrite=False)
    assert hidden(results.parent) == [left]
    check_output(results, overwrite=True, folder=True)
    assert contents(results.parent) == {f"measured/{RESULTS_SIGN}": b"earlier"}
    assert hidden(results.parent) == []
    assert [text.split(": ")[1] for text in told()] == [
        "what a killed run had left unfinished is removed"
    ]


def test_what_a_live_process_is_at_work_in_stays(results, told):
    """Rationale: two runs into one folder: neither may take the other's work away."""
    command = [sys.executable, "-c", WRITE_AND_WAIT, str(results)]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as run:
        assert run.stdout.readline() == "writing\n"
        before = hidden(results.parent)
        with folder_written_whole(results, overwrite=True) as ours:
            (ours / RESULTS_SIGN).write_text("new")
            settle(results.parent)
            assert len(hidden(results.parent)) == 2
        assert hidden(results.parent) == before
        run.kill()
    settle(results.parent)
    assert hidden(results.parent) == []
    assert len(told()) == 1
    assert contents(results.parent) == {f"measured/{RESULTS_SIGN}": b"new"}


def test_a_run_of_version_0_4_that_was_killed_is_put_right_too(tmp_path):
    """Rationale: its folders have no lock, and lie on people's disks."""
    left = tmp_path / ".measured.k2x_8abc.unfinished"
    for name, text in (("old", "earlier"), ("new", "half")):
        (left / name).mkdir(parents=True)
        (left / name / RESULTS_SIGN).write_text(text)
    check_output(tmp_path / "measured", overwrite=True, folder=True)
    assert contents(tmp_path) == {f"measured/{RESULTS_SIGN}": b"earlier"}


@pytest.mark.parametrize(
    "name",
    [".measured.more.k2x_8abc.unfinished", ".measured.unfinished", "measured.k2x_8abc.unfinished"],
)
def test_folders_of_other_outputs_and_of_the_user_stay(tmp_path, name, told):
    """Rationale: the output `measured.more` has another process, and other names are the user's."""
    (tmp_path / name / "new").mkdir(parents=True)
    check_output(tmp_path / "measured", overwrite=False, folder=True)
    assert [path.name for path in tmp_path.iterdir()] == [name]
    assert told() == []


def test_a_link_in_a_hidden_folders_place_is_not_followed(tmp_path):
    """Rationale: in a shared folder somebody else may have put it there."""
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine/file").touch()
    (tmp_path / ".measured.k2x_8abc.unfinished").symlink_to(tmp_path / "mine")
    check_output(tmp_path / "measured", overwrite=False, folder=True)
    assert (tmp_path / "mine/file").exists()


def test_a_disk_without_locks_is_written_to(results, monkeypatch):
    """Rationale: some network disks have none; there nobody can tell who is alive."""

    def none(*_):
        raise OSError(errno.ENOLCK, "No locks available")

    monkeypatch.setattr(files.fcntl, "flock", none)
    overwrite(results)
    assert contents(results.parent) == {f"measured/{RESULTS_SIGN}": b"new"}
    (results.parent / ".measured.k2x_8abc.unfinished/new").mkdir(parents=True)
    overwrite(results, "newer")
    assert hidden(results.parent) == [".measured.k2x_8abc.unfinished"]


def test_a_linked_output_is_put_right_where_it_lies(tmp_path, monkeypatch):
    """Rationale: the hidden folder is beside the results, not beside the link."""
    (tmp_path / "disk").mkdir()
    (tmp_path / "link").symlink_to(tmp_path / "disk" / "measured")
    (tmp_path / "disk/.measured.k2x_8abc.unfinished/old").mkdir(parents=True)
    (tmp_path / "disk/.measured.k2x_8abc.unfinished/old" / RESULTS_SIGN).write_text("earlier")
    check_output(tmp_path / "link", overwrite=True, folder=True)
    assert contents(tmp_path / "disk") == {f"measured/{RESULTS_SIGN}": b"earlier"}
