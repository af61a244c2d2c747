"""What all commands share: progress, times, and files named for what they are."""

import re
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
import typer
from command_line import command

from virtual_sensor.cli import shared
from virtual_sensor.errors import InputError
from virtual_sensor.reporting.tables import TextTable


def test_progress_is_a_line_every_ten_seconds_where_it_is_piped(capsys):
    """Rationale: a log of a long sweep that stays empty looks like a hung one."""
    now = [100.0]
    with shared.reporting("loading", clock=lambda: now[0]) as report:
        for second in range(0, 36, 3):
            now[0] = 100.0 + second
            report("rendering \x1b", second / 36)
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.splitlines() == [
        " 33% after 12 s: rendering \\x1b",
        " 67% after 24 s: rendering \\x1b",
    ]


def test_the_time_that_is_said_counts_the_start(tmp_path):
    """Rationale: 1.6 s, says a command that took 3 s from Enter to prompt."""
    code = (
        "import time; began = time.perf_counter()\n"
        "from virtual_sensor.cli.shared import wall_clock_s\n"
        "elapsed = time.perf_counter() - began\n"  # first: a pause adds to both bounds
        "print(wall_clock_s() - elapsed, time.clock_gettime(7))"
    )
    before = time.clock_gettime(time.CLOCK_BOOTTIME)
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, check=True)
    start_up, now = map(float, ended.stdout.split())
    assert -0.02 < start_up < now - before + 0.02  # the kernel counts hundredths


def test_a_file_is_what_its_name_says():
    """Rationale: a JPEG that is a PNG, or a CSV that is called .xlsx, opens nowhere."""
    shared.check_suffix(Path("a.CSV"), (".csv",), "a table")
    with pytest.raises(InputError, match=r"line\.xlsx: a table is written as \.csv; name it so"):
        shared.check_suffix(Path("line.xlsx"), (".csv",), "a table")
    with pytest.raises(InputError, match=r"written as \.png, \.svg or \.pdf"):
        shared.check_suffix(Path("a.jpg"), (".png", ".svg", ".pdf"), "a picture")


def test_the_end_names_the_page_to_open(capsys):
    """Rationale: of twenty files in a folder, a newcomer opens the wrong one."""
    shared.print_end(Path("my [results]"))
    assert "results in my [results], open my [results]/report.html first" in capsys.readouterr().out


def test_tables_sentences_and_notes_are_printed_each_once_and_whole(capsys):
    """Rationale: a path that is broken into lines can't be copied; a note said ten times hides."""
    path = f"/a{'/long' * 40}"
    shared.print_results([TextTable(("a",), (("1",),)), f"it is in {path}"], ["n", "m", "n"])
    said = capsys.readouterr().out
    assert f"it is in {path}\nNote: n\nNote: m\n" in said
    assert said.index(" 1 ") < said.index("it is in")


def test_results_are_a_folder_and_a_file_is_refused(tmp_path):
    """Rationale: `-o report.png` does not mean a folder of that name."""
    shared.check_folder(tmp_path / "results.v2", overwrite=False)
    with pytest.raises(InputError, match=r"name a folder, such as -o .*/report$"):
        shared.check_folder(tmp_path / "report.png", overwrite=False)


@pytest.mark.parametrize(
    "words",
    [
        "sweep hot_cylinder -D beta=0,5 -o table.csv",
        "reproduce -o report.pdf",
        "field info air.nc --json figures.xlsx",
    ],
)
def test_a_name_that_promises_another_format_is_refused(words, tmp_path, monkeypatch):
    """Rationale: also of folders in which a command goes on, and of files for programs."""
    monkeypatch.chdir(tmp_path)
    *_, option, name = words.split()
    status, _, error = command(*words.split())
    assert status == 2
    assert re.search(rf"{option} {name}: .*name (a folder|it so)", error)


@dataclass(frozen=True)
class Asked:
    """What a command is asked for.

    Attributes
    ----------
    width_mm : float
        Of the part; in
        two lines.
    at_least_s : float, optional
        How long.
    whole : bool
        All of it.
    """

    width_mm: float = 2.5
    at_least_s: float | None = None
    whole: bool = False


def test_fields_of_a_dataclass_are_options_with_its_words():
    """Rationale: an option is described once: type and default in its field, help in its words."""
    got = []

    @shared.with_options
    def run(name: str, *, asked: Asked, last: int = 1) -> None:
        """Run."""
        got.append((name, asked, last))

    app = typer.Typer(add_completion=False)
    app.command()(run)
    group: Any = typer.main.get_command(app)
    options = {each.opts[0]: each.help for each in group.params if each.name != "name"}
    assert options == {
        "--width": "Of the part; in two lines.",
        "--at-least": "How long.",
        "--whole": "All of it.",
        "--last": None,
    }
    for words in ("a", "b --width 3 --at-least 1 --whole --last 2"):
        group.main(words.split(), standalone_mode=False)
    assert got == [("a", Asked(), 1), ("b", Asked(3.0, 1.0, True), 2)]
