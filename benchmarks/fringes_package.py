"""Our decoders beside the package `fringes`, on images that it makes: coordinates and time.

python benchmarks/fringes_package.py               ten minutes: it compiles itself first
python benchmarks/fringes_package.py --python P    of an environment that has fringes

It is under the GPL, and needs opencv-contrib-python, which shares its files with our
opencv-contrib-python-headless: without --python a virtual environment of its own is made for it,
and removed afterwards.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
import venv
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Array = NDArray[np.float64]

PACKAGE = "fringes==2.1.0"
MOST_PX = 2e-4
"""By which the coordinates may differ."""

SIZE_PX = (1280, 160)
TIMED_PX = (2048, 2048)
RUNS = 3

# Its phase is 2 pi v x/L - 2 pi n/N - p0, where L is the image's longer side: with p0 = 0 its
# coordinates are ours and half a pixel.
PEER = """
import json, sys, time
import numpy as np
from fringes import Fringes
folder, cases = sys.argv[1], json.loads(sys.argv[2])
for name, case in cases.items():
    width, height = case["size"]
    shape = 2, len(case["periods"])
    coding = Fringes(X=width, Y=height, axes=(1, 0), K=shape[1], p0=0.0, dtype=case["dtype"],
                     mode=case["mode"],
                     v=np.tile(max(case["size"]) / np.array(case["periods"]), (2, 1)),
                     N=np.full(shape, case["steps"]), f=np.ones(shape))
    assert np.all(coding.N == case["steps"]), coding.N
    images = coding.encode()
    took = []
    for _ in range(1 + case["runs"]):
        began = time.perf_counter()
        found = coding.decode(images)
        took.append(time.perf_counter() - began)
    np.savez(f"{folder}/{name}.npz", images=images[..., 0], x=found[2][..., 0],
             seconds=sorted(took[1:])[case["runs"] // 2])
"""


class Case(NamedTuple):
    """A sequence of columns and rows: its codec as we call it, and how the peer writes it."""

    codec: str
    steps: int
    periods: tuple[float, ...]
    size: tuple[int, int] = SIZE_PX
    dtype: str = "float64"
    runs: int = 1
    mode: str = "precise"


BEATS = (1280 / 80, 1280 / 69, 1280 / 59)
CASES = {
    "three": Case("phase 3 16,128,1280", 3, (16, 128, 1280)),
    "four": Case("phase 4 16,128,1280", 4, (16, 128, 1280)),
    "eight": Case("phase 8 20,160,1280", 8, (20, 160, 1280)),
    "sixteen": Case("phase 16 40,1280", 16, (40, 1280)),
    "beats": Case(f"phase 4 {','.join(map(str, BEATS))} heterodyne", 4, BEATS),
    "large": Case("phase 4 16,128,2048", 4, (16, 128, 2048), TIMED_PX, "uint8", RUNS, "fast"),
}


class Result(NamedTuple):
    """How far our coordinates are from the peer's, and the times of both."""

    most_px: float
    rms_px: float
    decoded: float
    seconds: float
    peer_seconds: float


def peer(cases: dict[str, Case], folder: Path, python: str | None) -> None:
    """Have the package make images and decode them, into files of the folder."""
    if python is None:
        venv.create(folder / "venv", with_pip=True)
        python = str(folder / "venv/bin/python")
        subprocess.run([python, "-m", "pip", "install", "-q", PACKAGE], check=True)
    codecs = json.dumps({name: case._asdict() for name, case in cases.items()})
    subprocess.run([python, "-c", PEER, str(folder), codecs], check=True)


def compared(case: Case, given: Any) -> Result:
    """Decode the peer's images, and compare with what it found."""
    from virtual_sensor.metrology.fringes.codecs import codec_of

    codec = codec_of(case.codec, case.size)
    images, took = given["images"], []
    for _ in range(1 + case.runs):
        began = time.perf_counter()
        found = codec.decode(images, saturation=np.inf)  # white is no clipping
        took.append(time.perf_counter() - began)
    pairs = zip("uv", given["x"], strict=True)
    ours = {"u": found.column, "v": found.row}
    # Its first row and column lie on the border, where its own orders slip.
    inner = np.pad(found.ok[1:, 1:], ((1, 0), (1, 0)))
    apart = np.abs(np.concatenate([(ours[axis] + 0.5 - x)[inner] for axis, x in pairs]))
    rms, most = float(np.sqrt(np.mean(apart**2))), float(apart.max())
    seconds = sorted(took[1:])[case.runs // 2]
    return Result(most, rms, float(found.ok.mean()), seconds, float(given["seconds"]))


def main() -> int:
    """Compare and print a table; exit with 1 where the coordinates differ by too much."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--python", help=f"interpreter that has {PACKAGE}")
    asked = parser.parse_args()
    failed = False
    print(f"{'codec':<66} largest px   rms px  decoded  ours s  fringes s")
    with tempfile.TemporaryDirectory() as folder:
        peer(CASES, Path(folder), asked.python)
        for name, case in CASES.items():
            with np.load(f"{folder}/{name}.npz") as given:
                result = compared(case, given)
            failed |= case.dtype != "uint8" and result.most_px > MOST_PX
            print(
                f"{case.codec:<66} {result.most_px:10.2g} {result.rms_px:8.2g}"
                f" {result.decoded:8.1%} {result.seconds:7.2f} {result.peer_seconds:10.2f}"
            )
    return int(failed)


if __name__ == "__main__":
    sys.exit(main())
