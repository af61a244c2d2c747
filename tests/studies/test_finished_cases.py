"""Finished work is found again, other work is not taken for it, and no half results stay."""

import importlib
import os
import re
import shutil
import signal
import subprocess
import sys
import threading
import tomllib
from dataclasses import replace
from importlib import metadata
from pathlib import Path

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.studies import finished_cases as module
from virtual_sensor.studies.finished_cases import (
    file_hash,
    find,
    find_or_make,
    fingerprint,
    key_of,
    of_other_programs,
    own_folder,
    program,
    requirements,
)

ROOT = Path(__file__).parents[2]

INPUTS = {"beta": 15.0, "airs": ["resolved", "blurred"], "field": Path("air.nc"), "time": None}


def write(text):
    """A maker of work that is one file with a text."""
    return lambda folder: (folder / "work.txt").write_text(text)


def never(folder):
    raise AssertionError("made again")


def test_work_is_made_once(tmp_path):
    """Rationale: that is what it is stored for."""
    first = find_or_make(tmp_path, "nine", INPUTS, write("done"))
    assert first.name == f"nine-{key_of(INPUTS)}"
    assert find_or_make(tmp_path, "nine", INPUTS, never) == first == find(tmp_path, key_of(INPUTS))
    assert (first / "work.txt").read_text() == "done"


def test_the_same_work_under_another_name_is_the_same_work(tmp_path):
    """Rationale: a sweep that is extended by a parameter names its cases differently."""
    first = find_or_make(tmp_path, "beta=15", INPUTS, write("done"))
    assert find_or_make(tmp_path, "beta=15_temperature=1250", INPUTS, never) == first


@pytest.mark.parametrize(
    "change",
    [{"beta": 15.000000000000002}, {"beta": "15.0"}, {"airs": ["blurred", "resolved"]}, {"new": 0}],
)
def test_other_inputs_are_other_work(change):
    """Rationale: a result of other inputs is a wrong result."""
    assert key_of(INPUTS | change) != key_of(INPUTS)


def test_the_order_and_the_kind_of_equal_inputs_do_not_matter():
    """Rationale: a number from an array is the same number."""
    assert key_of({"a": 1, "b": 2.5}) == key_of({"b": np.float64(2.5), "a": np.int32(1)})
    assert key_of({"y": np.linspace(0.0, 1.0, 3)}) == key_of({"y": [0.0, 0.5, 1.0]})


def test_inputs_without_a_lasting_text_are_refused():
    """Rationale: an object's address would make a key that no other process finds."""
    with pytest.raises(TypeError, match="object"):
        key_of({"scene": object()})


def test_keys_are_the_same_in_another_process():
    """Rationale: a killed run goes on in a new one; sets and hashes differ there, keys must not."""
    program = (
        "from pathlib import Path; from virtual_sensor.studies.finished_cases import key_of\n"
        f"print(key_of({INPUTS!r}))".replace("PosixPath", "Path")
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.stdout.strip(), ended.stderr) == (key_of(INPUTS), "")


@pytest.fixture
def copied(tmp_path, monkeypatch):
    """Copies of the folders of the program, which are then hashed in their place."""
    folders = {tmp_path / folder.name: folder for folder in program()}
    for copy, folder in folders.items():
        shutil.copytree(folder, copy, ignore=shutil.ignore_patterns("fields", "meshes"))
    patterns = dict(zip(folders, program().values(), strict=True))
    monkeypatch.setattr(module, "program", lambda: patterns)
    return list(folders)


def now():
    """The program's hash, which a process else makes only once."""
    return fingerprint.__wrapped__()


def test_the_program_lies_where_it_is_imported_from():
    """Rationale: beside a checkout another version may be installed."""
    names = ("virtual_sensor", "virtual_sensor_plugins", "virtual_sensor_scenes")
    imported = [Path(importlib.import_module(name).__file__).parent for name in names]
    assert list(program()) == imported


def test_a_changed_byte_of_any_file_is_another_program(copied):
    """Rationale: after a bug is mended its results must go, wherever it was."""
    before = now()
    files = [file for folder in copied for file in folder.rglob("*.py")]
    files += [file for file in (copied[0] / "medium/heat_flow/case").rglob("*") if file.is_file()]
    assert len(files) > 190
    for file in files[::19]:
        whole = file.read_bytes()
        file.write_bytes(bytes([whole[0] ^ 1]) + whole[1:] if whole else b"#")
        assert now() != before, file
        file.write_bytes(whole)
    assert now() == before


def test_a_file_that_is_moved_gone_or_new_is_another_program(copied):
    """Rationale: an import finds another one then."""
    hashes = [now()]
    (copied[0] / "medium/air.py").rename(copied[0] / "optics/air.py")
    hashes.append(now())
    (copied[0] / "optics/air.py").unlink()
    hashes.append(now())
    (copied[0] / "optics/new.py").touch()
    hashes.append(now())
    assert len(set(hashes)) == len(hashes)


def test_place_times_and_compiled_files_make_no_other_program(copied):
    """Rationale: none of them changes what is computed."""
    assert now() == fingerprint()
    for folder in copied:
        for file in folder.rglob("*.py"):
            os.utime(file, (1e9, 1e9))
        (folder / "__pycache__").mkdir(exist_ok=True)
        (folder / "__pycache__/errors.cpython-399.pyc").write_bytes(b"new")
        (folder / "errors.pyc").write_bytes(b"new")
        (folder / ".errors.py.swp").write_text("an editor's")
    assert now() == fingerprint()


def test_what_is_installed_is_the_same_program_as_its_checkout(copied):
    """Rationale: of what lies in a checkout only some is shipped, and all of that counts."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    settings = settings["tool"]["setuptools"]
    tops = list(settings["package-dir"])
    shipped = set()
    for package in settings["packages"]:
        top, *rest = package.split(".")
        folder = copied[tops.index(top)].joinpath(*rest)
        patterns = ["*.py", *settings["package-data"].get(package, [])]
        shipped.update(file for pattern in patterns for file in folder.glob(pattern))
    assert len(shipped) > 190
    for folder in copied:
        for file in [file for file in folder.rglob("*") if file.is_file()]:
            if file not in shipped:
                file.unlink()
    assert now() == fingerprint()


@pytest.mark.parametrize("package", ["mitsuba", "numpy", "OpenEXR", "dask"])
def test_other_versions_are_another_program(package, monkeypatch):
    """Rationale: another renderer's last bits are not this one's."""
    before = now()
    version = module.metadata.version
    monkeypatch.setattr(
        module.metadata, "version", lambda name: "0" if name == package else version(name)
    )
    assert now() != before


def test_all_that_pyproject_requires_counts():
    """Rationale: a package that is new under the program must not be forgotten in a list."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))["project"]
    names = [re.match(r"[\w-]+", text)[0] for text in settings["dependencies"]]
    found = [text.split("==") for text in requirements()]
    assert sorted(name for name, _ in found) == sorted(names)
    assert all(version == metadata.version(name) for name, version in found)


@pytest.mark.parametrize("change", ["python", "variant", "llvm"])
def test_another_engine_is_another_program(change, monkeypatch):
    """Rationale: each compiles its own kernels, whose last bits are its own."""
    before = now()
    running = module.engine.activate()
    if change == "python":
        monkeypatch.setattr(module.platform, "python_version", lambda: "3.99.0")
    elif change == "variant":
        running = replace(running, variant="cuda_ad_mono")
    else:
        running = replace(running, llvm=replace(running.llvm, version="99.1.0"))
    monkeypatch.setattr(module.engine, "activate", lambda: running)
    assert now() != before


def test_a_program_that_is_not_installed_is_told(monkeypatch):
    """Rationale: nobody knows then which packages it stands on."""

    def absent(name):
        raise metadata.PackageNotFoundError(name)

    monkeypatch.setattr(module.metadata, "requires", absent)
    with pytest.raises(InputError, match=r"not installed.*pip install \."):
        now()


WORK = {"a": INPUTS, "b": {}}


def test_work_of_another_program_is_replaced_by_the_same_inputs_work(tmp_path, monkeypatch):
    """Rationale: a disk must not fill with what nobody reads, nor lose what is not made again."""
    first, other = (
        find_or_make(tmp_path, name, inputs, write("old")) for name, inputs in WORK.items()
    )
    assert of_other_programs(tmp_path) == []
    monkeypatch.setattr(module, "fingerprint", lambda: "f" * 8)
    assert sorted(of_other_programs(tmp_path)) == [first, other]
    assert of_other_programs(tmp_path, key_of(INPUTS)) == [first]
    with pytest.raises(InputError):
        find_or_make(tmp_path, "c", INPUTS, fails)
    assert sorted(tmp_path.iterdir()) == [first, other]
    again = find_or_make(tmp_path, "c", INPUTS, write("new"))
    assert sorted(tmp_path.iterdir()) == [other, again]
    assert (again / "work.txt").read_text() == "new"
    (tmp_path / "c-0123456789abcdef").mkdir()  # a key as version 0.5 had them
    assert sorted(of_other_programs(tmp_path)) == [other, tmp_path / "c-0123456789abcdef"]


def test_a_file_that_changes_has_another_hash(tmp_path):
    """Rationale: a field that is written again under its old name is another field."""
    file = tmp_path / "air.nc"
    file.write_text("cold")
    first = file_hash(file)
    file.write_text("hotter")
    assert file_hash(file) != first
    (tmp_path / "copy.nc").write_text("cold")
    assert file_hash(tmp_path / "copy.nc") == first
    with pytest.raises(InputError, match=r"none\.nc: can't be read"):
        file_hash(tmp_path / "none.nc")


def fails(folder):
    """A maker of work that ends halfway."""
    write("half")(folder)
    raise InputError("no light")


def test_work_that_fails_leaves_nothing(tmp_path):
    """Rationale: half of it would be taken for the whole."""
    with pytest.raises(InputError, match="no light"):
        find_or_make(tmp_path, "nine", INPUTS, fails)
    assert list(tmp_path.iterdir()) == []


def test_two_that_make_the_same_at_once_both_end_well(tmp_path):
    """Rationale: two workers may be given the same case; the first one's work stays, whole."""
    both = threading.Barrier(2)
    ended = []

    def make(folder):
        write("done")(folder)
        both.wait(timeout=60)  # now each has found nothing, and made its own

    def one():
        ended.append(find_or_make(tmp_path, "nine", INPUTS, make))

    threads = [threading.Thread(target=one) for _ in range(2)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    [place] = tmp_path.iterdir()
    assert ended == [place, place]
    assert (place / "work.txt").read_text() == "done"


KILLED = """
import os, signal, sys
from pathlib import Path
from virtual_sensor.studies.finished_cases import find_or_make

def make(folder):
    (folder / "work.txt").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)

find_or_make(Path(sys.argv[1]), "nine", {"beta": 15}, make)
"""


def test_a_killed_process_leaves_no_work_and_its_rubbish_goes_with_the_next(tmp_path):
    """Rationale: a folder that is there is whole, and a disk must not fill with halves."""
    ended = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], timeout=120)
    assert ended.returncode == -signal.SIGKILL
    assert [p.suffix for p in tmp_path.iterdir()] == [".unfinished"]
    assert find(tmp_path, key_of({"beta": 15})) is None
    place = find_or_make(tmp_path, "nine", {"beta": 15}, write("done"))
    assert list(tmp_path.iterdir()) == [place]
    assert (place / "work.txt").read_text() == "done"


def test_a_folder_is_ones_own_from_the_first_moment_on(tmp_path):
    """Rationale: what is unfinished goes on without --overwrite; a user's folder stays clean."""
    folder = tmp_path / "swept"
    for _ in range(2):
        own_folder(folder, "SWEEP.txt", "ours")
    assert (folder / "SWEEP.txt").read_text() == "ours"
    (tmp_path / "thesis.tex").touch()
    for taken, told in ((tmp_path, "holds other files"), (tmp_path / "thesis.tex", "not a folder")):
        with pytest.raises(InputError, match=f"{told}.*name another with -o"):
            own_folder(taken, "SWEEP.txt", "ours")
