"""Bent rays and frames side by side with peers: same cores, grid, rays and stated error, one run.

python -m pip install -e '.[bench]'
python benchmarks/peers.py --output peers           everything: ten minutes on two cores
python benchmarks/peers.py --output p --quick       few rays: to see that all works
python benchmarks/peers.py --output p --only numba --only ours
"""

from __future__ import annotations

import argparse
import os
import platform
import shlex
import sys
import time
from collections.abc import Iterator, Sequence
from dataclasses import replace
from importlib import metadata
from pathlib import Path
from typing import Any

KINDS = ("ours", "numba", "diffrax", "scipy", "frames")
_PACKAGES = ("virtual-sensor", "mitsuba", "drjit", "numpy", "scipy", "numba", "diffrax", "jax")


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure, print the table and write it."""
    asked = _parsed(arguments)
    _confine(asked.cores)
    # Only now: what is imported here counts the cores at its import.
    from report import lines, write

    from virtual_sensor.errors import InputError
    from virtual_sensor.files import check_output

    output = Path(asked.output)
    try:
        check_output(output, asked.overwrite, folder=True)
    except InputError as error:
        print(f"peers.py: {error}", file=sys.stderr)
        return 2
    began = time.perf_counter()
    kinds = asked.only or list(KINDS)
    rows, about = rays(kinds, asked)
    frames: list[Any] = []
    if "frames" in kinds:
        from frames import measured

        film, spp = (256, 4) if asked.quick else (2048, 16)
        for frame in measured(film, spp, asked.runs):
            frames.append(frame)
            _say(f"{frame.light}: {frame.renderer}: {frame.seconds:.3f} s")
        about["frames"] = f"{film} x {film} px, {spp} samples a pixel"
    facts = about | _facts(asked) | {"seconds": f"{time.perf_counter() - began:.0f}"}
    write(output, rows, frames, facts, asked.overwrite)
    print("\n".join(lines(rows, frames, facts)))
    return 0


def rays(kinds: Sequence[str], asked: argparse.Namespace) -> tuple[list[Any], dict[str, str]]:
    """The rows of all peers asked for, and what they were measured on."""
    import ours
    from problem import measured

    from virtual_sensor.imaging.scene import load_scene

    scene = load_scene("hot_cylinder", **({"field": asked.field} if asked.field else {}))
    most, judged = (2_000, 101) if asked.quick else (200_000, 2_001)
    problem = ours.problem_of(scene, most, judged)
    straight = problem.error_px(problem.targets)
    about = {
        "field": f"{scene.air.path.name}, {' x '.join(map(str, scene.field.shape))}"
        f" nodes of {' x '.join(f'{s:g}' for s in scene.field.spacing)} mm",
        "rays": f"{len(problem)} camera rays towards the laser's line through the plume,"
        f" {problem.lengths.mean():.0f} mm each in the field; straight ones miss by"
        f" {_rms(straight):.1f} px rms",
        "error": "rms over the rays of the distance, square to the ray, from the reference where"
        f" it ends; 1 px is 22 um; stated: {asked.error:g} px",
        "reference": ours.REFERENCE,
    }
    found = []
    for peer in _peers(kinds, scene, asked):
        if asked.quick:
            peer = replace(
                peer, rays=min(peer.rays, 200), judged=min(peer.judged, 20),
                settings=peer.settings[:: max(len(peer.settings) - 2, 1)],
            )  # fmt: skip
        for row in measured(peer, problem, asked.error, asked.runs):
            found.append(row)
            rate = f", {row.rays_per_s:.3g} rays/s" if row.rays_per_s == row.rays_per_s else ""
            _say(f"{row.peer}, {row.setting:.3g} {row.unit}: {row.rms_px:.2e} px{rate}")
    return found, about


def _peers(kinds: Sequence[str], scene: Any, asked: argparse.Namespace) -> Iterator[Any]:
    """The peers of some kinds; ours come first, when the machine is as cool as it gets for all."""
    if "ours" in kinds:
        import ours

        yield from ours.peers(scene)
    if "numba" in kinds:
        import numba_peer

        yield from numba_peer.peers(asked.cores)
    if "diffrax" in kinds:
        import diffrax_peer

        yield from diffrax_peer.peers()
    if "scipy" in kinds:
        import scipy_peer

        yield from scipy_peer.peers()


def _rms(values: Any) -> float:
    known = values[values == values]
    return float((known**2).mean() ** 0.5)


def _confine(cores: int) -> None:
    """All programs on the same cores, before any of them counts what there are."""
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, sorted(os.sched_getaffinity(0))[:cores])
    for name in ("VIRTUAL_SENSOR_THREADS", "NUMBA_NUM_THREADS", "OMP_NUM_THREADS"):
        os.environ[name] = str(cores)
    os.environ["OMP_WAIT_POLICY"] = "PASSIVE"  # threads that wait must not slow the next peer


def _facts(asked: argparse.Namespace) -> dict[str, str]:
    model = platform.processor()
    if Path("/proc/cpuinfo").exists():
        text = Path("/proc/cpuinfo").read_text(encoding="utf-8")
        model = text.partition("model name")[2].partition(":")[2].partition("\n")[0].strip()
    versions = {}
    for name in _PACKAGES:
        try:
            versions[name] = metadata.version(name)
        except metadata.PackageNotFoundError:
            versions[name] = "not installed"
    return {
        "cores": f"{asked.cores} of {model}; load before: {os.getloadavg()[0]:.1f}",
        "runs": f"median of {asked.runs} after one that warms up",
        "versions": f"Python {platform.python_version()}, "
        + ", ".join(f"{name} {number}" for name, number in versions.items()),
        "command": shlex.join(["python", "benchmarks/peers.py", *asked.typed]),
    }


def _say(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def _parsed(arguments: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("-o", "--output", required=True, help="folder for peers.csv and peers.md")
    parser.add_argument("--overwrite", action="store_true", help="replace earlier results there")
    parser.add_argument("--only", action="append", choices=KINDS, help="may be given several times")
    parser.add_argument("--error", type=float, default=1e-3, help="stated error in px [1e-3]")
    parser.add_argument("--cores", type=int, default=2, help="[2]")
    parser.add_argument("--runs", type=int, default=3, help="of each timing [3]")
    parser.add_argument("--field", help="another field file than the scene's")
    parser.add_argument("--quick", action="store_true", help="few rays: to see that all works")
    asked = parser.parse_args(arguments)
    asked.typed = list(sys.argv[1:] if arguments is None else arguments)
    return asked


if __name__ == "__main__":
    sys.exit(main())
