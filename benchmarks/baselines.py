"""What corrections of several kinds leave of measurements through hot air, on the same truths.

``python benchmarks/baselines.py -o baselines``: some ten minutes on two idle cores, of which the
flows take more than half; those that are in the folder already are taken as they are.

Truths are rays that are searched through air that no correction but "its own air" knows: three
steady ones, and two plumes that sway, across an endless cylinder and simulated for this (OpenFOAM):
in long time steps, which damp what is small, and in small ones, in which a plane flow is a street
of vortices. Surface errors are distances to the true cylinder, point errors those to where light
met it.

A *parabolic sheet* is what a sensor's calibration can do by itself: cold plates that are measured
at several heights, here in the hot air, show a curved sheet of light, to which s = quadratic
function of (t, depth) is fitted; measured pixels are triangulated with it along straight lines.

*Two numbers at best* is what the frames' two largest principal components leave: no family of air
that is linear in two parameters leaves less, whatever they are.
"""

from __future__ import annotations

import argparse
import subprocess
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

import virtual_sensor as vs
from virtual_sensor.medium.netcdf import field_times
from virtual_sensor.optics.surfaces import Cylinder

Array = NDArray[np.float64]

Y_MM = np.linspace(-10.9, 10.9, 61)
TRUTHS = {
    "1250 °C": {"temperature": 1250},
    "1250 °C, blurred 2 mm": {"temperature": 1250, "blur": 2},
    "1250 °C, widened 2.75, blurred 7.2 mm": {"temperature": 1250, "widen": 2.75, "blur": 7.2},
}
SECOND_POSE_DEG = 30.0
CYLINDER = vs.CylinderShape(13.5, 0.0, -13.5)
FREE = ("radius_mm", "y_mm", "z_mm")
SECTION = ("--section", "--cell", "1.2", "--steady", "0")
STEADY = (*SECTION, "--time", "4")
SWAYING = {
    "long time steps": ("--whole", "--time", "4", "--record", "1.5", "--every", "0.05"),
    "small time steps": ("--whole", "--unsteady", "--time", "3", "--record", "1"),
}
PLATES_MM = (0.0, -3.0, -6.0)
LIKE = {  # the same kind of correction, of steady air and of frames of a plume that sways
    "none": "none",
    "a parabolic sheet, fitted to cold plates": "a parabolic sheet, fitted in the first frame",
    "the air of 1100 °C": "the steady air",
    "ours, air estimated on the known cylinder": "lean, width of each frame",
    "ours, air estimated, cylinder unknown": "lean, width, cylinder unknown, frame by frame",
    f"the same, two poses, beta 0 and {SECOND_POSE_DEG:g}": (
        "lean, width of each frame, unknown cylinder of all"
    ),
    "ours, its own air": "its own air in each frame",
}
_FLAT_MM = 1e6  # radius of a plate


@dataclass(frozen=True)
class Seen:
    """A pose's searched pixels (N, 2), and where light met the cylinder, (N, 3) in mm."""

    scene: Any
    pixel: Array
    lit_mm: Array

    @classmethod
    def of(cls, scene: Any) -> Seen:
        """The section |y| <= 10.9 mm."""
        found = vs.ray_search(scene, Y_MM, "newton")
        return cls(scene, found.pixel, found.laser_point_mm)

    @property
    def observation(self) -> vs.Observation:
        """For an estimate."""
        return vs.Observation(self.scene, self.pixel)


@dataclass(frozen=True)
class Plate:
    """A cold plate in a scene's air, as a search takes it; its top lies at a height in mm."""

    scene: Any
    height_mm: float

    camera = property(lambda self: self.scene.camera)
    source = property(lambda self: self.scene.source)
    medium = property(lambda self: self.scene.medium)
    surface = property(
        lambda self: Cylinder(_FLAT_MM, axis_y_mm=0.0, axis_z_mm=self.height_mm - _FLAT_MM)
    )


@dataclass(frozen=True)
class ParabolicSheet:
    """s = quadratic function of (t, depth), as plates at several heights show it."""

    weights: Array

    @classmethod
    def of(cls, scene: Any) -> ParabolicSheet:
        """Fitted to plates that are measured in the scene's air."""
        s, terms = [], []
        for height_mm in PLATES_MM:
            pixel = vs.ray_search(Plate(scene, height_mm), Y_MM, "newton").pixel
            centre, heading = scene.camera.pose.origin_mm, scene.camera.lines_of_sight(pixel)
            along = (height_mm - centre[2]) / heading[:, 2]
            point = centre + along[:, None] * heading
            s.append(scene.source.family.coordinates(point)[:, 0])
            terms.append(cls._terms(scene, point))
        return cls(np.linalg.lstsq(np.concatenate(terms), np.concatenate(s), rcond=None)[0])

    def points(self, scene: Any, pixel: Array) -> Array:
        """Where straight lines of sight (N, 2) meet the sheet; (N, 3) in mm."""
        point = vs.triangulate(scene, pixel)
        for _ in range(4):
            s = self._terms(scene, point) @ self.weights
            point = vs.triangulate(scene, pixel, coordinate=s)
        return point

    @staticmethod
    def _terms(scene: Any, point: Array) -> Array:
        family = scene.source.family
        from_part = family.pose.to_local(point) - family.pose.to_local(np.zeros(3))
        t, depth = family.coordinates(point)[:, 1], from_part[:, 2]
        return np.stack([np.ones_like(t), t, depth, t * t, t * depth, depth * depth], axis=1)


def corrections(seen: Sequence[Seen], model: vs.AirModel) -> dict[str, list[Array]]:
    """Points (N, 3) of each of two poses, by what corrects them."""

    def by(correct: Callable[[Seen], Array]) -> list[Array]:
        return [correct(each) for each in seen]

    def estimated(poses: Sequence[Seen], **known: Any) -> list[Array]:
        found = vs.estimate_air([each.observation for each in poses], model, **known)
        return [vs.triangulate(each.scene, each.pixel, medium=found.medium) for each in seen]

    unknown = {"shape": CYLINDER, "free": FREE}
    return {
        "none": by(lambda each: vs.triangulate(each.scene, each.pixel)),
        "a parabolic sheet, fitted to cold plates": by(
            lambda each: ParabolicSheet.of(each.scene).points(each.scene, each.pixel)
        ),
        "the air of 1100 °C": by(
            lambda each: vs.triangulate(each.scene, each.pixel, medium=model.at())
        ),
        "ours, air estimated on the known cylinder": estimated(seen[:1], shape=CYLINDER),
        "ours, air estimated, cylinder unknown": estimated(seen[:1], **unknown),
        f"the same, two poses, beta 0 and {SECOND_POSE_DEG:g}": estimated(seen, **unknown),
        "ours, its own air": by(
            lambda each: vs.triangulate(each.scene, each.pixel, medium=each.scene.medium)
        ),
    }


def surface_um(points: Array) -> Array:
    """Distance (..., N) of points (..., N, 3) to the true cylinder."""
    return 1e3 * (np.hypot(points[..., 1], points[..., 2] + 13.5) - 13.5)


def rms(values: Array) -> float:
    return float(np.sqrt(np.nanmean(values**2)))


def radius_um(points: Array) -> float:
    """Error of the radius of the circle through points (N, 3)."""
    return 1e3 * (vs.fit_cylinder(points, direction=(1.0, 0.0, 0.0)).radius_mm - 13.5)


def steady_rows() -> list[tuple[str, ...]]:
    """A row for each correction and truth: errors of the first pose, and of both poses' radius."""
    model = vs.AirModel.of(vs.IndexField.read("hot_cylinder_1100C_quarter"))
    rows = []
    for truth, parameters in TRUTHS.items():
        scenes = [
            vs.load_scene("hot_cylinder", **parameters, beta=beta)
            for beta in (0.0, SECOND_POSE_DEG)
        ]
        seen = [Seen.of(scene) for scene in scenes]
        for name, points in corrections(seen, model).items():
            first = points[0]
            point_um = 1e3 * np.linalg.norm(first - seen[0].lit_mm, axis=1)
            figures = rms(surface_um(first)), rms(point_um), radius_um(first)
            both = radius_um(np.concatenate(points))
            rows.append((truth, name, *(f"{value:.3g}" for value in (*figures, both))))
            print(" | ".join(rows[-1]), flush=True)
    return rows


def simulated(field: Path, options: Sequence[str]) -> Path:
    """The field that `field simulate` makes with these options, unless it is there."""
    if not field.exists():
        command = [sys.executable, "-m", "virtual_sensor", "field", "simulate", *options]
        subprocess.run([*command, "-o", str(field)], check=True)
    return field


def sway_rows(sway: Path, steady: Path, every: int) -> list[tuple[str, ...]]:
    """A row for each correction of a burst's frames: what stays, and what sways."""
    instants = field_times(sway)
    assert instants is not None
    scene = vs.load_scene("hot_cylinder", field=sway)
    seen = [Seen.of(scene.at(float(instant))) for instant in instants[::every]]
    model, lit = vs.AirModel.of(vs.IndexField.read(steady)), np.array([s.lit_mm for s in seen])
    air = seen[0].scene.medium
    mean = air.with_nodes(np.mean([each.scene.medium.nodes for each in seen], axis=0))

    def each_estimated(names: Sequence[str], free: Sequence[str] = ()) -> Array:
        points = []
        for each in seen:
            found = vs.estimate_air(each.observation, model, names, shape=CYLINDER, free=free)
            points.append(found.points[0].point_mm)
        return np.array(points)

    def together(names: Sequence[str]) -> Array:
        lines = [each.observation for each in seen]
        found = vs.estimate_air(lines, model, names, each=names, shape=CYLINDER, free=FREE)
        return np.array([each.point_mm for each in found.points])

    def through(medium: vs.IndexField | None) -> Array:
        return np.array([vs.triangulate(s.scene, s.pixel, medium=medium) for s in seen])

    ways: Mapping[str, Callable[[], Array]] = {
        "none": lambda: through(None),
        "a parabolic sheet, fitted in the first frame": lambda: np.array(
            [
                sheet.points(s.scene, s.pixel)
                for sheet in [ParabolicSheet.of(seen[0].scene)]
                for s in seen
            ]
        ),
        "the steady air": lambda: through(model.at()),
        "the burst's mean air": lambda: through(mean),
        "offset, width of each frame": lambda: each_estimated(("offset", "width")),
        "lean, width of each frame": lambda: each_estimated(("lean", "width")),
        "lean, width, scale of each frame": lambda: each_estimated(("lean", "width", "scale")),
        "lean, width, cylinder unknown, frame by frame": lambda: each_estimated(
            ("lean", "width"), FREE
        ),
        "lean, width of each frame, unknown cylinder of all": lambda: together(("lean", "width")),
        "two numbers of each frame at best": lambda: through(None),
        "its own air in each frame": lambda: np.array(
            [vs.triangulate(s.scene, s.pixel, medium=s.scene.medium) for s in seen]
        ),
    }
    rows, before = [], None
    for name, correct in ways.items():
        points = correct()
        surface, point = surface_um(points), 1e3 * (points - lit)[..., 1]
        if name.startswith("two numbers"):
            surface, point = (without_components(each, 2) for each in (surface, point))
        sways = [rms(np.std(each, axis=0, ddof=1)) for each in (surface, point)]
        before = before or sways
        stays = [rms(np.mean(each, axis=0)) for each in (surface, point)]
        shares = [100.0 * now / then for now, then in zip(sways, before, strict=True)]
        figures = stays[0], sways[0], shares[0], stays[1], sways[1], shares[1]
        rows.append((name, *(f"{value:.3g}" for value in figures)))
        print(" | ".join(rows[-1]), flush=True)
    return rows


def without_components(values: Array, count: int) -> Array:
    """Values (F, N) less their largest principal components over the frames."""
    mean = values.mean(axis=0)
    left, size, right = np.linalg.svd(values - mean, full_matrices=False)
    size[:count] = 0.0
    return mean + (left * size) @ right


def markdown(heads: Sequence[str], rows: Sequence[Sequence[str]]) -> str:
    lines = [heads, ["---"] * len(heads), *rows]
    return "".join(f"| {' | '.join(line)} |\n" for line in lines)


def one_table(steady: Sequence[Sequence[str]], sway: Sequence[Sequence[str]]) -> str:
    """A row for each kind of correction: of every steady truth, and of a plume that sways."""
    heads = ["correction"]
    heads += [f"{truth}: {what}" for truth in TRUTHS for what in ("surface, µm rms", "radius, µm")]
    heads += ["swaying plume: stays, µm rms", "sways, µm"]
    swaying = {name: figures for name, *figures in sway}
    rows = []
    for name, alike in LIKE.items():
        found = [(row[2], row[4]) for row in steady if row[1] == name]
        rows.append([name, *(figure for pair in found for figure in pair), *swaying[alike][:2]])
    averaged = ["the mean of a burst's frames", *rows[0][1:-1], "0"]
    return markdown(heads, [rows[0], averaged, *rows[1:]])


def main() -> None:
    """Measure, print, and write one table of all, and those that it comes from."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("-o", "--output", type=Path, default=Path("baselines"))
    parser.add_argument("--every", type=int, default=3, help="of the instants of air that sways")
    asked = parser.parse_args()
    asked.output.mkdir(parents=True, exist_ok=True)
    steady, swaying = steady_rows(), []
    heads = "air", "correction", "surface, µm rms", "points, µm rms"
    tables = [markdown((*heads, "radius, µm", "radius from both poses, µm"), steady)]
    still = simulated(asked.output / "steady.nc", STEADY)
    for name, options in SWAYING.items():
        field = asked.output / f"{name.replace(' ', '_')}.nc"
        rows = sway_rows(simulated(field, (*SECTION, *options)), still, asked.every)
        swaying.append(rows)
        tables.append(
            markdown(
                (
                    *(f"correction ({name})", "surface: stays, µm rms", "sways, µm", "% left"),
                    *("points along the line: stay, µm rms", "sway, µm", "% left"),
                ),
                rows,
            )
        )
    tables.insert(0, one_table(steady, swaying[0]))
    (asked.output / "baselines.md").write_text("\n".join(tables), encoding="utf-8")


if __name__ == "__main__":
    main()
