"""The command `virtual-sensor sweep`."""

import math
from decimal import Decimal, InvalidOperation
from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.recording_options import RecordingOptions

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor sweep hot_cylinder -D beta=0:30:15 -D temperature=900,1100,1250 -o swept"
    "\n\n"
    "    virtual-sensor sweep stepped_shaft -D beta=-20:20:10 -o shafts\n\n"
    "    virtual-sensor sweep hot_cylinder -D transport=straight,marched,tabulated -o transports"
    "\n\n"
    "    virtual-sensor sweep hot_cylinder -D beta=0:15:5 --scheduler tcp://127.0.0.1:8786\n\n"
    "    virtual-sensor sweep hot_cylinder -D f_number=4,8,16 --sensor-model cmos_5um5 -o lenses"
)
_MOST_VALUES = 10_000
_SHOWN = 10  # cases whose notes are printed

Choices = Annotated[
    list[str] | None,
    typer.Option(
        "-D",
        metavar="NAME=VALUES",
        help="Values of a parameter of the scene, with commas in between, or a range "
        "START:STOP:STEP, such as beta=0:30:5; repeatable: all are combined. Where a value has "
        "commas of its own, put a semicolon after each value: 'dots=0,-5,-10;' is one.",
    ),
]


@shared.with_options
def sweep(
    scene: shared.SceneArgument,
    define: Choices = None,
    camera: shared.Camera = None,
    source: shared.Source = None,
    y: shared.ProbeRays = None,
    output: shared.FolderToGoOnIn = Path("swept"),
    scheduler: shared.Scheduler = None,
    *,
    recording: RecordingOptions,
) -> None:
    """Measure a scene over any of its parameters: a page and a table, and a folder for each case.

    Finished cases stay: stopped or killed, the same command goes on, and one with more values
    makes only what is missing. Exit status 1: some cases could not be measured, or have no line;
    3: none has a line.
    """
    choices = {name: values(name, text) for name, text in shared.definitions(define).items()}
    if len(choices) < len(define or []):
        raise InputError("-D: a parameter is given twice; give all values at once, as -D beta=0,15")

    from virtual_sensor.reporting.measure import save as save_case
    from virtual_sensor.reporting.sweep import save, table
    from virtual_sensor.reporting.words import counted
    from virtual_sensor.studies.sweep import CaseStatus, plan, run
    from virtual_sensor.studies.sweep_table import results

    shared.check_folder_name(output)
    with shared.reporting("planning the cases", shared.FINISHED_STAYS) as report:
        cases = plan(scene, choices, y or None, camera, source, recording)
        finished = run(
            cases,
            output,
            save_case,
            scheduler,
            lambda stage, fraction: report(stage, 0.98 * fraction),
        )
        report("writing the table", 0.98)
        result = results(finished, output)
        save(result, output, shared.command_line())
    shared.console.print(table(result).rich())
    summary = result.summary
    for name, message in summary.failed.items():
        shared.console.print(f"{name}: {message}", style="red")
    shared.print_notes(summary.notes[:_SHOWN])
    if len(summary.notes) > _SHOWN:
        shared.print_notes([f"{len(summary.notes) - _SHOWN} notes more: see summary.json"])
    there = sum(end.already_there for end in finished)
    failed = result.table.status.count(CaseStatus.FAILED)
    measured = len(finished) - there - failed
    shared.console.print(
        f"{counted(len(finished), 'case')}: {measured} measured, {there} already there,"
        f" {failed} failed"
    )
    if nothing := len(summary.nothing_found) == len(finished):
        shared.print_notes(["no case has a line centre or a dot"])
    shared.print_end(output)
    if nothing:
        raise typer.Exit(shared.NOTHING_FOUND)
    if any(status != CaseStatus.OK for status in result.table.status):
        raise typer.Exit(1)


def values(name: str, text: str) -> list[str]:
    """The values of one option: with commas in between, or with semicolons if there is one.

    Raises
    ------
    InputError
        If a range among them is none (see `numbers_of`).
    """
    parts = [part.strip() for part in text.split(";" if ";" in text else ",")]
    if ";" in text:
        parts = parts if parts[-1] else parts[:-1]
    return [value for part in parts for value in numbers_of(name, part)]


def numbers_of(name: str, text: str) -> list[str]:
    """The numbers of a range START:STOP:STEP, its stop included where it is hit; else the text.

    The numbers are decimal ones, without drift: 0:1:0.1 has eleven.

    Raises
    ------
    InputError
        If it begins as a range, with a number and a colon, and is none.
    """
    parts = text.split(":")
    if len(parts) == 1 or _decimal(parts[0]) is None:
        return [text]
    numbers = [_decimal(part) for part in parts]
    if len(numbers) != 3 or None in numbers:
        raise InputError(f"-D {name}={text}: write a range as START:STOP:STEP, such as 0:30:5")
    start, stop, step = (number for number in numbers if number is not None)
    if step == 0 or (stop - start) / step < 0:
        raise InputError(
            f"-D {name}={text}: steps of {parts[2]} don't lead from {parts[0]} to {parts[1]}; give"
            f" {'another one' if step == 0 else format(-step, 'f')}"
        )
    last = math.floor((stop - start) / step)
    if last >= _MOST_VALUES:
        raise InputError(
            f"-D {name}={text}: has {last + 1} values; give a longer step, for at most"
            f" {_MOST_VALUES}"
        )
    # Plainly: without an exponent, zeros at the end, or the sign of 0.
    return [f"{(start + i * step).normalize() + 0:f}" for i in range(last + 1)]


def _decimal(text: str) -> Decimal | None:
    try:
        number = Decimal(text.strip())
    except InvalidOperation:
        return None
    return number if number.is_finite() else None
