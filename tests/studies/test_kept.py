"""Finished work is found again, other work is not taken for it, and nothing is kept by half."""

import json
import signal
import subprocess
import sys
import threading
from pathlib import Path

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.studies import kept as module
from virtual_sensor.studies.kept import (
    file_hash,
    fingerprint,
    found,
    kept,
    key_of,
    own_folder,
    sources,
)

INPUTS = {"beta": 15.0, "airs": ["resolved", "blurred"], "field": Path("air.nc"), "time": None}


def write(text):
    """A maker of work that is one file with a text."""
    return lambda folder: (folder / "work.txt").write_text(text)


def never(folder):
    raise AssertionError("made again")


def test_work_is_made_once(tmp_path):
    """Rationale: that is what it is kept for."""
    first = kept(tmp_path, "nine", INPUTS, write("done"))
    assert first.name == f"nine-{key_of(INPUTS)}"
    assert kept(tmp_path, "nine", INPUTS, never) == first == found(tmp_path, key_of(INPUTS))
    assert (first / "work.txt").read_text() == "done"


def test_the_same_work_under_another_name_is_the_same_work(tmp_path):
    """Rationale: a sweep that is extended by a parameter names its cases anew."""
    first = kept(tmp_path, "beta=15", INPUTS, write("done"))
    assert kept(tmp_path, "beta=15_temperature=1250", INPUTS, never) == first


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
        "from pathlib import Path; from virtual_sensor.studies.kept import key_of\n"
        f"print(key_of({INPUTS!r}))".replace("PosixPath", "Path")
    )
    ended = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True)
    assert (ended.stdout.strip(), ended.stderr) == (key_of(INPUTS), "")


CHANGED = ["optics/eikonal.py", "studies/measure.py", "engine.py", "studies/notes.py"]


@pytest.mark.parametrize("source", CHANGED)
def test_a_changed_program_keeps_nothing(source, monkeypatch):
    """Rationale: after a bug is mended its results must go."""
    before = fingerprint.__wrapped__()
    assert before == fingerprint()
    read = Path.read_bytes

    def changed(path):
        return read(path) + (b"#" if path.as_posix().endswith(f"virtual_sensor/{source}") else b"")

    monkeypatch.setattr(Path, "read_bytes", changed)
    assert fingerprint.__wrapped__() != before


MEASURED = """
import json, sys
from pathlib import Path
import virtual_sensor as vs
from virtual_sensor.studies.measure import measure, summary
from virtual_sensor.studies.results import save
result = measure(vs.load_scene("cold_cylinder", width=64, height=64, spp=1, line_radius=2))
save(result, summary(result), Path(sys.argv[1]))
ours = {n: m.__file__ for n, m in sys.modules.items() if n.startswith("virtual_sensor")}
print(json.dumps(ours))
"""


def test_the_program_is_all_that_a_measurement_imports(tmp_path):
    """Rationale: of a list that is written by hand a new helper is missing: old results stay."""
    line = [sys.executable, "-c", MEASURED, str(tmp_path / "out")]
    # Not where the sources lie beside: what is installed measures.
    ended = subprocess.run(line, capture_output=True, text=True, check=True, cwd=tmp_path)
    imported = {name: Path(file) for name, file in json.loads(ended.stdout).items()}
    imported.pop("virtual_sensor_scenes")  # data: their files are among the inputs
    program = sources("virtual_sensor.studies.sweep")
    assert len(imported) > 40
    assert imported.items() <= program.items()
    assert not any(".cli" in name or ".chart" in name for name in program)


@pytest.mark.parametrize("package", ["mitsuba", "numpy", "OpenEXR"])
def test_other_versions_are_another_program(package, monkeypatch):
    """Rationale: another renderer's last bits are not this one's."""
    before = fingerprint.__wrapped__()
    version = module.metadata.version
    monkeypatch.setattr(
        module.metadata, "version", lambda name: "0" if name == package else version(name)
    )
    assert fingerprint.__wrapped__() != before


def test_a_file_that_changes_has_another_hash(tmp_path):
    """Rationale: a field that is written anew under its old name is another field."""
    file = tmp_path / "air.nc"
    file.write_text("cold")
    first = file_hash(file)
    file.write_text("hotter")
    assert file_hash(file) != first
    (tmp_path / "copy.nc").write_text("cold")
    assert file_hash(tmp_path / "copy.nc") == first
    with pytest.raises(InputError, match=r"none\.nc: can't be read"):
        file_hash(tmp_path / "none.nc")


def test_work_that_fails_leaves_nothing(tmp_path):
    """Rationale: half of it would be taken for the whole."""

    def fails(folder):
        write("half")(folder)
        raise InputError("no light")

    with pytest.raises(InputError, match="no light"):
        kept(tmp_path, "nine", INPUTS, fails)
    assert list(tmp_path.iterdir()) == []


def test_two_that_make_the_same_at_once_both_end_well(tmp_path):
    """Rationale: two workers may be given the same case; the first one's work stays, whole."""
    both = threading.Barrier(2)
    ended = []

    def make(folder):
        write("done")(folder)
        both.wait(timeout=60)  # now each has found nothing, and made its own

    def one():
        ended.append(kept(tmp_path, "nine", INPUTS, make))

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
from virtual_sensor.studies.kept import kept

def make(folder):
    (folder / "work.txt").write_text("half")
    os.kill(os.getpid(), signal.SIGKILL)

kept(Path(sys.argv[1]), "nine", {"beta": 15}, make)
"""


def test_a_killed_process_leaves_no_work_and_its_rubbish_goes_with_the_next(tmp_path):
    """Rationale: a folder that is there is whole, and a disk must not fill with halves."""
    ended = subprocess.run([sys.executable, "-c", KILLED, str(tmp_path)], timeout=120)
    assert ended.returncode == -signal.SIGKILL
    assert [p.suffix for p in tmp_path.iterdir()] == [".unfinished"]
    assert found(tmp_path, key_of({"beta": 15})) is None
    place = kept(tmp_path, "nine", {"beta": 15}, write("done"))
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
