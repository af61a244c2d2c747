"""Scenes with several cameras and sources, made of the shipped ones."""

import re

from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.scene_file import shipped_scenes

LAMP = '<emitter type="point" id="lamp"><point name="position" x="80" y="50" z="90"/></emitter>'
ORTHOGRAPHIC = """<sensor type="orthographic" id="flat"><transform name="to_world">
    <lookat origin="0, 0, 300" target="0, 0, 0" up="-1, 0, 0"/></transform>
    <film type="hdrfilm"><integer name="width" value="8"/><integer name="height" value="8"/></film>
    </sensor>
"""
_TURN = '<rotate y="1" angle="$tilt"/>'


def element(text, tag):
    """The first element of a tag, as text."""
    return re.search(rf" *<{tag} .*?</{tag}>\n", text, re.DOTALL)[0]


def text_of(name, cameras, sources, more=""):
    """A shipped scene's XML with other cameras and sources.

    `cameras` are (name, degrees from the shipped one, size of the film by its), `sources` (name,
    degrees from the shipped one, mm along x); each may be anywhere, and an empty name is none.
    """
    folder = shipped_scenes()
    text = (folder / f"{name}.xml").read_text(encoding="utf-8")
    for inside in ("fields", "meshes"):
        text = text.replace(f'"{inside}/', f'"{folder / inside}/')
    camera, laser = element(text, "sensor"), element(text, "emitter")
    seeing = "".join(
        turned(camera.replace("$width", "$w_" + each if size != 1 else "$width"), degrees)
        .replace(' id="camera"', f' id="{each}"' if each else "")
        .replace("$w_" + each, str(int(128 * size)))
        for each, degrees, size in cameras
    )
    shining = "".join(
        turned(laser, degrees)
        .replace(' id="laser"', f' id="{each}"' if each else "")
        .replace('<translate x="$along"', f'<translate x="{shift}"/><translate x="$along"')
        for each, degrees, shift in sources
    )
    return text.replace(camera, seeing).replace(laser, shining + more)


def turned(text, degrees):
    """An element's text, turned about the part's axis across the line by degrees."""
    return text.replace(_TURN, f'{_TURN}<rotate y="1" angle="{degrees}"/>')


def two_by_two(folder, name="hot_cylinder", **parameters):
    """Two cameras and two lasers, whose lines don't cross: loaded."""
    path = folder / f"two_{name}.xml"
    cameras, sources = [("near", 0, 1), ("far", 20, 1.5)], [("red", 0, 0), ("blue", 15, 4)]
    path.write_text(text_of(name, cameras, sources), encoding="utf-8")
    film = {"width": 128, "height": 128, "spp": 4, "line_radius": 0.5}
    return load_scene(path, **(film | parameters))
