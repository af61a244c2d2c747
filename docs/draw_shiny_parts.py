"""Draw what shiny parts do to a laser line, and the materials that come with the program.

``python docs/draw_shiny_parts.py`` makes the pictures of the page on shiny parts, in a minute.
"""

from pathlib import Path
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray

import virtual_sensor as vs
from virtual_sensor.engine import mi
from virtual_sensor.imaging.materials import installed_materials
from virtual_sensor.imaging.scene_file import shipped_scenes
from virtual_sensor.reporting.style import style

PICTURES = Path(__file__).parent / "pictures"
STEEL = {"width": 768, "height": 768, "focal_length": 140, "max_depth": 4}
STEEL |= {"material": "ground_steel"}
SHINY = ("v_groove", 0.5), ("v_groove", 0.2), ("v_groove", 0.1), ("bearing_ring", 0.1)
ROWS = 290, 560  # of the image, where the line is
VIEW = 200, 130  # px of a part in the light of a room
DARKEST = 1e-4  # of the brightest pixel: a camera of 14 bits
Image = NDArray[np.floating]


def in_a_room(material: str) -> Image:
    """The stepped shaft under a lamp, and a bright sky, as a photograph would show it."""
    scene = vs.load_scene("stepped_shaft", width=64, height=64, field="", material=material)
    lookat = mi.ScalarTransform4f().look_at([110, 130, 120], [-8, 0, -12], [0, 0, 1])
    lamp = mi.ScalarTransform4f().look_at([40, -60, 200], [0, 0, -13], [1, 0, 0])
    view: dict[str, Any] = {
        "type": "scene",
        "integrator": {"type": "path", "max_depth": 3, "hide_emitters": True},
        "part": {
            "type": "ply",
            "filename": str(shipped_scenes() / "meshes" / "stepped_shaft.ply"),
            "material": scene.mitsuba.shapes()[0].bsdf(),
        },
        "sky": {"type": "constant", "radiance": 0.12},
        "lamp": {
            "type": "rectangle",
            "to_world": lamp @ mi.ScalarTransform4f().scale([90, 25, 1]),
            "emitter": {"type": "area", "radiance": 6.0},
        },
        "camera": {
            "type": "perspective",
            "fov": 17.0,
            "to_world": lookat,
            "film": {
                "type": "hdrfilm",
                "width": VIEW[0],
                "height": VIEW[1],
                "pixel_format": "luminance",
                "rfilter": {"type": "box"},
            },
            "sampler": {"type": "independent", "sample_count": 128},
        },
    }
    return np.array(mi.render(mi.load_dict(view), seed=0))[..., 0]


def bright(image: Image) -> Image:
    """An image as a display shows it, its brightest hundredth white."""
    return np.clip(image / max(np.quantile(image, 0.99), 1e-12), 0.0, 1.0) ** (1.0 / 2.2)


def logarithmic(image: Image, brightest: float) -> Image:
    """From 0, `DARKEST` of the brightest, to 1."""
    return 1.0 - np.log(np.clip(image / brightest, DARKEST, 1.0)) / np.log(DARKEST)


def materials() -> Figure:
    """Each material on the shaft in a room, and its laser line in the groove."""
    names = [path.stem for path in installed_materials()]
    across = 5
    down = -(-len(names) // across)
    with style():
        figure = Figure(figsize=(9.0, 2.3 * down), layout="constrained")
        ratios = [2.0, 1.3] * down
        axes = figure.subplots(2 * down, across, squeeze=False, height_ratios=ratios)
        for each in axes.ravel():
            each.set_axis_off()
        for number, name in enumerate(names):
            row, column = divmod(number, across)
            above, below = axes[2 * row : 2 * row + 2, column]
            above.imshow(bright(in_a_room(name)), cmap="gray", vmin=0.0, vmax=1.0)
            above.set_title(name)
            edge = {"edge_angle": 90} if name == "painted_edge" else {}
            scene = vs.load_scene("v_groove", **(STEEL | edge | {"material": name}))
            image = vs.render(scene)[slice(*ROWS)]
            below.imshow(logarithmic(image, image.max()), cmap="gray", vmin=0.0, vmax=1.0)
    return figure


def ghosts() -> Figure:
    """Frames from dull to shiny, where the light of each ghost comes from, and what is found."""
    heads = "the frame", "ghosts: which point of the line", "what the detector finds"
    with style():
        figure = Figure(figsize=(9.0, 6.9), layout="constrained")
        axes = figure.subplots(len(SHINY), 3, sharex=True, sharey=True)
        for row, (name, roughness) in zip(axes, SHINY, strict=True):
            scene = vs.load_scene(name, roughness=roughness, **STEEL)
            frame = vs.render_frame(scene)
            brightest = frame.radiance.max()
            seen = logarithmic(frame.radiance, brightest)
            row[0].imshow(seen, cmap="gray", vmin=0.0, vmax=1.0)
            row[0].set_ylabel(f"{name}, {roughness}")
            shown = frame.indirect.sum(axis=0) > DARKEST * brightest
            along = np.where(shown, frame.ghost_coordinates()[..., 1], np.nan)
            truth = row[1].imshow(along, cmap="twilight", vmin=-8, vmax=8, interpolation="nearest")
            line = vs.line_centres(frame)
            row[2].imshow(0.3 * seen, cmap="gray", vmin=0.0, vmax=1.0)
            row[2].plot(line.column[line.found], line.row[line.found], ".", ms=1.2)
        for each, head in zip(axes[0], heads, strict=True):
            each.set_title(head, loc="left")
        for each in axes.ravel():
            each.grid(False)
            each.set_xticks([])
            each.set_yticks([])
        axes[0, 0].set_ylim(*ROWS[::-1])
        figure.colorbar(
            truth, ax=axes, location="bottom", label="along the laser line, mm", shrink=0.4
        )
    return figure


if __name__ == "__main__":
    matplotlib.use("Agg")
    materials().savefig(PICTURES / "materials.png", dpi=150)
    ghosts().savefig(PICTURES / "shiny_parts.png", dpi=150)
