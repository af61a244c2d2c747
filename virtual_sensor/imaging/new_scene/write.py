"""Writing a new scene: it is loaded and tried first, and then put in place, or nothing is."""

from __future__ import annotations

import dataclasses
import re
import shutil
import warnings
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any
from xml.sax.saxutils import quoteattr

import numpy as np

from virtual_sensor.arrays import numbers_of, truth_of
from virtual_sensor.devices.calibration_files import CalibrationFile, camera_in
from virtual_sensor.devices.camera import MM_PER_UM
from virtual_sensor.devices.image_sensor import image_sensor, image_sensors
from virtual_sensor.devices.projector import Projector
from virtual_sensor.errors import InputError, nearest, short
from virtual_sensor.files import (
    check_output,
    exists,
    path_of,
    readable,
    scratch_folder,
    written_whole,
)
from virtual_sensor.imaging.camera_parameters import with_field_of_view
from virtual_sensor.imaging.checks import check_scene
from virtual_sensor.imaging.materials import installed_materials, materials_with
from virtual_sensor.imaging.new_scene.lasers import close_lines
from virtual_sensor.imaging.new_scene.options import SPELT, UPWARD, NewScene
from virtual_sensor.imaging.new_scene.part import part_of
from virtual_sensor.imaging.new_scene.placement import PIXEL_UM, film_of, placed
from virtual_sensor.imaging.new_scene.text import scene_text, value_text
from virtual_sensor.imaging.part_survey import UNITS_MM, PartSurvey
from virtual_sensor.imaging.scene import Scene, load_scene, scene_parameters
from virtual_sensor.imaging.scene_file import (
    MATERIAL,
    filled,
    find_material,
    find_scene,
    read_scene_file,
    shipped_scenes,
)
from virtual_sensor.medium.find_field import find_field, is_installed
from virtual_sensor.optics.lens import F_NUMBERS
from virtual_sensor.optics.ray_search import SearchStatus, ray_search

_SAMPLES = 201  # rays of a line


@dataclass(frozen=True)
class SeenLine:
    """Shares of a laser's line, from 0 to 1, by what becomes of its light.

    Attributes
    ----------
    seen : float
        By the camera.
    beside : float
        That passes the part.
    outside : float
        That lies on the part, outside the image.
    hidden : float
        That the part hides from the camera.
    """

    seen: float
    beside: float
    outside: float
    hidden: float

    @staticmethod
    def of(scene: Scene) -> SeenLine:
        """Of a scene with one camera and one laser, in cold air."""
        y_mm = scene.laser.along(_SAMPLES)
        found = ray_search(scene.cold(), y_mm, k_stop=1, method="paper", r_max_um=np.inf).status
        statuses = SearchStatus.LASER_MISSED, SearchStatus.OUTSIDE_IMAGE, SearchStatus.UNDERCUT
        beside, outside, hidden = (float(np.mean(found == status)) for status in statuses)
        return SeenLine(1.0 - beside - outside - hidden, beside, outside, hidden)


@dataclass(frozen=True)
class WrittenScene:
    """A scene that was written.

    Attributes
    ----------
    path : Path
    copied : tuple of Path
        Files that were put beside it.
    parameters : Mapping
        Of the scene, by name.
    survey : PartSurvey or None
        Of the part's file, in mm, in the file's own frame.
    chosen : tuple of str
        Options that were not given, and chosen to suit the part.
    lines : Mapping
        `SeenLine` by the names of camera and laser.
    notes : tuple of str
    aside : bool
        Whether the line was put beside the middle of the part, where there is no surface.
    projects : bool
        Whether it has a projector, and is measured by `fringes`.
    unit_note : str
        Of a part that seems to be in another unit than mm, if none was said.
    """

    path: Path
    copied: tuple[Path, ...]
    parameters: Mapping[str, str]
    survey: PartSurvey | None
    chosen: tuple[str, ...]
    lines: Mapping[tuple[str, str], SeenLine]
    notes: tuple[str, ...]
    aside: bool = False
    unit_note: str = ""
    projects: bool = False


@dataclass(frozen=True)
class _Draft:
    """A scene's text, and the files that it names: by their places from its folder."""

    text: str
    files: dict[str, Path]
    survey: PartSurvey | None = None
    chosen: tuple[str, ...] = ()
    aside: bool = False
    unit_note: str = ""


def new_scene(path: str | Path, *, overwrite: bool = False, **options: Any) -> Path:
    """Write a scene of one's own beside a copy of its part, ready to be measured.

    >>> vs.new_scene("bracket.xml", part="bracket.stl", focal_length_mm=35, roughness=0.2)

    Parameters
    ----------
    path : str or Path
        The scene's file; ".xml" may be left out.
    overwrite : bool
        Replace files that exist.
    **options
        Fields of `NewScene`, which says what each is: `part`, `unit`, `up`; `diameter_mm`,
        `length_mm` of a cylinder; `focal_length_mm`, `pixel_um`, `film`, `f_number`,
        `focus_distance_mm`, `sensor_tilt`, `distortion`, `calibration`, `sensor_model`, `exposure`,
        `distance_mm`; `alpha`, `tilt`, `laser_offset_mm`, `beta`, `turn`, `at_mm`; `projector`;
        `line_length_mm`, `line_radius_mm`, `fan`, `wavelength_nm`; `material`, `roughness`,
        `temperature_c`, `field`, `from_scene`.  Several `alpha` make several cameras, several
        `tilt` several lasers or projectors.

    Returns
    -------
    Path
        For `load_scene`.

    Raises
    ------
    InputError
        If an option can't be, the part can't be read, or no camera sees a line; nothing is written
        then.

    Warns
    -----
    UserWarning
        If the part's file seems to be in another unit than mm, and none is said.
    """
    known = [each.name for each in dataclasses.fields(NewScene)]
    if unknown := sorted(options.keys() - {*known}):
        raise InputError(
            f"new_scene: no option '{unknown[0]}'; there are {', '.join(known)}"
            f"{nearest(unknown[0], known)}"
        )
    for name in ("alpha", "tilt", "laser_offset_mm", "at_mm"):
        if options.get(name) is not None:
            options[name] = tuple(numbers_of(f"new_scene: {name}", options[name]).ravel().tolist())
    for name in ("part", "field", "from_scene", "calibration", "material"):
        if options.get(name) is not None:
            options[name] = str(path_of(f"new_scene: {name}", options[name]))
    if isinstance(options.get("film"), (tuple, list)):
        options["film"] = "x".join(map(str, options["film"]))
    if not isinstance(options.get("film", ""), str):
        raise InputError(f"new_scene: film is {short(options['film'])}; give (width, height) in px")
    try:
        written = write_scene(path_of("new_scene: path", path), NewScene(**options), overwrite)
    except InputError as error:
        raise InputError(f"{error}".replace("--overwrite", "overwrite=True")) from None
    if written.unit_note:
        warnings.warn(f"{options['part']}: {written.unit_note}", stacklevel=2)
    return written.path


def write_scene(path: Path, said: NewScene, overwrite: bool = False) -> WrittenScene:
    """Write a scene; see `new_scene`."""
    path = path if path.suffix == ".xml" else path.with_name(f"{path.name}.xml")
    if exists(shipped_scenes() / path.name):
        raise InputError(f"{path}: a scene that is installed has this name; choose another")
    if exists(path) and not overwrite:
        raise InputError(f"{path}: exists; choose another name, or say --overwrite")
    check_output(path, overwrite=True)
    _check(said)
    draft = _copy(path, said) if said.from_scene else _drawn(path, said)
    copies = {path.parent / name: file for name, file in draft.files.items()}
    for target, file in list(copies.items()):
        if exists(target) and (target.samefile(file) or target.read_bytes() == file.read_bytes()):
            del copies[target]
        elif exists(target) and not overwrite:
            raise InputError(
                f"{target}: exists, and {file} would be copied there; rename one of them, or say"
                " --overwrite"
            )
    parameters, lines, notes, projects = _tried(path, draft)
    for target, file in copies.items():
        with written_whole(target) as new:
            shutil.copyfile(file, new)
    with written_whole(path) as new:
        new.write_text(draft.text, encoding="utf-8")
    written = path, tuple(copies), parameters, draft.survey, draft.chosen, lines, notes
    return WrittenScene(*written, draft.aside, draft.unit_note, projects)


def _check(said: NewScene) -> None:
    """Refuse what can't be, by the options' names."""
    size = (
        "diameter_mm length_mm focal_length_mm pixel_um distance_mm line_length_mm line_radius_mm"
        " focus_distance_mm"
    )
    limits = dict.fromkeys(size.split(), (0.0, 1e6)) | {
        **{
            "f_number": F_NUMBERS,
            "wavelength_nm": (200.0, 2000.0),
            "roughness": (0.0, 1.0),
            "fan": (-1e-9, 170.0),
        },
        **{"temperature_c": (-273.15, 4000.0), "beta": (-360.0, 360.0), "turn": (-360.0, 360.0)},
        **{"alpha": (-180.0, 180.0), "tilt": (-90.0, 90.0)},
        **dict.fromkeys(("laser_offset_mm", "at_mm"), (-1e6, 1e6)),
    }
    for name, (low, high) in limits.items():
        given = getattr(said, name)
        for number in numbers_of(option_of(name), [] if given is None else given).ravel():
            if not low < number < high:
                raise InputError(
                    f"{option_of(name)} {number:g}: give a number between {low:g} and {high:g}"
                )
    if not np.all(said.alpha):
        raise InputError("--alpha 0: the camera would look along the laser; give 30, for example")
    for name, value, known in (
        ("up", said.up, UPWARD),
        ("unit", said.unit or "mm", {**SPELT, **UNITS_MM}),
    ):
        if not isinstance(value, str) or value not in known:
            raise InputError(f"--{name} {value}: give one of {', '.join(known)}")
    truth_of("--projector", said.projector)
    of_lines = "line_length_mm", "line_radius_mm", "fan", "laser_offset_mm"
    if said.projector and (lines := [option_of(each) for each in of_lines if each in said.given]):
        raise InputError(f"{', '.join(lines)}: of a laser line; leave it out, or --projector")
    if said.part and (said.diameter_mm or said.length_mm):
        raise InputError("--diameter, --length: they are a cylinder's; leave them out, or --part")
    if not said.part and (said.unit or said.up != "z"):
        raise InputError("--unit, --up: they say how to read a part's file; give it by --part")


def option_of(name: str) -> str:
    """The option on the command line of a field of `NewScene`."""
    return f"--{parameter_of(name).replace('_', '-')}"


def parameter_of(name: str) -> str:
    """A field of `NewScene` without its unit, as scenes' parameters are called."""
    return re.sub(r"_(mm|um|nm|c|scene)$", "", name)


def _drawn(path: Path, said: NewScene) -> _Draft:
    """A new scene for a part."""
    part = part_of(said)
    said, files = _with_files(path.parent, _as_built(said))
    sensor = placed(part, said)
    part_place, field = "", said.field or ""
    if part.file:
        part_place = _place(path.parent, part.file)
        files[part_place] = part.file
    if field and not is_installed(air := find_field(field)):
        field = _place(path.parent, readable(air))
        files[field] = air
    text = scene_text(path.stem, part, part_place, sensor, said, field)
    chosen = sensor.chosen
    if said.projector:
        chosen = tuple(name for name in chosen if not name.startswith("line_"))
    return _Draft(text, files, part.survey, chosen, sensor.aside, part.unit_note)


def _as_built(said: NewScene) -> NewScene:
    """With the pixels of its image sensor and of its calibration, where others are not said."""
    if said.calibration:
        both = [option_of(n) for n in ("film", "focal_length_mm", "distortion") if n in said.given]
        if both:
            raise InputError(f"--calibration, {', '.join(both)}: give one of them")
    pixel_um, film = said.pixel_um, said.film
    if said.sensor_model:
        sensor = image_sensor(said.sensor_model)
        pixel_um = pixel_um or sensor.pixel_um
        if sensor.width_px and sensor.height_px:
            film = film or f"{sensor.width_px}x{sensor.height_px}"
    focal_mm = said.focal_length_mm
    if said.calibration:
        camera = camera_in(CalibrationFile.read(Path(said.calibration)))
        pixel_um = pixel_um or PIXEL_UM
        film = "x".join(map(str, camera.size))
        focal_mm = float(f"{abs(camera.matrix[0, 0]) * pixel_um * MM_PER_UM:.6g}")
    return dataclasses.replace(said, pixel_um=pixel_um, film=film, focal_length_mm=focal_mm)


def _with_files(folder: Path, said: NewScene) -> tuple[NewScene, dict[str, Path]]:
    """The same with the files of its camera as they are called beside the scene, and these."""
    files: dict[str, Path] = {}
    for name in ("calibration", "sensor_model"):
        given = getattr(said, name)
        if given and not (name == "sensor_model" and given in image_sensors()):
            file = readable(Path(given))
            place = _place(folder, file)
            changed: dict[str, Any] = {name: place}
            said, files = dataclasses.replace(said, **changed), {**files, place: file}
    if said.material is not None:
        surface = read_scene_file(find_material(said.material, [Path()]), inner=True)
        if said.roughness is not None and "roughness" not in surface.defaults:
            raise InputError(
                f"--roughness {said.roughness:g}: the material {said.material} has none; leave it"
                f" out, or take one of {', '.join(materials_with('roughness'))}"
            )
        name, of_material = _with_material(said.material, [Path()])
        said, files = dataclasses.replace(said, material=name), files | of_material
    return said, files


def _with_material(name: str, folders: list[Path]) -> tuple[str, dict[str, Path]]:
    """A material's name in a scene, and its files by their places there: installed, it has none."""
    file = find_material(name, folders)
    if file in installed_materials():
        return file.stem, {}
    files = {f"materials/{file.name}": file}
    for element in read_scene_file(file, inner=True).elements:
        for text in element.attributes.values():
            inside = not Path(text).is_absolute() and ".." not in text
            if inside and Path(text).suffix and exists(beside := file.parent / text):
                files[f"materials/{text}"] = beside
    return file.stem, files


def _place(folder: Path, file: Path) -> str:
    """A file's name in a scene: below the scene's folder its path from there, else its name."""
    whole, folder = file.parent.resolve() / file.name, folder.resolve()
    inside = whole.is_relative_to(folder)
    name = whole.relative_to(folder).as_posix() if inside else whole.name
    return re.sub(r'[$<>"|?*\\\x00-\x1f\x7f]', "_", name)  # a $ begins a parameter's name


def _tried(
    path: Path, draft: _Draft
) -> tuple[Mapping[str, str], dict[tuple[str, str], SeenLine], tuple[str, ...], bool]:
    """Load a draft and look what its cameras see.

    Returns
    -------
    parameters, lines, notes : Mapping, dict, tuple of str
    projects : bool
        Whether it has projectors, whose light `check_scene` looks for.
    """
    with scratch_folder() as folder:
        trial = folder / path.name
        trial.write_text(draft.text, encoding="utf-8")
        for name, file in draft.files.items():
            (folder / name).parent.mkdir(parents=True, exist_ok=True)
            (folder / name).symlink_to(file.absolute())
        try:
            scene = load_scene(trial)
            lasers = [n for n, each in scene.sources.items() if not isinstance(each, Projector)]
            projects = len(lasers) < len(scene.sources)
            pairs = [(camera, laser) for camera in scene.cameras for laser in lasers]
            lines = {pair: SeenLine.of(scene.only(*pair)) for pair in pairs}
            if pairs and not any(line.seen for line in lines.values()):
                raise InputError(f"{path}: {_remedy(next(iter(lines.values())))}")
            notes = [*scene.loading_notes, *check_scene(scene, facets=False)]
            notes += [] if projects else close_lines(scene)
        except InputError as error:
            raise InputError(f"{error}".replace(f"{folder}", f"{path.parent}")) from None
    in_place = tuple(note.replace(f"{folder}", f"{path.parent}") for note in notes)
    return scene.parameters, lines, in_place, projects


def _remedy(line: SeenLine) -> str:
    """Why nothing is seen of a line, and what to change."""
    if line.beside > 0.5:
        return "the laser's line misses the part; give --at X,Y,Z on it, or another --tilt"
    if line.outside > line.hidden:
        return (
            "the camera's image does not hold the line; give a longer --distance or a shorter"
            " --focal-length, or leave one of them out"
        )
    return "the part hides the line from the camera; give another --alpha, --turn or --at"


def _copy(path: Path, said: NewScene) -> _Draft:
    """Another scene with its files, some of its parameters changed."""
    source = find_scene(str(said.from_scene))
    said, own = _with_files(path.parent, said)
    file, values = read_scene_file(source), scene_parameters(source, {})
    text = file.text
    for name, value in _changes(said, values).items():
        pattern = rf'(<default name="{name}" value=)"[^"]*"/>( *)'

        def changed(found: re.Match[str], value: str = value) -> str:
            return f"{found[1]}{quoteattr(value)}/> ".ljust(len(found[0]))

        text, count = re.subn(pattern, changed, text, count=1)
        if not count:
            raise InputError(f"--from {said.from_scene}: no <default> of {name}; change its text")
    files = own
    any_temperature = {**values, "temperature": "*"}
    if "material" in values and not said.material:
        files |= _with_material(values["material"], [source.parent])[1]
    for element in file.elements:
        if element.attributes.get("filename") == MATERIAL:
            continue
        for place in {filled(each, any_temperature) for each in element.attributes.values()}:
            if Path(place).suffix and not Path(place).is_absolute() and ".." not in place:
                found = sorted(source.parent.glob(place))
                files |= {each.relative_to(source.parent).as_posix(): each for each in found}
    return _Draft(text, files)


def _changes(said: NewScene, values: Mapping[str, str]) -> dict[str, str]:
    """What options change of the parameters of a scene, which has these values."""
    given = {parameter_of(name): value for name, value in said.given.items()}
    given.pop("from")
    if at := given.pop("at", None):
        given |= {f"at_{axis}": value for axis, value in zip("xyz", at, strict=False)}
    if {"film", "pixel"} & given.keys():
        if film := given.pop("film", None):
            given["width"], given["height"] = film_of(str(film))
        pixel_um = float(given.get("pixel", values.get("pixel", "nan")))
        given["film_width"] = float(given.get("width", values.get("width", "nan"))) * pixel_um / 1e3
    changes = {}
    for name, value in given.items():
        (one, *more) = value if isinstance(value, tuple) else (value,)
        if more or name not in values:
            raise InputError(
                f"--from {said.from_scene}: it has no parameter {name}{'_2' if more else ''} that"
                f" --{name.replace('_', '-')} could change; it has {', '.join(sorted(values))}"
            )
        changes[name] = value_text(one)
    camera = with_field_of_view({**values, **changes}, {})
    return changes | {
        name: camera[name] for name in ("pixel", "fov") if camera[name] != values[name]
    }
