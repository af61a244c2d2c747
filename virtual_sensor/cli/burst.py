"""The command `virtual-sensor burst`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.files import folder_written_whole
from virtual_sensor.imaging.recording_options import RecordingOptions

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor burst hot_cylinder -D field=plume.nc\n\n"
    "    virtual-sensor burst hot_cylinder -D field=plume.nc --start 4 --duration 2 --frames 21"
    " -o sway_4s\n\n"
    "    virtual-sensor burst hot_cylinder -D field=plume.nc --images -o with_frames\n\n"
    "    virtual-sensor burst stepped_shaft -D field=plume.nc -D width=1024 -D height=1024\n\n"
    "    virtual-sensor burst hot_cylinder -D field=plume.nc --sensor-model cmos_5um5 --seed 1"
)


@shared.with_options
def burst(
    scene: shared.SceneArgument,
    define: shared.Definitions = None,
    camera: shared.Camera = None,
    source: shared.Source = None,
    y: shared.ProbeRays = None,
    start: Annotated[
        float | None,
        typer.Option(help="Flow time of the first frame, s; by default the field's last second."),
    ] = None,
    duration: Annotated[float, typer.Option(help="From the first frame to the last, s.")] = 1.0,
    frames: Annotated[int, typer.Option(help="Number of frames.")] = 11,
    images: Annotated[
        bool, typer.Option("--images", help="Write the frames too: EXR and PNG, in frames/.")
    ] = False,
    output: shared.Folder = Path("sway"),
    overwrite: shared.Overwrite = False,
    *,
    recording: RecordingOptions,
) -> None:
    """Measure a burst of frames in moving air: how much the line and the measured points sway.

    The scene's field must have a time axis. `sway.csv` has the standard deviation in each column.
    Exit status 3: a frame has no line centre; no results are written.
    """
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.reporting.burst import FrameFiles, lead, save, table
    from virtual_sensor.studies.burst import burst as run

    shared.check_folder(output, overwrite)
    with (
        shared.reporting("loading the scene") as report,
        folder_written_whole(output, overwrite) as place,
    ):
        loaded = load_scene(scene, **shared.definitions(define)).only(camera, source)
        result = run(
            loaded,
            start,
            duration,
            frames,
            lambda stage, fraction: report(stage, 0.95 * fraction),
            y or None,
            **({"each_frame": FrameFiles(place, loaded)} if images else {}),
            recording=recording,
        )
        report("writing the results", 0.95)
        save(result, place, shared.command_line())
    figures = result.summary
    shared.print_results([table(figures), lead(figures)], figures.notes)
    shared.print_end(output)
