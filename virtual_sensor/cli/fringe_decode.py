"""The command `virtual-sensor fringes decode`."""

from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.errors import InputError

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor fringes decode shots/\n\n"
    '    virtual-sensor fringes decode shots/ --codec "phase 4 16,128,1280 u" --size 1280x800'
    " -o decoded\n\n"
    '    virtual-sensor fringes decode shots/ --codec "phase 8 20 uv gray" --order auto\n\n'
    '    virtual-sensor fringes decode gray_*.png --codec "gray uv" --bits 12 --format npz\n\n'
    '    virtual-sensor fringes decode one.png --codec "single 16 u"'
)


def decode(
    images: Annotated[
        list[Path],
        typer.Argument(
            metavar="IMAGE...",
            help="The sequence, one image for each pattern: PNG, TIFF, BMP or JPEG of 8 to 16 bits,"
            " OpenEXR, or a folder of them, which is taken by name, numbers by their value.",
        ),
    ],
    codec: Annotated[
        str,
        typer.Option(
            help="Of the patterns: `phase STEPS [PERIODS] [AXES] [UNWRAPPING] [FIRSTdeg]`, periods"
            " in projector px with commas, axes u (columns), v (rows) or uv, unwrapping"
            " hierarchical, heterodyne, gray, spatial or none, and the phase at the image's border"
            " in the first step (-90deg of sines); `gray [AXES] [single]`: of single bits, without"
            " inverses, white and black stand before each axis's; `single [PERIOD] [AXES]`. Axis by"
            " axis, period by period, step by step, of which k shows A + B cos(phi - 2 pi k/STEPS);"
            " Gray bits follow, the coarsest first.",
        ),
    ] = "phase 4 16,128,1280 uv",
    size: Annotated[
        str, typer.Option(metavar="WxH", help="Width and height of the projector in px.")
    ] = "1280x800",
    order: Annotated[
        str,
        typer.Option(
            help="Of the images: usual, the codec's; coarse-first, fine-first, steps-first,"
            " rows-first, gray-first, fine-bits-first, each also with ' backwards';"
            " steps-backwards, of cos(phi + 2 pi k/STEPS), alone or after another; by-text (1, 10,"
            " 2); of each pattern the number of its image, with commas; auto: what the images tell."
        ),
    ] = "usual",
    noise: Annotated[
        float | None,
        typer.Option(
            help="Standard deviation of dark grey values; by default as the files say, else as the"
            " images show."
        ),
    ] = None,
    gain: Annotated[
        float,
        typer.Option(
            help="Grey values per electron (EMVA 1288's K), for the shot noise; 0: as the files"
            " say, else none."
        ),
    ] = 0.0,
    black: Annotated[
        float | None,
        typer.Option(
            help="Grey value of a pixel without light: the black level; by default as the files"
            " say, else 0."
        ),
    ] = None,
    saturation: Annotated[
        float | None, typer.Option(help="Grey value from which on pixels are clipped.")
    ] = None,
    bits: Annotated[
        int | None,
        typer.Option(min=1, max=16, help="Of the camera, where the files have more: 12, say."),
    ] = None,
    channel: Annotated[
        str | None,
        typer.Option(help="Of colour images: red, green, blue; of EXR files its name there."),
    ] = None,
    least_modulation: Annotated[
        float, typer.Option(help="Weakest fringes that count, relative to the image's strongest.")
    ] = 0.02,
    border: Annotated[
        float,
        typer.Option(
            metavar="PX",
            help="Of the projector's image: that is left out; of a projector that is out of focus"
            " three times the standard deviation of its blur.",
        ),
    ] = 0.0,
    format: Annotated[
        list[str] | None,
        typer.Option(help="Of what is decoded: exr (the default), npz or csv; repeatable."),
    ] = None,
    output: shared.Folder = Path("decoded"),
    overwrite: shared.Overwrite = False,
) -> None:
    """Decode a sequence of images of fringes: projector pixels with their errors, maps and a page.

    The images themselves tell whether they are in order: if not, or if one is missing, it is said.

    Exit status 3: there are results, but no pixel is decoded; the statuses say why.
    """
    from virtual_sensor.arrays import one_of
    from virtual_sensor.reporting.fringe_decode import FORMATS, lead, save, table
    from virtual_sensor.studies.fringes.decode import (
        DecodeSettings,
        decode_sequence,
        sequence_files,
    )

    if bits is not None and saturation is not None:
        raise InputError("--bits and --saturation: choose one of them")
    formats = tuple(one_of("--format", each.lower(), FORMATS) for each in format or FORMATS[:1])
    settings = DecodeSettings(
        codec=codec,
        size_px=_size(size),
        order=order,
        channel=channel,
        bits=bits,
        noise=noise,
        gain=gain,
        black=black,
        saturation=saturation,
        least_modulation=least_modulation,
        border_px=border,
    )
    shared.check_folder(output, overwrite)
    paths, notes = sequence_files(images)
    with shared.reporting("reading") as report:
        result = decode_sequence(paths, settings, report)
        report("writing the results", 0.8)
        command = shared.command_line()
        summary = save(result, settings, output, command, overwrite, formats, notes)
    shared.print_results([table(result), lead(result)], summary.notes)
    shared.print_end(output)
    if not summary.found.pixels:
        raise typer.Exit(shared.NOTHING_FOUND)


def _size(text: str) -> tuple[int, int]:
    """Width and height of ``WxH``."""
    width, _, height = text.lower().replace("×", "x").partition("x")
    if not (width.strip().isdecimal() and height.strip().isdecimal()):
        raise InputError(f"--size {text}: write it as WIDTHxHEIGHT in px, such as 1280x800")
    return int(width), int(height)
