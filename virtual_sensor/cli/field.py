"""The commands `virtual-sensor field info` and `field import`."""

from dataclasses import replace
from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.errors import InputError
from virtual_sensor.files import check_output
from virtual_sensor.medium.imports.import_field import Choices, import_field

FIELD_FILES = (".nc",)
"""Suffixes of a field file that is written."""

app = typer.Typer(
    help="The air's field: simulate it, import it from another solver, examine it.",
    no_args_is_help=True,
    rich_markup_mode="markdown",
)


@app.callback()
def field() -> None:
    """The air's field: simulate it, import it from another solver, examine it."""


@app.command(
    epilog="Examples:\n\n"
    "    virtual-sensor field info air.nc\n\n"
    "    virtual-sensor field info hot_cylinder_1250C_quarter\n\n"
    "    virtual-sensor field info air.nc --scene hot_cylinder -D beta=30 -o air.png\n\n"
    "    virtual-sensor field info --scene mine.xml\n\n"
    "    virtual-sensor field info swaying.nc --time 2.5 --json air.json"
)
def info(
    field: Annotated[
        Path | None,
        typer.Argument(
            metavar="FIELD",
            help="A field file, NetCDF, or one that is installed: hot_cylinder_900C_quarter,"
            " hot_cylinder_1100C_quarter, hot_cylinder_1250C_quarter. By default the scene's.",
            show_default=False,
        ),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            help="Scene whose light passes through the field: a file, or one that is installed. By"
            " default hot_cylinder, left out where it does not suit."
        ),
    ] = None,
    define: shared.Definitions = None,
    camera: shared.Camera = None,
    source: shared.Source = None,
    y: shared.ProbeRays = None,
    time: Annotated[
        float | None, typer.Option(help="Flow time, s, of a field with many; by default the last.")
    ] = None,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="Picture (.png, .svg, .pdf) of three cuts and of the image's shift; the page is"
            " written beside it: air.html beside air.png.",
        ),
    ] = None,
    figures: Annotated[
        Path | None, typer.Option("--json", help="File for every figure, for programs.")
    ] = None,
    overwrite: shared.Overwrite = False,
) -> None:
    """Show what a field holds, what it does to light, and whether border and grid are sound."""
    from virtual_sensor.reporting import field as words
    from virtual_sensor.studies.field_info import field_info

    if not (field or scene):
        raise InputError("name a FIELD, or a --scene that has one")

    if output:
        shared.check_suffix(output, words.PICTURES, "the picture")
        check_output(words.page_beside(output), overwrite)
        check_output(output, overwrite)
    if figures:
        shared.check_suffix(figures, (".json",), "what a program reads", "--json")
        check_output(figures, overwrite)
    with shared.reporting("reading the field") as report:
        found = field_info(
            field, scene, shared.definitions(define), time, report, y or None, camera, source
        )
        if output or figures:
            report("writing the results", 0.8)
            words.save(found, shared.command_line(), output, figures)
    shared.print_results([*words.tables(found), *words.verdicts(found)], found.notes)
    files = [f"figures in {figures}"] if figures else []
    if output:
        files += [f"picture in {output}", f"open {words.page_beside(output)} first"]
    shared.print_time(", ".join(files) or "-o draws a picture and writes a page")


@app.command(
    name="import",
    epilog="Examples:\n\n"
    "    virtual-sensor field import case/ --variable T --mirror x,y -o air.nc\n\n"
    "    virtual-sensor field import air.vtu --units K --length-units m --axes x,-z,y -o air.nc\n\n"
    "    virtual-sensor field import air.txt --origin 0,0,13.5 --solid cylinder:13.5 -o air.nc\n\n"
    "    virtual-sensor field import plane.csv --axes z,x,y --extrude -180,180 -o air.nc\n\n"
    "    virtual-sensor field import n.npy --quantity index --spacing 0.8 -o air.nc",
)
@shared.with_options
def import_(
    source: Annotated[
        Path,
        typer.Argument(
            metavar="FILE",
            help="An OpenFOAM case; VTK (.vti .vtk .vtp .vtr .vts .vtu, .pvti .pvtr .pvts .pvtu); "
            "COMSOL's text export; .csv with a header row; NumPy's .npy, .npz.",
        ),
    ],
    output: Annotated[Path, typer.Option("-o", "--output", help="Field file, NetCDF.")] = Path(
        "field.nc"
    ),
    *,
    said: Choices,
    overwrite: shared.Overwrite = False,
) -> None:
    """Import another solver's field, onto a regular grid and into the world's frame.

    OpenFOAM, VTK and scattered points need `pip install 'virtual-sensor[fields]'`.
    """
    from virtual_sensor.medium.netcdf import write_quantity
    from virtual_sensor.reporting.new_fields import imported, written

    shared.check_suffix(output, FIELD_FILES, "a field")
    check_output(output, overwrite)
    if said.spacing_mm and len(said.spacing_mm) == 1:
        said = replace(said, spacing_mm=(*said.spacing_mm,) * 3)
    with shared.reporting("reading") as report:
        made = import_field(source, said, shared.command_line(), report)
        report("writing", 0.95)
        # Of n - 1 nobody knows how many digits count; those of a temperature in 16 bits do.
        write_quantity(output, made.quantity, packed=made.quantity.kind != "refractivity")
    shared.print_results([f"  {line}" for line in imported(made)], made.notes)
    shared.print_time(written(output))
