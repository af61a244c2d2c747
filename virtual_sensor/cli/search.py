"""The command `virtual-sensor search`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.errors import InputError
from virtual_sensor.files import check_output

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor search hot_cylinder\n\n"
    "    virtual-sensor search hot_cylinder --method newton -y 0 -y -5 -D beta=30\n\n"
    "    virtual-sensor search hot_cylinder --rays 401 -o line.csv"
)


def search(
    scene: shared.SceneArgument,
    define: shared.Definitions = None,
    camera: shared.Camera = None,
    source: shared.Source = None,
    method: Annotated[
        str, typer.Option(help="paper, newton or tabulated (by ray maps).")
    ] = "paper",
    y: shared.ProbeRays = None,
    rays: Annotated[
        int | None, typer.Option(min=2, help="So many rays along the whole line, in place of -y.")
    ] = None,
    output: Annotated[
        Path | None, typer.Option("-o", "--output", help="CSV file for the result.")
    ] = None,
    overwrite: shared.Overwrite = False,
) -> None:
    """Search, ray by ray, for the pixels that see the laser: no image is made.

    Exit status 3: none is found.
    """
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.records import write_csv
    from virtual_sensor.reporting.search import on_console
    from virtual_sensor.reporting.words import counted
    from virtual_sensor.studies.search import METHODS
    from virtual_sensor.studies.search import search as run

    if method not in METHODS:
        raise InputError(f"--method {method}: choose paper, newton or tabulated")
    if y and rays:
        raise InputError("-y and --rays: choose one of them")
    if output:
        check_output(output, overwrite)
        shared.check_suffix(output, (".csv",), "a table")
    with shared.reporting("loading the scene") as report:
        loaded = load_scene(scene, **shared.definitions(define)).only(camera, source)
        result = run(loaded, method, y or None, rays, report)
        if output:
            write_csv(output, result.rays)
    if not output:
        shared.console.print(on_console(result).rich())
    shared.print_notes(result.notes)
    found = f"{result.found} of {counted(len(result.rays), 'ray')} found"
    shared.print_time(f"{found}, table in {output}" if output else found)
    if len(result.rays) and not result.found:
        raise typer.Exit(shared.NOTHING_FOUND)
