"""Draw what a lens sees through hot air: ``python docs/draw_blur.py`` (half a minute).

The paper's set-up with a lens, hot_cylinder at 1250 degC, the part in focus: the laser line's width
and its centre at f/4, f/8 and f/16, from the ray search through points of the pupil, and the image
of single laser points.
"""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure
from numpy.typing import NDArray

import virtual_sensor as vs
from virtual_sensor.metrology.truth import rms
from virtual_sensor.reporting.style import ALONG, CYCLE, colour, style
from virtual_sensor.studies.pupil import blur_through_air

PICTURES = Path(__file__).parent / "pictures"
LENS_MM = 75.0, 300.0  # image distance, and focus distance: at the part
F_NUMBERS = (4.0, 8.0, 16.0)
SPOTS_MM, SPOT_F_NUMBER = (0.0, 4.0, 8.0), 8.0

Array = NDArray[np.float64]
RAYS, LINE_POINTS, SPOT_POINTS = 241, 64, 400
APART_PX = 14.0  # spots from each other


def draw_spots(axes: Axes, scene: vs.Scene, lens: vs.Lens, air: str) -> None:
    """The images of single laser points, about where the pinhole sees them."""
    y_mm = np.array(SPOTS_MM)
    spots = vs.pupil_search(scene, y_mm, points=SPOT_POINTS, lens=lens).pixels
    middle = vs.ray_search(scene, y_mm, "newton").pixel
    for number, y in enumerate(y_mm):
        u, v = (spots[:, number] - middle[number]).T
        axes.plot(u + APART_PX * number, v, ".", ms=1.5, color=colour(air))
        axes.plot(APART_PX * number, 0.0, "+", ms=6.0, color="black")
        axes.annotate(f"y = {y:g} mm", (APART_PX * number, -2.9), ha="center")
    right = APART_PX * (len(y_mm) - 0.5)
    axes.set(xlim=(-0.5 * APART_PX, right), ylim=(2.6, -4.2), aspect="equal", ylabel="v in px")
    ticks = [-5, 0, 5]
    axes.set_xticks(np.add.outer(APART_PX * np.arange(len(y_mm)), ticks).ravel(), ticks * len(y_mm))
    axes.set_xlabel("u from where the pinhole sees the point in px")
    axes.set_title(f"{air}: images of single laser points at f/{SPOT_F_NUMBER:g}")


def draw(path: Path) -> None:
    """All panels."""
    hot = vs.load_scene("hot_cylinder")
    scenes = {"cold": hot.cold(), "hot": hot}
    half = 0.499 * hot.sensor.laser.length_mm
    y_mm = np.linspace(-half, half, RAYS)
    with style():
        figure = Figure(figsize=(7.6, 8.4), dpi=110, layout="constrained")
        rows = figure.subplots(4, 1, height_ratios=(0.8, 0.8, 1.2, 1.2))
        for axes, (air, scene) in zip(rows, scenes.items(), strict=False):
            draw_spots(axes, scene, vs.Lens.of_f_number(*LENS_MM, SPOT_F_NUMBER), air)
        study = blur_through_air(hot, F_NUMBERS, y_mm, LINE_POINTS)
        for number, (f_number, line) in enumerate(zip(F_NUMBERS, study.lines, strict=True)):
            for air in scenes:
                shift, width = line.shift_px[air], line.spread_px[air]
                look = {"color": CYCLE[number], "ls": "-" if air == "hot" else "--"}
                words = f"f/{f_number:g}, {air}"
                rows[2].plot(y_mm, width, **look, label=words)
                rows[3].plot(y_mm, shift, **look)
                shown = np.abs(y_mm) <= 10.0
                print(
                    f"{words}: width {np.nanmedian(width[shown]):.3f} px median,"
                    f" {np.nanmax(width[shown]):.2f} at most; shift {rms(shift[shown]):.3f} px rms,"
                    f" {np.nanmax(np.abs(shift[shown])):.3f} at most"
                )
            focus, left = line.focus_shift_mm[::24], line.left_px[shown]
            print(f"  focus farther by, mm: {np.round(focus, 1).tolist()}, left {rms(left):.2f} px")
        rows[2].set(title="width of the line by the pupil", ylabel="px, standard deviation")
        rows[3].set(title="centre of the line minus the pinhole's", ylabel="px", xlabel=ALONG)
        rows[2].legend(ncols=3)
        figure.savefig(path)


if __name__ == "__main__":
    matplotlib.use("Agg")
    draw(PICTURES / "blur_through_air.png")
