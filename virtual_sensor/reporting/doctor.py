"""The doctor's diagnosis as people read it: a finding a line, and what to install."""

from virtual_sensor import engine
from virtual_sensor.studies.doctor import Diagnosis, Package

ADVICE = f"""\
Another LLVM   {engine.INSTALL_LLVM}
               or name a file: export DRJIT_LIBLLVM_PATH=/path/to/libLLVM.so.19.1
               (LLVM {engine.OLDEST_LLVM} or newer: older ones refuse to start or abort the process)
An NVIDIA GPU  --variant cuda_ad_mono, or export VIRTUAL_SENSOR_VARIANT=cuda_ad_mono
Fewer threads  export VIRTUAL_SENSOR_THREADS=4"""


def report(diagnosis: Diagnosis) -> str:
    """Write the diagnosis as text for a terminal, one finding a line."""
    verdict = "This machine can run virtual-sensor." if diagnosis.ok else "Something is missing."
    findings = _engine_lines(diagnosis) + [_package_line(p) for p in diagnosis.packages]
    return "\n".join([verdict, "", *findings, "", ADVICE])


def _engine_lines(diagnosis: Diagnosis) -> list[str]:
    running = diagnosis.engine
    if running is None:
        return [_line("Engine", f"none. {diagnosis.fault}")]
    threads = f"{running.threads} CPU thread{'s' * (running.threads > 1)}"
    lines = [_line("Engine", f"{running.backend}, {threads}"), _line("Variant", running.variant)]
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
