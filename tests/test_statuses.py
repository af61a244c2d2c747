"""A status says in a sentence what happened, and what to do about it."""

import copy
import importlib
import pickle
import pkgutil
from enum import IntEnum

import numpy as np
import pytest

import virtual_sensor
from virtual_sensor.metrology.centres import Status
from virtual_sensor.statuses import StatusEnum

GOOD = {"OK", "FOUND", "HIT", "ENDED", "LEFT", "LIT", "KNOWN", "FITTED"}


def all_statuses():
    """Every status of the inner rooms."""
    for room in ("metrology", "optics"):
        package = importlib.import_module(f"{virtual_sensor.__name__}.{room}")
        for each in pkgutil.walk_packages(package.__path__, f"{package.__name__}."):
            importlib.import_module(each.name)
    return StatusEnum.__subclasses__()


def test_every_status_says_what_happened_and_what_to_do():
    """Rationale: 'too_narrow' helps only who has read the detector's code."""
    kinds = all_statuses()
    assert {"Status", "RayStatus", "CrossingStatus"} <= {kind.__name__ for kind in kinds}
    for member in (member for kind in kinds for member in kind):
        said = member.message
        assert said[0].isupper(), member
        assert said.endswith("."), member
        assert said.count(". ") == 0, f"{member!r}: one sentence"
        assert len(said) <= 230, member
        what, _, remedy = said.partition(": ")
        assert what, member
        assert remedy or member.name in GOOD, f"{member!r}: and the remedy?"


def test_every_enum_of_numbers_there_is_a_status():
    """Rationale: a new one without messages would be a number to its user."""
    all_statuses()
    ours = {each for each in IntEnum.__subclasses__() if each.__module__.startswith("virtual_")}
    inner = ("virtual_sensor.metrology", "virtual_sensor.optics")
    assert not {each for each in ours if each.__module__.startswith(inner)}


def test_numbers_become_members():
    """Rationale: results hold arrays of uint8; a person asks why."""
    numbers = np.array([[0, 3, 0], [1, 0, 0]], np.uint8)
    members = Status.of(numbers)
    assert members.shape == (2, 3)
    assert members[0, 1] is Status.TOO_NARROW
    assert Status(numbers[1, 0]) is Status.NO_PEAK
    assert Status.counts(numbers) == {Status.OK: 4, Status.TOO_NARROW: 1, Status.NO_PEAK: 1}
    assert next(iter(Status.counts(numbers))) is Status.OK
    assert Status.of([]).shape == (0,)
    assert Status.of(2) == Status.SATURATED
    assert Status.counts([]) == {}
    assert repr(Status.counts([1, 0, 0])) == "{Status.OK: 2, Status.NO_PEAK: 1}"
    with pytest.raises(ValueError, match="99 is not a valid Status"):
        Status.of([99])
    for again in (copy.deepcopy(Status.CUT), pickle.loads(pickle.dumps(Status.CUT))):
        assert again is Status.CUT
    assert np.array([Status.CUT]).dtype.kind == "i"
