"""What the commands share: the console, a progress bar, options."""

import functools
import inspect
import os
import re
import shlex
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import Field, fields, is_dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Annotated, Any, get_type_hints

import typer
from rich.progress import BarColumn, Progress, TaskProgressColumn, TextColumn, TimeElapsedColumn

from virtual_sensor import interrupts
from virtual_sensor.cli.console import console, errors
from virtual_sensor.display import attribute_words
from virtual_sensor.errors import InputError, printable
from virtual_sensor.files import check_output

if TYPE_CHECKING:
    from virtual_sensor.reporting.tables import TextTable

_IMPORTED = time.perf_counter()
_LINE_EVERY_S = 10.0
_FILES = {*(".csv", ".xlsx", ".json", ".ply", ".html", ".md", ".pdf"), *(".png", ".jpg", ".jpeg")}
_FILES |= {".tif", ".tiff", ".bmp", ".svg", ".exr", ".nc", ".txt", ".zip"}
"""Suffixes of files: no folder of results is meant by such a name."""


def there(scene: str) -> str:
    """A scene's name, looked up before the engine starts, which takes a second."""
    from virtual_sensor.imaging.scene_file import find_scene

    find_scene(scene)
    return scene


SceneArgument = Annotated[
    str,
    typer.Argument(
        metavar="SCENE",
        callback=there,
        help="A scene file, or one that is installed: hot_cylinder, cold_cylinder, stepped_shaft,"
        " v_groove, bearing_ring.",
    ),
]
Definitions = Annotated[
    list[str] | None,
    typer.Option(
        "-D",
        metavar="NAME=VALUE",
        help="Set a parameter of the scene; repeatable. A wrong name is answered with all names.",
    ),
]
Scheduler = Annotated[
    str | None,
    typer.Option(
        "--scheduler",
        metavar="ADDRESS",
        help="Of a running Dask cluster, such as tcp://10.0.0.1:8786, as `dask scheduler` "
        "prints it. Its workers (`dask worker ADDRESS --nthreads 1`) must have virtual-sensor "
        "installed and share the disk of the results. By default this process does the work.",
    ),
]
ProbeRays = Annotated[
    list[float] | None,
    typer.Option(
        "-y",
        metavar="MM",
        help="A probe ray's position along the line, mm; repeatable. By default nine rays over all "
        "that is seen of the line, or the dots.",
    ),
]
Camera = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Of the scene's cameras, where it has several: its id in the file."
    ),
]
Source = Annotated[
    str | None,
    typer.Option(
        metavar="NAME", help="Of the scene's lasers, where it has several: its id in the file."
    ),
]
NOTHING_FOUND = 3
"""Exit status of a command that has results, but no line, dot or ray in them."""
NOTHING_STAYS = "no results are written"
FINISHED_STAYS = "finished cases stay, and the same command goes on"
Folder = Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")]
FolderToGoOnIn = Annotated[
    Path, typer.Option("-o", "--output", help="Folder for the results, or to go on in.")
]
Overwrite = Annotated[bool, typer.Option("--overwrite", help="Replace results that exist.")]


def with_options(command: Callable[..., None]) -> Callable[..., None]:
    """Let a command take dataclasses, by keyword: each of their fields is an option.

    Its name is the field's without a unit at the end, its default the field's, and its help the
    field's words under "Attributes" of the dataclass or its bases. Metadata of a field: `counts`
    says how many numbers are written with commas in between, or, if (), words; `repeated` takes one
    each time that it is given; `flag` is the option's name where it is not the field's; `internal`
    makes none.
    """
    signature = inspect.signature(command, eval_str=True)
    parameters: list[inspect.Parameter] = []
    groups: dict[str, Any] = {}
    for name, parameter in signature.parameters.items():
        if is_dataclass(kind := parameter.annotation):
            groups[name] = kind
            parameters += [_option(each, kind) for each in _optional(kind)]
        else:
            parameters.append(parameter)

    @functools.wraps(command)
    def called(**given: Any) -> None:
        for name, kind in groups.items():
            said = {each.name: _said(each, given.pop(_flag(each))) for each in _optional(kind)}
            given[name] = kind(**said)
        command(**given)

    called.__signature__ = signature.replace(parameters=parameters)  # type: ignore[attr-defined]
    return called


def _optional(kind: Any) -> list[Field[Any]]:
    return [each for each in fields(kind) if not each.metadata.get("internal")]


def _flag(each: Field[Any]) -> str:
    return re.sub(r"_(mm|um|nm|c|pa|s|px_per_s)$", "", each.name)


def _option(each: Field[Any], kind: Any) -> inspect.Parameter:
    """The option of a dataclass's field."""
    hint: Any = get_type_hints(kind)[each.name]
    default: Any = each.default
    if "counts" in each.metadata:
        hint, default = str | None, ",".join(f"{part:g}" for part in default or ()) or None
    if each.metadata.get("repeated"):
        hint, default = list[float] | None, None
    flag = [f"--{_flag(each)}"] if hint is bool else []  # no --no-NAME
    flag = [each.metadata["flag"]] if "flag" in each.metadata else flag
    option = typer.Option(default, *flag, help=attribute_words(kind)[each.name])
    return inspect.Parameter(
        _flag(each), inspect.Parameter.KEYWORD_ONLY, default=option, annotation=hint
    )


def _said(each: Field[Any], given: Any) -> Any:
    """The field's value, from that of its option."""
    if each.metadata.get("repeated"):
        return tuple(given or ())
    counts = each.metadata.get("counts")
    if counts is None:
        return given
    if counts:
        return numbers(f"--{_flag(each)}".replace("_", "-"), given, *counts)
    return given.replace(" ", "").split(",") if given else ()


def definitions(define: list[str] | None) -> dict[str, str]:
    """The values of `-D` by their names."""
    pairs = {}
    for text in define or []:
        name, equals, value = text.partition("=")
        if not (name and equals):
            raise InputError(f"-D {text}: write it as NAME=VALUE, such as -D beta=15")
        pairs[name] = value
    return pairs


@contextmanager
def reporting(
    first: str,
    if_stopped: str = NOTHING_STAYS,
    clock: Callable[[], float] = time.monotonic,
) -> Iterator[Callable[[str, float], None]]:
    """Give a function that is called with what is being done and the fraction done.

    On a terminal it moves a bar; where the output is piped, it prints a line to standard error
    every 10 s. When nothing failed it ends with "done". A signal's line ends with `if_stopped`.
    """
    if not console.is_terminal:
        with interrupts.on_stop(lambda: if_stopped):
            report = _lines(clock)
            yield report
            report("done", 1.0)
        return
    columns = (
        TextColumn("{task.description:<36}", markup=False),
        BarColumn(),
        TaskProgressColumn(),
        TimeElapsedColumn(),
    )
    with Progress(*columns, console=console) as bar:
        task = bar.add_task(first, total=1.0)

        def report(stage: str, fraction: float) -> None:
            bar.update(task, description=printable(stage), completed=fraction)

        def leave() -> str:  # below the bar, with the cursor that it hides
            os.write(console.file.fileno(), b"\n\x1b[?25h")
            return if_stopped

        with interrupts.on_stop(leave):
            yield report
            report("done", 1.0)


def _lines(clock: Callable[[], float]) -> Callable[[str, float], None]:
    """A function that prints a line of progress, 10 s after the last one or later."""
    began = last = clock()

    def report(stage: str, fraction: float) -> None:
        nonlocal last
        now = clock()
        if now - last >= _LINE_EVERY_S:
            last = now
            errors.print(f"{fraction:4.0%} after {now - began:.0f} s: {printable(stage)}")

    return report


def wall_clock_s() -> float:
    """Seconds since this process was started, the start of Python and imports among them."""
    try:
        with Path("/proc/self/stat").open(encoding="utf-8") as file:
            # Fields follow the program's name, in parentheses; the 22nd of all is the start.
            ticks = int(file.read().rpartition(")")[2].split()[19])
        began = ticks / os.sysconf("SC_CLK_TCK")
        return time.clock_gettime(time.CLOCK_BOOTTIME) - began
    except (OSError, ValueError, AttributeError):  # not Linux
        return time.perf_counter() - _IMPORTED


def print_time(end: str) -> None:
    """Print a command's last line: how long it took, and what came of it."""
    from virtual_sensor.reporting.words import time_in_words

    console.print(f"{time_in_words(wall_clock_s())} in all; {end}")


def print_end(folder: Path, first: str = "report.html") -> None:
    """Print how long the command took, and where its results are."""
    print_time(f"results in {folder}, open {folder / first} first")


def print_results(said: "Iterable[TextTable | str]", notes: Iterable[str] = ()) -> None:
    """Print tables and sentences, and then the notes."""
    for each in said:
        console.print(each if isinstance(each, str) else each.rich())
    print_notes(notes)


def check_suffix(path: Path, suffixes: Sequence[str], what: str, option: str = "-o") -> None:
    """Refuse a file whose name asks for a format that is not written.

    Raises
    ------
    InputError
        Which names those that are.
    """
    if path.suffix.lower() not in suffixes:
        *others, last = suffixes
        wanted = f"{', '.join(others)} or {last}" if others else last
        raise InputError(f"{option} {path}: {what} is written as {wanted}; name it so")


def check_folder(path: Path, overwrite: bool) -> None:
    """Refuse a folder of results that can't be written, or whose name is a file's.

    Raises
    ------
    InputError
        Which names the remedy.
    """
    check_folder_name(path)
    check_output(path, overwrite, folder=True)


def check_folder_name(path: Path) -> None:
    """Refuse a folder of results whose name is a file's.

    Raises
    ------
    InputError
        Which names the remedy.
    """
    if path.suffix.lower() in _FILES and not path.is_dir():
        raise InputError(
            f"-o {path}: the results are a folder of tables, pictures and a page; name a folder,"
            f" such as -o {path.with_suffix('')}"
        )


def print_notes(notes: Iterable[str]) -> None:
    """Print what a reader ignored, converted or assumed, each once."""
    from virtual_sensor.imaging.scene_file import with_names

    for note in dict.fromkeys(notes):
        console.print(f"Note: {with_names(note)}", style="yellow")


def see_own_modules() -> None:
    """Let modules of the working folder be imported too, as `python -m` does; after all others."""
    try:
        here = str(Path.cwd())
    except OSError:  # it was deleted
        return
    if here not in sys.path:
        sys.path.append(here)


def command_line() -> str:
    """The command that was given, for a file's history."""
    return shlex.join(["virtual-sensor", *sys.argv[1:]])


def numbers(option: str, text: str | None, *counts: int) -> tuple[float, ...] | None:
    """Numbers that an option gives with commas in between."""
    if text is None:
        return None
    try:
        numbers = tuple(float(part) for part in text.split(","))
    except ValueError:
        numbers = ()
    if len(numbers) not in counts or not all(abs(n) < float("inf") for n in numbers):
        wanted = " or ".join(map(str, counts))
        raise InputError(f"{option} {text}: give {wanted} numbers with commas in between")
    return numbers
