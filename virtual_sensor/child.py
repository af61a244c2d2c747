"""Run a function in a child process, which may die of what it reads: `run_in_child`.

Libraries that read files in C++ abort, crash or allocate without end on damaged ones, and no
`except` helps. In a child process that is an error like others.

    python -P -m virtual_sensor.child

reads a pickled request from standard input and writes pickled messages to standard output; what
the function itself prints goes nowhere.
"""

from __future__ import annotations

import contextlib
import ctypes
import importlib
import os
import pickle
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import traceback
from collections.abc import Callable
from typing import Any

from virtual_sensor.errors import InputError

PR_SET_PDEATHSIG = 1
REMEDY = "it is damaged, or claims more than it holds; write or copy it again"


def run_in_child(
    target: str,
    *arguments: Any,
    subject: str,
    memory_bytes: int | None = None,
    seconds: float | None = None,
    report: Callable[..., None] | None = None,
) -> Any:
    """Call a function in a child process and return what it returns.

    The child ends with this call, however that ends: Ctrl-C, a signal or this process's death.

    Parameters
    ----------
    target : str
        The function, as ``"package.module:function"``.
    *arguments : object
        Its arguments. They and the result must be picklable.
    subject : str
        What is read, such as a file's path: messages about the child's end begin with it.
    memory_bytes : int, optional
        Address space of the child; as much as the machine has memory by default.
    seconds : float, optional
        The child is ended after this time. No limit by default: a large file takes its time.
    report : callable, optional
        The function gets a keyword argument `report`; what it calls that with reaches this one.

    Raises
    ------
    InputError
        If the child died, needed more memory or time than it may; or as the function raises it.
    Exception
        Others that the function raises, with the child's traceback as a note.
    """
    memory = memory_bytes or os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")
    request = pickle.dumps((target, arguments, memory, report is not None, os.getpid()))
    command = [sys.executable, "-P", "-m", "virtual_sensor.child"]
    paths = os.pathsep.join(path or os.getcwd() for path in sys.path)  # noqa: PTH109
    expired = threading.Event()
    with (
        tempfile.TemporaryFile() as complaints,
        subprocess.Popen(
            command,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=complaints,
            env=os.environ | {"PYTHONPATH": paths},
            process_group=0,  # Ctrl-C reaches this process alone, which ends the child
        ) as child,
    ):

        def end() -> None:
            expired.set()
            child.kill()

        timer = threading.Timer(seconds or 0.0, end)
        timer.daemon = True
        try:
            if seconds is not None:
                timer.start()
            kind, content = _answer(child, request, report or (lambda *told: None))
        finally:
            timer.cancel()
            child.kill()
        if kind == "result":
            return content
        if kind == "error" and not isinstance(content, MemoryError):
            raise content
        if expired.is_set():
            raise InputError(f"{subject}: was not read within {seconds:g} s; {REMEDY}")
        complaints.seek(0)
        if kind == "error" or b"bad_alloc" in complaints.read():
            raise InputError(
                f"{subject}: asks for more memory than the {memory / 1e9:.3g} GB that it may have;"
                f" {REMEDY}"
            )
        status = child.wait()
        end_of_it = signal.Signals(-status).name if status < 0 else f"exit status {status}"
        raise InputError(f"{subject}: what reads it crashed ({end_of_it}); {REMEDY}")


def _answer(
    child: subprocess.Popen[bytes], request: bytes, report: Callable[..., None]
) -> tuple[str, Any]:
    """Send the request and give the last message: "result", "error", or "death" if none came."""
    assert child.stdin
    assert child.stdout
    try:
        child.stdin.write(request)
        child.stdin.close()
        while True:
            kind, content = pickle.load(child.stdout)
            if kind != "report":
                return kind, content
            report(*content)
    except (BrokenPipeError, EOFError, pickle.UnpicklingError):
        with contextlib.suppress(BrokenPipeError):
            child.stdin.close()
        child.wait()
        return "death", None


def main() -> None:
    """Serve one request, in the child."""
    answers = os.fdopen(os.dup(1), "wb")
    target, arguments, memory, reports, parent = pickle.load(sys.stdin.buffer)
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has died before
        os._exit(1)
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1):
        os.dup2(nowhere, stream)

    def send(kind: str, content: Any) -> None:
        answers.write(pickle.dumps((kind, content), protocol=5))
        answers.flush()

    try:
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        limit = memory if most == resource.RLIM_INFINITY else min(memory, most)
        resource.setrlimit(resource.RLIMIT_AS, (limit, most))
        module, _, name = target.partition(":")
        function = getattr(importlib.import_module(module), name)
        told = {"report": lambda *content: send("report", content)} if reports else {}
        send("result", function(*arguments, **told))
    except Exception as error:
        if not isinstance(error, (InputError, MemoryError)):
            error.add_note(f"In the child process:\n{traceback.format_exc()}")
        try:
            send("error", error)
        except Exception:  # one that can't be pickled
            send("error", RuntimeError(traceback.format_exc()))
    # Libraries need not be shut down, and some would hang or crash then.
    answers.flush()
    os._exit(0)


if __name__ == "__main__":
    main()
