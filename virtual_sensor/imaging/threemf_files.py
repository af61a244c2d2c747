"""The reader of 3MF files; what is used is listed in `virtual_sensor.imaging.parts`."""

import re
import zipfile
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, field
from io import BytesIO
from typing import IO, Any
from xml.parsers import expat

import numpy as np

from virtual_sensor.child import physical_memory
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.polygons import Array, Polygons, numbers
from virtual_sensor.imaging.scene_file import shortened

_MAIN = "3D/3dmodel.model"
_UNITS_MM = {
    **{"micron": 1e-3, "millimeter": 1.0, "centimeter": 10.0},
    **{"inch": 25.4, "foot": 304.8, "meter": 1e3},
}
_UNUSED = {  # elements, and what they are called
    **dict.fromkeys(("basematerials", "colorgroup", "compositematerials"), "materials"),
    **dict.fromkeys(("texture2d", "texture2dgroup", "multiproperties"), "materials"),
    **{"beamlattice": "lattices of beams", "slicestack": "slices", "displacement2d": "reliefs"},
}
_BROKEN = (  # what zipfile raises
    *(zipfile.BadZipFile, zlib.error, EOFError, OSError),
    *(NotImplementedError, RuntimeError, ValueError),
)
_AS_IT_IS = np.eye(4, 3)
_MOST_COPIES, _MOST_NESTED = 10_000, 16
_BYTES_FOLD = 8  # what a byte of XML needs of the memory, about


@dataclass(frozen=True)
class _Use:
    """An object that is put somewhere: its file in the archive, its id, and its place (4, 3)."""

    file: str
    name: str
    place: Array


@dataclass
class _Object:
    """A mesh, as words of numbers, or other objects."""

    kind: str = "model"
    vertices: list[str] = field(default_factory=list)
    corners: list[str] = field(default_factory=list)
    parts: list[_Use] = field(default_factory=list)


@dataclass
class _Model:
    """A file of the archive: its unit in mm, its objects by their ids, and what is built."""

    unit: str = "millimeter"
    objects: dict[str, _Object] = field(default_factory=dict)
    built: list[_Use] = field(default_factory=list)
    unused: set[str] = field(default_factory=set)


def read_3mf(data: bytes) -> Polygons:
    """Read a 3MF file's bytes; its lengths become mm."""
    try:
        archive = zipfile.ZipFile(BytesIO(data))
        names = {each.filename.lstrip("/").lower(): each for each in archive.infolist()}
        models: dict[str, _Model] = {}

        def model(file: str) -> _Model:
            if file not in models:
                if file.lower() not in names:
                    raise InputError(f"there is no {shortened(file)} in it; give a 3MF file")
                entry = names[file.lower()]
                if entry.file_size * _BYTES_FOLD > physical_memory():
                    raise InputError(
                        f"its {file} has {entry.file_size:.2g} bytes; give a smaller one"
                    )
                with archive.open(entry) as text:
                    models[file] = _parsed(text, file)
            return models[file]

        main = model(_main_of(archive, names))
        pieces = list(_pieces(model, main.built))
    except InputError:
        raise
    except _BROKEN as error:
        raise InputError(f"it is no sound ZIP archive ({error}); give the whole file") from None
    if not pieces:
        raise InputError("it builds no object with triangles; give a mesh")
    offsets = np.cumsum([0, *(len(vertices) for vertices, _ in pieces)])
    triangles = [each + offset for (_, each), offset in zip(pieces, offsets, strict=False)]
    notes = [f"its {name} are ignored" for each in models.values() for name in sorted(each.unused)]
    if main.unit != "millimeter":
        notes.append(f"its lengths are in the unit {main.unit}; they become mm")
    corners = np.concatenate(triangles)
    return Polygons(
        np.concatenate([vertices for vertices, _ in pieces]) * _UNITS_MM[main.unit],
        corners.ravel(),
        np.full(len(corners), 3),
        notes=list(dict.fromkeys(notes)),
    )


def _main_of(archive: zipfile.ZipFile, names: dict[str, zipfile.ZipInfo]) -> str:
    """The file of the model: as the archive's relationships say."""
    if "_rels/.rels" in names:
        said = archive.read(names["_rels/.rels"])[:100_000].decode("utf-8", "replace")
        for target in re.findall(r"Target\s*=\s*[\"']/?([^\"']+\.model)[\"']", said):
            if target.lower() in names:
                return str(target)
    return _MAIN


def _pieces(model: Any, uses: list[_Use]) -> Iterator[tuple[Array, Any]]:
    """Vertices (N, 3) and triangles (M, 3) of the meshes that are built."""
    copies = 0
    waiting = [(use, use.place, 0) for use in reversed(uses)]
    while waiting:
        use, place, depth = waiting.pop()
        copies += 1
        if copies > _MOST_COPIES or depth > _MOST_NESTED:
            raise InputError("its objects hold one another too often; mend the file")
        built = model(use.file).objects.get(use.name)
        if built is None:
            raise InputError(
                f"it builds an object {shortened(use.name)} that is not there; mend it"
            )
        if built.kind in ("support", "solidsupport"):
            model(use.file).unused.add("supports")
            continue
        for part in reversed(built.parts):
            turn = part.place[:, :3] @ place[:3]
            turn[3] += place[3]
            waiting.append((part, turn, depth + 1))
        if built.corners:
            triangles = numbers(built.corners).reshape(-1, 3)
            wrong = (triangles != np.rint(triangles)) | (triangles < 0)
            wrong |= triangles >= len(built.vertices) // 3
            if wrong.any():
                row = int(np.argmax(wrong.any(axis=1)))
                raise InputError(
                    f"triangle {row} of its object {shortened(use.name)} refers to a vertex that is"
                    f" not there, of {len(built.vertices) // 3}; mend the file"
                )
            if np.linalg.det(place[:3]) < 0.0:
                triangles = triangles[:, ::-1]
            vertices = numbers(built.vertices).reshape(-1, 3)
            yield vertices @ place[:3] + place[3], triangles.astype(np.int64)


def _parsed(text: IO[bytes], file: str) -> _Model:
    """A file of a model."""
    model = _Model()
    current = _Object()
    parser = expat.ParserCreate(namespace_separator=" ")

    def start(tag: str, given: dict[str, str]) -> None:
        nonlocal current
        name = tag.rpartition(" ")[2]
        try:
            if name == "vertex":
                current.vertices += (given["x"], given["y"], given["z"])
            elif name == "triangle":
                current.corners += (given["v1"], given["v2"], given["v3"])
            elif name == "object":
                current = model.objects[given["id"]] = _Object(given.get("type", "model"))
            elif name == "component":
                current.parts.append(_use(given, file))
            elif name == "item":
                model.built.append(_use(given, file))
            elif name == "model":
                model.unit = given.get("unit", model.unit)
                if model.unit not in _UNITS_MM:
                    raise InputError(
                        f'its unit is "{shortened(model.unit)}"; 3MF has {", ".join(_UNITS_MM)}'
                    )
            elif name in _UNUSED:
                model.unused.add(_UNUSED[name])
        except KeyError as error:
            raise InputError(f"a <{name}> lacks its {error.args[0]}; mend the file") from None

    def refuse(*entity: object) -> None:
        raise InputError("it declares an <!ENTITY>, which 3MF does not allow; mend the file")

    parser.StartElementHandler, parser.EntityDeclHandler = start, refuse
    try:
        parser.ParseFile(text)
    except InputError:
        raise
    except (expat.ExpatError, LookupError, ValueError) as error:  # those: of its encoding
        raise InputError(f"its {shortened(file)} is no sound XML ({error}); mend it") from None
    return model


def _use(given: dict[str, str], file: str) -> _Use:
    """An <item> or a <component>."""
    words = given.get("transform", "").split()
    place = numbers(words).reshape(-1, 3) if len(words) == 12 else _AS_IT_IS
    if len(words) not in (0, 12) or not np.isfinite(place).all():
        raise InputError("it has a transform that is not of 12 finite numbers; mend the file")
    path = next((each for name, each in given.items() if name.rpartition(" ")[2] == "path"), file)
    return _Use(path.lstrip("/"), given["objectid"], place)
