"""Finished work is kept in folders that are named by a hash of all that went into it."""

import ast
import hashlib
import importlib.util
import json
from collections.abc import Callable, Iterator, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor import engine
from virtual_sensor.errors import InputError
from virtual_sensor.files import folder_written_whole, settle, written_whole

_PACKAGE, _PLUGINS = "virtual_sensor", "virtual_sensor_plugins"
_HOUSE = Path(engine.__file__).parent
_MEASURING = f"{_PACKAGE}.studies.sweep"
_IMPORTS = ast.Import | ast.ImportFrom
_PACKAGES = (
    *("mitsuba", "drjit", "numpy", "scipy", "matplotlib"),
    *("opencv-contrib-python-headless", "OpenEXR", "trimesh"),
)
_DIGITS = 16


@cache
def fingerprint() -> str:
    """Hash of the program that measures: its sources, the packages it stands on, the variant.

    What another version might compute otherwise must not be taken for this one's.
    """
    digest = hashlib.sha256()
    for name, file in sources(_MEASURING).items():
        digest.update(f"{name}\0".encode())
        digest.update(hashlib.sha256(file.read_bytes()).digest())
    for package in _PACKAGES:
        digest.update(f"{package} {_version(package)}\0".encode())
    digest.update(engine.activate().variant.encode())
    return digest.hexdigest()


@cache
def sources(module: str) -> dict[str, Path]:
    """Files of a module and of all of ours that it imports, inside functions too, by their names.

    Mitsuba asks for the plugins by name, and so all of them belong to every module.
    """
    plugins = _file_of(_PLUGINS).parent
    open_names = [module, *(f"{_PLUGINS}.{file.stem}" for file in plugins.glob("[!_]*.py"))]
    files: dict[str, Path] = {}
    while open_names:
        name = open_names.pop()
        file = _file_of(name)
        if name not in files and file.is_file():
            files[name] = file
            open_names += _imported(file)
    return dict(sorted(files.items()))


def _imported(file: Path) -> Iterator[str]:
    """Names that may be modules of ours among what a file imports, and the packages they lie in."""
    for node in ast.walk(ast.parse(file.read_text(encoding="utf-8"))):
        names = [alias.name for alias in node.names] if isinstance(node, _IMPORTS) else []
        if isinstance(node, ast.ImportFrom):
            names = [f"{node.module}.{name}" for name in names]
        for name in names:
            parts = name.split(".")
            if parts[0] in (_PACKAGE, _PLUGINS):
                yield from (".".join(parts[: n + 1]) for n in range(len(parts)))


def _file_of(module: str) -> Path:
    """Where a module of ours lies, if it is one."""
    package, *parts = module.split(".")
    folder = _HOUSE if package == _PACKAGE else _plugins_folder()
    place = folder.joinpath(*parts)
    return place / "__init__.py" if place.is_dir() else place.with_suffix(".py")


@cache
def _plugins_folder() -> Path:
    found = importlib.util.find_spec(_PLUGINS)
    assert found is not None
    assert found.submodule_search_locations is not None
    return Path(found.submodule_search_locations[0])


def _version(package: str) -> str:
    """A package's version; of OpenCV there are several, of which one is enough."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "none"


def key_of(inputs: Mapping[str, Any]) -> str:
    """Short hexadecimal key of inputs and program: equal if, and only if, all of it is equal.

    Parameters
    ----------
    inputs : Mapping
        What JSON can say, and besides it paths and NumPy's numbers and arrays.

    Raises
    ------
    TypeError
        If there is something else in it, whose text might differ from one process to the next.
    """
    text = json.dumps(inputs, sort_keys=True, separators=(",", ":"), default=_plain)
    return hashlib.sha256(f"{fingerprint()}{text}".encode()).hexdigest()[:_DIGITS]


def _plain(value: object) -> object:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} {value!r} has no place among the inputs of kept work")


@cache
def _hash_of(path: Path, size: int, mtime_ns: int) -> str:
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def file_hash(path: Path) -> str:
    """Hash of a file's content; read once, as long as its size and time stay the same.

    Raises
    ------
    InputError
        If it can't be read.
    """
    try:
        state = path.stat()
        return _hash_of(path.absolute(), state.st_size, state.st_mtime_ns)
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror or error})") from None


def found(folder: Path, key: str) -> Path | None:
    """The finished work of this key, under whatever name it was kept; None if there is none."""
    return min(folder.glob(f"*-{key}"), default=None)


def kept(folder: Path, name: str, inputs: Mapping[str, Any], make: Callable[[Path], None]) -> Path:
    """The finished work of these inputs, made now if it is not there.

    Parameters
    ----------
    folder : Path
        Where finished work is kept.
    name : str
        For people who look there: it becomes ``folder/name-key``.  Work that is there under
        another name is the same work.
    inputs : Mapping
        All that the work depends on but the program (see `key_of`).
    make : callable
        Fills the folder that it is given.  It is moved to its place only when this went well.

    Returns
    -------
    Path
        Of a folder.  Of two processes that make the same at once, the first one's stays.

    Raises
    ------
    InputError
        As `make` does, or if the folder can't be written.
    """
    key = key_of(inputs)
    settle(folder)  # also the same work's under another name
    place = found(folder, key)
    if place is None:
        place = folder / f"{name}-{key}"
        try:
            with folder_written_whole(place) as new:
                make(new)
        except InputError:
            if not place.is_dir():  # else another process was faster
                raise
    return place


def own_folder(folder: Path, mark: str, words: str) -> None:
    """Take a folder that is new, empty or one's own, by a file that says whose it is.

    Raises
    ------
    InputError
        If it holds something else, or can't be written.
    """
    settle(folder)
    sign = folder / mark
    if sign.is_file():
        return
    if folder.exists() and not folder.is_dir():
        raise InputError(f"{folder}: is not a folder; name another with -o")
    # What a run that begins at this moment has hidden is its own, too.
    if folder.is_dir() and any(not file.match(f".{mark}.*") for file in folder.iterdir()):
        raise InputError(f"{folder}: holds other files (there is no {mark}); name another with -o")
    with written_whole(sign) as temporary:
        temporary.write_text(words, encoding="utf-8")
