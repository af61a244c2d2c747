"""Files of other solvers: which reader reads which."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.meshes import PARALLEL, SERIAL, read_openfoam, read_vtk
from virtual_sensor.medium.imports.sources import Source
from virtual_sensor.medium.imports.tables import read_comsol, read_csv, read_numpy

KNOWN = (
    "an OpenFOAM case's folder or .foam file; VTK's .vti .vtk .vtp .vtr .vts .vtu and .pvti .pvtr "
    ".pvts .pvtu; a COMSOL text export .txt; .csv; NumPy's .npy and .npz"
)
"""What can be read, in words."""


def read_source(
    path: str | Path, time_s: float | None = None, spacing_mm: Sequence[float] | None = None
) -> Source:
    """Read another solver's file.

    Parameters
    ----------
    path : str or Path
        The file or folder; its suffix tells what it is, and of text a % at its beginning.
    time_s : float, optional
        Which of several times, s; the last by default.
    spacing_mm : sequence of three float, optional
        Distance of nodes, for a plain NumPy array.

    Raises
    ------
    InputError
        If it is missing, damaged, of unknown kind, or the optional reader is not installed.
    """
    path = Path(path)
    suffix = path.suffix.lower()
    if not path.exists():
        raise InputError("there is no such file or folder")
    if path.is_dir() or suffix == ".foam":
        return read_openfoam(path, time_s)
    if suffix in (".csv", ".txt", ".dat", ".tsv"):
        with path.open("rb") as file:
            comsol = file.readline().lstrip(b"\xef\xbb\xbf").startswith(b"%")
        return (read_comsol if comsol else read_csv)(path, time_s)
    if suffix not in (*SERIAL, *PARALLEL, ".npy", ".npz"):
        raise InputError(f"what is '{suffix}'? Known are: {KNOWN}")
    if time_s is not None:
        raise InputError("holds one time; leave --time out")
    return read_vtk(path) if suffix in (*SERIAL, *PARALLEL) else read_numpy(path, spacing_mm)
