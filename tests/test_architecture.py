"""The house: imports go down the stairs only, and what is promised to users is there."""

import ast
import inspect
import re
import shlex
import subprocess
import sys
import tomllib
from functools import cache
from pathlib import Path
from typing import Any
from xml.etree import ElementTree

import importlinter.cli
import pytest
import typer

import virtual_sensor as vs
from virtual_sensor import cli
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.imaging.scene_file import find_scene, shipped_scenes

ROOT = Path(__file__).parents[1]
PACKAGES = {
    "virtual_sensor": ROOT / "virtual_sensor",
    "virtual_sensor_plugins": ROOT / "plugins",
    "virtual_sensor_scenes": ROOT / "scenes",
}
# Metrology serves images of real cameras too: it knows no renderer, and bent rays only when asked.
METROLOGY_KNOWS = (
    "virtual_sensor.arrays",
    "virtual_sensor.calls",
    "virtual_sensor.devices.calibration_files",
    "virtual_sensor.devices.patterns",
    "virtual_sensor.devices.sheet_rows",
    "virtual_sensor.display",
    "virtual_sensor.errors",
    "virtual_sensor.files",
    "virtual_sensor.metrology",
    "virtual_sensor.optics.crossing_status",
    "virtual_sensor.optics.ray_families",
    "virtual_sensor.optics.sensor_geometry",
    "virtual_sensor.optics.sources",
    "virtual_sensor.poses",
    "virtual_sensor.statuses",
)
METROLOGY_KNOWS_WHEN_ASKED = (
    *METROLOGY_KNOWS,
    "virtual_sensor.medium.air_model",
    "virtual_sensor.optics",
)
SCENES = sorted(path.stem for path in shipped_scenes().glob("*.xml"))


def modules():
    """Map from the names of our modules to their files."""
    named = {}
    for package, folder in PACKAGES.items():
        for file in folder.rglob("*.py"):
            parts = file.relative_to(folder).with_suffix("").parts
            named[".".join([package, *(p for p in parts if p != "__init__")])] = file
    return named


MODULES = modules()
TOOLS = [file for room in ("tests", "benchmarks", "docs") for file in (ROOT / room).rglob("*.py")]


def imports(file, lazy=True):
    """Names of the modules that a file imports; of those inside functions only if lazy."""
    return imports_of(file)[lazy]


@cache
def imports_of(file):
    """Names of the modules that a file imports: by whether those inside functions count."""
    tree = ast.parse(file.read_text(encoding="utf-8"))
    return [
        {name for node in nodes for name in imported(node)} for nodes in (tree.body, ast.walk(tree))
    ]


def imported(node):
    """Names of the modules that a statement imports."""
    if isinstance(node, ast.Import):
        return {alias.name for alias in node.names}
    if isinstance(node, ast.ImportFrom):
        assert node.level == 0, f"{ast.unparse(node)}: write relative imports out"
        members = {f"{node.module}.{alias.name}" for alias in node.names}
        return {name if name in MODULES else node.module for name in members}
    return set()


def is_in(module, room):
    """Whether a module is a room, or lies in it."""
    return module == room or module.startswith(f"{room}.")


def in_any(module, rooms):
    """Whether a module is or lies in one of the rooms."""
    return any(is_in(module, room) for room in rooms)


def violations(forbidden, lazy=True):
    """Imports of all modules that are forbidden: by (module, what it imports)."""
    pairs = ((name, other) for name, file in MODULES.items() for other in imports(file, lazy))
    return sorted(f"{name} imports {other}" for name, other in pairs if forbidden(name, other))


def test_the_rooms_keep_their_contracts(capsys, monkeypatch):
    """Rationale: what lies below can be read, tested and used without what lies above.

    The contracts stand in pyproject.toml. What they can't say stands below: what is imported at
    once and what within functions, lists of all that is allowed, and files that are no package's.
    """
    monkeypatch.setattr(sys, "path", [*sys.path])  # which import-linter adds to
    # It would silence all loggers that there are, for the tests after this one.
    monkeypatch.setattr(importlinter.cli, "_configure_logging", lambda verbose: None)
    kept = (
        importlinter.cli.lint_imports(str(ROOT / "pyproject.toml"), no_cache=True, no_logo=True)
        == 0
    )
    assert kept, capsys.readouterr().out


@pytest.mark.parametrize("lazy", [False, True])
def test_metrology_knows_no_mitsuba(lazy):
    """Rationale: it must work on a real camera's images, on a machine without a renderer."""
    known = METROLOGY_KNOWS_WHEN_ASKED if lazy else METROLOGY_KNOWS

    def unknown(name, other):
        ours = is_in(name, "virtual_sensor.metrology") and other.startswith("virtual_sensor")
        return ours and not in_any(other, known)

    assert violations(unknown, lazy) == []


def test_tests_lie_in_rooms_like_what_they_test():
    """Rationale: who moves a module finds its tests, and moves them."""
    tests = {
        file.parent.relative_to(ROOT / "tests").as_posix().replace("/", ".")
        for file in (ROOT / "tests").rglob("test_*.py")
    }
    rooms = {name.replace("virtual_sensor_plugins", "virtual_sensor.plugins") for name in MODULES}
    assert {f"virtual_sensor.{room}" for room in tests - {".", "hostile"}} <= rooms


def test_only_the_engine_imports_drjit():
    """Rationale: Dr.Jit loads the LLVM that it finds at its import, and a bad one kills."""
    users = {
        file.relative_to(ROOT).as_posix()
        for file in [*MODULES.values(), *TOOLS]
        if re.search(r"import .*\b(drjit|mitsuba)|from (drjit|mitsuba)", file.read_text("utf-8"))
        and any(in_any(name, ("drjit", "mitsuba")) for name in imports(file))
    }
    assert users == {"virtual_sensor/engine.py"}


def test_the_oracles_know_nothing_of_the_project():
    """Rationale: no mistake may stand on both sides of a test."""
    assert not any(name.startswith("virtual_sensor") for name in imports(ROOT / "tests/oracles.py"))


def test_importing_the_package_starts_no_engine():
    """Rationale: those who only look for lines in images must not pay for a renderer."""
    code = (
        "import sys, virtual_sensor as vs; dir(vs); vs.line_centres; vs.triangulate\n"
        "print({'drjit', 'mitsuba', 'matplotlib'} & sys.modules.keys())"
    )
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (ended.stdout, ended.stderr) == ("set()\n", "")


def test_the_commands_load_no_numpy_before_one_runs():
    """Rationale: it is a third of the time that `--help` takes."""
    code = "import sys, virtual_sensor.cli.commands; print({'numpy', 'drjit'} & sys.modules.keys())"
    ended = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (ended.stdout, ended.stderr) == ("set()\n", "")


@pytest.mark.parametrize(
    ("name", "arguments"),
    [
        (
            "air_refractivity",
            "wavelength_nm temperature_c pressure_pa relative_humidity co2_ppm",
        ),
        ("trace", "field origins_mm directions length_mm step_mm method precision"),
        ("load_scene", "name parameters"),
        ("render", "scene spp seed"),
        ("ray_search", "scene laser_y_mm method"),
        ("line_centres", "image method"),
        ("triangulate", "sensor pixel"),
        ("IndexField.from_arrays", "refractivity origin_mm spacing_mm"),
        ("IndexField.read", "path"),
        ("IndexField.write", "self path"),
        ("IndexField.refractivity", "self points_mm"),
    ],
)
def test_what_users_rely_on_is_there(name, arguments):
    """Rationale: these names and the order of their arguments are a promise."""
    thing = vs
    for part in name.split("."):
        thing = getattr(thing, part)
    given = list(inspect.signature(thing).parameters)
    assert given[: len(arguments.split())] == arguments.split()


def test_every_public_name_resolves():
    """Rationale: the lazy door keeps a list of its own, which must agree with the house."""
    assert dir(vs) == sorted(vs.__all__) == sorted(vs._HOME)
    assert all(getattr(vs, name) is not None for name in vs.__all__)
    with pytest.raises(AttributeError, match="no attribute 'rays_search'"):
        _ = vs.rays_search  # type: ignore[attr-defined]


@pytest.mark.parametrize("name", SCENES)
def test_shipped_scenes_are_found_by_name_from_anywhere(name, tmp_path, monkeypatch):
    """Rationale: a user's first command runs in a folder of their own."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / name).mkdir()  # results, say: no scene
    assert find_scene(name) == find_scene(f"{name}.xml") == shipped_scenes() / f"{name}.xml"
    assert load_scene(name).camera.size == (2048, 2048)


def shipped():
    """Files of the scenes' package that an installation holds, by the patterns of pyproject."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    patterns = settings["tool"]["setuptools"]["package-data"]
    files = {pattern: list((ROOT / "scenes").glob(pattern)) for pattern in patterns.pop(SHIPPED)}
    files |= {p: list(PACKAGES[name].glob(p)) for name, each in patterns.items() for p in each}
    return files


SHIPPED = "virtual_sensor_scenes"


def test_what_is_to_be_shipped_exists():
    """Rationale: a pattern that matches nothing ships nothing, and says nothing."""
    for pattern, files in shipped().items():
        assert files, pattern
        assert all(file.stat().st_size > 0 or file.name == "py.typed" for file in files)


@pytest.mark.parametrize("name", SCENES)
def test_what_a_scene_refers_to_is_shipped(name):
    """Rationale: from an editable checkout every file is found, from an installation not."""
    path = ROOT / "scenes" / f"{name}.xml"
    scene = ElementTree.parse(path)
    values = {e.get("name"): e.get("value") for e in scene.iter("default")}
    named = ("field", "filename")
    texts = [e.get("value") for e in scene.iter("string") if e.get("name") in named]
    for file in texts + [element.get("filename") for element in scene.iter("include")]:
        for parameter, value in reversed(values.items()):  # a default may use earlier ones
            file = file.replace(f"${parameter}", value)
        if file:  # no field is none
            assert path.parent / file in [f for files in shipped().values() for f in files]


def test_every_package_is_listed():
    """Rationale: setuptools ships the packages of its list and no others."""
    settings = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
    packages = {n for n, file in MODULES.items() if file.name == "__init__.py"}
    assert set(settings["tool"]["setuptools"]["packages"]) == packages


def command_lines():
    """Commands as README and the help texts show them."""
    pages = [ROOT / "README.md", *(ROOT / "docs").rglob("*.md")]
    pages.remove(ROOT / "docs/reference/commands.md")  # it has the help texts' own
    groups = [group.typer_instance for group in cli.app.registered_groups]
    commands = [c for app in (cli.app, *groups) for c in app.registered_commands]
    commands += [group.registered_callback for group in groups]
    texts = [p.read_text(encoding="utf-8") for p in pages] + [c.epilog or "" for c in commands]
    shown = re.findall(r"\bvirtual-sensor [a-z-][^\n`#&;]+", "\n".join(texts))
    return sorted({line.strip() for line in shown})


@pytest.mark.parametrize("line", command_lines())
def test_commands_that_are_shown_can_be_typed(line, tmp_path, monkeypatch):
    """Rationale: a first command that fails is the last one."""
    words = shlex.split(line)[1:]
    monkeypatch.chdir(tmp_path)
    shown = (shlex.split(each)[1:] for each in command_lines())
    written = {name for word, name, *_ in (each for each in shown if each[1:]) if word == "new"}
    own = [f"{word.removesuffix('.xml')}.xml" for word in words if word in written]
    for name in {*own, *(word for word in words if word.endswith(".xml"))}:  # the reader's own
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text("<scene/>", encoding="utf-8")
    group: Any = typer.main.get_command(cli.app)
    if words != ["--help"]:
        number = next(i for i, word in enumerate(words) if word in group.commands)
        group.make_context("virtual-sensor", words[: number + 1])
        name, *arguments = words[number:]
        command = group.commands[name]
        if arguments and arguments[0] in getattr(command, "commands", {}):  # a group of them
            name, *arguments = arguments
            command = command.commands[name]
        given = command.make_context(name, arguments).params
        scene = given.get("scene") or SCENES[0]
        assert scene in SCENES or scene in written or scene.endswith(".xml")


def test_the_help_names_the_shipped_scenes():
    """Rationale: 'the name of a shipped one' helps only who knows the names.

    Those with a projector are for `fringes`, the others for the commands that look for a line.
    """
    fringes = [name for name in SCENES if name.startswith("fringe_")]
    of_lines = [name for name in SCENES if name not in fringes]
    for command in cli.app.registered_commands:
        argument = inspect.signature(command.callback).parameters.get("scene")
        if argument:
            named = argument.annotation.__metadata__[0].help.split(": ")[1]
            assert sorted(re.findall(r"\w+", named)) in (fringes, of_lines), command.callback
