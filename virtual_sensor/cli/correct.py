"""The command `virtual-sensor correct`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor correct measured/\n\n"
    "    virtual-sensor correct line.csv --scene hot_cylinder -D beta=15 --medium air.nc\n\n"
    "    virtual-sensor correct line_0.csv line_30.csv:beta=30 --scene hot_cylinder -o both"
)


def correct(
    measured: Annotated[
        list[str],
        typer.Argument(
            metavar="MEASURED...",
            help="Folders of `measure` or `burst`, tables of line centres (CSV), or images; with"
            " parameters of its own where a colon follows: line.csv:beta=30.",
        ),
    ],
    scene: Annotated[
        str | None,
        typer.Option(
            help="In which it was measured, by default the one that the folders name; a file, or"
            " one that is installed: hot_cylinder, cold_cylinder, stepped_shaft."
        ),
    ] = None,
    define: shared.Definitions = None,
    camera: shared.Camera = None,
    source: shared.Source = None,
    medium: Annotated[
        Path | None,
        typer.Option(help="Field of the air that light went through; by default the scene's own."),
    ] = None,
    output: shared.Folder = Path("corrected"),
    overwrite: shared.Overwrite = False,
) -> None:
    """Correct points that were measured through hot air: give the air, or have it estimated.

    Exit status 3: there are results, but no point could be corrected; the statuses say why.
    """
    from virtual_sensor.reporting.correct import on_console, save
    from virtual_sensor.studies.correct.correct import Settings
    from virtual_sensor.studies.correct.correct import correct as run
    from virtual_sensor.studies.correct.measured import Scenes, read_measured

    shared.check_folder(output, overwrite)
    with shared.reporting("reading") as report:
        scenes = Scenes(scene, shared.definitions(define), camera, source)
        given = read_measured(measured, scenes)
        result = run(given, Settings(medium), lambda s, f: report(s, 0.1 + 0.8 * f))
        report("writing the results", 0.9)
        save(result, output, shared.command_line(), overwrite)
    shared.print_notes(result.caveats)
    others = [note for note in result.notes if note not in result.caveats]
    shared.print_results(on_console(result), others)
    shared.print_end(output)
    if not result.points:
        raise typer.Exit(shared.NOTHING_FOUND)
