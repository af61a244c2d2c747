"""The command `virtual-sensor new`."""

import sys
from collections.abc import Callable
from contextlib import suppress
from dataclasses import replace
from pathlib import Path
from typing import Annotated, Any

import typer

from virtual_sensor.cli import shared
from virtual_sensor.errors import InputError
from virtual_sensor.files import readable
from virtual_sensor.imaging.new_scene.options import SPELT, NewScene

EPILOG = (
    "Examples:\n\n"
    "    virtual-sensor new bracket --part bracket.stl\n\n"
    "    virtual-sensor new bracket --part bracket.stl --unit in --focal-length 25 --distance 300"
    "\n\n"
    "    virtual-sensor new bracket --part bracket.stl --roughness 0.2\n\n"
    "    virtual-sensor new pair --part bracket.stl --alpha 30 --alpha -30 --tilt 0 --tilt 10\n\n"
    "    virtual-sensor new bracket_fringes --part bracket.stl --projector --tilt -15\n\n"
    "    virtual-sensor new bracket --part bracket.stl --f-number 8 --sensor-tilt laser_plane"
    " --sensor-model cmos_5um5\n\n"
    "    virtual-sensor new shaft --diameter 40 --length 200 --temperature 900\n\n"
    "    virtual-sensor new mine --from hot_cylinder --focal-length 50 --distance 400"
)


@shared.with_options
def new(
    name: Annotated[
        str, typer.Argument(metavar="NAME", help="File of the scene; .xml may be left out.")
    ],
    *,
    said: NewScene,
    overwrite: Annotated[
        bool, typer.Option("--overwrite", help="Replace files that exist.")
    ] = False,
) -> None:
    """Write a scene of your own, a part and the sensor over it, that `measure` runs at once.

    What you don't say is chosen so that it suits the part, and said. In a terminal you are asked
    in two cases only, and Enter takes what stands in [brackets]. With NAME alone: for the part, the
    lens, the distance and the temperature. With --part and without --unit: for the unit of a file
    whose part would be smaller than 1 mm or larger than 2 m.
    """
    said = _asked(said)
    from virtual_sensor.imaging.new_scene.write import write_scene
    from virtual_sensor.reporting.new_scene import next_steps, notes, on_console

    with shared.reporting("trying the scene"):
        written = write_scene(Path(name), said, overwrite)
    shared.print_results(on_console(written, said), notes(written))
    shared.print_time("next:")
    for line in next_steps(written, said):
        shared.console.print(f"  {line}")


def _asked(said: NewScene) -> NewScene:
    """Ask for what matters and was not said, if there is somebody to ask."""
    if said.from_scene or not (sys.stdin.isatty() and shared.console.is_terminal):
        return said
    answers: dict[str, Any] = {}
    with suppress(EOFError):  # the rest is chosen
        if not said.given:
            shared.console.print("Enter alone takes what stands in [brackets].")
            answers["part"] = _answer("File of the part", "none: a cylinder", _file)
            for name, (words, otherwise) in _CYLINDER.items():
                if not answers["part"]:
                    answers[name] = _answer(words, otherwise, float)
        part = said.part or answers.get("part")
        if part and not said.unit and Path(part).suffix.lower() != ".3mf":  # which has its own
            answers["unit"] = _asked_unit(part, always=not said.given)
        if not said.given:
            for name, words in _SENSOR.items():
                answers[name] = _answer(words, "chosen to suit", float)
            answers["temperature_c"] = _answer("Temperature of the part, degC", "cold", float)
    return replace(said, **{name: value for name, value in answers.items() if value is not None})


def _asked_unit(part: str, always: bool) -> str | None:
    """The unit of a part's file, asked for where mm are not plausible, or always."""
    from virtual_sensor.imaging.part_survey import likely_unit, plausible, survey
    from virtual_sensor.imaging.parts import find_part

    file = find_part(part)
    size_mm = survey(file).size_mm
    if plausible(size_mm) and not always:
        return None
    likely = likely_unit(size_mm)
    size = " x ".join(f"{length:.4g}" for length in size_mm)
    answer = _answer(f"{file.name} is {size}: in which unit", likely, _unit)
    return answer or (likely if likely != "mm" else None)


_CYLINDER = {"diameter_mm": ("Diameter, mm", "27"), "length_mm": ("Length, mm", "170")}
_SENSOR = {"focal_length_mm": "Focal length of the lens, mm", "distance_mm": "Distance, mm"}


def _answer(words: str, otherwise: str, reader: Callable[[str], Any]) -> Any:
    """What is typed; None of nothing."""
    while text := shared.console.input(f"{words} [{otherwise}]: ", markup=False).strip():
        try:
            return reader(text)
        except ValueError as error:  # InputError among them
            said = f"{error}" if isinstance(error, InputError) else f"{text} is no number"
            shared.console.print(said, style="red")
    return None


def _file(text: str) -> str:
    from virtual_sensor.imaging.parts import find_part

    return f"{readable(find_part(text))}"


def _unit(text: str) -> str:
    from virtual_sensor.imaging.part_survey import UNITS_MM

    known = {**SPELT, **UNITS_MM}
    if text not in known:
        raise InputError(f"{text}: give one of {', '.join(known)}")
    return text
