"""An object as a file, by the file's suffix, and its columns as a data frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from enum import Enum, IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed
from virtual_sensor.errors import InputError
from virtual_sensor.files import written_whole
from virtual_sensor.records import Table, plain, status_names, write_csv, write_json

Writer = Callable[[Path, Any], None]

PICTURES = (".png", ".svg", ".pdf")
_AXES = {2: "uv", 3: "xyz"}
_MOST_NUMBERS = 16  # of an array in one cell's place: a pose's matrix, a lens's coefficients


def data_frame(thing: Displayed) -> Any:
    """The columns of an object as a `pandas.DataFrame`.

    Raises
    ------
    InputError
        If pandas is not installed.
    """
    try:
        import pandas
    except ImportError:
        raise InputError("to_dataframe: pandas is missing; pip install pandas") from None
    return pandas.DataFrame(columns_of(thing))


def save(thing: Displayed, path: str | Path) -> Path:
    """Write an object to a file, by its suffix; see `Displayed.save`."""
    path = Path(path)
    writers = formats_of(thing)
    write = writers.get(path.suffix.lower())
    if write is None:
        *others, last = sorted(writers)
        raise InputError(
            f"{path}: a {type(thing).__name__} is written as {', '.join(others)} or {last}, as the"
            " file's suffix says"
        )
    write(path, thing)
    return path


def formats_of(thing: Displayed) -> dict[str, Writer]:
    """What an object is written by, for each suffix of a file."""
    from virtual_sensor.reporting import objects

    found: dict[str, Writer] = {".csv": _write_csv, ".json": _write_json, ".npz": _write_npz}
    if objects.drawing_of(thing):
        found |= dict.fromkeys(PICTURES, objects.write_picture)
    for names in reversed(list(objects.names_of(thing))):
        found |= _OWN.get(names, {})
    return found


# ------------------------------------------------------------------------------------- columns


def columns_of(thing: Displayed) -> dict[str, NDArray[Any]]:
    """Columns of equal length by their names: its own, those of its arrays, or one row of all."""
    if isinstance(thing, Table):
        return thing.columns()
    if own := getattr(thing, "_columns", None):
        return {name: _named(thing, name, np.asarray(values)) for name, values in own().items()}
    if thing._by_row:
        return dict(_row_columns(thing))
    return {name: np.array([value]) for name, value in _cells(thing, "")}


def _row_columns(thing: Displayed) -> Iterator[tuple[str, NDArray[Any]]]:
    """A column for each number of each row: of arrays whose shapes begin with the rows' shape."""
    held = dict(_public(thing))
    arrays = {name: value for name, value in held.items() if isinstance(value, np.ndarray)}
    shape = arrays["status"].shape if "status" in arrays else next(iter(arrays.values())).shape[:1]
    for name, array in arrays.items():
        if array.shape == shape:
            yield name, _named(thing, name, array.ravel())
        elif array.shape[:-1] == shape:
            axes = _AXES.get(array.shape[-1], range(array.shape[-1]))
            for i, axis in enumerate(axes):
                yield f"{name}_{axis}", array[..., i].ravel()


def _cells(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The numbers and words of an object, each under its name, objects within it too."""
    inner = f"{name}_" if name else ""
    if isinstance(value, IntEnum):
        yield name, value.name.lower()
    elif isinstance(value, Enum):
        yield from _cells(value.value, name)
    elif isinstance(value, bool | int | float | str | np.generic):
        yield name, value
    elif isinstance(value, Path):
        yield name, str(value)
    elif isinstance(value, np.ndarray | list | tuple):
        array = np.asarray(value) if not isinstance(value, np.ndarray) else value
        if array.ndim == 0:
            yield name, array.item()
        elif array.size <= _MOST_NUMBERS and array.dtype.kind in "bufiU":
            axes = _AXES.get(array.size, range(array.size)) if array.ndim == 1 else None
            for i, index in enumerate(np.ndindex(array.shape)):
                axis = axes[i] if axes else "".join(map(str, index))
                yield f"{inner}{axis}", array[index]
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _cells(each, f"{inner}{key}")
    elif dataclasses.is_dataclass(value):
        for key, each in _public(value):
            yield from _cells(each, f"{inner}{key}")


def _public(thing: Any) -> Iterator[tuple[str, Any]]:
    """The fields of an object that are data for others."""
    for each in dataclasses.fields(thing):
        if not each.name.startswith("_") and not each.metadata.get("internal"):
            yield each.name, getattr(thing, each.name)


def _named(thing: Any, name: str, value: Any) -> Any:
    """Numbers of a status as names; all else as it is."""
    kind = getattr(thing, "_statuses", {}).get(name)
    if kind is None:
        return value
    if isinstance(value, Mapping):
        return {key: _named(thing, name, each) for key, each in value.items()}
    names = status_names(value, kind).reshape(np.shape(value))
    return names if names.ndim else str(names)


# --------------------------------------------------------------------------------------- files


def _write_csv(path: Path, thing: Displayed) -> None:
    write_csv(path, columns_of(thing))


def _write_json(path: Path, thing: Displayed) -> None:
    write_json(path, _tree(thing))


def _tree(value: Any) -> Any:
    """An object as JSON has it, statuses by their names; what is no data is left out."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        found = {name: _tree(_named(value, name, each)) for name, each in _public(value)}
        return {name: each for name, each in found.items() if each is not _NO_DATA}
    if isinstance(value, Mapping):
        return {str(key): _tree(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_tree(each) for each in value]
    found = plain(value)
    return (
        found if found is None or isinstance(found, bool | int | float | str | list) else _NO_DATA
    )


_NO_DATA = object()


def _write_npz(path: Path, thing: Displayed) -> None:
    arrays: dict[str, Any] = dict(_arrays(thing, ""))
    with written_whole(path) as temporary, temporary.open("wb") as file:
        np.savez_compressed(file, **arrays)


def _arrays(value: Any, name: str) -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays, numbers and words of an object, as NumPy's, each under its name."""
    inner = f"{name}_" if name else ""
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "bufiU":
            yield name, value
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _arrays(each, f"{inner}{key}")
    elif dataclasses.is_dataclass(value):
        for key, each in _public(value):
            yield from _arrays(_named(value, key, each), f"{inner}{key}")
    elif isinstance(value, list | tuple) and value and dataclasses.is_dataclass(value[0]):
        for i, each in enumerate(value):
            yield from _arrays(each, f"{inner}{i}")
    elif value is not None and isinstance(value, bool | int | float | str | list | tuple | Path):
        array = np.asarray(str(value) if isinstance(value, str | Path) else value)
        if array.dtype.kind in "bufiU":
            yield name, array


_OWN: dict[str, dict[str, Writer]] = {}
"""Formats of its own that an object has, by its class's name (see `objects.names_of`)."""
