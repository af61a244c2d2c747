"""Settings and scenes: the paper's cylinder in any air, temperature and pose."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np

from virtual_sensor.display import Displayed
from virtual_sensor.imaging.scene import Scene, load_scene, scene_files, scene_parameters
from virtual_sensor.imaging.scene_file import find_scene
from virtual_sensor.medium.broadening import blurred, widened
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.eikonal import March
from virtual_sensor.studies.finished_cases import file_hash

SCENE = "hot_cylinder"
AIRS = RESOLVED, BLURRED, WIDENED = "resolved", "blurred", "widened"
"""As simulated; smeared by a Gaussian; stretched across the plume, and then smeared."""
TEMPERATURES_C = (900.0, 1100.0, 1250.0)
BETAS_DEG = (0.0, 15.0, 30.0)

NINE_RAYS_MM = np.linspace(0.0, -10.0, 9)
"""The paper's laser rays: positions y along the line."""
NINE_DOTS = ",".join(f"{y:g}" for y in NINE_RAYS_MM)
"""The same as dots of the laser."""
DOT_RADIUS_MM = 0.04
"""Small, since a Gaussian dot's centroid shifts with the square of its radius."""
LINE_MM = np.linspace(-11.0, 11.0, 45)
"""Rays of the whole line."""
ALL_BETAS_DEG = np.linspace(0.0, 90.0, 31)
"""Poses from above to the side, which the paper has three of."""

SCAN = March(step_mm=0.5, method="leapfrog", precision="double")
"""The march of whole lines, maps and scans: good to 1e-4 px."""


@dataclass(frozen=True, order=True)
class Setting(Displayed):
    """What laser rays were followed in.

    Attributes
    ----------
    air : str
        RESOLVED, BLURRED or WIDENED.
    temperature_c : float
        Of the cylinder, degC.
    beta_deg : float
        Turn of the sensor round the cylinder's axis.
    """

    air: str
    temperature_c: float = TEMPERATURES_C[-1]
    beta_deg: float = 0.0

    @property
    def name(self) -> str:
        """Of its files."""
        return f"{self.air}_{self.temperature_c:g}C_beta{self.beta_deg:g}"

    def __str__(self) -> str:
        return f"{self.air}, {self.temperature_c:g} °C, β = {self.beta_deg:g}°"


def settings(air: str) -> list[Setting]:
    """The paper's three temperatures in three poses."""
    return [Setting(air, t, b) for t in TEMPERATURES_C for b in BETAS_DEG]


@dataclass(frozen=True)
class Broadening(Displayed):
    """How the air is broadened: stretched across by a factor, then smeared by a Gaussian, mm."""

    blur_mm: float = 0.0
    widen: float = 1.0

    def applied(self, air: IndexField) -> IndexField:
        """The air, so broadened."""
        return blurred(widened(air, self.widen), self.blur_mm)

    def parameters(self) -> dict[str, str]:
        """The scene's parameters for it; none where it does nothing."""
        named = {"blur": (self.blur_mm, 0.0), "widen": (self.widen, 1.0)}
        return {name: f"{value:g}" for name, (value, none) in named.items() if value != none}

    def __str__(self) -> str:
        """In words."""
        words = [f"widened {self.widen:g} times"] if self.widen != 1.0 else []
        words += [f"blurred by {self.blur_mm:g} mm"] if self.blur_mm else []
        return " and ".join(words) or "as simulated"


@dataclass
class Scenes:
    """Loads scenes, and each field once.

    Attributes
    ----------
    given : mapping
        Parameters that the user set, for all scenes.
    """

    given: Mapping[str, str]
    _fields: dict[tuple[float, Broadening], IndexField] = field(default_factory=dict)
    _poses: dict[float, Scene] = field(default_factory=dict)

    def scene(self, temperature_c: float, beta_deg: float, broadening: Broadening) -> Scene:
        """The cylinder of a temperature, seen from a pose through an air."""
        return self.pose(beta_deg).with_medium(self.air(temperature_c, broadening))

    def pose(self, beta_deg: float) -> Scene:
        """The cylinder seen from a pose, without air: no field is read for it."""
        if beta_deg not in self._poses:
            asked = {"beta": f"{beta_deg:g}", "field": ""}
            self._poses[beta_deg] = load_scene(SCENE, **dict(self.given) | asked)
        return self._poses[beta_deg]

    def air(self, temperature_c: float, broadening: Broadening) -> IndexField:
        """The field of a temperature, broadened."""
        key = temperature_c, broadening
        if key not in self._fields:
            if broadening == Broadening():
                asked = {"temperature": f"{temperature_c:g}"}
                loaded = load_scene(SCENE, **dict(self.given) | asked)
                assert loaded.field is not None
                self._fields[key] = loaded.field
            else:
                self._fields[key] = broadening.applied(self.air(temperature_c, Broadening()))
        return self._fields[key]

    def inputs(self) -> dict[str, Any]:
        """What all of these scenes depend on: the key of what is found in them."""
        path = find_scene(SCENE)
        given = [dict(self.given) | {"temperature": f"{t:g}"} for t in TEMPERATURES_C]
        values = [scene_parameters(path, each) for each in given]
        files = {file for each in values for file in scene_files(path, each)}
        return {
            "file": file_hash(path),
            "parameters": values,
            "files": sorted(file_hash(file) for file in files),
        }

    def forget(self, broadening: Broadening) -> None:
        """Let go of fields that were only tried."""
        for key in [key for key in self._fields if key[1] == broadening]:
            del self._fields[key]
