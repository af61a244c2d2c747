"""The command `virtual-sensor reproduce`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from virtual_sensor.cli.shared import (
    FINISHED_STAYS,
    Definitions,
    Scheduler,
    console,
    definitions,
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
    poses, a dense reconstruction. What is finished is kept: stopped or killed, the same command
    goes on.
    """
    from virtual_sensor.reporting.measure import save as save_case
    from virtual_sensor.studies.reproduction.report import PAGE, save_reproduction
    from virtual_sensor.studies.reproduction.reproduce import reproduce as run
    from virtual_sensor.studies.tables import in_words

    with reporting("reading what is kept", FINISHED_STAYS) as report:
        result = run(
            output,
            save_case,
            definitions(define),
            scheduler,
            lambda stage, fraction: report(stage, 0.93 * fraction),
        )
        report("drawing and writing", 0.93)
        figures = save_reproduction(result, output)
        report("done", 1.0)
    table = Table("air", "", f"of {figures['statements']} statements borne out")
    for air, number in figures["borne out"].items():
        table.add_row(air, figures["airs"][air], str(number))
    console.print(table)
    for name, value in figures["rendered minus searched, px"].items():
        console.print(f"  rendered minus searched, {name}: {in_words(value)} px")
    for line in figures["cylinder fit"]:
        console.print(f"  {line}", soft_wrap=True)
    print_notes(figures["notes"])
    console.print(
        f"{figures['measured now']} of {len(result.measured['status'])} cases measured now,"
        f" {figures['seconds']:.0f} s; look at {output / 'report' / PAGE} first",
        soft_wrap=True,
    )
