"""The engine finds a library that works, refuses one that does not, and never dies of it.

What is loaded into a process stays there, so most tests start a Python of their own.
"""

import json
import os
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import pytest

from virtual_sensor import engine
from virtual_sensor.errors import EngineError

SYSTEM_LIBRARIES = Path("/usr/lib/x86_64-linux-gnu")
LLVM_14, LLVM_15 = (SYSTEM_LIBRARIES / f"libLLVM-{major}.so.1" for major in (14, 15))
needs_llvm_14 = pytest.mark.skipif(not LLVM_14.exists(), reason=f"{LLVM_14} is not installed")
needs_llvm_15 = pytest.mark.skipif(not LLVM_15.exists(), reason=f"{LLVM_15} is not installed")

DESCRIBE = """
import json, os
e = activate()
library = e.llvm
print(json.dumps({
    "variant": e.variant, "threads": e.threads, "path": str(library.path),
    "version": library.version, "origin": library.origin,
    "rejected": [[str(r.path), r.reason] for r in library.rejected],
}))
"""
IMPORT = "from virtual_sensor.engine import activate\n"


@pytest.fixture(scope="module")
def cache(tmp_path_factory):
    return tmp_path_factory.mktemp("cache")


@pytest.fixture
def python(cache, tmp_path):
    """Run code in a new Python, whose environment names no engine but as told; give its output."""

    def run(code, **settings):
        ours = ("DRJIT_", "VIRTUAL_SENSOR_")
        inherited = {k: v for k, v in os.environ.items() if not k.startswith(ours)}
        ended = subprocess.run(
            [sys.executable, "-c", code],
            env=inherited
            | {"XDG_CACHE_HOME": str(cache)}
            | {k: str(v) for k, v in settings.items()},
            cwd=tmp_path,
            capture_output=True,
            text=True,
            timeout=120,
        )
        assert ended.returncode == 0, ended.stderr
        return ended.stdout + ended.stderr

    return run


@pytest.fixture
def refusal(python):
    """Run code that ends in an EngineError; give its message."""

    def run(code, **settings):
        attempt = "".join(f"    {line}\n" for line in code.splitlines())
        return python(
            f"try:\n{attempt}    raise SystemExit('nothing was refused')\n"
            "except Exception as error:\n"
            "    assert type(error).__name__ == 'EngineError'\n"
            "    print(error)",
            **settings,
        )

    return run


@pytest.fixture
def only(monkeypatch, tmp_path):
    """Let the search see the given libraries and no others, with a cache of their own."""
    monkeypatch.setenv("XDG_CACHE_HOME", str(tmp_path / "cache"))

    def narrow(*libraries):
        monkeypatch.setattr(engine, "_sources", lambda: [("the test", list(libraries))])

    return narrow


def library_file(folder, name, release):
    """Write a file that carries LLVM's symbol version and nothing else."""
    path = folder / name
    path.write_bytes(b"\x7fELF\0LLVM_" + release.encode() + b"\0")
    return path


def test_the_engine_starts_with_the_wheels_llvm_and_computes_in_silence(python):
    """Rationale: after a plain `pip install` everything works, whatever LLVM the system has."""
    kernel = (
        "from virtual_sensor.engine import dr, mi\nprint(dr.sum(dr.minimum(mi.Float(1, 5), 3)))"
    )
    described, four = python(IMPORT + DESCRIBE + kernel).splitlines()
    assert four == "[4]"
    found = json.loads(described)
    assert found["variant"] == "llvm_ad_mono"
    assert found["origin"] == "the wheel karellen-llvm-core"
    assert Path(found["path"]).is_relative_to(Path(sys.prefix).resolve())
    assert int(found["version"].split(".")[0]) >= 17


def test_importing_the_engine_does_not_import_drjit(python):
    """Rationale: the tools that read images alone must not pay for a renderer, nor need one."""
    code = "import sys, virtual_sensor.engine\nprint({'drjit', 'mitsuba'} & sys.modules.keys())"
    assert python(code) == "set()\n"


@needs_llvm_15
def test_a_named_library_that_would_abort_is_passed_over_and_reported(python):
    """Rationale: Debian 12's LLVM 15 kills the process at the first kernel with a minimum."""
    found = json.loads(python(IMPORT + DESCRIBE, DRJIT_LIBLLVM_PATH=LLVM_15))
    [[path, reason]] = found["rejected"]
    assert path == str(LLVM_15)
    assert "LLVM 15" in reason
    assert found["path"] != path


@needs_llvm_15
def test_the_proof_survives_a_library_that_aborts():
    """Rationale: a library whose version cannot be read must not take the program with it."""
    assert "SIGABRT" in engine._prove(LLVM_15)


@pytest.mark.parametrize(
    "library",
    [
        pytest.param(LLVM_14, marks=[needs_llvm_14, pytest.mark.slow]),
        pytest.param(LLVM_15, marks=needs_llvm_15),
        Path("/nonexistent/libLLVM.so"),
    ],
    ids=["refuses", "aborts", "missing"],
)
def test_drjit_imported_first_with_a_bad_library_is_an_error_with_a_remedy(refusal, library):
    """Rationale: Dr.Jit loads LLVM once and for all; only a new start can mend it."""
    words = refusal(f"import drjit\n{IMPORT}activate()", DRJIT_LIBLLVM_PATH=library)
    assert "import virtual_sensor before drjit" in words
    named = words.partition("DRJIT_LIBLLVM_PATH=")[2].splitlines()[0]
    assert Path(named) == engine.find_llvm()[0]


@needs_llvm_15
@pytest.mark.parametrize(
    ("other", "named"),
    [
        ("drjit", LLVM_15),
        ("mitsuba", None),
        pytest.param("drjit", None, marks=pytest.mark.slow),
        pytest.param("mitsuba", LLVM_15, marks=pytest.mark.slow),
    ],
)
def test_who_imports_mitsuba_after_us_gets_an_llvm_that_works(python, named, other):
    """Rationale: by itself Dr.Jit loads the system's newest, and LLVM 15 aborts at a minimum."""
    code = (
        f"import virtual_sensor, {other}, drjit\n"
        "print(drjit.minimum(drjit.llvm.Float(1, 5), 3), drjit.detail.llvm_version()[0] >= 17)\n"
        + IMPORT
        + "print(activate().llvm.origin)"
    )
    settings = {"DRJIT_LIBLLVM_PATH": named} if named else {}
    assert python(code, **settings).splitlines() == [
        "[1, 3] True",
        "the wheel karellen-llvm-core",
    ]


@needs_llvm_15
def test_nobody_is_told_to_do_what_was_done(refusal):
    """Rationale: another library's LLVM is in use then; the remedy is to start with ours."""
    code = """
import virtual_sensor.engine as engine
engine.choose_llvm = lambda: None  # stands for what else loads LLVM first
import drjit
engine._chosen = engine.find_llvm()
engine.activate()
"""
    words = refusal(code, DRJIT_LIBLLVM_PATH=LLVM_15)
    assert "something else has loaded that library" in words
    assert "before drjit" not in words


def test_drjit_imported_first_with_a_good_library_is_kept_with_its_variant(python):
    """Rationale: a user's own Mitsuba session must go on as it was."""
    good, _, _ = engine.find_llvm()
    code = "import mitsuba\nmitsuba.set_variant('llvm_ad_rgb')\n" + IMPORT + DESCRIBE
    found = json.loads(python(code, DRJIT_LIBLLVM_PATH=good))
    assert found["variant"] == "llvm_ad_rgb"
    assert found["path"] == str(good)
    assert found["origin"] == "loaded before virtual_sensor"


def test_a_variant_that_cannot_serve_is_refused_and_a_good_one_still_starts(python):
    """Rationale: a slip in an option or a variable must say so, and leave the process usable."""
    code = """
import os
from virtual_sensor.engine import activate
from virtual_sensor.errors import EngineError
def attempt(variant=None):
    try:
        print(activate(variant).threads)
    except EngineError as error:
        print(error)
attempt("scalar_rgb")
attempt("llvm_ad_mno")
attempt("llvm_ad_spectral")
attempt("llvm_ad_spectral_polarized")
os.environ["VIRTUAL_SENSOR_THREADS"] = "few"
attempt()
os.environ["VIRTUAL_SENSOR_THREADS"] = "1"
attempt("llvm_ad_rgb")
attempt("llvm_ad_mono")
"""
    scalar, unknown, *spectral, threads, started, late = python(code).splitlines()
    for words, other in zip(spectral, ("mono", "mono_polarized"), strict=True):
        assert f"the laser has one: choose 'llvm_ad_{other}'" in words
    assert "'scalar_rgb'" in scalar
    assert "'llvm_ad_mono'" in scalar
    assert "no variant 'llvm_ad_mno'" in unknown
    assert "VIRTUAL_SENSOR_THREADS is 'few'" in threads
    assert started == "1"
    assert "'llvm_ad_rgb' is active" in late


def test_a_scalar_variant_set_by_the_caller_is_an_error(refusal):
    """Rationale: the sensor's rays are Dr.Jit arrays, which the scalar variants lack."""
    code = "import mitsuba\nmitsuba.set_variant('scalar_rgb')\n" + IMPORT + "activate()"
    assert "'scalar_rgb'" in refusal(code, DRJIT_LIBLLVM_PATH=engine.find_llvm()[0])


def test_cuda_without_a_device_is_an_error_that_names_the_way_out(refusal):
    """Rationale: the GPU is one option away, and a machine without one must say so at once."""
    settings = {"VIRTUAL_SENSOR_VARIANT": "cuda_ad_mono", "CUDA_VISIBLE_DEVICES": ""}
    words = refusal("from virtual_sensor.engine import dr", **settings)
    assert "NVIDIA GPU" in words
    assert "'llvm_ad_mono'" in words


def test_a_file_that_is_no_library_is_rejected(only, tmp_path):
    """Rationale: a name promises nothing; the proof decides."""
    fake = tmp_path / "libLLVM-19.so"
    fake.write_text("not a library")
    only(fake)
    with pytest.raises(EngineError, match=r"(?s)pip install karellen-llvm-core.*Unable to load"):
        engine.find_llvm()


def test_a_proof_is_remembered_until_the_library_changes(only, tmp_path, monkeypatch):
    """Rationale: the proof costs a second, too much for each start of a command."""
    library = library_file(tmp_path, "libLLVM.so", "19.1")
    only(library)
    proofs = []
    monkeypatch.setattr(engine, "_prove", lambda path: proofs.append(path))
    assert engine.find_llvm()[0] == engine.find_llvm()[0] == library
    assert len(proofs) == 1
    os.utime(library, (0, 0))
    engine.find_llvm()
    assert len(proofs) == 2


def test_a_failed_proof_is_not_remembered(only, tmp_path, monkeypatch):
    """Rationale: a busy machine may time out once; the next start must try again."""
    library = library_file(tmp_path, "libLLVM.so", "19.1")
    only(library)
    monkeypatch.setattr(engine, "_prove", lambda path: "too slow")
    with pytest.raises(EngineError, match="too slow"):
        engine.find_llvm()
    monkeypatch.setattr(engine, "_prove", lambda path: None)
    assert engine.find_llvm()[0] == library


def test_a_cache_that_cannot_be_used_costs_a_proof_and_nothing_else(only, tmp_path, monkeypatch):
    """Rationale: read-only homes and full disks are common on shared machines."""
    library = library_file(tmp_path, "libLLVM.so", "19.1")
    only(library)
    (tmp_path / "cache").write_text("a file where the folder should be")
    monkeypatch.setattr(engine, "_prove", lambda path: None)
    assert engine.find_llvm()[0] == engine.find_llvm()[0] == library


def test_who_has_no_home_has_a_cache_among_the_temporary_files(tmp_path, monkeypatch):
    """Rationale: in a container's nameless user's folder, a folder named "~" would be made."""
    library = library_file(tmp_path, "libLLVM.so", "19.1")
    for name in ("HOME", "XDG_CACHE_HOME"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("pwd.getpwuid", dict[int, Any]().__getitem__)
    assert engine._proof_file(library).parent == Path(tempfile.gettempdir(), "virtual_sensor")


def test_libraries_are_tried_newest_first_and_once(tmp_path, monkeypatch):
    """Rationale: names sort 9 after 19, and distributions link one file under many names."""
    for name, release in {
        "libLLVM-9.so": "9",
        "libLLVM.so.18.1": "18.1",
        "libLLVM.so.20.1": "20.1",
    }.items():
        library_file(tmp_path, name, release)
    (tmp_path / "libLLVM.so").symlink_to("libLLVM.so.18.1")
    (tmp_path / "libLLVMCore.so").touch()
    monkeypatch.setenv("LD_LIBRARY_PATH", str(tmp_path))
    ours = [path.name for path, _ in engine._candidates() if path.parent == tmp_path]
    assert ours == ["libLLVM.so.20.1", "libLLVM.so.18.1", "libLLVM-9.so"]


def test_the_wheel_is_found_where_its_record_says(tmp_path, monkeypatch):
    """Rationale: `pip install --user` puts the library outside sys.prefix."""
    folder = tmp_path / "lib"
    folder.mkdir()
    library = library_file(folder, "libLLVM.so.19.1", "19.1")
    record = tmp_path / "site" / "karellen_llvm_core-19.1.7.dist-info"
    record.mkdir(parents=True)
    (record / "METADATA").write_text("Name: karellen-llvm-core\nVersion: 19.1.7\n")
    (record / "RECORD").write_text("../lib/libLLVM.so.19.1,,\n../lib/libLTO.so.19.1,,\n")
    monkeypatch.syspath_prepend(tmp_path / "site")
    monkeypatch.delenv("DRJIT_LIBLLVM_PATH", raising=False)
    assert next(engine._candidates()) == (library, "the wheel karellen-llvm-core")


DOCTOR = """
from virtual_sensor.reporting.doctor import report
from virtual_sensor.studies.doctor import diagnose
diagnosis = diagnose()
print(report(diagnosis))
print(diagnosis.ok)
"""


def test_the_doctor_tells_what_computes_and_what_was_rejected(python):
    """Rationale: the first thing to ask of a user in trouble is this text."""
    words = python(DOCTOR, DRJIT_LIBLLVM_PATH="/nonexistent/libLLVM.so")
    assert words.endswith("True\n")
    for told in (
        "llvm_ad_mono",
        "the wheel",
        "rejected",
        "/nonexistent/libLLVM.so",
        "cuda_ad_mono",
    ):
        assert told in words


def test_the_doctor_reports_when_nothing_works(python, tmp_path):
    """Rationale: a doctor that falls ill with the patient is of no use."""
    fake = library_file(tmp_path, "libLLVM-15.so", "15")
    narrow = (
        "from virtual_sensor import engine\n"
        f"engine._sources = lambda: [('the test', [engine.Path({str(fake)!r})])]"
    )
    words = python(narrow + DOCTOR)
    assert words.endswith("False\n")
    for told in (str(fake), "LLVM 15", "pip install karellen-llvm-core", "libllvm19"):
        assert told in words
