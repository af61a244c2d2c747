"""Results are written whole or not at all: in a hidden folder beside their place first.

And only regular files are read: a FIFO would block for ever.
"""

import os
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from virtual_sensor.errors import InputError

RESULTS_SIGN = "summary.json"
"""A folder with this file holds results and may be replaced; what else it is, nobody knows."""


_KINDS = {
    stat.S_IFDIR: "a folder",
    stat.S_IFIFO: "a pipe",
    stat.S_IFSOCK: "a socket",
    stat.S_IFCHR: "a device",
    stat.S_IFBLK: "a device",
}


def exists(path: Path) -> bool:
    """Whether something is there; a text that can't be a file's name is nothing."""
    try:
        return path.exists()
    except (OSError, ValueError):
        return False


def readable(path: Path) -> Path:
    """Give a path back if a reader may open it; to be asked by each before it does.

    Raises
    ------
    InputError
        If there is no such file, it may not be read, or it is no regular file: opening a FIFO or
        reading a device may wait for ever.
    """
    try:
        mode = path.stat().st_mode
    except (OSError, ValueError) as error:  # ValueError: a zero byte in the name
        raise InputError(
            f"{path}: can't be read ({getattr(error, 'strerror', None) or error}); is it the right"
            " path?"
        ) from None
    if not stat.S_ISREG(mode):
        kind = _KINDS.get(stat.S_IFMT(mode), "no regular file")
        raise InputError(f"{path}: is {kind}; give a regular file")
    if not os.access(path, os.R_OK):
        raise InputError(f"{path}: can't be read (Permission denied); change its permissions")
    return path


def check_output(path: Path, overwrite: bool, folder: bool = False) -> None:
    """Refuse an output that must not or can't be written; to be asked before any work is done.

    Raises
    ------
    InputError
        If it exists and `overwrite` is not set, `overwrite` would destroy something else than
        earlier results, or its place can't be written.
    """
    with _told(path):
        if path.exists():
            if not overwrite:
                raise InputError(f"{path}: exists; name another with -o, or say --overwrite")
            if not (path.is_dir() if folder else path.is_file()):
                raise InputError(f"{path}: is not a {'folder' if folder else 'file'}; name another")
            if folder and any(path.iterdir()) and not (path / RESULTS_SIGN).exists():
                raise InputError(
                    f"{path}: holds other files than results (there is no {RESULTS_SIGN}), which"
                    " --overwrite would delete; name another with -o"
                )
        place = next(p for p in path.absolute().parents if p.exists())
        with tempfile.TemporaryDirectory(dir=place):
            pass


@contextmanager
def written_whole(path: Path) -> Iterator[Path]:
    """Give a temporary file to write; it takes its place when all went well, else it is removed.

    Raises
    ------
    InputError
        If the file can't be written.
    """
    with _beside(path) as workshop:
        if path.exists() and not path.is_file():
            raise InputError(f"{path}: is not a file; name another")
        new = workshop / path.name
        try:
            yield new
        except RuntimeError as error:  # OpenEXR's, where others raise OSError
            raise OSError(f"{error}") from error
        new.replace(path.resolve())


@contextmanager
def folder_written_whole(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """Give a temporary folder to fill; it takes its place when all went well, else it is removed.

    Raises
    ------
    InputError
        As `check_output`, and if what it is filled with can't be written.
    """
    check_output(path, overwrite, folder=True)
    final = path.resolve()
    with _beside(path) as workshop:
        new, old = workshop / "new", workshop / "old"
        new.mkdir()
        try:
            yield new
        except InputError as error:
            raise InputError(f"{error}".replace(f"{new}", f"{path}")) from error
        try:
            if overwrite and final.exists():
                final.replace(old)
            new.replace(final)
        finally:
            if old.exists() and not final.exists():
                old.replace(final)


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """Give a hidden folder on the same disk, which is removed in the end with all it holds."""
    with _told(path):
        parent = path.resolve().parent
        parent.mkdir(parents=True, exist_ok=True)
        with tempfile.TemporaryDirectory(
            ".unfinished", f".{path.name}.", parent, ignore_cleanup_errors=True
        ) as folder:
            yield Path(folder)


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Tell what the system refuses in a user's terms."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{path}: can't be written ({error.strerror or error}); nothing was kept. Make room, or"
            " choose a place where you may write"
        ) from error
