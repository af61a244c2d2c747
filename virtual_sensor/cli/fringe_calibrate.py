"""The command `virtual-sensor fringes calibrate`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import fringe_options, shared
from virtual_sensor.imaging.fringe_recording import FringeRecording

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor fringes calibrate fringe_cylinder -o calibrated\n\n"
    "    virtual-sensor fringes calibrate fringe_cylinder --hot --target dots --poses 20\n\n"
    "    virtual-sensor fringes calibrate fringe_cylinder -D width=512 -D height=512 --electrons"
    " 8000 --distortion 2 --frames"
)


@shared.with_options
def calibrate(
    scene: fringe_options.Scene,
    define: shared.Definitions = None,
    camera: shared.Camera = None,
    source: fringe_options.Projector = None,
    poses: Annotated[int, typer.Option(min=3, max=200, help="Of the target.")] = 12,
    target: Annotated[
        str, typer.Option(help="What is on it: checkerboard or dots.")
    ] = "checkerboard",
    pitch: Annotated[
        float | None,
        typer.Option(
            metavar="MM",
            help="From mark to mark; by default such that the marks fill what both devices see.",
        ),
    ] = None,
    hot: Annotated[
        bool,
        typer.Option(
            "--hot", help="Calibrate in the scene's hot air; by default in homogeneous air."
        ),
    ] = False,
    lift: Annotated[
        float,
        typer.Option(metavar="MM", help="Of the target towards the devices, clear of the part."),
    ] = 0.0,
    distortion: Annotated[
        int,
        typer.Option(
            help="How many coefficients of OpenCV's (k1, k2, p1, p2, k3, ...) are fitted for each"
            " device: 0, 1, 2, 4, 5, 8 or 12."
        ),
    ] = 4,
    codec: Annotated[
        str,
        typer.Option(
            help="Of the patterns: `phase STEPS PERIODS uv`, periods in projector px; `gray uv`."
        ),
    ] = "phase 4 16,128,1280 uv",
    spp: fringe_options.Samples = None,
    frames: Annotated[bool, typer.Option("--frames", help="Write all frames too, as PNG.")] = False,
    output: shared.Folder = Path("calibrated"),
    overwrite: shared.Overwrite = False,
    *,
    recording: FringeRecording,
) -> None:
    """Calibrate camera and projector by rendered frames of a target, and compare with the truth.

    A checkerboard or a plate of dots stands in the part's place in several poses; its marks are
    found in the camera's image, and the projector's pixels there by its patterns. The calibration
    is written as OpenCV's YAML.
    """
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.reporting.fringe_calibration import on_console, save
    from virtual_sensor.studies.fringes.calibrate import CalibrationSettings

    shared.check_folder(output, overwrite)
    with shared.reporting("loading the scene") as report:
        loaded = load_scene(scene, **shared.definitions(define)).only(camera, source)
        settings = CalibrationSettings(
            codec, target, poses, distortion, hot, spp, recording, pitch, lift
        )
        result = save(loaded, settings, output, shared.command_line(), frames, overwrite, report)
    shared.print_results(on_console(result), result.summary.notes)
    shared.print_end(output)
