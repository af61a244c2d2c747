"""Where a scene's air comes from: a field's file, and what is made of it."""

from __future__ import annotations

import threading
import weakref
from collections.abc import Hashable
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from virtual_sensor.arrays import number_within
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, naming
from virtual_sensor.medium.broadening import blurred, widened
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.medium.units import LEAST_PA, MOST_PA, PRESSURES
from virtual_sensor.poses import Pose

_LOCK = threading.Lock()
_READ: weakref.WeakValueDictionary[Hashable, IndexField] = weakref.WeakValueDictionary()
_LAST: list[IndexField] = []  # one, held for who loads scenes one after the other


@dataclass(frozen=True)
class MediumDescription(Displayed):
    """Which air a field's file stands for.

    Attributes
    ----------
    path : Path or None
        NetCDF file of the field; None: no file, and homogeneous air.
    time_s : float or None
        Flow time in a file with a time axis; None: its last instant.
    widen : float
        Factor by which the field is stretched along y.
    blur_mm : float
        Then: standard deviation of a Gaussian blur in y and z; 0: none.
    wavelength_nm : float
        Vacuum wavelength of the light.
    interpolation : str
        Between the nodes: "cubic" or "linear".
    dimensions : int
        3, or 2: the section x = 0, extruded along x.
    pressure_pa : float or None
        Of the air, which n - 1 goes with while the flow stays; None: the file's.
    pose : Pose or None
        Then: where all this is moved; None: it stays where the file has it.

    Raises
    ------
    InputError
        If the wavelength is no positive number, or a property of the field is given without one.
    """

    path: Path | None = None
    time_s: float | None = None
    widen: float = 1.0
    blur_mm: float = 0.0
    wavelength_nm: float = 532.0
    interpolation: str = "cubic"
    dimensions: int = 3
    pressure_pa: float | None = None
    pose: Pose | None = None

    def __post_init__(self) -> None:
        if not 0.0 < self.wavelength_nm < np.inf:
            raise InputError(
                f"'wavelength' must be a positive number of nm, not {self.wavelength_nm:g}"
            )
        if self.path is None and self.time_s is not None:
            raise InputError("'time' is one of a field's; give the 'field', or no time")
        if self.path is None and (self.widen, self.blur_mm) != (1.0, 0.0):
            raise InputError("'widen' and 'blur' are of a field; give the 'field', or neither")
        if self.path is None and self.pressure_pa is not None:
            raise InputError("'pressure' is that of a field's air; give the 'field', or neither")
        if self.pressure_pa is not None:
            number_within("'pressure'", self.pressure_pa, LEAST_PA, MOST_PA, PRESSURES)
        if self.path is None and self.pose is not None:
            raise InputError("'to_world' moves a field; give the 'field', or none of both")

    def _line(self) -> str:
        if self.path is None:
            return "homogeneous"
        widen = f"widened {self.widen:g} times" if self.widen != 1.0 else ""
        blur = f"blurred by {self.blur_mm:g} mm" if self.blur_mm else ""
        time = f"at {self.time_s:g} s" if self.time_s is not None else ""
        grid = "" if self.interpolation == "cubic" else self.interpolation
        flat = "" if self.dimensions == 3 else "its section x = 0"
        pressure = f"at {self.pressure_pa:g} Pa" if self.pressure_pa is not None else ""
        moved = "moved" if self.pose else ""
        light = f"for {self.wavelength_nm:g} nm"
        return listed(self.path.name, time, widen, blur, pressure, grid, flat, moved, light)

    def read(self) -> IndexField | None:
        """Read the field; None of homogeneous air.

        Scenes of the same air share one field, and with it what was made of it: it is read again
        when its file has changed.

        Raises
        ------
        InputError
            If the file can't be used, or the field not be broadened, simplified or moved so.
        """
        if self.path is None:
            return None
        try:
            stat = self.path.stat()
        except OSError:  # reading it says why
            return self._read(self.path)
        key = self, stat.st_ino, stat.st_size, stat.st_mtime_ns
        with _LOCK:
            field = _READ.get(key)
            if field is None:
                _READ[key] = field = self._read(self.path)
            _LAST[:] = [field]
        return field

    def _read(self, path: Path) -> IndexField:
        air = IndexField.read(path, wavelength_nm=self.wavelength_nm, time_s=self.time_s)
        with naming(path):
            broad = blurred(widened(air, self.widen), self.blur_mm)
            if self.pressure_pa is not None:
                broad = broad.at_pressure(self.pressure_pa)
            simple = broad.simplified(self.interpolation, self.dimensions)
            placed = simple if self.pose is None else simple.moved(self.pose)
        return replace(placed, notes=air.notes)

    def at(self, time_s: float) -> MediumDescription:
        """The same of another instant, s, of the file.

        Raises
        ------
        InputError
            If there is no file.
        """
        if self.path is None:
            raise InputError("there is no 'field' to have instants; give it one")
        return replace(self, time_s=time_s)

    def without_file(self) -> MediumDescription:
        """The same wavelength, for air that comes from no file."""
        return MediumDescription(wavelength_nm=self.wavelength_nm)
