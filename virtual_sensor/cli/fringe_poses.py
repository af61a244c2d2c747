"""The command `virtual-sensor fringes poses`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import fringe_options, shared
from virtual_sensor.cli.sweep import values
from virtual_sensor.errors import InputError

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor fringes poses fringe_cylinder -o poses\n\n"
    "    virtual-sensor fringes poses fringe_cylinder -D beta=0:40:10 -D temperature=1250"
    " --weights coverage=2,air=1\n\n"
    "    virtual-sensor fringes poses fringe_stepped_shaft -D alpha=30,45,60 --grid 128"
)


def poses(
    scene: fringe_options.Scene,
    define: Annotated[
        list[str] | None,
        typer.Option(
            "-D",
            metavar="NAME=VALUES",
            help="Values of a parameter of the scene, with commas in between, or a range"
            " START:STOP:STEP; repeatable: all are combined. By default temperature=900,1100,1250"
            " and beta=0,15,30, of those that the scene has.",
        ),
    ] = None,
    camera: shared.Camera = None,
    source: fringe_options.Projector = None,
    weights: Annotated[
        str | None,
        typer.Option(
            metavar="NAME=WEIGHT,...",
            help="Of the score: distance, resolution, incidence, coverage, air (what the air does"
            " to the surface). Those that are not named are 0. By default 1 each, and air 0.",
        ),
    ] = None,
    grid: Annotated[
        int,
        typer.Option(min=2, max=2048, help="Columns of the camera's pixels that are searched."),
    ] = 64,
    output: shared.Folder = Path("poses"),
    overwrite: shared.Overwrite = False,
) -> None:
    """Compare poses and temperatures of a fringe sensor: deviation maps, fits, and which to choose.

    By a search of rays, without images: noise-free fringes. A laser line in the projector's place
    is set beside them.
    """
    given = shared.definitions(define)
    if len(given) < len(define or []):
        raise InputError("-D: a parameter is given twice; give all values at once, as -D beta=0,15")
    choices = {name: values(name, text) for name, text in given.items()}

    from virtual_sensor.reporting.fringe_poses import on_console, save
    from virtual_sensor.studies.fringes.poses import compare_poses

    shared.check_folder(output, overwrite)
    with shared.reporting("loading the scene") as report:
        result = compare_poses(
            scene,
            choices,
            weights=_weights(weights),
            grid=grid,
            camera=camera,
            source=source,
            report=lambda stage, part: report(stage, 0.95 * part),
        )
        report("writing the results", 0.95)
        save(result, output, shared.command_line(), overwrite)
    shared.print_results(on_console(result), result.notes)
    shared.print_end(output)


def _weights(text: str | None) -> dict[str, float]:
    """The weights of ``NAME=WEIGHT,...``."""
    found = {}
    for part in filter(None, (text or "").replace(" ", "").split(",")):
        name, equals, value = part.partition("=")
        try:
            found[name] = float(value)
        except ValueError:
            equals = ""
        if not (name and equals):
            raise InputError(f"--weights {part}: write it as NAME=WEIGHT, such as coverage=2")
    return found
