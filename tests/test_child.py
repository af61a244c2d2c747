"""A function in a child process may die of anything; the caller gets a result or a clear error."""

import contextlib
import os
import select
import signal

import pytest

from virtual_sensor import child
from virtual_sensor.child import run_in_child
from virtual_sensor.errors import InputError


def run(name, *arguments, **options):
    return run_in_child(f"child_functions:{name}", *arguments, subject="a.vtk", **options)


def test_the_result_comes_back():
    """Rationale: large ones too, which no pipe holds at once."""
    assert run("joined", "a", "b") == "a b"
    assert run("large", 5_000_000) == b"x" * 5_000_000
    assert run("joined", "x" * 5_000_000) == "x" * 5_000_000


@pytest.mark.parametrize(
    ("name", "match", "options"),
    [
        ("abort", r"^a.vtk: what reads it crashed \(SIGABRT\); it is damaged", {}),
        ("leave", r"^a.vtk: what reads it crashed \(exit status 3\)", {}),
        ("allocate_without_end", "^a.vtk: asks for more memory than the 0.5 GB", {}),
        ("claim_memory", "^a.vtk: asks for more memory than the 0.5 GB", {}),
        ("refuse", "^a.vtk: holds no points; export it again$", {}),
        ("hang", "^a.vtk: was not read within 0.05 s", {"seconds": 0.05}),
    ],
)
def test_the_ways_to_die_are_input_errors(name, match, options):
    """Rationale: a library's crash on a damaged file is the file's fault, reported in one line."""
    with pytest.raises(InputError, match=match) as caught:
        run(name, memory_bytes=500_000_000, **options)
    assert "\n" not in f"{caught.value}"


def test_a_server_that_is_ended_while_its_death_is_noticed_has_died(monkeypatch):
    """Rationale: the time limit, in a thread of its own, closed the file that was just read."""
    server = child._ForkServer()
    wait = server.process.wait

    def waited(*limit):
        status = wait(*limit)
        server.complaints.close()
        return status

    monkeypatch.setattr(server.process, "wait", waited)
    server.process.kill()
    assert server.ask(("child_functions:refuse", b""), print) == ("death", (-signal.SIGKILL, b""))
    server.end()


def test_a_mistake_of_ours_stays_one():
    """Rationale: an error that is no user's keeps its type and shows where in the child it was."""
    with pytest.raises(KeyError, match="absent") as caught:
        run("fail")
    assert 'in fail\n    return {}["absent"]' in caught.value.__notes__[0]
    with pytest.raises(Exception, match="pickle"):
        run("unpicklable")


def test_what_it_prints_goes_nowhere(capfd):
    """Rationale: what VTK prints would break the answer, or a user's terminal."""
    assert run("chatter") == b""
    assert capfd.readouterr() == ("", "")


def test_what_a_child_imported_the_next_one_has():
    """Rationale: VTK takes a tenth of a second to load; whether the first one read or refused."""
    for first in ("knew_zipapp", "knew_zipapp_and_fails"):
        child._end_all()
        with contextlib.suppress(InputError):
            assert not run(first)
        assert run("knew_zipapp")


def test_what_was_imported_before_is_no_memory_of_the_next_one():
    """Rationale: with VTK loaded, a child that may have 0.5 GB could not even say what is wrong."""
    for _ in range(2):
        assert run("import_what_takes_a_gigabyte") == 10**9
    assert run("large", 50_000_000, memory_bytes=500_000_000) == b"x" * 50_000_000
    with pytest.raises(InputError, match=r"asks for more memory than the 0\.5 GB"):
        run("claim_memory", memory_bytes=500_000_000)
    child._end_all()


def test_its_progress_is_reported():
    """Rationale: an import of minutes has a bar."""
    told = []
    assert run("count", report=lambda *content: told.append(content)) == "done"
    assert told == [("counting", 0), ("counting", 1), ("counting", 2)]


def test_ctrl_c_ends_the_child_too():
    """Rationale: nothing goes on computing behind a user's back."""
    child = []

    def interrupted(number):
        child.append(number)
        raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        run("report_and_hang", report=interrupted)
    with pytest.raises(ProcessLookupError):
        os.kill(child[0], 0)


def test_a_death_costs_no_import():
    """Rationale: of a folder of damaged files each had VTK imported again, which takes a second."""
    run("knew_zipapp")
    run("knew_zipapp")
    server = child._idle[-1]
    for name, end in (("abort", "SIGABRT"), ("leave", "exit status 3")):
        with pytest.raises(InputError, match=end):
            run(name)
    assert run("knew_zipapp")
    assert child._idle[-1] is server


def test_an_answer_that_is_cut_off_is_a_death():
    """Rationale: the rest of a message would be taken for the next answer."""
    run("joined")
    answers = child._idle[-1].process.stdout

    def kill(reader):
        select.select([answers], [], [])  # it answers, with more than a pipe holds
        os.kill(reader, signal.SIGKILL)

    with pytest.raises(InputError, match=r"crashed \(SIGKILL\)"):
        run("report_and_answer", 5_000_000, report=kill)
    assert run("joined", "a", "b") == "a b"
