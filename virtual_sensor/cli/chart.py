"""The command `virtual-sensor chart`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli.shared import (
    Overwrite,
    command_line,
    console,
    print_end,
    print_notes,
    reporting,
)
from virtual_sensor.files import check_output

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor chart\n\n"
    "    virtual-sensor chart --panel rays --panel search -o rays\n\n"
    "    virtual-sensor chart --quick -o glance --overwrite\n\n"
    "    virtual-sensor --variant cuda_ad_mono chart --panel frames -o gpu"
)


def chart(
    panel: Annotated[
        list[str] | None,
        typer.Option(
            "--panel",
            metavar="NAME",
            help="rays, frames, search or lines; repeatable. All of them without it.",
        ),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Few configurations on small tasks, to see that all works."),
    ] = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "charted"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Chart error against time on this machine, and say how little is enough.

    Every configuration is measured: bent rays, rendered frames, searches, line detectors. Leave
    the machine idle meanwhile: some eight minutes on two cores. A CUDA device that is found gets
    rows of its own.
    """
    from virtual_sensor.reporting.chart import front_tables, headline, save
    from virtual_sensor.studies.chart.chart import chart as measure
    from virtual_sensor.studies.chart.chart import check_panels

    check_panels(panel or [])
    check_output(output, overwrite, folder=True)
    with reporting("getting ready") as report:
        result = measure(panel or [], quick, lambda stage, done: report(stage, 0.97 * done))
        report("drawing and writing", 0.97)
        save(result, output, command_line(), overwrite)
        report("done", 1.0)
    for table in front_tables(result):
        console.print(table.rich())
    console.print(headline(result), style="bold", soft_wrap=True)
    print_notes(result.notes)
    print_end(output)
