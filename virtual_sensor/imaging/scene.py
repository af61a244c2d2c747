"""From a scene file to what the program works with; the only place that loads a scene.

The sensor model is read *from* the loaded Mitsuba scene, so the two can't disagree.

===============================  ==================================================================
Element of a scene               What becomes of it
===============================  ==================================================================
integrator                       `refractive`, and no other
sensor                           one `perspective`, a pinhole; a mirrored one is heeded, with a note
film                             the whole one, no crop; one beyond the memory is refused
emitter                          one `laser_line`; others light the part too
shape of a file: ply, obj, stl   checked, and read where Mitsuba can't: `imaging.parts`
other shapes, bsdf, texture      heeded, by Mitsuba
to_world of sensor and laser     turns, moves and mirrors; scale and shear are refused
medium                           ignored, with a note
numbers                          what is not finite is refused
lengths                          in mm; a scene that seems to be in metres gets a note
===============================  ==================================================================

`virtual_sensor.imaging.scene_file` says what becomes of the XML itself.
"""

import re
from dataclasses import dataclass, replace
from importlib import resources
from pathlib import Path
from typing import Any

import numpy as np
import virtual_sensor_plugins as plugins
from numpy.typing import NDArray

from virtual_sensor.arrays import to_vectors
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.files import exists, readable
from virtual_sensor.imaging.loading import load
from virtual_sensor.imaging.scene_file import (
    SceneFile,
    filled,
    included,
    read_scene_file,
    shortened,
)
from virtual_sensor.medium.description import MediumDescription
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.sensor_model import Camera, Pose, SensorModel
from virtual_sensor.optics.surfaces import Cylinder, SceneSurface, Surface
from virtual_sensor.optics.transports import Transport

# Mitsuba's camera has x to the left and y up; ours has x along u and y along v, with z forward.
_OURS_FROM_MITSUBAS = np.diag([-1.0, -1.0, 1.0])
_ABSOLUTE_ZERO_C = -273.15
_SAME_MM = 1e-4  # float32 leaves so much doubt of a place
_CLEARANCE_MM = 0.01
_METRES_MM = 2.0, 5.0  # a part no larger, and a camera no farther: scenes in metres are so


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

    @property
    def air(self) -> MediumDescription:
        """Where the field comes from: its file, and what is made of it."""
        description: MediumDescription = self.integrator.air
        return description

    @property
    def transport(self) -> Transport:
        """How bent rays are found."""
        transport: Transport = self.integrator.transport
        return transport

    def with_transport(self, transport: Transport) -> "Scene":
        """The same scene by another transport of light."""
        return replace(self, integrator=self.integrator.with_transport(transport))

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
    shipped = {file.stem: file for file in sorted(shipped_scenes().glob("*.xml"))}
    if name and exists(path) and (path.is_file() or path.stem not in shipped):
        return readable(path)
    if path.name == str(name) and path.stem in shipped:
        return shipped[path.stem]
    raise InputError(
        f"{shortened(str(name))}: there is no such scene file; scenes that come along:"
        f" {', '.join(shipped)}"
    )


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
    files, values = _read(path, given)
    loaded, notes = load(files, given, values)
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
    _check_samples(files, values, loaded)
    notes = [*(note for file in files for note in file.notes), *notes]
    notes += _places(path, loaded, sensor)
    notes += integrator.field.notes if integrator.field else ()
    return Scene(path, values, loaded, integrator, sensor, _surface(loaded), tuple(notes))


def scene_parameters(path: Path, given: dict[str, str]) -> dict[str, str]:
    """The parameters of a scene file, with the given values in place of its defaults.

    Raises
    ------
    InputError
        If the file is no scene, or has no such parameter.
    """
    return _read(path, given)[1]


def _read(path: Path, given: dict[str, str]) -> tuple[list[SceneFile], dict[str, str]]:
    """A scene file with those that it includes, and the values of its parameters."""
    file = read_scene_file(path)
    root = file.elements[0]
    if root.tag != "scene":
        raise InputError(
            f"{path}: its root element is <{shortened(root.tag)}>; a scene's is <scene>"
        )
    files, values = [file], _values([file], given)
    for inner, _ in included(file, _folders(path), values, (path.resolve(),)):
        files.append(inner)
        values = _values(files, given)
    defaults = {e.attributes["name"] for file in files for e in file.elements if e.tag == "default"}
    used = {
        name
        for file in files
        for e in file.elements
        for text in e.attributes.values()
        for name in re.findall(r"\$(\w+)", text)
    }
    free = [name for name in used if not name.startswith(tuple(defaults))]
    unknown = [k for k in given if k not in defaults and not any(u.startswith(k) for u in free)]
    if unknown:
        names = ", ".join(sorted(defaults)) or "none"
        raise InputError(f"{path}: no parameter '{shortened(unknown[0])}'; the scene has: {names}")
    if "temperature" in values:
        _check_temperature(path, values["temperature"])
    return files, values


def _values(files: list[SceneFile], given: dict[str, str]) -> dict[str, str]:
    """Values of the parameters: as given, else by default; a default may use those before it."""
    texts: dict[str, str] = {}
    for element in (e for file in files for e in file.elements if e.tag == "default"):
        name, value = (element.attributes.get(key) for key in ("name", "value"))
        if not name or value is None:
            raise InputError(f"{element.where}: <default> needs a name and a value; give both")
        texts.setdefault(name, value)
    values: dict[str, str] = {}
    for name, text in (texts | given).items():
        if "\0" in text:
            raise InputError(f"{files[0].elements[0].file}: {name} has a zero byte; take it out")
        try:
            values[name] = filled(text, values)
        except InputError as error:
            raise InputError(f"{files[0].elements[0].file}: {error}") from None
    return values


def _check_temperature(path: Path, text: str) -> None:
    try:
        temperature = float(text)
    except ValueError:
        raise InputError(
            f"{path}: temperature={shortened(text)} is not a number; give it in degC"
        ) from None
    if temperature < _ABSOLUTE_ZERO_C:
        raise InputError(
            f"{path}: temperature={text} degC is below absolute zero"
            f" ({_ABSOLUTE_ZERO_C} degC); give the part's temperature in degC"
        )
    if not np.isfinite(temperature):
        raise InputError(f"{path}: temperature={text} is not a finite number; give it in degC")


def scene_files(path: Path, values: dict[str, str]) -> list[Path]:
    """Files that a scene file refers to, if they exist: fields, meshes, pictures, other scenes.

    `values` are its parameters' (see `scene_parameters`).

    Raises
    ------
    InputError
        If the file, or a scene that it includes, can't be read.
    """
    found: dict[Path, None] = {}
    folders, parents = _folders(path), (path.resolve(),)
    file = read_scene_file(path)
    for inner, _ in [(file, parents), *included(file, folders, values, parents)]:
        for element in inner.elements:
            texts = [filled(text, values) for text in element.attributes.values()]
            for place in (folder / text for folder in folders for text in texts):
                if exists(place) and place.is_file():
                    found[place.resolve()] = None
    return list(found)


def _folders(path: Path) -> dict[Path, None]:
    """Where the files that a scene refers to may be."""
    return {Path(): None, path.parent: None}


def _places(path: Path, loaded: Any, sensor: SensorModel) -> list[str]:
    """Notes of a scene whose lengths seem to be in metres."""
    box = loaded.bbox()
    corners = np.array([box.min, box.max], float)
    if not (np.isfinite(corners).all() and np.all(corners[0] <= corners[1])):
        raise InputError(f"{path}: its shapes have no finite size; give the scene a part")
    _check_clearance(path, loaded, sensor.camera.pose.origin_mm)
    size, middle = np.max(corners[1] - corners[0]), corners.mean(axis=0)
    distance = np.linalg.norm(sensor.camera.pose.origin_mm - middle)
    if size > _METRES_MM[0] or distance > _METRES_MM[1]:
        return []
    return [
        f"{path}: the part is {size:.2g} mm in size and the camera {distance:.2g} mm away; lengths"
        " are in mm: is the scene in metres?"
    ]


def _check_clearance(path: Path, loaded: Any, place_mm: NDArray[np.float64]) -> None:
    """A camera that touches a shape sees nothing but that, at no distance."""
    steps = np.array([s for s in np.ndindex(3, 3, 3) if s != (1, 1, 1)]) - 1.0
    unit = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    start = place_mm - _CLEARANCE_MM * unit
    met = SceneSurface(loaded).distance(
        to_vectors(start), to_vectors(unit), 2.0 * _CLEARANCE_MM, True
    )
    if np.isfinite(np.array(met)).any():
        raise InputError(
            f"{path}: <sensor>: the camera stands on a surface; move it away from it (to_world)"
        )


def _check_samples(files: list[SceneFile], values: dict[str, str], loaded: Any) -> None:
    """Samplers round a number that they can't do, and the frame is not of the number given."""
    taken = str(loaded.sensors()[0].sampler().sample_count())
    for element in (e for file in files for e in file.elements):
        if element.tag != "integer" or element.attributes.get("name") != "sample_count":
            continue
        asked = filled(element.attributes.get("value", ""), values).strip()
        if asked != taken or not int(taken):
            raise InputError(
                f"{element.where}: a sample_count of {shortened(asked)}: this <sampler> would take"
                f" {taken}; give a number that it has (spp), such as 1, 4, 9 or 16"
            )


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
