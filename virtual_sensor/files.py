"""Results are written whole or not at all: in a hidden folder beside their place first.

The hidden folder is ``.NAME.RANDOM.unfinished``, and its process holds a lock in it. What a killed
run has left is put right when the same output is written next: see `settle`.

And only regular files are read: a FIFO would block for ever.
"""

import ctypes
import errno
import fcntl
import hashlib
import logging
import os
import re
import shutil
import stat
import tempfile
from collections.abc import Iterable, Iterator, Sequence
from contextlib import contextmanager, suppress
from pathlib import Path

from virtual_sensor import interrupts
from virtual_sensor.errors import InputError, few, short

RESULTS_SIGN = "summary.json"
"""A folder with this file holds results and may be replaced; what else it is, nobody knows."""

_LOCK = ".lock"
_NAMED = re.compile(r"\.(.+)\.[a-z0-9_]{8}\.unfinished", re.DOTALL)
_LONGEST_NAME = 100  # of a file, in a message that names several places
_MOST_NAMES = 8  # of files that there are
_AT_FDCWD, _RENAME_EXCHANGE = -100, 2  # of Linux's fcntl.h

_log = logging.getLogger(__name__)

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


def path_of(name: str, path: object) -> Path:
    """A path that a caller gives, as Path; raises InputError, naming it, if it is none."""
    if not isinstance(path, str | os.PathLike) or not str(path):
        raise InputError(f"{name} is {short(path)}; give a file's name, a text or a Path")
    return Path(path)


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


def named_file(
    name: str | Path,
    kind: str,
    suffix: str,
    folders: Iterable[Path],
    installed: Sequence[Path],
    remedy: str = "",
) -> Path:
    """Find a file by its path, or by its name without the suffix.

    Parameters
    ----------
    name : str or Path
        A path, absolute or from one of the folders; `~` is the user's home.
    kind, suffix : str
        What it is, such as "scene", and how its name ends, such as ".xml".
    folders : iterable of Path
        Looked in first, one after the other.
    installed : sequence of Path
        Folders of the program's own files, looked in last.
    remedy : str
        What else to do if there is no such file.

    Raises
    ------
    InputError
        If it is no name, or there is none: it names the places that were looked in, the files that
        there are, and the one of the nearest name.
    """
    asked = (
        Path()
        if isinstance(name, str) and not name
        else path_of(f"name or path of the {kind}", name)
    )
    with suppress(RuntimeError):  # a home that nobody knows
        asked = asked.expanduser()
    places = [place for place in dict.fromkeys([*folders, *installed]) if exists(place)]
    wanted = [asked] if asked.suffix == suffix else [asked, Path(f"{asked}{suffix}")]
    paths = [place / each for each in wanted for place in places] if str(name) else []
    taken = [path for path in paths if exists(path)]
    for path in taken:
        if not path.is_dir():
            return path
    if taken:
        raise InputError(f"{taken[0]}: is a folder; give a file{'; ' * bool(remedy)}{remedy}")
    looked_in = list(dict.fromkeys((place / asked).parent.absolute() for place in places))
    raise _not_found(f"{name}", kind, suffix, looked_in, installed, remedy)


def _same_but_numbers(name: str, other: str) -> bool:
    return re.sub(r"\d+", "0", name) == re.sub(r"\d+", "0", other)


def _not_found(
    name: str, kind: str, suffix: str, looked_in: list[Path], installed: Sequence[Path], remedy: str
) -> InputError:
    """What to say of a file that is in none of some folders."""
    from difflib import get_close_matches  # few names are wrong

    own = [f for f in looked_in if not any(f.is_relative_to(each) for each in installed)]
    there = sorted({p.name for f in own if exists(f) for p in f.glob(f"*{suffix}") if p.is_file()})
    shipped = sorted({p.stem for folder in installed for p in folder.glob(f"*{suffix}")})
    known = {Path(each).stem: each for each in there} | {each: each for each in shipped}
    near = get_close_matches(Path(name).name.removesuffix(suffix), known, n=1)
    shown = name if len(name) <= _LONGEST_NAME else f"{name[:_LONGEST_NAME]}..."
    said = [f"{shown or repr(name)}: there is no such {kind} file"]
    if name and own:
        places = [f"{folder}{'' if exists(folder) else ' (no folder)'}" for folder in own]
        said.append(f"looked in {', '.join(places)}")
    if there:
        said.append(f"{'there is' if len(there) == 1 else 'there are'} {few(there, _MOST_NAMES)}")
    said.append(f"installed {kind}s: {', '.join(shipped)}")
    misspelt = near and not _same_but_numbers(near[0], Path(name).name.removesuffix(suffix))
    ends = [f"did you mean {known[near[0]]}?"] if misspelt else []
    return InputError("; ".join([*said, *([remedy] if remedy else []), *ends]))


def sha256_of(path: Path) -> str:
    """SHA-256 of a file's content."""
    with path.open("rb") as file:
        return hashlib.file_digest(file, "sha256").hexdigest()


def check_output(path: Path, overwrite: bool, folder: bool = False) -> None:
    """Refuse an output that must not or can't be written; to be asked before any work is done.

    Raises
    ------
    InputError
        If it exists and `overwrite` is not set, `overwrite` would destroy something else than
        earlier results, or its place can't be written.
    """
    with _told(path):
        final = path.resolve()
        settle(final.parent, final.name)
        if path.exists():
            if not overwrite:
                raise InputError(
                    f"{path}: exists; name another with -o, or say --overwrite (in Python"
                    " overwrite=True)"
                )
            if not (path.is_dir() if folder else path.is_file()):
                raise InputError(f"{path}: is not a {'folder' if folder else 'file'}; name another")
            if folder and any(path.iterdir()) and not (path / RESULTS_SIGN).exists():
                raise InputError(
                    f"{path}: holds other files than results (there is no {RESULTS_SIGN}), which"
                    " --overwrite would delete; name another with -o"
                )
        place = next(p for p in path.absolute().parents if p.exists())
        with _workshop(place / path.name):
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
            if interrupts.exit_status(error):
                raise
            raise OSError(f"{error}") from error
        new.replace(path.resolve())


@contextmanager
def folder_written_whole(path: Path, overwrite: bool = False) -> Iterator[Path]:
    """Give a temporary folder to fill; it takes its place when all went well, else it is removed.

    Where the system can, it changes places with the folder that it replaces in one step.

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
            raise type(error)(f"{error}".replace(f"{new}", f"{path}")) from error
        try:
            new.replace(final)  # where there is none, or an empty one
        except OSError as error:
            if not overwrite or error.errno not in (errno.ENOTEMPTY, errno.EEXIST):
                raise
            if not _exchanged(new, final):
                final.replace(old)  # killed here, `settle` puts it back
                new.replace(final)


@contextmanager
def scratch_folder() -> Iterator[Path]:
    """Give a folder for files that nobody needs afterwards; a signal removes it too."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:

        def close() -> None:
            shutil.rmtree(folder, ignore_errors=True)

        with interrupts.on_stop(close):
            yield Path(folder)


def settle(place: Path, name: str | None = None) -> None:
    """Put right what killed runs have left in a folder, and log it.

    Results that were just being replaced are put back, unfinished ones are removed. What another
    process is still at work in stays, and so does what belongs to another user.

    Parameters
    ----------
    place : Path
        The folder that the outputs are in; it need not exist.
    name : str, optional
        Of one output; by default all of them.
    """
    with suppress(OSError):
        for workshop in sorted(place.glob(".*.unfinished")):
            named = _NAMED.fullmatch(workshop.name)
            if not named or name not in (None, named[1]) or workshop.is_symlink():
                continue
            with suppress(OSError):
                if workshop.stat().st_uid != os.geteuid() or (lock := _lock(workshop)) is None:
                    continue
                final, left = place / named[1], any(f.name != _LOCK for f in workshop.iterdir())
                try:
                    restored = _close(workshop, final)
                finally:
                    os.close(lock)
                if restored:
                    _log.warning("%s: results that a killed run had moved are back here", final)
                elif left:
                    _log.warning("%s: what a killed run had left unfinished is removed", final)


def discard(folder: Path) -> None:
    """Remove a folder: in one step to others' eyes, and `settle` ends it if this is killed."""
    with suppress(OSError):
        doomed = Path(tempfile.mkdtemp(".unfinished", f".{folder.name}.", folder.parent))
        folder.replace(doomed)
        shutil.rmtree(doomed, ignore_errors=True)


@contextmanager
def _beside(path: Path) -> Iterator[Path]:
    """Give a hidden folder on the same disk, which is removed in the end with all it holds."""
    with _told(path):
        final = path.resolve()
        _make_parents(final)
        with _workshop(final) as folder:
            yield folder


def _make_parents(final: Path) -> None:
    """Make the folders of a file or folder; a hidden one that was removed is not made again.

    A thread may still write into it while a signal's handler cleans up.
    """
    folders = [*reversed(final.parents)]
    hidden = [i for i, folder in enumerate(folders) if _NAMED.fullmatch(folder.name)]
    if not hidden:
        final.parent.mkdir(parents=True, exist_ok=True)
        return
    for folder in folders[hidden[0] + 1 :]:  # one by one: none where the hidden one is gone
        folder.mkdir(exist_ok=True)


@contextmanager
def _workshop(final: Path) -> Iterator[Path]:
    """Give a hidden folder beside a place for results, locked against `settle` by others."""
    try:
        str(final).encode()
    except UnicodeEncodeError:  # libraries take a name as UTF-8
        raise InputError(f"{final}: its name is not UTF-8; name another with -o") from None
    lock = None
    while lock is None:  # another process may settle it between these two steps
        folder = Path(tempfile.mkdtemp(".unfinished", f".{final.name}.", final.parent))
        try:
            lock = _lock(folder)
        except OSError:  # a disk without locks, where nobody can settle anything
            lock = os.open(os.devnull, os.O_RDONLY)

    def close() -> None:
        _close(folder, final)

    try:
        with interrupts.on_stop(close):
            try:
                yield folder
            finally:
                close()
    finally:
        os.close(lock)


def _lock(workshop: Path) -> int | None:
    """Lock a hidden folder and give the open lock; None if another process has it, or had it.

    Raises
    ------
    OSError
        If the disk has no locks.
    """
    path = workshop / _LOCK
    try:
        lock = os.open(path, os.O_RDWR | os.O_CREAT, 0o600)
    except FileNotFoundError:
        return None
    try:
        fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        if os.path.samestat(os.fstat(lock), path.stat()):
            return lock
    except (BlockingIOError, FileNotFoundError):
        pass
    except OSError:
        os.close(lock)
        raise
    os.close(lock)
    return None


def _close(workshop: Path, final: Path) -> bool:
    """Remove a hidden folder; results in it that have no other place are put back first."""
    old = workshop / "old"
    restored = old.is_dir() and not os.path.lexists(final)
    if restored:
        old.replace(final)
    with suppress(OSError):  # so that other threads write into it no more
        doomed = Path(tempfile.mkdtemp(".unfinished", f".{final.name}.", workshop.parent))
        try:
            workshop.replace(doomed)
            workshop = doomed
        except OSError:  # another thread has removed it
            doomed.rmdir()
    shutil.rmtree(workshop, ignore_errors=True)
    return restored


def _exchanged(one: Path, other: Path) -> bool:
    """Let two folders change places in one step; False where the system can't."""
    rename = getattr(ctypes.CDLL(None, use_errno=True), "renameat2", None)
    if rename is None:
        return False
    paths = (_AT_FDCWD, os.fsencode(one), _AT_FDCWD, os.fsencode(other))
    if rename(*paths, _RENAME_EXCHANGE) == 0:
        return True
    number = ctypes.get_errno()
    if number in (errno.EINVAL, errno.ENOSYS, errno.EOPNOTSUPP):
        return False
    raise OSError(number, os.strerror(number))


@contextmanager
def _told(path: Path) -> Iterator[None]:
    """Say what the system refuses in a user's terms."""
    try:
        yield
    except OSError as error:
        raise InputError(
            f"{path}: can't be written ({error.strerror or error}); nothing was written. Make room,"
            " or choose a place where you may write"
        ) from error
