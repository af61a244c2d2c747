"""Write the generated pages of ``reference``: ``python docs/make_reference.py``.

The words are the program's own: of its help, docstrings, statuses and scenes.
"""

import functools
import inspect
import re
import types
import typing
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib import import_module
from pathlib import Path
from typing import Any

import typer
from make_data_dictionary import dictionary, files
from virtual_sensor_plugins import glow, laser_line, lens_camera, pattern_projector, refractive

import virtual_sensor as vs
from virtual_sensor import cli
from virtual_sensor.imaging.materials import installed_materials
from virtual_sensor.imaging.scene_file import parameter_words, read_scene_file, shipped_scenes
from virtual_sensor.reporting.sweep import unit_of
from virtual_sensor.statuses import StatusEnum
from virtual_sensor.studies.sweep_table import SweptParameter

FOLDER = Path(__file__).parent / "reference"

ROOMS = {
    "imaging": "Scenes and images",
    "devices": "Lasers and projectors",
    "metrology": "From images to numbers",
    "optics": "Light through air",
    "medium": "Air",
    "": "Poses, files and errors",
}
"""Headings of the API, by where in the program a name is at home."""

ELEMENTS = (
    ("integrator", "refractive", refractive.Refractive),
    ("emitter", "laser_line", laser_line.LaserLineEmitter),
    ("sensor", "lens_camera", lens_camera.LensCameraSensor),
    ("emitter", "pattern_projector", pattern_projector.PatternProjector),
    ("emitter", "glow", glow.Glow),
)
"""The plugins that a scene names."""

VALUES = {bool: "", float: "NUMBER", int: "N", str: "TEXT", Path: "PATH"}


def table(head: Sequence[str], rows: Iterable[Sequence[str]]) -> str:
    """A table in Markdown, of cells that are Markdown."""
    cells = [
        list(head),
        ["---"] * len(head),
        *([c.replace("|", "\\|") for c in row] for row in rows),
    ]
    return "".join(f"| {' | '.join(row)} |\n" for row in cells)


# --- the API -------------------------------------------------------------------------------------


def api() -> str:
    """What `import virtual_sensor as vs` gives."""
    names = {f"vs.{name}": getattr(vs, name) for name in vs.__all__}
    return _api_page(
        "Python API",
        "`import virtual_sensor as vs` gives these names. The objects that they take and give are"
        " of [further classes](api_classes.md). Lengths are in mm, temperatures in °C, angles in"
        " degrees, pixels (u, v) with integers at pixel centres. Names are described below the"
        " table, on the site; in Python `help(vs.render)` prints the same.",
        names,
    )


def api_classes() -> str:
    """The classes to which the names of `vs` lead."""
    public = [getattr(vs, name) for name in vs.__all__]
    reached = reached_classes(public) - {each for each in public if isinstance(each, type)}
    return _api_page(
        "Classes",
        "Objects of these classes are what the names of [`vs`](api.md) take and give, or consist"
        " of. They are described below the table, on the site; in Python `help(type(scene))` prints"
        " the same.",
        {each.__name__: each for each in sorted(reached, key=lambda each: each.__name__)},
    )


def _api_page(title: str, words: str, names: dict[str, Any]) -> str:
    """An index of names, then their descriptions, in the order of the rooms."""
    rooms = {
        heading: [n for n in names if _room(names[n]) == room] for room, heading in ROOMS.items()
    }
    rows: list[tuple[str, str]] = []
    for heading, chosen in rooms.items():
        rows += [(f"**{heading}**", "")] if chosen else []
        rows += [(f"[`{name}`](#{_slug(name)})", _summary(names[name])) for name in chosen]
    parts = [f"# {title}\n", f"{words}\n", table(("name", "what it is"), rows)]
    for heading, chosen in rooms.items():
        parts += [f"## {heading}\n"] if chosen else []
        parts += [f"### {name}\n\n::: {_path(names[name])}\n" for name in chosen]
    return "\n".join(parts)


def _slug(name: str) -> str:
    """The anchor of a heading, as GitHub and the site make it."""
    return re.sub(r"[^\w-]", "", name.lower())


def reached_classes(targets: Iterable[Any]) -> set[type]:
    """Our public classes that functions and classes name, in annotations, bases and members."""
    found: set[type] = set()
    waiting = list(targets)
    while waiting:
        target = waiting.pop()
        if isinstance(target, type):
            if target in found or target.__name__.startswith("_"):
                continue
            found.add(target)
            waiting += [each for each in target.__bases__ if _ours(each)]
            waiting += map(_function, (v for n, v in vars(target).items() if n[0] != "_"))
        hints = typing.get_type_hints(target) if callable(target) else {}
        for name, hint in hints.items():
            if not name.startswith("_"):
                waiting += _classes_in(hint)
    return found


def _function(member: Any) -> Any:
    """The function behind a member of a class."""
    if isinstance(member, property):
        return member.fget
    if isinstance(member, functools.cached_property):
        return member.func
    member = getattr(member, "__func__", member)
    return member if inspect.isfunction(member) else None


def _classes_in(hint: Any) -> Iterator[type]:
    if isinstance(hint, type) and not isinstance(hint, types.GenericAlias):
        if _ours(hint):
            yield hint
    else:
        for argument in typing.get_args(hint):
            yield from _classes_in(argument)


def _ours(kind: type) -> bool:
    return kind.__module__.startswith("virtual_sensor")


def _room(target: Any) -> str:
    room = target.__module__.removeprefix("virtual_sensor").split(".")[1]
    return room if room in ROOMS else "imaging" if "plugins" in target.__module__ else ""


def _path(target: Any) -> str:
    return f"{target.__module__}.{target.__qualname__}"


def _summary(target: Any) -> str:
    """The first sentence of a docstring."""
    return " ".join((inspect.getdoc(target) or "").split("\n\n")[0].split())


# --- the commands --------------------------------------------------------------------------------


def commands() -> str:
    """Each command with its options, their defaults, and its examples."""
    app: Any = typer.main.get_command(cli.app)
    every = dict(_commands(app))
    rows = [(f"[`{name}`](#{_anchor(name)})", _first(each.help)) for name, each in every.items()]
    parts = [
        "# Commands\n",
        "`virtual-sensor COMMAND --help` prints the same.\n",
        table(("command", "what it does"), rows),
        "## Before the command\n",
        _options(app),
    ]
    for name, each in every.items():
        arguments = [p for p in each.params if p.param_type_name == "argument"]
        usage = " ".join(["virtual-sensor", name, *(_argument(p) for p in arguments), "[OPTIONS]"])
        parts += [f"## {name}\n", f"{each.help}\n", f"```text\n{usage}\n```\n", _options(each)]
        examples = re.findall(r"^    (.+)$", each.epilog or "", re.MULTILINE)
        parts.append(
            "\n".join(["<!-- not run: a test reads their options -->", "```sh", *examples, "```\n"])
        )
    return "\n".join(parts)


def _commands(group: Any, before: str = "") -> Iterator[tuple[str, Any]]:
    for name, each in group.commands.items():
        if not hasattr(each, "commands") or each.invoke_without_command:
            yield before + name, each
        if hasattr(each, "commands"):
            yield from _commands(each, f"{name} ")


def _anchor(name: str) -> str:
    return name.replace(" ", "-")


def _first(text: str) -> str:
    return text.split("\n\n")[0]


def _argument(parameter: Any) -> str:
    name = parameter.metavar or parameter.name.upper()
    name = f"{name} ..." if parameter.nargs == -1 else name
    return name if parameter.required else f"[{name}]"


def _options(command: Any) -> str:
    """A table of a command's arguments and options."""
    hints = typing.get_type_hints(command.callback)
    signature = inspect.signature(command.callback)
    rows = []
    for each in command.params:
        hint = signature.parameters[each.name].annotation
        hint = hints[each.name] if isinstance(hint, str) else hint
        if each.param_type_name == "argument":
            name = _argument(each)
        else:
            value = "" if each.is_flag else each.metavar or _value(hint)
            name = f"{' '.join(sorted(each.opts, key=len))} {value}".strip()
        default = (
            "" if each.default in (None, False, "") or callable(each.default) else each.default
        )
        default = f"{default:g}" if isinstance(default, float) else str(default)
        shown = "required" if each.required else f"`{default}`" if default else ""
        rows.append((f"`{name}`", shown, " ".join((each.help or "").split())))
    return table(("option", "default", "what it does"), rows)


def _value(hint: Any) -> str:
    """The word that stands for an option's value."""
    if hint in VALUES:
        return VALUES[hint]
    words = (_value(each) for each in typing.get_args(hint) if each is not type(None))
    return next((word for word in words if word), "TEXT")


# --- the scenes' parameters ----------------------------------------------------------------------


def scene_parameters() -> str:
    """The parameters of the shipped scenes, with unit and default."""
    scenes = sorted(
        shipped_scenes().glob("*.xml"), key=lambda path: (path.stem != "hot_cylinder", path.stem)
    )
    words: dict[str, str] = {}
    defaults: dict[str, dict[str, str]] = {}
    for path in scenes:
        words = parameter_words(path) | words
        for name, value in read_scene_file(path).defaults.items():
            defaults.setdefault(name, {})[path.stem] = value
    rows = []
    for name, by_scene in defaults.items():
        only = "" if len(by_scene) == len(scenes) else ", ".join(f"`{scene}`" for scene in by_scene)
        values = {f"`{value}`" if value else "empty" for value in by_scene.values()}
        unit = unit_of(SweptParameter(name, words[name], ()))
        said = re.sub(r",? ?\b(degrees|degC|mm|nm|px|s|um)\b(?=[,;:]|$)", "", words[name])
        rows.append((f"`{name}`", unit, said, ", ".join(sorted(values)), only))
    head = ("parameter", "unit", "what it is", "default", "only in")
    return "\n".join(
        [
            "# Scene parameters\n",
            "The shipped scenes " + ", ".join(f"`{path.stem}`" for path in scenes) + " have these"
            " parameters. Commands set them by `-D beta=15`, Python by"
            ' `vs.load_scene("hot_cylinder", beta=15)`, and the command `sweep` varies them. A'
            " scene of your own declares its parameters by `<default>` elements; a wrong name is"
            " answered with all names of the scene. Angles and lengths of the sensor are drawn in"
            " the [glossary](glossary.md).\n",
            table(head, rows),
            "## Materials\n",
            "The parameter `material` names the surface of a part: one of these, which are files of"
            " Mitsuba's elements `bsdf`, or a file of your own. They are shown in"
            " [what shiny parts do to a laser line](../explanation/shiny_parts.md). Each has"
            " parameters of its own, which are given like those of the scene, such as"
            " `-D material=ground_steel -D roughness=0.1`. Where a part has texture coordinates, u"
            " is along the lay of its surface and v across it.\n",
            table(("material", "what it is", "parameters"), _materials()),
        ]
    )


def _materials() -> list[tuple[str, str, str]]:
    """Each installed material: its name, what its file says first, and its parameters."""
    rows = []
    for path in installed_materials():
        said = re.search(r"<!--(.*?)-->", path.read_text(encoding="utf-8"), re.DOTALL)
        words, values = parameter_words(path), read_scene_file(path).defaults
        parameters = "; ".join(f"`{n}` ({value}): {words[n]}" for n, value in values.items())
        rows.append((f"`{path.stem}`", " ".join(said[1].split()) if said else "", parameters))
    return rows


# --- the scenes' elements ------------------------------------------------------------------------


def scene_elements() -> str:
    """The elements that this program adds to Mitsuba's, with their properties."""
    parts = [
        "# Scene elements\n",
        "A scene is ordinary Mitsuba XML. These elements are this program's own; all others are"
        " [Mitsuba's](https://mitsuba.readthedocs.io/en/stable/src/plugin_reference.html).\n",
    ]
    for kind, name, plugin in ELEMENTS:
        said = (inspect.getdoc(plugin) or "").replace("``", "`")
        before, lines, after = re.split(
            r"(?:^|\n)=+(?: +=+)+\nProperty.*\n=+(?: +=+)+\n|\n=+(?: +=+)+(?:\n|$)", said
        )
        parts += [f"## {name}\n", f'`<{kind} type="{name}">`\n', f"{before.strip()}\n"]
        parts.append(table(("property", "default", "meaning"), _properties(lines)))
        parts += [f"{after.strip()}\n"] if after.strip() else []
    return "\n".join(parts)


def _properties(lines: str) -> list[list[str]]:
    """The rows of a table of properties; one that begins with spaces goes on with the last."""
    rows: list[list[str]] = []
    for line in lines.splitlines():
        if line.startswith(" "):
            rows[-1][2] += f" {line.strip()}"
        else:
            name, default, meaning = re.split(r" {2,}|(?<=\"|\)) ", line, maxsplit=2)
            rows.append(
                [f"`{name}`", default.strip("()") if "(" in default else f"`{default}`", meaning]
            )
    return rows


# --- statuses ------------------------------------------------------------------------------------


def statuses() -> str:
    """Each enumeration of statuses, its members and their messages."""
    parts = [
        "# Statuses\n",
        "Beside every value that may be missing stands a status. Arrays hold its number, files its"
        " name in lower case. `Status(number).message` says what it means, `Status.counts(array)`"
        " how many there are of each. The cases of a sweep have"
        " [a status of their own](../how_to/sweep.md#the-table).\n",
    ]
    kinds = sorted(status_kinds(), key=lambda kind: kind.__name__)
    rows = [(f"[`{kind.__name__}`](#{kind.__name__.lower()})", _summary(kind)) for kind in kinds]
    parts.append(table(("status", "what it says"), rows))
    for kind in kinds:
        members = [(f"`{each.name}`", str(int(each)), each.message) for each in kind]
        parts += [f"## {kind.__name__}\n", f"{_summary(kind)} `{kind.__module__}`\n"]
        parts.append(table(("member", "value", "meaning"), members))
    return "\n".join(parts)


def status_kinds() -> list[type[StatusEnum]]:
    """The statuses of all modules."""
    package = Path(vs.__file__).parent
    for file in package.rglob("*.py"):
        if "(StatusEnum):" in file.read_text(encoding="utf-8"):
            import_module(".".join(file.relative_to(package.parent).with_suffix("").parts))
    return StatusEnum.__subclasses__()


PAGES: dict[str, Callable[[], str]] = {
    "api.md": api,
    "api_classes.md": api_classes,
    "commands.md": commands,
    "data_dictionary.md": lambda: dictionary(files()),
    "scene_elements.md": scene_elements,
    "scene_parameters.md": scene_parameters,
    "statuses.md": statuses,
}

if __name__ == "__main__":
    for name, page in PAGES.items():
        (FOLDER / name).write_text(page(), encoding="utf-8")
