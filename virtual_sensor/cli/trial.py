"""The command `virtual-sensor trial`."""

from pathlib import Path
from typing import Annotated

import typer
from rich.table import Table

from virtual_sensor.cli.shared import Overwrite, console, reporting, see_own_modules
from virtual_sensor.files import check_output

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor trial\n\n"
    "    virtual-sensor trial --quick -o glance\n\n"
    "    virtual-sensor trial --detector max_likelihood --detector my_package.my_module:mine"
)


def trial(
    detector: Annotated[
        list[str] | None,
        typer.Option(
            help="One of ours, an entry point's name, or package.module:function; repeatable."
            " All of ours without it."
        ),
    ] = None,
    seed: Annotated[int, typer.Option(min=0, help="Of all images: the same, the same images.")] = 0,
    columns: Annotated[int, typer.Option(min=100, help="Of each drawn image.")] = 2000,
    quick: Annotated[bool, typer.Option("--quick", help="Few images, in seconds.")] = False,
    frames: Annotated[
        bool, typer.Option("--frames/--no-frames", help="Render the part cold and hot too.")
    ] = True,
    workers: Annotated[
        int | None, typer.Option(min=1, help="Processes; by default one a core.")
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "trial"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Try line detectors on images of known truth: error, bias, outliers and time, and the bound.

    Widths, signals and noises; saturation, speckle and background; the part rendered cold and hot.
    """
    from virtual_sensor.studies.trial.drawing import chosen_for_front, front
    from virtual_sensor.studies.trial.report import HEAD, PAGE, rows, save_trial
    from virtual_sensor.studies.trial.trial import trial as run

    see_own_modules()
    check_output(output, overwrite, folder=True)
    with reporting("getting ready") as report:
        result = run(
            detector or [],
            seed,
            columns,
            quick,
            frames,
            workers,
            lambda stage, fraction: report(stage, 0.95 * fraction),
        )
        report("drawing and writing", 0.95)
        save_trial(result, output, overwrite)
        report("done", 1.0)
    scores = chosen_for_front(result)
    condition = scores[0].condition
    title = f"line of {condition.width_px:g} px, {condition.column_electrons:g} electrons a column"
    table = Table(title=title, title_justify="left", box=None, pad_edge=False)
    for number, name in enumerate(HEAD):
        table.add_column(name, no_wrap=number == 0)
    best = {each.detector for each in front(scores)}
    for row in rows(scores):
        table.add_row(*row, style="bold" if row[0] in best else None)
    console.print(table)
    console.print(
        f"{len(result.scores)} scores in {result.seconds:.0f} s (bold: no other is both faster and"
        f" more accurate); results in {output}, look at {output / PAGE} first",
        soft_wrap=True,
    )
