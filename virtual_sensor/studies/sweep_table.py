"""A sweep's results: one tidy table over all cases, and a summary."""

import json
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.files import RESULTS_SIGN
from virtual_sensor.imaging.materials import material_words
from virtual_sensor.imaging.scene_file import find_scene, parameter_words
from virtual_sensor.records import Record, Table
from virtual_sensor.studies.finished_cases import fingerprint, of_other_programs
from virtual_sensor.studies.provenance import MadeWith, made_with
from virtual_sensor.studies.sweep import CASES, CaseStatus, Finished, differing

Array = NDArray[np.float64]
STATES = ("cold", "hot")


@dataclass(frozen=True)
class SweptParameter(Record):
    """A parameter that is not the same in all cases.

    Attributes
    ----------
    name : str
        As the scene calls it.
    words : str
        What the scene's file says of it, in the comment behind its default; "" if nothing.
    values : tuple of str
        That were taken, each once, in the order of the cases.
    """

    name: str
    words: str
    values: tuple[str, ...]


@dataclass(frozen=True)
class SweepTable(Table):
    """One row for each case; what a case does not have is NaN, an empty cell.

    Attributes
    ----------
    parameters : dict of tuple of str
        The given parameters as they were used: a column for each, under its own name, or
        "parameter_NAME" where another column has that name.
    status : tuple of str
        "ok", "failed", or "nothing_found": measured, and no frame has a line centre or a dot.
    cold_centres, hot_centres : ndarray of shape (N,)
        Columns of the image, or dots, whose centre was found, in the cold and in the hot frame.
    cold_compared, hot_compared : ndarray of shape (N,)
        Centres, or dots, that were compared with the ray search.
    cold_wrong, hot_wrong : ndarray of shape (N,)
        Centres of a line that are ok and wrong by the frame's own truth.
    cold_section_rms_um, hot_section_rms_um : ndarray of shape (N,)
        Distance of the measured points from the part's true section, rms.
    cold_section_largest_um, hot_section_largest_um : ndarray of shape (N,)
        Distance of the measured points from the part's true section, the largest.
    cold_line_rms_px, hot_line_rms_px : ndarray of shape (N,)
        Rendered line minus ray search, across the line, rms.
    cold_line_largest_px, hot_line_largest_px : ndarray of shape (N,)
        Rendered line minus ray search, across the line, at most.
    cold_line_shift_px, hot_line_shift_px : ndarray of shape (N,)
        Found line minus ray search, across the line, on average; of a recorded one beside the chief
        rays, so that the shift by a lens's blur is in it.
    cold_line_width_px, hot_line_width_px : ndarray of shape (N,)
        Median of the widths of the line's profile: their standard deviations.
    cold_lens_px, hot_lens_px : ndarray of shape (N,)
        How far a lens's pupil moves the place of a recorded line by the ray search, rms.
    cold_detector_px, hot_detector_px : ndarray of shape (N,)
        What the detector makes of the place of a recorded line: its error in ideal frames, rms.
    cold_noise_px, hot_noise_px : ndarray of shape (N,)
        What the sensor's noise makes of it, rms.
    cold_speckle_px, hot_speckle_px : ndarray of shape (N,)
        What speckle makes of it, rms.
    cold_ghost_columns, hot_ghost_columns : ndarray of shape (N,)
        Columns with a ghost of a hundredth of the line or more, where light that bounces was
        rendered (max_depth).
    cold_ghost_over_line, hot_ghost_over_line : ndarray of shape (N,)
        How bright the brightest ghost of a column is beside its line: the median of all columns.
    cold_dots_largest_u_px, hot_dots_largest_u_px : ndarray of shape (N,)
        Rendered dots minus ray search, along the line, at most.
    cold_dots_largest_v_px, hot_dots_largest_v_px : ndarray of shape (N,)
        Rendered dots minus ray search, across the line, at most.
    rays_lit : ndarray of shape (N,)
        How many of the probe rays the laser lights.
    largest_incidence_shift_um : ndarray of shape (N,)
        Of the probe rays: how far hot air moves the point that a ray lights, |B - A|.
    largest_hot_error_um : ndarray of shape (N,)
        Of the probe rays: how far the point measured hot is from the one that is lit, |B - B_m|.
    largest_measured_shift_um : ndarray of shape (N,)
        Of the probe rays: how far hot air moves the measured point, |B_m - A_m|.
    folder : tuple of str
        Of the case's results, relative to the sweep's; "" if there are none.
    message : tuple of str
        Why it failed; else what to know of the scene.
    """

    parameters: Mapping[str, tuple[str, ...]]
    status: tuple[str, ...]
    cold_centres: Array
    hot_centres: Array
    cold_compared: Array
    hot_compared: Array
    cold_wrong: Array
    hot_wrong: Array
    cold_section_rms_um: Array
    hot_section_rms_um: Array
    cold_section_largest_um: Array
    hot_section_largest_um: Array
    cold_line_rms_px: Array
    hot_line_rms_px: Array
    cold_line_largest_px: Array
    hot_line_largest_px: Array
    cold_line_shift_px: Array
    hot_line_shift_px: Array
    cold_line_width_px: Array
    hot_line_width_px: Array
    cold_lens_px: Array
    hot_lens_px: Array
    cold_detector_px: Array
    hot_detector_px: Array
    cold_noise_px: Array
    hot_noise_px: Array
    cold_speckle_px: Array
    hot_speckle_px: Array
    cold_ghost_columns: Array
    hot_ghost_columns: Array
    cold_ghost_over_line: Array
    hot_ghost_over_line: Array
    cold_dots_largest_u_px: Array
    hot_dots_largest_u_px: Array
    cold_dots_largest_v_px: Array
    hot_dots_largest_v_px: Array
    rays_lit: Array
    largest_incidence_shift_um: Array
    largest_hot_error_um: Array
    largest_measured_shift_um: Array
    folder: tuple[str, ...]
    message: tuple[str, ...]

    def columns(self) -> dict[str, NDArray[Any]]:
        """The columns, each of shape (N,), by their names; the parameters' come first."""
        names = [each.name for each in fields(self) if each.name != "parameters"]
        own = {name: np.asarray(getattr(self, name)) for name in names}
        given = {
            f"parameter_{name}" if name in own else name: np.asarray(values, np.str_)
            for name, values in self.parameters.items()
        }
        return given | own


@dataclass(frozen=True)
class SweepSummary(Record):
    """What was swept, and what became of it.

    Attributes
    ----------
    scene : str
        Name of a shipped scene, or path of a scene file.
    swept : tuple of SweptParameter
        The parameters that differ between cases.
    cases : int
        Their number.
    failed : dict of str
        Why cases could not be measured, by their names.
    nothing_found : tuple of str
        Names of the cases in which no line centre or dot was found.
    notes : tuple of str
        On the program, and those of all cases that were measured, after the case's name.
    program : str
        Hash of the program, with which the names of its cases' folders end.
    made_with : MadeWith
        Engine and versions.
    """

    scene: str
    swept: tuple[SweptParameter, ...]
    cases: int
    failed: Mapping[str, str]
    nothing_found: tuple[str, ...]
    notes: tuple[str, ...]
    program: str
    made_with: MadeWith


@dataclass(frozen=True)
class Sweep(Displayed):
    """A sweep's results.

    Attributes
    ----------
    finished : tuple of Finished
    table : SweepTable
        A row for each of them.
    summary : SweepSummary
    """

    finished: tuple[Finished, ...]
    table: SweepTable
    summary: SweepSummary

    def _line(self) -> str:
        summary = self.summary
        return f"{summary.cases} cases of {Path(summary.scene).stem}, {len(summary.failed)} failed"

    def _columns(self) -> dict[str, NDArray[Any]]:
        return self.table.columns()


def results(finished: Sequence[Finished], folder: Path) -> Sweep:
    """Table and summary of the finished cases of a sweep in a folder.

    Raises
    ------
    InputError
        If a case's summary can't be read.
    """
    found, cases = table(finished, folder), [end.case for end in finished]
    scene = cases[0].scene if cases else ""
    words = material_words() | parameter_words(find_scene(scene)) if cases else {}
    said = list(zip((case.name for case in cases), found.status, found.message, strict=True))
    of_cases = [f"{name}: {m}" for name, how, m in said if m and how != CaseStatus.FAILED]
    summary = SweepSummary(
        scene=scene,
        swept=tuple(
            SweptParameter(name, words.get(name, ""), tuple(dict.fromkeys(found.parameters[name])))
            for name in differing(cases)
        ),
        cases=len(cases),
        failed={name: message for name, how, message in said if how == CaseStatus.FAILED},
        nothing_found=tuple(name for name, how, _ in said if how == CaseStatus.NOTHING_FOUND),
        notes=(*_program_notes(finished, folder), *of_cases),
        program=fingerprint(),
        made_with=made_with(),
    )
    return Sweep(tuple(finished), found, summary)


def _program_notes(finished: Sequence[Finished], folder: Path) -> list[str]:
    """What has become of results of another version of the program, or of a package under it."""
    again = sum(end.made_again for end in finished)
    others = len(of_other_programs(folder / CASES))
    replaced = (
        f"{again} cases were measured again, since this program or a package under it has changed;"
        " their earlier results are removed"
    )
    unused = (
        f"{CASES}/ holds {others} results of another version of this program, or of a package under"
        f" it, that were not used; delete what does not end with -{fingerprint()}"
    )
    return [note for count, note in ((again, replaced), (others, unused)) if count]


def table(finished: Sequence[Finished], folder: Path) -> SweepTable:
    """The tidy table of finished cases; their folders are given relative to `folder`.

    Raises
    ------
    InputError
        If a case's summary can't be read.
    """
    given = dict.fromkeys(name for end in finished for name in end.case.parameters)
    summaries = [_summary_of(end) for end in finished]
    figures = [_figures(summary) for summary in summaries]
    columns = {name: np.array([row[name] for row in figures], float) for name in _figures({})}
    return SweepTable(
        parameters={
            name: tuple(end.case.values.get(name, "") for end in finished) for name in given
        },
        status=tuple(_status(end, row) for end, row in zip(finished, figures, strict=True)),
        **columns,
        folder=tuple(
            str(end.folder.relative_to(folder.absolute())) if end.folder else "" for end in finished
        ),
        message=tuple(
            end.message or "; ".join(summary.get("notes", ()))
            for end, summary in zip(finished, summaries, strict=True)
        ),
    )


def _status(end: Finished, figures: Mapping[str, float]) -> str:
    nothing = not any(figures[f"{name}_centres"] > 0.0 for name in STATES)
    if nothing and end.status == CaseStatus.OK:
        return CaseStatus.NOTHING_FOUND.value
    return end.status.value


def _summary_of(end: Finished) -> dict[str, Any]:
    """The summary of a case's measurement; empty if there is none."""
    if end.folder is None:
        return {}
    path = end.folder / RESULTS_SIGN
    try:
        summary: dict[str, Any] = json.loads(path.read_text(encoding="utf-8"))
        return summary | {"notes": summary["notes"]}
    except (OSError, ValueError, KeyError, TypeError) as error:
        raise InputError(
            f"{path}: can't be read ({error!r}); delete the case's folder, and it is measured again"
        ) from None


def _figures(summary: dict[str, Any]) -> dict[str, float]:
    """The figures of one case's summary; NaN where it has none."""
    figures: dict[str, float | None] = {}
    for name in STATES:
        state = summary.get("states", {}).get(name, {})
        parts = ("section", "dots_minus_search", "line_minus_search", "line_minus_truth")
        section, dots, line, truth = (state.get(part) or {} for part in parts)
        whole, ghosts = (state.get(part) or {} for part in ("split", "ghosts"))
        split = whole.get("parts", {})
        figures |= {
            f"{name}_centres": dots.get("found", line.get("centres")),
            f"{name}_compared": dots.get("found", line.get("compared")),
            f"{name}_wrong": truth.get("wrong") if line else None,
            f"{name}_section_rms_um": section.get("rms_um"),
            f"{name}_section_largest_um": section.get("largest_um"),
            f"{name}_line_rms_px": line.get("rms_px"),
            f"{name}_line_largest_px": line.get("largest_px"),
            f"{name}_line_shift_px": _shift(whole) if whole and line else line.get("mean_px"),
            f"{name}_line_width_px": state.get("line_width_px") if line else None,
            f"{name}_ghost_columns": ghosts.get("ghost_columns"),
            f"{name}_ghost_over_line": ghosts.get("ghost_over_line"),
            f"{name}_dots_largest_u_px": dots.get("largest_u_px"),
            f"{name}_dots_largest_v_px": dots.get("largest_v_px"),
        }
        for part in ("lens", "detector", "noise", "speckle"):
            figures[f"{name}_{part}_px"] = split.get(part, {}).get("rms_px")
    rays = summary.get("probe_rays", {})
    figures["rays_lit"] = rays.get("lit")
    for name in ("incidence_shift", "hot_error", "measured_shift"):
        figures[f"largest_{name}_um"] = rays.get(f"largest_{name}_um")
    return {name: np.nan if value is None else value for name, value in figures.items()}


def _shift(split: Mapping[str, Any]) -> float | None:
    """Mean of what all parts but refraction move the line by, px."""
    whole, bent = split["whole"]["mean_px"], split["parts"]["refraction"]["mean_px"]
    return None if whole is None or bent is None else whole - bent
