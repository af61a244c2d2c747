"""Files of other solvers: which reader reads which."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path

from virtual_sensor.errors import InputError
from virtual_sensor.medium.imports.comsol import read_comsol
from virtual_sensor.medium.imports.meshes import PARALLEL, SERIAL, read_openfoam, read_vtk
from virtual_sensor.medium.imports.sources import Source
from virtual_sensor.medium.imports.tables import read_csv, read_numpy

KNOWN = (
    "an OpenFOAM case's folder or .foam file; VTK's .vti .vtk .vtp .vtr .vts .vtu and .pvti .pvtr "
    ".pvts .pvtu; a COMSOL text export .txt or .csv; .csv; NumPy's .npy and .npz"
)
"""What can be read, in words."""

_TEXT = (".csv", ".txt", ".dat", ".tsv")
_BLOCKS = "holds several blocks; join them in ParaView (Merge Blocks) and save a .vtu"
_CONVERT = "open it in ParaView and save the air's data as .vtu or .vti"
_REMEDIES = {
    **dict.fromkeys((".vtm", ".vtmb", ".vthb", ".vtmg"), _BLOCKS),
    ".pvd": "lists a file for each time; import the one of your time",
    ".series": "lists a file for each time; import the one of your time",
    **dict.fromkeys((".case", ".encas", ".cgns", ".exo", ".e", ".xdmf", ".xmf", ".msh"), _CONVERT),
    **dict.fromkeys((".vtkhdf", ".hdf", ".h5", ".plt", ".tec", ".cas", ".mph"), _CONVERT),
    ".nc": "is NetCDF: if it is a field file already, use it as it is, `-D field=FILE`; if not, "
    "write its arrays as .npz of x, y, z and the quantity",
    ".mat": "load it with SciPy's loadmat and save x, y, z and the quantity as .npz",
    **dict.fromkeys((".xlsx", ".xls", ".ods"), "save the sheet as .csv"),
}


def read_source(
    path: str | Path,
    time_s: float | None = None,
    spacing_mm: Sequence[float] | None = None,
    region: str | None = None,
) -> Source:
    """Read another solver's file.

    Parameters
    ----------
    path : str or Path
        The file or folder; its suffix says what it is, and of text a % at its beginning.
    time_s : float, optional
        Which of several times, s; the last by default.
    spacing_mm : sequence of three float, optional
        Distance of nodes, for a plain NumPy array.
    region : str, optional
        Of an OpenFOAM case of several.

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
        return read_openfoam(path, time_s, region)
    if not path.is_file():
        raise InputError("is a pipe or a device; give a regular file")
    if suffix in _REMEDIES:
        raise InputError(_REMEDIES[suffix])
    if suffix not in (*SERIAL, *PARALLEL, *_TEXT, ".npy", ".npz"):
        raise InputError(f"what is '{suffix}'? Known are: {KNOWN}")
    if region is not None:
        raise InputError(f"--region {region}: only an OpenFOAM case has regions; leave it out")
    if suffix in _TEXT:
        with path.open("rb") as file:
            comsol = re.match(rb'[\xef\xbb\xbf\s"]*%', file.readline())
        return (read_comsol if comsol else read_csv)(path, time_s)
    if time_s is not None:
        raise InputError("holds one time; leave --time out")
    return read_vtk(path) if suffix in (*SERIAL, *PARALLEL) else read_numpy(path, spacing_mm)
