"""Charts that nobody measured."""

import numpy as np

from virtual_sensor.studies.chart.benchmark import Measured, with_fronts
from virtual_sensor.studies.chart.chart import PANELS, Chart
from virtual_sensor.studies.chart.failures import table
from virtual_sensor.studies.chart.scaling import power
from virtual_sensor.studies.machine import Machine
from virtual_sensor.studies.provenance import made_with

NASTY = "<script>&\"'"


def measured(
    name="leapfrog", time_s=1e-6, error_px=1e-3, panel="rays", task="a job", failed=0, **chosen
):
    """A configuration; `chosen` may hold `bound_px`."""
    bound_px = chosen.pop("bound_px", 0.0)
    um = 22.0 * error_px if panel != "lines" else np.nan
    values = (error_px, 3.0 * error_px, um, time_s, 1000, failed)
    kind = "tabulated" if name == "tabulated" else "marched"
    more = {"variant": "llvm"}
    words = "float64, say"
    return Measured(panel, task, name, kind, chosen, more, *values, words, bound_px, note=NASTY)


def failures():
    """A table of two failures."""
    row = {
        "panel": "rays",
        "trouble": "trouble one",
        "method": "leapfrog",
        "unit": "mm",
        "mildest": 1.0,
        "severest": 8.0,
        "reported_from": "",
        "reported": 0,
        "reports": "",
        "wrong_from": 4.0,
        "wrong": 3,
        "largest_error_px": 0.02,
        "items": 10,
        "conditions": "as ever",
        "note": "a note",
    }
    reported = {"trouble": f"trouble {NASTY}", "reported_from": 2.0, "reports": "OUT_OF_STEPS"}
    return table([row, row | reported])


def chart():
    """Four panels of two tasks, with a configuration whose error nobody knows."""
    rng = np.random.default_rng(3)
    rows = [
        measured(
            name,
            10.0 ** rng.uniform(-7, -4),
            10.0 ** rng.uniform(-5, 0),
            panel,
            task,
            bound_px=1e-3 if panel == "lines" else 0.0,
            step_mm=float(step),
            precision=precision,
        )
        for panel in PANELS
        for task in ("the main job", f"another job {NASTY}")
        for name in ("euler", "rk4", "tabulated")
        for precision in ("single", "double")
        for step in (1, 2, 4)
    ]
    rows.append(measured("unknown", error_px=np.nan, task="the main job"))
    scalings = (
        *power("frame, samples", {1.0: 0.5, 4.0: 1.5}, f"about {NASTY}"),
        *power("frame, nodes", {1.0: 0.5}),
    )
    machine = Machine("today", f"an {NASTY} abacus", 2, 2, "none", 0.1, made_with())
    return Chart(with_fronts(rows), scalings, failures(), 9.0, machine, (f"a note {NASTY}",), 12.0)
