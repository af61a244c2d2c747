"""A plume known in closed form, written in the formats of other solvers."""

import numpy as np

X, Y, Z = np.linspace(-20, 20, 21), np.linspace(-24, 24, 25), np.linspace(0, 60, 31)
K = {"units": "K", "length_units": "mm"}


def temperature(points_mm):
    """Temperature of the plume at world positions (..., 3) in mm, K."""
    x, y, z = np.moveaxis(np.asarray(points_mm, dtype=np.float64), -1, 0)
    return 293.15 + 500.0 * np.exp(-((y / 16) ** 2) / 2 - (x / 40) ** 2 / 2) * (1 + z / 300)


def lattice(x=X, y=Y, z=Z):
    """Positions of all nodes, (nx, ny, nz, 3)."""
    return np.stack(np.meshgrid(x, y, z, indexing="ij"), axis=-1)


def warped(nodes=None):
    """Nodes moved inside the box, so that no cell is a cuboid and no axis regular."""
    nodes = lattice() if nodes is None else nodes
    low, high = nodes.min(axis=(0, 1, 2)), nodes.max(axis=(0, 1, 2))
    bumps = np.sin(np.pi * (nodes - low) / (high - low)).prod(axis=-1)
    return nodes + 0.03 * bumps[..., None] * (high - low) * [1.0, -0.7, 0.5]


def hexahedra(pv, nodes):
    """Nodes (nx, ny, nz, 3) as an unstructured grid of hexahedra."""
    return pv.StructuredGrid(*np.moveaxis(nodes, -1, 0).copy()).cast_to_unstructured_grid()


def write_csv(path, points, header="x [mm],y [mm],z [mm],T [K]", values=None):
    """One row for each of the points (N, 3)."""
    values = temperature(points) if values is None else values
    rows = np.column_stack([points, values])
    np.savetxt(path, rows, "%.12g", ",", header=header, comments="")
    return path


def write_comsol(path, points, values=None, unit="mm", column="T (K) @ t=0.5", nodes=None):
    """COMSOL's spreadsheet form, one row for each of the points (N, 2 or 3)."""
    values = temperature(points) if values is None else values
    names = "xyz"[: points.shape[1]]
    header = (
        "% Model:              plume.mph\n% Version:            COMSOL 6.2.0.415\n"
        f"% Date:               Nov 23 2026, 09:23\n% Dimension:          {len(names)}\n"
        f"% Nodes:              {nodes or len(points)}\n% Expressions:        1\n"
        f"% Description:        Temperature\n% Length unit:        {unit}\n% "
        + "".join(f"{name:<25}" for name in names)
        + column
    )
    rows = np.column_stack([points, values])
    np.savetxt(path, rows, "%-25.15g", header=header, comments="")
    return path


def write_comsol_grid(path, x=X, y=Y, z=Z, values=None):
    """COMSOL's grid form: the axes, then a row along x for each y and z."""
    values = temperature(lattice(x, y, z)) if values is None else values
    with path.open("w") as file:
        file.write("% Version:            COMSOL 6.2.0.415\n% Length unit:        mm\n% Grid\n")
        for axis in (x, y, z):
            file.write(" ".join(map(repr, axis.tolist())) + "\n")
        file.write("% Data\n% T (K)\n")
        for row in values.transpose(2, 1, 0).reshape(-1, len(x)):
            file.write(" ".join(map(repr, row.tolist())).replace("nan", "NaN") + "\n")
    return path


def write_parallel_image(path, image):
    """An image in two parts along x, as .pvti."""
    (nx, ny, nz), half = (n - 1 for n in image.dimensions), 7
    pieces = ""
    for i, (first, last) in enumerate(((0, half), (half, nx))):
        extent = (first, last, 0, ny, 0, nz)
        image.extract_subset(extent, rebase_coordinates=False).save(path.parent / f"piece{i}.vti")
        pieces += f'<Piece Extent="{" ".join(map(str, extent))}" Source="piece{i}.vti"/>'
    origin, spacing = (" ".join(map(str, v)) for v in (image.origin, image.spacing))
    path.write_text(
        f'<VTKFile type="PImageData" version="0.1"><PImageData WholeExtent="0 {nx} 0 {ny} 0 {nz}" '
        f'GhostLevel="0" Origin="{origin}" Spacing="{spacing}"><PPointData><PDataArray '
        f'type="Float64" Name="T"/></PPointData>{pieces}</PImageData></VTKFile>'
    )
    return path


def write_parallel_mesh(path, mesh):
    """An unstructured grid with cell values in two parts, as .pvtu; the parts share points."""
    low = mesh.cell_centers().points[:, 0] < 3.0
    for i, cells in enumerate((low, ~low)):
        mesh.extract_cells(cells).save(path.parent / f"piece{i}.vtu")
    pieces = "".join(f'<Piece Source="piece{i}.vtu"/>' for i in range(2))
    path.write_text(
        '<VTKFile type="PUnstructuredGrid" version="0.1"><PUnstructuredGrid GhostLevel="0">'
        '<PCellData><PDataArray type="Float64" Name="T"/></PCellData><PPoints><PDataArray '
        f'type="Float64" NumberOfComponents="3"/></PPoints>{pieces}</PUnstructuredGrid></VTKFile>'
    )
    return path


def write_openfoam(folder, nodes, times=("0.5",), processors=1, extra=()):
    """A case with values at the centres of hexahedra between nodes (nx, ny, nz, 3) in mm.

    With more than one processor it is decomposed along x. `extra` names further fields.
    """
    _write_foam(folder / "system" / "controlDict", "dictionary", "application none;\n")
    (folder / "air.foam").touch()
    parts = np.array_split(np.arange(len(nodes) - 1), processors)
    for i, part in enumerate(parts):
        home = folder / f"processor{i}" if processors > 1 else folder
        own = nodes[part[0] : part[-1] + 2]
        centres = _write_poly_mesh(home / "constant" / "polyMesh", own)
        for time in times:
            for name, dimensions in (("T", "[0 0 0 1 0 0 0]"), *extra):
                values = temperature(centres) if name == "T" else np.ones(len(centres))
                text = f"dimensions {dimensions};\ninternalField nonuniform List<scalar>\n"
                text += f"{_foam_list(f'{v:.12g}' for v in values)};\n"
                text += "boundaryField { border { type zeroGradient; } }\n"
                _write_foam(home / time / name, "volScalarField", text)
    return folder


def _write_foam(path, kind, text):
    path.parent.mkdir(parents=True, exist_ok=True)
    head = f"FoamFile {{ version 2.0; format ascii; class {kind}; object {path.name}; }}\n"
    path.write_text(head + text)


def _foam_list(items):
    lines = list(items)
    return f"{len(lines)}\n(\n" + "\n".join(lines) + "\n)\n"


def _write_poly_mesh(folder, nodes):
    """Write points, faces, owner, neighbour and boundary; return the cells' centres in mm."""
    shape = nodes.shape[:3]
    node = np.arange(np.prod(shape)).reshape(shape)
    cell = np.arange(np.prod(np.subtract(shape, 1))).reshape(np.subtract(shape, 1))
    inner, border = [], []  # owner, neighbour, four points whose normal leaves the owner
    for axis in range(3):
        # Seen from the end of the axis, (0, 0) (1, 0) (1, 1) (0, 1) turns to the left.
        turned = np.moveaxis(node, (axis, (axis + 1) % 3, (axis + 2) % 3), (0, 1, 2))
        cells = np.moveaxis(cell, (axis, (axis + 1) % 3, (axis + 2) % 3), (0, 1, 2))
        corners = (turned[:, :-1, :-1], turned[:, 1:, :-1], turned[:, 1:, 1:], turned[:, :-1, 1:])
        faces = np.stack(corners, axis=-1)
        pairs = np.stack([cells[:-1], cells[1:]], axis=-1)
        inner.append(np.concatenate([pairs, faces[1:-1]], axis=-1).reshape(-1, 6))
        for owner, face in ((cells[0], faces[0][..., ::-1]), (cells[-1], faces[-1])):
            border.append(np.concatenate([owner[..., None], face], axis=-1).reshape(-1, 5))
    within, outside = np.concatenate(inner), np.concatenate(border)
    within = within[np.lexsort((within[:, 1], within[:, 0]))]
    faces = np.concatenate([within[:, 2:], outside[:, 1:]])
    points = nodes.reshape(-1, 3)
    for name, kind, lines in (
        ("points", "vectorField", ("({:.12g} {:.12g} {:.12g})".format(*p / 1e3) for p in points)),
        ("faces", "faceList", ("4({} {} {} {})".format(*face) for face in faces)),
        ("owner", "labelList", (str(c) for c in [*within[:, 0], *outside[:, 0]])),
        ("neighbour", "labelList", (str(c) for c in within[:, 1])),
    ):
        _write_foam(folder / name, kind, _foam_list(lines))
    patch = f"border {{ type patch; nFaces {len(outside)}; startFace {len(within)}; }}"
    _write_foam(folder / "boundary", "polyBoundaryMesh", f"1\n(\n{patch}\n)\n")
    eight = [nodes[i : i - 1 or None, j : j - 1 or None, k : k - 1 or None] for i, j, k in CORNERS]
    return np.mean(eight, axis=0).reshape(-1, 3)


CORNERS = list(np.ndindex(2, 2, 2))
