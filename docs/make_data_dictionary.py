"""Write the data dictionary beside this file: ``python docs/make_data_dictionary.py``."""

import pkgutil
from importlib import import_module
from pathlib import Path

from virtual_sensor import reporting
from virtual_sensor.reporting.files import FileOf, dictionary

PAGE = Path(__file__).with_name("data_dictionary.md")


def files() -> dict[str, tuple[FileOf, ...]]:
    """The files of each command: `FILES` of the modules in `reporting`, by their `COMMAND`."""
    found = {}
    for each in pkgutil.iter_modules(reporting.__path__):
        module = import_module(f"{reporting.__name__}.{each.name}")
        if hasattr(module, "FILES"):
            command = getattr(module, "COMMAND", each.name.replace("_", " "))
            found[command] = tuple(module.FILES)
    return found


if __name__ == "__main__":
    PAGE.write_text(dictionary(files()), encoding="utf-8")
