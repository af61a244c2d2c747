"""A field's file by its path, or by the name of one that comes with the program."""

import re
from collections.abc import Iterable
from importlib import resources
from pathlib import Path

from virtual_sensor.files import named_file

FIELDS = "fields"
"""Folder of fields, beside scenes: it may be left out of a field's name."""


def find_field(name: str | Path, folders: Iterable[Path] = (Path(),)) -> Path:
    """Find a field's file.

    The first that there is of `name`, then of `name` with .nc: in each of the folders and in
    `fields` beside it, and then among the fields that come with the program. So a file of one's own
    comes before a shipped one.

    Parameters
    ----------
    name : str or Path
        A path, or a name such as "hot_cylinder_1250C_quarter".
    folders : iterable of Path
        From which a relative path starts; by default the one where the program runs.

    Raises
    ------
    InputError
        If there is none: it names the places that were looked in, the fields that there are, and
        the one of the nearest name.
    """
    installed = _installed()
    places = [place for folder in folders for place in (folder, folder / FIELDS)]
    return named_file(
        name,
        "field",
        ".nc",
        places,
        [installed, installed / FIELDS],
        f"{_temperatures(name)}virtual-sensor field simulate makes one of another part or"
        " temperature, and field import one of another solver's results",
    )


def _temperatures(name: str | Path) -> str:
    """Of a heated cylinder: the temperatures of which there is a field; else ""."""
    cylinders = re.compile(r"hot_cylinder_(\d+)C")
    if not cylinders.match(Path(f"{name}").name):
        return ""
    stems = [file.stem for file in (_installed() / FIELDS).glob("*.nc")]
    known = sorted(int(found[1]) for stem in stems if (found := cylinders.match(stem)))
    return f"temperatures with a field: {', '.join(map(str, known))}; "


def is_installed(path: Path) -> bool:
    """Whether a file or a folder is among those of the scenes that come with the program."""
    return path.resolve().is_relative_to(_installed().resolve())


def _installed() -> Path:
    return Path(str(resources.files("virtual_sensor_scenes")))
