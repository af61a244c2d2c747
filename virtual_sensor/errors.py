"""The errors that a user is meant to read: each names the file, the element and the remedy."""

from pathlib import Path


class InputError(ValueError):
    """A scene, a field, an option or an output folder that the program cannot work with."""


class EngineError(RuntimeError):
    """Dr.Jit or Mitsuba cannot run on this machine as things stand."""


class Interrupted(SystemExit):
    """A run was stopped by Ctrl-C or a signal, in good order: the same command goes on.

    Its text tells so, `code` is the status to exit with, `time_s` the flow time reached, s.
    """

    def __init__(self, folder: Path, time_s: float, code: int) -> None:
        super().__init__(code)
        self.time_s = time_s
        self.told = f"stopped at {time_s:.8g} s of flow; the same command goes on ({folder})"

    def __str__(self) -> str:
        return self.told
