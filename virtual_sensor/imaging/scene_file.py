"""The XML of a scene file, checked before Mitsuba is given it: what would crash it is refused.

===============================  ==================================================================
Feature of a scene file          What becomes of it
===============================  ==================================================================
UTF-8, ASCII, byte order marks   heeded
other encodings, by byte order   heeded, with a note; unknown ones are refused, and in an included
mark or declaration              file all but UTF-8, UTF-16 and ISO-8859-1
``$parameters``, ``<default>``   heeded, also those of included files
``<include>``                    heeded, up to 14 deep; of one another: refused
the material's ``<include>``     heeded: ``$material`` is a file, or the name of one in a folder
                                 `materials` beside the scene or of the program
``<path>``, ``<alias>``,         heeded (by Mitsuba)
``<ref>``
``<!ENTITY>``                    refused: Mitsuba doesn't expand entities
elements nested over 16 deep     refused: Mitsuba's stack or patience ends
values over 100,000 characters   refused, as they stand or once parameters are filled in
a folder, pipe, device           refused
===============================  ==================================================================

`virtual_sensor.imaging.scene` says what becomes of the elements, `virtual_sensor.imaging.parts` of
files of parts.
"""

import codecs
import re
import shlex
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from importlib import resources
from pathlib import Path
from xml.parsers import expat

from virtual_sensor.errors import InputError, naming
from virtual_sensor.files import exists, named_file, readable
from virtual_sensor.imaging.part_kinds import is_part

MOST_NESTED = 16
MOST_INCLUDED = 14  # one less than Mitsuba allows
LONGEST_VALUE = 100_000
LARGEST_FILE = 1 << 26

MATERIAL = "materials/$material.xml"
"""What a scene's material is included by."""

_MARKS = {  # in this order: the mark of UTF-32 begins with that of UTF-16
    codecs.BOM_UTF32_LE: "UTF-32",
    codecs.BOM_UTF32_BE: "UTF-32",
    codecs.BOM_UTF16_LE: "UTF-16",
    codecs.BOM_UTF16_BE: "UTF-16",
    codecs.BOM_UTF8: "UTF-8-SIG",
}
_IMAGES = (  # the first bytes of PNG, JPEG, TIFF, OpenEXR, BMP, GIF
    *(b"\x89PNG", b"\xff\xd8\xff", b"II*\x00", b"MM\x00*", b"v/1\x01", b"BM", b"GIF8"),
)
_FIELDS = (b"CDF\x01", b"CDF\x02", b"CDF\x05", b"\x89HDF")  # of NetCDF
_PLAIN = ("utf-8", "utf-8-sig", "ascii")
_MITSUBAS = (*_PLAIN, "utf-16", "iso8859-1")
_DECLARATION = re.compile(r"<\?xml\b[^>]*?\bencoding\s*=\s*[\"']([^\"']*)[\"'][^>]*\?>")

_DOCUMENTED = re.compile(
    r"<default\b[^>]*?\bname\s*=\s*[\"']([^\"']*)[\"'][^>]*?/>[ \t]*<!--(.*?)-->", re.DOTALL
)


@dataclass(frozen=True)
class Element:
    """An element of a scene file, its attributes as they are written there."""

    file: Path
    line: int
    depth: int
    tag: str
    attributes: dict[str, str]

    @property
    def where(self) -> str:
        """File and line, for messages."""
        return f"{self.file}, line {self.line}"


@dataclass(frozen=True)
class SceneFile:
    """Elements of a scene file in their order, the root first, its text, and notes on it."""

    elements: list[Element]
    text: str
    notes: tuple[str, ...] = ()

    @property
    def defaults(self) -> dict[str, str]:
        """Its parameters by name, with their values by default."""
        said = (element.attributes for element in self.elements if element.tag == "default")
        return {each.get("name", ""): each.get("value", "") for each in said}


def shipped_scenes() -> Path:
    """Folder of the scenes that come with the program."""
    return Path(str(resources.files("virtual_sensor_scenes")))


def with_names(text: str) -> str:
    """A text for people: scenes that come with the program by their names, not their paths."""
    return re.sub(rf"{re.escape(f'{shipped_scenes()}')}[/\\\\](\w+)\.xml", r"\1", text)


def find_scene(name: str | Path) -> Path:
    """A scene's file: a path, or the name of one that comes with the program.

    Raises
    ------
    InputError
        If there is none: it names the places that were looked in, the scenes that there are, and
        the one of the nearest name.
    """
    return named_file(name, "scene", ".xml", [Path()], [shipped_scenes()])


def find_material(name: str, folders: Iterable[Path]) -> Path:
    """A material's file: a path, or its name in `materials`, beside the scene or of the program.

    Parameters
    ----------
    name : str
        A bare one, such as "ground_steel", is looked for among materials alone.
    folders : iterable of Path
        In which files of the scene are looked for.

    Raises
    ------
    InputError
        If there is none: it names the places that were looked in, the materials that there are,
        and the one of the nearest name.
    """
    own = [folder / "materials" for folder in folders]
    places = own if Path(name).name == name and not Path(name).suffix else folders
    return named_file(name, "material", ".xml", places, [shipped_scenes() / "materials"])


def parameter_words(path: Path) -> dict[str, str]:
    """What a scene file says of its parameters: the comment behind a ``<default>``, on its line.

    Raises
    ------
    InputError
        If the file can't be read (see `read_scene_file`).
    """
    text = read_scene_file(path).text
    return {name: " ".join(words.split()) for name, words in _DOCUMENTED.findall(text)}


def read_scene_file(path: Path, inner: bool = False) -> SceneFile:
    """Read the elements of one scene file; `inner`: of one that another includes.

    Raises
    ------
    InputError
        If the file can't be read, is no well-formed XML, or holds what the table above refuses.
    """
    data = _bytes(path)
    text, encoding = _decoded(path, data)
    if inner and encoding not in _MITSUBAS:
        raise _encoding_refused(path, encoding)
    parser = expat.ParserCreate("utf-8")
    elements: list[Element] = []
    depth = 0

    def opened(tag: str, attributes: dict[str, str]) -> None:
        nonlocal depth
        depth += 1
        here = Element(path, parser.CurrentLineNumber, depth, tag, attributes)
        if depth > MOST_NESTED:
            raise InputError(
                f"{here.where}: <{shortened(tag)}> lies in {depth - 1} other elements; nest no more"
                f" than {MOST_NESTED}"
            )
        for name, value in attributes.items():
            if len(value) > LONGEST_VALUE:
                raise InputError(
                    f"{here.where}: {name} of <{shortened(tag)}> has {len(value)} characters; give"
                    f" no more than {LONGEST_VALUE}"
                )
        elements.append(here)

    def closed(tag: str) -> None:
        nonlocal depth
        depth -= 1

    def entity(name: str, *rest: object) -> None:
        raise InputError(
            f"{path}, line {parser.CurrentLineNumber}: <!ENTITY {shortened(name)}>: Mitsuba expands"
            " no entities; write its text where it is used, or use $parameters"
        )

    parser.StartElementHandler, parser.EndElementHandler = opened, closed
    parser.EntityDeclHandler = entity
    try:
        parser.Parse(text.encode("utf-8", "surrogatepass"), True)
    except expat.ExpatError as error:
        _check_it_is_a_scene(path, data)
        raise InputError(f"{path}: not well-formed XML ({error}); mend that line") from None
    plain = encoding in _PLAIN
    notes = () if plain else (f"{path}: read as {encoding}, as its first bytes say",)
    return SceneFile(elements, text, notes)


def included(
    file: SceneFile, folders: dict[Path, None], values: dict[str, str], parents: tuple[Path, ...]
) -> Iterator[tuple[SceneFile, tuple[Path, ...]]]:
    """Give the files that a scene file includes, and theirs, each with the files it is in.

    `folders`, in which files are searched, grows by the ``<path>`` elements.

    Raises
    ------
    InputError
        If one can't be read, or files include one another.
    """
    for element in file.elements:
        texts = [filled(text, values) for text in element.attributes.values()]
        if element.tag == "path":
            folders |= {folder / text: None for folder in list(folders) for text in texts}
        if element.tag != "include":
            continue
        found = included_file(element, folders, values)
        if found is None:
            continue  # Mitsuba says so, with the line
        if found.resolve() in parents:
            raise InputError(
                f"{element.where}: <include>: {found} includes itself; take one of them out"
            )
        if len(parents) > MOST_INCLUDED:
            raise InputError(
                f"{element.where}: <include>: {len(parents)} files deep; include no more than"
                f" {MOST_INCLUDED} in one another"
            )
        inner, within = read_scene_file(found, inner=True), (*parents, found.resolve())
        yield inner, within
        yield from included(inner, folders, values, within)


def included_file(element: Element, folders: Iterable[Path], values: dict[str, str]) -> Path | None:
    """The file that an ``<include>`` names, if it is in one of the folders."""
    name = element.attributes.get("filename", "")
    if name == MATERIAL and "material" in values:
        with naming(element.where):
            return find_material(values["material"], folders)
    name = filled(name, values)
    return next((p for f in folders if exists(p := f / name)), None) if name else None


def filled(text: str, values: dict[str, str]) -> str:
    """A text with values in place of its ``$parameters``.

    Raises
    ------
    InputError
        If it grows beyond reason.
    """
    for name in sorted(values, key=len, reverse=True):
        more = text.count(f"${name}") * (len(values[name]) - len(name) - 1)
        if len(text) + more > LONGEST_VALUE:
            raise InputError(
                f"${shortened(name)}: a value grows beyond {LONGEST_VALUE} characters once"
                " parameters are filled in; give a shorter <default>"
            )
        text = text.replace(f"${name}", values[name])
    return text


def shortened(text: str, most: int = 80) -> str:
    """A text for a message: one line, no control characters, long words cut."""
    text = re.sub(r"[^\S ]+|[\x00-\x1f\x7f-\x9f]", " ", text)
    return re.sub(rf"\S{{{most},}}", lambda word: f"{word[0][: most - 20]}...", text)


def _bytes(path: Path) -> bytes:
    size = readable(path).stat().st_size
    if size > LARGEST_FILE:
        with path.open("rb") as file:
            _check_it_is_a_scene(path, file.read(1000))
        raise InputError(
            f"{path}: {size / 2**20:.0f} MiB are no scene file; give at most"
            f" {LARGEST_FILE >> 20} MiB of XML"
        )
    try:
        return path.read_bytes()
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from None


def _decoded(path: Path, data: bytes) -> tuple[str, str]:
    """Text without its declaration, line by line the same, and Python's name of its encoding."""
    declared = next((name for mark, name in _MARKS.items() if data.startswith(mark)), "")
    if not declared:
        found = _DECLARATION.match(data[:1000].decode("ascii", "replace").lstrip())
        declared = found[1] if found else "utf-8"
    try:
        encoding = codecs.lookup(declared).name
        text = data.decode(encoding)
    except UnicodeDecodeError as error:
        _check_it_is_a_scene(path, data)
        line = data[: error.start].count(b"\n") + 1
        raise InputError(
            f"{path}, line {line}: not {shortened(declared)} as it says ({error.reason}); save it"
            " as UTF-8"
        ) from None
    except (LookupError, ValueError):
        raise _encoding_refused(path, declared) from None
    return _DECLARATION.sub(lambda head: re.sub(r"[^\n]", " ", head[0]), text, count=1), encoding


def _check_it_is_a_scene(path: Path, data: bytes) -> None:
    """Refuse a file that holds something else, and say what."""
    image = any(data.startswith(mark) for mark in _IMAGES)
    if is_part(path, data) and not image:
        name = shlex.quote(path.stem)
        raise InputError(
            f"{path} is a part, not a scene; `virtual-sensor new {name} --part"
            f" {shlex.quote(f'{path}')}` makes one"
        )
    if image:
        raise InputError(
            f"{path} is an image, not a scene; `virtual-sensor detect"
            f" {shlex.quote(f'{path}')}` finds its lines"
        )
    if data.startswith(_FIELDS):
        raise InputError(
            f"{path} is a field of air, not a scene; give it to one: `virtual-sensor measure SCENE"
            f" -D field={shlex.quote(f'{path}')}`"
        )


def _encoding_refused(path: Path, encoding: str) -> InputError:
    return InputError(
        f"{path}: its encoding, {shortened(encoding)}, can't be read; save the file as UTF-8"
    )
