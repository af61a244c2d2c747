"""One scene measured over any of its parameters, case by case, in this process or on a cluster.

Dask's scheduler reads the tasks too.  Nothing here starts the engine before a case is planned or
made, so that the scheduler's machine needs none.
"""

import itertools
import math
import pkgutil
import re
import shlex
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.recording_options import RecordingOptions
from virtual_sensor.studies.cluster import completed
from virtual_sensor.studies.finished_cases import (
    file_hash,
    find,
    find_or_make,
    key_of,
    of_other_programs,
    own_folder,
)

Report = Callable[[str, float], None]
Save = Callable[..., object]
"""Called as ``save(measurement, folder, command, overwrite)``, it writes a case's results.

A cluster's workers import it by its name.
"""

MARK = "SWEEP.txt"
"""A folder with this file is a sweep's own."""
CASES = "cases"
MOST_CASES = 100_000

_MARK_TEXT = """\
The folder of a `virtual-sensor sweep`. Finished cases lie in cases/ under a hash of all that went
into them: the same command, or an extended one, makes only those that are missing.
"""
_VALUE_LENGTH, _NAME_LENGTH = 40, 120
_ONE_AT_A_TIME = threading.Lock()  # a case uses all cores, and what it holds is one process's
_Ending = tuple[str, str]  # status and message
_IDEAL = RecordingOptions()
_REFUSED = "refused"  # for all cases: which camera or source is meant


class CaseStatus(StrEnum):
    """How a case ended."""

    OK = "ok"
    NOTHING_FOUND = "nothing_found"
    """It was measured, and no frame has a line centre or a dot."""
    FAILED = "failed"


@dataclass(frozen=True)
class Case(Displayed):
    """One measurement of a sweep.

    Attributes
    ----------
    scene : str
        Name of a shipped scene, else the scene file's full path.
    parameters : dict
        What is given for the scene's ``$parameters``.
    values : dict
        All of the scene's parameters as they are used, defaults included.
    name : str
        For people and for files, of the parameters that are swept.
    key : str
        Hashes of the scene, the files that it refers to, `values` and `y_mm`; and of the program.
    y_mm : tuple of float or None
        Positions of the probe rays along the line; None: the scene's own.
    camera, source : str or None
        Names of the scene's; None: it has only one.
    recording : RecordingOptions
        How its frames are recorded; all cases have the same seed.
    """

    scene: str
    parameters: dict[str, str]
    values: dict[str, str]
    name: str
    key: str
    y_mm: tuple[float, ...] | None = None
    camera: str | None = None
    source: str | None = None
    recording: RecordingOptions = _IDEAL

    def _line(self) -> str:
        return f"{Path(self.scene).stem}, {self.name}"

    @property
    def command(self) -> str:
        """The command that measures this case alone."""
        words = ["virtual-sensor", "measure", self.scene]
        words += [f"-D{name}={value}" for name, value in self.parameters.items()]
        words += [f"--camera={self.camera}"] if self.camera else []
        words += [f"--source={self.source}"] if self.source else []
        words += [f"-y{y:g}" for y in self.y_mm or ()]
        words += self.recording.words
        return shlex.join(words)


@dataclass(frozen=True)
class Finished(Displayed):
    """A case that was measured, or that can't be.

    Attributes
    ----------
    case : Case
    folder : Path or None
        Of its results; None if there are none.
    status : CaseStatus
    message : str
        Why it failed; else what a user should know of the scene.
    already_there : bool
        It was finished before this run.
    made_again : bool
        Another version of the program had made it before; its results are removed.
    """

    case: Case
    folder: Path | None
    status: CaseStatus
    message: str
    already_there: bool
    made_again: bool = False

    def _line(self) -> str:
        return listed(self.case.name, self.status, self.message)


def plan(
    scene: str | Path,
    choices: Mapping[str, Any],
    y_mm: Sequence[float] | None = None,
    camera: str | None = None,
    source: str | None = None,
    recording: RecordingOptions | None = None,
) -> list[Case]:
    """All combinations of parameters' values, the last parameter's changing fastest.

    `choices` has texts or numbers by the parameters' names; a single one is that of all cases, and
    one that is given twice is taken once.  `y_mm` are the positions of the probe rays; by default
    each case has its scene's own.  `camera` and `source` are names of the scene's, where it has
    several.  `recording` says how all cases' frames are recorded.

    Raises
    ------
    InputError
        If the scene can't be read, has no such parameter, one has no value to take, or there are
        over `MOST_CASES` combinations.
    """
    listed = {
        name: [values] if isinstance(values, str | int | float) else list(values)
        for name, values in choices.items()
    }
    different = {name: _different([f"{v}" for v in listed[name]]) for name in listed}
    if empty := [name for name, values in different.items() if not values]:
        raise InputError(f"{empty[0]}: no value to take; give one or more")
    count = math.prod(map(len, different.values()))
    if count > MOST_CASES:
        raise InputError(f"{scene}: {count} cases; give at most {MOST_CASES} combinations")
    combined = itertools.product(*different.values())
    given = [dict(zip(different, values, strict=True)) for values in combined]
    return cases(scene, given, y_mm=y_mm, camera=camera, source=source, recording=recording)


def _different(values: Sequence[str]) -> list[str]:
    """Values without those that are the same text, or the same number, as one before."""
    found: dict[float | str, str] = {}
    for value in values:
        try:
            found.setdefault(float(value), value)
        except ValueError:
            found.setdefault(value, value)
    return list(found.values())


def cases(
    scene: str | Path,
    parameters: Sequence[Mapping[str, str]],
    names: Sequence[str] | None = None,
    y_mm: Sequence[float] | None = None,
    camera: str | None = None,
    source: str | None = None,
    recording: RecordingOptions | None = None,
) -> list[Case]:
    """A list of cases, each with the values that are given for it.

    Parameters
    ----------
    scene : str or Path
        A scene file, or the name of a shipped one.
    parameters : sequence of Mapping
        For each case what differs from the scene's defaults.
    names : sequence of str, optional
        One for each case; by default the parameters in which the cases differ.
    y_mm : sequence of float, optional
        Positions of the probe rays along the line, mm; by default each scene's own.
    camera, source : str, optional
        Names of the scene's, where it has several.
    recording : RecordingOptions, optional
        How all cases' frames are recorded; by default as the scene's camera says.

    Raises
    ------
    InputError
        If the scene can't be read, or has no such parameter.
    """
    from virtual_sensor.imaging.scene_file import find_scene, shipped_scenes

    path = find_scene(scene)
    which = str(scene) if path.parent == shipped_scenes() else str(path.absolute())
    planned, probes = [], None if y_mm is None else tuple(map(float, y_mm))
    recording = (recording or RecordingOptions()).anywhere()
    for given in parameters:
        whole = {name: _anywhere(path, str(value)) for name, value in given.items()}
        case = Case(which, whole, {}, "", "", probes, camera, source, recording)
        values, inputs = _inputs(case)
        planned.append(replace(case, values=values, key=key_of(inputs)))
    chosen = names or [_name(path.stem, case, differing(planned)) for case in planned]
    return [replace(case, name=_as_file(name)) for case, name in zip(planned, chosen, strict=True)]


def differing(planned: Iterable[Case]) -> list[str]:
    """Names of the given parameters that are not the same in all cases."""
    planned = list(planned)
    given = dict.fromkeys(name for case in planned for name in case.parameters)
    return [name for name in given if len({case.values.get(name, "") for case in planned}) > 1]


def _name(scene: str, case: Case, swept: list[str]) -> str:
    """The name of a case, such as ``beta=15_temperature=900``."""
    words = (f"{name}={Path(case.values.get(name, '')).name[:_VALUE_LENGTH]}" for name in swept)
    return "_".join(words) or scene


def _as_file(name: str) -> str:
    return re.sub(r"[^\w.,+=-]", "-", name)[:_NAME_LENGTH].lstrip(".-") or "case"


def _anywhere(scene: Path, value: str) -> str:
    """A file's name that holds in other folders too; any other value as it is."""
    try:
        float(value)
    except ValueError:
        for text in (value, f"{value}.nc"):  # a field may be named without it
            file = Path(text)
            if file.suffix and file.is_file() and not (scene.parent / text).is_file():
                return str(file.absolute())
    return value


def _inputs(case: Case) -> tuple[dict[str, str], dict[str, Any]]:
    """The parameters as used, and all that a measurement depends on but the program."""
    from virtual_sensor.imaging.scene import scene_files, scene_parameters
    from virtual_sensor.imaging.scene_file import find_scene

    path = find_scene(case.scene)
    values = scene_parameters(path, case.parameters)
    files = sorted(file_hash(file) for file in scene_files(path, values))
    found = {"scene": file_hash(path), "parameters": values, "files": files}
    chosen = {"probe rays": case.y_mm, "camera": case.camera, "source": case.source}
    return values, found | chosen | {"recording": case.recording.inputs()}


def run(
    cases: Sequence[Case],
    folder: Path,
    save: Save,
    scheduler: str | None = None,
    report: Report = lambda stage, fraction: None,
) -> list[Finished]:
    """Measure the cases that are not finished yet; each is saved as soon as it is.

    Parameters
    ----------
    cases : sequence of Case
    folder : Path
        Results go to ``folder/cases/name-key/``.
    save : callable
        Writes a case's results (see `Save`).  For a cluster, a module's function.
    scheduler : str, optional
        Address of a Dask cluster's, such as ``tcp://10.0.0.1:8786``; its workers must reach
        `folder` under the same name.  By default the cases run in this process, one by one.
    report : callable
        Called with what is being done, and the fraction of the whole that is done.

    Returns
    -------
    list of Finished
        In the order of `cases`.  A case that can't be measured does not keep others from it.

    Raises
    ------
    InputError
        If the folder holds something else or can't be written; if the scene has several cameras or
        sources and none is named; if there is no such scheduler, it has no workers or is lost, or
        the workers write to another disk.
    """
    place = folder.absolute() / CASES
    there = {case.key: find(place, case.key) for case in cases}
    missing = list({case.key: case for case in cases if not there[case.key]}.values())
    own_folder(folder, MARK, _MARK_TEXT)
    outdated = {case.key for case in missing if of_other_programs(place, case.key)}
    ended: dict[str, _Ending] = {}
    if missing:
        report(f"{len(cases) - len(missing)} of {len(cases)} cases are there", 0.0)
        if scheduler:
            ending = _on_cluster(missing, place, save, scheduler, report)
        else:
            ending = _here(missing, place, save, report)
        for case, (status, message) in ending:
            if status == _REFUSED:
                raise InputError(message)
            ended[case.key] = status, message
    report("done", 1.0)
    finished = []
    for case in cases:
        status, message = ended.get(case.key, (CaseStatus.OK, ""))
        earlier = there[case.key]
        made = earlier or find(place, case.key)
        again = made is not None and case.key in outdated
        end = Finished(case, made, CaseStatus(status), message, earlier is not None, again)
        finished.append(end)
    return finished


def _make(case: Case, place: str, save: Save | str, report: Report | None) -> _Ending:
    """Measure a case and save it: the task that Dask runs, in whatever process and thread.

    `save` may be a function's name, as ``module:name``.
    """
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.studies.measure import measure

    progress = report or (lambda stage, fraction: None)

    def fill(folder: Path) -> None:
        result = measure(
            scene, lambda stage, part: progress(stage, 0.85 * part), case.y_mm, case.recording
        )
        progress("writing the results", 0.85)
        write = pkgutil.resolve_name(save) if isinstance(save, str) else save
        write(result, folder, case.command, overwrite=True)

    with _ONE_AT_A_TIME:
        try:
            inputs = _inputs(case)[1]
            if key_of(inputs) != case.key:
                raise InputError(
                    f"{case.scene}: its files or the program are not those that the sweep was"
                    " planned with; let all workers have the same version of both, and run it again"
                )
            progress("loading the scene", 0.0)
            scene = load_scene(case.scene, **case.parameters)
            try:
                scene = scene.only(case.camera, case.source)
                _ = scene.camera_name, scene.source_name
            except InputError as error:
                return _REFUSED, f"{error}"
            find_or_make(Path(place), case.name, inputs, fill)
        except InputError as error:
            return CaseStatus.FAILED.value, f"{error}"
    return CaseStatus.OK.value, ""


def _here(
    missing: list[Case], place: Path, save: Save, report: Report
) -> Iterator[tuple[Case, _Ending]]:
    for number, case in enumerate(missing):

        def progress(stage: str, part: float, case: Case = case, number: int = number) -> None:
            words = f"case {number + 1} of {len(missing)} ({case.name}): {stage}"
            report(words, (number + part) / len(missing))

        yield case, _make(case, str(place), save, progress)


def _on_cluster(
    missing: list[Case], place: Path, save: Save, scheduler: str, report: Report
) -> Iterator[tuple[Case, _Ending]]:
    from dask import delayed

    task = delayed(_make, pure=False, traverse=False)
    by_name = f"{save.__module__}:{save.__qualname__}"  # the scheduler's machine can't import it
    keys = {f"{case.name}-{case.key}": case for case in missing}
    tasks = [task(c, str(place), by_name, None, dask_key_name=key) for key, c in keys.items()]
    report(f"waiting for workers at {scheduler}", 0.0)
    for number, (key, ending) in enumerate(completed(scheduler, tasks)):
        case = keys[key]
        if ending is None:
            message = "each worker that tried it was lost; see the workers' own messages"
            ending = (CaseStatus.FAILED.value, message)
        elif ending[0] == CaseStatus.OK and not find(place, case.key):
            raise InputError(
                f"{place}: a worker has written a case there, but it is not there; client and"
                " workers must share that disk under the same name: choose such a place with -o"
            )
        report(f"{number + 1} of {len(missing)} cases: {case.name}", (number + 1) / len(missing))
        yield case, ending
