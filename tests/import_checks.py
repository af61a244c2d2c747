"""A small plume for tests of importers, and what an import of it must be."""

import re

import numpy as np
import pytest
from plume_files import lattice, temperature

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.import_field import Choices, import_field

X, Y, Z = np.linspace(-40, 40, 5), np.linspace(-24, 24, 7), np.linspace(0, 40, 6)
NODES = lattice(X, Y, Z)
VALUES = temperature(NODES)
ROWS = np.column_stack([NODES.reshape(-1, 3), VALUES.ravel()])
HEADER = "x [mm],y [mm],z [mm],T [K]\n"
PART = (abs(NODES[..., 1]) < 9) & (NODES[..., 2] > 7) & (NODES[..., 2] < 33)
PART &= abs(NODES[..., 0]) < 30


def table_of(reader):
    """The features of a reader's table, and what is said to be done of each."""
    lines = reader.__doc__.splitlines()
    rules = [i for i, line in enumerate(lines) if re.fullmatch(r"\s*=+  =+", line)]
    column = lines[rules[0]].index("  ", len(lines[rules[0]]) - len(lines[rules[0]].lstrip()))
    rows = lines[rules[1] + 1 : rules[2]]
    return {line[:column].strip(): line[column:].strip() for line in rows}


def imported(path, **choices):
    return import_field(path, Choices(**choices))


def error(made, truth=temperature):
    """Largest error of a field's values at its nodes in the air, K."""
    q = made.quantity
    axes = (
        o + s * np.arange(n)
        for o, s, n in zip(q.origin_mm, q.spacing_mm, q.values.shape, strict=True)
    )
    return np.nanmax(abs(q.values - truth(lattice(*axes))))


def same(made, shape=VALUES.shape):
    """It is the plume, at the nodes where it was given."""
    assert made.quantity.values.shape == shape
    assert error(made) < 1e-3  # single precision and printed digits; the plume is 500 K


def refused(path, match, **choices):
    """Import in vain; the message is one line that begins with the file's name."""
    with pytest.raises(InputError, match=match) as caught:
        imported(path, **choices)
    assert f"{caught.value}".startswith(f"{path}: ")
    assert "\n" not in f"{caught.value}"


def written(path, text, encoding="utf-8"):
    path.write_bytes(text.encode(encoding))
    return path


def rows(mark=",", values=ROWS):
    return "".join(mark.join(map(repr, row)) + "\n" for row in values.tolist())
