"""Draw a laser line in coherent light, in partly coherent light and out of focus.

``python docs/draw_speckle.py`` makes the picture of the page on speckle, in a second.
"""

from pathlib import Path

import matplotlib
import numpy as np
from matplotlib.figure import Figure

import virtual_sensor as vs
from virtual_sensor.metrology.drawn_lines import line_shares
from virtual_sensor.reporting.style import style

PICTURE = Path(__file__).parent / "pictures" / "speckle.png"
SIZE_PX = 240, 44
PARTLY = {"polarisations": 2, "linewidth_nm": 2.0, "roughness_um": 30.0, "modes": 2.25}
CASES = (
    ("f/5.6", 5.6, {}, 0.0),
    ("f/22", 22.0, {}, 0.0),
    ("f/22, 11 patterns", 22.0, PARTLY, 0.0),
    ("f/5.6, defocus of 6 px", 5.6, {}, 6.0),
)


def drawn() -> Figure:
    """The picture."""
    width, height = SIZE_PX
    line, _ = line_shares(np.full(width, height / 2.0), 2.0, height)
    with style():
        figure = Figure(figsize=(7.2, 6.0), layout="constrained")
        for axes, (name, f_number, light, blur_px) in zip(
            figure.subplots(len(CASES), 1), CASES, strict=True
        ):
            aperture = vs.Aperture(f_number, magnification=0.25, **light)
            seen = vs.speckled(line, aperture, 1, blur_px)
            axes.imshow(seen, cmap="gray", vmax=np.quantile(seen, 0.998), interpolation="nearest")
            axes.set_title(f"{name}: contrast {aperture.contrast:.2f}", loc="left")
            axes.set_xticks([])
            axes.set_yticks([])
    return figure


if __name__ == "__main__":
    matplotlib.use("Agg")
    drawn().savefig(PICTURE, dpi=150)
