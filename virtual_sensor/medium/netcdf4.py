"""What NetCDF-4 and CDF-5 files hold, by the package netCDF4; runs in a child process."""

from __future__ import annotations

import netCDF4
import numpy as np

from virtual_sensor.errors import InputError, cause_of
from virtual_sensor.medium.netcdf_elements import AXES, Contents, Variable
from virtual_sensor.medium.quantities import UNITS

_WANTED = {*AXES, *UNITS, "time", "solid"}


def read(path: str) -> Contents:
    """Read a file's attributes and variables; numbers only of those that make a field.

    Raises
    ------
    InputError
        If it is damaged.
    """
    try:
        with netCDF4.Dataset(path) as file:
            file.set_auto_maskandscale(False)
            return Contents(
                {name: _variable(name, variable) for name, variable in file.variables.items()},
                _attributes(file),
            )
    except MemoryError:
        raise
    except Exception as error:  # as the damage will have it
        raise InputError(f"is truncated or damaged ({cause_of(error)}); copy it again") from error


def _variable(name: str, variable: netCDF4.Variable) -> Variable:
    attributes = _attributes(variable)
    wanted = name in _WANTED or attributes.get("fill_value_means") == "solid"
    data = np.asarray(variable[...]) if wanted else np.empty(0)
    return Variable(variable.dimensions, data, attributes)


def _attributes(owner: netCDF4.Dataset | netCDF4.Variable) -> dict[str, object]:
    return {name: owner.getncattr(name) for name in owner.ncattrs()}
