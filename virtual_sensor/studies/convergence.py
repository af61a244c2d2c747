"""Convergence of the air's field: mesh, flow time and grid against what the sensor then sees.

Sections across an endless cylinder are simulated on meshes of several widths, and sampled after
several flow times on several grids. What counts is the change of the line in the image and of the
points measured from it, against the finest of all.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.medium.heat_flow.mesh import cylinder_mesh
from virtual_sensor.medium.heat_flow.prepare import prepare_case
from virtual_sensor.medium.heat_flow.run import run_case
from virtual_sensor.medium.heat_flow.sample import SampleGrid, sample
from virtual_sensor.medium.heat_flow.saved import series
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.imports.meshes import pyvista
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.metrology.deviation import UM_PER_MM, euclidean
from virtual_sensor.metrology.triangulation import error_um, triangulate
from virtual_sensor.metrology.truth import TrueLine, compare_line
from virtual_sensor.optics.ray_search import FoundPixels, ray_search
from virtual_sensor.records import Record
from virtual_sensor.studies.correct.scene_part import ScenePart
from virtual_sensor.studies.probes import DENSE_RAYS, probe_rays
from virtual_sensor.studies.provenance import MadeWith, made_with
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
class Setting(Record):
    """How finely a field is made.

    Attributes
    ----------
    cell_mm : float
        Width of a mesh cell across the plume.
    time_s : float
        Flow time.
    grid_y_mm, grid_z_mm : float
        Distance of the field's nodes.
    """

    cell_mm: float
    time_s: float
    grid_y_mm: float
    grid_z_mm: float

    @property
    def grid_mm(self) -> tuple[float, float]:
        """Distances of nodes along y and z."""
        return self.grid_y_mm, self.grid_z_mm


SHIPPED = Setting(0.8, 4.0, 0.5, 1.25)
"""What the shipped fields were made with."""


@dataclass(frozen=True)
class Change(Setting):
    """What a setting changes against the finest one.

    Attributes
    ----------
    line_px, line_rms_px : float
        Of the line across itself, at equal columns: at most, and root mean square.
    rays_px : float
        Of the probe rays' pixels, in both axes, at most.
    points_um : float
        Of the points measured on the line, at most.
    left_surface_um, left_points_um : float
        Of a line that is seen through the finest air and corrected through this one: the points'
        distance from the part's surface, and from the points that were lit, at most.
    solver_s : float
        Solver's time on one core, from the start to this flow time.
    cells : int
        Of the mesh.
    file_mb : float
        Size of a three-dimensional field on this grid.
    """

    line_px: float
    line_rms_px: float
    rays_px: float
    points_um: float
    left_surface_um: float
    left_points_um: float
    solver_s: float
    cells: int
    file_mb: float

    @property
    def setting(self) -> Setting:
        """The setting alone."""
        return Setting(self.cell_mm, self.time_s, self.grid_y_mm, self.grid_z_mm)


@dataclass(frozen=True)
class Coarsest(Record):
    """The coarsest setting whose line stays within a bound of the finest one's.

    Attributes
    ----------
    bound_px : float
        Allowed change of the line's centres.
    change : Change or None
        The quickest run, and of these the smallest file; None if none stays within it.
    """

    bound_px: float
    change: Change | None


@dataclass(frozen=True)
class Convergence(Record):
    """The study; its changes are the rows of a table of their own.

    Attributes
    ----------
    temperature_c : float
        Of the cylinder.
    reference : Setting
        The finest, which the others are compared with.
    coarsest : tuple of Coarsest
        For each of `BOUNDS_PX`.
    shipped : Change or None
        Of the shipped fields' setting; None if it is not among them.
    longer_run : Change
        Of the paper's flow time against the reference's, on one mesh.
    made_with : MadeWith
        Engine and versions.
    notes : tuple of str
        What the user should know of the scene that is seen through the air.
    """

    temperature_c: float
    reference: Setting
    coarsest: tuple[Coarsest, ...] = dataclasses.field(init=False)
    shipped: Change | None = dataclasses.field(init=False)
    longer_run: Change
    made_with: MadeWith
    notes: tuple[str, ...]
    # Of all settings, by mesh, time and grid.
    changes: tuple[Change, ...] = dataclasses.field(metadata={"internal": True}, repr=False)

    def __post_init__(self) -> None:
        shipped = next((c for c in self.changes if c.setting == SHIPPED), None)
        chosen = tuple(Coarsest(bound, coarsest(self.changes, bound)) for bound in BOUNDS_PX)
        object.__setattr__(self, "coarsest", chosen)
        object.__setattr__(self, "shipped", shipped)


def coarsest(changes: Sequence[Change], bound_px: float) -> Change | None:
    """The quickest run, then the smallest file, whose line stays within a bound."""
    within = [c for c in changes if c.line_px <= bound_px]
    return min(within, key=lambda c: (c.solver_s, c.file_mb), default=None)


@dataclass(frozen=True)
class Seen(Displayed):
    """What the sensor sees through a field.

    Attributes
    ----------
    line : TrueLine
        By the search along it.
    found : FoundPixels
        That search.
    rays_px : ndarray of shape (N, 2)
        Pixels of the probe rays.
    """

    line: TrueLine
    found: FoundPixels
    rays_px: Array


def convergence(
    folder: Path,
    temperature_c: float = 1250.0,
    cells_mm: Sequence[float] = CELLS_MM,
    times_s: Sequence[float] = TIMES_S,
    grids_mm: Sequence[tuple[float, float]] = GRIDS_MM,
    long: tuple[float, float] = (LONG_CELL_MM, LONG_S),
    report: Report = lambda stage, fraction: None,
) -> Convergence:
    """Simulate all meshes, and compare all settings with the finest.

    Parameters
    ----------
    folder : Path
        Of the cases; those that exist are continued.
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

    settings = [Setting(c, t, *g) for c in cells_mm for t in times_s for g in grids_mm]
    longer = Setting(*long, *grids_mm[-1])
    air, seen = dict[Setting, IndexField](), dict[Setting, Seen]()
    for i, setting in enumerate(wanted := [*settings, longer]):
        report("searching rays through the fields", 0.7 + 0.15 * i / len(wanted))
        flow, case = flows[setting.cell_mm], cases[setting.cell_mm]
        grid = SampleGrid.of(flow, (1.0, *setting.grid_mm))
        air[setting] = as_field(sample(flow, case, (setting.time_s,), grid))
        seen[setting] = seen_through(scene.with_medium(air[setting]))

    def change(setting: Setting, against: Setting) -> Change:
        flow, case = flows[setting.cell_mm], cases[setting.cell_mm]
        grid = SampleGrid.of(flow, (1.0, *setting.grid_mm))
        line, points = compare(scene, seen[setting], seen[against])
        surface, left = corrected(scene, seen[against].found, air[setting])
        moved = euclidean(seen[setting].rays_px - seen[against].rays_px)
        return Change(
            **vars(setting),
            line_px=float(np.abs(line).max()),
            line_rms_px=float(np.sqrt(np.mean(line**2))),
            rays_px=float(np.nanmax(moved)),
            points_um=float(points.max()),
            left_surface_um=float(np.abs(surface).max()),
            left_points_um=float(left.max()),
            solver_s=solver_seconds(case, setting.time_s),
            cells=cylinder_mesh(flow).cells,
            file_mb=2e-6 * NODES_ALONG * len(grid.y) * len(grid.z),
        )

    reference = Setting(cells_mm[-1], times_s[-1], *grids_mm[-1])
    changes = []
    for i, setting in enumerate(settings):
        report("correcting through the fields", 0.85 + 0.15 * i / len(settings))
        changes.append(change(setting, reference))
    report("done", 1.0)
    return Convergence(
        temperature_c,
        reference,
        change(longer, dataclasses.replace(reference, cell_mm=long[0])),
        made_with(scene),
        scene.loading_notes,
        tuple(changes),
    )


def seen_through(scene: Scene) -> Seen:
    """The line and the probe rays, by Newton's search.

    Raises
    ------
    InputError
        If the camera does not see the whole line, once in each column.
    """
    y = np.linspace(-0.5, 0.5, DENSE_RAYS) * scene.sensor.laser.length_mm
    found = ray_search(scene, y, "newton")
    pixel = found.pixel
    known, width = np.isfinite(pixel[:, 0]), scene.sensor.camera.size[0]
    if not (known.all() and (np.diff(pixel[:, 0]) > 0.0).all()):
        raise InputError(f"{scene.path}: the air hides or folds the line; nothing to compare")
    rays = ray_search(scene, probe_rays(scene), "newton").pixel
    return Seen(TrueLine.of_search(pixel, known, width, np.inf), found, rays)


def compare(scene: Scene, seen: Seen, reference: Seen) -> tuple[Array, Array]:
    """Change of the line's rows, px, and of the points measured from them, um; shape (columns,)."""
    moved = compare_line(seen.line.centres(), reference.line)
    return moved.error_px, error_um(scene.sensor, moved)


def corrected(scene: Scene, found: FoundPixels, air: IndexField | None) -> tuple[Array, Array]:
    """Errors (N,) in um of the points of found pixels that are corrected through some air.

    Their distance from the part's surface, positive outside, and from the points that were lit.
    """
    point = triangulate(scene, found.pixel, medium=air)
    surface = ScenePart.of(scene).distance_um(point)
    return surface, UM_PER_MM * euclidean(point - found.laser_point_mm)


def solver_seconds(case: Path, time_s: float) -> float:
    """Time that the solver took on one core up to a flow time, s, over all its runs."""
    times, columns = series(case, "pace")
    spent = np.diff(columns["cpuTime"], prepend=0.0)
    spent[spent < 0.0] = columns["cpuTime"][spent < 0.0]  # the solver was started again
    return float(np.interp(time_s, times, np.cumsum(spent)))
