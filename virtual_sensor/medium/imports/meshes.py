"""Files of VTK and cases of OpenFOAM, read by VTK through PyVista (an optional extra)."""

from __future__ import annotations

import logging
import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.columns import ascending, pick_time
from virtual_sensor.medium.imports.import_field import NEEDS_PYVISTA
from virtual_sensor.medium.imports.sources import (
    Cloud,
    Grid,
    Mesh,
    Source,
    Variable,
    as_lattice,
    on_lattice,
)
from virtual_sensor.medium.imports.vtk_arrays import (
    DUPLICATE,
    HIDDEN_CELL,
    REFINED,
    blank_points,
    check_mesh,
    ghosts,
    joined_neighbours,
    left_out,
    scalars,
    with_only,
)

_Read = tuple[list[Variable], Grid | Cloud | Mesh, tuple[str, ...]]  # values, where, and notes

DATA_SETS = {  # by the last letter of a suffix
    "i": "ImageData",
    "p": "PolyData",
    "r": "RectilinearGrid",
    "s": "StructuredGrid",
    "u": "UnstructuredGrid",
}
SERIAL = (".vti", ".vtk", ".vtp", ".vtr", ".vts", ".vtu")
PARALLEL = (".pvti", ".pvtr", ".pvts", ".pvtu")
DAMAGED_CASE = "[Ee]rror"
"""In what VTK says of an OpenFOAM case; that folders are absent is an "ERROR" too."""
COLLATED = (
    "is decomposed in OpenFOAM's collated form (processorsN), which VTK doesn't read; run"
    " `reconstructPar` (of several regions `reconstructPar -allRegions`)"
)


def pyvista() -> Any:
    """Import PyVista.

    Raises
    ------
    InputError
        If it is not installed.
    """
    try:
        import pyvista
    except ImportError as error:
        raise InputError(NEEDS_PYVISTA) from error
    return pyvista


def read_vtk(path: Path) -> Source:
    """Read a file of VTK.

    Images and rectilinear grids become a `Grid`, as do meshes whose points, or cells' centres, lie
    on one. A damaged file may end the process: `import_field` reads it in a child.

    ===============================  =======================================================
    Feature                          What is done
    ===============================  =======================================================
    .vtk .vti .vtr .vts .vtu .vtp    heeded: ASCII, binary, appended, compressed
    .pvti .pvtr .pvts .pvtu          heeded: parts are joined, without their ghost cells
    values at points or cells        heeded, both in one file too; of one name those at points
    origin, spacing, extent          heeded: an extent need not begin at 0
    negative spacing                 heeded: reversed
    descending coordinates           heeded: reversed
    direction matrix                 heeded
    blanked points and cells         heeded: no data (vtkGhostType), noted
    vtkValidPointMask                heeded: no data where it is 0 (ParaView's resampling), noted
    NaN                              heeded: no data
    polyhedra                        heeded
    points without cells             heeded: joined to tetrahedra
    integers                         heeded
    vectors, tensors, texts          ignored, and noted
    field data                       ignored, and noted
    time                             ignored, and noted: the file's one instant is read
    points that are not finite       refused
    cells that refer to no point     refused
    less or more than is claimed     refused
    .vtm, .pvd, .case and others     refused, with what to write in their place
    ===============================  =======================================================

    Raises
    ------
    InputError
        If it is truncated or damaged, one of its parts is missing, or it holds no points.
    """
    from vtkmodules import vtkIOLegacy, vtkIOXML

    pv, suffix = pyvista(), path.suffix.lower()
    if suffix == ".vtk":
        reader = vtkIOLegacy.vtkDataSetReader()
        reader.ReadAllScalarsOn()
        reader.ReadAllFieldsOn()
        if ended := _with_line_end(path.read_bytes()):
            reader.ReadFromInputStringOn()
            reader.SetBinaryInputString(ended, len(ended))
    else:
        parallel = "P" if suffix in PARALLEL else ""
        reader = getattr(vtkIOXML, f"vtkXML{parallel}{DATA_SETS[suffix[-1]]}Reader")()
    reader.SetFileName(f"{path}")
    with raise_vtk_errors():
        reader.Update()
        data = pv.wrap(reader.GetOutput())
    return _source(data, "", _version(pv))


def _with_line_end(content: bytes) -> bytes:
    """A legacy file in ASCII that ends in a number, with the line end that it lacks; else nothing.

    After a number that ends with the file, VTK takes what lies in memory for the numbers that are
    absent, and says nothing.
    """
    if content[-1:].isspace() or not re.match(rb".*\n.*\n\s*ASCII\b", content, re.I):
        return b""
    last = content[-4000:].split()[-33:]
    if len(last) < 9 or len(last[-1]) < min(map(len, last[:-1])):
        raise InputError(
            f"ends with '{last[-1].decode('latin-1')[-40:]}' and without a line end: truncated?"
            " Write or copy it again; if it is whole, end its last line"
        )
    return content + b"\n"


def read_openfoam(path: Path, time_s: float | None, region: str | None = None) -> Source:
    """Read a case of OpenFOAM.

    ===========================  ========================================================
    Feature                      What is done
    ===========================  ========================================================
    reconstructed                heeded
    decomposed, processor0 ...   heeded
    decomposed, processors4      refused (collated): reconstructPar; noted if times are there
    ASCII, binary, compressed    heeded
    times                        heeded: --time, the last by default
    dimensions                   heeded: K, kg/m3; lengths in m
    one region                   heeded
    several regions              heeded: --region, or the only fluid of regionProperties
    volScalarField               heeded: values at cells
    vectors, tensors             ignored, and noted
    patches, particles, sets     ignored
    ===========================  ========================================================

    Parameters
    ----------
    path : Path
        Its folder, or a file in it with the suffix .foam.
    time_s : float, optional
        The wanted time; the last by default.
    region : str, optional
        Of several; the only fluid by default.

    Raises
    ------
    InputError
        If it is no case, the time or the region is not there, or a file is damaged.
    """
    pv = pyvista()
    case = path if path.is_dir() else path.parent
    control = case / "system" / "controlDict"
    if not control.is_file():
        raise InputError("is no OpenFOAM case: there is no system/controlDict in that folder")
    readers = {}
    with raise_vtk_errors(DAMAGED_CASE):
        for kind in ("reconstructed", "decomposed"):
            if kind == "decomposed" and not (case / "processor0").is_dir():
                continue
            reader = pv.POpenFOAMReader(f"{control}")
            reader.case_type = kind
            reader.skip_zero_time = False
            reader.cell_to_point_creation = False
            reader.reader.AddDimensionsToArrayNamesOn()  # "T [K]"
            if hasattr(reader.reader, "SetDecomposePolyhedra"):  # gone from VTK 9.4 on
                reader.decompose_polyhedra = False
            readers[kind] = reader
        times = {
            kind: list(reader.time_values) if reader.reader.GetTimeValues() else []
            for kind, reader in readers.items()
        }
    collated = next(case.glob("processors[0-9]*"), None)
    everything = [t for each in times.values() for t in each]
    if not everything:
        raise InputError(COLLATED if collated else "has no time folders; run the case first")
    wanted = pick_time(everything, time_s)
    kind = next(kind for kind, each in times.items() if wanted in each)
    with raise_vtk_errors(DAMAGED_CASE):
        readers[kind].set_active_time_value(wanted)
        blocks = readers[kind].read()
    regions = [name for name in blocks.keys() if _mesh_of(blocks[name]) is not None]  # noqa: SIM118
    if "internalMesh" in blocks.keys():  # noqa: SIM118, it is not a dict
        if region is not None:
            raise InputError(f"--region {region}: the case has one region; leave --region out")
        mesh, chosen = blocks["internalMesh"], ""
    else:
        region = _region(case, regions, region)
        mesh, chosen = _mesh_of(blocks[region]), f", region {region}"
    read_by = f"{_version(pv)}, OpenFOAM case, {kind}{chosen}, t = {wanted:g} s"
    source = _source(mesh, "m", read_by)
    if collated and not source.variables:
        raise InputError(COLLATED)
    if collated:
        note = f"{collated.name}: OpenFOAM's collated form is not read, only reconstructed times"
        source = replace(source, notes=(*source.notes, note))
    return source


def _mesh_of(block: Any) -> Any:
    """The inner mesh of a region's blocks; None of other blocks."""
    names = block.keys() if isinstance(block, pyvista().MultiBlock) else ()
    return block["internalMesh"] if "internalMesh" in names else None


def _region(case: Path, regions: Sequence[str], wanted: str | None) -> str:
    """The wanted region; by default the only fluid, or the only one."""
    listed = ", ".join(regions) or "none that has a mesh"
    if wanted is not None:
        if wanted not in regions:
            raise InputError(f"--region {wanted}: there is no such region; there are: {listed}")
        return wanted
    properties = case / "constant" / "regionProperties"
    text = properties.read_text("latin-1") if properties.is_file() else ""
    fluid = re.search(r"\bfluid\s*\(([^()]*)\)", re.sub(r"//.*|/\*(?s:.*?)\*/", "", text))
    found = [name for name in (fluid[1].split() if fluid else ()) if name in regions] or regions
    if len(found) != 1:
        raise InputError(
            f"holds {len(regions)} regions, {listed}; name that of the air with --region, such as"
            f" --region {found[0] if found else 'air'}"
        )
    return found[0]


def moved(cells: Any, points: np.ndarray) -> Any:
    """Cells with other coordinates; PyVista's own assignment changes shallow copies along."""
    result = cells.copy(deep=False)
    result.SetPoints(pyvista().vtk_points(np.array(points), force_float=False))
    return result


@contextmanager
def raise_vtk_errors(fatal: str | None = "[Ee]rror|ERROR") -> Iterator[None]:
    """Raise what VTK complains of, in place of its prints, if these words are in it."""
    from vtkmodules.vtkCommonCore import vtkLogger

    verbosity, disabled = vtkLogger.GetCurrentVerbosityCutoff(), logging.root.manager.disable
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    logging.disable(logging.CRITICAL)
    catcher = pyvista().VtkErrorCatcher(raise_errors=False, send_to_logging=False)
    try:
        with catcher:
            yield
        said = [f"{event}" for event in catcher.events]
        bad = [e for e in said if fatal and re.search(fatal, e) and "Pipeline" not in e]
        if bad:
            raise RuntimeError(bad[0])
    except (RuntimeError, OSError, ValueError) as error:
        cause = f"{error}".strip().splitlines()[-1].partition("): ")
        raise InputError(
            f"is truncated or damaged ({cause[2] or cause[0]}); write or copy it again"
        ) from error
    finally:
        vtkLogger.SetStderrVerbosity(verbosity)
        logging.disable(disabled)


def _version(pv: Any) -> str:
    return f"VTK {'.'.join(map(str, pv.vtk_version_info))} through PyVista {pv.__version__}"


def _source(data: Any, length_units: str, reader: str) -> Source:
    """Make a source of a PyVista data set: of its values at points, at cells, or both."""
    pv = pyvista()
    counts = [getattr(data, "n_points", 0), *getattr(data, "dimensions", ())]
    if min(counts) < 1 or not isinstance(data, pv.DataSet):
        raise InputError(
            "holds no points: it is truncated, no grid or mesh, of several blocks, or one of its"
            " parts is missing"
        )
    notes = left_out(data)
    if isinstance(data, (pv.PolyData, pv.UnstructuredGrid)):
        check_mesh(data)
    if isinstance(data, pv.ImageData) and not np.allclose(data.direction_matrix, np.eye(3)):
        data = data.cast_to_structured_grid()
    if isinstance(data, (pv.ImageData, pv.RectilinearGrid)):
        make = _regular
    else:
        if not np.isfinite(np.asarray(data.points)).all():
            raise InputError("the coordinates of its points are not all finite; remove those")
        make = _irregular
    sources = [
        Source(variables, geometry, length_units, reader, notes + more)
        for at_cells in (False, True)
        if scalars(data, at_cells)
        for variables, geometry, more in [make(data, at_cells)]
    ]
    if not sources:
        return Source([], Cloud(np.zeros((0, 3))), length_units, reader, notes)
    return replace(sources[0], at_cells=sources[1] if len(sources) > 1 else None)


def _irregular(data: Any, at_cells: bool) -> _Read:
    """Read cells between points, or points without cells."""
    pv = pyvista()
    shown, notes = _without_blanks(data)
    if shown.n_cells == 0:
        raise InputError("has no cell that is not blanked; write it with its data")
    if set(np.unique(shown.celltypes)) <= {pv.CellType.VERTEX, pv.CellType.POLY_VERTEX}:
        cells, mesh = shown, None
    else:
        cells = shown.clean()  # joins the points that parts share
        cells = moved(cells, np.asarray(cells.points, dtype=np.float64))
        mesh = Mesh(cells, at_cells)
    variables = scalars(cells, at_cells)
    points = cells.cell_centers().points if at_cells else cells.points
    places = np.asarray(points, dtype=np.float64)
    lattice = as_lattice(places)
    if lattice and len(np.unique(lattice[1])) == len(lattice[1]) == lattice[0].size:
        values = [replace(v, values=on_lattice(*lattice, v.values)) for v in variables]
        return values, lattice[0], notes
    return variables, mesh or Cloud(places), notes


def _without_blanks(data: Any) -> tuple[Any, tuple[str, ...]]:
    """The cells, or points without cells, that are shown, and notes on the others."""
    pv = pyvista()
    cells = data.cast_to_unstructured_grid()
    if cells.n_cells == 0:
        if not isinstance(data, pv.PolyData):
            raise InputError("holds no cells; write the cells too, or the points alone as .vtp")
        cells = pv.PolyData(data.points).cast_to_unstructured_grid()
        cells.point_data.update(data.point_data)
    points, whole = blank_points(data), cells.n_cells
    blank = ghosts(cells.cell_data, DUPLICATE | REFINED | HIDDEN_CELL)
    duplicates = ghosts(cells.cell_data, DUPLICATE).sum()
    if points.any():
        with_blanks = with_only(cells, blank=points.astype(float)).point_data_to_cell_data()
        blank |= np.asarray(with_blanks.cell_data["blank"]) > 0.0
    for arrays in (cells.point_data, cells.cell_data):
        if "vtkGhostType" in arrays:
            del arrays["vtkGhostType"]
    if not blank.any():
        return cells, ()
    count = int(blank.sum() - duplicates)
    notes = (f"{count} of {whole} cells are blanked, and hold no data",) if count else ()
    return cells.extract_cells(~blank), notes


def _regular(data: Any, at_cells: bool) -> _Read:
    """Read an image or a rectilinear grid."""
    nodes = (
        [np.asarray(axis, dtype=np.float64) for axis in (data.x, data.y, data.z)]
        if hasattr(data, "x") and not hasattr(data, "spacing")
        else [
            o + s * np.arange(first, last + 1)
            for o, s, first, last in zip(
                data.origin, data.spacing, data.extent[::2], data.extent[1::2], strict=True
            )
        ]
    )
    if [len(axis) for axis in nodes] != list(data.dimensions):
        raise InputError("is damaged: its axes have other lengths than its dimensions say")
    points = blank_points(data).reshape(data.dimensions, order="F")
    shape = np.maximum(np.subtract(data.dimensions, 1), 1)
    cells = ghosts(data.cell_data, REFINED | HIDDEN_CELL)
    cells = (cells if len(cells) else np.zeros(shape.prod(), bool)).reshape(shape, order="F")
    if at_cells:
        nodes = [0.5 * (axis[1:] + axis[:-1]) if len(axis) > 1 else axis for axis in nodes]
        blank = cells | joined_neighbours(points, np.logical_or)
    else:
        shown = np.pad(~cells, [(1, 1) if n > 1 else (0, 0) for n in data.dimensions])
        blank = points | ~joined_neighbours(shown, np.logical_or)
    notes: tuple[str, ...] = ()
    if blank.any():
        what = "cells" if at_cells else "points"
        notes = (f"{blank.sum()} of {blank.size} {what} are blanked, and hold no data",)
    elif cells.any():
        notes = (f"{cells.sum()} blanked cells have no point of their own, and are not heeded",)
    values = []
    for v in scalars(data, at_cells):
        if len(v.values) != blank.size:
            raise InputError(f"is damaged: {len(v.values)} values of '{v}' for {blank.size} places")
        whole = v.values.reshape(blank.shape, order="F")
        if blank.any():
            whole = np.where(blank, np.float32(np.nan), whole)
        values.append(replace(v, values=whole))
    return *ascending(values, nodes), notes
