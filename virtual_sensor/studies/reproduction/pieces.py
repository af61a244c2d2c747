"""What the reproduction searches, kept: the fits, all nine rays, whole lines, maps of all poses."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Any, TypeVar

import numpy as np

from virtual_sensor.studies.finished_cases import find_or_make
from virtual_sensor.studies.measure import Report
from virtual_sensor.studies.reproduction.beta_map import LINE_MM, BetaMap, beta_map
from virtual_sensor.studies.reproduction.broadening_fit import FAMILIES, Fit, fit_broadening
from virtual_sensor.studies.reproduction.curves import SEARCHED, Curve, Setting, searched
from virtual_sensor.studies.reproduction.reconstruction import Reconstruction, reconstruct
from virtual_sensor.studies.reproduction.settings import (
    NINE_RAYS_MM,
    SCAN,
    Broadening,
    Scenes,
    settings,
)

T = TypeVar("T")


@dataclass(frozen=True)
class Shelf:
    """Where pieces are kept, and what all of them depend on.

    Attributes
    ----------
    folder : Path
    scenes : Scenes
    """

    folder: Path
    scenes: Scenes

    def piece(
        self, name: str, inputs: Mapping[str, Any], make: Callable[[], T], kind: type[T]
    ) -> T:
        """A dataclass of arrays: made, and kept as a file of NumPy's; or taken from there."""
        whole = {"piece": name, "scene": self.scenes.inputs(), **inputs}
        place = find_or_make(
            self.folder, name, whole, lambda new: _write(new / f"{name}.npz", make())
        )
        return _read(place / f"{name}.npz", kind)


def _write(path: Path, value: Any) -> None:
    """A flat dataclass's fields as arrays."""
    with path.open("wb") as file:
        arrays: dict[str, Any] = {f.name: np.asarray(getattr(value, f.name)) for f in fields(value)}
        np.savez(file, **arrays)


def _read(path: Path, kind: type[T]) -> T:
    with np.load(path, allow_pickle=False) as file:
        return kind(**{name: _plain(file[name]) for name in file.files})


def _plain(array: np.ndarray) -> Any:
    if array.dtype.kind == "U" and array.ndim:
        return tuple(map(str, array))
    return array if array.ndim else array.item()


def fits(shelf: Shelf, report: Report) -> dict[str, Fit]:
    """The broadenings that come nearest to the paper's numbers, by air."""
    found = {}
    for number, family in enumerate(FAMILIES.values()):

        def told(stage: str, part: float, number: int = number) -> None:
            report(stage, (number + part) / len(FAMILIES))

        found[family.air] = shelf.piece(
            f"fit_{family.air}",
            {},
            lambda family=family, told=told: fit_broadening(  # type: ignore[misc]
                shelf.scenes, family, told
            ),
            Fit,
        )
    return found


@dataclass(frozen=True)
class _Rays:
    """Curves of several settings, stacked: what a `Curve` holds, each with a first axis more."""

    y_mm: np.ndarray
    A_mm: np.ndarray
    B_mm: np.ndarray
    pixel_A: np.ndarray
    pixel_B: np.ndarray
    helper_um: np.ndarray


def rays(
    shelf: Shelf, airs: Mapping[str, Broadening], whole: bool, report: Report
) -> dict[Setting, Curve]:
    """The nine rays, or the whole line, searched in all airs, temperatures and poses."""
    curves = {}
    wanted = [setting for air in airs for setting in settings(air)]
    for air, broadening in airs.items():

        def make(air: str = air, broadening: Broadening = broadening) -> _Rays:
            found = []
            for setting in settings(air):
                report(f"searching, {setting}", wanted.index(setting) / len(wanted))
                scene = shelf.scenes.scene(setting.temperature_c, setting.beta_deg, broadening)
                if whole:
                    found.append(searched(scene, setting, LINE_MM, SCAN, helper=False))
                else:
                    found.append(searched(scene, setting, NINE_RAYS_MM))
            return _Rays(*(np.stack([getattr(c, f.name) for c in found]) for f in fields(_Rays)))

        name = f"{'line' if whole else 'nine_rays'}_{air}"
        stacked = shelf.piece(name, {"broadening": str(broadening)}, make, _Rays)
        for number, setting in enumerate(settings(air)):
            sensor = shelf.scenes.pose(setting.beta_deg).sensor
            arrays = (getattr(stacked, f.name)[number] for f in fields(_Rays))
            curves[setting] = Curve(setting, SEARCHED, sensor, *arrays)
    return curves


def maps(shelf: Shelf, airs: Mapping[str, Broadening], report: Report) -> dict[str, BetaMap]:
    """The whole line from all poses, at the highest temperature."""
    found = {}
    for number, (air, broadening) in enumerate(airs.items()):

        def told(stage: str, part: float, number: int = number) -> None:
            report(stage, (number + part) / len(airs))

        found[air] = shelf.piece(
            f"all_poses_{air}",
            {"broadening": str(broadening)},
            lambda air=air, broadening=broadening, told=told: beta_map(  # type: ignore[misc]
                shelf.scenes, air, broadening, report=told
            ),
            BetaMap,
        )
    return found


def reconstructions(
    shelf: Shelf, airs: Mapping[str, Broadening], wanted: Sequence[Setting], report: Report
) -> dict[Setting, Reconstruction]:
    """Scans of the cylinder, cold and hot, with the cylinders fitted to them."""
    found = {}
    for number, setting in enumerate(wanted):
        report(f"reconstructing, {setting}", number / len(wanted))
        broadening = airs[setting.air]

        def make(setting: Setting = setting, broadening: Broadening = broadening) -> Reconstruction:
            scene = shelf.scenes.scene(setting.temperature_c, setting.beta_deg, broadening)
            return reconstruct(scene)

        name = f"scan_{setting.air}_{setting.temperature_c:g}C_beta{setting.beta_deg:g}"
        inputs = {"setting": str(setting), "broadening": str(broadening)}
        found[setting] = shelf.piece(name, inputs, make, Reconstruction)
    return found
