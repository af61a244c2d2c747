"""Run a program for a parent, and send it a signal when that parent dies: a script of its own.

    python -IS attendant.py SIGNAL PARENT PROGRAM [ARGUMENT ...]

The kernel gives a parent's death to each of its threads in turn, so that the signal may come twice,
and OpenFOAM's solvers, who finish their step at the first, die of a second. It is passed on once.
"""

import ctypes
import os
import signal
import subprocess
import sys

PR_SET_PDEATHSIG = 1


def _tie(number: int, parent: int) -> None:
    """Have the kernel send this process a signal when its parent dies."""
    ctypes.CDLL(None).prctl(PR_SET_PDEATHSIG, number)
    if os.getppid() != parent:  # it has died before
        os._exit(1)


def main(number: int, parent: int, command: list[str]) -> None:
    """Run the command to its end, and end as it did."""
    passed_on = {number, signal.SIGTERM} - {signal.SIGKILL}
    signal.pthread_sigmask(signal.SIG_BLOCK, passed_on)  # until there is a program
    _tie(number, parent)
    attendant = os.getpid()

    def begin() -> None:
        _tie(signal.SIGKILL, attendant)
        signal.pthread_sigmask(signal.SIG_UNBLOCK, passed_on)

    program = subprocess.Popen(command, close_fds=False, preexec_fn=begin)

    def pass_on(given: int, _: object) -> None:
        signal.signal(given, signal.SIG_IGN)
        program.send_signal(given)

    for given in passed_on:
        signal.signal(given, pass_on)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, passed_on)
    status = program.wait()
    sys.exit(status if status >= 0 else 128 - status)  # as a shell reports signals


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), sys.argv[3:])
