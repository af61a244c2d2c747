"""The command `virtual-sensor chart`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared

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
            help="rays, frames, search, correction, fringes, camera or lines; repeatable. All of"
            " them without it.",
        ),
    ] = None,
    quick: Annotated[
        bool,
        typer.Option("--quick", help="Few configurations on small tasks, to see that all works."),
    ] = False,
    output: shared.Folder = Path("charted"),
    overwrite: shared.Overwrite = False,
) -> None:
    """Chart error against time on this machine, and say how little is enough.

    Every configuration is measured: bent rays, rendered frames, searches, corrections, fringes,
    frames through a lens, line detectors. Leave the machine idle meanwhile: some ten minutes on two
    cores. A CUDA device that is found gets rows of its own.
    """
    from virtual_sensor.reporting.chart import front_tables, headline, save
    from virtual_sensor.studies.chart.chart import chart as measure
    from virtual_sensor.studies.chart.chart import check_panels

    check_panels(panel or [])
    shared.check_folder(output, overwrite)
    with shared.reporting("getting ready") as report:
        result = measure(panel or [], quick, lambda stage, done: report(stage, 0.97 * done))
        report("drawing and writing", 0.97)
        save(result, output, shared.command_line(), overwrite)
    shared.print_results([*front_tables(result), headline(result)], result.notes)
    shared.print_end(output)
