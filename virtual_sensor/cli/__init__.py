"""The command `virtual-sensor`: arguments to studies, results to files and a terminal.

Signals are handled before anything else is imported, which takes a second.
"""

import atexit
import gc
import os
import sys
from typing import Any

from virtual_sensor import interrupts

__all__ = ["app", "main"]

GC_THRESHOLD = 50_000  # objects since the last collection; Python's 700 cost 8 % of `measure`


def main() -> None:
    """Run the command that `sys.argv` gives, and exit with its status."""
    ours = interrupts.install()
    gc.set_threshold(GC_THRESHOLD)  # libraries make many objects while they load, which all stay
    for number in range(3):  # a stream that is closed would be the next file that is opened
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)

    status = _run()
    if ours:
        # Python's own end takes the handlers away, while libraries may still abort or hang.
        atexit._run_exitfuncs()
        os._exit(status)
    raise SystemExit(status)


def _run() -> int:
    try:
        os.getcwd()  # noqa: PTH109
    except OSError as error:  # Mitsuba would abort
        sys.stderr.write(f"Error: the working folder is gone ({error.strerror}); go to another\n")
        return 2

    from virtual_sensor.cli.commands import run

    try:
        return run()
    except Exception:
        sys.excepthook(*sys.exc_info())
        return 1


def __getattr__(name: str) -> Any:
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from virtual_sensor.cli.commands import app

    return app
