"""What the commands print can be read: on any terminal, in any encoding, whatever names hold."""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
from pathlib import Path

import pytest
from command_line import command, status_of
from rich.table import Table

from virtual_sensor.cli import commands
from virtual_sensor.cli.console import Console, one_line
from virtual_sensor.errors import printable

COMMANDS = [
    *("measure", "search", "burst", "sweep", "reproduce", "chart", "detect", "trial", "doctor"),
    *("field info", "field import", "field simulate", "field convergence"),
]
NUMBERS = ["0.0055", "-1234.5678", "7.43e-11", "696"]


def printed(table, width):
    """Text of a table on a console of a width."""
    out = io.StringIO()
    Console(file=out, width=width).print(table)
    return out.getvalue()


def program(words, redirection="", **settings):
    """The command in a shell, with its streams redirected: status, output, errors."""
    line = f'"$0" -m virtual_sensor {words} {redirection}'
    ended = subprocess.run(
        ["bash", "-c", line, sys.executable], env=os.environ | settings, capture_output=True
    )
    return ended.returncode, ended.stdout.decode(), ended.stderr.decode()


def as_program(words, encoding="utf-8", full=()):
    """The command as a program: status, output, errors; streams that are full are given by 1, 2."""
    redirections = " ".join(f"{number}> /dev/full" for number in full)
    return program(words, redirections, PYTHONIOENCODING=encoding)


def in_this_process(words, encoding="utf-8", full=()):
    """The same, in this process."""
    with contextlib.ExitStack() as opened:
        files = [io.BytesIO(), io.BytesIO()]
        for number in full:
            files[number - 1] = opened.enter_context(Path("/dev/full").open("wb"))
        streams = [io.TextIOWrapper(file, encoding=encoding) for file in files]
        status = status_of(shlex.split(words), *streams)
        return status, *("" if n in full else f.getvalue().decode() for n, f in enumerate(files, 1))


runs = pytest.mark.parametrize(
    "run", [in_this_process, pytest.param(as_program, marks=pytest.mark.slow)]
)


@pytest.mark.parametrize("width", [20, 40, 60, 80, 200])
def test_no_number_in_a_table_is_cut(width):
    """Rationale: "0.00…" is worse than no table; a narrow terminal gets a list."""
    table = Table("state", "rms, px", "at most, px", "error", "centres", title="compared")
    table.add_row("cold", *NUMBERS)
    table.add_row("hot, by marched rays, with a long name of its own", *NUMBERS)
    lines = printed(table, width).splitlines()
    for number in NUMBERS:
        whole = re.compile(rf"(?<![\w.…-]){re.escape(number)}(?![\w.…])")
        assert sum(bool(whole.search(line)) for line in lines) == 2, lines
    assert "…" not in "".join(lines)
    assert "compared" in "".join(lines)


def test_a_table_without_headings_becomes_a_list_too():
    """Rationale: `field info` begins with one."""
    table = Table.grid(padding=(0, 2))
    table.add_row("temperature", "20 to 1250.125 degC, at 1234567.125 of all nodes of the grid")
    assert printed(table, 20).split() == printed(table, 200).split()


@pytest.mark.parametrize("text", ["\x1b[31mred", "a\x07b", "a\rb", "\x9b2J", "x\u202ey", "\udcff"])
def test_control_characters_are_escaped_wherever_they_are_printed(text):
    """Rationale: a file's name may clear a terminal, or say what is not so."""
    table = Table("name")
    table.add_row(text)
    for said in (printable(text), printed(text, 80), printed(table, 80)):
        assert "\\" in said
        assert all(c.isprintable() or c == "\n" for c in said)
    assert one_line(f"{text}\nnext") == f"{printable(text)}\\nnext"
    assert printable("12 µm\nand\u00a020 °C\t") == "12 µm\nand\u00a020 °C\t"


@pytest.mark.parametrize(
    "words", [["measure", "\x1b]0;title\x07\nnext"], ["measure", "--\x1b[31m"], ["\x1b[2Jx"]]
)
def test_a_users_word_is_escaped_in_the_one_line_that_refuses_it(words):
    """Rationale: the shell completes names that others chose."""
    status, out, err = command(*words)
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert "\x1b" not in err
    assert "\x07" not in err


@pytest.mark.parametrize(
    ("words", "told"),
    [
        ("mesure a", "No such command 'mesure'.*measure.*see `virtual-sensor --help`"),
        ("measure", "Missing argument 'SCENE'; see `virtual-sensor measure --help`"),
        ("search a --rays few", "'--rays'.*integer.*see `virtual-sensor search --help`"),
        ("field inf", "No such command 'inf'.*info.*see `virtual-sensor field --help`"),
        ("sweep a --ouput b", "No such option: --ouput.*--output.*sweep --help`"),
    ],
)
def test_a_command_line_that_makes_no_sense_is_told_in_one_line(words, told):
    """Rationale: what to type instead is in the last line, where the eye is."""
    status, out, err = command(*words.split())
    assert (status, out, err.count("\n")) == (2, "", 1)
    assert re.search(told, err)


@pytest.mark.parametrize("name", COMMANDS)
def test_every_help_shows_its_examples_and_options_whole_on_a_narrow_screen(monkeypatch, name):
    """Rationale: a phone, a split window, a terminal that knows ASCII alone."""
    for columns in ("40", "80"):
        monkeypatch.setenv("COLUMNS", columns)
        status, out, err = command(*name.split(), "--help")
        assert (status, err) == (0, "")
        assert f"virtual-sensor {name}" in out.partition("Examples:")[2]
        assert "…" not in out
        assert "--help" in out


def test_without_a_command_the_help_is_shown_on_a_narrow_screen_too(monkeypatch):
    """Rationale: the bare command is what is typed before anything is read."""
    monkeypatch.setenv("COLUMNS", "40")
    assert "virtual-sensor measure hot_cylinder" in command()[1]


@runs
def test_a_terminal_that_knows_ascii_alone_is_written_to_in_ascii(run):
    """Rationale: batch systems and containers have no locale; µ and ° are in every result."""
    status, out, err = run("search cold_cylinder -y 0", "ascii")
    assert (status, err) == (0, "")
    assert out.isascii()
    assert "distance, um" in out
    status, out, err = run("measure 'µ\N{SNOWMAN}'", "ascii")
    assert (status, out) == (2, "")
    assert err.startswith("Error: u\\u2603: ")


@runs
def test_an_output_that_is_full_costs_no_results_and_is_told_in_a_line(tmp_path, run):
    """Rationale: the table goes to a full disk, and an hour's work must not."""
    file = tmp_path / "rays.csv"
    status, out, err = run(f"search cold_cylinder -y 0 -o {file}", full=(1,))
    assert (status, out) == (1, "")
    assert re.fullmatch(r"Error: standard output: can't be written \(No space .*\n", err)
    assert file.exists()
    assert run("measure nope", full=(2,)) == (2, "", "")


@pytest.mark.slow
def test_a_reader_that_has_gone_and_streams_that_are_closed_are_no_error():
    """Rationale: `| head -1`, and services that start programs without any stream."""
    status, out, err = program("search cold_cylinder -y 0", "| head -c 0; exit ${PIPESTATUS[0]}")
    assert (status, out, err) == (0, "", "")
    assert program("--version", ">&-") == (0, "", "")
    assert program("measure nope", "2>&- <&-") == (2, "", "")


def test_a_working_folder_that_is_gone_is_told_in_a_line(tmp_path):
    """Rationale: Mitsuba aborts there."""
    code = (
        "import os, sys\n"
        "os.chdir(sys.argv.pop(1)); os.rmdir(os.getcwd())\n"
        "from virtual_sensor.cli import main; main()"
    )
    (tmp_path / "gone").mkdir()
    ended = subprocess.run(
        [sys.executable, "-c", code, tmp_path / "gone", "search", "cold_cylinder"],
        capture_output=True,
        text=True,
    )
    assert (ended.returncode, ended.stdout) == (2, "")
    assert re.fullmatch("Error: the working folder is gone .*; go to another\n", ended.stderr)


def test_a_name_that_libraries_can_not_write_is_refused(tmp_path):
    """Rationale: OpenEXR and OpenCV take names as UTF-8, Linux any bytes."""
    status, out, err = command("search", "cold_cylinder", "-o", f"{tmp_path}/a\udcff.csv")
    assert (status, out) == (2, "")
    assert re.fullmatch(r"Error: .*a\\udcff\.csv: its name is not UTF-8; name another.*\n", err)


@pytest.mark.slow
def test_a_home_that_is_missing_costs_no_more_than_a_cache(tmp_path):
    """Rationale: batch jobs and services have none."""
    (tmp_path / "file").touch()
    settings = {"HOME": f"{tmp_path}/file", "XDG_CACHE_HOME": f"{tmp_path}/file/cache"}
    status, out, _ = program("search cold_cylinder -y 0", **settings)
    assert (status, out.count(" found ")) == (0, 1)


def test_an_error_of_the_program_itself_still_shows_where(monkeypatch):
    """Rationale: what is no user's slip must be reported, and mended."""
    monkeypatch.setattr(commands, "app", None)
    status, out, err = command("doctor")
    assert (status, out) == (1, "")
    assert err.startswith("Traceback ")
