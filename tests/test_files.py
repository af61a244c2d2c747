"""Results come whole or not at all, whatever goes wrong, and what was there before stays."""

import errno
import os
import resource
import shutil
import signal
import subprocess
import sys
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import OpenEXR
import pytest
from folders import WRITE_AND_WAIT, contents, earlier_results

from virtual_sensor.errors import InputError
from virtual_sensor.files import (
    RESULTS_SIGN,
    check_output,
    folder_written_whole,
    readable,
    written_whole,
)


@pytest.fixture
def results(tmp_path):
    """A folder of earlier results."""
    return earlier_results(tmp_path)


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
    """Rationale: a bug or Ctrl-C in the middle must not cost the last good result."""
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


def test_a_folder_that_a_signal_has_removed_is_not_made_again(tmp_path):
    """Rationale: a thread that wrote on while the handler cleaned up left an unfinished folder."""
    made = folder_written_whole(tmp_path / "made")
    folder = made.__enter__()
    shutil.rmtree(folder.parent)  # as the handler does
    for late in (folder / "a.csv", folder / "report" / "b.csv"):
        with pytest.raises(InputError), written_whole(late):
            pass
        assert list(tmp_path.iterdir()) == []
    with pytest.raises(InputError):
        made.__exit__(None, None, None)
    assert list(tmp_path.iterdir()) == []


def test_folders_within_a_new_folder_are_made(tmp_path):
    """Rationale: pages lie in folders of their own."""
    with (
        folder_written_whole(tmp_path / "made") as folder,
        written_whole(folder / "report" / "pictures" / "b.csv") as new,
    ):
        new.write_text("b")
    assert contents(tmp_path / "made") == {"report/pictures/b.csv": b"b"}


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
