"""The air that a scene may have: its own, and what its neighbours in the folder make of it."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.medium.air_model import AirModel
from virtual_sensor.medium.field_family import FieldFamily
from virtual_sensor.medium.index_field import IndexField


def air_model_of(scene: Scene) -> AirModel:
    """The scene's air with free parameters; at their defaults it is `scene.medium` itself.

    A scene whose field's file is named by its parameter `temperature` has a family: all files
    beside that one whose names differ by the temperature alone, if they have its grid and
    surroundings. What the scene makes of its air (widen, blur, to_world ...) is made of them all.

    Raises
    ------
    InputError
        If light runs straight in the scene.
    """
    medium = scene.medium
    if medium is None:
        raise InputError(
            f"{scene.path}: light runs straight in it, so that there is no air to vary; give the"
            " scene a field (-D field=..., or scene.with_medium)"
        )
    fields: dict[float, IndexField] = {}
    for temperature_c, path in _neighbours(scene):
        if path == scene.air.path:
            fields[temperature_c] = medium
            continue
        with suppress(InputError):  # of a file of another kind, which is no relative
            relative = replace(scene.air, path=path).read()
            if relative is not None:
                FieldFamily({0.0: medium, 1.0: relative})
                fields[temperature_c] = relative
    if len(fields) < 2:
        return AirModel.of(medium)
    own = float(scene.parameters["temperature"])
    return AirModel.of(dict(sorted(fields.items())), temperature_c=own)


def _neighbours(scene: Scene) -> Iterator[tuple[float, Path]]:
    """Wall temperatures, degC, and files whose names differ from that of the scene's by them."""
    path, own = scene.air.path, scene.parameters.get("temperature", "")
    if path is None or not own:
        return
    before, found, after = path.name.rpartition(own)
    number = r"(?<![\d.])(\d+(?:\.\d+)?)(?![\d.]*\d)"
    if not found or not re.fullmatch(number, own):
        return
    alike = re.compile(f"{re.escape(before)}{number}{re.escape(after)}")
    for each in sorted(path.parent.iterdir()):
        if match := alike.fullmatch(each.name):
            yield float(match[1]), each
