"""What times were measured on: no time means anything without it."""

from __future__ import annotations

import os
import platform
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

from virtual_sensor import engine
from virtual_sensor.records import Record
from virtual_sensor.studies.provenance import MadeWith, made_with


@dataclass(frozen=True)
class Machine(Record):
    """A machine, and what runs on it.

    Attributes
    ----------
    date : str
        When it was asked.
    processor : str
        Its name.
    cores, usable_cores : int
        That it has, and that this process may use.
    system : str
        Operating system.
    load : float
        Processes that wanted a core in the minute before; NaN where the system doesn't say.
    made_with : MadeWith
        Engine and versions.
    """

    date: str
    processor: str
    cores: int
    usable_cores: int
    system: str
    load: float
    made_with: MadeWith


def machine() -> Machine:
    """What this process runs on."""
    cores = os.cpu_count() or 1
    usable = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else cores
    return Machine(
        date=datetime.now().astimezone().strftime("%Y-%m-%d %H:%M %Z"),
        processor=_processor(),
        cores=cores,
        usable_cores=usable,
        system=platform.platform(),
        load=os.getloadavg()[0] if hasattr(os, "getloadavg") else float("nan"),
        made_with=made_with(),
    )


def cuda_found() -> bool:
    """Whether an NVIDIA GPU is there that Dr.Jit can use; asking never fails."""
    engine.activate()
    try:
        return bool(engine.dr.has_backend(engine.dr.JitBackend.CUDA))
    except Exception:  # whatever a broken driver makes of it, the chart does without
        return False


def _processor() -> str:
    """The processor's name, as Linux or else Python gives it."""
    with suppress(OSError):
        for line in Path("/proc/cpuinfo").read_text(encoding="utf-8").splitlines():
            if line.startswith("model name"):
                return line.partition(":")[2].strip()
    return platform.processor() or platform.machine()
