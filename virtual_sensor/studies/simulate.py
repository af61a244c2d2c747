"""Simulate the air round a hot part, until its effect on light is steady, and write the field."""

from __future__ import annotations

import json
from collections.abc import Callable
from contextlib import ExitStack
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from importlib import metadata
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.files import scratch_folder
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.heat_flow import saved
from virtual_sensor.medium.heat_flow.balance import (
    HeatBalance,
    check_wall_layer,
    heat_balance,
    nusselt_number,
    wall_cells,
)
from virtual_sensor.medium.heat_flow.openfoam import OpenFoam, find_openfoam
from virtual_sensor.medium.heat_flow.prepare import prepare_case, setup_of
from virtual_sensor.medium.heat_flow.quick import QUICK_HEIGHT_MM, quick_cell_mm, quick_time_s
from virtual_sensor.medium.heat_flow.run import Progress, RunEnd, run_case
from virtual_sensor.medium.heat_flow.sample import SampleGrid, sample
from virtual_sensor.medium.heat_flow.setup import HeatFlow, Until
from virtual_sensor.medium.heat_flow.snapped_mesh import ROOM_MM, read_part
from virtual_sensor.medium.imports.meshes import pyvista
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import GriddedQuantity, write_quantity
from virtual_sensor.studies.field_info import searched_pixels
from virtual_sensor.studies.probes import probe_rays
from virtual_sensor.studies.scene_air import SceneAir

if TYPE_CHECKING:
    from trimesh import Trimesh

Array = NDArray[np.float64]
Report = Callable[[str, float], None]

CHECK_S = 0.25
"""Flow time between two checks of whether the effect on light is steady."""

BALANCE_S = {False: 0.25, True: 0.5}
"""Flow time over which heat is balanced; a first look's long steps make few records."""


@dataclass(frozen=True)
class Simulation(Displayed):
    """A finished simulation.

    Attributes
    ----------
    end : RunEnd
    balance : HeatBalance
        Of the last quarter of a second, of a first look half a second.
    nusselt : float
        Mean Nusselt number of a cylinder, by air of film temperature; NaN of another part.
    wall_layer_cells : int
        Cells of the mesh in the wall layer.
    drift_px_per_s : float
        How fast the probe rays' pixels still moved in the end; NaN where it was not searched.
    cell_mm : float
        Width of a mesh cell across the plume, mm.
    quick : bool
        Whether it was a first look.
    notes : tuple of str
        What the user should know of the scene whose rays were followed.
    """

    end: RunEnd
    balance: HeatBalance
    nusselt: float
    wall_layer_cells: int
    drift_px_per_s: float
    cell_mm: float
    quick: bool = False
    notes: tuple[str, ...] = ()


@dataclass
class Steadiness:
    """Watches how fast the probe rays' pixels move while the flow develops."""

    scene: Scene
    until: Until
    sampled: Callable[[float], GriddedQuantity]
    drift_px_per_s: float = np.nan
    _last: tuple[float, Array] | None = field(default=None, repr=False)
    _probes: Array = field(init=False, repr=False)

    def __post_init__(self) -> None:
        self._probes = probe_rays(self.scene)

    def __call__(self, time_s: float) -> bool:
        """Whether the flow may end at this saved time."""
        if self.until.steady_px_per_s <= 0.0:
            return False
        if time_s < self.until.at_least_s - CHECK_S - 1e-6:
            return False
        if self._last and time_s - self._last[0] < CHECK_S - 1e-6:
            return False
        self._search(time_s)
        steady = self.drift_px_per_s < self.until.steady_px_per_s
        return steady and time_s >= self.until.at_least_s - 1e-6

    def look_back(self, times_s: list[float]) -> None:
        """Find the drift at the end of a run in which it was not searched."""
        earlier = [t for t in times_s if 0.0 < t <= times_s[-1] - CHECK_S + 1e-6]  # not the start
        if np.isnan(self.drift_px_per_s) and earlier:
            self._last = None
            self._search(earlier[-1])
            self._search(times_s[-1])

    def _search(self, time_s: float) -> None:
        pixel = searched_pixels(self.scene, self._probes, as_field(self.sampled(time_s)))
        if self._last:
            before_s, before = self._last
            moved = np.linalg.norm(pixel - before, axis=1)
            if np.isfinite(moved).any():
                self.drift_px_per_s = float(np.nanmax(moved)) / (time_s - before_s)
        self._last = (time_s, pixel)


def simulate(
    air: SceneAir,
    case: Path,
    output: Path,
    until: Until | None = None,
    *,
    cell_mm: float | None = None,
    spacing_mm: tuple[float, float, float] | None = None,
    coarse: bool = False,
    record_s: float = 0.0,
    every_s: float = CHECK_S,
    processes: int = 1,
    history: str = "",
    report: Report = lambda stage, fraction: None,
) -> Simulation:
    """Simulate, continuing a case that exists, and write the field at the end.

    Parameters
    ----------
    air : SceneAir
        The part, its air, and the scene whose probe rays show whether the flow is steady.
    case, output : Path
        Folder of the OpenFOAM case; NetCDF file of the field.
    until : Until, optional
        When it ends. A flow that is `unsteady`, and one that is recorded, ends at `at_most_s`. By
        default a first look ends when a plume like it has come to stand.
    cell_mm : float, optional
        Width of a mesh cell across the plume, mm; by default the flow's own, of a first look as
        suits the part.
    spacing_mm : tuple of three float, optional
        Distance of the field's nodes, mm.
    coarse : bool
        Accept a mesh that does not resolve the wall layer.
    record_s : float
        The field gets the instants of so many last seconds as a time axis; 0: the last one only.
    every_s : float
        Flow time between saved instants, s.
    processes : int
        Of the solver, by MPI.
    history : str
        The command, for the file's attributes.

    Raises
    ------
    InputError
        If OpenFOAM or PyVista is missing, the folder holds something else, the mesh does not
        resolve the wall layer, or the run fails; the times before that stay.
    Interrupted
        If it was stopped; the same command goes on.
    """
    with ExitStack() as stack:
        flow = air.flow
        if air.part is not None:
            folder = stack.enter_context(scratch_folder())
            flow = replace(flow, stl=_written(air.part, folder, air.scene.path))
        flow, until = _first_look(flow, until, cell_mm)
        grid = SampleGrid.of(flow, spacing_mm)
        if not (coarse or flow.quick):
            check_wall_layer(flow)
        foam = _openfoam(processes > 1)
        pyvista()  # not missed only after hours of computing
        scene = air.scene
        steadiness = Steadiness(scene, until, lambda time_s: sample(flow, case, (time_s,), grid))
        prepare_case(flow, case, until.at_most_s, every_s, processes)
        part_cells = wall_cells(flow) if flow.stl else None
    moving = flow.unsteady or record_s > 0.0

    def solving(progress: Progress) -> None:
        left = progress.seconds_left
        rest = "" if left is None else f", {duration(left)} left at most"
        text = f"{progress.stage}: {progress.time_s:.3f} s of flow{rest}"
        report(text, 0.95 * progress.time_s / progress.end_s)

    end = run_case(
        case,
        until.at_most_s,
        processes=processes,
        report=solving,
        stop=(lambda time_s: False) if moving else steadiness,
    )
    report("writing the field", 0.95)
    times = [s.time_s for s in saved.times(case)]
    if not moving:
        steadiness.look_back(times)
    # A run that was stopped in between has saved that time as well, off the others' interval.
    even = [t for t in times if abs(t / every_s - round(t / every_s)) < 1e-4]
    written = tuple(t for t in even if t >= end.time_s - record_s - 1e-6) or (end.time_s,)
    balance = heat_balance(case, BALANCE_S[flow.quick])
    nusselt = np.nan if flow.stl else nusselt_number(flow, balance.wall_w)
    cells = wall_cells(flow, nusselt) if part_cells is None else part_cells
    made = Simulation(
        *(end, balance, nusselt, cells, steadiness.drift_px_per_s, flow.cell_mm, flow.quick),
        notes=(*scene.loading_notes, *air.notes),
    )
    attributes = _provenance(flow, made, foam.version) | {
        "parameters": json.dumps(setup_of(case)),
        "history": f"{datetime.now(UTC).isoformat(timespec='seconds')} {history}".strip(),
    }
    write_quantity(output, sample(flow, case, written, grid, attributes))
    report("done", 1.0)
    return made


def _written(part: Trimesh, folder: Path, scene: Path) -> Path:
    """Write a scene's part as an STL file, and check it."""
    stl = folder / f"{scene.stem}.stl"
    part.export(stl)
    try:
        read_part(stl)
    except InputError as error:
        raise InputError(f"{scene}: its part: " + f"{error}".removeprefix(f"{stl}: ")) from None
    return stl


def _first_look(
    flow: HeatFlow, until: Until | None, cell_mm: float | None
) -> tuple[HeatFlow, Until]:
    """How finely and how long, where that is not asked for."""
    if not flow.quick:
        return replace(flow, cell_mm=cell_mm or flow.cell_mm), until or Until()
    part = read_part(flow.stl) if flow.stl else None
    flow = replace(flow, cell_mm=cell_mm or quick_cell_mm(flow, part))
    if until is None:
        height_mm = flow.light_mm[2] - part.low_mm[2] + ROOM_MM if part else QUICK_HEIGHT_MM
        time_s = quick_time_s(flow, height_mm)
        until = Until(time_s, time_s, 0.0)
    return flow, until


def _openfoam(parallel: bool) -> OpenFoam:
    try:
        return find_openfoam(parallel)
    except InputError as error:
        raise InputError(
            f"{error}. Without it: simulate the air in another program and import it"
            " (virtual-sensor field import --help), or take a field that is shipped, of a cylinder"
            " (-D field=hot_cylinder_900C_quarter)"
        ) from None


def as_field(quantity: GriddedQuantity) -> IndexField:
    """The field of a quantity that is in no file yet."""
    with scratch_folder() as folder:
        path = Path(folder) / "field.nc"
        write_quantity(path, quantity)
        return IndexField.read(path)


def duration(seconds: float) -> str:
    """In words."""
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    if hours:
        return f"{hours} h {minutes} min"
    return f"{minutes} min {rest} s" if minutes else f"{rest} s"


def _provenance(flow: HeatFlow, made: Simulation, version: str) -> dict[str, str]:
    """The file's attributes: what it is, how it was made, and how sound it is."""
    part = f"part, {flow.stl.name}" if flow.stl else f"cylinder of {2 * flow.radius_mm:g} mm"
    if not flow.stl:
        part += ", endless" if flow.section else f" x {flow.length_mm:g} mm"
    ours, balance = metadata.version("virtual-sensor"), made.balance
    sound = [f"heat given off {balance.wall_w:.4g} W, carried out {balance.outflow_w:.4g} W"]
    if np.isfinite(made.nusselt):
        sound.append(f"mean Nusselt number {made.nusselt:.3g} by air of film temperature")
    if np.isfinite(made.drift_px_per_s):
        sound.append(f"the probe rays still move by {made.drift_px_per_s:.2g} px per s of flow")
    if made.end.step:
        residuals = made.end.step.residuals.items()
        sound.append(f"last residuals: {', '.join(f'{of} {value:.0e}' for of, value in residuals)}")
    return {
        "title": f"Air temperature round a hot {part}, {flow.temperature_c:g} degC",
        "source": (
            f"OpenFOAM v{version} rhoPimpleFoam by virtual-sensor {ours}: laminar, perfect gas,"
            f" Sutherland air; isothermal wall {flow.temperature_c:g} degC, air"
            f" {flow.ambient_c:g} degC, {flow.pressure_pa:g} Pa; cells of {flow.cell_mm:g} mm"
            f" across the plume; flow time {made.end.time_s:g} s"
        ),
        "comment": "; ".join(sound),
    }
