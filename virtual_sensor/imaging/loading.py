"""A scene's text to Mitsuba's objects, checked meanwhile; errors in a user's terms."""

import re
from collections.abc import Iterator, Mapping
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from functools import lru_cache
from itertools import chain, count
from pathlib import Path
from typing import Any
from xml.sax.saxutils import escape

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins.properties import folders_of_files
from virtual_sensor_plugins.renderer import is_source

from virtual_sensor import interrupts
from virtual_sensor.child import physical_memory
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.display import Displayed
from virtual_sensor.engine import dr, mi
from virtual_sensor.errors import InputError, naming
from virtual_sensor.files import exists, readable, scratch_folder, sha256_of
from virtual_sensor.imaging.expansion import grow
from virtual_sensor.imaging.materials import goes_by_coordinates, name_material, with_coordinates
from virtual_sensor.imaging.part_kinds import AS_MESH, EXACT_KINDS, KINDS
from virtual_sensor.imaging.part_survey import faults
from virtual_sensor.imaging.parts import Part, read_part
from virtual_sensor.imaging.scene_file import (
    MATERIAL,
    Element,
    SceneFile,
    filled,
    shortened,
)
from virtual_sensor.medium.find_field import find_field, is_installed

_FAR_MM = 1e6  # beyond, float32 leaves a doubt of 0.06 mm
_RIGID = 1e-3  # of what a rotation's columns may differ from one by float32 and typed digits
_LONGEST_WORD = 300  # of a message, such as a path
_CHECKED_BY_PLUGIN = {  # and what they may be is said
    *(
        ("laser_line", name)
        for name in (
            *("distance", "length", "radius", "power", "fan", "uniformity", "wavelength"),
            *("waist_distance", "beam_quality", "rayleigh_length"),
            *("linewidth", "roughness", "modes"),
        )
    ),
    *(
        ("pattern_projector", name)
        for name in (
            *("fov", "focal_length", "pixel", "image_width", "power", "lumen", "wavelength"),
            *("principal_point_offset_x", "principal_point_offset_y"),
            *("contrast", "gamma", "defocus"),
        )
    ),
    *(("lens_camera", name) for name in ("transmission", "pixel", "image_distance", "f_number")),
    *(("lens_camera", name) for name in ("focus_distance", "focal_length")),
    ("refractive", "tolerance"),
}
_OF_SURFACES: dict[str, tuple[float, float, str]] = {  # what Mitsuba takes without a word
    **dict.fromkeys(
        ("alpha", "alpha_u", "alpha_v"),
        (1e-4, 1.0, "a roughness above 0 and up to 1, such as 0.2"),
    ),
    **dict.fromkeys(
        ("reflectance", "diffuse_reflectance", "specular_reflectance"),
        (0.0, 1.0, "a share from 0 to 1"),
    ),
    "k": (0.0, np.inf, "a number that is not negative"),
}
_DEVICES = "laser_line", "pattern_projector"  # emitters that are made of one
_PARTS_CACHED = 8
_WATERTIGHT = "embree_use_robust_intersections"
_LARGEST = 1e30  # float32 ends at 3e38
_PIXEL_BYTES = 64  # of a frame with its truth, at least

# What Mitsuba says of faults that are easily made, and what we say instead.
_COMPLAINTS = (
    (
        r'unreferenced propert\w+ in (\w+) plugin of type "([^"]+)":\s+- object ',
        r'<\1 type="\2"> has no use for an element that is in it; take that out',
    ),
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
    (
        r'unresolved reference to "([^"]*)"',
        r'<ref id="\1"/>: no element has this id; correct it',
    ),
    (
        r'duplicate ID(?: in included file "[^"]*")?: "([^"]*)"',
        r'two elements have the id "\1"; give one another',
    ),
    (
        r'missing required attribute "([^"]+)" in <(\w+)>',
        r'<\2> lacks its attribute "\1"; add it',
    ),
    (
        r"invalid lookat transformation",
        "<lookat>: its origin is its target, or it looks along its up; change one (distance=0?)",
    ),
    (
        r'included file "([^"]*)" not found',
        r'<include>: there is no file "\1" where "filename" says; correct it',
    ),
    (
        r"unsupported XML element: <([^>]*)>",
        r"a scene knows no element <\1>; correct its name or take it out",
    ),
)


@dataclass(frozen=True)
class Loaded(Displayed):
    """What Mitsuba made of a scene.

    Attributes
    ----------
    scene : mitsuba.Scene
    cameras : dict
        Its sensors by their names: their `id`s, or made up where they have none.
    sources : dict
        Likewise its emitters that are made of a device, such as `laser_line`.
    notes : tuple of str
    """

    scene: Any
    cameras: dict[str, Any]
    sources: dict[str, Any]
    notes: tuple[str, ...]


@contextmanager
def _among(folder: Path, here: Path, more: list[Path]) -> Iterator[Any]:
    """Let Mitsuba find files in a folder, in the one where a scene was loaded, and in more."""
    before = mi.file_resolver()
    resolver = mi.FileResolver(before)
    with suppress(FileNotFoundError):  # a working folder that is gone
        resolver.prepend(str(here.absolute()))
        resolver.prepend(str(folder.absolute()))
        for other in more:
            resolver.append(str(other.absolute()))
    mi.set_file_resolver(resolver)
    try:
        yield resolver
    finally:
        mi.set_file_resolver(before)


class _Listener(mi.Appender):
    """Collects Mitsuba's warnings, which it would print."""

    def __init__(self) -> None:
        super().__init__()
        self.heard: list[str] = []

    def append(self, level: Any, text: str) -> None:
        """Collect a line of the log."""
        self.heard.append(text)

    def log_progress(self, *progress: Any) -> None:
        """Nothing: loading is quick."""


@contextmanager
def _listening() -> Iterator[list[str]]:
    """Collect Mitsuba's warnings instead of printing them."""
    logger, listener = mi.logger(), _Listener()
    before = [logger.appender(number) for number in range(logger.appender_count())]
    logger.clear_appenders()
    logger.add_appender(listener)
    try:
        yield listener.heard
    finally:
        logger.clear_appenders()
        for appender in before:
            logger.add_appender(appender)


@contextmanager
def _never_alone() -> Iterator[None]:
    """Give Mitsuba two threads at least: to read an OpenEXR file one waits for another."""
    threads = dr.thread_count()
    dr.set_thread_count(max(threads, 2))
    try:
        yield
    finally:
        dr.set_thread_count(threads)


def warnings_of(main: Path, heard: list[str]) -> list[str]:
    """Notes of Mitsuba's warnings; refuse a shape that is not what the scene says."""
    notes = []
    for line in dict.fromkeys(re.sub(r"^.*? WARN +", "", text) for text in heard):
        if found := re.match(r"\[(\w+)\] 'to_world' transform shouldn't contain (.*?)!", line):
            raise InputError(
                f'{main}: <shape type="{found[1].lower()}">: to_world has {found[2]}, and Mitsuba'
                " would draw another shape; turn, move and scale evenly, or give a mesh"
            )
        if "Monochrome mode" not in line:  # whose one channel is what is wanted
            notes.append(shortened(f"{main}: {line}", _LONGEST_WORD))
    return notes


def load(
    files: list[SceneFile],
    given: dict[str, str],
    values: dict[str, str],
    here: Path,
    poses: Mapping[str, NDArray[np.float64]],
    material: Path | None = None,
) -> Loaded:
    """Load with Mitsuba, and put its errors in a user's terms.

    Parameters
    ----------
    files : list of SceneFile
        The scene's, and those that it includes.
    given, values : dict
        Those of its parameters that are no defaults, and all.
    here : Path
        Folder from which relative paths start, beside the scene's own.
    poses : Mapping
        By the names of cameras and sources: matrices (4, 4) in place of their `to_world`.
    material : Path, optional
        File of the material, which the first file includes.
    """
    main = files[0].elements[0].file
    config = mi.parser.ParserConfig(mi.variant())
    # Mitsuba 3.9 merges meshes otherwise, and a merged one has no valid bounding box.
    config.merge_equivalent = config.merge_meshes = False
    config.unused_parameters = mi.LogLevel.Debug  # such as those that `fov` is worked out from
    text, more = files[0].text, [material.parent] if material else []
    if material:
        text = text.replace(MATERIAL, escape(f"{material.absolute()}", {'"': "&quot;"}))
    with _among(main.parent, here, more), ExitStack() as temporary, _listening() as heard:
        try:
            state = mi.parser.parse_string(config, text, **values)
            if material:
                name_material(state, material)
            _name(state)
            _place(state, poses)
            _find_field(main, state, given)
            notes = [
                note for node in state.nodes for note in _check_node(main, state, node, values)
            ]
            notes += _grow(main, state)
            notes += _prepare_parts(main, state, temporary)
            notes += _check_films(main, state)
            samples = _samples(main, state)
            for node in state.nodes:  # reading marks as used, and what nothing uses is a fault
                for name in list(node.props.keys()):
                    node.props.mark_queried(name, False)
            _let_no_ray_through(state)
            mi.parser.transform_all(config, state)
            with _never_alone():
                scene = mi.parser.instantiate(config, state)
            notes += warnings_of(main, heard)
            cameras = {sensor.id(): sensor for sensor in scene.sensors()}
            sources = {each.id(): each for each in scene.emitters() if is_source(each)}
            _check_samples(cameras, samples)
            _focus_lasers(main, cameras, sources)
            return Loaded(scene, cameras, sources, tuple(notes))
        except InputError:
            raise
        except Exception as error:  # RuntimeError, and what plugins raise is passed on
            text = str(error)
    interrupts.raised_again(text)
    raise _in_users_terms(text, main, [e for file in files for e in file.elements], values)


def _let_no_ray_through(state: Any) -> None:
    """Have rays that meet a mesh in an edge of its triangles meet it: Embree lets some through."""
    for node in state.nodes:
        if node.type == mi.ObjectType.Scene:
            node.props[_WATERTIGHT] = True
            node.props.mark_queried(_WATERTIGHT)  # other engines than Embree don't ask


def _name(state: Any) -> None:
    """Give the sensors and emitters without an `id` one: "camera", "laser", "laser_2" and so on.

    Of a `laser_line` it is "laser", of a `pattern_projector` "projector".
    """
    taken = {node.props.id() for node in state.nodes}
    for node in state.nodes:
        if node.props.id() or node.type not in (mi.ObjectType.Sensor, mi.ObjectType.Emitter):
            continue
        kind = "camera" if node.type == mi.ObjectType.Sensor else node.props.plugin_name()
        kind = kind.removesuffix("_line").removeprefix("pattern_")
        numbered = (f"{kind}_{number}" for number in count(2))
        node.props.set_id(next(name for name in chain([kind], numbered) if name not in taken))
        taken.add(node.props.id())


def _parts(state: Any, node: Any, kind: Any) -> list[Any]:
    """Nodes of a kind within a node."""
    props, resolved = node.props, mi.Properties.Type.ResolvedReference
    inner = [props[name].index() for name in props.keys() if props.type(name) == resolved]  # noqa: SIM118
    return [state.nodes[index] for index in inner if state.nodes[index].type == kind]


def _check_films(main: Path, state: Any) -> list[str]:
    """Notes of sensors without a film."""
    return [
        f"{_where(main, state, node)} has no <film>; Mitsuba's of 768 x 576 px is taken"
        for node in state.nodes
        if node.type == mi.ObjectType.Sensor and not _parts(state, node, mi.ObjectType.Film)
    ]


def _samples(main: Path, state: Any) -> dict[str, tuple[str, int]]:
    """Samples a pixel that sensors' samplers are asked for, by the sensors' names, and where."""
    return {
        node.props.id(): (_where(main, state, sampler), int(sampler.props["sample_count"]))
        for node in state.nodes
        if node.type == mi.ObjectType.Sensor
        for sampler in _parts(state, node, mi.ObjectType.Sampler)
        if "sample_count" in sampler.props
    }


def _check_samples(cameras: dict[str, Any], samples: dict[str, tuple[str, int]]) -> None:
    """Refuse a number of samples that the sampler would round."""
    for name, (where, asked) in samples.items():
        taken = int(cameras[name].sampler().sample_count())
        if asked != taken or not taken:
            raise InputError(
                f"{where}: a sample_count of {asked}: it would take {taken}; give a number that it"
                " has (spp), such as 1, 4, 9 or 16"
            )


def _focus_lasers(main: Path, cameras: dict[str, Any], sources: dict[str, Any]) -> None:
    """Have cameras whose tilt is "laser_plane" focus that of the only laser."""
    for name, sensor in cameras.items():
        if not getattr(sensor, "focuses_laser", False):
            continue
        where = f'{main}: <sensor id="{shortened(name)}">'
        lasers = [s.source for s in sources.values() if isinstance(s.source, LaserLine)]
        if len(lasers) != 1:
            raise InputError(
                f"{where}: 'tilt' is laser_plane, and the scene has {len(lasers)} laser lines; give"
                " the tilt in degrees"
            )
        with naming(where):
            sensor.focus_laser(*lasers[0].plane)


def _place(state: Any, poses: Mapping[str, NDArray[np.float64]]) -> None:
    """Move named elements."""
    for node in state.nodes:
        if node.props.id() not in poses:
            continue
        if "to_world" in node.props:
            del node.props["to_world"]
        node.props["to_world"] = mi.ScalarAffineTransform4d(poses[node.props.id()])


def _find_field(main: Path, state: Any, given: dict[str, str]) -> None:
    """Have the integrator's field named by its path.

    A field that a parameter gives is not looked for beside a shipped scene before all else: there
    may be one of that name where the user stands.
    """
    for node in state.nodes:
        name = str(node.props.get("field", "")) if node.props.plugin_name() == "refractive" else ""
        if name:
            folders = folders_of_files()
            if name in given.values():
                folders = sorted(folders, key=is_installed)
            with naming(_where(main, state, node)):
                node.props["field"] = str(find_field(name, folders).absolute())


def _in_users_terms(
    text: str, main: Path, elements: list[Element], values: dict[str, str]
) -> InputError:
    """Mitsuba's error in a user's terms."""
    places = re.findall(r"(?:At|ading) (\S[^\n]*?) \(line (\d+), col \d+\)", text)
    file, line = places[-1] if places else ("", "")
    where = f"{main if file in ('', 'string') else file}" + (f", line {line}" if line else "")
    if kind := re.search(r'(\w+) plugin of type "([^"]*)"', text):
        # Of an element in an included file Mitsuba names the line in the wrong file.
        alike = [
            e
            for e in elements
            if e.tag == kind[1] and filled(e.attributes.get("type", ""), values) == kind[2]
        ]
        if alike and where not in [element.where for element in alike]:
            where = alike[0].where
    if ours := re.search(r"InputError: (.*)", text, re.DOTALL):
        return InputError(shortened(f"{where}: {ours[1].strip()}", _LONGEST_WORD))
    for pattern, in_our_words in _COMPLAINTS:
        if found := re.search(pattern, text, re.DOTALL):
            given = _with_value(found[found.re.groups], values)
            said = f"{where}: {found.expand(in_our_words)}{given}"
            return InputError(shortened(said, _LONGEST_WORD))
    if raised := re.findall(r"^(\w[\w.]*(?:Error|Exception)\b.*)", text, re.MULTILINE):
        text = raised[-1]  # by a plugin, below its traceback
    reason = re.split(r"ading .*? \(line \d+, col \d+\): |\[[\w.:]+\] ", text)[-1]
    reason = " ".join(shortened(reason).split())
    return InputError(f"{where}: Mitsuba can't load the scene: {reason[:300]}")


def _with_value(text: str, values: dict[str, str]) -> str:
    """The parameters that have a value, for messages."""
    named = [f"{name}={shortened(value)}" for name, value in values.items() if value == text]
    return f" ({', '.join(named)})" if named else ""


def _where(main: Path, state: Any, node: Any) -> str:
    """File, line and element of a parsed node, for messages."""
    if node.file_index:  # of an included file Mitsuba counts the lines in the wrong one
        file = Path(str(state.files[node.file_index]))
        number = file.read_bytes()[: node.offset].count(b"\n") + 1
        line = f"{file}, line {number}"
    else:
        place = re.search(r" \(line (\d+), col \d+\)$", mi.parser.file_location(state, node))
        line = f"{main}, line {place[1]}" if place else f"{main}"
    return f'{line}: <{node.type.name.lower()} type="{shortened(node.props.plugin_name())}">'


def _check_node(main: Path, state: Any, node: Any, values: dict[str, str]) -> list[str]:
    """Refuse what would crash Mitsuba or give wrong numbers; return notes."""
    props, where, notes = node.props, _where(main, state, node), []
    kind, types = props.plugin_name(), mi.Properties.Type
    for name in list(props.keys()):
        if props.type(name) == types.Transform:
            numbers = np.array(props[name].matrix, float)
        elif props.type(name) == types.Spectrum:
            numbers = np.array(props[name].values, float)
        elif (
            props.type(name) in (types.Float, types.Vector, types.Color)
            and (kind, name) not in _CHECKED_BY_PLUGIN
        ):
            numbers = np.array(props[name], float)
        else:
            continue
        if not np.all(np.abs(numbers) < _LARGEST):
            raise InputError(f"{where}: {name} is not a finite number{_culprit(values)}; give one")
        if node.type == mi.ObjectType.BSDF and name in _OF_SURFACES:
            low, high, words = _OF_SURFACES[name]
            if not np.all((numbers >= low) & (numbers <= high)):
                raise InputError(f"{where}: {name} is {numbers.ravel()[0]:g}; give {words}")
        camera = node.type == mi.ObjectType.Sensor
        if name == "to_world" and (camera or kind in _DEVICES):
            notes += _check_pose(where, numbers.reshape(-1)[:16].reshape(4, 4), camera)
    if node.type == mi.ObjectType.Film:
        _check_film(where, int(props.get("width", 768)), int(props.get("height", 576)))
    if node.type == mi.ObjectType.BSDF and str(props.get("material", "none")) != "none":
        notes.append(
            f"{where}: n and k of {props['material']} are taken as means of all visible light, not"
            " at the light's wavelength; give them (eta, k)"
        )
    if node.type == mi.ObjectType.Medium:
        notes.append(f"{where}: ignored; light meets the field of the integrator and no medium")
    return notes


def _culprit(values: dict[str, str]) -> str:
    """The parameters that are not finite, or nearly so."""
    found = []
    for name, text in values.items():
        with suppress(ValueError):
            if not abs(float(text)) < _LARGEST:
                found.append(shortened(f"{name}={text}"))
    return f" ({', '.join(found)})" if found else ""


def _check_pose(where: str, matrix: NDArray[np.float64], camera: bool) -> list[str]:
    """Refuse a pose beyond reason, or a camera's that scales or shears; note one that mirrors."""
    turn, place = matrix[:3, :3], matrix[:3, 3]
    if camera and not np.allclose(turn.T @ turn, np.eye(3), atol=_RIGID):  # a source says so itself
        raise InputError(f"{where}: to_world scales or shears; turn and move, and no more")
    if np.max(np.abs(place)) > _FAR_MM:
        raise InputError(
            f"{where}: to_world puts it {np.max(np.abs(place)):.3g} mm from the origin; lengths are"
            f" in mm, up to {_FAR_MM:g}"
        )
    return [f"{where}: to_world mirrors it"] if np.linalg.det(turn) < 0.0 else []


def _check_film(where: str, width: int, height: int) -> None:
    memory = physical_memory()
    if width * height * _PIXEL_BYTES > memory:
        raise InputError(
            f"{where}: a film of {width} x {height} px needs {width * height * _PIXEL_BYTES:.2g}"
            f" bytes or more, and this machine has {memory:.2g}; give a smaller one"
        )


def _grow(main: Path, state: Any) -> list[str]:
    """Have shapes grow whose glow has an expansion; give notes of it."""
    said = dict.fromkeys(
        grow(node, glow, _where(main, state, glow))
        for node in state.nodes
        if node.type == mi.ObjectType.Shape
        for glow in _parts(state, node, mi.ObjectType.Emitter)
        if glow.props.plugin_name() == "glow"
    )
    return [f"{main}: {note}" for note in said if note]


def _prepare_parts(main: Path, state: Any, temporary: ExitStack) -> list[str]:
    """Check files of parts, and give Mitsuba those that it can't read as files that it can."""
    notes: list[str] = []
    folder: Path | None = None
    for number, node in enumerate(state.nodes):
        props, kind = node.props, node.props.plugin_name()
        if node.type == mi.ObjectType.Shape and kind in EXACT_KINDS:
            raise InputError(f"{_where(main, state, node)} is of exact surfaces; {AS_MESH}")
        if node.type != mi.ObjectType.Shape or kind not in KINDS:
            continue
        where = _where(main, state, node)
        if "filename" not in props:
            raise InputError(f'{where} lacks its "filename"; add it')
        name = str(props["filename"])
        file = Path(str(mi.file_resolver().resolve(name)))
        if not name or not exists(file):
            raise InputError(
                f'{where}: there is no file "{shortened(name)}" where "filename" says; correct it'
            )
        to_world = np.eye(4)
        if "to_world" in props:
            to_world = np.array(props["to_world"].matrix, float).reshape(4, 4)
        with naming(where):
            digest = sha256_of(readable(file))
            found, ply = _prepared(file, kind, digest, tuple(to_world.ravel().tolist()))
        notes += found
        mapped = goes_by_coordinates(state, node)
        if not (ply or mapped):
            continue
        folder = folder or temporary.enter_context(scratch_folder())
        if ply:
            _exchange(props, folder / f"{number}.ply", ply)
        if mapped:
            mesh = mi.load_dict(
                {"type": props.plugin_name()}
                | {name: props[name] for name in ("filename", "to_world") if name in props}
                | {"face_normals": bool(props.get("face_normals", False))}
            )
            if not mesh.has_vertex_texcoords():
                _exchange(props, folder / f"{number}_mapped.ply", with_coordinates(mesh))
                notes.append(
                    f"{where} has no texture coordinates: its material is laid on along the axes,"
                    " in mm, the lay of its surface along x"
                )
    return notes


def _exchange(props: mi.Properties, file: Path, ply: bytes) -> None:
    """Have a shape read another file, in the scene's own place."""
    file.write_bytes(ply)
    if "to_world" in props:
        del props["to_world"]
    props.set_plugin_name("ply")
    props["filename"] = str(file)


@lru_cache(maxsize=_PARTS_CACHED)  # a sensor that moves has its scene loaded again, its part stays
def _prepared(
    file: Path, kind: str, digest: str, to_world: tuple[float, ...]
) -> tuple[tuple[str, ...], bytes]:
    """Notes of a part's file of this digest, and a file for Mitsuba; b"" if it reads the part's."""
    part, matrix = read_part(file, kind), np.array(to_world).reshape(4, 4)
    placed = part.placed(matrix)
    notes = *part.notes, *(f"{file}: {fault}" for fault in faults(placed))
    if part.by_mitsuba and np.linalg.det(matrix[:3, :3]) > 0.0:
        return notes, b""
    return notes, _ply(placed)


def _ply(part: Part) -> bytes:
    """A part as a file that Mitsuba reads."""
    import trimesh  # most scenes have no such part

    mesh = trimesh.Trimesh(part.vertices, part.faces, vertex_normals=part.normals, process=False)
    return bytes(mesh.export(file_type="ply", vertex_normal=part.normals is not None))
