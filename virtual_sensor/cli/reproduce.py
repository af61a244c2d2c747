"""The command `virtual-sensor reproduce`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from virtual_sensor.cli.shared import (
    FINISHED_STAYS,
    Definitions,
    Scheduler,
    command_line,
    console,
    definitions,
    print_end,
    print_notes,
    reporting,
)

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor reproduce\n\n"
    "    virtual-sensor reproduce -o finer -D spp=64 -D step=1\n\n"
    "    virtual-sensor reproduce -o fast --scheduler tcp://127.0.0.1:8786"
)


def reproduce(
    output: Annotated[
        Path, typer.Option("-o", "--output", help="Folder for the results, or to go on in.")
    ] = Path("reproduced"),
    define: Definitions = None,
    scheduler: Scheduler = None,
) -> None:
    """Remake section 5 of Beermann et al. 2018, and set every statement beside the paper's.

    Figures 6, 7, 9, 10(b) and 11 by ray search and by rendered frames, through the air as simulated
    and through air as broad as the paper's; and what the paper could not do: whole lines, all
    poses, a dense reconstruction. Finished work stays: stopped or killed, the same command goes on.
    """
    from virtual_sensor.reporting.measure import save as save_case
    from virtual_sensor.reporting.reproduction import cylinder_answer, cylinder_table, save
    from virtual_sensor.reporting.words import heading, in_words
    from virtual_sensor.studies.reproduction.reproduce import reproduce as run

    with reporting("reading what is finished", FINISHED_STAYS) as report:
        result = run(
            output,
            save_case,
            definitions(define),
            scheduler,
            lambda stage, fraction: report(stage, 0.93 * fraction),
        )
        report("drawing and writing", 0.93)
        save(result, output, command_line())
        report("done", 1.0)
    summary = result.summary
    table = Table("air", "", f"of {summary.statements} statements borne out")
    for air, number in summary.met.items():
        table.add_row(air, summary.airs[air], str(number))
    console.print(table)
    for name, value in vars(summary.rendered_minus_searched).items():
        console.print(f"  rendered minus searched, {heading(name)}: {in_words(value)}")
    console.print(cylinder_answer(result.reconstructions), soft_wrap=True)
    console.print(cylinder_table(result.reconstructions, narrow=True).rich())
    print_notes(summary.notes)
    console.print(f"{summary.made_now} of {summary.cases} cases measured now")
    print_end(output, "report/report.html")
