"""The command `virtual-sensor correct`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.errors import InputError

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor correct measured/\n\n"
    "    virtual-sensor correct pose_0/ pose_30/ --estimate scale,width -o both\n\n"
    "    virtual-sensor correct fringes/ --estimate scale,width -o surface\n\n"
    "    virtual-sensor correct burst/ --medium steady.nc --estimate lean,width -o still\n\n"
    "    virtual-sensor correct line.csv --scene hot_cylinder -D beta=15 --medium air.nc\n\n"
    "    virtual-sensor correct line_0.csv line_30.csv:beta=30 --scene hot_cylinder"
    " --temperature 1180\n\n"
    "    virtual-sensor correct shot.png --scene hot_cylinder --calibration sensor.yaml"
    " --estimate scale,offset --shape part --prior scale=1:0.05"
)


def correct(
    measured: Annotated[
        list[str],
        typer.Argument(
            metavar="MEASURED...",
            help="Folders of `measure`, `fringes`, `fringes decode` or `burst`, tables of line"
            " centres (CSV), or images; with parameters of the scene for one alone behind a colon:"
            " line.csv:beta=30.",
        ),
    ],
    scene: Annotated[
        str | None,
        typer.Option(
            help="In which it was measured, by default the one that the folders name; a file, or"
            " one that is installed: hot_cylinder, cold_cylinder, stepped_shaft,"
            " v_groove, bearing_ring."
        ),
    ] = None,
    define: shared.Definitions = None,
    camera: shared.Camera = None,
    source: shared.Source = None,
    medium: Annotated[
        Path | None,
        typer.Option(help="Field of the air that light went through; by default the scene's own."),
    ] = None,
    temperature: Annotated[
        float | None,
        typer.Option(
            help="Wall temperature of the air, degC, between those of the scene's fields."
        ),
    ] = None,
    estimate: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Parameters that are found from the measurements: scale, width, offset, lean,"
            " height, blur, pressure, temperature of the air; of poses sensor_x ... camera_turn_z,"
            " of one measurement NAME.sensor_x; of the laser plane laser_offset, laser_tilt,"
            " laser_roll.",
        ),
    ] = None,
    shape: Annotated[
        str | None,
        typer.Option(
            help="Of the part, for an estimate: cylinder, plane, sphere (with parameters of their"
            " own that are found too), part (the scene's, known), none (dots need none)."
        ),
    ] = None,
    free: Annotated[
        str | None,
        typer.Option(
            metavar="NAMES",
            help="Parameters of the shape that are found: radius,y,z of a cylinder, which are the"
            " default; none: it is known.",
        ),
    ] = None,
    prior: Annotated[
        list[str] | None,
        typer.Option(
            metavar="NAME=VALUE:SIGMA",
            help="What is known of a parameter before: scale=1:0.05; repeatable.",
        ),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="Of the sensor, in the scene's world: OpenCV's or ROS's YAML, XML or JSON with a"
            " laser_plane, or of camera and projector; by default the scene's own sensor."
        ),
    ] = None,
    sigma: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of the line's centres, px, in place of those that files have."
        ),
    ] = None,
    tolerance: Annotated[
        float, typer.Option(help="Change of the residuals, px, below which an estimate ends.")
    ] = 1e-5,
    output: shared.Folder = Path("corrected"),
    overwrite: shared.Overwrite = False,
) -> None:
    """Correct points that were measured through hot air: give the air, or have it estimated.

    Two poses of the sensor make the air visible: measure at both, and give both with --estimate.
    Fringes along both axes show it by their epipolar residual, whatever the shape.

    Exit status 3: there are results, but no line centre is given; the statuses say why.
    """
    from virtual_sensor.reporting.correct import on_console, save
    from virtual_sensor.studies.correct.asked import Settings, names_of, priors_of
    from virtual_sensor.studies.correct.correct import correct as run
    from virtual_sensor.studies.correct.measured import Scenes, read_measured

    shared.check_folder(output, overwrite)
    for path in [*(Path(text.partition(":")[0]) for text in measured), medium, calibration]:
        if path and output.resolve() in (path.resolve(), *path.resolve().parents):
            raise InputError(
                f"-o {output}: holds {path}, which is to be corrected or read; name another folder"
            )
    settings = Settings(
        medium,
        temperature,
        names_of(estimate),
        shape,
        None if free is None else names_of(free),
        priors_of(prior or []),
        tolerance,
    )
    with shared.reporting("reading") as report:
        scenes = Scenes(scene, shared.definitions(define), camera, source)
        given = read_measured(measured, scenes, calibration, sigma)
        result = run(given, settings, lambda stage, part: report(stage, 0.1 + 0.8 * part))
        report("writing the results", 0.9)
        save(result, output, shared.command_line(), overwrite)
    shared.print_notes(result.caveats)
    others = [note for note in result.notes if note not in result.caveats]
    shared.print_results(on_console(result), others)
    shared.print_end(output)
    if not result.points:
        raise typer.Exit(shared.NOTHING_FOUND)
