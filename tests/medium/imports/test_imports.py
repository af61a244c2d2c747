"""Imports: a plume known in closed form goes through each format and comes back as n - 1."""

import numpy as np
import plume_files as plume
import pytest
from plume_files import K, X, Y, Z, lattice, temperature, warped

from virtual_sensor.errors import InputError
from virtual_sensor.medium.air import air_refractivity
from virtual_sensor.medium.imports.import_field import Choices, import_field
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.netcdf import AMBIENT_DENSITY, write_quantity
from virtual_sensor.reporting.new_fields import imported

SMALL = (X[5:16], Y[6:19], Z[:16])  # a part of the plume, for what takes long
MARGIN_MM = 2.0  # one cell
CELLS_MM = 8.0  # values at cells: of the data's border one side is unknown


@pytest.fixture
def pv():
    return pytest.importorskip("pyvista", reason="the extra virtual-sensor[fields] is absent")


def through_a_file(path, tmp_path, packed=True, **choices):
    """Import, write, and read as a field."""
    made = import_field(path, Choices(**choices))
    write_quantity(tmp_path / "field.nc", made.quantity, packed)
    return IndexField.read(tmp_path / "field.nc"), made


def deviation(field, margin=MARGIN_MM, keep=lambda p: np.full(len(p), True), truth=None):
    """Largest relative error of n - 1 at random points, away from the border and where told."""
    low, high = field.box + np.array([[margin], [-margin]])
    points = np.random.default_rng(0).uniform(low, high, (2000, 3))
    points = points[keep(points)]
    truth = temperature(points) if truth is None else truth(points)
    return abs(field.refractivity(points) * truth / (air_refractivity() * 293.15) - 1).max()


def image(pv):
    data = pv.ImageData(dimensions=(21, 25, 31), spacing=(2, 2, 2), origin=(-20, -24, 0))
    data["T"] = temperature(data.points)
    return data


def rectilinear(pv):
    data = pv.RectilinearGrid(X, Y, np.linspace(0, np.sqrt(60), 40) ** 2)
    data["T"] = temperature(data.points)
    return data


def mesh(pv, at_cells=False, tetrahedra=False):
    data = plume.hexahedra(pv, warped(lattice(*SMALL)))
    data = data.triangulate() if tetrahedra else data
    if at_cells:
        data.cell_data["T"] = temperature(data.cell_centers().points)
    else:
        data["T"] = temperature(data.points)
    return data


def structured(pv):
    data = pv.StructuredGrid(*np.moveaxis(warped(lattice(*SMALL)), -1, 0).copy())
    data["T"] = temperature(data.points)
    return data


def point_cloud(pv):
    data = pv.PolyData(warped(lattice(*SMALL)).reshape(-1, 3))
    data["T"] = temperature(data.points)
    return data


def saved(data, path):
    data.save(path)
    return path


VTK = {
    "an image, .vti": lambda pv, d: saved(image(pv), d / "a.vti"),
    "an image, .vtk": lambda pv, d: saved(image(pv), d / "a.vtk"),
    "a rectilinear grid, .vtr": lambda pv, d: saved(rectilinear(pv), d / "a.vtr"),
    "a structured grid, .vts": lambda pv, d: saved(structured(pv), d / "a.vts"),
    "hexahedra, .vtu": lambda pv, d: saved(mesh(pv), d / "a.vtu"),
    "hexahedra, .vtk": lambda pv, d: saved(mesh(pv), d / "a.vtk"),
    "tetrahedra, .vtu": lambda pv, d: saved(mesh(pv, tetrahedra=True), d / "a.vtu"),
    "values at cells, .vtu": lambda pv, d: saved(mesh(pv, True), d / "a.vtu"),
    "points only, .vtp": lambda pv, d: saved(point_cloud(pv), d / "a.vtp"),
    "pieces of an image, .pvti": lambda pv, d: plume.write_parallel_image(d / "a.pvti", image(pv)),
    "pieces of a mesh, .pvtu": lambda pv, d: plume.write_parallel_mesh(
        d / "a.pvtu", mesh(pv, True)
    ),
}


@pytest.mark.parametrize("kind", VTK)
def test_vtk_comes_back(pv, kind, tmp_path):
    """Rationale: n - 1 within 1e-4 is what the optics need; in parts or not."""
    field, made = through_a_file(VTK[kind](pv, tmp_path), tmp_path, **K)
    at_cells = kind in ("values at cells, .vtu", "pieces of a mesh, .pvtu")
    assert deviation(field, CELLS_MM if at_cells else MARGIN_MM) < 1e-4
    assert "through PyVista" in made.quantity.attributes["source"]


@pytest.mark.parametrize("processors", [1, 2])
def test_an_openfoam_case_comes_back(pv, processors, tmp_path):
    """Rationale: finite volumes have values at cells only; decomposed, the cells lie in parts."""
    nodes = warped(lattice(*SMALL))
    case = plume.write_openfoam(tmp_path / "case", nodes, processors=processors)
    field, made = through_a_file(case, tmp_path)
    assert deviation(field, CELLS_MM) < 1e-4
    source = made.quantity.attributes["source"]
    assert ("decomposed" if processors > 1 else "reconstructed") + ", t = 0.5 s" in source


def test_openfoam_knows_its_units_times_and_suffix(pv, tmp_path):
    """Rationale: nobody should have to say K and m; the last time is what one wants."""
    nodes = lattice(*SMALL)
    case = plume.write_openfoam(tmp_path / "case", nodes, times=("0.5", "10", "2"))
    last = import_field(case / "air.foam", Choices())
    assert "t = 10 s" in last.quantity.attributes["source"]
    first = import_field(case, Choices(time_s=0.5))
    assert "t = 0.5 s" in first.quantity.attributes["source"]
    np.testing.assert_allclose(first.quantity.origin_mm, nodes[0, 0, 0] + 1.0, atol=1e-5)


TABLES = {
    "COMSOL, spreadsheet of a grid": lambda d: plume.write_comsol(
        d / "a.txt", lattice().reshape(-1, 3)
    ),
    "COMSOL, grid": lambda d: plume.write_comsol_grid(d / "a.txt"),
    "CSV of a grid in m and degC": lambda d: plume.write_csv(
        d / "a.csv",
        lattice().reshape(-1, 3) / 1e3,
        "x [m],y [m],z [m],T [degC]",
        temperature(lattice()).ravel() - 273.15,
    ),
}


@pytest.mark.parametrize("kind", TABLES)
def test_tables_on_a_grid_come_back(kind, tmp_path):
    """Rationale: they say their units themselves, and need no optional reader."""
    field, made = through_a_file(TABLES[kind](tmp_path), tmp_path)
    assert made.quantity.values.shape == (21, 25, 31)
    assert deviation(field, margin=0.0) < 1e-4


def test_a_descending_order_of_rows_is_no_other_grid(tmp_path):
    """Rationale: exports sort as they please."""
    rows = lattice().reshape(-1, 3)
    shuffled = np.random.default_rng(1).permutation(rows)
    one = import_field(plume.write_csv(tmp_path / "a.csv", rows), Choices())
    other = import_field(plume.write_csv(tmp_path / "b.csv", shuffled), Choices())
    np.testing.assert_array_equal(one.quantity.values, other.quantity.values)


@pytest.mark.parametrize("kind", ["comsol", "csv", "npz"])
def test_scattered_points_come_back(pv, kind, tmp_path):
    """Rationale: COMSOL exports at the nodes of its mesh, without the cells."""
    points = warped(lattice(*SMALL)).reshape(-1, 3)
    points = np.concatenate([points, points[::7]])  # COMSOL gives shared nodes twice
    choices = {}
    if kind == "comsol":
        path = plume.write_comsol(tmp_path / "a.txt", points)
    elif kind == "csv":
        header = '"T","Points:0","Points:1","Points:2"'  # ParaView's
        path, choices = tmp_path / "a.csv", K
        rows = np.column_stack([temperature(points), points])
        np.savetxt(path, rows, "%.12g", ",", header=header, comments="")
    else:
        path, choices = tmp_path / "a.npz", K
        np.savez(path, **dict(zip("xyz", points.T, strict=True)), T=temperature(points))
    field, _ = through_a_file(path, tmp_path, **choices)
    assert deviation(field) < 1e-4


@pytest.mark.parametrize("kind", ["npz", "npy with fields", "npy"])
def test_numpy_comes_back(kind, tmp_path):
    """Rationale: the shortest route from a program of one's own."""
    values, choices = temperature(lattice()), dict(K)
    path = tmp_path / ("a.npz" if kind == "npz" else "a.npy")
    if kind == "npz":
        np.savez(path, x=X, y=Y[::-1], z=Z, T=values[:, ::-1])
    elif kind == "npy":
        np.save(path, values)
        choices = {"units": "K", "quantity": "temperature", "spacing_mm": (2.0, 2.0, 2.0)}
        choices["origin_mm"] = (20.0, 24.0, 0.0)
    else:
        rows = np.column_stack([lattice().reshape(-1, 3), values.ravel()])
        fields = [(name, "f8") for name in ("x", "y", "z", "T")]
        np.save(path, np.array([tuple(row) for row in rows], dtype=fields))
    field, _ = through_a_file(path, tmp_path, **choices)
    np.testing.assert_allclose(field.origin, [-20, -24, 0], atol=1e-9)
    assert deviation(field, margin=0.0) < 1e-4


@pytest.mark.parametrize("axes", ["x,y,z", "y,z,x", "x,-y,z", "-z,x,-y"])
@pytest.mark.parametrize("kind", ["grid", "mesh"])
def test_axes_origin_and_scale_bring_it_into_the_world(pv, kind, axes, tmp_path):
    """Rationale: solvers have other frames, some left-handed to ours; a sign is easily lost."""
    origin, scale = np.array([3.0, -5.0, 40.0]), 0.5
    names = axes.split(",")
    world = [lattice(*SMALL), warped(lattice(*SMALL))][kind == "mesh"]
    source = np.empty_like(world)
    for i, name in enumerate(names):
        sign = -1.0 if name[0] == "-" else 1.0
        a = "xyz".index(name[-1])
        source[..., a] = sign * world[..., i] / scale + origin[a]
    if kind == "mesh":
        data = plume.hexahedra(pv, source)
        data["T"] = temperature(plume.hexahedra(pv, world).points)
        path = saved(data, tmp_path / "a.vtu")
    else:
        path = tmp_path / "a.npz"
        points = dict(zip("xyz", source.reshape(-1, 3).T, strict=True))
        np.savez(path, **points, T=temperature(world).ravel())
    field, _ = through_a_file(path, tmp_path, axes=axes, origin_mm=origin, scale=scale, **K)
    np.testing.assert_allclose(field.box, [world.min((0, 1, 2)), world.max((0, 1, 2))], atol=1e-4)
    assert deviation(field) < 1e-4


@pytest.mark.parametrize("side", [1, -1])
@pytest.mark.parametrize("kind", ["nodes", "between nodes", "points", "cells"])
def test_half_a_field_is_mirrored(pv, kind, side, tmp_path):
    """Rationale: symmetric flows are solved on a half; at the plane the field must stay smooth."""
    y = side * np.arange(0.0 if kind != "between nodes" else 1.0, 24.0, 2.0)
    nodes = lattice(SMALL[0], np.sort(y), SMALL[2])
    if kind in ("points", "cells"):
        nodes = warped(nodes)
    if kind == "cells":
        data = plume.hexahedra(pv, nodes)
        data.cell_data["T"] = temperature(data.cell_centers().points)
        path, choices = saved(data, tmp_path / "a.vtu"), K
    else:
        path, choices = plume.write_csv(tmp_path / "a.csv", nodes.reshape(-1, 3)), {}
    field, made = through_a_file(path, tmp_path, mirror=("y",), **choices)
    assert (field.mirror, field.origin[1]) == ((False, True, False), 0.0)
    assert deviation(field, CELLS_MM if kind == "cells" else MARGIN_MM) < 1e-4
    assert "(mirrored)" in imported(made)[1]


@pytest.mark.parametrize("kind", ["table", "scattered", "triangles", "one layer of cells"])
def test_a_cross_section_holds_along_x(pv, kind, tmp_path):
    """Rationale: round a long cylinder the flow is plane, and solved so."""
    y, z = Y, Z
    plane = np.zeros((1, len(y), len(z), 3)) + lattice([0.0], y, z)
    if kind != "table":
        bumps = np.sin(np.pi * (plane[..., 1] + 24) / 48) * np.sin(np.pi * plane[..., 2] / 60)
        plane[..., 1:] += bumps[..., None] * [0.9, -0.7]
    choices = {"axes": "z,x,y", "extrude_mm": (-30.0, 30.0)}
    flat = plane.reshape(-1, 3)[:, 1:]  # the solver's x and y
    values = temperature(plane.reshape(-1, 3))
    if kind in ("table", "scattered"):
        path = plume.write_comsol(tmp_path / "a.txt", flat, values)
    else:
        layers = np.array([0.0, 1.0]) if kind == "one layer of cells" else np.zeros(1)
        turned = np.stack([np.concatenate([plane] * len(layers))[..., i] for i in (1, 2, 0)], -1)
        turned[..., 2] = layers[:, None, None]
        if kind == "triangles":
            data = pv.PolyData(turned.reshape(-1, 3)).delaunay_2d()
            data["T"] = values
            path = saved(data.cast_to_unstructured_grid(), tmp_path / "a.vtu")
            choices |= K
        else:
            data = plume.hexahedra(pv, turned)
            centres = data.cell_centers().points[:, [2, 0, 1]] * [0.0, 1.0, 1.0]
            data.cell_data["T"] = temperature(centres)
            path, choices = saved(data, tmp_path / "a.vtu"), choices | K
    field, _ = through_a_file(path, tmp_path, **choices)
    np.testing.assert_allclose(field.box[:, 0], [-30, 30])
    assert field.shape[0] == 4
    margin = CELLS_MM if kind == "one layer of cells" else MARGIN_MM
    assert deviation(field, margin, truth=lambda p: temperature(p * [0, 1, 1])) < 1e-4


RADIUS = 9.0


def beside_the_part(points, length=20.0, gap=0.0):
    """Whether points are outside of a cylinder along x whose top line is at z = 30."""
    around = np.hypot(points[..., 1], points[..., 2] - 30.0 + RADIUS) > RADIUS + gap
    return around | (abs(points[..., 0]) > 0.5 * length + gap)


@pytest.mark.parametrize(
    "kind",
    [
        "NaN on a grid",
        "rows left out",
        "scattered",
        pytest.param("scattered NaN", marks=pytest.mark.slow),
    ],
)
def test_the_part_is_found_and_filled(pv, kind, tmp_path):
    """Rationale: solvers have no air in the part, and a spline must not see that."""
    x, y, z = X[2:19], Y[4:21], Z[2:26]
    nodes = lattice(x, y, z)
    if "scattered" in kind:
        nodes = warped(nodes)
    air = beside_the_part(nodes)
    if kind == "NaN on a grid":
        values = np.where(air, temperature(nodes), np.nan)
        path = plume.write_comsol_grid(tmp_path / "a.txt", x, y, z, values)
    elif kind == "scattered NaN":
        values = np.where(air, temperature(nodes), np.nan).ravel()
        path = plume.write_comsol(tmp_path / "a.txt", nodes.reshape(-1, 3), values)
    else:
        path = plume.write_comsol(tmp_path / "a.txt", nodes[air])
    field, made = through_a_file(path, tmp_path)
    solid = made.quantity.solid
    placed = lattice(*(o + s * np.arange(n) for o, s, n in zip(*grid_of(made), strict=True)))
    assert solid[~beside_the_part(placed, gap=-2.1)].all()
    assert not solid[beside_the_part(placed, gap=2.1)].any()
    assert deviation(field, keep=lambda p: beside_the_part(p, gap=7.0)) < 1e-4
    assert imported(made)[-1].startswith("solid:")


def grid_of(made):
    return made.quantity.origin_mm, made.quantity.spacing_mm, made.quantity.values.shape


def test_a_part_in_a_mirrored_mesh_is_found(pv, tmp_path):
    """Rationale: in a quarter model the part's hole is open, but only towards the mirror planes."""
    angle, radius = np.linspace(-0.5 * np.pi, 0.5 * np.pi, 41), np.linspace(6.0, 40.0, 35)
    x, r, a = np.meshgrid(np.arange(0, 21, 4.0), radius, angle, indexing="ij")
    data = plume.hexahedra(pv, np.stack([x, r * np.cos(a), 30 + r * np.sin(a)], axis=-1))
    data.cell_data["T"] = temperature(data.cell_centers().points)
    box = (0.0, 20.0, 0.0, 24.0, 6.0, 54.0)
    choices = {"box_mm": box, "spacing_mm": 3 * (1.5,), **K, "mirror": ("x", "y")}
    path = saved(data, tmp_path / "a.vtu")
    told = {"origin_mm": (0, 0, 36.0), "box_mm": (0, 20, 0, 24, -30, 18), "solid": "cylinder:6"}
    with pytest.raises(InputError, match=r"open to the field's border.*cylinder:RADIUS"):
        import_field(path, Choices(**(choices | {"spacing_mm": 3 * (4.0,)})))
    field, made = through_a_file(path, tmp_path, **(choices | told))
    assert made.quantity.solid.any(axis=0).sum() < 60
    away = deviation(
        field,
        CELLS_MM,
        keep=lambda p: np.hypot(p[:, 1], p[:, 2] + 6) > 14.0,
        truth=lambda p: temperature(np.add(p, [0, 0, 36])),
    )
    assert away < 1e-4


def test_a_part_with_a_temperature_of_its_own_can_be_told(tmp_path):
    """Rationale: conjugate heat transfer has values in the part, which are no air's."""
    nodes = lattice()
    values = np.where(beside_the_part(nodes, 1e9), temperature(nodes), 3000.0)
    path = plume.write_comsol_grid(tmp_path / "a.txt", values=values)
    field, made = through_a_file(
        path, tmp_path, solid=f"cylinder:{RADIUS},1000", origin_mm=(0, 0, 30)
    )
    assert np.nanmax(made.quantity.values) < 900.0
    away = deviation(
        field,
        keep=lambda p: beside_the_part(np.add(p, [0, 0, 30]), 1e9, gap=7.0),
        truth=lambda p: temperature(np.add(p, [0, 0, 30])),
    )
    assert away < 1e-4


@pytest.mark.parametrize(
    ("name", "units", "ambient", "of_temperature"),
    [
        ("rho", "kg/m3", AMBIENT_DENSITY, lambda T: AMBIENT_DENSITY * 293.15 / T),
        ("rho", "g/cm3", 1.2041e-3, lambda T: 1.2041e-3 * 293.15 / T),
        ("refractivity", None, air_refractivity(), lambda T: air_refractivity() * 293.15 / T),
        ("n", None, 1 + air_refractivity(), lambda T: 1 + air_refractivity() * 293.15 / T),
    ],
)
def test_density_and_index_come_back(name, units, ambient, of_temperature, tmp_path):
    """Rationale: some solvers give the density, some users n; n - 1 must keep its digits."""
    path = tmp_path / "a.npz"
    np.savez(path, x=X, y=Y, z=Z, **{name: of_temperature(temperature(lattice()))})
    told = {"units": units, "length_units": "mm", "ambient": ambient}
    field, _ = through_a_file(path, tmp_path, packed=name == "rho", **told)
    density_scale = field.ambient / air_refractivity()  # Ciddor's air is not quite an ideal gas
    assert density_scale == pytest.approx(1.0, abs=1e-3)
    got = deviation(field, 0.0, truth=lambda p: temperature(p) / density_scale)
    assert got < 1e-4


def test_provenance_is_kept(tmp_path):
    """Rationale: a field whose origin nobody knows proves nothing."""
    path = plume.write_comsol(tmp_path / "a.txt", lattice().reshape(-1, 3))
    made = import_field(path, Choices(ambient=293.15, pressure_pa=1e5), "virtual-sensor field ...")
    kept = made.quantity.attributes
    assert kept["title"] == "Temperature imported from a.txt"
    assert kept["source"].startswith(
        "a.txt, variable T [K]; read by COMSOL's text export (COMSOL 6"
    )
    assert kept["history"].endswith("virtual-sensor field ...")
    assert made.quantity.ambient == {"ambient_temperature": 293.15, "ambient_pressure": 1e5}


@pytest.mark.parametrize("at_cells", [False, True])
def test_a_front_as_narrow_as_a_cell_makes_no_new_extremes(pv, at_cells, tmp_path):
    """Rationale: air colder than the surroundings, or hotter than the part, is nobody's result."""
    data = plume.hexahedra(pv, warped(lattice(*SMALL)))
    places = data.cell_centers().points if at_cells else data.points
    step = np.where(places[:, 2] > 14.7, 1500.0, 293.15)
    (data.cell_data if at_cells else data.point_data)["T"] = step
    path = saved(data, tmp_path / "a.vtu")
    made = import_field(path, Choices(spacing_mm=3 * (0.9,), **K)).quantity.values
    assert (made.min(), made.max()) == (293.15, 1500.0)
