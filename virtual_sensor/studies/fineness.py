"""How fine must the air's field be?  Mesh, flow time and grid against what the sensor then sees.

Sections across an endless cylinder are simulated on meshes of several widths, looked at after
several flow times and sampled on several grids. What counts is the change of the line in the image
and of the points measured from it, against the finest of all.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.medium.heat_flow.mesh import cylinder_mesh
from virtual_sensor.medium.heat_flow.prepare import prepare_case
from virtual_sensor.medium.heat_flow.run import run_case
from virtual_sensor.medium.heat_flow.sample import SampleGrid, sample
from virtual_sensor.medium.heat_flow.saved import series
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.imports.meshes import pyvista
from virtual_sensor.metrology.deviation import euclidean
from virtual_sensor.metrology.triangulation import error_um
from virtual_sensor.metrology.truth import TrueLine, compare_line
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.studies.probes import DENSE_RAYS, probe_rays
from virtual_sensor.studies.simulate import as_field

Array = NDArray[np.float64]
Report = Callable[[str, float], None]

CELLS_MM = (3.0, 2.0, 1.2, 0.8, 0.5)
TIMES_S = (0.5, 1.0, 2.0, 4.0, 6.0)
GRIDS_MM = ((3.0, 5.0), (1.5, 2.5), (0.75, 1.25), (0.5, 1.25), (0.375, 0.625))
"""Distances of nodes along y and z."""
LONG_S, LONG_CELL_MM = 15.0, 1.2
"""The paper's flow time is tried on one mesh."""
NODES_ALONG = 41
"""Nodes along x of a three-dimensional field, for the size of its file."""
BOUNDS_PX = (0.1, 0.02)


@dataclass(frozen=True)
class Choice:
    """Mesh, flow time and grid of one field: cell width, s, distances of nodes along y and z."""

    cell_mm: float
    time_s: float
    grid_mm: tuple[float, float]


SHIPPED = Choice(0.8, 4.0, (0.5, 1.25))
"""What the fields that come along were made with."""


@dataclass(frozen=True)
class Change:
    """What a choice changes against the finest one.

    Attributes
    ----------
    choice : Choice
    line_px, line_rms_px : float
        Of the line across itself, at equal columns: at most, and root mean square.
    rays_px : float
        Of the probe rays' pixels, in both axes, at most.
    points_um : float
        Of the points measured on the line, at most.
    run_s : float
        Solver's time on one core, from the start to this flow time.
    cells : int
        Of the mesh.
    file_mb : float
        Size of a three-dimensional field on this grid.
    """

    choice: Choice
    line_px: float
    line_rms_px: float
    rays_px: float
    points_um: float
    run_s: float
    cells: int
    file_mb: float


@dataclass(frozen=True)
class Fineness:
    """The study.

    Attributes
    ----------
    temperature_c : float
    reference : Choice
        The finest, which the others are compared with.
    changes : list of Change
        Of all choices, by mesh, time and grid.
    long : Change
        Of the paper's flow time against the reference's, on the mesh of `LONG_CELL_MM`.
    notes : tuple of str
        What the user should know of the scene that looks through the air.
    """

    temperature_c: float
    reference: Choice
    changes: list[Change]
    long: Change
    notes: tuple[str, ...] = ()

    def change(self, cell_mm: float, time_s: float, grid_mm: tuple[float, float]) -> Change:
        """The change that one choice makes."""
        return next(c for c in self.changes if c.choice == Choice(cell_mm, time_s, grid_mm))

    def coarsest(self, bound_px: float) -> Change | None:
        """The quickest run, then the smallest file, whose line keeps within a bound."""
        kept = [c for c in self.changes if c.line_px <= bound_px]
        return min(kept, key=lambda c: (c.run_s, c.file_mb), default=None)


@dataclass(frozen=True)
class Seen:
    """What the sensor sees through a field.

    Attributes
    ----------
    line : TrueLine
        By the search along it.
    rays_px : ndarray of shape (9, 2)
        Pixels of the probe rays.
    """

    line: TrueLine
    rays_px: Array


def fineness(
    folder: Path,
    temperature_c: float = 1250.0,
    cells_mm: Sequence[float] = CELLS_MM,
    times_s: Sequence[float] = TIMES_S,
    grids_mm: Sequence[tuple[float, float]] = GRIDS_MM,
    long: tuple[float, float] = (LONG_CELL_MM, LONG_S),
    report: Report = lambda stage, fraction: None,
) -> Fineness:
    """Simulate all meshes, and compare all choices with the finest.

    Parameters
    ----------
    folder : Path
        Of the cases; those that are there are gone on with.
    temperature_c : float
        Of the cylinder, degC.
    cells_mm, times_s, grids_mm : sequence
        Widths of cells, flow times and distances of nodes, each from the coarsest to the finest.
    long : tuple of float
        Cell width, one of `cells_mm`, and flow time of one longer run.

    Raises
    ------
    InputError
        If OpenFOAM or PyVista is missing, or a run fails.
    """
    pyvista()  # not missed only after the simulations
    scene = load_scene("hot_cylinder")
    flows = {c: HeatFlow(temperature_c, section=True, cell_mm=c) for c in cells_mm}
    cases = {c: folder / f"section_{temperature_c:g}C_{c:g}mm" for c in cells_mm}
    # The time of a run goes with the cells, and finer ones take shorter steps.
    weight = np.cumsum([0.0, *(c**-2.5 for c in cells_mm)])
    share = 0.7 * weight / weight[-1]
    for i, (c, flow) in enumerate(flows.items()):
        end_s = long[1] if c == long[0] else times_s[-1]
        prepare_case(flow, cases[c], end_s, 0.25)
        run_case(
            cases[c],
            end_s,
            report=lambda p, c=c, i=i: report(  # type: ignore[misc]
                f"mesh of {c:g} mm: {p.time_s:.2f} s of flow",
                share[i] + (share[i + 1] - share[i]) * p.time_s / p.end_s,
            ),
        )

    choices = [Choice(c, t, g) for c in cells_mm for t in times_s for g in grids_mm]
    wanted = [*choices, Choice(*long, grids_mm[-1])]
    seen = {}
    for i, choice in enumerate(wanted):
        report("looking through the fields", 0.7 + 0.3 * i / len(wanted))
        grid = SampleGrid.of(flows[choice.cell_mm], (1.0, *choice.grid_mm))
        case = cases[choice.cell_mm]
        air = sample(flows[choice.cell_mm], case, (choice.time_s,), grid)
        seen[choice] = look(scene.with_medium(as_field(air)))

    def change(choice: Choice, against: Choice) -> Change:
        flow = flows[choice.cell_mm]
        grid = SampleGrid.of(flow, (1.0, *choice.grid_mm))
        line, points = compare(scene, seen[choice], seen[against])
        moved = euclidean(seen[choice].rays_px - seen[against].rays_px)
        return Change(
            choice,
            float(np.abs(line).max()),
            float(np.sqrt(np.mean(line**2))),
            float(np.nanmax(moved)),
            float(points.max()),
            solver_seconds(cases[choice.cell_mm], choice.time_s),
            cylinder_mesh(flow).cells,
            2e-6 * NODES_ALONG * len(grid.y) * len(grid.z),
        )

    reference = Choice(cells_mm[-1], times_s[-1], grids_mm[-1])
    report("done", 1.0)
    return Fineness(
        temperature_c,
        reference,
        [change(choice, reference) for choice in choices],
        change(Choice(*long, grids_mm[-1]), Choice(long[0], times_s[-1], grids_mm[-1])),
        scene.notes,
    )


def look(scene: Scene) -> Seen:
    """The line and the probe rays, by Newton's search.

    Raises
    ------
    InputError
        If the camera does not see the whole line, once in each column.
    """
    y = np.linspace(-0.5, 0.5, DENSE_RAYS) * scene.sensor.laser.length_mm
    pixel = ray_search(scene, y, "newton").pixel
    known, width = np.isfinite(pixel[:, 0]), scene.sensor.camera.size[0]
    if not (known.all() and (np.diff(pixel[:, 0]) > 0.0).all()):
        raise InputError(f"{scene.path}: the air hides or folds the line; nothing to compare")
    rays = ray_search(scene, probe_rays(scene), "newton").pixel
    return Seen(TrueLine.of_search(pixel, known, width, np.inf), rays)


def compare(scene: Scene, seen: Seen, reference: Seen) -> tuple[Array, Array]:
    """Change of the line's rows, px, and of the points measured from them, um; shape (columns,)."""
    moved = compare_line(seen.line.centres(), reference.line)
    return moved.error_px, error_um(scene.sensor, moved)


def solver_seconds(case: Path, time_s: float) -> float:
    """Time that the solver took on one core up to a flow time, s, over all its runs."""
    times, columns = series(case, "pace")
    spent = np.diff(columns["cpuTime"], prepend=0.0)
    spent[spent < 0.0] = columns["cpuTime"][spent < 0.0]  # the solver was started anew
    return float(np.interp(time_s, times, np.cumsum(spent)))
