"""The command `virtual-sensor detect`."""

from pathlib import Path
from typing import Annotated, Any

import typer
from rich.table import Table

from virtual_sensor.cli.shared import (
    Overwrite,
    command_line,
    console,
    print_notes,
    reporting,
    see_own_modules,
)
from virtual_sensor.errors import InputError
from virtual_sensor.files import RESULTS_SIGN, check_output, folder_written_whole

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor detect line.png\n\n"
    "    virtual-sensor detect shots/ --detector max_likelihood --noise 1.2 --gain 0.37 --bits 12"
    " -o found\n\n"
    "    virtual-sensor detect line.tif --along rows --peaks 2\n\n"
    "    virtual-sensor detect measured/hot.exr --calibration measured/calibration.yaml\n\n"
    "    virtual-sensor detect line.png --detector my_package.my_module:my_function"
)


def detect(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            help="PNG, TIFF, BMP or JPEG of 8 to 16 bits, OpenEXR, or folders of them.",
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
        str, typer.Option(help="columns, where the line lies flat, or rows, where it stands.")
    ] = "columns",
    peaks: Annotated[
        int, typer.Option(min=1, help="So many peaks of each column, the highest first.")
    ] = 1,
    bits: Annotated[
        int | None,
        typer.Option(min=1, max=16, help="Of the camera, where the file has more: 12, say."),
    ] = None,
    saturation: Annotated[
        float | None, typer.Option(help="Grey value from which on pixels are clipped.")
    ] = None,
    noise: Annotated[
        float | None,
        typer.Option(help="Standard deviation of dark grey values; by default as the image shows."),
    ] = None,
    gain: Annotated[
        float,
        typer.Option(help="Grey values per electron (EMVA 1288's K), for the shot noise; 0: none."),
    ] = 0.0,
    min_amplitude: Annotated[
        float, typer.Option(help="Smallest height of a line, relative to the image's highest.")
    ] = 0.01,
    max_width: Annotated[float, typer.Option(help="Broadest line, px standard deviation.")] = 32.0,
    channel: Annotated[
        str | None,
        typer.Option(help="Of a colour image: red, green, blue; of an EXR file its name there."),
    ] = None,
    calibration: Annotated[
        Path | None,
        typer.Option(
            help="OpenCV's or ROS's YAML, XML or JSON, of fisheye lenses too: camera_matrix,"
            " distortion_coefficients, rotation, translation, laser_plane. Then there are points"
            " too, as PLY."
        ),
    ] = None,
    output: Annotated[Path, typer.Option("-o", "--output", help="Folder for the results.")] = Path(
        "detected"
    ),
    overwrite: Overwrite = False,
) -> None:
    """Find laser lines in images: their centres as CSV, a picture of each, and points as PLY."""
    from virtual_sensor.imaging.image_files import find_images
    from virtual_sensor.metrology.calibration import read_calibration
    from virtual_sensor.studies.detect import Detected
    from virtual_sensor.studies.detect import detect as run
    from virtual_sensor.studies.detect_results import names_of, save_detected
    from virtual_sensor.studies.tables import write_json

    see_own_modules()
    if bits is not None and saturation is not None:
        raise InputError("--bits and --saturation: choose one of them")
    options: dict[str, Any] = {"along": along, "peaks": peaks, "min_amplitude": min_amplitude}
    options |= {"saturation": saturation, "max_sigma": max_width, "noise": noise, "gain": gain}
    calibrated = read_calibration(calibration) if calibration else None
    check_output(output, overwrite, folder=True)
    paths, notes = find_images(images)
    notes += calibrated.notes if calibrated else ()
    names = names_of(paths)
    summary: dict[str, Any] = {}
    table = Table("image", "centres", "other statuses", "detector's time")
    with reporting("reading") as report, folder_written_whole(output, overwrite) as place:

        def each(found: Detected, number: int) -> None:
            report(found.path.name, number / len(paths))
            save_detected(found, names[number], place)
            counts = dict(found.counts)
            ok = counts.pop("ok", 0)
            others = ", ".join(f"{name} {n}" for name, n in counts.items())
            table.add_row(names[number], str(ok), others, f"{found.seconds * 1e3:.0f} ms")
            summary[names[number]] = {"file": str(found.path), "ok": ok, **counts}

        notes += run(paths, detector, options, channel, calibrated, each, bits)
        report("done", 1.0)
        told = {"command": command_line(), "notes": notes, "images": summary}
        write_json(place / RESULTS_SIGN, told)
    console.print(table)
    print_notes(notes)
    first = output / f"{names[0]}.png"
    read = "1 image" if len(paths) == 1 else f"{len(paths)} images"
    console.print(f"{read}; results in {output}, look at {first} first", soft_wrap=True)
