"""Damaged files of VTK are refused wherever the damage is, and no value is made up."""

import os
from importlib.util import find_spec

import numpy as np
import pytest
from import_checks import NODES, VALUES, error, imported, refused, temperature
from plume_files import K, hexahedra

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.import_field import Choices, import_field

pytestmark = pytest.mark.skipif(
    find_spec("pyvista") is None, reason="the extra virtual-sensor[fields] is absent"
)


def data_sets():
    import pyvista as pv

    image = pv.ImageData(dimensions=VALUES.shape, spacing=(20, 8, 8), origin=(-40, -24, 0))
    image["T"] = VALUES.ravel(order="F")
    image["U"] = np.ones((image.n_points, 3))
    mesh = hexahedra(pv, NODES)
    mesh.cell_data["T"] = temperature(mesh.cell_centers().points)
    points = pv.PolyData(NODES.reshape(-1, 3))
    points["T"] = temperature(points.points)
    rectilinear = image.cast_to_rectilinear_grid()
    return {
        "image": image,
        "rectilinear": rectilinear,
        "structured": image.cast_to_structured_grid(),
        "cells": mesh,
        "points": points,
    }


@pytest.mark.parametrize("step", [1597, pytest.param(797, marks=pytest.mark.slow)])
@pytest.mark.parametrize("binary", [False, True], ids=["ASCII", "binary"])
@pytest.mark.parametrize("kind", ["image", "rectilinear", "structured", "cells", "points"])
def test_a_legacy_file_is_refused_wherever_it_ends(kind, binary, step, tmp_path):
    """Rationale: of what is lost, VTK makes up what lay in memory, if the last number is cut."""
    path = tmp_path / "a.vtk"
    data_sets()[kind].save(path, binary=binary)
    content = path.read_bytes()
    whole = error(imported(path, **K))
    for end in range(len(content) // 50, len(content), step):
        path.write_bytes(content[:end])
        try:
            made = imported(path, **K)
        except InputError:
            continue
        assert error(made) == whole  # it ends behind all values


def test_a_lost_40_percent_are_not_0_degc(tmp_path):
    """Rationale: the seed: an ASCII image cut at 60 % was imported with zeros."""
    path = tmp_path / "a.vtk"
    data_sets()["image"].save(path, binary=False)
    content = path.read_bytes()
    path.write_bytes(content[: content.index(b"SCALARS T") + 1500])
    told = "Error reading ascii data|without a line end: truncated"
    refused(path, told, units="degC", length_units="mm")


@pytest.mark.parametrize(
    ("old", "new", "match"),
    [
        (b"DIMENSIONS 5 7 6", b"DIMENSIONS 5 7 7", "no scalar|damaged"),
        (b"DIMENSIONS 5 7 6", b"DIMENSIONS 5 -7 6", "damaged"),
        (b"DIMENSIONS 5 7 6", b"DIMENSIONS 5 7 x", "damaged"),
        (b"POINT_DATA 210", b"POINT_DATA 999999999999", "damaged"),
        (b"POINT_DATA 210", b"POINT_DATA -1", "damaged"),
        (b"SCALARS T double", b"SCALARS T string", "no scalar|damaged"),
        (b"SPACING 20", b"SPACING nan", "neither ascends nor descends"),
        (b"DATASET STRUCTURED_POINTS", b"DATASET GRAPH", "no grid or mesh"),
        (b"ASCII", b"ASCIJ", "Unrecognized file type: ascij"),
        (b"LOOKUP_TABLE default\n", b"LOOKUP_TABLE default\nx", "damaged"),
    ],
)
def test_a_claim_that_cannot_be_is_refused(old, new, match, tmp_path):
    """Rationale: such claims ended the interpreter, or took minutes."""
    path = tmp_path / "a.vtk"
    data_sets()["image"].save(path, binary=False)
    content = path.read_bytes()
    assert old in content
    path.write_bytes(content.replace(old, new, 1))
    refused(path, match, **K)


def test_a_last_number_without_a_line_end_may_be_cut(tmp_path):
    """Rationale: 293.1 for 293.15 is a number too; hand-written files may end so if whole."""
    path = tmp_path / "a.vtk"
    head = (
        "# vtk DataFile Version 3.0\nby hand\nASCII\nDATASET STRUCTURED_POINTS\nDIMENSIONS 4 4 4\n"
    )
    head += "ORIGIN -30 -24 0\nSPACING 20 16 16\nPOINT_DATA 64\nSCALARS T double\n"
    for end, fine in (("400.25", True), ("400.2", False)):
        path.write_text(head + "LOOKUP_TABLE default\n" + "400.25 " * 63 + end)
        if fine:
            assert error(imported(path, **K), lambda p: 400.25) < 1e-9
        else:
            refused(path, "ends with '400.2' and without a line end", **K)


def test_a_pipe_is_refused_without_waiting(tmp_path):
    """Rationale: to open one blocks until somebody writes to it."""
    os.mkfifo(tmp_path / "a.vtk")
    refused(tmp_path / "a.vtk", "is a pipe or a device")


def test_a_damaged_word_is_quoted_in_part(tmp_path):
    """Rationale: binary data without a line end read as a type of 5,000 characters."""
    path = tmp_path / "air.vtk"
    words = "# vtk DataFile Version 3.0\nt\nBINARY\nDATASET UNSTRUCTURED_GRID\nPOINTS 8 "
    path.write_bytes(words.encode() + b"doub\x1b\0" * 1000 + b"\n")
    with pytest.raises(InputError, match="Unsupported data type") as caught:
        import_field(path, Choices(units="K", length_units="mm"))
    assert len(f"{caught.value}") < 700 + len(f"{path}")
