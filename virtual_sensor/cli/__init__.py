"""The command `virtual-sensor`: arguments to studies, results to files and a terminal.

Signals are handled before anything else is imported, which takes a second.
"""

import atexit
import os
from typing import Any

from virtual_sensor import interrupts

__all__ = ["app", "main"]


def main() -> None:
    """Run the command that `sys.argv` gives, and exit with its status."""
    ours = interrupts.install()
    for number in range(3):  # a stream that is closed would be the next file that is opened
        try:
            os.fstat(number)
        except OSError:
            os.open(os.devnull, os.O_RDWR)

    from virtual_sensor.cli.commands import run

    status = run()
    if ours:
        # Python's own end takes the handlers away, while libraries may still abort or hang.
        atexit._run_exitfuncs()
        os._exit(status)
    raise SystemExit(status)


def __getattr__(name: str) -> Any:
    if name != "app":
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    from virtual_sensor.cli.commands import app

    return app
