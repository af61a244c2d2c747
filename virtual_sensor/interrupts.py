"""Ctrl-C and other signals that end a command: from any moment, with one line and no traceback.

The handler raises no exception. One that is raised inside a callback of C++ is lost, or taken for a
fault of the scene, and one that is raised while a library is imported aborts the process. Instead
the handler itself runs what has been registered by `on_stop`, ends child processes and exits with
128 + the signal's number, 130 for Ctrl-C and 143 for SIGTERM. A second signal exits at once.
"""

import ctypes
import os
import re
import signal
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from types import FrameType

SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)

_PR_SET_PDEATHSIG = 1  # of Linux's prctl.h

_Action = Callable[[], str | None]
_actions: list[_Action] = []
_received: list[signal.Signals] = []
_raising = 0


def install() -> bool:
    """Handle the signals in this process, and say whether that is so.

    Those that it was started to ignore stay ignored.
    """
    process = os.getpid()

    def handle(number: int, frame: FrameType | None) -> None:
        if _received or os.getpid() != process:  # a second one; a fork, whose parent cleans up
            os._exit(128 + number)
        _received.append(signal.Signals(number))
        if _raising:
            raise KeyboardInterrupt if number == signal.SIGINT else SystemExit(128 + number)
        _end()

    _received.clear()
    for number in SIGNALS:
        with suppress(ValueError):  # only the main thread may
            if signal.getsignal(number) is not signal.SIG_IGN:
                signal.signal(number, handle)
    return handle in map(signal.getsignal, SIGNALS)


@contextmanager
def on_stop(action: _Action) -> Iterator[None]:
    """Have the handler call a function, should a signal come within this context.

    What it returns, if anything, is added to the line that a user reads.
    """
    _actions.append(action)
    try:
        yield
    finally:
        _actions.remove(action)


@contextmanager
def raising() -> Iterator[None]:
    """Within this context a first signal raises KeyboardInterrupt or SystemExit.

    For pure Python that ends in good order by itself.
    """
    global _raising
    _raising += 1
    try:
        yield
    finally:
        _raising -= 1


@contextmanager
def deaf_children() -> Iterator[None]:
    """Start processes that do not hear a terminal's Ctrl-C: the handler here ends them."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def tie_to_parent(parent: int) -> None:
    """Have this process killed when its parent dies, by kill -9 too; the caller is a child."""
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has died before
        os._exit(1)


def exit_status(error: BaseException) -> int | None:
    """Exit status where a signal is behind an exception; None where there was no signal.

    Libraries wrap a KeyboardInterrupt into errors of their own, Dr.Jit's loops among them.
    """
    if _received:
        return 128 + _received[0]
    seen: BaseException | None = error
    while seen is not None:
        if isinstance(seen, KeyboardInterrupt):
            return 128 + signal.SIGINT
        seen = seen.__cause__ or seen.__context__
    return None


def raised_again(text: str) -> None:
    """Raise a stop that is named in the text of an error: C++ passes on no more than that."""
    if stop := re.search(r"^(?:KeyboardInterrupt|SystemExit: (\d+))\b", text, re.MULTILINE):
        raise SystemExit(int(stop[1])) if stop[1] else KeyboardInterrupt


def line(status: int, more: str = "") -> str:
    """The line that a user reads, from the exit status."""
    number = signal.Signals(status - 128)
    name = "Ctrl-C" if number == signal.SIGINT else number.name
    return f"Stopped by {name}{more and '; '}{more}."


def _end() -> None:
    """Clean up, say so and exit."""
    status = 128 + _received[0]
    with suppress(BaseException):
        _kill_children()
    words = []
    for action in _actions[::-1]:  # a copy: threads that end take theirs away meanwhile
        with suppress(BaseException):
            words.append(action() or "")
    with suppress(OSError):
        text = line(status, "; ".join(filter(None, words)))
        os.write(2, f"{text}\n".encode(sys.getfilesystemencoding(), "replace"))
    os._exit(status)


def _kill_children() -> None:
    """Kill this process's children, those aside that lead a session of their own.

    What workers shared with this process, named in the system, is removed.
    """
    tracker = None
    if "multiprocessing.resource_tracker" in sys.modules:
        tracker = sys.modules["multiprocessing.resource_tracker"]._resource_tracker._pid
    with suppress(OSError):  # Linux lists them
        for thread in os.listdir("/proc/self/task"):  # noqa: PTH208
            with open(f"/proc/self/task/{thread}/children") as file:  # noqa: PTH123
                for child in map(int, file.read().split()):
                    with suppress(OSError):
                        if child != tracker and os.getsid(child) != child:
                            os.kill(child, signal.SIGKILL)
    if tracker is not None:
        sys.modules["multiprocessing.util"]._run_finalizers(0)  # which tell the tracker
