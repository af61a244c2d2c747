"""The command `virtual-sensor trial`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor trial\n\n"
    "    virtual-sensor trial --width 2.5 --peak 900 --read-noise 6\n\n"
    "    virtual-sensor trial --quick -o glance\n\n"
    "    virtual-sensor trial --detector max_likelihood --detector my_package.my_module:mine"
)


def trial(
    detector: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME",
            help="One of ours, an entry point's name, or package.module:function; repeatable."
            " All of ours without it.",
        ),
    ] = None,
    width: Annotated[
        float,
        typer.Option(help="Of your line, px standard deviation: a detector is chosen for it."),
    ] = 1.5,
    peak: Annotated[float, typer.Option(help="Electrons of a pixel at your line's peak.")] = 5000.0,
    read_noise: Annotated[float, typer.Option(help="Of your camera, electrons.")] = 2.0,
    seed: Annotated[
        int, typer.Option(metavar="N", min=0, help="Of all images: the same, the same images.")
    ] = 0,
    columns: Annotated[int, typer.Option(metavar="N", min=100, help="Of each drawn image.")] = 2000,
    quick: Annotated[bool, typer.Option("--quick", help="Few images, in seconds.")] = False,
    frames: Annotated[
        bool, typer.Option("--frames/--no-frames", help="Render the part cold and hot too.")
    ] = True,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Processes; by default one for each core."),
    ] = None,
    output: shared.Folder = Path("trial"),
    overwrite: shared.Overwrite = False,
) -> None:
    """Try line detectors on images of known truth: error, bias, outliers, time, and the bound.

    Widths, signals and noises; saturation, speckle, ambient light; the part rendered cold and hot.
    """
    from virtual_sensor.reporting.trial import described, lead, save, table
    from virtual_sensor.studies.trial.images import Condition
    from virtual_sensor.studies.trial.trial import trial as run

    shared.see_own_modules()
    shared.check_folder(output, overwrite)
    task = Condition.of_peak("task", width, peak, read_noise)
    with shared.reporting("getting ready") as report:
        result = run(
            *(detector or [], task, seed, columns, quick, frames, workers),
            lambda stage, fraction: report(stage, 0.9 * fraction),
        )
        report("drawing and writing", 0.9)
        save(result, output, shared.command_line(), overwrite)
    scores = table(result.of("task"), described(task), narrow=True)
    bold = ["Bold: no other detector is both faster and more accurate."]
    key = bold if shared.console.is_terminal else []  # a pipe has no bold
    shared.print_results([scores, *key, lead(result)])
    shared.print_end(output)
