"""The cache of finished cases: folders that are named by hashes of all that went into them.

``name-INPUTS-PROGRAM``: a hash of the inputs and one of the program. A case that another program
has made of the same inputs is not used; it is removed when this one has made it again.
"""

import hashlib
import importlib.util
import json
import platform
import re
from collections.abc import Callable, Mapping
from functools import cache
from importlib import metadata
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor import engine
from virtual_sensor.errors import InputError
from virtual_sensor.files import discard, folder_written_whole, settle, sha256_of, written_whole

_DISTRIBUTION = "virtual-sensor"
_PACKAGES = {  # and what of their files belongs to the program: a scene's are inputs of its case
    "virtual_sensor": "*",
    "virtual_sensor_plugins": "*",
    "virtual_sensor_scenes": "*.py",
}
_INPUT_DIGITS, _PROGRAM_DIGITS = 16, 8


@cache
def fingerprint() -> str:
    """Hash of the program: its packages' files, what it requires, Python, and the engine.

    What another version might compute otherwise must not be taken for this one's.

    Raises
    ------
    InputError
        If the program is not installed, so that nobody knows what it requires.
    """
    running = engine.activate()
    llvm = f"LLVM {running.llvm.version}" if running.llvm else "no LLVM"
    python = f"Python {platform.python_version()}"
    parts = [content_of(program()), *requirements(), python, running.variant, llvm]
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:_PROGRAM_DIGITS]


def program() -> dict[Path, str]:
    """The folders that the program lies in, and the patterns of the files in them."""
    return {_folder_of(package): pattern for package, pattern in _PACKAGES.items()}


def content_of(folders: Mapping[Path, str]) -> str:
    """Hash of the files in folders that match a pattern each: their names there, and their bytes.

    Where the folders lie, when a file was written, and what Python compiled does not matter.
    """
    digest = hashlib.sha256()
    for folder, pattern in folders.items():
        names = {file.relative_to(folder).as_posix(): file for file in folder.rglob(pattern)}
        for name, file in sorted(names.items()):
            if file.is_file() and not re.search(r"(^|/)(\.|__pycache__/)|\.pyc$", name):
                digest.update(f"{name}\0".encode())
                digest.update(hashlib.sha256(file.read_bytes()).digest())
        digest.update(b"\0")
    return digest.hexdigest()


def requirements() -> list[str]:
    """Names and versions of the packages that the program requires, its extras left out.

    Raises
    ------
    InputError
        If the program is not installed.
    """
    try:
        required = metadata.requires(_DISTRIBUTION) or []
    except metadata.PackageNotFoundError:
        raise InputError(
            f"{_DISTRIBUTION} is not installed, so that nobody knows with which packages finished"
            " cases were made; install it: pip install ."
        ) from None
    names = [
        re.split(r"[^\w.-]", text, maxsplit=1)[0] for text in required if "extra ==" not in text
    ]
    return sorted(f"{name}=={_version(name)}" for name in names)


def _folder_of(package: str) -> Path:
    found = importlib.util.find_spec(package)
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
    """Key of inputs and program, two hashes: equal if, and only if, all of it is equal.

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
    return f"{hashlib.sha256(text.encode()).hexdigest()[:_INPUT_DIGITS]}-{fingerprint()}"


def _plain(value: object) -> object:
    if isinstance(value, (np.ndarray, np.generic)):
        return value.tolist()
    if isinstance(value, Path):
        return str(value)
    raise TypeError(f"{type(value).__name__} {value!r} has no place among the inputs of a case")


@cache
def _hash_of(path: Path, size: int, mtime_ns: int) -> str:
    return sha256_of(path)


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


def find(folder: Path, key: str) -> Path | None:
    """The finished case of this key, under whatever name; None if there is none."""
    return min(folder.glob(f"[!.]*-{key}"), default=None)


def of_other_programs(folder: Path, key: str | None = None) -> list[Path]:
    """Cases that another program has finished: of a key's inputs, or by default of any."""
    pattern = f"[!.]*-{key.partition('-')[0]}-*" if key else "[!.]*"
    return [case for case in folder.glob(pattern) if not case.name.endswith(f"-{fingerprint()}")]


def find_or_make(
    folder: Path, name: str, inputs: Mapping[str, Any], make: Callable[[Path], None]
) -> Path:
    """The finished case of these inputs, made now if it is not there.

    Parameters
    ----------
    folder : Path
        Where finished cases lie.
    name : str
        For people who open the folder: it becomes ``folder/name-key``.  A case that is there under
        another name is the same case.
    inputs : Mapping
        All that the case depends on but the program (see `key_of`).
    make : callable
        Fills the folder that it is given.  It is moved to its place only when this went well.

    Returns
    -------
    Path
        Of a folder.  Of two processes that make the same at once, the first one's stays; what
        another program has made of the same inputs goes.

    Raises
    ------
    InputError
        As `make` does, or if the folder can't be written.
    """
    key = key_of(inputs)
    settle(folder)  # also the same case's under another name
    place = find(folder, key)
    if place is None:
        place = folder / f"{name}-{key}"
        try:
            with folder_written_whole(place) as new:
                make(new)
        except InputError:
            if not place.is_dir():  # else another process was faster
                raise
        for old in of_other_programs(folder, key):
            discard(old)
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
    # The hidden files of a run that begins at this moment are its own, too.
    if folder.is_dir() and any(not file.match(f".{mark}.*") for file in folder.iterdir()):
        raise InputError(f"{folder}: holds other files (there is no {mark}); name another with -o")
    with written_whole(sign) as temporary:
        temporary.write_text(words, encoding="utf-8")
