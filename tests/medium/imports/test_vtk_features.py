"""VTK's files: what the reader's table says of each feature is done."""

import re

import numpy as np
import plume_files as plume
import pytest
from import_checks import (
    NODES,
    PART,
    VALUES,
    X,
    Y,
    Z,
    error,
    imported,
    refused,
    same,
    table_of,
    written,
)
from plume_files import K, lattice, temperature

from virtual_sensor.medium.imports.meshes import read_vtk


def image(pv, data="point", offset=0):
    """The plume; its extent begins at `offset`."""
    grid = pv.ImageData(dimensions=VALUES.shape, spacing=(20, 8, 8))
    grid.origin = (-40 - 20 * offset, -24, 0)
    grid.extent = (offset, offset + 4, 0, 6, 0, 5)
    if data == "point":
        grid.point_data["T"] = VALUES.ravel(order="F")
    else:
        grid.cell_data["T"] = temperature(NODES[:-1, :-1, :-1] + [10, 4, 4]).ravel(order="F")
    return grid


def saved(data, path, **options):
    data.save(path, **options)
    return path


def vtk_suffixes(pv, folder):
    made = {
        "vti": image(pv),
        "vtr": image(pv).cast_to_rectilinear_grid(),
        "vts": image(pv).cast_to_structured_grid(),
        "vtu": image(pv).cast_to_unstructured_grid(),
        "vtk": image(pv),
    }
    for suffix, data in made.items():
        for binary in (True, False):
            same(imported(saved(data, folder / f"a{binary}.{suffix}", binary=binary), **K))


def vtk_pieces(pv, folder):
    data = plume.hexahedra(pv, lattice(X, Y, Z))
    data.cell_data["T"] = temperature(data.cell_centers().points)
    same(imported(plume.write_parallel_mesh(folder / "a.pvtu", data), **K), (4, 6, 5))


def vtk_points_or_cells(pv, folder):
    both = image(pv, "cell")
    both.point_data["id"] = np.arange(both.n_points, dtype=float)
    same(imported(saved(both, folder / "a.vti"), **K), (4, 6, 5))
    same(imported(saved(both, folder / "a.vti"), variable="T", **K), (4, 6, 5))
    both.point_data["T"] = VALUES.ravel(order="F")
    made = imported(saved(both, folder / "b.vti"), **K)
    same(made)
    assert "T is given at points and at cells; that at points is taken" in made.notes


def vtk_extent(pv, folder):
    for data, shape in (("point", VALUES.shape), ("cell", (4, 6, 5))):
        for suffix in ("vti", "vtk", "vtr"):
            grid = image(pv, data, offset=10)
            grid = grid.cast_to_rectilinear_grid() if suffix == "vtr" else grid
            made = imported(saved(grid, folder / f"{data}.{suffix}"), **K)
            same(made, shape)


def vtk_negative_spacing(pv, folder):
    text = saved(image(pv), folder / "a.vti", binary=False).read_text()
    text = re.sub(r'Spacing="[^"]*"', 'Spacing="20 8 -8"', text)
    made = imported(written(folder / "b.vti", text), **K, axes="x,y,-z")
    same(made)


def vtk_descending(pv, folder):
    grid = pv.RectilinearGrid(X[::-1].copy(), Y, Z[::-1].copy())
    grid.point_data["T"] = VALUES[::-1, :, ::-1].ravel(order="F")
    same(imported(saved(grid, folder / "a.vtr"), **K))
    grid = pv.RectilinearGrid(X, Y, Z[::-1].copy())
    grid.cell_data["T"] = temperature(grid.cell_centers().points)
    same(imported(saved(grid, folder / "b.vtr"), **K), (4, 6, 5))


def vtk_direction(pv, folder):
    grid = image(pv)
    grid.direction_matrix = [[0, -1, 0], [1, 0, 0], [0, 0, 1]]
    grid.origin = (-24, -40, 0)
    grid.point_data["T"] = temperature(grid.points[:, [1, 0, 2]])
    same(imported(saved(grid, folder / "a.vti"), **K, axes="y,x,z"))


def vtk_blanked(pv, folder):
    for suffix, wrong in (("vti", 293.15), ("vti", 0.0), ("vtr", 0.0), ("vtk", 0.0)):
        grid = image(pv) if suffix != "vtr" else image(pv).cast_to_rectilinear_grid()
        hidden = PART.ravel(order="F")
        grid.point_data["T"] = np.where(hidden, wrong, grid.point_data["T"])
        grid.point_data["vtkGhostType"] = np.where(hidden, 2, 0).astype(np.uint8)
        made = imported(saved(grid, folder / f"{wrong}.{suffix}"), **K)
        same(made)
        np.testing.assert_array_equal(made.quantity.solid, PART)
        assert any("36 of 210 points are blanked" in note for note in made.notes)
    grid = image(pv, "cell")
    middle = abs(grid.cell_centers().points[:, 1]) < 13
    middle &= abs(grid.cell_centers().points[:, 2] - 20) < 13
    grid.cell_data["T"] = np.where(middle, 0.0, grid.cell_data["T"])
    grid.cell_data["vtkGhostType"] = np.where(middle, 32, 0).astype(np.uint8)
    made = imported(saved(grid, folder / "cells.vti"), **K, solid="enclosed")
    same(made, (4, 6, 5))
    assert made.quantity.solid.sum() == middle.sum() == 48


def vtk_valid_mask(pv, folder):
    grid = image(pv)
    valid = ~PART.ravel(order="F")
    grid.point_data["T"] = np.where(valid, grid.point_data["T"], 0.0)
    grid.point_data["vtkValidPointMask"] = valid.astype(np.int8)
    made = imported(saved(grid, folder / "a.vti"), **K)
    same(made)
    np.testing.assert_array_equal(made.quantity.solid, PART)


def vtk_nan(pv, folder):
    grid = image(pv)
    grid.point_data["T"] = np.where(PART, np.nan, VALUES).ravel(order="F")
    made = imported(saved(grid, folder / "a.vti"), **K)
    same(made)
    np.testing.assert_array_equal(made.quantity.solid, PART)


def vtk_polyhedra(pv, folder):
    data = plume.hexahedra(pv, lattice(X, Y, Z))
    faces = np.array([[0, 3, 2, 1], [4, 5, 6, 7], [0, 1, 5, 4], [1, 2, 6, 5], [2, 3, 7, 6],
                      [3, 0, 4, 7]])  # fmt: skip
    cells = []
    for corners in data.cell_connectivity.reshape(-1, 8):
        each = [6, *np.column_stack([np.full(6, 4), corners[faces]]).ravel()]
        cells += [len(each), *each]
    kinds = np.full(data.n_cells, pv.CellType.POLYHEDRON)
    poly = pv.UnstructuredGrid(np.array(cells), kinds, data.points)
    poly.point_data["T"] = temperature(poly.points)
    same(imported(saved(poly, folder / "a.vtu"), **K))


def vtk_bare_points(pv, folder):
    cloud = pv.PolyData(plume.warped(NODES).reshape(-1, 3))
    cloud["T"] = temperature(cloud.points)
    for data, name in ((cloud, "a.vtp"), (cloud.cast_to_unstructured_grid(), "a.vtu")):
        made = imported(saved(data, folder / name), **K, spacing_mm=(20, 8, 8))
        assert error(made) < 25.0  # the plume of 500 K is 8 mm fine
    cloud.clear_data()
    cloud.cell_data["T"] = temperature(cloud.points)
    vertices = cloud.cast_to_unstructured_grid()
    made = imported(saved(vertices, folder / "b.vtu"), **K, spacing_mm=(20, 8, 8))
    assert error(made) < 25.0


def vtk_integers(pv, folder):
    grid = image(pv)
    grid.point_data["T"] = np.rint(grid.point_data["T"]).astype(np.int16)
    assert error(imported(saved(grid, folder / "a.vti"), **K)) < 0.51


def vtk_vectors(pv, folder):
    grid = image(pv)
    grid.point_data["U"] = np.ones((grid.n_points, 3))
    grid.add_field_data(np.array([1.0]), "seed")
    made = imported(saved(grid, folder / "a.vti"), **K)
    same(made)
    assert "not read: U (3 components), field data seed" in made.notes


def vtk_time(pv, folder):
    grid = image(pv)
    grid.add_field_data(np.array([2.5]), "TimeValue")
    path = saved(grid, folder / "a.vti")
    assert "field data TimeValue" in imported(path, **K).notes[0]
    refused(path, "holds one time; leave --time out", **K, time_s=2.5)


def vtk_not_finite(pv, folder):
    data = plume.hexahedra(pv, lattice(X, Y, Z))
    data["T"] = temperature(data.points)
    for bad in (np.nan, np.inf):
        data.points[7, 1] = bad
        refused(saved(data, folder / "a.vtu"), "not finite, of point 7|damaged", **K)


VTU = """<VTKFile type="UnstructuredGrid" version="0.1"><UnstructuredGrid>
<Piece NumberOfPoints="{count}" NumberOfCells="1"><PointData>
<DataArray type="Float64" Name="T" format="ascii">300 301 302 303 304 305 306 307</DataArray>
</PointData><Points><DataArray type="Float64" NumberOfComponents="3" format="ascii">0 0 0 20 0 0
0 20 0 20 20 0 0 0 20 20 0 20 0 20 20 20 20 20</DataArray></Points><Cells>
<DataArray type="Int64" Name="connectivity" format="ascii">0 1 2 3 4 5 6 {last}</DataArray>
<DataArray type="Int64" Name="offsets" format="ascii">{offset}</DataArray>
<DataArray type="UInt8" Name="types" format="ascii">{kind}</DataArray>
</Cells></Piece></UnstructuredGrid></VTKFile>"""


def vtk_no_such_point(pv, folder):
    for last in (8, 999999, 2**31 - 1, -1):
        path = written(folder / "a.vtu", VTU.format(count=8, last=last, offset=8, kind=11))
        refused(path, f"cell 0 refers to point {last}, and there are 8 points", **K)


def vtk_claims(pv, folder):
    for count in (9, 10**6, 10**11, -8):
        path = written(folder / "a.vtu", VTU.format(count=count, last=7, offset=8, kind=11))
        refused(path, "damaged|truncated", **K)
    for offset, kind in ((99, 11), (-8, 11), (8, 77), (8, 42)):
        path = written(folder / "a.vtu", VTU.format(count=8, last=7, offset=offset, kind=kind))
        refused(path, "damaged|crashed|no data|no points|nodes", **K)
    head = '<VTKFile type="ImageData" version="0.1"><ImageData WholeExtent="{0}" Origin="0 0 0" '
    tail = 'Spacing="6 6 6"><Piece Extent="{0}"><PointData><DataArray type="Float64" Name="T" '
    tail += 'format="ascii">300 300</DataArray></PointData></Piece></ImageData></VTKFile>'
    for extent, match in (
        ("0 2147483646 0 8 0 10", "more memory than the 6 GB that it may have"),
        ("0 99999 0 99999 0 99999", "damaged"),
        ("5 0 0 8 0 10", "damaged|no points"),
        ("5 0 8 0 0 10", "damaged|no points"),
        ("0 4 0 4 0 4", "damaged"),
        ("0 4 0 4", "damaged|no points"),
    ):
        refused(written(folder / "a.vti", (head + tail).format(extent)), match, **K)


def vtk_others(pv, folder):
    for suffix, match in (
        ("vtm", "Merge Blocks"),
        ("pvd", "lists a file for each time"),
        ("case", "open it in ParaView"),
        ("nc", "use it as it is"),
    ):
        refused(written(folder / f"a.{suffix}", "x"), match)


VTK = {
    ".vtk .vti .vtr .vts .vtu .vtp": vtk_suffixes,
    ".pvti .pvtr .pvts .pvtu": vtk_pieces,
    "values at points or cells": vtk_points_or_cells,
    "origin, spacing, extent": vtk_extent,
    "negative spacing": vtk_negative_spacing,
    "descending coordinates": vtk_descending,
    "direction matrix": vtk_direction,
    "blanked points and cells": vtk_blanked,
    "vtkValidPointMask": vtk_valid_mask,
    "NaN": vtk_nan,
    "polyhedra": vtk_polyhedra,
    "points without cells": vtk_bare_points,
    "integers": vtk_integers,
    "vectors, tensors, texts": vtk_vectors,
    "field data": vtk_vectors,
    "time": vtk_time,
    "points that are not finite": vtk_not_finite,
    "cells that refer to no point": vtk_no_such_point,
    "less or more than is claimed": vtk_claims,
    ".vtm, .pvd, .case and others": vtk_others,
}


@pytest.mark.parametrize("feature", VTK)
def test_vtk_is_read_as_its_table_says(feature, tmp_path):
    """Rationale: the reader's docstring is a promise."""
    pv = pytest.importorskip("pyvista", reason="the extra virtual-sensor[fields] is absent")
    assert set(VTK) == set(table_of(read_vtk))
    VTK[feature](pv, tmp_path)
