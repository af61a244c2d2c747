"""The commands `virtual-sensor field info` and `field import`."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.files import check_output

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
    "    virtual-sensor field info air.nc --scene hot_cylinder -D beta=30 -o air.png\n\n"
    "    virtual-sensor field info swaying.nc --time 2.5 --json air.json"
)
def info(
    field: Annotated[Path, typer.Argument(metavar="FIELD", help="A field file, NetCDF.")],
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


@dataclass(frozen=True)
class ImportOptions:
    """What a user says about a file that is imported: `Choices`, as texts.

    Attributes
    ----------
    variable : str, optional
        Which variable; by default the only one that suits.
    quantity : str, optional
        temperature, density, refractivity (n - 1) or index (n); by default what the variable's
        name or units say.
    units : str, optional
        K, degC, kg/m3 or g/cm3, if the file does not say.
    length_units : str, optional
        m, cm or mm, if the file does not say.
    axes : str
        Axes of the file that become the world's x, y, z: x,-y,z or y,z,x.
    origin_mm : str
        Point of the file, mm along its axes, that becomes the world's origin: the middle of the
        part's top line.
    scale : float
        Factor on all lengths.
    mirror : str, optional
        Axes about whose planes through 0 the field is even, such as x,y.
    box_mm : str, optional
        Extent x0,x1,y0,y1,z0,z1 of the field, mm; by default the data's.
    spacing_mm : str, optional
        Distance of nodes, mm, one number or three; by default the data's own, or their median. Of
        a plain .npy array its own.
    extrude_mm : str, optional
        From where to where along x a cross-section holds, mm.
    solid : str
        What has no air: auto (an enclosed gap in the data), enclosed (several), none, or
        cylinder:RADIUS[,LENGTH] in mm, along x under the origin.
    ambient : float, optional
        Value in the surrounding air, in the variable's units; else 20 °C.
    pressure_pa : float, optional
        Air pressure, Pa, with a temperature; else 101325.
    time_s : float, optional
        Flow time, s, of a file with many; by default the last.
    region : str, optional
        Of an OpenFOAM case of several; by default the only fluid.
    """

    variable: str | None = None
    quantity: str | None = None
    units: str | None = None
    length_units: str | None = None
    axes: str = "x,y,z"
    origin_mm: str = "0,0,0"
    scale: float = 1.0
    mirror: str | None = None
    box_mm: str | None = None
    spacing_mm: str | None = None
    extrude_mm: str | None = None
    solid: str = "auto"
    ambient: float | None = None
    pressure_pa: float | None = None
    time_s: float | None = None
    region: str | None = None


@app.command(
    name="import",
    epilog="Examples:\n\n"
    "    virtual-sensor field import case/ --variable T --mirror x,y -o air.nc\n\n"
    "    virtual-sensor field import air.vtu --units K --length-units m --axes x,-z,y -o air.nc\n\n"
    "    virtual-sensor field import air.txt --origin 0,0,13.5 --solid cylinder:13.5 -o air.nc\n\n"
    "    virtual-sensor field import plane.csv --axes z,x,y --extrude -120,120 -o air.nc\n\n"
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
    said: ImportOptions,
    overwrite: shared.Overwrite = False,
) -> None:
    """Import another solver's field, onto a regular grid and into the world's frame.

    OpenFOAM, VTK and scattered points need `pip install 'virtual-sensor[fields]'`.
    """
    from virtual_sensor.medium.imports.import_field import Choices, import_field
    from virtual_sensor.medium.netcdf import write_quantity
    from virtual_sensor.reporting.new_fields import imported, written

    shared.check_suffix(output, FIELD_FILES, "a field")
    check_output(output, overwrite)
    spacing = shared.numbers("--spacing", said.spacing_mm, 1, 3)
    numbers = {
        "origin_mm": shared.numbers("--origin", said.origin_mm, 3),
        "box_mm": shared.numbers("--box", said.box_mm, 6),
        "spacing_mm": spacing * 3 if spacing and len(spacing) == 1 else spacing,
        "extrude_mm": shared.numbers("--extrude", said.extrude_mm, 2),
    }
    mirror = said.mirror.replace(" ", "").split(",") if said.mirror else ()
    choices = Choices(**vars(said) | numbers | {"mirror": mirror})
    with shared.reporting("reading") as report:
        made = import_field(source, choices, shared.command_line(), report)
        report("writing", 0.95)
        # Of n - 1 nobody knows how many digits count; those of a temperature in 16 bits do.
        write_quantity(output, made.quantity, packed=made.quantity.kind != "refractivity")
    shared.print_results([f"  {line}" for line in imported(made)], made.notes)
    shared.print_time(written(output))
