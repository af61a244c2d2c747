"""The whole reproduction: fit the broadening, measure all cases, search the rest, judge."""

from __future__ import annotations

import time
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.studies.finished_cases import own_folder
from virtual_sensor.studies.measure import Report
from virtual_sensor.studies.reproduction.beta_map import BetaMap
from virtual_sensor.studies.reproduction.broadening_fit import Fit
from virtual_sensor.studies.reproduction.curves import (
    BLURRED,
    DOTS,
    LINE,
    RESOLVED,
    SEARCHED,
    WIDENED,
    Curve,
    Curves,
    Setting,
    from_dots,
    from_line,
    read_columns,
)
from virtual_sensor.studies.reproduction.pieces import Shelf, fits, maps, rays, reconstructions
from virtual_sensor.studies.reproduction.reconstruction import Reconstruction, fit_section
from virtual_sensor.studies.reproduction.settings import (
    BETAS_DEG,
    DOT_RADIUS_MM,
    NINE_DOTS,
    NINE_RAYS_MM,
    SCENE,
    TEMPERATURES_C,
    Broadening,
    Scenes,
    settings,
)
from virtual_sensor.studies.reproduction.statements import Verdict, judge
from virtual_sensor.studies.sweep import CaseStatus, Finished, Save, cases, run
from virtual_sensor.studies.sweep_table import table

MARK = "REPRODUCTION.txt"
_MARK_TEXT = """\
The folder of a `virtual-sensor reproduce`. report/ holds the results, measurements/ a sweep, kept/
what was searched. What is finished is kept under a hash of all that went into it: the same command
makes only what is missing.
"""

OPEN = ("spp", "step", "method", "precision")
"""Parameters that a user may set: all others are the paper's, whose numbers hold for its sensor."""


@dataclass(frozen=True)
class Reproduction:
    """Section 5 of the paper, remade.

    Attributes
    ----------
    airs : dict
        The broadening of each air.
    fits : dict
        How it was found, by air.
    curves : Curves
    maps : dict
        Of all poses, by air.
    reconstructions : dict
        Dense scans of the cylinder, searched, by setting.
    sections : dict
        Columns of a table: the cylinders fitted to each rendered line.
    measured : dict
        The sweep's table: one row for each rendered case.
    verdicts : list of Verdict
    made : int
        Cases that were measured now; the others had been kept.
    seconds : float
        That it took.
    """

    airs: dict[str, Broadening]
    fits: dict[str, Fit]
    curves: Curves
    maps: dict[str, BetaMap]
    reconstructions: dict[Setting, Reconstruction]
    sections: dict[str, list[Any]]
    measured: dict[str, Any]
    verdicts: list[Verdict]
    made: int
    seconds: float


def reproduce(
    folder: Path,
    save: Save,
    given: Mapping[str, str] | None = None,
    scheduler: str | None = None,
    report: Report = lambda stage, fraction: None,
) -> Reproduction:
    """Remake section 5 of Beermann et al. 2018 in a folder, or go on with what is kept there.

    Parameters
    ----------
    folder : Path
        New, empty, or an earlier reproduction's.
    save : callable
        Writes a rendered case's results (see `sweep.Save`).
    given : mapping, optional
        Parameters of the scene for all cases; those in `OPEN`.
    scheduler : str, optional
        Of a Dask cluster for the rendered cases, as in `sweep.run`.
    report : callable
        Told what is being done, and which fraction of the whole is.

    Raises
    ------
    InputError
        If a parameter is not open or can't be loaded, the folder is another's, or a case
        can't be measured.
    """
    started = time.perf_counter()
    given = dict(given or {})
    if others := [name for name in given if name not in OPEN]:
        raise InputError(
            f"-D {others[0]}: reproduce takes the paper's set-up, but for {', '.join(OPEN)};"
            " measure or sweep take any"
        )
    scenes = Scenes(given)
    scenes.pose(0.0)  # what can't be loaded is told before anything is written
    own_folder(folder, MARK, _MARK_TEXT)
    shelf = Shelf(folder.absolute() / "kept", scenes)

    def part(first: float, last: float) -> Report:
        return lambda stage, fraction: report(stage, first + (last - first) * fraction)

    found = fits(shelf, part(0.0, 0.1))
    airs = {RESOLVED: Broadening()} | {air: fit.broadening for air, fit in found.items()}
    finished = _measure(folder / "measurements", save, given, airs, scheduler, part(0.1, 0.88))
    nine = rays(shelf, airs, False, part(0.88, 0.92))
    whole = rays(shelf, airs, True, part(0.92, 0.95))
    all_poses = maps(shelf, airs, part(0.95, 0.97))
    scans = reconstructions(shelf, airs, SCANS, part(0.97, 1.0))
    curves = Curves(_all_ways(nine, finished), whole)
    return Reproduction(
        airs,
        found,
        curves,
        all_poses,
        scans,
        _sections(finished, shelf.scenes),
        dict(table(list(finished.values()), folder / "measurements").columns()),
        judge(curves, list(airs)),
        sum(not end.already_there for end in finished.values()),
        time.perf_counter() - started,
    )


SCANS = (
    *(Setting(RESOLVED, t, 0.0) for t in TEMPERATURES_C),
    *(Setting(RESOLVED, TEMPERATURES_C[-1], b) for b in BETAS_DEG[1:]),
    *(Setting(air, TEMPERATURES_C[-1], 0.0) for air in (BLURRED, WIDENED)),
)
"""What is reconstructed densely."""


def rendered_cases() -> list[tuple[Setting, str]]:
    """What is rendered: lines and dots in resolved air, else the dots of figures 7 to 10."""
    return [
        *((setting, LINE) for setting in settings(RESOLVED)),
        *((setting, DOTS) for setting in settings(RESOLVED)),
        *((Setting(air, TEMPERATURES_C[-1], 0.0), DOTS) for air in (BLURRED, WIDENED)),
    ]


def _measure(
    folder: Path,
    save: Save,
    given: Mapping[str, str],
    airs: Mapping[str, Broadening],
    scheduler: str | None,
    report: Report,
) -> dict[tuple[Setting, str], Finished]:
    wanted = rendered_cases()
    planned = cases(
        SCENE,
        [_parameters(setting, way, given, airs[setting.air]) for setting, way in wanted],
        [_name(setting, way) for setting, way in wanted],
        NINE_RAYS_MM.tolist(),
    )
    finished = run(planned, folder, save, scheduler, report)
    if failed := [end for end in finished if end.status is not CaseStatus.OK]:
        raise InputError(f"{failed[0].case.name}: {failed[0].message}")
    return dict(zip(wanted, finished, strict=True))


def _parameters(
    setting: Setting, way: str, given: Mapping[str, str], broadening: Broadening
) -> dict[str, str]:
    named = {"temperature": f"{setting.temperature_c:g}", "beta": f"{setting.beta_deg:g}"}
    dots = {"dots": NINE_DOTS, "line_radius": f"{DOT_RADIUS_MM:g}"} if way == DOTS else {}
    return {**given, **named, **broadening.parameters(), **dots}


def _name(setting: Setting, way: str) -> str:
    what = "dots" if way == DOTS else "line"
    return f"{setting.air}_{setting.temperature_c:g}C_beta{setting.beta_deg:g}_{what}"


def _all_ways(
    nine: Mapping[Setting, Curve], finished: Mapping[tuple[Setting, str], Finished]
) -> dict[tuple[Setting, str], Curve]:
    """The searched curves, and beside them the rendered ones."""
    curves = {(setting, SEARCHED): curve for setting, curve in nine.items()}
    for (setting, way), end in finished.items():
        assert end.folder is not None
        seen = from_dots if way == DOTS else from_line
        curves[setting, way] = seen(nine[setting], end.folder)
    return curves


def _sections(
    finished: Mapping[tuple[Setting, str], Finished], scenes: Scenes
) -> dict[str, list[Any]]:
    """The cylinder through each rendered line, its axis' direction held."""
    rows = []
    for (setting, way), end in finished.items():
        if way != LINE or end.folder is None:
            continue
        part = scenes.pose(setting.beta_deg).surface
        assert isinstance(part, Cylinder)
        for state in ("cold", "hot"):
            line = read_columns(end.folder / f"line_{state}.csv")
            points = np.stack([line[f"point_mm_{axis}"] for axis in "xyz"], axis=1).astype(float)
            fit, interval = fit_section(points)
            rows.append(
                {
                    "air": setting.air,
                    "temperature_c": setting.temperature_c,
                    "beta_deg": setting.beta_deg,
                    "state": state,
                    "points": fit.count,
                    "radius_mm": fit.radius_mm,
                    "radius_error_um": UM_PER_MM * (fit.radius_mm - part.radius_mm),
                    "radius_error_low_um": UM_PER_MM * (interval[0] - part.radius_mm),
                    "radius_error_high_um": UM_PER_MM * (interval[1] - part.radius_mm),
                    "residual_std_um": fit.residual_std_um,
                }
            )
    return {name: [row[name] for row in rows] for name in (rows[0] if rows else ())}


def worst(measured: Mapping[str, Sequence[Any]], columns: Sequence[str]) -> float:
    """The largest of some columns of the sweep's table; NaN where a case has none."""
    return float(np.fmax.reduce([value for name in columns for value in measured[name]]))
