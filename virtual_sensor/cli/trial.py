"""The command `virtual-sensor trial`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.errors import InputError
from virtual_sensor.files import exists

PEAK_E, READ_NOISE_E = 5000.0, 2.0
"""Of a line and a camera that nothing is said of."""

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor trial\n\n"
    "    virtual-sensor trial --width 2.5 --peak 900 --read-noise 6\n\n"
    "    virtual-sensor trial --sensor-model cmos_5um5 --width 2.5\n\n"
    "    virtual-sensor trial --quick -o glance\n\n"
    "    virtual-sensor trial --kind hard -o hard\n\n"
    "    virtual-sensor trial --kind clipped --kind edged --detector gaussian\n\n"
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
    peak: Annotated[
        float | None,
        typer.Option(
            help="Electrons of a pixel at your line's peak; by default 5000, or 80 % of what the"
            " image sensor can tell."
        ),
    ] = None,
    read_noise: Annotated[
        float | None,
        typer.Option(help="Of your camera, electrons; by default 2, or the image sensor's."),
    ] = None,
    sensor_model: Annotated[
        str | None,
        typer.Option(
            metavar="NAME",
            help="Record your line, and the part cold and hot, by this image sensor: cmos_5um5,"
            " cmos_3um45, profile_sensor, or a .toml file of your own.",
        ),
    ] = None,
    seed: Annotated[
        int, typer.Option(metavar="N", min=0, help="Of all images: the same, the same images.")
    ] = 0,
    columns: Annotated[int, typer.Option(metavar="N", min=100, help="Of each drawn image.")] = 2000,
    quick: Annotated[bool, typer.Option("--quick", help="Few images, in seconds.")] = False,
    frames: Annotated[
        bool,
        typer.Option(
            "--frames/--no-frames", help="Render too: the part cold and hot, and hard frames."
        ),
    ] = True,
    kind: Annotated[
        list[str] | None,
        typer.Option(
            metavar="KIND",
            help="Only such images, besides your line's: clean, saturated, speckle, cold, hot;"
            " clipped, edged, speckled, ambient, spattered, ghostly, or hard for these six;"
            " repeatable.",
        ),
    ] = None,
    workers: Annotated[
        int | None,
        typer.Option(metavar="N", min=1, help="Processes; by default one for each core."),
    ] = None,
    output: shared.Folder = Path("trial"),
    overwrite: shared.Overwrite = False,
) -> None:
    """Try line detectors on images of known truth: error, bias, outliers, time, and the bound.

    Widths, signals and noises; saturation, speckle, ambient light; the part rendered cold and hot.
    Hard frames: over-exposed, with edges of the reflectance, grains, spatter and ghosts; each
    centre is held against the error that its detector predicts.
    """
    from virtual_sensor.reporting.trial import described, hard_table, honesty, lead, save, table
    from virtual_sensor.studies.trial.images import AMOUNTS, Condition
    from virtual_sensor.studies.trial.trial import trial as run

    shared.see_own_modules()
    shared.check_folder(output, overwrite)
    if sensor_model is None:
        peak = PEAK_E if peak is None else peak
        read_noise = READ_NOISE_E if read_noise is None else read_noise
        task = Condition.of_peak("task", width, peak, read_noise)
    elif read_noise is not None:
        raise InputError(
            f"--read-noise {read_noise:g}: {sensor_model} has read noise of its own; leave it out,"
            " or --sensor-model"
        )
    else:
        file = Path(sensor_model)  # other processes read it too
        sensor = str(file.absolute()) if file.suffix and exists(file) else sensor_model
        task = Condition.of_sensor("task", width, sensor, peak)
    with shared.reporting("getting ready") as report:
        result = run(
            *(detector or [], task, seed, columns, quick, frames, kind or [], workers),
            lambda stage, fraction: report(stage, 0.9 * fraction),
        )
        report("drawing and writing", 0.9)
        save(result, output, shared.command_line(), overwrite)
    scores = table(result.of("task"), described(task), narrow=True)
    bold = ["Bold: no other detector is both faster and more accurate."]
    key = bold if shared.console.is_terminal else []  # a pipe has no bold
    hard = (hard_table(result), honesty(result)) if result.of(*AMOUNTS) else ()
    shared.print_results([scores, *key, *hard, lead(result)])
    shared.print_end(output)
