"""Write ``reference/data_dictionary.md``: ``python docs/make_data_dictionary.py``."""

import pkgutil
from collections.abc import Mapping, Sequence
from importlib import import_module
from pathlib import Path

from virtual_sensor import reporting
from virtual_sensor.records import Described, documented
from virtual_sensor.reporting.files import FileOf
from virtual_sensor.reporting.tables import TextTable

PAGE = Path(__file__).parent / "reference/data_dictionary.md"


def files() -> dict[str, tuple[FileOf, ...]]:
    """The files of each command: `FILES` of the modules in `reporting`, by their `COMMAND`."""
    found = {}
    for each in pkgutil.iter_modules(reporting.__path__):
        module = import_module(f"{reporting.__name__}.{each.name}")
        if hasattr(module, "FILES"):
            command = getattr(module, "COMMAND", each.name.replace("_", " "))
            found[command] = tuple(module.FILES)
    return found


def dictionary(files: Mapping[str, Sequence[FileOf]]) -> str:
    """The data dictionary in Markdown: command by command, then the objects within JSON files."""
    parts = [
        "# Data dictionary\n\nEvery file that a command writes, with its columns, keys and layers."
        " Names end with their unit. CSV columns of vectors end with their axis: `point_mm` is"
        " `point_mm_x`, `point_mm_y`, `point_mm_z`, and `pixel` is `pixel_u`, `pixel_v`. What has"
        " no answer is an empty cell, or `null`. Objects within an object are listed"
        " [at the end](#objects), each once.\n"
    ]
    objects: dict[str, type] = {}
    for command, written in files.items():
        parts.append(f"## {command}\n")
        for each in written:
            parts.append(f"### {each.pattern}\n\n{each.words}\n".replace("*", "\\*"))
            parts += _listed(each.fields, objects)
    parts.append("## Objects\n")
    done: set[str] = set()
    while waiting := sorted(objects.keys() - done):
        name = waiting[0]
        done.add(name)
        words = (objects[name].__doc__ or "").splitlines()[0]
        parts += [f"### {name}\n\n{words}\n", *_listed(documented(objects[name]), objects)]
    return "\n".join(parts)


def _listed(fields: Sequence[Described], objects: dict[str, type]) -> list[str]:
    """A table of fields, if there are any; records within them are added to `objects`."""
    if not fields:
        return []
    rows = []
    for each in fields:
        objects |= {kind.__name__: kind for kind in each.records}
        links = ", ".join(f"[{kind.__name__}](#{kind.__name__.lower()})" for kind in each.records)
        rows.append((f"`{each.name}`", each.unit, f"{each.words} {links}".strip()))
    return [TextTable(("name", "unit", "what it is"), tuple(rows)).markdown().replace("\\`", "`")]


if __name__ == "__main__":
    PAGE.write_text(dictionary(files()), encoding="utf-8")
