"""Where methods fail."""

from collections.abc import Callable
from dataclasses import dataclass

Report = Callable[[str, float], None]
"""Gets what is being done, and which fraction of the whole is."""


@dataclass(frozen=True)
class Failure:
    """Where a method first fails, and how it is told.

    Attributes
    ----------
    what : str
        The trouble: "laser's map folds", "steps too long".
    method : str
    first_at : str
        The setting at which it first fails, with its unit; "" if never within what was tried.
    tried : str
        The settings tried, in words.
    status : str
        The status that tells of it, or how the error grows where none can.
    failed, of : int
        How many items failed there, of how many.
    note : str
    """

    what: str
    method: str
    first_at: str
    tried: str
    status: str
    failed: int
    of: int
    note: str = ""
