"""The command `virtual-sensor measure`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli.shared import (
    NOTHING_FOUND,
    Camera,
    Definitions,
    Overwrite,
    ProbeRays,
    SceneArgument,
    Source,
    command_line,
    console,
    definitions,
    print_end,
    print_notes,
    reporting,
)
from virtual_sensor.files import check_output

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor measure hot_cylinder\n\n"
    "    virtual-sensor measure hot_cylinder -D beta=15 -D line_radius=0.1 -o turned\n\n"
    "    virtual-sensor measure stepped_shaft -o shaft\n\n"
    "    virtual-sensor measure hot_cylinder --tolerance 0.01"
)


def measure(
    scene: SceneArgument,
    define: Definitions = None,
    camera: Camera = None,
    source: Source = None,
    y: ProbeRays = None,
    tolerance: Annotated[
        float | None,
        typer.Option(
            help="Error of the line centres, px, that is allowed: the cheapest settings that keep"
            " it are chosen, and printed."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "measured"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Measure a part cold and hot: frames, line centres, points, ray search, a picture and a page.

    Exit status 3: there are results, but no frame has a line centre; a note says why.
    """
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.reporting.measure import on_console, save
    from virtual_sensor.studies.measure import measure as run

    check_output(output, overwrite, folder=True)
    with reporting("loading the scene") as report:
        loaded = load_scene(scene, **definitions(define)).only(camera, source)
        if tolerance is not None:
            from virtual_sensor.studies.tolerance import choose, configured

            report("choosing the settings", 0.0)
            configuration = choose(loaded, tolerance)
            loaded = configured(loaded, configuration)
            console.print(f"{tolerance:g} px: {configuration}", soft_wrap=True)
            console.print(f"  because {'; '.join(configuration.why)}", soft_wrap=True)
        result = run(loaded, lambda stage, fraction: report(stage, 0.9 * fraction), y or None)
        report("writing the results", 0.92)
        figures = save(result, output, command_line(), overwrite)
        report("done", 1.0)
    for each in on_console(figures):
        console.print(each if isinstance(each, str) else each.rich(), soft_wrap=True)
    print_notes(result.notes)
    print_end(output)
    if not result.centres:
        raise typer.Exit(NOTHING_FOUND)
