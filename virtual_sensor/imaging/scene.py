"""From a scene file to what the program works with; the only place that loads a scene.

The sensor model is read *from* the loaded Mitsuba scene, so the two can't disagree.

===============================  ==================================================================
Element of a scene               What becomes of it
===============================  ==================================================================
integrator                       `refractive`, and no other
sensor                           a camera, if it is a `lens_camera`, a `perspective`, which is a
                                 pinhole, or a `thinlens`, whose film's width is assumed, with a
                                 note; others are left out, with a note; a mirrored one is heeded,
                                 with a note
film                             the whole one, no crop; one beyond the memory is refused
emitter                          a source, if it is a `laser_line` or a `pattern_projector`; others
                                 light the part too
id                               the name of a camera or a source; those without one get a name
shape of a file: stl, obj, ply,  checked, and read where Mitsuba can't: `imaging.parts`
3mf
other shapes, bsdf, texture      heeded, by Mitsuba
expansion of a shape's glow      heeded: `imaging.expansion`
to_world of sensor and source    turns, moves and mirrors; scale and shear are refused
to_world of the integrator       turns and moves the air
medium                           ignored, with a note
numbers                          what is not finite is refused
lengths                          in mm; a scene, or a part, that seems to be in another unit gets a
                                 note
===============================  ==================================================================

`virtual_sensor.imaging.scene_file` says what becomes of the XML itself.
"""

from __future__ import annotations

import dataclasses
import importlib
import pickle
import re
import shlex
from collections.abc import Hashable, Iterable, Mapping
from contextlib import suppress
from dataclasses import dataclass, replace
from pathlib import Path
from types import MappingProxyType
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from virtual_sensor_plugins import refractive
from virtual_sensor_plugins.views import OURS_FROM_MITSUBAS, THIN_LENS_FILM_MM, camera_of

from virtual_sensor import engine
from virtual_sensor.arrays import LARGEST, number_within, to_vectors
from virtual_sensor.calls import public
from virtual_sensor.devices.camera import LensCamera
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.devices.laser_profile import MeasuredProfile, profile_of
from virtual_sensor.devices.projector import Projector
from virtual_sensor.devices.sensor import SensorModel
from virtual_sensor.display import Displayed, listed
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError, naming, nearest, short
from virtual_sensor.files import exists, sha256_of
from virtual_sensor.imaging.camera_parameters import with_field_of_view
from virtual_sensor.imaging.field_notes import field_notes
from virtual_sensor.imaging.field_solid import (
    SolidFit,
    fit_of,
    solid_in_file,
    solid_of,
    wrong_scale,
)
from virtual_sensor.imaging.loading import Loaded, load
from virtual_sensor.imaging.materials import (
    check_material,
    materials_with,
    with_index_of_iron,
)
from virtual_sensor.imaging.part_survey import scale_note
from virtual_sensor.imaging.scene_file import (
    MATERIAL,
    SceneFile,
    filled,
    find_scene,
    included,
    included_file,
    read_scene_file,
    shipped_scenes,
    shortened,
    with_names,
)
from virtual_sensor.medium.description import MediumDescription
from virtual_sensor.medium.find_field import find_field
from virtual_sensor.medium.index_field import IndexField, field_of
from virtual_sensor.optics.surfaces import Cylinder, SceneSurface, Surface, own_variant
from virtual_sensor.optics.transports import Transport
from virtual_sensor.optics.undistortion import check_unfolded
from virtual_sensor.poses import Pose

Array = NDArray[np.float64]
T = TypeVar("T")

_ABSOLUTE_ZERO_C = -273.15
_NAMING_FILES = ("string", "include", "spectrum")  # elements of Mitsuba's XML that may
_SAME_MM = 1e-4  # float32 leaves so much doubt of a place
_CLEARANCE_MM = 0.01
_ROUND_PUPIL = 24  # directions in which a shape within the pupil is looked for
_ELEMENTS = {  # that a scene may lack
    "camera": '<sensor type="lens_camera">',
    "source": '<emitter type="laser_line">, or <emitter type="pattern_projector">',
    "projector": '<emitter type="pattern_projector">; or take the scene fringe_cylinder',
}
_OF_NEW = {"emissivity": "--temperature"} | {
    name: f"--{name}"
    for name in ("roughness", "temperature", "part", "unit", "up", "film", "diameter", "length")
}
"""Names that a scene may lack as parameters: options of `new`, which decide what it is made of."""
_METRES_MM = 2.0, 5.0  # a part no larger, and a camera no farther: scenes in metres are so


@dataclass(frozen=True)
class _Origin:
    """What a scene was loaded from, so that it can be loaded again, also by another process.

    Attributes
    ----------
    given : dict
        Parameters.
    here : Path
        Folder from which relative paths start, beside the scene's own.
    digests : tuple
        Of the scene's file, which is the first, and of all files that it refers to, with their
        places: absolute, or in the folder of the scenes that come with the program, which may lie
        in another folder on another machine.
    """

    given: dict[str, str]
    here: Path
    digests: tuple[tuple[Path, str], ...]

    @staticmethod
    def of(given: dict[str, str], here: Path, files: Iterable[Path]) -> _Origin:
        """The origin of a scene with these files."""
        folders = shipped_scenes(), shipped_scenes().resolve()

        def place(file: Path) -> Path:
            inside = (file.relative_to(each) for each in folders if file.is_relative_to(each))
            return next(inside, file.absolute())

        digests = tuple((place(file.absolute()), sha256_of(file)) for file in files)
        return _Origin(given, here.absolute(), digests)

    @property
    def files(self) -> list[Path]:
        """The scene's file and those that it refers to."""
        return [shipped_scenes() / place for place, _ in self.digests]

    def check(self) -> None:
        """Raise InputError if a file has changed."""
        for file, (_, digest) in zip(self.files, self.digests, strict=True):
            there = exists(file)
            if not there or sha256_of(file) != digest:
                raise InputError(
                    f"{self.files[0]}: can't be loaded again, since {file}"
                    f" {'was changed' if there else 'is gone'}; load the scene by load_scene"
                )


@dataclass(frozen=True)
class _Stage:
    """What Mitsuba holds of a scene; `poses` are those that were changed, as matrices (4, 4)."""

    origin: _Origin
    poses: dict[str, Array]
    parameters: dict[str, str]
    loaded: Loaded
    surface: Surface
    cameras: dict[str, LensCamera]
    sources: dict[str, LaserLine | Projector]
    notes: tuple[str, ...]
    where: str  # its integrator stands, for messages
    variant: str  # of Mitsuba
    exchanged: frozenset[str] = frozenset()  # cameras, by `with_camera`
    fits: dict[Hashable, SolidFit | None] = dataclasses.field(default_factory=dict)

    @property
    def air(self) -> MediumDescription:
        """The air, as the file says."""
        air: MediumDescription = self.loaded.scene.integrator().air
        return air

    @property
    def transport(self) -> Transport:
        """The transport, as the file says."""
        transport: Transport = self.loaded.scene.integrator().transport
        return transport

    def check_march(self, transport: Transport, medium: IndexField | None) -> None:
        """Refuse a march that can't get through the air."""
        with naming(f"{self.where}: refractive"):
            try:
                transport.check(medium)
            except InputError:
                if medium and (hint := wrong_scale(self.loaded.scene, medium)):
                    raise InputError(f"'field': {hint}") from None
                raise


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Displayed):
    """A loaded scene: a part in its air, the cameras that see it, the sources that light it.

    It never changes; `with_medium`, `with_pose` and their kin give other ones.  Two are equal if
    they were loaded from the same files with the same parameters, and changed alike.  A scene can
    be pickled: where it is unpickled its files are read again, which must not have changed.

    Attributes
    ----------
    path : Path
    parameters : Mapping
        The scene's ``$parameters`` as used, defaults included.
    medium : IndexField or None
        The air; None where light runs straight.
    air : MediumDescription
        The medium's file, if it has one, and what is made of it.
    cameras : Mapping
        `LensCamera` by name: its element's `id`, or "camera", "camera_2", ... where it has none.
    sources : Mapping
        `LaserLine` or `Projector` by name: likewise, or "laser", "laser_2", "projector", ...
    transport : Transport
        How frames find bent rays.
    hot : bool
        Whether its surfaces glow, those that can.
    """

    path: Path
    parameters: Mapping[str, str]
    medium: IndexField | None
    air: MediumDescription
    cameras: Mapping[str, LensCamera]
    sources: Mapping[str, LaserLine | Projector]
    transport: Transport
    hot: bool = dataclasses.field(
        metadata={"internal": True}
    )  # of a part without glow it says nothing
    _stage: _Stage

    def __post_init__(self) -> None:
        for name in ("parameters", "cameras", "sources"):
            object.__setattr__(self, name, MappingProxyType(dict(getattr(self, name))))

    def _line(self) -> str:
        air = self.air.path.name if self.air.path else "homogeneous"
        air = "given" if self.medium and not self.air.path else air
        cameras, sources = _counted("camera", self.cameras), _counted("source", self.sources)
        return listed(self.path.name, cameras, sources, f"air {air}", self.transport.name)

    @property
    def loaded(self) -> Loaded:
        """What Mitsuba made of the file: all scenes have the same that differ in air alone."""
        return self._stage.loaded

    @property
    def mitsuba(self) -> Any:
        """Mitsuba's scene, with all its cameras and sources."""
        return self._stage.loaded.scene

    @property
    def max_depth(self) -> int:
        """Segments of the light's path, at most: 2 is direct light, 3 with one reflection between.

        By its file: `with_parameters` gives a scene with another.
        """
        return int(self._stage.loaded.scene.integrator().max_depth)

    @property
    def indirect_samples(self) -> int:
        """Likewise points of the lit stripe for each sample of a pixel's indirect light."""
        return int(self._stage.loaded.scene.integrator().indirect_samples)

    @property
    def surface(self) -> Surface:
        """The part's, in float64 where it is the analytic cylinder."""
        return self._stage.surface

    @property
    def notes(self) -> tuple[str, ...]:
        """What was ignored, converted or assumed, and what of its air does not suit it.

        The air is looked at when this is asked for, whatever the medium is: its solid, its box, its
        border.  How fine its grid is, `measure` tells.
        """
        checks = importlib.import_module("virtual_sensor.imaging.checks")  # which lies above
        return tuple(dict.fromkeys([*self.loading_notes, *checks.air_notes(self)]))

    @property
    def loading_notes(self) -> tuple[str, ...]:
        """Those of them that `check_scene` does not give."""
        notes = self._stage.notes + (self.medium.notes if self.medium else ())
        if self.medium is None or not (self.air.path is None or exists(self.air.path)):
            return notes
        temperature = self.parameters.get("temperature", "")
        of_field = field_notes(
            self.air, self.air_name, self.field_fit, temperature, self.simulate_command
        )
        if hint := wrong_scale(self.mitsuba, self.medium):
            of_field = [f"{self.air_name}: {hint}"]
        where = self._stage.where if self.air.path else self.path
        return (*notes, *(with_names(f"{where}: {note}") for note in of_field))

    @property
    def air_name(self) -> str:
        """What its medium is called, for messages."""
        return f"the field {self.air.path.name}" if self.air.path else "the given air"

    @property
    def field_fit(self) -> SolidFit | None:
        """How its part and the solid of its field lie to each other; None if that marks none."""
        if self.medium is None:
            return None
        own_variant(self.mitsuba)
        up, fits, file = self.towards_sensors, self._stage.fits, self.air.path
        if file is None:
            solid = solid_of(self.medium)
            return fit_of(self.mitsuba, self.medium, solid, self.air_name, up)
        if not exists(file):
            return None
        modified = file.stat().st_mtime_ns
        key = replace(self.air, time_s=None), modified, up.tobytes()
        if key not in fits:
            solid = solid_in_file(file, modified)
            fits[key] = fit_of(self.mitsuba, self.medium, solid, self.air_name, up)
        return fits[key]

    @property
    def simulate_command(self) -> str:
        """The command that makes the air of this scene's part."""
        name = self.path.stem if self.path.parent == shipped_scenes() else f"{self.path}"
        return f"virtual-sensor field simulate --scene {shlex.quote(name)} --quick -o air.nc"

    @property
    def towards_sensors(self) -> Array:
        """Unit vector (3,) from the part to the middle of all that sees it and lights it."""
        up = -np.sum([pose.rotation[:, 2] for pose in self.poses.values()], axis=0)
        length = np.linalg.norm(up)
        return up / length if length > _SAME_MM else np.array([0.0, 0.0, 1.0])

    @property
    def field(self) -> IndexField | None:
        """Another name of the medium."""
        return self.medium

    @property
    def camera(self) -> LensCamera:
        """The only camera; an InputError where there are several."""
        return self.cameras[self.camera_name]

    @property
    def source(self) -> LaserLine | Projector:
        """The only source; an InputError where there is none, or several."""
        return self.sources[self.source_name]

    @property
    def laser(self) -> LaserLine:
        """The only source, which is a laser line; an InputError where it is none."""
        source = self.source
        if isinstance(source, Projector):
            raise InputError(
                f"{self.path}: {self.source_element} is a projector, and this needs a laser line;"
                " measure such a scene by `virtual-sensor fringes`, or take one with a laser_line"
            )
        return source

    @property
    def projector(self) -> Projector:
        """The only projector, whatever lasers there are; an InputError where it is none."""
        source = self.sources[self.projector_name]
        assert isinstance(source, Projector)
        return source

    @property
    def projector_name(self) -> str:
        """The only projector's."""
        all_of_them = {n: each for n, each in self.sources.items() if isinstance(each, Projector)}
        return self._one("projector", all_of_them, "source")

    @property
    def poses(self) -> dict[str, Pose]:
        """Where the cameras and the sources stand, by name."""
        cameras = {name: camera.pose for name, camera in self.cameras.items()}
        return cameras | {name: source.pose for name, source in self.sources.items()}

    @property
    def sensor(self) -> SensorModel:
        """The only camera with the only source, which is a laser line."""
        return SensorModel(self.camera, self.laser)

    @property
    def camera_name(self) -> str:
        """The only camera's."""
        return self._one("camera", self.cameras)

    @property
    def source_name(self) -> str:
        """The only source's."""
        return self._one("source", self.sources)

    @property
    def camera_element(self) -> str:
        """The only camera's element, for messages."""
        return _sensor(self.camera_name)

    @property
    def source_element(self) -> str:
        """The only source's element, for messages."""
        return f'<emitter id="{shortened(self.source_name)}">'

    @property
    def mitsuba_camera(self) -> Any:
        """Mitsuba's sensor of the only camera."""
        return self._stage.loaded.cameras[self.camera_name]

    def only(self, camera: str | None = None, source: str | None = None) -> Scene:
        """The same scene with one camera or one source: the others neither see nor shine.

        Raises
        ------
        InputError
            If there is none of that name; it says which there are.
        """
        cameras, sources = self.cameras, self.sources
        if camera is not None:
            cameras = {camera: self._named("camera", cameras, camera)}
        if source is not None:
            sources = {source: self._named("source", sources, source)}
        return replace(self, cameras=cameras, sources=sources)

    def with_medium(self, medium: IndexField | str | Path | None) -> Scene:
        """The same scene in other air; None: in homogeneous air, its part cold.

        Parameters
        ----------
        medium : IndexField, str, Path or None
            A field; or its file, or the name of one that comes with the program, which is read for
            the scene's wavelength.

        Raises
        ------
        InputError
            If it is no field, or can't be read.
        """
        air = field_of("with_medium: medium", medium, self.air.wavelength_nm)
        return replace(self, medium=air, air=self.air.without_file(), hot=air is not None)

    def cold(self) -> Scene:
        """The same scene in homogeneous air, its part cold."""
        return self.with_medium(None)

    def at(self, time_s: float) -> Scene:
        """The same scene in the air of another instant, s, of its field's file.

        Raises
        ------
        InputError
            If its air comes from no file, or the file does not hold that instant.
        """
        number_within("at: time_s", time_s, -LARGEST, LARGEST, "the flow time in s")
        with naming(self.path):
            air = self.air.at(time_s)
            medium = air.read()
        time = {"time": f"{time_s:.9g}"} if "time" in self.parameters else {}
        return replace(self, medium=medium, air=air, parameters={**self.parameters, **time})

    def with_transport(self, transport: Transport) -> Scene:
        """The same scene by another transport of light."""
        return replace(self, transport=transport)

    def with_camera(self, camera: LensCamera, name: str | None = None) -> Scene:
        """The same scene with another lens, distortion or sensor on a camera, where it stands.

        >>> lens = vs.Lens.of_f_number(75, 300, 8)
        >>> scene.with_camera(replace(scene.camera, lens=lens))

        Parameters
        ----------
        camera : LensCamera
            Such as the scene's own with other fields; its pose and size must be the scene's.
            Other integrators than `refractive` see by the file's camera.
        name : str, optional
            Which it is, where the scene has several.

        Raises
        ------
        InputError
            If it is none, of another pose or size, or its distortion folds the image.
        """
        name = self.camera_name if name is None else name
        before = self._named("camera", self.cameras, name)
        if not isinstance(camera, LensCamera):
            raise InputError(f"with_camera: camera is {short(camera)}; give a LensCamera")
        where = f"{self.path}: {_sensor(name)}"
        if camera.size != before.size or camera.pose != before.pose:
            raise InputError(
                f"{where}: with_camera: the camera has another size or pose; move it by with_pose,"
                " and give its film another size in the scene (width, height)"
            )
        with naming(where):
            check_unfolded(camera)
        _check_pupil(where, self.mitsuba, camera)
        stage = replace(self._stage, exchanged=self._stage.exchanged | {name})
        return replace(self, cameras={**self.cameras, name: camera}, _stage=stage)

    def with_pose(self, name: str, pose: Pose) -> Scene:
        """The same scene with one of its cameras or sources at another place.

        It is loaded again, and other changes stay.  What stands there then is what Mitsuba
        holds: the pose in float32.

        Parameters
        ----------
        name : str
            The camera's or the source's.
        pose : Pose
            Of a camera and a projector x along u, y along v, z forward; of a laser x across the
            sheet, y along the line, z forward.  It may mirror.

        Raises
        ------
        InputError
            If there is no such element, it can't stand so, or a file of the scene was changed since
            it was loaded.
        """
        if not isinstance(name, str):
            raise InputError(f"with_pose: name is {short(name)}; give one of {_listed(self.poses)}")
        self._named("camera or source", self.poses, name)
        return self._again({}, {name: self._matrix(name, pose)})

    def with_sensor_moved(self, motion: Pose) -> Scene:
        """The same scene after all its cameras and sources moved as one; part and air stay.

        Parameters
        ----------
        motion : Pose
            From places before to places after: `Pose.shift`, `Pose.turn`.

        Raises
        ------
        InputError
            As `with_pose` does.
        """
        moved = {name: pose.moved(motion) for name, pose in self.poses.items()}
        return self._again({}, {name: self._matrix(name, pose) for name, pose in moved.items()})

    def _matrix(self, name: str, pose: Pose) -> Array:
        """A camera's or source's ``to_world``, (4, 4)."""
        if not isinstance(pose, Pose):
            raise InputError(f"{self.path}: {name}: pose is {short(pose)}; give a Pose")
        matrix = np.eye(4)
        matrix[:3, :3], matrix[:3, 3] = pose.rotation, pose.origin_mm
        if name in self.cameras or isinstance(self.sources[name], Projector):
            matrix[:3, :3] = matrix[:3, :3] @ OURS_FROM_MITSUBAS
        return matrix

    def with_parameters(self, **parameters: object) -> Scene:
        """The same scene with other values of its ``$parameters``.

        It is loaded again, and changes of its air, poses and transport stay.

        Raises
        ------
        InputError
            As `load_scene` does, and if a file of the scene was changed since it was loaded.
        """
        return self._again(_texts(parameters), {})

    def from_file(self, path: Path, **parameters: object) -> Scene:
        """The same devices and air, with all changes, in another file that has them too.

        Parameters
        ----------
        path : Path
            A scene file with all the parameters of this one's, such as one with another part.
        **parameters
            Values for its ``$parameters``, beside those that this scene was given.

        Raises
        ------
        InputError
            As `load_scene` does.
        """
        return self._again(_texts(parameters), {}, path)

    def _again(
        self, parameters: dict[str, str], poses: dict[str, Array], path: Path | None = None
    ) -> Scene:
        """The scene loaded again with some parameters and poses, its other changes applied."""
        before, origin = self._stage, self._stage.origin
        origin.check()
        given, poses = origin.given | parameters, before.poses | poses
        stage = _staged(path or origin.files[0], given, origin.here, poses)
        stage = replace(stage, exchanged=before.exchanged)
        air, medium, values = self.air, self.medium, stage.parameters
        if air.path:
            air = stage.air
            with naming(stage.where):
                if self.air != before.air and "time" not in parameters:
                    air = replace(air, time_s=self.air.time_s)
                    if "time" in values:
                        values = values | {"time": self.parameters["time"]}
                medium = medium if air == self.air else air.read()
        transport = stage.transport if self.transport == before.transport else self.transport
        stage.check_march(transport, medium)
        cameras = {
            name: self._optics(name, self._named("camera", stage.cameras, name), bool(parameters))
            for name in self.cameras
        }
        sources = {name: self._named("source", stage.sources, name) for name in self.sources}
        path = path or self.path
        return Scene(path, values, medium, air, cameras, sources, transport, self.hot, stage)

    def _optics(self, name: str, again: LensCamera, changed: bool) -> LensCamera:
        """A camera that was loaded again, with the lens and sensor that it had.

        Where parameters were changed the file's camera counts, unless `with_camera` gave another.
        """
        mine = self.cameras[name]
        if changed and name not in self._stage.exchanged:
            return again
        return mine.with_pose(again.pose) if mine.size == again.size else again

    def _one(self, kind: str, named: Mapping[str, Any], option: str = "") -> str:
        """The only name; an option of most functions and commands chooses one of several."""
        if len(named) == 1:
            return next(iter(named))
        if not named:
            raise InputError(
                f"{self.path}: the scene has no {kind}, and this needs one; add {_ELEMENTS[kind]}"
            )
        raise InputError(
            f"{self.path}: the scene has {len(named)} {kind}s: {_listed(named)}; say which"
            f" ({option or kind}=, or --{option or kind} on the command line)"
        )

    def _named(self, kind: str, named: Mapping[str, T], name: str) -> T:
        """What has a name."""
        if not isinstance(name, str):
            raise InputError(f"{kind} is {short(name)}; give its name: {_listed(named)}")
        if name not in named:
            raise InputError(
                f"{self.path}: no {kind} '{shortened(str(name))}'; the scene has:"
                f" {_listed(named) or 'none'}{nearest(name, named)}"
            )
        return named[name]

    def _values(self) -> tuple[object, ...]:
        """What makes it equal to others."""
        stage = self._stage
        return (
            stage.origin.digests,
            stage.variant,
            tuple(sorted(self.parameters.items())),
            tuple((name, matrix.tobytes()) for name, matrix in sorted(stage.poses.items())),
            self.air,
            id(self.medium) if self.air.path is None else None,  # equal if it is the same
            tuple(self.cameras.items()),
            tuple(self.sources),
            self.transport,
            self.hot,
        )

    def __eq__(self, other: object) -> bool:
        return self._values() == other._values() if isinstance(other, Scene) else NotImplemented

    def __hash__(self) -> int:
        return hash(self._values())

    def __reduce__(self) -> tuple[Any, ...]:
        stage = self._stage
        chosen = dict(self.cameras), stage.exchanged, tuple(self.sources)
        air = self.air.time_s if self.air.path else self.medium
        of_file = self.air.path is not None
        changes = dict(self.parameters), of_file, air, self.transport, self.hot
        data = pickle.dumps((stage.origin, stage.poses, chosen, *changes))
        return engine.under, (stage.variant, f"{__name__}:_unpickled", data)

    def __copy__(self) -> Scene:
        return self

    def __deepcopy__(self, known: dict[int, Any]) -> Scene:
        return self


def _unpickled(
    origin: _Origin,
    poses: dict[str, Array],
    chosen: tuple[dict[str, LensCamera], frozenset[str], tuple[str, ...]],
    parameters: dict[str, str],
    of_file: bool,
    air: Any,
    transport: Transport,
    hot: bool,
) -> Scene:
    """A scene that was pickled, loaded again; `air` is an instant of its file, or a medium."""
    origin.check()
    path = origin.files[0]
    cameras, exchanged, names = chosen
    stage = replace(_staged(path, origin.given, origin.here, poses), exchanged=exchanged)
    described = replace(stage.air, time_s=air) if of_file else stage.air.without_file()
    medium = described.read() if of_file else air
    sources = {name: stage.sources[name] for name in names}
    return Scene(path, parameters, medium, described, cameras, sources, transport, hot, stage)


def _counted(kind: str, named: Mapping[str, Any]) -> str:
    """The devices of a kind by their names; one that has the usual name says it all."""
    names = _listed(named) or "none"
    return (
        names
        if names in ("camera", "laser", "projector")
        else f"{kind}{'s' * (len(named) > 1)} {names}"
    )


def _listed(named: Mapping[str, Any]) -> str:
    return shortened(", ".join(named))


@public
def load_scene(name: str | Path, **parameters: object) -> Scene:
    """Load a scene: from its Mitsuba XML file, or by its name one that comes with the program.

    Parameters
    ----------
    name : str or Path
        A Mitsuba XML file, or the name of a scene that comes with the program.
    **parameters
        Values for the scene's ``$parameters``: numbers, texts, paths, True and False, or lists of
        numbers, such as ``temperature=1250, dots=[0, -5]``.

    Raises
    ------
    InputError
        Naming the file, the element and the remedy.
    """
    path = find_scene(name)
    stage = _staged(path, _texts(parameters), Path(), {})
    air, transport = stage.air, stage.transport
    with naming(stage.where):
        medium = air.read()
    stage.check_march(transport, medium)
    return Scene(
        path, stage.parameters, medium, air, stage.cameras, stage.sources, transport, True, stage
    )


def _texts(parameters: Mapping[str, object]) -> dict[str, str]:
    """Parameters' values as a scene's XML has them."""
    return {name: _text(name, value) for name, value in parameters.items()}


def _text(name: str, value: object) -> str:
    if isinstance(value, str | Path):
        return str(value)
    if isinstance(value, bool | np.bool_):
        return str(value).lower()
    try:
        numbers = np.asarray(value)
    except ValueError:  # lists of different lengths
        numbers = np.empty((0, 0))
    if numbers.ndim > 1 or numbers.dtype.kind not in "iufU":
        raise InputError(
            f"{name} is {short(value)}; give a number, a text or a list of numbers, or leave it out"
            f"{'; a field is given by scene.with_medium' * isinstance(value, IndexField)}"
        )
    return ", ".join(map(_number, numbers.ravel()))


def _number(number: Any) -> str:
    """A number's text: that of 64.0 is one that an integer can have too."""
    whole = isinstance(number, np.floating) and abs(number) < 1e15 and number == round(number)
    return f"{int(number)}" if whole else str(number)


def _staged(path: Path, given: dict[str, str], here: Path, poses: dict[str, Array]) -> _Stage:
    """Have Mitsuba load a scene."""
    files, values, folders = _read(path, given, here)
    loaded = load(files, given, values, here, poses, _material(files, folders, values))
    if not isinstance(loaded.scene.integrator(), refractive.Refractive):
        raise InputError(
            f'{path}: the scene\'s integrator is not "refractive"; put <integrator'
            ' type="refractive"/> in its place'
        )
    cameras, left_out = _cameras(path, loaded.cameras)
    sources = {name: emitter.source for name, emitter in loaded.sources.items()}
    notes = [*(note for file in files for note in file.notes), *loaded.notes, *left_out]
    notes += _places(path, loaded.scene, cameras)
    surface = _surface(loaded.scene)
    origin = _Origin.of(given, here, [path, *_referred(files, folders, values)])
    where = next(e.where for f in files for e in f.elements if e.tag == "integrator")
    rest = tuple(notes), where, mi.variant()
    return _Stage(origin, poses, values, loaded, surface, cameras, sources, *rest)


def scene_parameters(path: Path, given: dict[str, str]) -> dict[str, str]:
    """The parameters of a scene file, with the given values in place of its defaults.

    Raises
    ------
    InputError
        If the file is no scene, or has no such parameter.
    """
    return _read(path, given, Path())[1]


def _read(
    path: Path, given: dict[str, str], here: Path
) -> tuple[list[SceneFile], dict[str, str], list[Path]]:
    """A scene file with those that it includes, its parameters' values, and where its files are."""
    file = read_scene_file(path)
    root = file.elements[0]
    if root.tag != "scene":
        raise InputError(
            f"{path}: its root element is <{shortened(root.tag)}>; a scene's is <scene>"
        )
    files, values = [file], _values([file], given)
    folders: dict[Path, None] = {here: None, path.parent: None}
    for inner, _ in included(file, folders, values, (path.resolve(),)):
        files.append(inner)
        values = _values(files, given)
    if material := _material(files, list(folders), values):
        check_material(next(each for each in files if each.elements[0].file == material))
        folders |= {material.parent: None}
    defaults = {name for file in files for name in file.defaults}
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
        option = _OF_NEW.get(unknown[0])
        remedy = f"; it was made without; say {option} to `virtual-sensor new`" if option else ""
        if material and (have := materials_with(unknown[0])):
            remedy = f"; materials that have it: {', '.join(have)}"
        raise InputError(
            f"{path}: no parameter '{shortened(unknown[0])}'; the scene has: {names}"
            f"{remedy or nearest(unknown[0], defaults)}"
        )
    if "temperature" in values:
        _check_temperature(path, values["temperature"])
    with naming(path):
        values = with_index_of_iron(with_field_of_view(values, given), given)
    return files, _with_own_radius(values, given, list(folders)), list(folders)


def _material(files: list[SceneFile], folders: list[Path], values: dict[str, str]) -> Path | None:
    """The file of the scene's material, if it includes one."""
    elements = (element for element in files[0].elements if element.tag == "include")
    of_material = (e for e in elements if e.attributes.get("filename") == MATERIAL)
    return next((included_file(each, folders, values) for each in of_material), None)


def _with_own_radius(
    values: dict[str, str], given: dict[str, str], folders: list[Path]
) -> dict[str, str]:
    """The parameters' values, where a laser's measured profile has its own radius unless given."""
    if "line_radius" not in values or "line_radius" in given or not values.get("line_profile"):
        return values
    with suppress(InputError):  # which loading the scene tells
        profile = profile_of(values["line_profile"], folders)
        if isinstance(profile, MeasuredProfile):
            return {**values, "line_radius": f"{profile.radius_mm:.10g}"}
    return values


def _values(files: list[SceneFile], given: dict[str, str]) -> dict[str, str]:
    """Values of the parameters: as given, else by default; a default may use those before it."""
    main = files[0].elements[0].file
    texts: dict[str, str] = {}
    for element in (e for file in files for e in file.elements if e.tag == "default"):
        name, value = (element.attributes.get(key) for key in ("name", "value"))
        if not name or value is None:
            raise InputError(f"{element.where}: <default> needs a name and a value; give both")
        texts.setdefault(name, value)
    values: dict[str, str] = {}
    for name, text in (texts | given).items():
        if "\0" in text:
            raise InputError(f"{main}: {name} has a zero byte; take it out")
        with naming(main):
            values[name] = filled(text, values)
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
    files, values, folders = _read(path, values, Path())
    return _referred(files, folders, values)


def _referred(files: list[SceneFile], folders: list[Path], values: dict[str, str]) -> list[Path]:
    """The files that attributes of scene files name."""
    found: dict[Path, None] = {}
    for element in (e for file in files for e in file.elements if e.tag in _NAMING_FILES):
        texts = [filled(text, values) for text in element.attributes.values()]
        if element.tag == "include" and (file := included_file(element, folders, values)):
            found[file.resolve()] = None
        for place in (folder / text for folder in folders for text in texts):
            if exists(place) and place.is_file():
                found[place.resolve()] = None
        field = element.attributes.get("name") == "field" and filled(
            element.attributes.get("value", ""), values
        )
        if field:
            with suppress(InputError):  # which loading the scene tells
                found[find_field(field, folders).resolve()] = None
    return list(found)


def _places(path: Path, loaded: Any, cameras: dict[str, LensCamera]) -> list[str]:
    """Notes of a scene, or a part, whose lengths seem not to be in mm."""
    box = loaded.bbox()
    corners = np.array([box.min, box.max], float)
    if not (np.isfinite(corners).all() and np.all(corners[0] <= corners[1])):
        raise InputError(f"{path}: its shapes have no finite size; give the scene a part")
    for name, camera in cameras.items():
        where = f"{path}: {_sensor(name)}"
        _check_clearance(where, loaded, camera.pose.origin_mm)
        _check_pupil(where, loaded, camera)
    size, middle = float(np.max(corners[1] - corners[0])), corners.mean(axis=0)
    distances, views = [], []
    for camera in cameras.values():
        origin = camera.pose.origin_mm
        distances.append(np.linalg.norm(origin - middle))
        away = np.linalg.norm(origin - np.clip(origin, *corners)) or distances[-1]
        views.append(float(away * max(camera.size) / abs(camera.matrix[0, 0])))
    if size <= _METRES_MM[0] and max(distances) <= _METRES_MM[1]:
        return [
            f"{path}: the part is {size:.2g} mm in size and the camera {max(distances):.2g} mm"
            " away; lengths are in mm: is the scene in metres?"
        ]
    note = scale_note(size, max(views))
    return [f"{path}: {note}"] if note else []


def _check_clearance(where: str, loaded: Any, place_mm: Array) -> None:
    """Refuse a camera that touches a shape: it would see only that."""
    steps = np.array([s for s in np.ndindex(3, 3, 3) if s != (1, 1, 1)]) - 1.0
    unit = steps / np.linalg.norm(steps, axis=1, keepdims=True)
    start = place_mm - _CLEARANCE_MM * unit
    met = SceneSurface(loaded).distance(
        to_vectors(start), to_vectors(unit), 2.0 * _CLEARANCE_MM, True
    )
    if np.isfinite(np.array(met)).any():
        raise InputError(
            f"{where}: the camera stands on a surface; move it away from it (to_world)"
        )


def _check_pupil(where: str, loaded: Any, camera: LensCamera) -> None:
    """Refuse a lens whose pupil a shape reaches into."""
    if (lens := camera.lens_with_pupil) is None:
        return
    angle = np.linspace(0.0, 2.0 * np.pi, _ROUND_PUPIL, endpoint=False)
    beside = np.column_stack([np.cos(angle), np.sin(angle), np.zeros(_ROUND_PUPIL)])
    unit = beside @ camera.pose.rotation.T
    start = np.broadcast_to(camera.pose.origin_mm, unit.shape)
    radius_mm = lens.pupil_radius_mm
    met = SceneSurface(loaded).distance(to_vectors(start), to_vectors(unit), radius_mm, True)
    if np.isfinite(np.array(met)).any():
        raise InputError(
            f"{where}: a shape reaches into the lens's pupil, which is {2.0 * radius_mm:.3g} mm"
            " wide; give a larger f_number, or move the camera away from it"
        )


def _sensor(name: str) -> str:
    """A camera's element, for messages."""
    return f'<sensor id="{shortened(name)}">'


def _cameras(path: Path, sensors: dict[str, Any]) -> tuple[dict[str, LensCamera], list[str]]:
    """The cameras of a scene, at least one, and notes of its sensors."""
    cameras, unfit, notes = {}, [], []
    for name, sensor in sensors.items():
        where = f"{path}: {_sensor(name)}"
        with naming(where):
            camera = camera_of(sensor)
        if camera:
            _check_film(where, sensor.film())
            cameras[name] = camera
            notes += [f"{where}{note}" for note in _camera_notes(sensor, camera)]
        else:
            unfit.append(f"{where} is no {_ELEMENTS['camera']}")
    if cameras:
        return cameras, [*(f"{reason}; it is left out" for reason in unfit), *notes]
    if unfit:
        raise InputError(f"{unfit[0]}; a camera must be one")
    raise InputError(f"{path}: the scene has no camera; add {_ELEMENTS['camera']}")


def _camera_notes(sensor: Any, camera: LensCamera) -> list[str]:
    """What of a camera was assumed, or does not go together."""
    notes, chip, lens = [], camera.sensor, camera.lens
    if lens and not hasattr(sensor, "camera"):
        notes.append(
            f": a thinlens has no film in mm; one {THIN_LENS_FILM_MM:g} mm wide is assumed, which"
            f" makes it f/{lens.f_number:.3g}; use a lens_camera"
        )
    whole = (chip.width_px, chip.height_px) if chip else (None, None)
    if any(n and n < m for n, m in zip(whole, camera.size, strict=True)):
        notes.append(f": its film is larger than its sensor, of {whole[0]} x {whole[1]} px")
    return notes


def _check_film(where: str, film: Any) -> None:
    width, height = (int(n) for n in film.size())
    if min(width, height) < 1:
        raise InputError(f"{where}: <film> of {width} x {height} px; give a width and a height")
    if [int(n) for n in film.crop_size()] != [width, height]:
        raise InputError(f"{where}: the film is cropped; give the whole film")


def _surface(loaded: Any) -> Surface:
    """The analytic cylinder, if the part is one along x with end faces; else Mitsuba's shapes."""
    places: dict[str, list[Array]] = {}
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
