"""Panel "rays": bent rays on their own, error against time for each ray."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from functools import partial
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor import engine
from virtual_sensor.imaging.scene import Scene, load_scene
from virtual_sensor.optics.eikonal import Field, March
from virtual_sensor.optics.steppers import STEPPERS
from virtual_sensor.studies.chart.benchmark import Configuration, Score, Task, timed
from virtual_sensor.studies.chart.ray_bundles import (
    FINEST,
    MM_PER_PX,
    Bundle,
    Ends,
    apart_px,
    camera_bundle,
    ends_of,
    fibre,
    fish_eye_of_hot_air,
    prepare,
    tabulated_ends,
)

Array = NDArray[np.float64]

SCENE = "hot_cylinder"

_RAYS = {"llvm": 32_768, "cuda": 1_000_000}  # two blocks of Dr.Jit's on a CPU; what fills a GPU
_TABLE_RAYS = 100_000  # share the making of a table: fewer than one a pixel of a frame's line
_QUICK_RAYS = 2_000
_JUDGED, _QUICK_JUDGED = 2_001, 51
_STEPS_MM = (8.0, 4.0, 2.0, 1.0, 0.5)
_EULER_STEPS_MM = (8.0, 2.0, 0.5, 0.125)
_TOLERANCES_MM = (1e-3, 1e-4, 1e-5, 1e-6)
_TABLES_PX = (0.05, 0.01, 0.002)
_LONGEST_MM = 24.0  # step of methods that control theirs
_UM_PER_PX = 1e3 * MM_PER_PX
_PRECISIONS = ("single", "double")


def tasks(quick: bool = False) -> Iterator[Task]:
    """The camera's rays through the hot plume, and rays that have a closed form."""
    scene = load_scene(SCENE)
    field = scene.field
    assert field is not None
    judged = _QUICK_JUDGED if quick else _JUDGED
    rays = _QUICK_RAYS if quick else _RAYS[engine.activate().backend]
    reference = f"rays in float64, {FINEST.method.upper()} of {FINEST.step_mm:g} mm"

    def plume(bundle: Bundle, configurations: list[Configuration]) -> Task:
        truth = ends_of(field, bundle.some(judged), FINEST)
        return _task("through the hot plume", reference, bundle, truth, configurations)

    bundle = camera_bundle(scene, rays)
    yield plume(bundle, list(_through_air(scene, bundle, quick)))
    if rays < _TABLE_RAYS and not quick:
        bundle = camera_bundle(scene, _TABLE_RAYS)
    yield plume(bundle, list(_tabulated(scene, bundle, quick)))
    for words, made in (("a fibre", fibre), ("Maxwell's fish-eye", fish_eye_of_hot_air)):
        exact, bundle, ends = made(rays)
        truth = ends[bundle.sample(judged)]
        choices = list(_fixed_steps(exact, bundle, quick))
        yield _task(
            f"through {words} as weak as hot air", "rays in closed form", bundle, truth, choices
        )


def _task(
    name: str, reference: str, bundle: Bundle, truth: Array, configurations: list[Configuration]
) -> Task:
    """A bundle of rays, some of which must end where `truth` (M, 3) in mm says."""
    at, some = bundle.sample(len(truth)), bundle.some(len(truth))

    def score(ends: Ends | Array) -> Score:
        positions = ends.positions() if isinstance(ends, Ends) else ends
        error = apart_px(positions[at], truth, some)
        return Score(error, _UM_PER_PX * error, int(np.isnan(positions[:, 0]).sum()))

    return Task(name, reference, len(bundle.targets), score, configurations)


def _through_air(scene: Scene, bundle: Bundle, quick: bool) -> Iterator[Configuration]:
    """Whatever the camera's rays are bent by, but tables."""
    air = scene.field
    assert air is not None
    march = March(2.0, "leapfrog", "single")
    yield Configuration("straight", "straight", partial(prepare, None, bundle, march))
    for step in (4.0,) if quick else _STEPS_MM[:4]:
        yield _marched(air, bundle, March(step, "leapfrog", "single", first_order=True))
    yield from _fixed_steps(air, bundle, quick)
    for tolerance in _TOLERANCES_MM[1:2] if quick else _TOLERANCES_MM:
        for precision in _PRECISIONS[:1] if quick else _PRECISIONS:
            march = March(_LONGEST_MM, "dopri5", precision, tolerance_mm=tolerance)
            yield _marched(air, bundle, march, controlled=True)
    linear, flat = {"interpolation": "linear"}, {"dimensions": 2}
    steps = (4.0,) if quick else _STEPS_MM
    both = () if quick else (2.0,)
    for model, lengths in ((linear, steps), (flat, steps), (linear | flat, both)):
        for step in lengths:
            yield _marched(air, bundle, March(step, "leapfrog", "single"), model)


def _fixed_steps(field: Field, bundle: Bundle, quick: bool) -> Iterator[Configuration]:
    """Each method with several steps, in both precisions."""
    for method in STEPPERS:
        for step in (4.0,) if quick else _EULER_STEPS_MM if method == "euler" else _STEPS_MM:
            for precision in _PRECISIONS[:1] if quick else _PRECISIONS:
                yield _marched(field, bundle, March(step, method, precision))


def _marched(
    field: Any,
    bundle: Bundle,
    march: March,
    model: dict[str, Any] | None = None,
    controlled: bool = False,
) -> Configuration:
    """A march through a field, or through what its `IndexField.simplified` makes of it."""
    transport = "first_order" if march.first_order else "marched"
    length = {"tolerance_mm": march.tolerance_mm} if controlled else {"step_mm": march.step_mm}
    return Configuration(
        transport if march.first_order else march.method,
        transport,
        lambda: prepare(field.simplified(**model) if model else field, bundle, march),
        length | {"precision": march.precision} | (model or {}),
        {"transport": transport, "method": march.method, "step_mm": march.step_mm},
    )


def _tabulated(scene: Scene, bundle: Bundle, quick: bool) -> Iterator[Configuration]:
    """By tables, whose making is in the time."""
    for tolerance in _TABLES_PX[:1] if quick else _TABLES_PX:
        work, make = tabulated_ends(scene, bundle, tolerance)

        def note(make: Callable[[], object] = make) -> str:
            seconds, _ = timed(make, 3)
            return f"of it, making the table takes {seconds:.2g} s, whatever the number of rays"

        yield Configuration(
            "tabulated",
            "tabulated",
            lambda work=work: work,  # type: ignore[misc]
            {"tolerance_px": tolerance},
            {"transport": "tabulated", "march": str(scene.transport.march)},
            note=note,
        )
