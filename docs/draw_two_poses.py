"""Draw how two poses make the air visible: ``python docs/draw_two_poses.py`` (about a minute).

The radius of hot_cylinder's part, measured through three airs: of its own, blurred by 2 mm, and
widened and blurred. The model is the air of a part 150 K colder, with a scale and a width to be
found. Pixels are those of the ray search, with noise of 0.02 px.
"""

from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.colors import LinearSegmentedColormap
from matplotlib.figure import Figure
from matplotlib.patches import Circle, Polygon
from numpy.typing import NDArray

import virtual_sensor as vs
from virtual_sensor.reporting.style import style

PICTURES = Path(__file__).parent / "pictures"
AIRS = ({}, {"blur": 2}, {"widen": 2.75, "blur": 7.2})
Y_MM = np.linspace(-10.0, 10.0, 61)
NOISE_PX = 0.02
RADIUS_MM = 13.5

HALF_LINE_MM = 11.0
SENSOR_MM = 58.0, 66.0  # of the sketch, from the axis
LEFT_UM, LEAST_UM, RIGHT_UM = 0.06, 0.1, 2000.0  # what is less is drawn as the least

Array = NDArray[np.float64]


class Theme(NamedTuple):
    """Colours of a page."""

    ink: str
    faint: str
    paper: str
    part: str
    poses: tuple[str, str]
    wrong: str
    right: str


THEMES = {
    "light": Theme(
        "#1f2328", "#59636e", "#ffffff", "#c9ccd1", ("#0072B2", "#009E73"), "#C24E00", "#0072B2"
    ),
    "dark": Theme(
        "#e6edf3", "#9aa4b0", "#0d1117", "#4a4e57", ("#56B4E9", "#2EC89A"), "#FF8A47", "#56B4E9"
    ),
}


def radius_errors() -> dict[str, Array]:
    """Radius minus the true one in µm, in each of the airs, by how it was measured."""
    random = np.random.default_rng(4)
    model = vs.AirModel.of(vs.load_scene("hot_cylinder", temperature=1100).medium)
    found: dict[str, list[float]] = {}
    for air in AIRS:
        seen = [observed(beta, air, random) for beta in (0, 15, 30)]
        straight = vs.fit_cylinder(
            vs.triangulate(seen[0].scene, seen[0].pixel), direction=(1, 0, 0)
        )
        found.setdefault("not corrected", []).append(straight.radius_mm)
        for words, poses in (
            ("corrected, air found from one pose", seen[:1]),
            ("... from two poses, 0° and 15°", seen[:2]),
            ("... from two poses, 0° and 30°", seen[::2]),
        ):
            found.setdefault(words, []).append(estimated_mm(poses, model))
    return {words: 1e3 * (np.array(each) - RADIUS_MM) for words, each in found.items()}


def observed(beta: float, air: dict[str, float], random: np.random.Generator) -> vs.Observation:
    """What the sensor, turned by beta, sees through an air."""
    scene = vs.load_scene("hot_cylinder", temperature=1250, beta=beta, **air)
    pixel = np.asarray(vs.ray_search(scene, Y_MM, "newton").pixel)
    pixel[:, 1] += random.normal(0.0, NOISE_PX, len(pixel))
    return vs.Observation(scene, pixel, NOISE_PX)


def estimated_mm(seen: Sequence[vs.Observation], model: vs.AirModel) -> float:
    """The radius, found together with the air's scale and width and the cylinder's place."""
    free = ("radius_mm", "y_mm", "z_mm")
    found = vs.estimate_air(seen, model, ("scale", "width"), shape=vs.CylinderShape(), free=free)
    return found["radius_mm"]


def sketch(axes: Axes, theme: Theme) -> None:
    """The part in its air, and the sensor's two poses, seen along the cylinder."""
    field = vs.load_scene("hot_cylinder", temperature=1250).medium
    y, z = np.meshgrid(np.linspace(-46.0, 34.0, 240), np.linspace(-30.0, 62.0, 276))
    points = np.stack([np.zeros_like(y), y, z], axis=-1).reshape(-1, 3)
    heat = (field.ambient - field.refractivity(points).reshape(y.shape)) / field.ambient
    colours = LinearSegmentedColormap.from_list("heat", [theme.paper, "#F2A65A", "#D5420A"])
    axes.imshow(heat, colours, vmin=0.0, vmax=0.85, origin="lower", extent=(-46, 34, -30, 62))
    axes.add_patch(Circle((0.0, -RADIUS_MM), RADIUS_MM, color=theme.part, zorder=3))
    for beta, paint in zip((0.0, 30.0), theme.poses, strict=True):
        pose(axes, beta, paint, theme.paper)
    words = {"color": theme.ink, "ha": "center", "va": "center", "fontsize": 11, "zorder": 4}
    axes.text(0.0, -RADIUS_MM, "1250 °C", **words)
    axes.set(xlim=(-46, 34), ylim=(-30, 62))
    axes.set_axis_off()


def pose(axes: Axes, beta: float, paint: str, paper: str) -> None:
    """The sensor, turned by beta about the cylinder's axis, and its sheet of light."""
    sine, cosine = np.sin(np.radians(beta)), np.cos(np.radians(beta))

    def place(points: Array) -> Array:
        return points @ np.array([[cosine, sine], [-sine, cosine]]) - (0.0, RADIUS_MM)

    half, (low, high) = HALF_LINE_MM, SENSOR_MM
    across = np.linspace(-half, half, 60)
    lit = np.stack([across, np.sqrt(RADIUS_MM**2 - across**2)], axis=1)
    light = np.concatenate([lit, [[half, low], [-half, low]]])
    body = np.array([[-half, low], [half, low], [half, high], [-half, high]])
    axes.add_patch(Polygon(place(light), color=paint, alpha=0.22, lw=0, zorder=2))
    axes.plot(*place(lit).T, color=paint, lw=4, zorder=5, solid_capstyle="round")
    axes.add_patch(Polygon(place(body), color=paint, zorder=4))
    words = {"ha": "center", "va": "center", "fontsize": 11, "fontweight": "bold", "zorder": 6}
    middle = place(np.array([0.0, 0.5 * (low + high)]))
    axes.text(*middle, f"{beta:g}°", color=paper, rotation=beta, **words)


def errors(axes: Axes, found: dict[str, Array], theme: Theme) -> None:
    """Sizes of the radius' errors: a row for each way to measure, a dot for each air."""
    for row, (words, each) in enumerate(found.items()):
        size = np.abs(each).clip(LEAST_UM)
        ends = size.min(), size.max()
        paint = theme.right if "two poses" in words else theme.wrong
        style = {"color": paint, "solid_capstyle": "round"}
        axes.plot(ends, (row, row), lw=9, alpha=0.3, **style)
        axes.plot(size, np.full(size.shape, row), "o", ms=8, color=paint)
        axes.text(LEFT_UM, row - 0.27, words, color=theme.ink, va="bottom", fontsize=11.5)
        most = f"{ends[1]:.0f}" if ends[1] >= 10.0 else f"{ends[1]:.1f}"
        bold = {"ha": "right", "va": "bottom", "fontsize": 11.5, "fontweight": "bold"}
        axes.text(RIGHT_UM, row - 0.27, f"up to {most} µm", color=paint, **bold)
    axes.set_xscale("log")
    axes.set(xlim=(LEFT_UM, RIGHT_UM), ylim=(len(found) - 0.6, -0.8))
    axes.set_xticks([0.1, 1.0, 10.0, 100.0, 1000.0], ["≤ 0.1", "1", "10", "100", "1000 µm"])
    axes.minorticks_off()
    axes.set_yticks([])
    axes.tick_params(axis="x", colors=theme.faint, labelsize=10, length=0)
    axes.grid(axis="x", color=theme.faint, alpha=0.35, lw=0.7)
    axes.spines[:].set_visible(False)
    axes.patch.set_alpha(0.0)


def draw(found: dict[str, Array], theme: Theme) -> Figure:
    """The picture."""
    figure = Figure(figsize=(8.0, 3.9), facecolor=theme.paper)
    head = {"ha": "left", "va": "top"}
    title = "Two poses make the air visible"
    figure.text(0.02, 0.97, title, color=theme.ink, fontsize=16, fontweight="bold", **head)
    words = (
        "Error of a cylinder's radius, 13.5 mm, through three airs (dots) of which the model"
        " knows none"
    )
    figure.text(0.02, 0.88, words, color=theme.faint, fontsize=10.5, **head)
    sketch(figure.add_axes((0.01, 0.02, 0.35, 0.80)), theme)
    errors(figure.add_axes((0.39, 0.085, 0.59, 0.74)), found, theme)
    return figure


if __name__ == "__main__":
    matplotlib.rcParams["svg.hashsalt"] = "virtual_sensor"  # the same file from the same program
    found = radius_errors()
    for name, theme in THEMES.items():
        with style():
            path = PICTURES / f"two_poses_{name}.svg"
            draw(found, theme).savefig(path, metadata={"Date": None})
    for words, each in found.items():
        print(f"{words}: {', '.join(f'{error:.2f}' for error in each)} µm")
