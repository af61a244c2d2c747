"""The command `virtual-sensor chart`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from virtual_sensor.cli.shared import Overwrite, console, print_notes, reporting
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
        bool, typer.Option("--quick", help="Few rungs on small tasks, to see that all works.")
    ] = False,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "charted"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Chart error against time on this machine, and tell where each method fails.

    Every rung of the ladder is measured: bent rays, rendered frames, searches, line detectors.
    Leave the machine idle meanwhile: some ten minutes on two cores. A CUDA device that is found
    gets rows of its own.
    """
    from virtual_sensor.studies.chart.chart import PANELS, check_panels
    from virtual_sensor.studies.chart.chart import chart as run
    from virtual_sensor.studies.chart.report import FRONT_HEAD, PAGE, front_rows, save_chart
    from virtual_sensor.studies.tables import in_words

    check_panels(panel or [])
    check_output(output, overwrite, folder=True)
    with reporting("getting ready") as report:
        result = run(panel or [], quick, lambda stage, fraction: report(stage, 0.97 * fraction))
        report("drawing and writing", 0.97)
        save_chart(result, output, overwrite)
        report("done", 1.0)
    for name in result.panels:
        table = Table(*FRONT_HEAD, title=f"{PANELS[name].title}: the front", title_justify="left")
        for row in front_rows(result, name):
            table.add_row(*row)
        console.print(table)
    for scaling in result.scalings:
        power = in_words(scaling.exponent, "{:.2f}")
        console.print(
            f"  {scaling.name}: time to the power {power}; {scaling.note}", soft_wrap=True
        )
    print_notes(result.notes)
    for fact, value in result.machine.items():
        console.print(f"  {fact}: {value}", soft_wrap=True)
    console.print(
        f"{len(result.rungs)} rungs, {len(result.failures)} failures told, {result.seconds:.0f} s;"
        f" results in {output}, look at {output / PAGE} first",
        soft_wrap=True,
    )
