"""The whole reproduction: fit the broadening, measure all cases, search the rest, judge."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.metrology.deviation import UM_PER_MM
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.records import Record
from virtual_sensor.studies.finished_cases import find_or_make, own_folder
from virtual_sensor.studies.measure import Report
from virtual_sensor.studies.provenance import MadeWith, made_with
from virtual_sensor.studies.reproduction.broadening_fit import FAMILIES, Fit, fit_broadening
from virtual_sensor.studies.reproduction.curves import (
    DOTS,
    LINE,
    SEARCHED,
    BySetting,
    Curve,
    Curves,
    from_dots,
    from_line,
    read_columns,
    searched,
)
from virtual_sensor.studies.reproduction.paper import Verdict, judge
from virtual_sensor.studies.reproduction.reconstruction import (
    FittedCylinders,
    Reconstruction,
    fit_section,
    fitted_cylinders,
    reconstruct,
)
from virtual_sensor.studies.reproduction.settings import (
    ALL_BETAS_DEG,
    BETAS_DEG,
    BLURRED,
    DOT_RADIUS_MM,
    LINE_MM,
    NINE_DOTS,
    NINE_RAYS_MM,
    RESOLVED,
    SCAN,
    SCENE,
    TEMPERATURES_C,
    WIDENED,
    Broadening,
    Scenes,
    Setting,
    settings,
)
from virtual_sensor.studies.sweep import CaseStatus, Finished, Save, cases, run
from virtual_sensor.studies.sweep_table import SweepTable, table

Array = NDArray[np.float64]

MARK = "REPRODUCTION.txt"
_MARK_TEXT = """\
The folder of a `virtual-sensor reproduce`. report/ holds the results, measurements/ a sweep,
searches/ what was searched. What is finished lies under a hash of all that went into it: the same
command makes only what is missing.
"""
OPEN = ("spp", "step", "method", "precision")
"""Parameters that a user may set: all others are the paper's, whose numbers hold for its sensor."""
SCANS = (
    *(Setting(RESOLVED, t, 0.0) for t in TEMPERATURES_C),
    *(Setting(RESOLVED, TEMPERATURES_C[-1], b) for b in BETAS_DEG[1:]),
    *(Setting(air, TEMPERATURES_C[-1], 0.0) for air in (BLURRED, WIDENED)),
)
"""What is reconstructed densely."""
_STORED = (np.ndarray, float, str)  # of the values of what is found


@dataclass(frozen=True)
class Agreement(Record):
    """Rendered minus searched, largest of all cases.

    Attributes
    ----------
    line_rms_px : float
        Rms of a line across itself.
    dots_u_px, dots_v_px : float
        Of dots, along and across the line.
    figures_dots_px : float
        Distance of a dot from the searched ray that it is drawn beside, larger of u and v.
    """

    line_rms_px: float
    dots_u_px: float
    dots_v_px: float
    figures_dots_px: float


@dataclass(frozen=True)
class Summary(Record):
    """What a reproduction comes to.

    Attributes
    ----------
    statements : int
        How many statements of the paper are judged.
    met : dict of int
        How many of them each air bears out.
    not_met : dict of sequence of str
        Those that it does not.
    airs : dict of str
        What was done to each air.
    rendered_minus_searched : Agreement
        How well rendered frames and ray search agree.
    paths_minus_whole_px : float
        Largest difference of the sum of the separated paths from the pixel's shift.
    made_now : int
        Cases that were measured now; the others were finished before.
    cases : int
        All of them.
    time_s : float
        That it took.
    notes : sequence of str
        What the reader should know besides.
    made_with : MadeWith
        Engine and versions.
    """

    statements: int
    met: dict[str, int]
    not_met: dict[str, list[str]]
    airs: dict[str, str]
    rendered_minus_searched: Agreement
    paths_minus_whole_px: float
    made_now: int
    cases: int
    time_s: float
    notes: tuple[str, ...]
    made_with: MadeWith


@dataclass(frozen=True)
class Reproduction(Displayed):
    """Section 5 of the paper, remade.

    Attributes
    ----------
    fits : dict
        How the broadening of the airs was found, by air.
    curves : Curves
    reconstructions : dict
        Dense scans of the cylinder, searched, by setting.
    sections : FittedCylinders
        Those through each rendered line.
    measured : SweepTable
        The sweep's table: one row for each rendered case.
    made_now : int
        Cases that were measured now; the others were finished before.
    time_s : float
        That it took.
    """

    fits: dict[str, Fit]
    curves: Curves
    reconstructions: dict[Setting, Reconstruction]
    sections: FittedCylinders
    measured: SweepTable
    made_now: int
    time_s: float

    @property
    def airs(self) -> dict[str, Broadening]:
        """The broadening of each air."""
        return broadenings(self.fits)

    @property
    def cylinders(self) -> FittedCylinders:
        """What was fitted to the dense scans."""
        return fitted_cylinders(self.reconstructions)

    @cached_property
    def verdicts(self) -> list[Verdict]:
        """Whether the curves bear the paper's statements out."""
        return judge(self.curves)

    @cached_property
    def summary(self) -> Summary:
        """What it comes to."""

        def worst(*names: str) -> float:
            values = [getattr(self.measured, name) for name in names]
            return float(np.fmax.reduce(np.concatenate(values)))

        nine, verdicts = self.curves.nine, self.verdicts
        searched = {setting: c for (setting, method), c in nine.items() if method == SEARCHED}
        apart = [
            np.abs(getattr(curve, name) - getattr(searched[setting], name)).max()
            for (setting, method), curve in nine.items()
            for name in ("pixel_cold", "pixel_hot")
            if method == DOTS
        ]
        paths = [np.abs(each.rays().paths_minus_whole_px).max() for each in searched.values()]
        not_met = {
            air: [v.statement.claim for v in verdicts if not v.found[air].met] for air in self.airs
        }
        messages = zip(self.measured.folder, self.measured.message, strict=True)
        return Summary(
            statements=len(verdicts),
            met={air: len(verdicts) - len(others) for air, others in not_met.items()},
            not_met=not_met,
            airs={air: str(broadening) for air, broadening in self.airs.items()},
            rendered_minus_searched=Agreement(
                line_rms_px=worst("cold_line_rms_px", "hot_line_rms_px"),
                dots_u_px=worst("cold_dots_largest_u_px", "hot_dots_largest_u_px"),
                dots_v_px=worst("cold_dots_largest_v_px", "hot_dots_largest_v_px"),
                figures_dots_px=float(max(apart)),
            ),
            paths_minus_whole_px=float(max(paths)),
            made_now=self.made_now,
            cases=len(self.measured.status),
            time_s=self.time_s,
            notes=tuple(f"{Path(at).name}: {message}" for at, message in messages if message),
            made_with=made_with(),
        )


def reproduce(
    folder: Path,
    save: Save,
    given: Mapping[str, str] | None = None,
    scheduler: str | None = None,
    report: Report = lambda stage, fraction: None,
) -> Reproduction:
    """Remake section 5 of Beermann et al. 2018 in a folder, or go on with what is finished there.

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
        Called with what is being done, and which fraction of the whole is.

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
    scenes.pose(0.0)  # what can't be loaded is refused before anything is written
    own_folder(folder, MARK, _MARK_TEXT)
    searches = Searches(folder.absolute() / "searches", scenes)
    part = partial(_share, report)

    fits = searches.fits(part(0.0, 0.1))
    airs = broadenings(fits)
    finished = _measure(folder / "measurements", save, given, airs, scheduler, part(0.1, 0.88))
    nine_rays = partial(searched, y_mm=NINE_RAYS_MM)
    line = partial(searched, y_mm=LINE_MM, march=SCAN, paper=False)
    every = [setting for air in airs for setting in settings(air)]
    turned = [setting for air in airs for setting in all_poses(air)]
    each = partial(searches.each, airs)
    nine = searches.curves(each("nine_rays", every, nine_rays, part(0.88, 0.92)))
    whole = searches.curves(each("line", every, line, part(0.92, 0.95)))
    poses = searches.curves(each("line", turned, line, part(0.95, 0.97)))
    scanned = each("dense_scan", SCANS, _scan, part(0.97, 1.0))
    scans = {setting: Reconstruction(**found) for setting, found in scanned}
    curves = Curves(_with_rendered(nine, finished), whole, poses)
    sections = _sections(finished, scenes)
    measured = table(list(finished.values()), folder / "measurements")
    made_now = sum(not end.already_there for end in finished.values())
    took_s = time.perf_counter() - started
    return Reproduction(fits, curves, scans, sections, measured, made_now, took_s)


def broadenings(fits: Mapping[str, Fit]) -> dict[str, Broadening]:
    """The broadening of each air: none of the air as simulated."""
    return {RESOLVED: Broadening()} | {air: fit.broadening for air, fit in fits.items()}


def all_poses(air: str) -> list[Setting]:
    """The hottest cylinder from above to the side, for which the paper has three poses."""
    return [Setting(air, TEMPERATURES_C[-1], float(beta)) for beta in ALL_BETAS_DEG]


def rendered_cases() -> list[tuple[Setting, str]]:
    """What is rendered: lines and dots in resolved air, else the dots of figures 7 to 10."""
    return [
        *((setting, LINE) for setting in settings(RESOLVED)),
        *((setting, DOTS) for setting in settings(RESOLVED)),
        *((Setting(air), DOTS) for air in (BLURRED, WIDENED)),
    ]


def _measure(
    folder: Path,
    save: Save,
    given: Mapping[str, str],
    airs: Mapping[str, Broadening],
    scheduler: str | None,
    report: Report,
) -> dict[tuple[Setting, str], Finished]:
    """Measure what is rendered, as a sweep."""
    wanted = rendered_cases()
    dots = {"dots": NINE_DOTS, "line_radius": f"{DOT_RADIUS_MM:g}"}
    parameters = [
        dict(given)
        | {"temperature": f"{setting.temperature_c:g}", "beta": f"{setting.beta_deg:g}"}
        | airs[setting.air].parameters()
        | (dots if method == DOTS else {})
        for setting, method in wanted
    ]
    names = [f"{setting.name}_{method.removeprefix('rendered ')}" for setting, method in wanted]
    planned = cases(SCENE, parameters, names, NINE_RAYS_MM.tolist())
    finished = run(planned, folder, save, scheduler, report)
    if failed := [end for end in finished if end.status is not CaseStatus.OK]:
        raise InputError(f"{failed[0].case.name}: {failed[0].message}")
    return dict(zip(wanted, finished, strict=True))


def _with_rendered(nine: BySetting, finished: Mapping[tuple[Setting, str], Finished]) -> BySetting:
    """The searched curves, and beside them the rendered ones."""
    curves = dict(nine)
    for (setting, method), end in finished.items():
        assert end.folder is not None
        read = from_dots if method == DOTS else from_line
        curves[setting, method] = read(nine[setting, SEARCHED], end.folder)
    return curves


def _sections(finished: Mapping[tuple[Setting, str], Finished], scenes: Scenes) -> FittedCylinders:
    """The cylinder through each rendered line, its axis' direction held."""
    rows = []
    for (setting, method), end in finished.items():
        if method != LINE or end.folder is None:
            continue
        part = scenes.pose(setting.beta_deg).surface
        assert isinstance(part, Cylinder)
        for state in ("cold", "hot"):
            line = read_columns(end.folder / f"line_{state}.csv")
            points = np.stack([line[f"point_mm_{axis}"] for axis in "xyz"], axis=1).astype(float)
            fit, interval = fit_section(points)
            errors = UM_PER_MM * (np.array([fit.radius_mm, *interval]) - part.radius_mm)
            at = (*vars(setting).values(), state, fit.count)
            rows.append((*at, fit.radius_mm, *errors, fit.residual_std_um))
    return FittedCylinders(*zip(*rows, strict=True))


@dataclass(frozen=True)
class Searches(Displayed):
    """What is searched, each finished one stored under a hash of all that it depends on.

    Attributes
    ----------
    folder : Path
    scenes : Scenes
    """

    folder: Path
    scenes: Scenes

    def stored(
        self, name: str, inputs: Mapping[str, Any], make: Callable[[], Any]
    ) -> dict[str, Any]:
        """Arrays, numbers and texts of an object, by name: made and written, or read again."""

        def write(folder: Path) -> None:
            made = vars(make()).items()
            arrays: dict[str, Any] = {k: np.asarray(v) for k, v in made if isinstance(v, _STORED)}
            with (folder / "found.npz").open("wb") as file:
                np.savez(file, **arrays)

        whole = {"name": name, "scene": self.scenes.inputs(), **inputs}
        place = find_or_make(self.folder, name, whole, write)
        with np.load(place / "found.npz", allow_pickle=False) as arrays:
            values = {each: arrays[each] for each in arrays.files}
        return {each: value if value.ndim else value.item() for each, value in values.items()}

    def fits(self, report: Report) -> dict[str, Fit]:
        """The broadenings that come nearest to the paper's numbers, by air."""
        found = {}
        for number, air in enumerate(FAMILIES, 1):
            share = _share(report, (number - 1) / len(FAMILIES), number / len(FAMILIES))
            make = partial(fit_broadening, self.scenes, air, share)
            found[air] = Fit(**self.stored(f"fit_{air}", {}, make))
        return found

    def each(
        self,
        airs: Mapping[str, Broadening],
        name: str,
        wanted: Sequence[Setting],
        find: Callable[[Scene, Setting], Any],
        report: Report,
    ) -> Iterator[tuple[Setting, dict[str, Any]]]:
        """What is found in the scenes of some settings, as it is stored."""
        for number, setting in enumerate(wanted):
            report(f"searching {name.replace('_', ' ')}, {setting}", number / len(wanted))
            air = airs[setting.air]
            inputs = {"setting": str(setting), "broadening": str(air)}

            def make(setting: Setting = setting, air: Broadening = air) -> Any:
                scene = self.scenes.scene(setting.temperature_c, setting.beta_deg, air)
                return find(scene, setting)

            yield setting, self.stored(f"{name}_{setting.name}", inputs, make)

    def curves(
        self, each: Iterable[tuple[Setting, dict[str, Any]]]
    ) -> dict[tuple[Setting, str], Curve]:
        """The curves of stored rays."""
        curves = {}
        for setting, found in each:
            sensor = self.scenes.pose(setting.beta_deg).sensor
            curves[setting, SEARCHED] = Curve(setting=setting, sensor=sensor, **found)
        return curves


def _scan(scene: Scene, _: Setting) -> Reconstruction:
    return reconstruct(scene)


def _share(report: Report, first: float, last: float) -> Report:
    """What reports a part of the whole."""
    return lambda stage, fraction: report(stage, first + (last - first) * fraction)
