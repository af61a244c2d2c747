"""The data dictionary: the program that writes it, and what of a folder it does not list."""

import csv
import importlib.util
import json
from pathlib import Path
from types import UnionType
from typing import Union, get_args, get_origin, get_type_hints

from virtual_sensor.records import Record
from virtual_sensor.reporting.files import file_of

DOCS = Path(__file__).parents[1] / "docs"
_AXES = {f"_{axis}" for axis in (*"xyzuv", "norm")}


def maker():
    """The program that writes the page."""
    spec = importlib.util.spec_from_file_location("maker", DOCS / "make_data_dictionary.py")
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def undocumented(folder, files):
    """What a folder of results holds and no dictionary lists: files, columns, keys."""
    found = []
    for path in sorted(p for p in folder.rglob("*") if p.is_file()):
        name = path.relative_to(folder).as_posix()
        file = file_of(files, name)
        if file is None:
            found.append(name)
        elif isinstance(file.kind, type) and path.suffix == ".csv":
            known = _column_names(file.fields)
            found += [f"{name}: {each}" for each in _csv_names(path) if each not in known]
        elif isinstance(file.kind, type) and path.suffix == ".json":
            value = json.loads(path.read_text(encoding="utf-8"))
            found += [f"{name}: {each}" for each in _unknown(value, file.kind, "")]
    return found


def _column_names(fields):
    names = {each.name for each in fields}
    return names | {name + axis for name in names for axis in _AXES}


def _csv_names(path):
    with path.open(encoding="utf-8", newline="") as file:
        return next(csv.reader(file))


def _unknown(value, hint, above):
    """Keys of an object that no record of its type has, with dots."""
    arguments = [kind for kind in get_args(hint) if kind not in (type(None), Ellipsis)]
    if isinstance(hint, type) and issubclass(hint, Record) and isinstance(value, dict):
        hints = get_type_hints(hint)
        for key, each in value.items():
            if key in hints:
                yield from _unknown(each, hints[key], f"{above}{key}.")
            else:
                yield f"{above}{key}"
    elif isinstance(hint, UnionType) or get_origin(hint) is Union:
        yield from min((list(_unknown(value, kind, above)) for kind in arguments), key=len)
    elif isinstance(value, dict) and arguments:
        for key, each in value.items():
            yield from _unknown(each, arguments[-1], f"{above}{key}.")
    elif isinstance(value, list) and arguments:
        for each in value:
            yield from _unknown(each, arguments[0], above)
