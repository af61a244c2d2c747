"""What is said of a scene that was written."""

from pathlib import Path

from virtual_sensor.imaging.new_scene.options import NewScene
from virtual_sensor.imaging.new_scene.write import SeenLine, WrittenScene, parameter_of

_NOTED = 0.02  # of a line that is not seen
_CHOSEN = {
    "focal_length_mm": "a lens of {} mm",
    "distance_mm": "the camera {} mm from the line",
    "line_length_mm": "a line {} mm long",
    "line_radius_mm": "a line radius of {} mm",
}


def on_console(written: WrittenScene, said: NewScene) -> list[str]:
    """Sentences for a terminal: the files, the part, the sensor, and what to do next."""
    copied = f", and beside it {', '.join(str(file) for file in written.copied)}"
    lines = [f"{written.path} is written{copied if written.copied else ''}."]
    if found := written.survey:
        size = " x ".join(f"{length:.4g}" for length in found.size_mm)
        unit = "" if said.unit else " (lengths in mm; if they are not, say --unit)"
        facets = f", facets within {found.facet_error_um:.2g} µm" if found.facet_error_um else ""
        lines.append(f"The part is {size} mm{unit}: {found.triangles} triangles{facets}.")
    chosen = [
        _CHOSEN[name].format(written.parameters[parameter_of(name)])
        for name in _CHOSEN
        if name in written.chosen
    ]
    if chosen:
        lines.append(f"Chosen to suit it: {', '.join(chosen)}.")
    lines.append(_view(written))
    if written.aside:
        lines.append(
            f"There is no surface under the middle of the part: the {_light(written)} is beside it,"
            " at the nearest place where it lights a good part (another: --at X,Y)."
        )
    return lines


def _view(written: WrittenScene) -> str:
    """What the camera sees."""
    values = {name: float(written.parameters[name]) for name in _VIEW if name in written.parameters}
    if len(values) < len(_VIEW):
        return ""
    scale = values["distance"] / values["focal_length"]
    width = values["film_width"] * scale
    height = width * values["height"] / values["width"]
    pixel_um = 1e3 * width / values["width"]
    return (
        f"The camera sees {width:.3g} x {height:.3g} mm at that distance, {pixel_um:.3g} µm per"
        f" pixel; the {_light(written)} is in the middle, at ({', '.join(_place(written))}) mm."
    )


_VIEW = ("distance", "focal_length", "film_width", "width", "height")


def _light(written: WrittenScene) -> str:
    return "light" if written.projects else "line"


def _place(written: WrittenScene) -> list[str]:
    return [written.parameters.get(f"at_{axis}", "0") for axis in "xyz"]


def notes(written: WrittenScene) -> list[str]:
    """What part of the line is not seen, and the scene's own notes."""
    found = [written.unit_note] if written.unit_note else []
    for (camera, laser), line in written.lines.items():
        which = f"{camera} with {laser}: " if len(written.lines) > 1 else ""
        words = _unseen(line)
        if words:
            found.append(f"{which}{line.seen:.0%} of the line is seen; {', '.join(words)}")
    return [*found, *written.notes]


def _unseen(line: SeenLine) -> list[str]:
    """Why parts of a line are not seen, and what would change that."""
    causes = {
        "passes the part or falls through a hole (--line-length, --at)": line.beside,
        "lies outside the image (--distance, --focal-length)": line.outside,
        "is hidden by the part (--alpha, --turn)": line.hidden,
    }
    return [f"{share:.0%} {words}" for words, share in causes.items() if share > _NOTED]


def next_steps(written: WrittenScene, said: NewScene) -> list[str]:
    """Commands to go on with."""
    scene = _quoted(written.path.with_suffix(""))
    command = f"virtual-sensor {'fringes' if written.projects else 'measure'} {scene}"
    if written.projects:  # by one camera and one projector
        first = {"alpha_1": " --camera camera_1", "tilt_1": " --source projector_1"}
        command += "".join(option for name, option in first.items() if name in written.parameters)
    if said.temperature_c is None or written.parameters.get("field"):
        return [command]
    stem = written.path.stem
    air = _quoted(written.path.with_name(f"{stem}_air.nc"))
    cold, hot = (_quoted(Path(f"{stem}_{state}")) for state in ("cold", "hot"))
    return [
        f"{command} -o {cold}    # as long as there is no air",
        f"virtual-sensor field simulate --scene {scene} --quick",
        f"{command} -D field={air} -o {hot}",
    ]


def _quoted(path: Path) -> str:
    import shlex

    return shlex.quote(str(path))
