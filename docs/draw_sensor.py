"""Draw the pictures of the glossary, for light and dark pages: ``python docs/draw_sensor.py``.

Angles and lengths are those of the scene hot_cylinder, except in the close-up, which is a sketch.
"""

from collections.abc import Callable
from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from matplotlib.patches import Arc, Circle, Rectangle
from numpy.typing import NDArray

import virtual_sensor as vs
from virtual_sensor.reporting.style import COLOURS, style

PICTURES = Path(__file__).parent / "pictures"
INKS = {"light": "#1f2328", "dark": "#e6e6e6"}
PARTS = {"light": "#d9d9d9", "dark": "#4a4e57"}
LASER, CAMERA, HOT = COLOURS["laser"], COLOURS["camera"], COLOURS["hot"]
RADIUS = 13.5  # of the cylinder, mm
DISTANCE = 300.0  # of camera and laser from the line, mm
TURN = 30.0  # beta in the second panel, degrees: round x, from z towards -y

Array = NDArray[np.float64]


def draw(panel: Callable[[Axes, str, str], None], title: str, ink: str, part: str) -> Figure:
    """One drawing."""
    figure = Figure(figsize=(5.4, 4.7), layout="constrained")
    axes = figure.subplots()
    panel(axes, ink, part)
    axes.set_title(title, color=ink)
    axes.grid(False)
    return figure


def side(axes: Axes, ink: str, part: str) -> None:
    """The plane of the laser's and the camera's axes: tilt and alpha."""
    axes.add_patch(Rectangle((-85, -27), 170, 27, color=part))
    laser, camera = (at(angle, DISTANCE) for angle in (-30.0, 30.0))
    axes.plot([0, 0], [0, 250], ":", color=ink, lw=1)
    for stop, colour, towards in ((laser, LASER, True), (camera, CAMERA, False)):
        axes.plot(*zip(stop, (0, 0), strict=True), color=colour, lw=2)
        middle, step = 0.5 * stop, -0.03 * stop if towards else 0.03 * stop
        arrow(axes, middle - step, middle + step, colour)
        axes.plot(*stop, "s", ms=13, color=colour)
    axes.text(laser[0] + 14, laser[1] + 8, "laser", color=ink, ha="left")
    axes.text(camera[0] - 14, camera[1] + 8, "camera", color=ink, ha="right")
    angle(axes, 90, 120, 170, ink, "tilt", 105)
    angle(axes, 60, 120, 95, ink, "alpha", 78)
    axes.text(-112, 118, "distance", color=ink, rotation=-60, ha="center", va="center")
    axes.text(60, -13.5, "part", color=ink, ha="center", va="center")
    cross(axes, (-80, 45), ("x", "z"), 35, ink)
    axes.plot(0, 0, "o", color=ink)
    axes.annotate("origin, on the\ntop line", (0, 0), (20, 14), color=ink, fontsize=9)
    frame(axes, (-200, 200), (-40, 300))


def end(axes: Axes, ink: str, part: str) -> None:
    """Across the cylinder: the laser's sheet, the plume, and beta."""
    y, z = np.meshgrid(np.linspace(-30, 30, 200), np.linspace(-30, 75, 200))
    plume = np.exp(-((y / 6.0) ** 2)) * (z > 0) + np.exp(
        -((np.hypot(y, z + RADIUS) - RADIUS) / 3.0)
    )
    axes.imshow(
        np.dstack([*(np.full_like(y, float(c)) for c in matplotlib.colors.to_rgb(HOT)),
                   0.45 * np.clip(plume, 0.0, 1.0)]),
        extent=(-30, 30, -30, 75), origin="lower", aspect="equal",
    )  # fmt: skip
    axes.add_patch(Circle((0, -RADIUS), RADIUS, color=part))
    sheet = np.array([[-11, -11], [-11, 75], [11, 75], [11, -11]], float)
    top = np.sqrt(RADIUS**2 - 11.0**2) - RADIUS
    sheet[[0, 3], 1] = top
    axes.fill(*sheet.T, color=LASER, alpha=0.25, lw=0)
    axes.plot([-11, -11], [top, 75], color=LASER, lw=1)
    axes.plot([11, 11], [top, 75], color=LASER, lw=1)
    lit = np.linspace(-11, 11, 60)
    axes.plot(lit, np.sqrt(RADIUS**2 - lit**2) - RADIUS, color=LASER, lw=3)
    axes.text(12.5, 62, "laser sheet,\nline_length\nwide", color=ink, ha="left", va="center")
    axes.text(0, 40, "hot\nair", color=ink, ha="center", va="center")
    axes.plot([0, 0], [-RADIUS, 75], ":", color=ink, lw=1)
    turned = at(-TURN, 80.0) - (0.0, RADIUS)
    axes.plot([0, turned[0]], [-RADIUS, turned[1]], ":", color=ink, lw=1)
    arc = Arc((0, -RADIUS), 132, 132, theta1=90, theta2=90 + TURN, color=ink, lw=1.2)
    axes.add_patch(arc)
    axes.text(-22, 52, "beta", color=ink, ha="center", fontweight="bold")
    axes.text(-34, 64, "sensor\nturned by\nbeta", color=ink, ha="right", va="center", fontsize=9)
    axes.text(0, -RADIUS - 4, "part", color=ink, ha="center", va="center")
    cross(axes, (-50, -20), ("y", "z"), 14, ink)
    frame(axes, (-62, 62), (-30, 78))


def image(axes: Axes, ink: str, part: str) -> None:
    """The line as the camera sees it, cold and hot."""
    scene = vs.load_scene("hot_cylinder")
    y_mm = np.linspace(-10.9, 10.9, 81)
    for each, colour, words in ((scene.cold(), COLOURS["cold"], "cold"), (scene, HOT, "hot")):
        pixel = vs.ray_search(each, y_mm, "newton").pixel
        axes.plot(*pixel.T, color=colour, lw=2, label=words)
    axes.legend(labelcolor=ink, loc="upper right")
    axes.annotate(
        "one line centre in each column:\nits row is what a detector finds",
        (1023.5, 1022),
        (1023.5, 1120),
        color=ink,
        ha="center",
        fontsize=9,
        arrowprops={"arrowstyle": "->", "color": ink},
    )
    axes.set(xlim=(500, 1550), ylim=(1290, 990))
    axes.set_xlabel("u in px, along the line", color=ink)
    axes.set_ylabel("v in px, across it", color=ink)
    axes.tick_params(colors=ink)
    for spine in axes.spines.values():
        spine.set_color(ink)
    axes.patch.set_alpha(0.0)


def close_up(axes: Axes, ink: str, part: str) -> None:
    """A, B and what is measured there."""
    x = np.linspace(-1.3, 1.3, 200)
    axes.fill_between(x, -0.28 * x**2, -1.0, color=part, lw=0)
    laser, camera = np.array([-0.78, 1.25]), np.array([1.0, 1.25])
    a, b = np.array([0.0, 0.0]), np.array([0.36, -0.036])
    seen = bent(b, camera, 0.1)
    straight = seen[-2] - camera  # the direction from which light comes into the camera
    share, _ = np.linalg.solve(np.stack([straight, laser - a], axis=1), a - camera)
    measured = camera + share * straight
    axes.plot(*zip(laser, a, strict=True), "--", color=LASER, lw=1.5)
    axes.plot(*zip(a, camera, strict=True), "--", color=CAMERA, lw=1.5)
    axes.plot(*bent(laser, b, 0.1).T, color=LASER, lw=2.2)
    axes.plot(*seen.T, color=CAMERA, lw=2.2)
    axes.plot(*zip(measured, camera, strict=True), ":", color=CAMERA, lw=1.8)
    axes.plot(*np.array([a, b, measured]).T, "o", color=ink, ms=6)
    for place, words, aside, side_ in (
        (a, "A = A$_m$", (-0.03, -0.13), "right"),
        (b, "B", (0.05, -0.15), "left"),
        (measured, "B$_m$", (-0.06, -0.06), "right"),
    ):
        axes.text(*(place + aside), words, color=ink, ha=side_, fontsize=14, fontweight="bold")
    axes.text(-0.86, 1.28, "laser", color=ink, ha="center", va="bottom")
    axes.text(1.0, 1.28, "camera", color=ink, ha="center", va="bottom")
    key = (("--", "cold: light runs straight"), ("-", "hot: both paths bend"),
           (":", "line of sight that triangulation takes for straight"))  # fmt: skip
    lines = [axes.plot([], [], dash, color=ink, lw=1.8, label=words)[0] for dash, words in key]
    axes.legend(handles=lines, labelcolor=ink, loc="lower left", fontsize=9)
    frame(axes, (-1.3, 1.3), (-1.0, 1.45), equal=False)


def at(degrees: float, length: float) -> Array:
    """The point at so many degrees from the vertical, towards +x."""
    return length * np.array([np.sin(np.radians(degrees)), np.cos(np.radians(degrees))])


def bent(start: Array, stop: Array, by: float) -> Array:
    """A path from start to end that bulges to its left by so much of its length."""
    share = np.linspace(0.0, 1.0, 40)[:, None]
    aside = np.array([start[1] - stop[1], stop[0] - start[0]])
    return start + share * (stop - start) + by * 4.0 * share * (1.0 - share) * aside


def arrow(axes: Axes, start: Array, stop: Array, colour: str) -> None:
    """An arrow head."""
    axes.annotate("", stop, start, arrowprops={"arrowstyle": "-|>", "color": colour, "lw": 2})


def angle(
    axes: Axes, first: float, last: float, radius: float, ink: str, words: str, where: float
) -> None:
    """An arc round the origin between two directions, degrees from +x, with its name."""
    axes.add_patch(
        Arc((0, 0), 2 * radius, 2 * radius, theta1=first, theta2=last, color=ink, lw=1.2)
    )
    place = (radius + 13) * np.array([np.cos(np.radians(where)), np.sin(np.radians(where))])
    axes.text(*place, words, color=ink, ha="center", va="center", fontweight="bold")


def cross(
    axes: Axes, origin: tuple[float, float], names: tuple[str, str], length: float, ink: str
) -> None:
    """Two axes of the world with their names."""
    for step, name in zip(np.eye(2) * length, names, strict=True):
        arrowprops = {"arrowstyle": "->", "color": ink}
        axes.annotate("", np.add(origin, step), origin, arrowprops=arrowprops)
        axes.text(*np.add(origin, 1.25 * step), name, color=ink, ha="center", va="center")


def frame(axes: Axes, x: tuple[float, float], y: tuple[float, float], equal: bool = True) -> None:
    """What of a drawing is seen, without axes."""
    axes.set(xlim=x, ylim=y)
    if equal:
        axes.set_aspect("equal")
    axes.set_axis_off()


PANELS = {
    "side": (side, "1  Seen from the side, across the cylinder"),
    "end": (end, "2  Seen along the cylinder's axis"),
    "image": (image, "3  The camera's image"),
    "close_up": (close_up, "4  At the part, in hot air (not to scale)"),
}

if __name__ == "__main__":
    matplotlib.rcParams["svg.hashsalt"] = "virtual_sensor"  # the same file from the same program
    for page, ink in INKS.items():
        for name, (panel, title) in PANELS.items():
            with style():
                draw(panel, title, ink, PARTS[page]).savefig(
                    PICTURES / f"sensor_{name}_{page}.svg",
                    metadata={"Date": None},
                    transparent=True,
                )
