"""Figures as people read them, and (until its last user is gone) what `records` has now."""

import numpy as np

from virtual_sensor.records import (
    status_names,
    vectors,
    write_csv,
    write_json,
    write_ply,
)

__all__ = ["in_words", "status_names", "vectors", "write_csv", "write_json", "write_ply"]


def in_words(value: float | None, shape: str = "{:.4f}") -> str:
    """A figure as people read it; "none" where there is no answer."""
    return "none" if value is None or np.isnan(value) else shape.format(value)
