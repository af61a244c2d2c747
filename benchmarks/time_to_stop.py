"""How long commands take to end after Ctrl-C, at moments spread over their run; goal 2 s.

    python benchmarks/time_to_stop.py [MOMENTS]

A kernel's compilation is one call of C++ during which Python hears no signal.
"""

import random
import signal
import subprocess
import sys
import tempfile
import time

COMMANDS = (
    "measure hot_cylinder",
    "search hot_cylinder --rays 401",
    "sweep hot_cylinder -D beta=0,15",
    "chart --quick",
    "trial --quick",
    "reproduce",
    "field info {fields}/hot_cylinder_1250C_quarter.nc -o cuts.png",
    "doctor",
)
LONGEST_S = 30.0


def started(words: str, folder: str) -> subprocess.Popen:
    """A command in a session of its own, as in a terminal."""
    from virtual_sensor.imaging.scene_file import shipped_scenes

    line = words.format(fields=shipped_scenes() / "fields").split()
    code = (
        "import signal; signal.signal(signal.SIGINT, signal.default_int_handler)\n"
        "from virtual_sensor.cli import main; main()"
    )
    return subprocess.Popen(
        [sys.executable, "-c", code, *line],
        cwd=folder,
        stdout=subprocess.DEVNULL,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
    )


def whole_s(words: str) -> float:
    """How long a command takes, s, or `LONGEST_S`."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        began = time.monotonic()
        run = started(words, folder)
        try:
            run.communicate(timeout=LONGEST_S)
        except subprocess.TimeoutExpired:
            run.send_signal(signal.SIGINT)
            run.communicate()
        return time.monotonic() - began


def stop_s(words: str, moment_s: float) -> float | None:
    """Seconds from the signal to the end; None if the command had ended before."""
    with tempfile.TemporaryDirectory(ignore_cleanup_errors=True) as folder:
        run = started(words, folder)
        time.sleep(moment_s)
        began = time.monotonic()
        run.send_signal(signal.SIGINT)
        _, said = run.communicate()
        if run.returncode == 0:
            return None
        if run.returncode != 130 or said.count("\n") != 1:
            print(f"  {words}, {moment_s:.2f} s: status {run.returncode}, {said!r}")
        return time.monotonic() - began


def main(moments: int) -> None:
    """Print a line for each command."""
    chance = random.Random(16)
    print(f"{'command':32} {'whole, s':>9} {'stopped':>8} {'median, s':>10} {'longest, s':>11}")
    for words in COMMANDS:
        whole = whole_s(words)
        # Python itself needs the first moment.
        taken = [stop_s(words, chance.uniform(0.1, 0.95 * whole)) for _ in range(moments)]
        ended = sorted(seconds for seconds in taken if seconds is not None)
        print(
            f"{words.split(' {')[0]:32} {whole:9.1f} {len(ended):8} {ended[len(ended) // 2]:10.2f}"
            f" {ended[-1]:11.2f}",
            flush=True,
        )


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else 20)
