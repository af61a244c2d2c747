"""The parent's side: hands cases to a child process, and starts another one when it dies."""

from __future__ import annotations

import os
import pickle
import select
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

from hostile.cases import Answer, Case

LIMIT_S = 60.0  # for a hang; any case takes a small fraction of a second
_READER = Path(__file__).with_name("reader.py")


class Runner:
    """Reads cases in a long-lived child; a context manager."""

    def __init__(self) -> None:
        self._child: subprocess.Popen[bytes] | None = None
        self._home = Path(tempfile.mkdtemp(prefix="hostile"))
        self._number = 0

    def __enter__(self) -> Runner:
        return self

    def __exit__(self, *_: object) -> None:
        self._stop()
        shutil.rmtree(self._home, ignore_errors=True)

    def run(self, case: Case) -> Answer:
        """Read a case twice; see `cases.Answer`."""
        # A folder of its own: a reader may remember what it has read by the file's name.
        self._number += 1
        folder = self._home / f"{self._number}"
        _write(folder, case)
        try:
            return self._asked(pickle.dumps((case.kind, folder, case.main, case.options)))
        finally:
            shutil.rmtree(folder, ignore_errors=True)

    def _asked(self, question: bytes) -> Answer:
        child = self._child or self._started()
        try:
            _send(child.stdin, question)
            return Answer(**pickle.loads(_received(child.stdout.fileno())))
        except TimeoutError:
            self._stop()
            return Answer("hung", f"no answer within {LIMIT_S:g} s")
        except (EOFError, BrokenPipeError):
            code = child.wait()
            said = self._log().read_text(errors="replace")
            self._stop()
            name = signal.Signals(-code).name if code < 0 else f"status {code}"
            said = said.partition("Extension modules")[0]
            return Answer("died", f"{name}: {' '.join(said.split())[:1500]}")

    def _log(self) -> Path:
        return self._home / "printed.txt"

    def _started(self) -> subprocess.Popen[bytes]:
        paths = [str(_READER.parents[1]), os.environ.get("PYTHONPATH", "")]
        environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, paths))}
        environment |= {"VIRTUAL_SENSOR_THREADS": "1", "PYTHONWARNINGS": "error"}
        self._child = subprocess.Popen(
            [sys.executable, "-P", _READER, self._log()],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            env=environment,
            cwd=self._home,
        )
        return self._child

    def _stop(self) -> None:
        if self._child:
            self._child.kill()
            self._child.communicate()
            self._child = None


def _write(folder: Path, case: Case) -> None:
    folder.mkdir(parents=True)
    for name, content in case.files.items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        if isinstance(content, bytes):
            path.write_bytes(content)
        elif content == "fifo":
            os.mkfifo(path)
        elif content == "folder":
            path.mkdir()
        else:
            path.symlink_to(path)


def _send(pipe, message: bytes) -> None:
    pipe.write(len(message).to_bytes(8, "little") + message)
    pipe.flush()


def _received(descriptor: int) -> bytes:
    size = int.from_bytes(_exactly(descriptor, 8), "little")
    return _exactly(descriptor, size)


def _exactly(descriptor: int, count: int) -> bytes:
    parts = []
    while count:
        if not select.select([descriptor], [], [], LIMIT_S)[0]:
            raise TimeoutError
        part = os.read(descriptor, min(count, 1 << 20))
        if not part:
            raise EOFError
        parts.append(part)
        count -= len(part)
    return b"".join(parts)
