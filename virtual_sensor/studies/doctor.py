"""Says in plain words what computes on this machine, what was turned down, and what to install."""

from __future__ import annotations

import importlib
import platform
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version

from virtual_sensor import engine
from virtual_sensor.engine import Engine
from virtual_sensor.errors import EngineError

ADVICE = f"""\
Another LLVM   {engine.INSTALL_LLVM}
               or name a file: export DRJIT_LIBLLVM_PATH=/path/to/libLLVM.so.19.1
               (LLVM {engine.OLDEST_LLVM} or newer: older ones refuse to start or abort the process)
An NVIDIA GPU  --variant cuda_ad_mono, or export VIRTUAL_SENSOR_VARIANT=cuda_ad_mono
Fewer threads  export VIRTUAL_SENSOR_THREADS=4"""


@dataclass(frozen=True)
class Package:
    """A package that the program stands on: its version, or what is wrong with it."""

    name: str
    version: str | None
    fault: str | None


@dataclass(frozen=True)
class Diagnosis:
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
    """Activate the engine and import what the program stands on; report failures, raise none."""
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


def report(diagnosis: Diagnosis) -> str:
    """Write the diagnosis as text for a terminal, one finding a line."""
    verdict = "This machine can run virtual-sensor." if diagnosis.ok else "Something is missing."
    findings = _engine_lines(diagnosis) + [_package_line(p) for p in diagnosis.packages]
    return "\n".join([verdict, "", *findings, "", ADVICE])


def _engine_lines(diagnosis: Diagnosis) -> list[str]:
    running = diagnosis.engine
    if running is None:
        return [_line("Engine", f"none. {diagnosis.fault}")]
    lines = [_line("Engine", f"{running.backend}, {running.threads} CPU threads")]
    lines.append(_line("Variant", running.variant))
    if running.llvm:
        lines.append(_line("LLVM", f"{running.llvm.version}, from {running.llvm.origin}"))
        lines.append(_line("", str(running.llvm.path)))
        lines += [_line("  rejected", str(library)) for library in running.llvm.rejected]
    lines.append(_line("NVIDIA GPU", "found" if diagnosis.cuda_device else "none found"))
    return lines


def _package_line(package: Package) -> str:
    return _line(package.name, package.version or f"not usable. {package.fault}")


def _line(subject: str, words: str) -> str:
    return f"{subject:15}" + words.replace("\n", "\n" + 15 * " ")


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
