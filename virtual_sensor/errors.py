"""The errors that a user is meant to read: each names the file, the element and the remedy."""


class InputError(ValueError):
    """A scene, a field, an option or an output folder that the program cannot work with."""


class EngineError(RuntimeError):
    """Dr.Jit or Mitsuba cannot run on this machine as things stand."""
