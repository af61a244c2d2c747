"""The commands `virtual-sensor field simulate` and `field convergence`, which need OpenFOAM."""

from dataclasses import dataclass, field
from pathlib import Path
from typing import Annotated

import typer

from virtual_sensor.cli import shared
from virtual_sensor.cli.field import FIELD_FILES, app
from virtual_sensor.files import check_output
from virtual_sensor.medium.heat_flow.setup import HeatFlow

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
    time_s : float
        Flow time at which it ends at the latest, s.
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
    time_s: float = 15.0
    at_least_s: float = 2.0
    steady_px_per_s: float = 0.05
    record_s: float = 0.0
    every_s: float | None = None


@app.command(
    epilog="Examples:\n\n"
    "    virtual-sensor field simulate --section -o section.nc\n\n"
    "    virtual-sensor field simulate --temperature 1100 --processes 2 -o hot_1100.nc\n\n"
    "    virtual-sensor field simulate --section --whole --unsteady --time 3 --record 1 -o sway.nc"
    "\n\n"
    "    virtual-sensor field simulate --stl part.stl --cell 2 --coarse -o part.nc"
)
@shared.with_options
def simulate(
    output: Annotated[Path, typer.Option("-o", "--output", help="NetCDF file for the field.")],
    case: Annotated[
        Path | None,
        typer.Option(help="Folder of the OpenFOAM case; by default beside the field, .case."),
    ] = None,
    *,
    flow: HeatFlow,
    asked: RunOptions,
    processes: Annotated[int, typer.Option(min=1, help="Processes of the solver, by MPI.")] = 1,
    scene: Annotated[
        str, typer.Option(help="Scene whose probe rays show whether the flow is steady.")
    ] = "hot_cylinder",
    camera: shared.Camera = None,
    source: shared.Source = None,
    overwrite: shared.Overwrite = False,
) -> None:
    """Simulate the air round a hot part with OpenFOAM, until its effect on light is steady.

    Stopped by Ctrl-C or killed, the same command goes on where it was.
    """
    from virtual_sensor.reporting.new_fields import simulated, written
    from virtual_sensor.studies.simulate import Until
    from virtual_sensor.studies.simulate import simulate as run

    shared.check_suffix(output, FIELD_FILES, "a field")
    check_output(output, overwrite)
    with shared.reporting("preparing the case", GOES_ON) as report:
        result = run(
            flow,
            case or output.with_suffix(".case"),
            output,
            Until(asked.time_s, min(asked.at_least_s, asked.time_s), asked.steady_px_per_s),
            spacing_mm=asked.grid_mm,
            coarse=asked.coarse,
            record_s=asked.record_s,
            every_s=asked.every_s or (0.05 if flow.unsteady else 0.25),
            processes=processes,
            scene_name=scene,
            camera=camera,
            source=source,
            history=shared.command_line(),
            report=report,
        )
    shared.print_results([f"  {line}" for line in simulated(result)], result.notes)
    shared.print_time(written(output))


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
