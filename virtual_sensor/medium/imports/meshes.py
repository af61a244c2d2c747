"""Files of VTK and cases of OpenFOAM, read by VTK through PyVista (an optional extra)."""

from __future__ import annotations

import logging
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.sources import (
    Cloud,
    Grid,
    Mesh,
    Source,
    Variable,
    as_lattice,
    on_lattice,
    split_units,
)
from virtual_sensor.medium.imports.tables import pick_time

SERIAL = (".vti", ".vtk", ".vtp", ".vtr", ".vts", ".vtu")
PARALLEL = (".pvti", ".pvtr", ".pvts", ".pvtu")


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
        raise InputError(
            "needs PyVista, which is not installed; pip install 'virtual-sensor[fields]'"
        ) from error
    return pyvista


def read_vtk(path: Path) -> Source:
    """Read a file of VTK.

    Images and rectilinear grids become a `Grid`, as do meshes whose points, or cells' centres, lie
    on one. Pieces of a parallel file are joined, without their ghost cells.

    Raises
    ------
    InputError
        If it is truncated or damaged, one of its pieces is missing, or it holds no points.
    """
    pv = pyvista()
    with told_by_vtk():
        if path.suffix.lower() == ".pvts":  # PyVista knows no reader of these
            from vtkmodules.vtkIOXML import vtkXMLPStructuredGridReader

            reader = vtkXMLPStructuredGridReader()
            reader.SetFileName(f"{path}")
            reader.Update()
            data = pv.wrap(reader.GetOutput())
        else:
            data = pv.get_reader(f"{path}").read()
    return _source(data, "", _version(pv))


def read_openfoam(path: Path, time_s: float | None) -> Source:
    """Read a case of OpenFOAM, reconstructed or decomposed.

    Parameters
    ----------
    path : Path
        Its folder, or a file in it with the suffix .foam.
    time_s : float, optional
        The wanted time; the last by default.

    Raises
    ------
    InputError
        If it is no case, the time is not there, or a file is damaged.
    """
    pv = pyvista()
    case = path if path.is_dir() else path.parent
    control = case / "system" / "controlDict"
    if not control.is_file():
        raise InputError("is no OpenFOAM case: there is no system/controlDict in that folder")
    readers = {}
    with told_by_vtk():
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
    everything = [t for each in times.values() for t in each]
    if not everything:
        raise InputError("has no time folders; run the case first")
    wanted = pick_time(everything, time_s)
    kind = next(kind for kind, each in times.items() if wanted in each)
    with told_by_vtk():
        readers[kind].set_active_time_value(wanted)
        blocks = readers[kind].read()
    if "internalMesh" not in blocks.keys():  # noqa: SIM118, it is not a dict
        raise InputError(
            f"has no single mesh but {', '.join(map(str, blocks.keys()))}; write the region of the "
            "air with `foamToVTK -region NAME` and import its .vtu file"
        )
    told = f"{_version(pv)}, OpenFOAM case, {kind}, t = {wanted:g} s"
    return _source(blocks["internalMesh"], "m", told)


def moved(cells: Any, points: np.ndarray) -> Any:
    """Cells with other coordinates; PyVista's own assignment changes shallow copies along."""
    result = cells.copy(deep=False)
    result.SetPoints(pyvista().vtk_points(np.array(points), force_float=False))
    return result


@contextmanager
def told_by_vtk(fatal: bool = True) -> Iterator[None]:
    """Raise what VTK complains of, if that is fatal, in place of its prints."""
    from vtkmodules.vtkCommonCore import vtkLogger

    verbosity, disabled = vtkLogger.GetCurrentVerbosityCutoff(), logging.root.manager.disable
    vtkLogger.SetStderrVerbosity(vtkLogger.VERBOSITY_OFF)
    logging.disable(logging.CRITICAL)
    catcher = pyvista().VtkErrorCatcher(raise_errors=False, send_to_logging=False)
    try:
        with catcher:
            yield
        bad = [f"{e}" for e in catcher.events if "rror" in f"{e}"]
        if bad and fatal:
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
    """Make a source of a PyVista data set."""
    pv = pyvista()
    if getattr(data, "n_points", 0) == 0 or not isinstance(data, pv.DataSet):
        raise InputError(
            "holds no points: it is truncated, of several blocks, or one of its pieces is missing"
        )
    if isinstance(data, pv.ImageData) and not np.allclose(data.direction_matrix, np.eye(3)):
        data = data.cast_to_structured_grid()
    regular = isinstance(data, (pv.ImageData, pv.RectilinearGrid))
    at_cells = not _scalars(data.point_data) and bool(_scalars(data.cell_data))
    if regular:
        return _regular(data, at_cells, length_units, reader)
    if isinstance(data, pv.PolyData) and not at_cells and data.n_cells <= data.n_verts:
        cells, geometry = data, None
    else:
        cells = data.cast_to_unstructured_grid()
        if "vtkGhostType" in cells.cell_data:
            cells = cells.extract_cells(np.asarray(cells.cell_data["vtkGhostType"]) == 0)
        cells = cells.clean()  # joins the points that pieces share
        cells = moved(cells, np.asarray(cells.points, dtype=np.float64))
        geometry = Mesh(cells, at_cells)
    variables = _scalars(cells.cell_data if at_cells else cells.point_data)
    places = cells.cell_centers().points if at_cells else cells.points
    places = np.asarray(places, dtype=np.float64)
    lattice = as_lattice(places)
    if lattice and len(lattice[1]) == np.prod([len(a) for a in lattice[0].axes]):
        values = [Variable(v.name, v.units, on_lattice(*lattice, v.values)) for v in variables]
        return Source(values, lattice[0], length_units, reader)
    return Source(variables, geometry or Cloud(places), length_units, reader)


def _regular(data: Any, at_cells: bool, length_units: str, reader: str) -> Source:
    """Make a source of an image or of a rectilinear grid."""
    nodes = (
        [np.asarray(axis, dtype=np.float64) for axis in (data.x, data.y, data.z)]
        if hasattr(data, "x") and not hasattr(data, "spacing")
        else [
            o + s * np.arange(n)
            for o, s, n in zip(data.origin, data.spacing, data.dimensions, strict=True)
        ]
    )
    if at_cells:
        nodes = [0.5 * (axis[1:] + axis[:-1]) if len(axis) > 1 else axis for axis in nodes]
    shape = [len(axis) for axis in nodes]
    found = _scalars(data.cell_data if at_cells else data.point_data)
    values = [Variable(v.name, v.units, v.values.reshape(shape, order="F")) for v in found]
    return Source(values, Grid((nodes[0], nodes[1], nodes[2])), length_units, reader)


def _scalars(data: Any) -> list[Variable]:
    """The real scalars among a data set's arrays."""
    return [
        Variable(*split_units(name), np.asarray(array))
        for name, array in data.items()
        if array.ndim == 1 and array.dtype.kind in "fiu" and not name.startswith("vtk")
    ]
