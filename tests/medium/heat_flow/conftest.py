"""Where OpenFOAM is absent, the tests that need it are skipped, with what is missing as reason."""

import pytest

from virtual_sensor.errors import InputError
from virtual_sensor.medium.heat_flow.openfoam import find_openfoam


@pytest.fixture(scope="session")
def openfoam():
    """OpenFOAM, on one process."""
    return _found(parallel=False)


@pytest.fixture(scope="session")
def parallel_openfoam():
    """OpenFOAM, with mpirun."""
    return _found(parallel=True)


def _found(parallel):
    try:
        return find_openfoam(parallel)
    except InputError as error:
        pytest.skip(f"{error}")
