"""Finds out what computes on this machine, and what is missing."""

from __future__ import annotations

import importlib
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from virtual_sensor import engine
from virtual_sensor.display import Displayed
from virtual_sensor.engine import Engine
from virtual_sensor.errors import EngineError


@dataclass(frozen=True)
class Package(Displayed):
    """A package that the program needs.

    Attributes
    ----------
    name : str
    version : str or None
        None if it can't be used.
    fault : str or None
        Why it can't, and the remedy.
    """

    name: str
    version: str | None
    fault: str | None


@dataclass(frozen=True)
class Diagnosis(Displayed):
    """What works in this process.

    Attributes
    ----------
    engine : Engine or None
        What computes; None if nothing can.
    fault : str or None
        Why nothing can, and the remedy.
    cuda_device : bool or None
        Whether Dr.Jit finds an NVIDIA GPU; None if Dr.Jit did not start.
    packages : tuple of Package
        Python itself first.
    """

    engine: Engine | None
    fault: str | None
    cuda_device: bool | None
    packages: tuple[Package, ...]

    @property
    def ok(self) -> bool:
        """Whether the program can run."""
        return self.engine is not None and all(package.version for package in self.packages)


def diagnose() -> Diagnosis:
    """Activate the engine and import what the program needs; report failures, raise none."""
    running, fault, cuda_device = None, None, None
    try:
        running = engine.activate()
        cuda_device = bool(engine.dr.has_backend(engine.dr.JitBackend.CUDA))
    except EngineError as error:
        fault = str(error)
    except Exception as error:  # a broken Mitsuba may raise anything at its import
        fault = f"{type(error).__name__}: {error}"
    packages = (
        Package("Python", platform.python_version(), None),
        *(_installed(name) for name in ("mitsuba", "drjit")),
        *(_imported(name) for name in ("numpy", "scipy", "cv2", "OpenEXR")),
    )
    return Diagnosis(running, fault, cuda_device, packages)


def _installed(name: str) -> Package:
    """Ask the package's metadata: importing Dr.Jit without its LLVM would only add noise."""
    try:
        return Package(name, version(name), None)
    except PackageNotFoundError:
        return Package(name, None, "it is not installed: pip install mitsuba")


def _imported(name: str) -> Package:
    """Import the package: OpenCV may be installed and still lack a system library."""
    try:
        return Package(name, importlib.import_module(name).__version__, None)
    except Exception as error:
        return Package(name, None, f"{type(error).__name__}: {error}")
