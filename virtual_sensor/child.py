"""Run a function in a child process, which may die of what it reads: `run_in_child`.

Libraries that read files in C++ abort, crash or allocate without end on damaged ones, and no
`except` helps. In a child process that is an error like others.

    python -P -m virtual_sensor.child PARENT

is a fork server: for each request on standard input it imports the function's module and forks a
child, which answers on standard output; what the function itself prints goes nowhere. The next
child need not import that module again, nor what this one imported while it was at work: with the
answer it names these, and the next request has the server import them. The server reports its
child's death; it dies itself where that was in the middle of a message, and with its parent.
"""

from __future__ import annotations

import atexit
import contextlib
import gc
import importlib
import mmap
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
from pathlib import Path
from typing import Any

from virtual_sensor import interrupts
from virtual_sensor.errors import InputError

ANSWERED = 77  # exit status of a child that has sent its last message
PATIENCE_S = 10.0  # with a server that is to end its child and itself
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
        That the child may take beyond what is loaded already; as much as the machine has by
        default, and at most.
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
    memory = min(memory_bytes or physical_memory(), physical_memory())
    content = pickle.dumps((arguments, memory, report is not None, str(Path.cwd()), sys.path))
    server = _take()
    expired = threading.Event()

    def end() -> None:
        expired.set()
        server.end()

    timer = threading.Timer(seconds or 0.0, end)
    timer.daemon = True
    kind = ""
    try:
        if seconds is not None:
            timer.start()
        kind, answer = server.ask((target, content), report or (lambda *progress: None))
    finally:
        timer.cancel()
        if kind and not expired.is_set() and server.process.poll() is None:
            _idle.append(server)
        else:
            server.end()
    if kind == "result":
        return answer
    if kind == "error" and not isinstance(answer, MemoryError):
        raise answer
    if expired.is_set():
        raise InputError(f"{subject}: was not read within {seconds:g} s; {REMEDY}")
    status, complaints = (0, b"") if kind == "error" else answer
    if kind == "error" or b"bad_alloc" in complaints:
        raise InputError(
            f"{subject}: asks for more memory than the {memory / 1e9:.3g} GB that it may have;"
            f" {REMEDY}"
        )
    how = signal.Signals(-status).name if status < 0 else f"exit status {status}"
    raise InputError(f"{subject}: what reads it crashed ({how}); {REMEDY}")


def physical_memory() -> int:
    """Bytes of memory that this machine has."""
    return os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE")


def _address_space() -> int:
    """Bytes of address space that this process has, libraries included."""
    return int(Path("/proc/self/statm").read_text().split()[0]) * resource.getpagesize()


class _ForkServer:
    """A process that forks children, one at a time."""

    def __init__(self) -> None:
        self.owner = os.getpid()
        self.imported: list[str] = []  # modules, by the last child
        self.complaints = tempfile.TemporaryFile("a+b")  # noqa: SIM115
        paths = os.pathsep.join(path or str(Path.cwd()) for path in sys.path)
        self.process = subprocess.Popen(
            [sys.executable, "-P", "-m", "virtual_sensor.child", str(self.owner)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self.complaints,
            env=os.environ | {"PYTHONPATH": paths},
            process_group=0,  # Ctrl-C reaches this process alone, which ends the child
        )

    def ask(self, request: tuple[str, bytes], report: Callable[..., None]) -> tuple[str, Any]:
        """Send a request and give the last message: "result", "error" or "death" and its content.

        That of a death is the child's exit status and what it wrote to standard error.
        """
        assert self.process.stdin
        assert self.process.stdout
        start = os.fstat(self.complaints.fileno()).st_size
        try:
            pickle.dump((self.imported, *request), self.process.stdin)
            self.process.stdin.flush()
            while True:
                kind, content = pickle.load(self.process.stdout)
                if kind == "report":
                    report(*content)
                elif kind == "imported":
                    self.imported = content
                elif kind == "death":
                    status = content
                    break
                else:
                    return kind, content
        except (BrokenPipeError, EOFError, pickle.UnpicklingError, ValueError):
            status = self.process.wait()
        with contextlib.suppress(ValueError):  # closed by `end`, in another thread
            self.complaints.seek(start)
            return "death", (status, self.complaints.read())
        return "death", (status, b"")

    def end(self) -> None:
        """End it, with a child that it has."""
        self.process.terminate()
        try:
            self.process.wait(PATIENCE_S)
        except subprocess.TimeoutExpired:
            os.killpg(self.process.pid, signal.SIGKILL)
            self.process.wait()
        for stream in (self.process.stdin, self.process.stdout, self.complaints):
            with contextlib.suppress(BrokenPipeError):
                stream.close()  # type: ignore[union-attr]


_idle: list[_ForkServer] = []


def _take() -> _ForkServer:
    """An idle server of this process, or a new one."""
    while _idle:
        server = _idle.pop()
        if server.owner != os.getpid():  # this is a fork of the process that has it
            server.process.returncode = 0
        elif server.process.poll() is None:
            return server
        else:
            server.end()
    return _ForkServer()


@atexit.register
def _end_all() -> None:
    while _idle:
        server = _idle.pop()
        if server.owner == os.getpid():
            server.end()


def main(parent: int) -> None:
    """Serve requests, in the server."""
    interrupts.tie_to_parent(parent)
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    children: list[int] = []
    answering = mmap.mmap(-1, 1)  # shared with the child: 1 in the middle of a message
    stopped = False

    def stop(*_: object) -> None:
        nonlocal stopped
        if not children:
            os._exit(1)
        stopped = True
        os.kill(children[0], signal.SIGKILL)

    signal.signal(signal.SIGTERM, stop)
    while True:
        try:
            imported, target, content = pickle.load(sys.stdin.buffer)
        except EOFError:
            return
        for module in (target.partition(":")[0], *imported):
            with contextlib.suppress(Exception):  # the child reports it
                importlib.import_module(module)
        gc.freeze()  # the child's collections then copy none of the memory that it shares
        signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGTERM])
        server, child = os.getpid(), os.fork()
        if not child:
            try:
                signal.signal(signal.SIGTERM, signal.SIG_DFL)
                signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
                _answer(server, target, content, answering)
            finally:  # libraries need not be shut down, and some would hang or crash then
                os._exit(1)
        children.append(child)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, [signal.SIGTERM])
        status = os.waitstatus_to_exitcode(os.waitpid(child, 0)[1])
        children.clear()
        if stopped:  # when its child had answered, too
            os._exit(1)
        if status == ANSWERED:
            continue
        if not answering[0]:
            sys.stdout.buffer.write(pickle.dumps(("death", status)))
            sys.stdout.buffer.flush()
            continue
        if status < 0:
            with contextlib.suppress(OSError):  # SIGKILL has no handler
                signal.signal(-status, signal.SIG_DFL)
            os.kill(server, -status)
        os._exit(status)


def _answer(server: int, target: str, content: bytes, answering: mmap.mmap) -> None:
    """Call the function and send what it returns or raises, in the child."""
    interrupts.tie_to_parent(server)
    answers = os.fdopen(os.dup(1), "wb")
    nowhere = os.open(os.devnull, os.O_RDWR)
    for stream in (0, 1):
        os.dup2(nowhere, stream)
    here = set(sys.modules)

    def send(kind: str, content: Any) -> None:
        message = pickle.dumps((kind, content), protocol=5)
        answering[0] = 1
        answers.write(message)
        answers.flush()
        answering[0] = 0

    def imported() -> None:
        with contextlib.suppress(MemoryError):
            send("imported", [module for module in sys.modules if module not in here])

    try:
        arguments, memory, reports, folder, sys.path = pickle.loads(content)
        os.chdir(folder)
        _, most = resource.getrlimit(resource.RLIMIT_AS)
        limit = _address_space() + memory
        limit = limit if most == resource.RLIM_INFINITY else min(limit, most)
        resource.setrlimit(resource.RLIMIT_AS, (limit, most))
        module, _, name = target.partition(":")
        function = getattr(importlib.import_module(module), name)
        options = {"report": lambda *content: send("report", content)} if reports else {}
        result = function(*arguments, **options)
        imported()
        send("result", result)
    except Exception as error:
        if not isinstance(error, (InputError, MemoryError)):
            error.add_note(f"In the child process:\n{traceback.format_exc()}")
        imported()
        try:
            send("error", error)
        except Exception:  # one that can't be pickled
            send("error", RuntimeError(traceback.format_exc()))
    os._exit(ANSWERED)


if __name__ == "__main__":
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    main(int(sys.argv[1]))
