"""The command `virtual-sensor sweep`."""

from collections.abc import Sequence
from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from virtual_sensor.cli.shared import (
    FINISHED_STAYS,
    Camera,
    ProbeRays,
    SceneArgument,
    Scheduler,
    Source,
    console,
    definitions,
    print_notes,
    reporting,
)
from virtual_sensor.errors import InputError

_SHOWN = 10  # cases whose notes are printed

Choices = Annotated[
    list[str] | None,
    typer.Option(
        "-D",
        metavar="NAME=VALUES",
        help="Values of a parameter of the scene, with commas in between; repeatable: all are "
        "combined. Where a value has commas of its own, put a semicolon after each value: "
        "'dots=0,-5,-10;' is one.",
    ),
]


def sweep(
    scene: SceneArgument,
    define: Choices = None,
    camera: Camera = None,
    source: Source = None,
    y: ProbeRays = None,
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for the results, or to go on in.")
    ] = Path("swept"),
    scheduler: Scheduler = None,
) -> None:
    """Measure a scene over any of its parameters: a table over all cases, and a folder for each.

    Finished cases are kept: stopped or killed, the same command goes on, and one with more values
    makes only what is missing. Cases that can't be measured are listed in the end; exit status 1:
    there are some, or some have found nothing.
    """
    from virtual_sensor.studies.sweep import (
        CaseStatus,
        differing,
        plan,
        program_notes,
        run,
        sweep_notes,
    )
    from virtual_sensor.studies.sweep_results import save_sweep

    choices = {name: _values(text) for name, text in definitions(define).items()}
    if len(choices) < len(define or []):
        raise InputError("-D: a parameter is given twice; give all values at once, as -D beta=0,15")
    with reporting("planning the cases", FINISHED_STAYS) as report:
        cases = plan(scene, choices, y or None, camera, source)
        finished = run(
            cases,
            output,
            save_case,
            scheduler,
            lambda stage, fraction: report(stage, 0.98 * fraction),
        )
        report("writing the table", 0.98)
        columns = save_sweep(finished, output)
        report("done", 1.0)
    console.print(_table(columns, differing(cases)))
    failed = [end for end in finished if end.status == CaseStatus.FAILED]
    for end in failed:
        console.print(f"{end.case.name}: {end.message}", style="red", soft_wrap=True)
    print_notes(program_notes(finished, output))
    notes = sweep_notes(finished, columns)
    print_notes(notes[:_SHOWN])
    if len(notes) > _SHOWN:
        print_notes([f"{len(notes) - _SHOWN} cases more have notes: see summary.json"])
    there = sum(end.already_there for end in finished)
    console.print(
        f"{len(finished)} cases: {len(finished) - there - len(failed)} measured, {there} already"
        f" there, {len(failed)} failed; results in {output}, look at {output / 'sweep.csv'} and"
        f" {output / 'sweep.png'} first",
        soft_wrap=True,
    )
    if any(status != CaseStatus.OK for status in columns["status"]):
        raise typer.Exit(1)


def _values(text: str) -> list[str]:
    """The values of one option: with commas in between, or with semicolons if there is one."""
    if ";" not in text:
        return [value.strip() for value in text.split(",")]
    values = [value.strip() for value in text.split(";")]
    return values if values[-1] else values[:-1]


def save_case(result: Any, folder: Path, command: str, overwrite: bool = False) -> None:
    """Write the results of a sweep's case."""
    from virtual_sensor.reporting.measure import save

    save(result, folder, command, overwrite)


def _table(columns: dict[str, list[Any]], swept: Sequence[str]) -> Table:
    shown = [*swept, "status", "hot_line_rms_px", "hot_dots_largest_v_px"]
    shown += ["largest_B-A_um", "largest_B-B_m_um", "largest_B_m-A_m_um"]
    shown = [name for name in shown if any(value == value for value in columns[name])]  # not NaN
    told = Table(*(name.replace("_", " ") for name in shown))
    for row in zip(*(columns[name] for name in shown), strict=True):
        told.add_row(*map(_cell, row))
    return told


def _cell(value: object) -> str:
    if isinstance(value, float):
        return f"{value:.4g}" if value == value else "none"
    return str(value)
