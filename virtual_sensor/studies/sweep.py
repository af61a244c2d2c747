"""One scene measured over any of its parameters, case by case, in this process or on a cluster.

Dask's scheduler reads the tasks too.  Nothing here starts the engine before a case is planned or
made, so that the scheduler's machine needs none.
"""

import itertools
import re
import threading
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path
from typing import Any

from virtual_sensor.errors import InputError
from virtual_sensor.studies.cluster import completed
from virtual_sensor.studies.kept import (
    by_other_programs,
    file_hash,
    found,
    kept,
    key_of,
    own_folder,
)

Report = Callable[[str, float], None]
Told = tuple[str, str]
"""How a case ended, and what there is to say of it."""

MARK = "SWEEP.txt"
"""A folder with this file is a sweep's own."""
CASES = "cases"

_MARK_TEXT = """\
The folder of a `virtual-sensor sweep`. Finished cases are kept in cases/ under a hash of all that
went into them: the same command, or an extended one, makes only those that are missing.
"""
_VALUE_LENGTH, _NAME_LENGTH = 40, 120
_ONE_AT_A_TIME = threading.Lock()  # a case uses all cores, and what it holds is one process's


class CaseStatus(StrEnum):
    """How a case ended."""

    OK = "ok"
    NOTHING_FOUND = "nothing_found"
    """It was measured, and no frame has a line centre or a dot."""
    FAILED = "failed"


@dataclass(frozen=True)
class Case:
    """One measurement of a sweep.

    Attributes
    ----------
    scene : str
        Name of a scene that comes along, else the scene file's full path.
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
    """

    scene: str
    parameters: dict[str, str]
    values: dict[str, str]
    name: str
    key: str
    y_mm: tuple[float, ...] | None = None
    camera: str | None = None
    source: str | None = None


@dataclass(frozen=True)
class Finished:
    """A case that was measured, or that can't be.

    Attributes
    ----------
    case : Case
    folder : Path or None
        Of its results; None if there are none.
    status : CaseStatus
    message : str
        Why it failed; else what a user should know of the scene.
    was_kept : bool
        It was there before.
    made_again : bool
        Another version of the program had made it before; its results are removed.
    """

    case: Case
    folder: Path | None
    status: CaseStatus
    message: str
    was_kept: bool
    made_again: bool = False


def plan(
    scene: str | Path,
    choices: Mapping[str, Sequence[str]],
    y_mm: Sequence[float] | None = None,
    camera: str | None = None,
    source: str | None = None,
) -> list[Case]:
    """All combinations of parameters' values, the last parameter's changing fastest.

    `y_mm` are the positions of the probe rays; by default each case has its scene's own.  `camera`
    and `source` are names of the scene's, where it has several.

    Raises
    ------
    InputError
        If the scene can't be read, has no such parameter, or one has no value to take.
    """
    empty = [name for name, values in choices.items() if not values]
    if empty:
        raise InputError(f"{empty[0]}: no value to take; give one or more")
    combined = itertools.product(*choices.values())
    given = [dict(zip(choices, values, strict=True)) for values in combined]
    return cases(scene, given, y_mm=y_mm, camera=camera, source=source)


def cases(
    scene: str | Path,
    parameters: Sequence[Mapping[str, str]],
    names: Sequence[str] | None = None,
    y_mm: Sequence[float] | None = None,
    camera: str | None = None,
    source: str | None = None,
) -> list[Case]:
    """A list of cases, each with the values that are given for it.

    Parameters
    ----------
    scene : str or Path
        A scene file, or the name of one that comes along.
    parameters : sequence of Mapping
        For each case what differs from the scene's defaults.
    names : sequence of str, optional
        One for each case; by default the parameters in which the cases differ.
    y_mm : sequence of float, optional
        Positions of the probe rays along the line, mm; by default each scene's own.
    camera, source : str, optional
        Names of the scene's, where it has several.

    Raises
    ------
    InputError
        If the scene can't be read, or has no such parameter.
    """
    from virtual_sensor.imaging.scene import find_scene, shipped_scenes

    path = find_scene(scene)
    which = str(scene) if path.parent == shipped_scenes() else str(path.absolute())
    planned, probes = [], None if y_mm is None else tuple(map(float, y_mm))
    for given in parameters:
        whole = {name: _anywhere(path, str(value)) for name, value in given.items()}
        case = Case(which, whole, {}, "", "", probes, camera, source)
        values, inputs = _inputs(case)
        planned.append(replace(case, values=values, key=key_of(inputs)))
    told = names or [_name(path.stem, case, differing(planned)) for case in planned]
    return [replace(case, name=_as_file(name)) for case, name in zip(planned, told, strict=True)]


def differing(planned: Iterable[Case]) -> list[str]:
    """Names of the given parameters that are not the same in all cases."""
    seen: dict[str, set[str]] = {}
    for case in planned:
        for name in case.parameters:
            seen.setdefault(name, set())
    for name, values in seen.items():
        values |= {case.values.get(name, "") for case in planned}
    return [name for name, values in seen.items() if len(values) > 1]


def _name(scene: str, case: Case, swept: list[str]) -> str:
    """The name of a case, such as ``beta=15_temperature=900``."""
    words = (f"{name}={Path(case.values.get(name, '')).name[:_VALUE_LENGTH]}" for name in swept)
    return "_".join(words) or scene


def _as_file(name: str) -> str:
    return re.sub(r"[^\w.,+=-]", "-", name)[:_NAME_LENGTH].lstrip(".-") or "case"


def _anywhere(scene: Path, value: str) -> str:
    """A file's name that holds in other folders too; any other value as it is."""
    file = Path(value)
    try:
        float(value)
    except ValueError:
        if file.suffix and file.is_file() and not (scene.parent / value).is_file():
            return str(file.absolute())
    return value


def _inputs(case: Case) -> tuple[dict[str, str], dict[str, Any]]:
    """The parameters as used, and all that a measurement depends on but the program."""
    from virtual_sensor.imaging.scene import find_scene, scene_files, scene_parameters

    path = find_scene(case.scene)
    values = scene_parameters(path, case.parameters)
    files = sorted(file_hash(file) for file in scene_files(path, values))
    inputs = {
        **{"scene": file_hash(path), "parameters": values, "files": files},
        **{"probe rays": case.y_mm, "camera": case.camera, "source": case.source},
    }
    return values, inputs


def run(
    cases: Sequence[Case],
    folder: Path,
    scheduler: str | None = None,
    report: Report = lambda stage, fraction: None,
) -> list[Finished]:
    """Measure the cases that are not kept yet; each is kept as soon as it is finished.

    Parameters
    ----------
    cases : sequence of Case
    folder : Path
        Results go to ``folder/cases/name-key/``.
    scheduler : str, optional
        Address of a Dask cluster's, such as ``tcp://10.0.0.1:8786``; its workers must reach
        `folder` under the same name.  By default the cases run in this process, one by one.
    report : callable
        Told what is being done, and which fraction of the whole is.

    Returns
    -------
    list of Finished
        In the order of `cases`.  A case that can't be measured does not keep others from it.

    Raises
    ------
    InputError
        If the folder holds something else or can't be written; if there is no such scheduler, it
        has no workers or is lost, or the workers write elsewhere.
    """
    own_folder(folder, MARK, _MARK_TEXT)
    place = folder.absolute() / CASES
    there = {case.key: found(place, case.key) for case in cases}
    missing = list({case.key: case for case in cases if not there[case.key]}.values())
    outdated = {case.key for case in missing if by_other_programs(place, case.key)}
    ended: dict[str, Told] = {}
    if missing:
        report(f"{len(cases) - len(missing)} of {len(cases)} cases are kept", 0.0)
        if scheduler:
            on_cluster = _on_cluster(missing, place, scheduler, report)
            ended = {case.key: told for case, told in on_cluster}
        else:
            here = _here(missing, place, report)
            ended = {case.key: told for case, told in here}
    report("done", 1.0)
    return [
        _finished(case, place, there[case.key], ended.get(case.key), case.key in outdated)
        for case in cases
    ]


def _finished(
    case: Case, place: Path, earlier: Path | None, told: Told | None, outdated: bool
) -> Finished:
    status, message = told or (CaseStatus.OK, "")
    made = earlier or found(place, case.key)
    again = outdated and made is not None
    return Finished(case, made, CaseStatus(status), message, earlier is not None, again)


def _make(case: Case, place: str, report: Report | None) -> Told:
    """Measure a case and keep it: the task that Dask runs, in whatever process and thread."""
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.studies.measure import measure, summary
    from virtual_sensor.studies.results import save

    told = report or (lambda stage, fraction: None)

    def fill(folder: Path) -> None:
        told("loading the scene", 0.0)
        scene = load_scene(case.scene, **case.parameters).only(case.camera, case.source)
        result = measure(scene, lambda stage, part: told(stage, 0.85 * part), case.y_mm)
        told("writing the results", 0.85)
        save(result, summary(result), folder, overwrite=True)

    with _ONE_AT_A_TIME:
        try:
            inputs = _inputs(case)[1]
            if key_of(inputs) != case.key:
                raise InputError(
                    f"{case.scene}: its files or the program are not those that the sweep was"
                    " planned with; let all workers have the same version of both, and run it again"
                )
            kept(Path(place), case.name, inputs, fill)
        except InputError as error:
            return CaseStatus.FAILED.value, f"{error}"
    return CaseStatus.OK.value, ""


def _task(case: Case, place: Path, report: Report | None) -> Any:
    from dask import delayed

    task = delayed(_make, pure=False, traverse=False)
    return task(case, str(place), report, dask_key_name=f"{case.name}-{case.key}")


def _here(missing: list[Case], place: Path, report: Report) -> Iterator[tuple[Case, Told]]:
    for number, case in enumerate(missing):
        words = f"case {number + 1} of {len(missing)} ({case.name})"

        def told(stage: str, part: float, words: str = words, number: int = number) -> None:
            report(f"{words}: {stage}", (number + part) / len(missing))

        # Dr.Jit uses all cores itself; one after the other they come in the order of the list.
        yield case, _task(case, place, told).compute(scheduler="synchronous")


def _on_cluster(
    missing: list[Case], place: Path, scheduler: str, report: Report
) -> Iterator[tuple[Case, Told]]:
    tasks = [_task(case, place, None) for case in missing]
    of = {task.key: case for task, case in zip(tasks, missing, strict=True)}
    report(f"waiting for workers at {scheduler}", 0.0)
    for number, (task, told) in enumerate(completed(scheduler, tasks)):
        case = of[task]
        if told is None:
            message = "each worker that tried it was lost; look at the workers' own messages"
            told = (CaseStatus.FAILED.value, message)
        elif told[0] == CaseStatus.OK and not found(place, case.key):
            raise InputError(
                f"{place}: a worker has written a case there, but it is not there; client and"
                " workers must share that disk under the same name: choose such a place with -o"
            )
        report(f"{number + 1} of {len(missing)} cases: {case.name}", (number + 1) / len(missing))
        yield case, told
