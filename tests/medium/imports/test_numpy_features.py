"""NumPy's files: what the reader's table says of each feature is done."""

import numpy as np
import pytest
from import_checks import PART, ROWS, VALUES, X, Y, Z, imported, refused, same, table_of
from plume_files import K

from virtual_sensor.medium.imports.tables import read_numpy


def npz(path, **arrays):
    np.savez(path, **arrays)
    return path


def numpy_grids(folder):
    same(imported(npz(folder / "a.npz", x=X, y=Y, z=Z, T=VALUES), **K))
    down = {"x": X[::-1], "y": Y, "z": Z[::-1], "T": VALUES[::-1, :, ::-1]}
    same(imported(npz(folder / "b.npz", **down), **K))
    whole = {"x": X.astype("i2"), "y": Y.astype(">f4"), "z": Z, "T": VALUES.astype(">f8")}
    same(imported(npz(folder / "c.npz", **whole), **K))
    blank = np.where(PART, np.nan, VALUES)
    made = imported(npz(folder / "d.npz", x=X, y=Y, z=Z, T=blank), **K)
    np.testing.assert_array_equal(made.quantity.solid, PART)


def numpy_points(folder):
    columns = dict(zip("xyzT", ROWS.T, strict=True))
    same(imported(npz(folder / "a.npz", **columns), **K))
    fields = np.array([tuple(row) for row in ROWS], [(name, "f8") for name in "xyzT"])
    np.save(folder / "a.npy", fields)
    same(imported(folder / "a.npy", **K))


def numpy_plain(folder):
    np.save(folder / "a.npy", np.asfortranarray(VALUES))
    choices = {"units": "K", "quantity": "temperature", "origin_mm": (40.0, 24.0, 0.0)}
    same(imported(folder / "a.npy", **choices, spacing_mm=(20.0, 8.0, 8.0)))
    refused(folder / "a.npy", r"is a plain array of shape \(5, 7, 6\).*--spacing", **choices)


def numpy_refused(folder):
    grid = {"x": X, "y": Y, "z": Z}
    for values in (VALUES + 0j, VALUES.astype("U8"), VALUES > 0):
        refused(npz(folder / "a.npz", **grid, T=values), "holds no real numbers", **K)
    np.save(folder / "a.npy", VALUES.astype(object), allow_pickle=True)
    refused(folder / "a.npy", "no NumPy file of numbers", spacing_mm=(1, 1, 1))
    refused(npz(folder / "b.npz"), "needs arrays x, y and z; there are: none")
    refused(npz(folder / "b.npz", **grid, T=VALUES[1:]), "do not fit each other", **K)
    refused(npz(folder / "b.npz", **grid, X=X, T=VALUES), "are the same axis", **K)
    refused(npz(folder / "b.npz", **(grid | {"x": X * np.nan}), T=VALUES), "axis x neither", **K)
    refused(npz(folder / "b.npz", **(grid | {"x": X[:0]}), T=VALUES), "do not fit", **K)


def numpy_damaged(folder):
    np.save(folder / "a.npy", VALUES)
    whole = (folder / "a.npy").read_bytes()
    damaged = {
        "claim": whole.replace(b"(5, 7, 6)", b"(5, 7, 10**15)"[:9]),
        "header": whole.replace(b"(5, 7, 6)", b"(5, 7, 6("),
        "cut": whole[:-3],
        "empty": b"",
    }
    for name, content in damaged.items():
        (folder / f"{name}.npy").write_bytes(content)
        refused(folder / f"{name}.npy", "damaged|plain array", spacing_mm=(20.0, 8.0, 8.0))
    header = b"{'descr': '<f8', 'fortran_order': False, 'shape': (1000000000000000,), }\n"
    claims = b"\x93NUMPY\x01\x00" + len(header).to_bytes(2, "little") + header
    (folder / "b.npy").write_bytes(claims)
    refused(folder / "b.npy", "truncated, damaged or no NumPy file")
    content = npz(folder / "a.npz", x=X, y=Y, z=Z, T=VALUES).read_bytes()
    for end in (10, len(content) // 2, len(content) - 10):
        (folder / "b.npz").write_bytes(content[:end])
        refused(folder / "b.npz", "damaged")
    flagged = bytearray(content)
    flagged[content.index(b"PK\x01\x02") + 8] |= 1 << 5  # "compressed patched data"
    (folder / "c.npz").write_bytes(flagged)
    refused(folder / "c.npz", "damaged")


NUMPY = {
    ".npz of axes and arrays": numpy_grids,
    ".npz of points": numpy_points,
    ".npy with fields": numpy_points,
    "plain .npy (nx, ny, nz)": numpy_plain,
    "descending axes": numpy_grids,
    "integers, any byte order": numpy_grids,
    "NaN": numpy_grids,
    "complex or other types": numpy_refused,
    "Python objects (pickles)": numpy_refused,
    "damaged, or claims too much": numpy_damaged,
    "other shapes": numpy_refused,
}


@pytest.mark.parametrize("check", dict.fromkeys(NUMPY.values()))
def test_numpy_is_read_as_its_table_says(check, tmp_path):
    """Rationale: the reader's docstring is a promise."""
    assert set(NUMPY) == set(table_of(read_numpy))
    check(tmp_path)
