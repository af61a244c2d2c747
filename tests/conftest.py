"""What holds for all tests: Ctrl-C is heard, and as many run side by side as the machine has cores.

pytest-xdist's workers get whole files, so that what a module's fixtures make is made once. Each
worker computes with its share of the cores. A run of single files is done by this process.
"""

import contextlib
import gc
import os
import signal
from collections import Counter
from pathlib import Path

import pytest

from virtual_sensor.cli import GC_THRESHOLD

# Started in the background of a shell, Ctrl-C is ignored, and by the commands that tests start too.
signal.signal(signal.SIGINT, signal.default_int_handler)

CORES = len(os.sched_getaffinity(0))
MOST_WORKERS = 4  # each needs about 1 GB

if workers := int(os.environ.get("PYTEST_XDIST_WORKER_COUNT", "0")):
    os.environ.pop("COLUMNS", None)  # readline leaves it to workers; a console would go by it
    share = str(max(1, CORES // workers))
    for name in ("VIRTUAL_SENSOR_THREADS", "OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
        os.environ.setdefault(name, share)


def pytest_collection_modifyitems(items):
    """Begin with the files that have slow tests: none of them is left when all else is done."""
    if workers:
        slow = Counter(item.path for item in items if item.get_closest_marker("slow"))
        tests = Counter(item.path for item in items)
        items.sort(key=lambda item: (-slow[item.path], -tests[item.path], item.path))


def pytest_collection_finish():
    """Collect garbage as seldom as the commands do, and of no module that stays."""
    gc.freeze()
    gc.set_threshold(GC_THRESHOLD)


def pytest_xdist_auto_num_workers(config):
    """How many `-n auto` starts."""
    folders = [given for given in config.args if Path(given.partition("::")[0]).is_dir()]
    return min(CORES, MOST_WORKERS) if folders else 0


@pytest.fixture(scope="session")
def without_paint():
    """Pictures in this context have their panels drawn but not painted: half a command's time.

    For tests of what is computed, saved and said; what pictures show, others look at.
    """

    @contextlib.contextmanager
    def unpainted():
        import numpy as np

        from virtual_sensor.reporting import pictures

        def blank(figure):
            width, height = figure.canvas.get_width_height()
            return np.full((height, width, 3), 255, np.uint8)

        with pytest.MonkeyPatch.context() as patch:
            patch.setattr(pictures, "_pixels", blank)
            yield

    return unpainted


@pytest.fixture(scope="module")
def unpainted(without_paint):
    """No picture of a module is painted."""
    with without_paint():
        yield


@pytest.fixture
def unpainted_test(without_paint):
    """No picture of a test is painted."""
    with without_paint():
        yield
