"""Panel "rays": bent rays on their own, error per ray against time per ray."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor import engine
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.eikonal import Field, March
from virtual_sensor.optics.steppers import STEPPERS
from virtual_sensor.studies.chart.ray_bundles import (
    FINEST,
    MM_PER_PX,
    Bundle,
    apart_px,
    camera_bundle,
    ends_of,
    fibre,
    fish_eye_of_hot_air,
    prepare,
    tabulated_ends,
)
from virtual_sensor.studies.chart.rung import Report, Rung, timed

Array = NDArray[np.float64]

SCENE = "hot_cylinder"

_RAYS = {"llvm": 32_768, "cuda": 1_000_000}  # two blocks of Dr.Jit's on a CPU; what fills a GPU
_TABLE_RAYS = 100_000  # share the making of a table: fewer than one a pixel of a frame's line
_QUICK_RAYS = 2_000
_JUDGED, _QUICK_JUDGED = 2_001, 51
_RUNS, _QUICK_RUNS = 3, 1
_STEPS_MM = (8.0, 4.0, 2.0, 1.0, 0.5)
_EULER_STEPS_MM = (8.0, 2.0, 0.5, 0.125)
_TOLERANCES_MM = (1e-3, 1e-4, 1e-5, 1e-6)
_TABLES_PX = (0.05, 0.01, 0.002)
_LONGEST_MM = 24.0  # step of methods that control theirs
_UM_PER_PX = 1e3 * MM_PER_PX


@dataclass(frozen=True)
class Choice:
    """One way of bending rays, as a user would choose it.

    Attributes
    ----------
    name : str
    march : March
    settings : dict
        What differs from a scene's defaults.
    model : dict
        Of the field, for `IndexField.simplified`; empty: as it is.
    """

    name: str
    march: March
    settings: dict[str, Any]
    model: dict[str, Any]


@dataclass(frozen=True)
class Task:
    """Rays to bend, and where those that are judged must end.

    Attributes
    ----------
    field : Field
    bundle : Bundle
    at : ndarray of shape (M,)
        Numbers of the rays that are judged.
    truth : ndarray of shape (M, 3)
        Where these end, mm.
    reference : str
    note : str
    """

    field: Field
    bundle: Bundle
    at: NDArray[np.intp]
    truth: Array
    reference: str
    note: str


def rungs(report: Report, quick: bool = False) -> list[Rung]:
    """Measure all methods of bending rays, on the camera's rays and on closed-form ones.

    Parameters
    ----------
    report : callable
    quick : bool
        Few rungs and rays.
    """
    scene = load_scene(SCENE)
    judged = _QUICK_JUDGED if quick else _JUDGED
    rays = _QUICK_RAYS if quick else _RAYS[engine.activate().backend]
    work: list[tuple[Task, Choice]] = []
    report("rays: the reference", 0.0)
    camera = _camera_task(scene, rays, judged)
    work += [(camera, choice) for choice in _choices(quick)]
    for task in _closed_form_tasks(rays, judged):
        work += [(task, choice) for choice in _plain_choices(quick)]
    found = []
    for number, (task, choice) in enumerate(work):
        report(f"rays: {choice.name}", (number + 1) / (len(work) + 2))
        found.append(_measured(task, choice, _QUICK_RUNS if quick else _RUNS))
    report("rays: tabulated", 1.0)
    shared = camera if rays > _TABLE_RAYS or quick else _camera_task(scene, _TABLE_RAYS, judged)
    return found + _tabulated(scene, shared, quick)


def _tabulated(scene: Scene, task: Task, quick: bool) -> list[Rung]:
    """The tabulated transport: the time is that of making the table too."""
    found = []
    for tolerance in _TABLES_PX[:1] if quick else _TABLES_PX:
        work, make = tabulated_ends(scene, task.bundle, tolerance)
        runs = _QUICK_RUNS if quick else _RUNS
        seconds, making = timed(work, runs), timed(make, runs)
        error = apart_px(work()[task.at], task.truth, task.bundle.some(len(task.at)))
        march = scene.transport.march
        found.append(
            Rung(
                panel="rays",
                name="tabulated",
                settings={"transport": "tabulated", "tolerance": tolerance, "march": str(march)},
                error_px=float(np.sqrt(np.mean(error**2))),
                largest_px=float(error.max()),
                error_um=float(np.sqrt(np.mean(error**2))) * _UM_PER_PX,
                seconds=seconds / len(task.bundle.targets),
                item="ray",
                items=len(task.bundle.targets),
                failed=0,
                reference=task.reference,
                note=f"of it, making the table takes {making:.2g} s, whatever the number of rays",
            )
        )
    return found


def _camera_task(scene: Scene, rays: int, judged: int) -> Task:
    """The camera's rays through the hot plume, judged by the finest march in float64."""
    field = scene.field
    assert field is not None
    bundle = camera_bundle(scene, rays)
    return Task(
        field,
        bundle,
        bundle.sample(judged),
        ends_of(field, bundle.some(judged), FINEST),
        f"float64, {FINEST.method} of {FINEST.step_mm:g} mm",
        "",
    )


def _closed_form_tasks(rays: int, judged: int) -> Iterator[Task]:
    """Fields whose rays are known."""
    for words, made in (("a fibre", fibre), ("Maxwell's fish-eye", fish_eye_of_hot_air)):
        field, bundle, ends = made(rays)
        at = bundle.sample(judged)
        note = "no grid: the method's error alone, and what an expression costs for a field"
        yield Task(field, bundle, at, ends[at], f"closed form: {words} as weak as hot air", note)


def _choices(quick: bool) -> Iterator[Choice]:
    """What the camera's rays are bent by."""
    yield Choice("straight", March(2.0, "leapfrog", "single"), {"transport": "straight"}, {})
    for step in (4.0,) if quick else _STEPS_MM[:4]:
        yield _chosen("leapfrog", step, "single", first_order=True)
    yield from _plain_choices(quick)
    for tolerance in _TOLERANCES_MM[1:2] if quick else _TOLERANCES_MM:
        for precision in ("single",) if quick else ("single", "double"):
            march = March(_LONGEST_MM, "dopri5", precision, tolerance_mm=tolerance)
            yield Choice("dopri5, controlled", march, {"tolerance_mm": tolerance}, {})
    for model in ({"interpolation": "linear"}, {"dimensions": 2}):
        for step in (4.0,) if quick else _STEPS_MM:
            yield _chosen("leapfrog", step, "single", model)
    if not quick:
        yield _chosen("leapfrog", 2.0, "single", {"interpolation": "linear", "dimensions": 2})


def _plain_choices(quick: bool) -> Iterator[Choice]:
    """Each method with several steps, in both precisions."""
    for method in STEPPERS:
        steps = (4.0,) if quick else _EULER_STEPS_MM if method == "euler" else _STEPS_MM
        for step in steps:
            for precision in ("single",) if quick else ("single", "double"):
                yield _chosen(method, step, precision)


def _chosen(
    method: str,
    step: float,
    precision: str,
    model: dict[str, Any] | None = None,
    first_order: bool = False,
) -> Choice:
    """A march with fixed steps, under a name that tells what is out of the ordinary."""
    model = model or {}
    simpler = [f"{model['interpolation']} field"] if "interpolation" in model else []
    simpler += [f"{model['dimensions']}-D field"] if "dimensions" in model else []
    name = ", ".join(["first order" if first_order else method, *simpler])
    return Choice(name, March(step, method, precision, first_order=first_order), {}, model)


def _measured(task: Task, choice: Choice, runs: int) -> Rung:
    """Time a choice and judge it."""
    field: Field | None = task.field
    straight = choice.settings.get("transport") == "straight"
    if straight:
        field = None
    elif choice.model:
        assert isinstance(field, IndexField)
        field = field.simplified(**choice.model)
    work = prepare(field, task.bundle, choice.march)
    seconds = timed(work, runs)
    positions = work().positions()
    error = apart_px(positions[task.at], task.truth, task.bundle.some(len(task.at)))
    known = error[np.isfinite(error)]
    rms = float(np.sqrt(np.mean(known**2))) if known.size else np.nan
    march = choice.march
    transport = "first_order" if march.first_order else "marched"
    settings = {
        "transport": transport,
        "method": march.method,
        "step": march.step_mm,
    } | choice.settings
    if straight:
        settings = choice.settings
    return Rung(
        panel="rays",
        name=choice.name,
        settings=settings | {"precision": march.precision} | choice.model,
        error_px=rms,
        largest_px=float(known.max()) if known.size else np.nan,
        error_um=rms * _UM_PER_PX,
        seconds=seconds / len(positions),
        item="ray",
        items=len(positions),
        failed=int(np.sum(np.isnan(positions[:, 0]))),
        reference=task.reference,
        note=task.note,
    )
