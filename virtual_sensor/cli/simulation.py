"""The commands `virtual-sensor field simulate` and `field convergence`, which need OpenFOAM."""

import sys
from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.cli.field import FIELD_FILES, app
from virtual_sensor.errors import InputError
from virtual_sensor.files import check_output
from virtual_sensor.medium.heat_flow.openfoam import available_processes
from virtual_sensor.medium.heat_flow.setup import HeatFlow, Until

GOES_ON = "the simulated flow stays, and the same command goes on"


@dataclass(frozen=True)
class RunOptions:
    """When a simulation ends, and what is saved of it.

    Attributes
    ----------
    coarse : bool
        Accept a mesh that does not resolve the wall layer.
    grid_mm : tuple of three float, optional
        Distance of the field's nodes along x, y, z, mm; by default 3,0.5,1.25, and for another
        part as fine as 2 MB hold.
    time_s : float, optional
        Flow time at which it ends at the latest, s; by default 15, quick: as suits.
    at_least_s : float
        Flow time before which it does not end, s.
    steady_px_per_s : float
        It ends when the scene's probe rays move by less than this, px per s of flow.
    record_s : float
        Write the last so many seconds of flow as a time axis.
    every_s : float, optional
        Flow time between saved instants, s; by default 0.25, unsteady 0.05.
    """

    coarse: bool = False
    grid_mm: tuple[float, float, float] | None = field(default=None, metadata={"counts": (3,)})
    time_s: float | None = None
    at_least_s: float = 2.0
    steady_px_per_s: float = 0.05
    record_s: float = 0.0
    every_s: float | None = None


@app.command(
    epilog="Examples:\n\n"
    "    virtual-sensor field simulate --scene mine.xml --quick\n\n"
    "    virtual-sensor field simulate --scene mine.xml --cell 2 --coarse --processes 2 -o air.nc"
    "\n\n"
    "    virtual-sensor field simulate --section -o section.nc\n\n"
    "    virtual-sensor field simulate --temperature 1100 --processes 2 -o hot_1100.nc\n\n"
    "    virtual-sensor field simulate --section --whole --unsteady --time 3 --record 1 -o sway.nc"
    "\n\n"
    "    virtual-sensor field simulate --stl part.stl --cell 2 --coarse -o part.nc"
)
@shared.with_options
def simulate(
    context: typer.Context,
    output: Annotated[
        Path | None,
        typer.Option(
            "-o",
            "--output",
            help="NetCDF file for the field; by default the one in which the scene looks for its"
            " air, or else NAME_air.nc beside it.",
        ),
    ] = None,
    case: Annotated[
        Path | None,
        typer.Option(help="Folder of the OpenFOAM case; by default beside the field, .case."),
    ] = None,
    *,
    flow: HeatFlow,
    asked: RunOptions,
    temperature: Annotated[
        float | None,
        typer.Option(
            help="Of the part's surface, degC; held constant after a ramp of 0.25 s. By default the"
            " scene's parameter temperature, without a scene 1250."
        ),
    ] = None,
    cell: Annotated[
        float | None,
        typer.Option(
            help="Width of a mesh cell across the plume, mm; all others scale with it. By default"
            " 0.8, quick: as suits the part."
        ),
    ] = None,
    processes: Annotated[
        int | None,
        typer.Option(min=1, help="Processes of the solver, by MPI; by default 1, quick: 2 to 4."),
    ] = None,
    scene: Annotated[
        str | None,
        typer.Option(
            help="Scene whose part the air is of, and whose probe rays show whether the flow is"
            " steady: a file, or one that is installed. Without one, a cylinder."
        ),
    ] = None,
    define: shared.Definitions = None,
    camera: shared.Camera = None,
    source: shared.Source = None,
    overwrite: shared.Overwrite = False,
) -> None:
    """Simulate the air round a hot part with OpenFOAM, until its effect on light is steady.

    Stopped by Ctrl-C or killed, the same command goes on where it was.
    """
    from virtual_sensor.reporting.new_fields import simulated, written
    from virtual_sensor.studies.notes import without_options
    from virtual_sensor.studies.scene_air import scene_air
    from virtual_sensor.studies.simulate import simulate as run

    if output:
        shared.check_suffix(output, FIELD_FILES, "a field")
        check_output(output, overwrite)
    if scene and any(_is_given(context, name) for name in ("radius", "length")):
        raise InputError(
            "--radius and --length are of a cylinder, and the scene's part is simulated; leave them"
            " out, or --scene"
        )
    with shared.reporting("preparing the case", GOES_ON) as report:
        air = scene_air(scene, shared.definitions(define), flow, temperature, camera, source)
        field = output or (air.output if scene else None)
        if not field:
            raise InputError("name the field's file with -o, such as -o air.nc")
        check_output(field, overwrite)
        result = run(
            air,
            case or field.with_suffix(".case"),
            field,
            _until(asked, flow.quick),
            cell_mm=cell,
            spacing_mm=asked.grid_mm,
            coarse=asked.coarse,
            record_s=asked.record_s,
            every_s=asked.every_s or (0.05 if flow.unsteady else 0.25),
            processes=processes or (available_processes() if flow.quick else 1),
            history=shared.command_line(),
            report=report,
        )
    own = without_options(["virtual-sensor", *sys.argv[1:]], "-o", "--output", "--case", "--cell")
    shared.print_results([f"  {line}" for line in simulated(result, own)], result.notes)
    measured = None
    if scene:
        there = {} if field == air.field else {"field": f"{field}"}
        set_to = [f"{name}={value}" for name, value in (air.parameters | there).items()]
        measured = [
            "virtual-sensor",
            "measure",
            scene,
            *(w for each in set_to for w in ("-D", each)),
        ]
    shared.print_time(written(field, measured))


def _is_given(context: typer.Context, name: str) -> bool:
    """Whether an option was given, and is not at its default."""
    source = context.get_parameter_source(name)
    return source is not None and source.name == "COMMANDLINE"


def _until(asked: RunOptions, quick: bool) -> Until | None:
    """When it ends; a first look at one time, whatever still moves."""
    if quick:
        return Until(asked.time_s, asked.time_s, 0.0) if asked.time_s else None
    end = 15.0 if asked.time_s is None else asked.time_s
    return Until(end, min(asked.at_least_s, end), asked.steady_px_per_s)


@app.command(
    epilog="Examples:\n\n"
    "    virtual-sensor field convergence -o convergence\n\n"
    "    virtual-sensor field convergence --temperature 900 -o convergence_900"
)
def convergence(
    output: shared.Folder = Path("convergence"),
    temperature: Annotated[float, typer.Option(help="Of the cylinder, degC.")] = 1250.0,
    cases: Annotated[
        Path | None, typer.Option(help="Folder of the OpenFOAM cases; by default OUTPUT.cases.")
    ] = None,
    overwrite: shared.Overwrite = False,
) -> None:
    """Show how mesh, flow time and grid of the air's field change what is measured.

    Some minutes; stopped, the same command goes on.
    """
    from virtual_sensor.reporting.convergence import outcome, save
    from virtual_sensor.studies.convergence import convergence as run

    shared.check_folder(output, overwrite)
    folder = cases or output.with_name(f"{output.name}.cases")
    with shared.reporting("preparing the cases", GOES_ON) as report:
        result = run(folder, temperature, report=report)
        save(result, output, shared.command_line(), overwrite)
    shared.print_results(outcome(result), result.notes)
    shared.print_end(output)
