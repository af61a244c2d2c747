"""The command `virtual-sensor detect`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.errors import InputError

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor detect line.png\n\n"
    "    virtual-sensor detect shots/ --detector max_likelihood --noise 1.2 --gain 0.37 --bits 12"
    " -o found\n\n"
    "    virtual-sensor detect line.tif --along rows --peaks 2\n\n"
    "    virtual-sensor detect phone.jpg --wavelength 650\n\n"
    "    virtual-sensor detect on/ --dark off/\n\n"
    "    virtual-sensor detect measured/hot.exr --calibration measured/calibration.yaml\n\n"
    "    virtual-sensor detect line.png --detector my_package.my_module:my_function"
)


def detect(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            help="PNG, TIFF, JPEG, BMP, WebP, PGM, OpenEXR and others, or folders of them.",
        ),
    ],
    detector: Annotated[
        str,
        typer.Option(
            help="gaussian, weighted_gaussian, max_likelihood, log_parabola, parabola,"
            " linear_interpolation, centre_of_gravity, fir4, fir8, steger (lines of any"
            " direction), an entry point's name, or package.module:function."
        ),
    ] = "gaussian",
    along: Annotated[
        str,
        typer.Option(
            help="columns, where the line lies flat, rows, where it stands, or auto: which of them"
            " show more of it."
        ),
    ] = "auto",
    peaks: Annotated[
        int,
        typer.Option(
            min=1, help="Peaks that are sought in each column: the line, then ghosts of it."
        ),
    ] = 1,
    choose: Annotated[
        str,
        typer.Option(
            help="What is the line, of several peaks: path, which continues best from column to"
            " column, or highest."
        ),
    ] = "path",
    bits: Annotated[
        int | None,
        typer.Option(min=1, max=16, help="Of the camera, where the file has more: 12, say."),
    ] = None,
    saturation: Annotated[
        float | None, typer.Option(help="Grey value from which on pixels are clipped.")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of dark grey values; by default as the file says, else as the"
            " image shows."
        ),
    ] = None,
    gain: Annotated[
        float,
        typer.Option(
            help="Grey values per electron (EMVA 1288's K), for the shot noise; 0: as the file"
            " says, else none."
        ),
    ] = 0.0,
    min_amplitude: Annotated[
        float, typer.Option(help="Smallest height of a line, relative to the image's highest.")
    ] = 0.01,
    max_width: Annotated[float, typer.Option(help="Broadest line, px standard deviation.")] = 32.0,
    channel: Annotated[
        str | None,
        typer.Option(
            help="Of a colour image: red, green, blue; of an EXR file its name there. By default"
            " the colour in which the line stands out most."
        ),
    ] = None,
    wavelength: Annotated[
        float | None,
        typer.Option(metavar="NM", help="Of the laser: of a colour image its colour is read."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="OpenCV's or ROS's YAML, XML or JSON, of fisheye lenses too: camera_matrix,"
            " distortion_coefficients, rotation, translation, laser_plane. Points are written then"
            " too, as PLY."
        ),
    ] = None,
    dark: Annotated[
        Path | None,
        typer.Option(
            help="An image of the same scene, exposed alike, with the laser off: it is subtracted."
            " Or a folder that has one of each image's name."
        ),
    ] = None,
    output: shared.Folder = Path("detected"),
    overwrite: shared.Overwrite = False,
) -> None:
    """Find laser lines in images: centres as CSV, points as PLY, a picture of each, and a page.

    Exit status 3: there are results, but no image has a line centre; the statuses say why. 1: some
    images could not be used, and are skipped.
    """
    from virtual_sensor.imaging.image_files import find_images
    from virtual_sensor.metrology.calibration import read_calibration
    from virtual_sensor.reporting.detect import lead, save, skipped, table
    from virtual_sensor.studies.detect import Settings
    from virtual_sensor.studies.detect import detect as run

    shared.see_own_modules()
    if bits is not None and saturation is not None:
        raise InputError("--bits and --saturation: choose one of them")
    settings = Settings(
        *(detector, along, peaks, choose, channel, wavelength, bits, saturation, noise, gain),
        min_amplitude=min_amplitude,
        max_width_px=max_width,
    )
    shared.check_folder(output, overwrite)
    calibrated = read_calibration(calibration) if calibration else None
    paths, notes = find_images(images)
    if dark and len(paths) > 1:  # it may lie among them
        paths = [path for path in paths if path != dark]
    notes += calibrated.notes if calibrated else ()
    with shared.reporting("reading") as report:
        found = run(paths, settings, calibrated, dark)
        command = shared.command_line()
        summary = save(
            *(found, paths, settings, output, command, overwrite, calibration, dark),
            notes=notes,
            report=report,
        )
    tables = [table(summary), skipped(summary)] if summary.skipped else [table(summary)]
    shared.print_results([*tables, lead(summary)], summary.notes)
    shared.print_end(output)
    if not summary.centres:
        raise typer.Exit(shared.NOTHING_FOUND)
    if summary.skipped:
        raise typer.Exit(1)
