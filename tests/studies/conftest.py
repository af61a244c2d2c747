"""What studies find is no matter of pictures: tests/reporting looks at those."""

import pytest


@pytest.fixture(scope="module", autouse=True)
def _unpainted(unpainted):
    """Nothing is painted."""
