"""A scene's cameras, sources and air with a flat plate in the part's place, such as a target."""

from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from xml.etree import ElementTree

import cv2
import numpy as np
from numpy.typing import NDArray

from virtual_sensor.errors import InputError
from virtual_sensor.files import scratch_folder
from virtual_sensor.imaging.scene import Scene
from virtual_sensor.imaging.scene_file import MATERIAL, read_scene_file
from virtual_sensor.poses import Pose

_WHITE = 65535

PLATE = """
<scene>
    <default name="plate_pose" value="1 0 0 0 0 1 0 0 0 0 1 0 0 0 0 1"/>
    <shape type="rectangle" id="plate">
        <transform name="to_world">
            <scale x="{width}" y="{height}"/>
            <rotate x="1" angle="180"/>
            <matrix value="$plate_pose"/>
        </transform>
        <bsdf type="diffuse">
            <texture type="bitmap" name="reflectance">
                <string name="filename" value="{picture}"/>
                <boolean name="raw" value="true"/>
                <string name="wrap_mode" value="clamp"/>
            </texture>
        </bsdf>
    </shape>
</scene>
"""

LAMP = """
<scene>
    <default name="plate_light" value="0"/>
    <emitter type="directional" id="plate_lamp">
        <spectrum name="irradiance" value="$plate_light"/>
        <transform name="to_world">
            <matrix value="$plate_pose"/>
        </transform>
    </emitter>
</scene>
"""
"""Of the plate: its light falls square on it and is even, and there is no chance in it."""


class PlateScenes:
    """Scenes with a plate in the part's place, one for each pose.

    Parameters
    ----------
    scene : Scene
    dark, lit : Path
        Files of the scene with the plate, and with the plate's lamp.
    """

    def __init__(self, scene: Scene, dark: Path, lit: Path) -> None:
        self._scene, self._dark, self._lit = scene, dark, lit

    def at(self, pose: Pose, irradiance: float = 0.0) -> Scene:
        """The scene with the plate in a pose: x along its rows, y along its columns, z into it.

        With its lamp it has no other source.

        Parameters
        ----------
        pose : Pose
        irradiance : float
            Of the plate's own lamp, W/mm^2; 0: it has none.

        Raises
        ------
        InputError
            If a camera would stand on the plate.
        """
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.origin_mm
        numbers = " ".join(f"{number:.12g}" for number in matrix.ravel())
        if not irradiance:
            return self._scene.from_file(self._dark, plate_pose=numbers)
        light = float(irradiance)
        lit = self._scene.from_file(self._lit, plate_pose=numbers, plate_light=light)
        return replace(lit, sources={})


@contextmanager
def plate_scenes(
    scene: Scene, reflectance: NDArray[np.float32], size_mm: tuple[float, float]
) -> Iterator[PlateScenes]:
    """Give a scene's devices and air with a plate in place of all its shapes.

    Parameters
    ----------
    scene : Scene
        Its shapes are left out, and with them lamps that are shapes; other lamps stay.
    reflectance : ndarray of shape (H, W)
        Of the plate, from its lowest x and y on; diffuse.
    size_mm : pair of float
        Width and height.

    Raises
    ------
    InputError
        If shapes stand in a file that the scene's includes.
    """
    text = read_scene_file(scene.path).text
    root = ElementTree.fromstring(text)
    for shape in root.findall("shape"):
        root.remove(shape)
    if any(each.get("filename") != MATERIAL for each in root.iter("include")):
        raise InputError(
            f"{scene.path}: has an <include>, and the part may stand there; put its elements into"
            " the scene file"
        )
    with scratch_folder() as folder:
        picture = folder / "plate.png"
        levels = np.rint(np.clip(reflectance, 0.0, 1.0) * _WHITE).astype(np.uint16)
        # By OpenCV: Mitsuba's own writer now and then waits for ever.
        picture.write_bytes(cv2.imencode(".png", levels)[1].tobytes())
        width, height = size_mm
        plate = PLATE.format(width=width / 2.0, height=height / 2.0, picture=picture)
        root.insert(0, ElementTree.Element("path", value=str(scene.path.parent.absolute())))
        files = []
        for name, elements in (("dark", plate), ("lit", LAMP)):
            root.extend(ElementTree.fromstring(elements))
            files.append(folder / f"{scene.path.stem}_{name}.xml")
            text = ElementTree.tostring(root, encoding="unicode")
            files[-1].write_text(text, encoding="utf-8")
        yield PlateScenes(scene, *files)
