"""What a chart was measured on: no time means anything without it."""

from __future__ import annotations

import os
import platform
from contextlib import suppress
from datetime import datetime
from importlib import metadata
from pathlib import Path

from virtual_sensor import engine

_PACKAGES = (
    "virtual-sensor",
    "mitsuba",
    "drjit",
    "numpy",
    "scipy",
    "opencv-contrib-python-headless",
)


def machine() -> dict[str, str]:
    """Facts of this machine and of what runs on it, by their names."""
    running = engine.activate()
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    facts = {
        "date": datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        "processor": _processor(),
        "cores": f"{usable} usable of {os.cpu_count()}",
        "threads": str(running.threads),
        "variant": running.variant,
        "LLVM": running.llvm.version if running.llvm else "none: CUDA",
        "system": platform.platform(),
        "python": platform.python_version(),
        **{name: metadata.version(name) for name in _PACKAGES if _installed(name)},
    }
    with suppress(OSError):  # some systems tell of no load
        others = os.getloadavg()[0]
        facts["load before"] = f"{others:.2f}: processes that wanted a core in the minute before"
    return facts


def cuda_found() -> bool:
    """Whether an NVIDIA GPU is there that Dr.Jit can use; asking never fails."""
    engine.activate()
    try:
        return bool(engine.dr.has_backend(engine.dr.JitBackend.CUDA))
    except Exception:  # whatever a broken driver makes of it, the chart does without
        return False


def _processor() -> str:
    """The processor's name, as Linux or else Python tells it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()


def _installed(name: str) -> bool:
    try:
        metadata.version(name)
    except metadata.PackageNotFoundError:
        return False
    return True
