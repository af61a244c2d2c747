"""Fields of other solvers: the linear temperature of `fields`, by PyVista, NumPy and as text."""

from __future__ import annotations

import functools
import io
import re
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from hostile.fields import kelvin

X, Y, Z = np.linspace(-12, 12, 5), np.linspace(-15, 15, 6), np.linspace(0, 24, 7)
NODES = np.stack(np.meshgrid(X, Y, Z, indexing="ij"), axis=-1)
VALUES = kelvin(*np.moveaxis(NODES, -1, 0))
KELVIN_MM = {"units": "K", "length_units": "mm"}
NEAR_K = 0.01
HALF_CELL_K = 25.0  # what a cell's value differs from its corners'


@dataclass(frozen=True)
class Written:
    """A whole file, or a folder of them.

    Attributes
    ----------
    files : dict
    main : str
    options : dict
    near : float
        K by which a result may differ.
    ascii : bool
    sealed : tuple of pair of int
        Bytes that a checksum guards.
    ends_in_a_number : bool
        Whether the file ends in a number, which may lose its last digits.
    plain : bool
        Whether it must be read.
    """

    files: dict[str, bytes]
    main: str
    options: dict[str, Any]
    label: str
    near: float = NEAR_K
    ascii: bool = False
    sealed: tuple[tuple[int, int], ...] = ()
    ends_in_a_number: bool = False
    plain: bool = True

    @property
    def data(self) -> bytes:
        """What is read."""
        return self.files[self.main]

    def spoilt(self, data: bytes) -> dict[str, bytes]:
        """The files with other contents of the main one."""
        return self.files | {self.main: data}


def _saved(data: Any, name: str, **options: Any) -> bytes:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        data.save(str(path), **options)
        return path.read_bytes()


def _written_by(writer: Any, data: Any, name: str, mode: str) -> bytes:
    """By one of VTK's XML writers: ASCII, binary in the text, or appended; compressed or not."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / name
        writer.SetFileName(str(path))
        writer.SetInputData(data)
        if mode == "ascii":
            writer.SetDataModeToAscii()
        elif mode.startswith("binary"):
            writer.SetDataModeToBinary()
        else:
            writer.SetDataModeToAppended()
            writer.EncodeAppendedDataOff()
        if not mode.endswith("zip"):
            writer.SetCompressorTypeToNone()
        writer.Write()
        return path.read_bytes()


MODES = ("ascii", "binary", "binary zip", "raw", "raw zip")
SHAPES = ("vti", "vtr", "vts", "vtu", "vtp", "vtk image", "vtk mesh", "vtk grid", "vtk points")


@functools.cache
def _data(shape: str, at: str) -> Any:
    """A data set of PyVista."""
    import pyvista as pv

    if shape in ("vti", "vtk image"):
        spacing = (X[1] - X[0], Y[1] - Y[0], Z[1] - Z[0])
        made = pv.ImageData(dimensions=VALUES.shape, spacing=spacing, origin=(X[0], Y[0], Z[0]))
    elif shape in ("vtr", "vtk grid"):
        made = pv.RectilinearGrid(X, Y, Z)
    elif shape in ("vtp", "vtk points"):
        made = pv.PolyData(NODES.reshape(-1, 3))
    else:
        made = pv.StructuredGrid(*np.moveaxis(NODES, -1, 0).copy())
        if shape != "vts":
            made = made.cast_to_unstructured_grid()
    if at == "cells":
        made.cell_data["T"] = kelvin(*made.cell_centers().points.T)
    else:
        made.point_data["T"] = kelvin(*np.asarray(made.points, float).T)
    return made


@functools.cache
def vtk(shape: str, mode: str, at: str) -> Written:
    """A file of VTK."""
    from vtkmodules import vtkIOXML

    data, near = _data(shape, at), NEAR_K if at == "points" else HALF_CELL_K
    label = f"{shape} {mode} {at}"
    if shape.startswith("vtk"):
        made = _saved(data, "air.vtk", binary=mode != "ascii")
        plain = shape != "vtk points"
        text = mode == "ascii"
        return Written(
            {"air.vtk": made}, "air.vtk", KELVIN_MM, label, near, text, (), text, plain=plain
        )
    writers = {
        "vti": "vtkXMLImageDataWriter",
        "vtr": "vtkXMLRectilinearGridWriter",
        "vts": "vtkXMLStructuredGridWriter",
        "vtu": "vtkXMLUnstructuredGridWriter",
        "vtp": "vtkXMLPolyDataWriter",
    }
    name = f"air.{shape}"
    made = _written_by(getattr(vtkIOXML, writers[shape])(), data, name, mode)
    sealed = ()
    if mode == "raw zip":
        sealed = ((made.index(b"_", made.index(b"<AppendedData")) + 1, made.rindex(b"</Appended")),)
    plain = shape != "vtp"
    return Written({name: made}, name, KELVIN_MM, label, near, mode == "ascii", sealed, plain=plain)


def _rows(points, values, mark=",", digits="%.12g"):
    file = io.StringIO()
    np.savetxt(file, np.column_stack([points, values]), digits, mark)
    return file.getvalue()


def table(header: str, mark: str, degrees: bool, ordered: bool) -> Written:
    """A CSV file."""
    points, values = NODES.reshape(-1, 3), VALUES.ravel() - (273.15 if degrees else 0.0)
    if not ordered:
        order = np.random.default_rng(0).permutation(len(points))
        points, values = points[order], values[order]
    units = "degC" if degrees else "K"
    text = header.replace("K", units).replace(",", mark) + "\n" + _rows(points, values, mark)
    options = {} if "[mm]" in header else {"units": units, "length_units": "mm"}
    return Written(
        {"air.csv": text.encode()}, "air.csv", options, "csv", ascii=True, ends_in_a_number=True
    )


def comsol(form: str) -> Written:
    """A text export of COMSOL."""
    points, values = NODES.reshape(-1, 3), VALUES.ravel()
    marks = "% Model:              air.mph\n% Version:            COMSOL 6.2.0.415\n"
    marks += f"% Dimension:          3\n% Nodes:              {len(points)}\n"
    marks += "% Expressions:        1\n% Description:        Temperature\n"
    marks += "% Length unit:        mm\n"
    if form == "grid":
        text = "% Version:            COMSOL 6.2.0.415\n% Length unit:        mm\n% Grid\n"
        text += "".join(" ".join(map(repr, axis.tolist())) + "\n" for axis in (X, Y, Z))
        text += "% Data\n% T (K)\n"
        rows = VALUES.transpose(2, 1, 0).reshape(-1, len(X))
        text += "".join(" ".join(map(repr, row.tolist())) + "\n" for row in rows)
    elif form == "csv":
        marks = re.sub(r": +", ",", marks)
        text = marks + "% x,y,z,T (K)\n" + _rows(points, values)
    elif form == "sweep":
        head = "% X                       Y                        Z                        "
        head += "T (K) @ t=0 T (K) @ t=1\n"
        text = marks.replace("ns:        1", "ns:        2") + head
        text += _rows(points, np.column_stack([values - 20.0, values]), "  ")
    else:
        head = "% x                       y                        z                        "
        text = marks + head + "T (K) @ t=0.5\n" + _rows(points, values, "   ")
    name = "air.csv" if form == "csv" else "air.txt"
    plain = form not in ("csv", "sweep")
    return Written({name: text.encode()}, name, {}, f"comsol {form}", NEAR_K, True, (), True, plain)


def numpy_file(form: str) -> Written:
    """An .npy or .npz file."""
    file = io.BytesIO()
    points, values = NODES.reshape(-1, 3), VALUES.ravel()
    options: dict[str, Any] = dict(KELVIN_MM)
    name = "air.npz"
    if form == "axes":
        np.savez(file, x=X, y=Y, z=Z, T=VALUES)
    elif form == "packed":
        np.savez_compressed(file, x=X, y=Y, z=Z, T=VALUES.astype(np.float32))
    elif form == "points":
        np.savez(file, x=points[:, 0], y=points[:, 1], z=points[:, 2], T=values)
    elif form == "records":
        names = [(n, float) for n in ("x", "y", "z", "T")]
        np.save(file, np.array([(*p, v) for p, v in zip(points, values, strict=True)], names))
        name = "air.npy"
    else:
        np.save(file, VALUES)
        name = "air.npy"
        spacing = (X[1] - X[0], Y[1] - Y[0], Z[1] - Z[0])
        options = {"quantity": "temperature", "units": "K", "spacing_mm": spacing}
        options["origin_mm"] = (-X[0], -Y[0], -Z[0])
    data = file.getvalue()
    sealed = ((0, len(data)),) if name.endswith(".npz") else ()
    return Written({name: data}, name, options, f"numpy {form}", sealed=sealed)


@functools.cache
def openfoam() -> Written:
    """A case of OpenFOAM, its field in ASCII."""
    from plume_files import write_openfoam

    with tempfile.TemporaryDirectory() as place:
        folder = Path(place) / "case"
        write_openfoam(folder, NODES)
        files = {
            str(p.relative_to(place)): p.read_bytes() for p in folder.rglob("*") if p.is_file()
        }
    centres = 0.125 * sum(
        NODES[i : i - 1 or None, j : j - 1 or None, k : k - 1 or None].reshape(-1, 3)
        for i, j, k in np.ndindex(2, 2, 2)
    )
    values = "\n".join(f"{v:.12g}" for v in kelvin(*centres.T))
    head = files["case/0.5/T"].partition(b"dimensions")[0].decode()
    text = f"{head}dimensions [0 0 0 1 0 0 0];\ninternalField nonuniform List<scalar>\n"
    text += f"{len(centres)}\n(\n{values}\n)\n;\n"
    text += "boundaryField { border { type zeroGradient; } }\n"
    files["case/0.5/T"] = text.encode()
    return Written(files, "case/0.5/T", {}, "openfoam", HALF_CELL_K, ascii=True)
