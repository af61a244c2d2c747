"""Imports that cannot be right: each is refused in one line, which tells the remedy."""

import sys

import numpy as np
import plume_files as plume
import pytest
from command_line import command
from import_checks import refused
from plume_files import K, X, Y, Z, lattice, temperature, warped

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.import_field import Choices, import_field
from virtual_sensor.medium.index_field import IndexField

ROWS = lattice().reshape(-1, 3)
VALUES = temperature(lattice())


@pytest.fixture
def pv():
    return pytest.importorskip("pyvista", reason="the extra virtual-sensor[fields] is absent")


def npz(folder, x=X, y=Y, z=Z, **arrays):
    np.savez(folder / "a.npz", x=x, y=y, z=z, **(arrays or {"T": VALUES}))
    return folder / "a.npz"


@pytest.mark.parametrize(
    ("choices", "match"),
    [
        ({"length_units": "mm"}, "units of 'T'; say --units K or degC"),
        ({"units": "K"}, "units of length; say --length-units mm or m"),
        ({"units": "F", "length_units": "mm"}, "'T' in 'F'. Known are: K"),
        (K | {"variable": "p"}, "no variable 'p'; there are: T"),
        (K | {"quantity": "heat"}, "--quantity heat: choose one of temperature"),
        (K | {"length_units": "m"}, r"span 4e\+04 x 4.8e\+04 x 6e\+04 mm.*--length-units mm"),
        (K | {"scale": 0.02}, "span 0.8 x 0.96 x 1.2 mm.*--length-units m"),
        (K | {"units": "degC"}, None),
        (K | {"axes": "x,y"}, "--axes x,y: name each axis of the source once"),
        (K | {"axes": "x,y,x"}, "--axes x,y,x: name each axis of the source once"),
        (K | {"scale": 0.0}, "--scale 0: give a positive factor"),
        (K | {"scale": 1e308}, "--scale 1e\\+308: give a positive factor, 1e-09 to"),
        (K | {"origin_mm": (0.0, 1e300, 0.0)}, "--origin .*: give 3 finite numbers below 1e"),
        (K | {"mirror": ("q",)}, "--mirror q: name axes"),
        (K | {"mirror": ("y",)}, "the data lie on both sides of y = 0, from -24 to 24 mm"),
        (K | {"mirror": ("z",), "origin_mm": (0, 0, -9)}, "do not reach the plane z = 0"),
        (K | {"box_mm": (-10, 10, -10, 90, 0, 9)}, "box runs from -10 to 90 mm along y, the data"),
        (K | {"box_mm": (5, 5, 0, 9, 0, 9)}, "box runs from 5 to 5 mm along x"),
        (K | {"spacing_mm": (30.0, 2.0, 2.0)}, "3 x 25 x 31 nodes, and needs 4"),
        (K | {"spacing_mm": (0.01, 0.1, 0.1)}, "give a wider --spacing"),
        (K | {"spacing_mm": (0.0, 1.0, 1.0)}, "give positive lengths"),
        (K | {"extrude_mm": (0, 9)}, "--extrude is for a 2-D cross-section"),
        (K | {"solid": "cylinder:."}, "--solid cylinder:.: say auto, enclosed, none or cylinder"),
        (K | {"solid": "cylinder:1.2.3"}, "say auto, enclosed, none or cylinder"),
        (K | {"solid": "sphere:3"}, "--solid sphere:3: say auto, enclosed, none or cylinder"),
        (K | {"solid": "cylinder:0.5", "origin_mm": (0, 1, 30)}, "no node of the grid is inside"),
        (K | {"time_s": 1.0}, "holds one time; leave --time out"),
        (K | {"ambient": 20.0}, "a temperature of 20 K, read in K.*--units degC"),
    ],
)
def test_what_is_said_must_make_sense(choices, match, tmp_path):
    """Rationale: the program cannot guess, but it can tell what is missing or cannot be."""
    if match is None:  # 436 degC at least: hot, but possible
        import_field(npz(tmp_path), Choices(**choices))
        return
    refused(npz(tmp_path), match, **choices)


@pytest.mark.parametrize(
    ("arrays", "match", "choices"),
    [
        ({"T": VALUES, "rho": 1.2 + 0 * VALUES}, "2 variables come into question, T, rho;", {}),
        ({"T": VALUES, "T0": VALUES}, None, {}),
        ({"a": VALUES, "b": VALUES}, "2 variables come into question, a, b;", {}),
        ({"q": VALUES}, "what is variable 'q'.*--quantity temperature", {}),
        ({"T": VALUES - 273.15 - 200}, "degC, said to be K.*--units degC", {}),
        ({"T": VALUES - 150}, "coldest air is at .*K, said to be degC", {"units": "degC"}),
        ({"T": VALUES + 6000}, "missing values are NaN", {}),
        ({"T": VALUES * np.nan}, "'T' has no finite value", {}),
        ({"rho": VALUES}, "densities of .*--units kg/m3 or g/cm3", {"units": "kg/m3"}),
        ({"rho": 1e-3 + 0 * VALUES}, "densities of .* g/cm3", {"units": "kg/m3"}),
        ({"n": 2.7e-4 + 0 * VALUES}, "n - 1, said to be n", {"units": None}),
        ({"refractivity": 1.00027 + 0 * VALUES}, "n, said to be n - 1", {"units": None}),
        ({"refractivity": 27 + 0 * VALUES}, "which no gas has", {"units": None}),
        ({"rho": 1 + 0 * VALUES}, "--pressure goes with", {"units": "kg/m3", "pressure_pa": 1e5}),
        ({"T": VALUES[:-1]}, "arrays do not fit each other", {}),
        ({"T": VALUES.astype("U8")}, "holds no real numbers", {}),
    ],
)
def test_variables_must_be_one_and_physical(arrays, match, choices, tmp_path):
    """Rationale: n for n - 1, K for degC or g/cm3 for kg/m3 is soon said, and bends no light."""
    path = npz(tmp_path, **arrays)
    if match is None:
        assert import_field(path, Choices(**K)).quantity.kind == "temperature"
        return
    refused(path, match, **(K | choices))


def with_gap(low, high, values=VALUES):
    """The plume with NaN where low <= node <= high."""
    inside = ((lattice() >= low) & (lattice() <= high)).all(axis=-1)
    return np.where(inside, np.nan, values)


PART = ([-10, -8, 10], [10, 8, 26])


@pytest.mark.parametrize(
    ("values", "match", "choices"),
    [
        (with_gap([-4, 0, 40], [-4, 0, 40]), r"1 nodes at \(-4, 0, 40\) mm have no data", {}),
        (with_gap([0, 0, 50], [9, 9, 99]), "no data, and are open to the field's border", {}),
        (
            with_gap([0, 0, 40], [8, 8, 48], with_gap(*PART)),
            "no data in 2 enclosed regions, in x -10 to 10.*--solid enclosed",
            {},
        ),
        (with_gap(*PART), "no data in 1 enclosed regions", {"solid": "none"}),
        (
            with_gap([0, 0, 40], [8, 8, 48], with_gap(*PART)),
            "no data in 1 enclosed regions, in x 0 to 8, y 0 to 8, z 40 to 48 mm",
            {"solid": "cylinder:12", "origin_mm": (0, 0, 30)},
        ),
    ],
)
def test_a_hole_in_the_light_path_is_refused(values, match, choices, tmp_path):
    """Rationale: to fill it would make up what the light is bent by."""
    if "origin_mm" in choices:
        match = match.replace("40 to 48", "10 to 18")
    refused(npz(tmp_path, T=values), match, **K, **choices)


def test_two_parts_may_be_told(tmp_path):
    """Rationale: what one user's hole is, is another's second part."""
    values = with_gap([0, 0, 40], [8, 8, 48], with_gap(*PART))
    made = import_field(npz(tmp_path, T=values), Choices(solid="enclosed", **K))
    np.testing.assert_array_equal(made.quantity.solid, np.isnan(values))


def test_n_in_float32_is_noted(tmp_path):
    """Rationale: its digits end at 1.2e-7, which is 4e-4 of the n - 1 of air."""
    n = (1 + 2.7e-4 * 293.15 / VALUES).astype(np.float32)
    made = import_field(npz(tmp_path, n=n), Choices(length_units="mm"))
    assert any("float32" in note for note in made.notes)


def test_a_field_that_does_not_end_in_the_surrounding_air_is_noted(tmp_path):
    """Rationale: what is left at the border is a jump of n, which refracts."""
    path = npz(tmp_path)
    assert any("at the field's border" in n for n in import_field(path, Choices(**K)).notes)
    border = np.concatenate([VALUES.take(i, a).ravel() for a in range(3) for i in (0, -1)])
    assert import_field(path, Choices(**K, ambient=float(np.median(border)))).notes == ()


def cut(path, fraction):
    content = path.read_bytes()
    path.write_bytes(content[: int(len(content) * fraction)])
    return path


@pytest.mark.parametrize("suffix", ["csv", "grid.txt", "points.txt", "npz", "npy"])
def test_truncated_tables_are_refused(suffix, tmp_path):
    """Rationale: half a file is half a plume."""
    path = tmp_path / f"a.{suffix}"
    if suffix == "csv":
        plume.write_csv(path, ROWS)
    elif suffix == "grid.txt":
        plume.write_comsol_grid(path)
    elif suffix == "points.txt":
        plume.write_comsol(path, ROWS)
    elif suffix == "npz":
        npz(tmp_path)
    else:
        np.save(path, VALUES)
    path = cut(path, 0.7)
    told = {"spacing_mm": (2.0, 2.0, 2.0)} if suffix == "npy" else {}
    refused(path, "truncated|columns|hole in the light path", **told)


def test_a_truncated_header_count_is_refused(tmp_path):
    """Rationale: cut at a row's end nothing else would tell."""
    path = plume.write_comsol(tmp_path / "a.txt", ROWS[:-25], nodes=len(ROWS))
    refused(path, "its header says 16275 nodes, there are 16250 rows")


@pytest.mark.parametrize("suffix", ["vti", "vtk", "vtr", "vts", "vtu"])
@pytest.mark.parametrize("fraction", [0.3, 0.95])
def test_truncated_vtk_files_are_refused(pv, suffix, fraction, tmp_path, capfd):
    """Rationale: VTK prints many lines and goes on with an empty grid or with rubbish."""
    image = pv.ImageData(dimensions=(9, 9, 9), spacing=(2, 2, 2))
    image["T"] = temperature(image.points)
    data = {
        "vtr": image.cast_to_rectilinear_grid,
        "vts": image.cast_to_structured_grid,
        "vtu": image.cast_to_unstructured_grid,
    }.get(suffix, lambda: image)()
    path = tmp_path / f"a.{suffix}"
    data.save(path)
    refused(cut(path, fraction), "is truncated or damaged", **K)
    assert capfd.readouterr() == ("", "")


def test_a_missing_piece_is_refused(pv, tmp_path):
    """Rationale: the parallel file is copied and one of its parts forgotten."""
    mesh = plume.hexahedra(pv, lattice(X[:9], Y[:9], Z[:9]))
    mesh.cell_data["T"] = temperature(mesh.cell_centers().points)
    path = plume.write_parallel_mesh(tmp_path / "a.pvtu", mesh)
    (tmp_path / "piece1.vtu").unlink()
    refused(path, "File for piece 1 cannot be read", **K)


def test_an_openfoam_case_must_be_whole(pv, tmp_path):
    """Rationale: no case, no times, no such time, two candidates, a damaged field."""
    refused(tmp_path, "no OpenFOAM case")
    nodes = lattice(X[:9], Y[:9], Z[:9])
    case = plume.write_openfoam(tmp_path / "case", nodes, extra=[("rho", "[1 -3 0 0 0 0 0]")])
    refused(case, r"2 variables come into question, T \[K\], rho \[kg/m3\]")
    refused(case, "no time 3 s; the last ones are 0.5", time_s=3.0)
    refused(
        case, "the file says that 'T' is in K; leave --units degC out", variable="T", units="degC"
    )
    refused(case, "length is in m; leave --length-units mm", variable="T", length_units="mm")
    cut(case / "0.5" / "T", 0.5)
    refused(case, "is truncated or damaged", variable="T")
    for file in (case / "0.5").iterdir():
        file.unlink()
    refused(case, "holds no scalar")
    (case / "0.5").rmdir()
    (case / "constant").rename(tmp_path / "lost")
    refused(case, "has no time folders")


@pytest.mark.parametrize(
    ("name", "content", "match"),
    [
        ("a.xyz", "1", "what is '.xyz'. Known are: an OpenFOAM case"),
        ("a.csv", "1,2,3,4\n1,2,3,5\n", "needs a header row"),
        ("a.csv", "x,y,T\n", "needs a header row"),
        ("a.csv", "x [mm],T [K]\n1,300\n", "needs columns x, y and z"),
        ("a.csv", "x [m],y [mm],T [K]\n1,2,300\n", "coordinates in different units: m, mm"),
        ("a.csv", "x,y,z,T\n1,2,3\n", "header names 4 columns .* the rows have 3"),
        ("a.csv", "x,y,z,T\n1,2,3,300\n1,2,3\n", "columns changed from 4 to 3 at row 2"),
        ("a.csv", "x,y,z,T\n1,2,3,hot\n", "'hot'.*at row 1"),
        ("a.csv", "x,y,z,T\nnan,2,3,300\n", "a coordinate is not finite"),
        ("a.csv", "x [mm],y [mm],z [mm]\n1,2,3\n", "holds no scalar"),
        ("a.txt", "% Length unit: m\n% r z T (K)\n1 2 300\n", "is axisymmetric"),
        ("a.txt", "% Coordinates\n1 2 3\n% Elements\n1\n% Data\n300\n", "sectionwise form"),
        ("a.txt", "% Length unit: m\n", "holds no numbers"),
        ("a.npy", "no NumPy", "truncated, damaged or no NumPy file"),
    ],
)
def test_what_is_no_such_file_is_refused(name, content, match, tmp_path):
    """Rationale: the line and what is wanted there are named."""
    (tmp_path / name).write_text(content)
    refused(tmp_path / name, match)


def test_points_in_a_plane_or_on_a_line_are_refused(pv, tmp_path):
    """Rationale: a cross-section must say so, and a line holds no field."""
    flat = warped()[:, :, 3]
    path = plume.write_comsol(
        tmp_path / "a.txt", flat.reshape(-1, 3)[:, :2], temperature(flat).ravel()
    )
    refused(path, "is 2-D, flat along its z.*--axes z,x,y")
    refused(path, "from where to where along x with --extrude", axes="z,x,y")


def test_without_the_extra_the_remedy_is_told(tmp_path, monkeypatch):
    """Rationale: VTK is large, so it is not installed with us."""
    (tmp_path / "a.vtu").touch()
    monkeypatch.setitem(sys.modules, "pyvista", None)
    refused(tmp_path / "a.vtu", r"pip install 'virtual-sensor\[fields\]'")
    refused(tmp_path / "b.vtu", "there is no such file")


def test_the_command_writes_a_field_and_tells_what_is_in_it(tmp_path, monkeypatch):
    """Rationale: from the solver's file to a field that a scene can use, in one line."""
    monkeypatch.chdir(tmp_path)
    npz(tmp_path)
    line = "field import a.npz --units K --length-units mm --origin 0,0,-10 --ambient 300 -o o.nc"
    status, out, err = command(*line.split())
    assert (status, err) == (0, "")
    assert "extent: x -20 to 20, y -24 to 24, z 10 to 70 mm" in out
    assert "nodes: 21 x 25 x 31, 2 x 2 x 2 mm apart" in out
    assert "virtual-sensor field info o.nc" in out
    np.testing.assert_allclose(IndexField.read(tmp_path / "o.nc").origin, [-20, -24, 10])
    assert line.encode() in (tmp_path / "o.nc").read_bytes()

    status, _, err = command(*line.split())
    assert (status, err.count("\n")) == (2, 1)
    assert "o.nc: exists" in err
    assert command(*line.split(), "--overwrite")[0] == 0


@pytest.mark.parametrize(
    ("arguments", "match"),
    [
        ("--origin 1,2", "--origin 1,2: give 3 numbers with commas in between"),
        ("--box 1,2,3,4,5,inf", "--box 1,2,3,4,5,inf: give 6 numbers"),
        ("--spacing fine", "--spacing fine: give 1 or 3 numbers"),
    ],
)
def test_numbers_are_told_with_commas(arguments, match, tmp_path, monkeypatch):
    """Rationale: nothing is written when an option cannot be read."""
    monkeypatch.chdir(tmp_path)
    npz(tmp_path)
    status, _, err = command("field", "import", "a.npz", *arguments.split(), "-o", "o.nc")
    assert status == 2
    assert match in err
    assert not (tmp_path / "o.nc").exists()


@pytest.mark.parametrize(
    "options",
    [{"origin_mm": ()}, {"spacing_mm": ()}, {"box_mm": (0.0,) * 5}, {"extrude_mm": (1.0,)}],
)
def test_options_of_too_few_numbers_are_refused(tmp_path, options):
    """A script may give them; of the commands each counts its own."""
    path = tmp_path / "n.npy"
    np.save(path, np.full((4, 4, 4), 2.7e-4))
    with pytest.raises(InputError, match=r"n\.npy: --\w+ \(.*\): give \d finite numbers"):
        import_field(path, Choices(**options))


@pytest.mark.parametrize("binary", [False, True])
def test_a_legacy_file_whose_size_is_not_that_of_its_data_is_refused(tmp_path, binary):
    """VTK would ask for the memory of a billion nodes before it finds out."""
    pv = pytest.importorskip("pyvista")
    image = pv.ImageData(dimensions=(5, 6, 7), spacing=(6.0, 6.0, 4.0))
    image.point_data["T"] = np.linspace(300.0, 400.0, 210)
    path = tmp_path / "a.vtk"
    image.save(str(path), binary=binary)
    data = path.read_bytes()
    for dimensions in (b"1000000005 6 7", b"5 6 8"):
        path.write_bytes(data.replace(b"DIMENSIONS 5 6 7", b"DIMENSIONS " + dimensions))
        refused(path, "is truncated or damaged", **K)
