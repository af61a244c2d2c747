"""From command to prompt: wall and processor time of `measure`, `correct` and of the start.

``python benchmarks/command_time.py [--runs 5]``; each command runs once before the clock starts.
Processor time says more than wall time where other programs run.
"""

import argparse
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path
from statistics import median

COMMANDS = {
    "import virtual_sensor": ["-c", "import virtual_sensor"],
    "virtual-sensor --help": ["-m", "virtual_sensor", "--help"],
    "virtual-sensor measure hot_cylinder": ["-m", "virtual_sensor", "measure", "hot_cylinder"],
    "virtual-sensor correct measured": ["-m", "virtual_sensor", "correct", "measured"],
    "virtual-sensor correct measured --estimate scale,width,offset": [
        *("-m", "virtual_sensor", "correct", "measured", "--estimate", "scale,width,offset"),
        *("--medium", "hot_cylinder_1100C_quarter", "--sigma", "0.02", "-o", "estimated"),
    ],
}


def once(arguments: list[str], folder: Path) -> tuple[float, float]:
    """Wall and processor time of a command, s; with its children's."""
    before, began = resource.getrusage(resource.RUSAGE_CHILDREN), time.perf_counter()
    words = [*arguments, "--overwrite"] if {"measure", "correct"} & {*arguments} else arguments
    subprocess.run([sys.executable, *words], cwd=folder, check=True, capture_output=True)
    wall, after = time.perf_counter() - began, resource.getrusage(resource.RUSAGE_CHILDREN)
    return wall, after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime


def main(runs: int) -> None:
    """Print the least and the median of both times for each command."""
    print("wall: least, median; processor: least, median; s")
    with tempfile.TemporaryDirectory() as folder:
        for name, arguments in COMMANDS.items():
            once(arguments, Path(folder))
            wall, cpu = zip(*(once(arguments, Path(folder)) for _ in range(runs)), strict=True)
            figures = "  ".join(f"{min(times):5.2f} {median(times):5.2f}" for times in (wall, cpu))
            print(f"{figures}   {name}", flush=True)


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--runs", type=int, default=5)
    main(parser.parse_args().runs)
