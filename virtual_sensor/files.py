"""Results are written whole or not at all: files beside their place first, folders likewise."""

import os
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from virtual_sensor.errors import InputError


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """A temporary file to write; it takes its place when all went well and is removed if not."""
    temporary = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        yield temporary
        temporary.replace(path)
    finally:
        temporary.unlink(missing_ok=True)


@contextmanager
def folder_written_whole(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """A temporary folder to fill; it takes its place when all went well and is removed if not.

    Raises
    ------
    InputError
        If the folder exists and `overwrite` is not set, or its parent can't be written.
    """
    path = path.absolute()
    if path.exists() and not overwrite:
        raise InputError(f"{path}: the output folder exists; name another, or say --overwrite")
    if path.exists() and not path.is_dir():
        raise InputError(f"{path}: the output folder's name belongs to a file; name another")
    temporary = path.with_name(f".{path.name}.{os.getpid()}.unfinished")
    try:
        temporary.mkdir(parents=True)
    except OSError as error:
        raise InputError(
            f"{path}: the output folder can't be made ({error.strerror}); choose one where you may"
            " write"
        ) from None
    try:
        yield temporary
        old = path.with_name(f".{path.name}.{os.getpid()}.old")
        if path.exists():
            path.replace(old)
        temporary.replace(path)
        shutil.rmtree(old, ignore_errors=True)
    except OSError as error:
        raise InputError(
            f"{path}: the results can't be written ({error.strerror or error}); nothing was kept"
        ) from error
    finally:
        shutil.rmtree(temporary, ignore_errors=True)
