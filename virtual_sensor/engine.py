"""Finds a working LLVM or GPU and sets the Mitsuba variant, before anything imports drjit.

Every module that computes with Dr.Jit says ``from virtual_sensor.engine import dr, mi``: the first
such import activates the engine. Until then drjit is not imported.

Dr.Jit's CPU backend loads an LLVM shared library while it is imported, by default the system's
newest. LLVM 15 and 16 then abort the process at the first kernel that takes a minimum. So each
library is first proven in a process of its own, and the proof is remembered. Whoever imports drjit
or mitsuba after virtual_sensor gets a proven library too.

====================== ===========================================================
environment variable   meaning
====================== ===========================================================
VIRTUAL_SENSOR_VARIANT Mitsuba variant, by default ``llvm_ad_mono``
VIRTUAL_SENSOR_THREADS number of CPU threads, by default Dr.Jit's choice
DRJIT_LIBLLVM_PATH     the LLVM library to try first; set to the one that is used
XDG_CACHE_HOME         where ``virtual_sensor/`` keeps the proofs, else ``~/.cache``
====================== ===========================================================
"""

from __future__ import annotations

import hashlib
import importlib
import mmap
import os
import pickle
import re
import signal
import subprocess
import sys
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, distribution, version
from pathlib import Path
from typing import TYPE_CHECKING, Any

from platformdirs import user_cache_path

from virtual_sensor.display import Displayed
from virtual_sensor.errors import EngineError
from virtual_sensor.files import scratch_folder

if TYPE_CHECKING:
    import drjit as dr
    import mitsuba as mi

__all__ = ["Engine", "Llvm", "RejectedLibrary", "activate", "dr", "find_llvm", "mi", "under"]

DEFAULT_VARIANT = "llvm_ad_mono"
OLDEST_LLVM = 17
PROOF_TIMEOUT_S = 120
WHEEL = "karellen-llvm-core"
INSTALL_LLVM = f"pip install {WHEEL}==19.1.7 (or, on Debian: apt install libllvm19)"

LIBRARY_NAME = re.compile(r"libLLVM(-\d[\w.]*)?\.so[\d.]*")
SYSTEM_FOLDERS = (
    "usr/lib/*-linux-gnu",
    "usr/lib/llvm*/lib",
    "usr/lib/llvm/*/lib*",
    "usr/lib64",
    "usr/lib64/llvm*/lib",
    "usr/lib",
    "usr/local/lib*",
)

# Minimum and maximum are what LLVM 15 and 16 die of; the sums are exact in both precisions.
PROOF = """
import sys
sys.tracebacklimit = 0
import drjit as dr
from drjit.llvm import Float, Float64, UInt32
for Real in Float, Float64:
    x = dr.arange(Real, 8) - 3
    y = dr.fma(dr.maximum(x, 0.5), 2, dr.minimum(x, 1))
    sums = dr.zeros(Real, 2)
    dr.scatter_add(sums, y, dr.arange(UInt32, 8) & 1)
    if list(sums) != [8, 14]:
        sys.exit(f"a test kernel sums to {list(sums)} instead of [8, 14]")
"""


@dataclass(frozen=True)
class RejectedLibrary(Displayed):
    """An LLVM library that cannot serve, who named it, and why it cannot."""

    path: Path
    origin: str
    reason: str

    def __str__(self) -> str:
        return f"{self.path} ({self.origin}): {self.reason}"


@dataclass(frozen=True)
class Llvm(Displayed):
    """The LLVM library in use.

    Attributes
    ----------
    path : Path or None
        None where the system does not tell which file Dr.Jit has loaded.
    version : str
        As Dr.Jit reads it, such as ``19.1.7``.
    origin : str
        Who named the library: the user, the wheel, this Python environment, the system.
    rejected : tuple of RejectedLibrary
        Those tried before it.
    """

    path: Path | None
    version: str
    origin: str
    rejected: tuple[RejectedLibrary, ...] = ()


@dataclass(frozen=True)
class Engine(Displayed):
    """What computes in this process.

    Attributes
    ----------
    variant : str
        Mitsuba's variant, such as ``llvm_ad_mono``.
    backend : str
        ``llvm`` or ``cuda``.
    llvm : Llvm or None
        The library in use; None under CUDA.
    threads : int
        CPU threads, the calling one included.
    """

    variant: str
    backend: str
    llvm: Llvm | None
    threads: int


_active: Engine | None = None
_chosen: tuple[Path, str, tuple[RejectedLibrary, ...]] | None = None


def __getattr__(name: str) -> Any:
    """Activate the engine at the first use of ``dr`` or ``mi`` (PEP 562)."""
    if name not in ("dr", "mi"):
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    activate()
    globals().update(dr=sys.modules["drjit"], mi=sys.modules["mitsuba"])
    return globals()[name]


def activate(variant: str | None = None) -> Engine:
    """Start Dr.Jit and set Mitsuba's variant; later calls return the same engine.

    Parameters
    ----------
    variant : str, optional
        ``llvm_ad_*`` or ``cuda_ad_*``. Left out: the variant that the caller has given to Mitsuba,
        else ``VIRTUAL_SENSOR_VARIANT``, else ``llvm_ad_mono``.

    Raises
    ------
    EngineError
        No LLVM works, there is no CUDA device, the variant cannot serve, or another one is active.
    """
    global _active
    current = _active.variant if _active else _mitsuba_variant()
    if current and variant not in (None, current):
        raise EngineError(
            f"the variant {current!r} is active, too late for {variant!r}: choose it first, by "
            "VIRTUAL_SENSOR_VARIANT or by calling activate() before anything computes"
        )
    if _active is None:
        _active = _start(
            current or variant or os.environ.get("VIRTUAL_SENSOR_VARIANT") or DEFAULT_VARIANT
        )
    return _active


def under(variant: str, function: str, data: bytes) -> Any:
    """Call a function, "module:name", with pickled arguments once a variant is active.

    To import what they are made of starts the engine, with another variant than theirs maybe.

    Raises
    ------
    EngineError
        As `activate` does.
    """
    if _mitsuba_variant() != variant:
        activate(variant)
    module, _, name = function.partition(":")
    return getattr(importlib.import_module(module), name)(*pickle.loads(data))


def find_llvm() -> tuple[Path, str, tuple[RejectedLibrary, ...]]:
    """Find the first LLVM library that is proven to work, without loading it here.

    Returns
    -------
    path : Path
        The library's real path.
    origin : str
        Who named it.
    rejected : tuple of RejectedLibrary
        Those tried before it.

    Raises
    ------
    EngineError
        None works; the message lists those tried.
    """
    rejected: list[RejectedLibrary] = []
    for path, origin in _candidates():
        fault = _fault(path)
        if fault is None:
            return path, origin, tuple(rejected)
        rejected.append(RejectedLibrary(path, origin, fault))
    tried = "".join(f"\n  {library}" for library in rejected) or " nothing, none is installed"
    raise EngineError(f"no LLVM {OLDEST_LLVM} or newer works here: {INSTALL_LLVM}. Tried:{tried}")


def _mitsuba_variant() -> str | None:
    mitsuba = sys.modules.get("mitsuba")
    return mitsuba.variant() if mitsuba else None


def _start(variant: str) -> Engine:
    backend = variant.partition("_")[0]
    if backend not in ("llvm", "cuda"):
        raise EngineError(
            f"the Mitsuba variant {variant!r} has no arrays to compute with: choose "
            f"{DEFAULT_VARIANT!r} or, with an NVIDIA GPU, 'cuda_ad_mono'"
        )
    if "spectral" in variant:
        raise EngineError(
            f"the Mitsuba variant {variant!r} draws wavelengths at random, and the laser has one: "
            f"choose {variant.replace('spectral', 'mono')!r}"
        )
    threads = _requested_threads()
    llvm = _load_llvm() if backend == "llvm" else None

    import drjit
    import mitsuba

    if backend == "cuda" and not drjit.has_backend(drjit.JitBackend.CUDA):
        raise EngineError(
            f"the variant {variant!r} needs an NVIDIA GPU and its driver, and Dr.Jit finds none "
            f"(does nvidia-smi list one?): choose {DEFAULT_VARIANT!r} to compute on the CPU"
        )
    if variant not in mitsuba.variants():
        raise EngineError(
            f"Mitsuba has no variant {variant!r}: choose one of "
            + ", ".join(v for v in mitsuba.variants() if v.startswith(backend))
        )
    if mitsuba.variant() != variant:
        mitsuba.set_variant(variant)
    if threads:
        drjit.set_thread_count(threads)
    return Engine(variant, backend, llvm, drjit.thread_count())


def _requested_threads() -> int | None:
    text = os.environ.get("VIRTUAL_SENSOR_THREADS")
    if not text:
        return None
    if not text.isdecimal() or int(text) < 1:
        raise EngineError(f"VIRTUAL_SENSOR_THREADS is {text!r}: give a whole number from 1 up")
    return int(text)


def _load_llvm() -> Llvm:
    """Import drjit with a proven library, or judge the one that it has loaded already."""
    if "drjit" not in sys.modules:
        choose_llvm()

    import drjit

    path, origin, rejected = _chosen or (None, "loaded before virtual_sensor", ())
    release = drjit.detail.llvm_version()  # (-1, -1, -1) where Dr.Jit has none or refused it
    loaded = next((library for library in _mapped() if _major(library) == release[0]), path)
    if release[0] < OLDEST_LLVM:
        found = f"LLVM {release[0]} ({loaded})" if release[0] > 0 else "no LLVM that it can use"
        raise EngineError(
            f"Dr.Jit was imported with {found}: {_remedy()}start Python with"
            f" DRJIT_LIBLLVM_PATH={find_llvm()[0]}"
        )
    return Llvm(loaded, ".".join(map(str, release)), origin, rejected)


def choose_llvm() -> None:
    """Find an LLVM library once, and have Dr.Jit load it when it is imported."""
    global _chosen
    if _chosen is None:
        _chosen = find_llvm()
        os.environ["DRJIT_LIBLLVM_PATH"] = str(_chosen[0])


def _remedy() -> str:
    """What would have helped, but for the environment variable."""
    if _chosen:
        return "something else has loaded that library before; import virtual_sensor first, or "
    return "import virtual_sensor before drjit, mitsuba and whatever else loads LLVM, or "


def _mapped() -> list[Path]:
    """List the LLVM libraries mapped into this process; empty where there is no /proc."""
    try:
        lines = Path("/proc/self/maps").read_text(errors="replace").splitlines()
    except OSError:
        return []
    files = dict.fromkeys(Path(line[line.index("/") :]) for line in lines if "/libLLVM" in line)
    return [file for file in files if LIBRARY_NAME.fullmatch(file.name)]


def _candidates() -> Iterator[tuple[Path, str]]:
    """Yield each library once, by its real path, with who named it, the most trusted first."""
    seen: set[Path] = set()
    for origin, files in _sources():
        for path in files:
            if path not in seen:
                seen.add(path)
                yield path, origin


def _sources() -> Iterator[tuple[str, list[Path]]]:
    named = os.environ.get("DRJIT_LIBLLVM_PATH")
    if named:
        yield "DRJIT_LIBLLVM_PATH", [Path(named).resolve()]
    yield f"the wheel {WHEEL}", _newest_first(_wheel_files())
    yield "this Python environment", _newest_first(Path(sys.prefix, "lib").glob("libLLVM*"))
    search_path = filter(None, os.environ.get("LD_LIBRARY_PATH", "").split(os.pathsep))
    yield "LD_LIBRARY_PATH", _newest_first(f for d in search_path for f in Path(d).glob("libLLVM*"))
    system = (f for folder in SYSTEM_FOLDERS for f in Path("/").glob(f"{folder}/libLLVM*"))
    yield "the system", _newest_first(system)


def _wheel_files() -> list[Path]:
    """List the wheel's files; its record knows them outside sys.prefix too, in a user's folder."""
    try:
        wheel = distribution(WHEEL)
    except PackageNotFoundError:
        return []
    record = (wheel.read_text("RECORD") or "").splitlines()
    return [Path(str(wheel.locate_file(row.split(",")[0]))) for row in record if "/libLLVM" in row]


def _newest_first(files: Iterable[Path]) -> list[Path]:
    libraries = {file.resolve() for file in files if LIBRARY_NAME.fullmatch(file.name)}
    existing = [library for library in libraries if library.is_file()]
    return sorted(existing, key=lambda library: (_major(library) or 0, library), reverse=True)


def _major(library: Path) -> int | None:
    """Read LLVM's major version from the file's symbol version, else from its name."""
    with (
        suppress(OSError, ValueError),
        library.open("rb") as file,
        mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ) as image,
    ):
        if found := re.search(rb"\0LLVM_(\d+)[.\d]*\0", image):
            return int(found[1])
    named = re.match(r"libLLVM(?:-|\.so\.)(\d\d)", library.name)
    return int(named[1]) if named else None


def _fault(library: Path) -> str | None:
    """Say why the library cannot serve; None if test kernels are proven to run with it."""
    try:
        proof = _proof_file(library)
    except OSError as error:
        return error.strerror
    major = _major(library)
    if major is not None and major < OLDEST_LLVM:
        return f"LLVM {major} cannot run Dr.Jit's kernels, {OLDEST_LLVM} or newer can"
    with suppress(OSError):
        if proof.exists():
            return None
    fault = _prove(library)
    if fault is None:
        with suppress(OSError):  # an unwritable cache costs a second at each start, no more
            proof.parent.mkdir(parents=True, exist_ok=True)
            proof.touch()
    return fault


def _proof_file(library: Path) -> Path:
    """Name the empty file whose existence says that the library has passed the proof."""
    key = (library, library.stat().st_mtime_ns, version("drjit"), sys.version, PROOF)
    digest = hashlib.sha256(repr(key).encode()).hexdigest()
    try:
        cache = user_cache_path("virtual_sensor")
    except RuntimeError:  # a user without a home, as in a container
        cache = Path(tempfile.gettempdir(), "virtual_sensor")
    return cache / f"llvm_works_{digest[:16]}"


def _prove(library: Path) -> str | None:
    """Run the test kernels in a process of its own, which may abort; say what went wrong."""
    try:
        with scratch_folder() as folder:
            run = subprocess.run(
                [sys.executable, "-c", PROOF],
                env=os.environ
                | {"DRJIT_LIBLLVM_PATH": str(library), "DRJIT_CACHE_DIR": str(folder)},
                cwd=folder,
                capture_output=True,
                text=True,
                errors="replace",
                timeout=PROOF_TIMEOUT_S,
            )
    except subprocess.TimeoutExpired:
        return f"its test kernels did not end within {PROOF_TIMEOUT_S} s"
    except OSError as error:
        return f"its test kernels did not start: {error}"
    if run.returncode == 0:
        return None
    ending = signal.Signals(-run.returncode).name if run.returncode < 0 else "an error"
    said = run.stderr.strip().partition("\n")[0]
    return f"its test kernels ended with {ending}: {said or 'nothing was said'}"
