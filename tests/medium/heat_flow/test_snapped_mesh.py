"""A part from an STL file: refused in words, or meshed, simulated and sampled."""

import re
import shutil
from dataclasses import replace
from importlib.util import find_spec
from types import SimpleNamespace

import numpy as np
import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow.balance import check_wall_layer
from virtual_sensor.medium.heat_flow.prepare import make_mesh, prepare_case
from virtual_sensor.medium.heat_flow.run import run_case
from virtual_sensor.medium.heat_flow.sample import SampleGrid, sample
from virtual_sensor.medium.heat_flow.setup import HeatFlow
from virtual_sensor.medium.heat_flow.snapped_mesh import (
    SURFACE,
    read_part,
    snapped_mesh,
    wall_faces_mm,
)
from virtual_sensor.medium.imports import mesh_values
from virtual_sensor.medium.imports.meshes import moved, read_openfoam
from virtual_sensor.medium.imports.sources import Mesh

pytestmark = pytest.mark.skipif(
    find_spec("pyvista") is None, reason="the extra virtual-sensor[fields] is absent"
)

RADIUS, LENGTH = 10.0, 20.0
CELL = 3.2
END_S = 0.05  # of flow: some 40 time steps


def cylinder(**changes):
    shape = {"center": (0, 0, -RADIUS), "direction": (1, 0, 0), "radius": RADIUS, "height": LENGTH}
    import pyvista as pv

    return pv.Cylinder(**(shape | changes), resolution=90).triangulate()


def written(folder, surface, name="part.stl"):
    path = folder / name
    surface.save(path)
    return path


def box(low, high):
    bounds = [edge for pair in zip(low, high, strict=True) for edge in pair]
    import pyvista as pv

    return pv.Box(bounds).triangulate()


def open_box():
    whole = box((-9, -9, -9), (9, 9, 0))
    return whole.remove_cells([0])


@pytest.mark.parametrize(
    ("surface", "match"),
    [
        (cylinder().scale(1e-3), r"0.02 x 0.02 x 0.02 mm; .* in m, scale it by 1000"),
        (cylinder().scale(1e3), r"2e\+04 x 2e\+04 x 2e\+04 mm; .* in um, scale it by 0.001"),
        (cylinder(center=(0, 90, -9)), "at y = 80 to 100 mm, outside the domain: .*; move the"),
        (cylinder(center=(-90, 0, -9)), "at x = -100 to -80 mm, outside the domain: .*; move the"),
        (cylinder(center=(0, 0, 200)), "reaches up to z = 210 mm; the domain ends at 305 mm"),
        (open_box(), r"is not closed: 3 edges .* the first at \(-?9, -?9, \S+\) mm"),
    ],
)
def test_a_part_that_cannot_be_simulated_is_refused_with_a_remedy(tmp_path, surface, match):
    """Rationale: OpenFOAM meshes each of them, or fails far from the cause."""
    path = written(tmp_path, surface)
    with pytest.raises(InputError, match=match) as caught:
        prepare_case(HeatFlow(stl=path, cell_mm=1.0), tmp_path / "case", 0.1, 0.1)
    assert f"{caught.value}".startswith(f"{path}: ")
    assert "\n" not in f"{caught.value}"
    assert [p.name for p in tmp_path.iterdir()] == ["part.stl"]


@pytest.mark.parametrize(
    ("content", "match"),
    [
        (None, "there is no such file"),
        (b"", "truncated or damaged"),
        (b"not a surface, but a longer text " * 9, "truncated or damaged"),
        (b"solid a\nendsolid a\n", "holds no triangles"),
    ],
)
def test_what_is_no_stl_file_is_told(tmp_path, content, match):
    """Rationale: VTK gives an empty surface and prints on the terminal."""
    path = tmp_path / "part.stl"
    if content is not None:
        path.write_bytes(content)
    with pytest.raises(InputError, match=match) as caught:
        read_part(path)
    assert f"{caught.value}".startswith(f"{path}: ")


def test_a_mesh_that_does_not_resolve_the_wall_layer_is_told_with_the_cells(tmp_path):
    """Rationale: the heat given off, and all the plume with it, would be wrong unseen."""
    flow = HeatFlow(stl=written(tmp_path, cylinder()), cell_mm=2.0)
    with pytest.raises(InputError, match=r"of 2 mm resolves .* with 3 cells") as caught:
        check_wall_layer(flow)
    finer = float(re.search(r"take ([\d.]+) mm", f"{caught.value}")[1])
    check_wall_layer(replace(flow, cell_mm=finer))
    with pytest.raises(InputError, match="with 5 cells"):
        check_wall_layer(replace(flow, cell_mm=finer + 0.05))


def test_a_mesh_beyond_every_machine_is_refused(tmp_path):
    """Rationale: snappyHexMesh would fill the memory, hours later."""
    part = read_part(written(tmp_path, box((-400, -400, -400), (400, 400, 0))))
    with pytest.raises(InputError, match=r"of 0.4 mm would be about \d+ million.* 20 million"):
        snapped_mesh(part, 0.4)


def test_the_parts_file_is_what_the_case_is_of(tmp_path):
    """Rationale: a part changed under its name is another part, and one that was moved is not."""
    one, other = tmp_path / "one", tmp_path / "other"
    one.mkdir()
    other.mkdir()
    path = written(one, cylinder())
    case = tmp_path / "case"
    prepare_case(HeatFlow(stl=path), case, 0.1, 0.1)
    prepare_case(HeatFlow(stl=shutil.copy(path, other) and other / path.name), case, 0.1, 0.1)
    written(one, cylinder(height=21.0))
    with pytest.raises(InputError, match="was made with stl_sha256 = "):
        prepare_case(HeatFlow(stl=path), case, 0.1, 0.1)
    with pytest.raises(InputError, match=r"was made with stl = part.stl, not None"):
        prepare_case(HeatFlow(), case, 0.1, 0.1)


def test_a_long_parts_field_stays_within_two_megabytes(tmp_path):
    """Rationale: what is shipped and mailed; along the part less is needed than across it."""
    shaft = written(tmp_path, cylinder(height=170.0))
    grid = SampleGrid.of(HeatFlow(stl=shaft))
    assert 0.8 * 2e6 < 2 * len(grid.x) * len(grid.y) * len(grid.z) < 2e6
    np.testing.assert_allclose(grid.spacing / grid.spacing[1], [4.0, 1.0, 2.0])
    assert grid.x[0] < -100.0 < 100.0 < grid.x[-1] + grid.spacing[0]
    assert grid.z[0] < -2.0 * RADIUS < 290.0 < grid.z[-1]


def test_what_is_inside_is_known_whatever_way_the_faces_look(tmp_path):
    """Rationale: a field whose solid is all but the part; formulas of the bodies are the judge."""
    ball, plate = cylinder(height=30.0), box((-40, -30, -60), (40, 30, -19))  # they overlap
    mixed = ball.flip_faces().append_polydata(plate)
    points = np.random.default_rng(1).uniform((-45, -35, -65), (45, 35, 5), (4000, 3))
    x, y, z = points.T
    r = np.hypot(y, z + RADIUS)
    inside = (r < RADIUS) & (abs(x) < 15.0) | (abs(x) < 40) & (abs(y) < 30) & (z > -60) & (z < -19)
    clear = abs(r - RADIUS) > 0.05
    for surface in (mixed, ball.append_polydata(plate.flip_faces())):
        part = read_part(written(tmp_path, surface))
        assert len(part.bodies) == 2
        np.testing.assert_array_equal(part.holds(points)[clear], inside[clear])
        assert part.volume_mm3 == pytest.approx(np.pi * 100 * 30 + 80 * 60 * 41, rel=2e-3)
    twice = box((-10, -10, -10), (10, 10, 0)).append_polydata(box((-9, -9, -9), (11, 11, 0.5)))
    part = read_part(written(tmp_path, twice))
    assert part.volume_mm3 == pytest.approx(4000 + 3800)
    assert part.filled_mm3 == pytest.approx(7800 - 19 * 19 * 9, rel=0.04)


def test_thin_walls_that_the_mesh_has_lost_are_told(tmp_path):
    """Rationale: snappyHexMesh leaves them out in silence, and what is not there is not hot."""
    case = tmp_path / "case"
    prepare_case(HeatFlow(stl=written(tmp_path, box((-30, -20, -1), (30, 20, 0)))), case, 0.1, 0.1)
    (case / "constant/polyMesh").mkdir()
    (case / "constant/polyMesh/points").touch()
    low, high = (-0.1, -0.1, -0.1), (0.1, 0.1, 0.3)
    said = (
        "Overall domain bounding box ({} {} {}) ({} {} {})\nMesh OK.\nTotal volume = {:.9g}.  OK\n"
    )
    for held_mm3, lost in ((2300.0, False), (900.0, True)):
        air = 0.2 * 0.2 * 0.4 - 1e-9 * held_mm3
        (case / "log.checkMesh").write_text(said.format(*low, *high, air))
        if lost:
            with pytest.raises(InputError, match=r"only 38% of the part: .* take --cell 0.48,"):
                make_mesh(None, case)
        else:
            make_mesh(None, case)


@pytest.fixture(scope="session")
def run(openfoam, tmp_path_factory):
    """A small part's flow after its first moments."""
    folder = tmp_path_factory.mktemp("snapped")
    flow = HeatFlow(stl=written(folder, cylinder()), cell_mm=CELL)
    case = folder / "case"
    prepare_case(flow, case, END_S, END_S)
    end = run_case(case, END_S)
    return SimpleNamespace(flow=flow, case=case, time_s=end.time_s)


@pytest.mark.slow
def test_the_mesh_lies_on_the_part(run):
    """Rationale: cells cut off in steps have a third more surface, and give off that much more."""
    assert "Mesh OK." in (run.case / "log.checkMesh").read_text()
    cells = read_openfoam(run.case, run.time_s).geometry.cells
    faces = cells.extract_surface(algorithm="dataset_surface").scale(1e3)
    x, y, z = faces.cell_centers().points.T
    wall = faces.extract_cells((abs(x) < LENGTH) & (abs(y) < 2 * RADIUS) & (abs(z) < 3 * RADIUS))
    wall = wall.extract_surface(algorithm="dataset_surface")
    part = cylinder()
    assert wall.is_manifold
    assert wall.area == pytest.approx(part.area, rel=0.03)
    assert abs(wall.compute_implicit_distance(part)["implicit_distance"]).max() < 0.1 * CELL
    finest = wall_faces_mm(CELL)[0]
    assert np.sqrt(np.median(wall.compute_cell_sizes()["Area"])) == pytest.approx(finest, rel=0.25)


@pytest.mark.slow
def test_the_air_round_the_part_is_sampled(run):
    """Rationale: from a case with polyhedra to a field with the part's very shape in it."""
    assert run.time_s == END_S
    grid = SampleGrid.of(run.flow, (2.0, 1.5, 3.0))
    quantity = sample(run.flow, run.case, (run.time_s,), grid)
    assert quantity.mirror == (False, False, False)
    x, y, z = np.meshgrid(grid.x, grid.y, grid.z, indexing="ij")
    r = np.hypot(y, z + RADIUS)
    inside = (r < 0.99 * RADIUS) & (abs(x) < 0.49 * LENGTH)
    outside = (r > 1.01 * RADIUS) | (abs(x) > 0.51 * LENGTH)
    assert quantity.solid[inside].all()
    assert not quantity.solid[outside & (np.hypot(r - RADIUS, abs(x) - LENGTH / 2) > 1.0)].any()
    assert np.isfinite(quantity.values[~quantity.solid]).all()
    distance = np.maximum(r - RADIUS, abs(x) - LENGTH / 2)
    near = quantity.values[(distance > 0.2) & (distance < 1.0)]
    far = quantity.values[distance > 20.0]
    wall_k = run.flow.ambient_k + END_S / 0.25 * (run.flow.wall_k - run.flow.ambient_k)
    assert run.flow.ambient_k + 30.0 < near.mean() < wall_k
    np.testing.assert_allclose(far, run.flow.ambient_k, atol=3.0)
    with pytest.raises(InputError, match="reaches beyond the simulated air"):
        sample(run.flow, run.case, (run.time_s,), replace(grid, x=grid.x * 3.0))


@pytest.mark.slow
def test_where_cells_of_two_sizes_meet_nothing_is_made_up(run):
    """Rationale: polyhedra fall into tetrahedra, of which flat ones gave temperatures below 0 K."""
    cells = read_openfoam(run.case, run.time_s).geometry.cells
    cells = moved(cells, 1e3 * np.asarray(cells.points, dtype=np.float64))

    def hump(points):
        from_axis = np.asarray(points) - (0.0, 0.0, -RADIUS)
        return np.exp(-((np.linalg.norm(from_axis, axis=-1) / 25.0) ** 4))

    axes = tuple(np.arange(low, 45.0, 1.7) for low in (-45.0, -45.0, -50.0))
    nodes = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1)
    found = mesh_values.sample(Mesh(cells, True), hump(cells.cell_centers().points), axes)
    known = np.isfinite(found)
    assert known.mean() > 0.97
    np.testing.assert_allclose(found[known], hump(nodes)[known], atol=0.035)


@pytest.mark.slow
def test_the_case_holds_the_part_that_was_simulated(run):
    """Rationale: the field can be sampled again when the STL file is gone."""
    assert read_part(run.case / SURFACE).surface.area == pytest.approx(cylinder().area, rel=1e-6)
