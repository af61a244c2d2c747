"""Killed runs lose no results, and what they leave is put right by the next run, which says so."""

import errno
import subprocess
import sys
from pathlib import Path

import pytest
from folders import WRITE_AND_WAIT, contents, earlier_results

from virtual_sensor import files
from virtual_sensor.errors import InputError
from virtual_sensor.files import RESULTS_SIGN, check_output, folder_written_whole, settle


@pytest.fixture
def results(tmp_path):
    """A folder of earlier results."""
    return earlier_results(tmp_path)


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
