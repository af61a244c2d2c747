"""From a scene file to what the program works with; the only place that loads a scene.

The sensor model is read *from* the loaded Mitsuba scene, so the two can't disagree.
"""

import re
import xml.etree.ElementTree as ElementTree
from contextlib import suppress
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import virtual_sensor_plugins as plugins
from numpy.typing import NDArray

from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.sensor_model import Camera, Pose, SensorModel
from virtual_sensor.optics.surfaces import Cylinder, SceneSurface, Surface

# Mitsuba's camera has x to the left and y up; ours has x along u and y along v, with z forward.
_OURS_FROM_MITSUBAS = np.diag([-1.0, -1.0, 1.0])
_ABSOLUTE_ZERO_C = -273.15
_SAME_MM = 1e-4  # float32 leaves so much doubt of a place

# What Mitsuba says of faults that are easily made, and what we say instead.
_COMPLAINTS = (
    (
        r'unreferenced propert\w+ in (\w+) plugin of type "([^"]+)":\s+- \w+ "([^"]+)"',
        r'<\1 type="\2"> has no property "\3"; correct its name or take it out',
    ),
    (
        r'(\w+) plugin of type "([^"]+)": \[PluginManager\] Plugin .* not found',
        r'there is no <\1 type="\2">; correct its type',
    ),
    (
        r'(\w+) plugin of type "([^"]+)": .*Could not find property named "([^"]+)"',
        r'<\1 type="\2"> lacks its "\3"; add it',
    ),
    (
        r'(\w+) plugin of type "([^"]+)": .*file "([^"]+)": file not found',
        r'<\1 type="\2">: there is no file "\3" where "filename" says; correct it',
    ),
    (
        r'could not parse (.*) "([^"]*)"',
        r'"\2" is no \1; correct it, or the parameter that it comes from',
    ),
    (
        r"undefined parameter: (\S+)",
        r"the parameter \1 has no value; give it one, or a <default> in the scene",
    ),
)


@dataclass(frozen=True)
class Scene:
    """A loaded scene.

    Attributes
    ----------
    path : Path
    parameters : dict
        The scene's ``$parameters`` as used, defaults included.
    mitsuba : mitsuba.Scene
    integrator : Refractive
    sensor : SensorModel
    surface : Surface
        Of the part, in float64 where it is the analytic cylinder.
    notes : tuple of str
        What was ignored, converted or assumed when it was loaded.
    """

    path: Path
    parameters: dict[str, str]
    mitsuba: Any
    integrator: Any
    sensor: SensorModel
    surface: Surface
    notes: tuple[str, ...] = ()

    @property
    def field(self) -> IndexField | None:
        """The air; None where light runs straight."""
        return self.integrator.field

    def cold(self) -> "Scene":
        """The same scene in homogeneous air."""
        return self.with_field(None)

    def with_field(self, field: IndexField | None) -> "Scene":
        """The same scene in other air; None: homogeneous, where light runs straight."""
        return replace(self, integrator=self.integrator.with_field(field))

    def at(self, time_s: float) -> "Scene":
        """The same scene in the air of another instant, s, of its field's file.

        Raises
        ------
        InputError
            If it has no field file, or the file does not hold that instant.
        """
        try:
            integrator = self.integrator.at(time_s)
        except InputError as error:
            raise InputError(f"{self.path}: {error}") from None
        time = {"time": f"{time_s:.9g}"} if "time" in self.parameters else {}
        return replace(self, integrator=integrator, parameters=self.parameters | time)


def shipped_scenes() -> Path:
    """Folder of the scenes that come with the program."""
    return Path(str(resources.files("virtual_sensor_scenes")))


def find_scene(name: str | Path) -> Path:
    """A scene's file: a path, or the name of one that comes with the program."""
    path = Path(name)
    shipped = shipped_scenes() / path.with_suffix(".xml").name
    if path.is_file():
        return path
    if path.name == str(name) and shipped.is_file():
        return shipped
    names = ", ".join(sorted(p.stem for p in shipped_scenes().glob("*.xml")))
    raise InputError(f"{name}: there is no such scene file; scenes that come along: {names}")


def load_scene(name: str | Path, **parameters: object) -> Scene:
    """Load a scene.

    Parameters
    ----------
    name : str or Path
        A Mitsuba XML file, or the name of a scene that comes with the program.
    **parameters
        Values for the scene's ``$parameters``, such as ``temperature=1250, beta=15``.

    Raises
    ------
    InputError
        Naming the file, the element and the remedy.
    """
    path = find_scene(name)
    given = {key: str(value) for key, value in parameters.items()}
    values = scene_parameters(path, given)
    loaded = _load(path, given)
    integrator = loaded.integrator()
    if not isinstance(integrator, plugins.refractive.Refractive):
        raise InputError(
            f'{path}: the scene\'s integrator is not "refractive"; put <integrator'
            ' type="refractive"/> in its place'
        )
    try:
        emitter = plugins.refractive.laser_of(loaded)
    except InputError as error:
        raise InputError(f"{path}: {error}") from None
    sensor = SensorModel(_camera(path, loaded), emitter.line)
    return Scene(path, values, loaded, integrator, sensor, _surface(loaded))


def scene_parameters(path: Path, given: dict[str, str]) -> dict[str, str]:
    """The parameters of a scene file, with the given values in place of its defaults.

    Raises
    ------
    InputError
        If the file is no scene, or has no such parameter.
    """
    root = _root(path)
    if root.tag != "scene":
        raise InputError(f"{path}: its root element is <{root.tag}>; a scene's is <scene>")
    defaults = {str(e.get("name")): str(e.get("value")) for e in root.iter("default")}
    used = set(re.findall(r"\$(\w+)", path.read_text(encoding="utf-8")))
    free = [name for name in used if not name.startswith(tuple(defaults))]
    unknown = [k for k in given if k not in defaults and not any(u.startswith(k) for u in free)]
    if unknown:
        names = ", ".join(sorted(defaults)) or "none"
        raise InputError(f"{path}: no parameter '{unknown[0]}'; the scene has: {names}")
    values: dict[str, str] = {}
    for name, value in (defaults | given).items():  # a default may use those before it
        values[name] = _filled(value, values)
    if "temperature" in values:
        try:
            below = float(values["temperature"]) < _ABSOLUTE_ZERO_C
        except ValueError:
            raise InputError(
                f"{path}: temperature={values['temperature']} is not a number; give it in degC"
            ) from None
        if below:
            raise InputError(
                f"{path}: temperature={values['temperature']} degC is below absolute zero"
                f" ({_ABSOLUTE_ZERO_C} degC); give the part's temperature in degC"
            )
    return values


def scene_files(path: Path, values: dict[str, str]) -> list[Path]:
    """Files that a scene file refers to, if they exist: fields, meshes, pictures, other scenes.

    `values` are its parameters' (see `scene_parameters`).

    Raises
    ------
    InputError
        If the file, or a scene that it includes, can't be read.
    """
    found: dict[Path, None] = {}
    open_scenes, folders = [path], {Path(): None, path.parent: None}
    while open_scenes:
        for element in _root(open_scenes.pop()).iter():
            texts = [_filled(text, values) for text in element.attrib.values()]
            if element.tag == "path":
                folders |= {folder / text: None for folder in list(folders) for text in texts}
            for file in (folder / text for folder in folders for text in texts):
                with suppress(OSError, ValueError):  # a text that can't be a file's name
                    if file.is_file() and (file := file.resolve()) not in found:
                        found[file] = None
                        open_scenes += [file] if element.tag == "include" else []
    return list(found)


def _root(path: Path) -> ElementTree.Element:
    try:
        return ElementTree.parse(path).getroot()
    except ElementTree.ParseError as error:
        raise InputError(f"{path}: not well-formed XML ({error}); mend that line") from None
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{path}: can't be read as a scene ({error})") from None


def _filled(text: str, values: dict[str, str]) -> str:
    """A text with values in place of its ``$parameters``."""
    for name in sorted(values, key=len, reverse=True):
        text = text.replace(f"${name}", values[name])
    return text


def _load(path: Path, given: dict[str, str]) -> Any:
    """Load with Mitsuba, and put its complaint in a user's terms."""
    try:
        # Mitsuba 3.9 merges meshes otherwise, and a merged one has no valid bounding box.
        return mi.load_file(str(path), optimize=False, **given)
    except Exception as error:  # Mitsuba raises RuntimeError, and passes on what plugins raise
        text = str(error)
    line = re.search(r"\(line (\d+), col \d+\)", text)
    where = f"{path}, line {line[1]}" if line else str(path)
    if ours := re.search(r"InputError: (.*)", text, re.DOTALL):
        raise InputError(f"{where}: {ours[1].strip()}")
    for pattern, in_our_words in _COMPLAINTS:
        if found := re.search(pattern, text, re.DOTALL):
            raise InputError(f"{where}: {found.expand(in_our_words)}")
    reason = re.split(r"hile loading .*? \(line \d+, col \d+\): |\[[\w.:]+\] ", text)[-1]
    raise InputError(f"{where}: Mitsuba can't load the scene: {reason.strip()}")


def _camera(path: Path, loaded: Any) -> Camera:
    """K and pose of the scene's only camera, from what Mitsuba holds."""
    sensors = loaded.sensors()
    if len(sensors) != 1:
        raise InputError(f"{path}: {len(sensors)} sensors; the scene must have one")
    held = mi.traverse(sensors[0])
    if "x_fov" not in held or "aperture_radius" in held:
        raise InputError(f'{path}: its camera must be <sensor type="perspective">, a pinhole')
    film = sensors[0].film()
    width, height = (int(n) for n in film.size())
    if min(width, height) < 1:
        raise InputError(f"{path}: <film> of {width} x {height} px; give a width and a height")
    if [int(n) for n in film.crop_size()] != [width, height]:
        raise InputError(f"{path}: the film is cropped; give the whole film")
    focal_px = width / 2.0 / np.tan(np.radians(float(np.ravel(held["x_fov"])[0])) / 2.0)
    shift_x = float(np.ravel(held["principal_point_offset_x"])[0])
    shift_y = float(np.ravel(held["principal_point_offset_y"])[0])
    # Mitsuba's pixel i reaches from i to i + 1, ours has its centre at i; its shift moves the film.
    centre = (width * (0.5 - shift_x) - 0.5, height * (0.5 - shift_y) - 0.5)
    matrix = np.array([[focal_px, 0.0, centre[0]], [0.0, focal_px, centre[1]], [0.0, 0.0, 1.0]])
    to_world = np.array(sensors[0].world_transform().matrix, float).reshape(-1)[:16].reshape(4, 4)
    pose = Pose.from_matrix(to_world)
    pose = replace(pose, rotation=pose.rotation @ _OURS_FROM_MITSUBAS)
    return Camera(matrix, pose, (width, height))


def _surface(loaded: Any) -> Surface:
    """The analytic cylinder, if the part is one along x with end faces; else Mitsuba's shapes."""
    places: dict[str, list[NDArray[np.float64]]] = {}
    for shape in loaded.shapes():
        held = mi.traverse(shape)
        if "to_world" not in held:
            return SceneSurface(loaded)
        place = np.array(held["to_world"].matrix, float).reshape(4, 4)
        places.setdefault(str(shape).split("[", 1)[0], []).append(place)
    if {kind: len(each) for kind, each in places.items()} == {"Cylinder": 1, "Disk": 2}:
        (tube,) = places["Cylinder"]
        radius, along, start = np.linalg.norm(tube[:3, 0]), tube[:3, 2], tube[:3, 3]
        ends = sorted((disk[:3, 3] for disk in places["Disk"]), key=lambda end: end @ along)
        closed = np.allclose(ends, [start, start + along], atol=_SAME_MM) and all(
            np.allclose(np.linalg.norm(disk[:3, :2], axis=0), radius, atol=_SAME_MM)
            and np.allclose(disk[0, :2], 0.0, atol=_SAME_MM)
            for disk in places["Disk"]
        )
        middle = start + along / 2.0
        if closed and np.allclose([middle[0], *along[1:]], 0.0, atol=_SAME_MM):
            half = float(abs(along[0])) / 2.0
            return Cylinder(round(float(radius), 6), half, float(middle[1]), float(middle[2]))
    return SceneSurface(loaded)
