"""What a sensor measured: line centres from folders of results, tables or images, with a scene.

=========================  =======================================================================
What is given              What is taken of it
=========================  =======================================================================
folder of `measure`        hot line centres, or dots; the scene and its parameters, as it says;
                           of several cameras or lasers each pair
folder of `fringes`        hot decoded fringes, in blocks of pixels; the scene, as it says
folder of `fringes         the same of a sequence of one's own; the scene is said by --scene
decode`, or its .exr
folder of `burst`          the line centres of each frame; the scene at that instant
CSV of `measure`, `detect`  pixels, their sigma and status; the scene is said by --scene
other CSV                  columns u, v (or x, y; column, row), sigma where there is one; without a
                           header the first two columns are u and v
image                      detected here (`line_centres`)
=========================  =======================================================================
"""

from __future__ import annotations

import csv
import json
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.arrays import LARGEST, SMALLEST, number_within
from virtual_sensor.display import Displayed, listed
from virtual_sensor.errors import InputError, few, naming
from virtual_sensor.files import RESULTS_SIGN, exists, readable
from virtual_sensor.imaging.image_files import is_image, read_image
from virtual_sensor.imaging.scene import (
    Scene,
    find_scene,
    load_scene,
    scene_parameters,
    shipped_scenes,
)
from virtual_sensor.metrology.calibration import Calibration, read_calibration
from virtual_sensor.metrology.centres import LineCentres, Status, found_in_words, is_found
from virtual_sensor.metrology.fringes.calibration import FringeCalibration
from virtual_sensor.metrology.fringes.decoded import DecodedFringes
from virtual_sensor.metrology.fringes.observations import fringe_observation
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.metrology.observations import SIGMA_PX
from virtual_sensor.metrology.range_image import check_columns, reconstruct
from virtual_sensor.metrology.triangulation import triangulate
from virtual_sensor.poses import Pose
from virtual_sensor.studies.fringes.decoded_files import holds_decoded, read_decoded

Array = NDArray[np.float64]

DECODED = "decoded.exr"
"""What `fringes decode` writes."""

LEAST_SIGMA_PX = 1e-3
"""Of a centre in a rendered frame without noise, whose detector knows of no other error."""

_TABLES = (".csv", ".txt", ".tsv")
_NAMES = {  # of a table's columns, ours first
    "u": ("column_px", "pixel_u", "column", "u", "u_px", "x", "x_px", "col"),
    "v": ("row_px", "pixel_v", "row", "v", "v_px", "y", "y_px"),
    "sigma": ("sigma_px", "sigma", "std_px", "std", "uncertainty"),
    "normal": ("normal_deg",),
    "status": ("status",),
    "along": ("y_mm",),  # of dots
    "time": ("time_s",),  # of a burst
}
_SAME_SENSOR_MM = 1.0  # points further apart are of another sensor
_NOTED_MM = 1e-3
_DERIVED = ("film_width", "pixel", "fov")  # parameters that follow from others unless given


@dataclass(frozen=True)
class Measured(Displayed):
    """Line centres, dots or decoded fringes, and the scene in which they were seen.

    Attributes
    ----------
    name : str
        Of the folder or file; all of a command differ.
    scene : Scene
        With one camera, one source, and the air that it says.
    pixel : ndarray of shape (N, 2)
        (u, v) in px; NaN where there is no centre.
    sigma_px : ndarray of shape (N,)
        Standard deviation across the line.
    normal_deg : ndarray of shape (N,)
        Direction that it holds in, from +u towards +v; NaN: in every direction, of dots.
    centre_status : ndarray of shape (N,)
        `Status` of the centres.
    along_mm : ndarray of shape (N,) or None
        Of dots, whose light it is: their positions along the line; of fringes along both axes the
        second coordinate t of the projector's rays. None of a line.
    coordinate : ndarray of shape (N,) or float
        First coordinate s of the light: 0 of a laser line.
    fringes : DecodedFringes or None
        Of the whole image, where the pixels are the middles of its blocks.
    one_of_many : bool
        Whether it is a frame of a burst, whose air is another in each.
    notes : tuple of str
    """

    name: str
    scene: Scene
    pixel: Array
    sigma_px: Array
    normal_deg: Array
    centre_status: NDArray[np.uint8]
    along_mm: Array | None = None
    coordinate: Array | float = 0.0
    fringes: DecodedFringes | None = None
    one_of_many: bool = False
    notes: tuple[str, ...] = ()

    def _line(self) -> str:
        return listed(self.name, found_in_words(self.centre_status), self.scene.path.name)


@dataclass
class Scenes:
    """Loads the scenes that measurements are of, each once.

    Attributes
    ----------
    name : str or None
        The scene for all that name none; in place of those that folders name.
    given : Mapping
        Parameters set on top of those that folders name.
    camera, source : str or None
        Names, where a scene has several.
    """

    name: str | None = None
    given: Mapping[str, str] = field(default_factory=dict)
    camera: str | None = None
    source: str | None = None
    loaded: dict[Any, Scene] = field(default_factory=dict)

    def of(self, what: Path, own: Mapping[str, str]) -> Scene:
        """The scene of a table or an image; `own` are parameters of it alone.

        Of one in a folder of `measure` it is the folder's, cold where its name says so.
        """
        if self.name is None and exists(what.parent / RESULTS_SIGN):
            facts = _facts(what.parent)
            if "states" in facts:
                scene = self.of_results(what.parent, facts, own)
                return scene.cold() if what.stem.endswith("cold") else scene
        if self.name is None:
            raise InputError(
                f"{what}: names no scene; say in which it was measured: --scene hot_cylinder, or"
                " give the folder of `measure`"
            )
        return self._load(find_scene(self.name), {**self.given, **own}, self.camera, self.source)

    def of_results(self, folder: Path, facts: Mapping[str, Any], own: Mapping[str, str]) -> Scene:
        """The scene that a folder of results names."""
        if self.name is not None:
            return self.of(folder, own)
        path = _scene_file(folder, str(facts["scene"]))
        with naming(folder / RESULTS_SIGN):
            given = given_parameters(path, facts["parameters"])
        camera, source = self.camera or facts.get("camera"), self.source or facts.get("source")
        return self._load(path, {**given, **self.given, **own}, camera, source)

    def _load(
        self, path: Path, given: dict[str, str], camera: str | None, source: str | None
    ) -> Scene:
        key = path, tuple(sorted(given.items())), camera, source
        if key not in self.loaded:
            self.loaded[key] = load_scene(path, **given).only(camera, source)
            # Of one camera and one source, or they say which to choose.
            _ = self.loaded[key].camera, self.loaded[key].source
        return self.loaded[key]


def _scene_file(folder: Path, name: str) -> Path:
    """The scene that results name: there, beside them, or one that comes with the program."""
    path = Path(name)
    shipped = shipped_scenes() / path.name
    places = [path, folder / path, folder.parent / path, folder.parent / path.name]
    if path.parent.name == "scenes" or path.parent.name == shipped.parent.name:
        places.append(shipped)
    for place in places:
        if exists(place):
            return place
    raise InputError(
        f"{folder / RESULTS_SIGN}: its scene {name} is gone; say where it is now: --scene FILE"
    )


def given_parameters(path: Path, used: Mapping[str, str]) -> dict[str, str]:
    """Those of a scene's parameters, as they were used, that its own defaults do not give.

    Others on top of them then have their usual effect, such as a temperature that chooses the air.

    Raises
    ------
    InputError
        If the scene has no such parameters (any more).
    """
    given: dict[str, str] = {}
    order = sorted(used, key=lambda name: name in _DERIVED)  # else those before others
    while True:
        values = scene_parameters(path, given)
        wanting = [name for name in order if values.get(name) != used[name]]
        if not set(wanting) - given.keys():
            return given
        name = next(name for name in wanting if name not in given)
        given[name] = used[name]


def read_measured(
    texts: Sequence[str],
    scenes: Scenes,
    calibration: Path | None = None,
    sigma_px: float | None = None,
) -> list[Measured]:
    """Read measurements, each a path, or a path with parameters: ``line.csv:beta=30,along=2``.

    Parameters
    ----------
    texts : sequence of str
    scenes : Scenes
    calibration : Path, optional
        File of the sensor's; by default the scenes' own sensors.
    sigma_px : float, optional
        The centres' standard deviation, in place of those that files have.

    Raises
    ------
    InputError
        Naming what can't be read, or does not go together, and the remedy.
    """
    found: list[Measured] = []
    for text in texts:
        path, own = _path_and_parameters(text)
        found += _read(path, own, scenes)
    if not found:
        raise InputError("nothing is given to correct; name a folder of `measure`, say")
    if calibration is not None:
        of_laser = None if all(each.fringes for each in found) else read_calibration(calibration)
        found = [
            calibrated(each, of_laser)
            if of_laser and each.fringes is None
            else fringes_calibrated(each, calibration)
            for each in found
        ]
    if sigma_px is not None:
        number_within("--sigma", sigma_px, SMALLEST, LARGEST, "a positive number of px")
    return [_with_sigma(each, sigma_px) for each in _with_names(found)]


def _path_and_parameters(text: str) -> tuple[Path, dict[str, str]]:
    """A path and the parameters behind its last colon."""
    if exists(Path(text)):
        return Path(text), {}
    path, colon, behind = text.rpartition(":")
    pairs = [part.partition("=") for part in behind.split(",")]
    if not (colon and path and all(name and equals for name, equals, _ in pairs)):
        readable(Path(text))  # which says why not
        return Path(text), {}
    return Path(path), {name.strip(): value.strip() for name, _, value in pairs}


def _read(path: Path, own: dict[str, str], scenes: Scenes) -> Iterator[Measured]:
    """The measurements of one path."""
    if path.is_dir():
        yield from _of_folder(path, own, scenes)
    elif path.suffix.lower() == ".exr" and holds_decoded(path):
        yield of_fringes(path.stem, scenes.of(path, own), read_decoded(path))
    elif path.suffix.lower() in _TABLES:
        yield _of_columns(path, read_centres(path), scenes.of(path, own))
    elif is_image(path):
        yield _of_image(path, scenes.of(path, own))
    elif path.name == RESULTS_SIGN:
        yield from _of_folder(path.parent, own, scenes)
    else:
        readable(path)
        raise InputError(
            f"{path}: is no measurement; give a folder of `measure` or `burst`, a table of line"
            f" centres (CSV), or an image"
        )


def _of_folder(folder: Path, own: dict[str, str], scenes: Scenes) -> Iterator[Measured]:
    facts = _facts(folder)
    if "pairs" in facts:
        for name in facts["pairs"]:
            yield from _of_folder(folder / name, own, scenes)
    elif "codec" in facts:
        yield _of_fringes(folder, facts, scenes.of_results(folder, facts, own))
    elif exists(folder / DECODED):
        scene = scenes.of(folder / DECODED, own)
        yield of_fringes(folder.name, scene, read_decoded(folder / DECODED))
    elif "states" in facts:
        state = "hot" if "hot" in facts["states"] else "cold"
        dots = folder / f"dots_{state}.csv"
        table = dots if dots.exists() else folder / f"line_{state}.csv"
        scene = scenes.of_results(folder, facts, own)
        cold = f"{folder}: was measured only cold; its line is taken as seen through the air"
        notes = (cold,) if state == "cold" and scene.medium else ()
        yield replace(_of_columns(table, read_centres(table), scene), name=folder.name, notes=notes)
    elif "columns_in_every_frame" in facts:
        yield from _of_burst(folder, scenes.of_results(folder, facts, own))
    elif "images" in facts:
        for name, image in facts["images"].items():
            table = folder / f"{name}.csv"
            scene = scenes.of(table, own)
            _check_size(table, (image["columns"], image["rows"]), scene)
            yield _of_columns(table, read_centres(table), scene)
    else:
        raise InputError(
            f"{folder}: holds results of another kind; give a folder of `measure`, `fringes`,"
            " `burst` or `detect`"
        )


def _of_fringes(folder: Path, facts: Mapping[str, Any], scene: Scene) -> Measured:
    """Decoded fringes: of the hot part, where it was measured hot."""
    state = "hot" if "hot" in facts["states"] else "cold"
    cold = f"{folder}: was measured only cold; its fringes are taken as seen through the air"
    with naming(folder):
        measured = of_fringes(folder.name, scene, read_decoded(folder / f"{state}.exr"))
    notes = (cold,) if state == "cold" and scene.medium else ()
    return replace(measured, notes=notes)


def of_fringes(name: str, scene: Scene, decoded: DecodedFringes) -> Measured:
    """Decoded fringes as what was measured in a scene: a pixel for each block.

    Raises
    ------
    InputError
        If they are of another camera or projector, nothing is decoded, or the projector's columns
        don't tell the depth.
    """
    family = scene.projector.family  # or it says what to do
    seen = fringe_observation(scene, decoded)
    if decoded.row is not None:
        u, v = np.rint(seen.pixel).astype(int).T
        check_columns(
            f"{name}, {scene.path}", scene.camera, family, seen.pixel, decoded.pixel[v, u]
        )
    count = len(seen.pixel)
    normal = seen.normal_deg if seen.normal_deg is not None else np.full(count, np.nan)
    return Measured(
        name,
        scene,
        seen.pixel,
        seen.sigma_px,
        normal,
        np.full(count, Status.OK, np.uint8),
        seen.along_mm,
        seen.coordinate,
        decoded,
    )


def _facts(folder: Path) -> dict[str, Any]:
    sign = folder / RESULTS_SIGN
    if not exists(sign):
        inside = sorted(each.name for each in folder.iterdir() if exists(each / RESULTS_SIGN))
        hint = f"; give those within it: {few(inside, 4)}" if inside else ""
        raise InputError(
            f"{folder}: holds no results (there is no {RESULTS_SIGN}){hint or '; give a folder of'}"
            f"{'' if hint else ' `measure`, or the table of line centres or the image itself'}"
        )
    try:
        facts = json.loads(readable(sign).read_text(encoding="utf-8"))
    except (OSError, ValueError) as error:
        raise InputError(f"{sign}: can't be read ({error}); measure again") from None
    if not isinstance(facts, dict):
        raise InputError(f"{sign}: is no summary of results; measure again")
    return facts


def _of_burst(folder: Path, scene: Scene) -> Iterator[Measured]:
    """Each frame of a burst, in the air of its instant."""
    columns = read_centres(folder / "frames.csv")
    times = columns["time"]
    for number, instant in enumerate(np.unique(times)):
        here = {name: values[times == instant] for name, values in columns.items()}
        frame = _of_columns(folder / "frames.csv", here, scene.at(float(instant)))
        name = f"{folder.name}_{number:04d}"
        yield replace(frame, name=name, one_of_many=True)


def _of_image(path: Path, scene: Scene) -> Measured:
    try:
        image = read_image(path)
    except InputError as error:
        raise InputError(
            f"{error}; or find its line by `virtual-sensor detect`, and give that folder"
        ) from None
    _check_size(path, image.pixels.shape[::-1], scene)
    line = line_centres(image)
    return replace(_of_line(path.stem, line, scene), notes=tuple(image.notes))


def _check_size(path: Path, size: tuple[int, ...], scene: Scene) -> None:
    width, height = scene.camera.size
    if tuple(size) != (width, height):
        raise InputError(
            f"{path}: is of {size[0]} x {size[1]} px, but the camera of {scene.path} has {width} x"
            f" {height}; give the scene's width and height (-D), or the scene of this camera"
        )


def _of_line(name: str, line: LineCentres, scene: Scene) -> Measured:
    _ = scene.laser  # or it says what to do
    return Measured(
        name,
        scene,
        line.pixel.reshape(-1, 2),
        np.ravel(line.sigma),
        np.ravel(line.normal_deg),
        np.ravel(line.status),
    )


def _of_columns(path: Path, columns: Mapping[str, NDArray[Any]], scene: Scene) -> Measured:
    """Centres as a table has them."""
    _ = scene.laser  # or it says what to do
    pixel = np.stack([columns["u"], columns["v"]], axis=1)
    status = _statuses(path, columns.get("status"), pixel)
    pixel[~is_found(status)] = np.nan
    width, height = scene.camera.size
    beside = np.abs(pixel - [(width - 1) / 2, (height - 1) / 2]) > [width / 2, height / 2]
    if (far := beside.any(axis=1)).any():
        u, v = pixel[far][0]
        raise InputError(
            f"{path}: a centre at ({u:g}, {v:g}) lies beside the camera of {scene.path}, which has"
            f" {width} x {height} px; give the scene's width and height (-D), or the scene of this"
            " camera"
        )
    blank = np.full(len(pixel), np.nan)
    along = columns.get("along")
    normal = columns.get("normal", np.full(len(pixel), 90.0 if along is None else np.nan))
    return Measured(path.stem, scene, pixel, columns.get("sigma", blank), normal, status, along)


def _with_sigma(measured: Measured, given_px: float | None) -> Measured:
    """The same with the standard deviation that is given, or the usual one where none is known."""
    sigma, there = measured.sigma_px, np.isfinite(measured.pixel[:, 0])
    if given_px is not None:
        return replace(measured, sigma_px=np.full(len(sigma), given_px))
    known = np.isfinite(sigma) & (sigma > 0.0)
    missing = int(np.sum(there & ~known))
    centres = "one centre has" if missing == 1 else f"{missing} centres have"
    note = (
        f"{measured.name}: {centres} no standard deviation: {SIGMA_PX:g} px is taken (or give"
        " --sigma)"
    )
    sigma = np.where(known, np.maximum(sigma, LEAST_SIGMA_PX), SIGMA_PX)
    return replace(measured, sigma_px=sigma, notes=measured.notes + (note,) * bool(missing))


def _statuses(path: Path, names: NDArray[Any] | None, pixel: Array) -> NDArray[np.uint8]:
    """`Status` of centres, by its names in lower case; "found" is a search's."""
    there = np.isfinite(pixel).all(axis=1)
    status = np.where(there, Status.OK, Status.NO_PEAK).astype(np.uint8)
    if names is None:
        return status
    known = {each.name.lower(): int(each) for each in Status}
    known |= {"": int(Status.OK), "found": int(Status.OK), "not_found": int(Status.NO_PEAK)}
    unknown = sorted({f"{name}" for name in names} - known.keys())
    if unknown:
        raise InputError(
            f"{path}: knows a status {few([repr(n) for n in unknown], 3)}; there are"
            f" {few(list(known), 20)}, or leave the column out"
        )
    said = np.array([known[f"{name}"] for name in names], np.uint8)
    return np.where(is_found(said) & ~there, status, said).astype(np.uint8)


def read_centres(path: Path) -> dict[str, NDArray[Any]]:
    """Columns of a table of line centres: ``u``, ``v`` and what else it has of `_NAMES`.

    Delimiters are comma, semicolon, tab or blanks; lines that begin with # are comments.

    Raises
    ------
    InputError
        Naming the file, the row and the remedy.
    """
    try:
        text = readable(path).read_text(encoding="utf-8-sig", errors="replace")
    except OSError as error:
        raise InputError(f"{path}: can't be read ({error.strerror})") from None
    lines = [line.strip() for line in text.splitlines()]
    numbered = [(n, line) for n, line in enumerate(lines, 1) if line and not line.startswith("#")]
    if not numbered:
        raise InputError(f"{path}: is empty; give a table with columns u and v, px")
    mark = next((each for each in ";\t," if each in numbered[0][1]), None)
    if mark in (";", "\t"):  # then a comma is a decimal one
        numbered = [(n, re.sub(r"(?<=\d),(?=\d)", ".", line)) for n, line in numbered]
    rows = [
        (n, next(csv.reader([line], delimiter=mark)) if mark else line.split())
        for n, line in numbered
    ]
    first = [cell.strip().strip('"').lower() for cell in rows[0][1]]
    if all(_number(cell) is not None for cell in first):
        places = {"u": 0, "v": 1} | ({"sigma": 2} if len(first) > 2 else {})
        if len(first) < 2:
            raise InputError(f"{path}: has one column; give u and v, px, in a row")
    else:
        rows, bare = rows[1:], [re.sub(r"\s*[\[(].*", "", name) for name in first]
        places = {
            kind: bare.index(next(name for name in names if name in bare))
            for kind, names in _NAMES.items()
            if any(name in bare for name in names)
        }
        if not {"u", "v"} <= places.keys():
            raise InputError(
                f"{path}: has the columns {few(first, 8)}; name those of the line's centres u and v"
                " (px, integers at pixel centres)"
            )
    for n, cells in rows:
        if len(list(filter(str.strip, cells))) > len(first):
            raise InputError(
                f"{path}, line {n}: has {len(cells)} columns, and the first line {len(first)}; put"
                " semicolons or tabs between numbers with decimal commas"
            )
    widest = max(places.values())
    short = next((n for n, cells in rows if len(cells) <= widest), None)
    if short is not None:
        raise InputError(f"{path}, line {short}: has too few columns; give {widest + 1}, or none")
    return {kind: _column(path, kind, rows, place) for kind, place in places.items()}


def _column(
    path: Path, kind: str, rows: Sequence[tuple[int, Sequence[str]]], place: int
) -> NDArray[Any]:
    cells = [(n, cells[place].strip()) for n, cells in rows]
    if kind == "status":
        return np.array([cell.lower() for _, cell in cells], np.str_)
    values = [_number(cell) for _, cell in cells]
    wrong = next((i for i, value in enumerate(values) if value is None), None)
    if wrong is not None:
        raise InputError(
            f"{path}, line {cells[wrong][0]}: {cells[wrong][1]!r} is no number; leave the cell"
            " empty where there is none"
        )
    return np.array(values, float)


def _number(cell: str) -> float | None:
    """A cell's number, NaN if it is empty; None if it is none."""
    if not cell:
        return np.nan
    try:
        value = float(cell)
    except ValueError:
        return None
    return value if np.isfinite(value) else np.nan


def calibrated(measured: Measured, calibration: Calibration) -> Measured:
    """The same, seen by the calibration's camera, in the light of its laser plane.

    The calibration's world must be that of the scene, whose part and air stay where they are; the
    laser's rays are turned and shifted into the plane.

    Raises
    ------
    InputError
        If it is of another sensor than the scene's.
    """
    scene = measured.scene
    camera, laser = calibration.camera, scene.source
    if camera.size != scene.camera.size:
        (width, height), (w, h) = camera.size, scene.camera.size
        raise InputError(
            f"{measured.name}: the calibration is of {width} x {height} px, and the camera of"
            f" {scene.path} has {w} x {h}; give the scene of this sensor (--scene), or its width"
            " and height (-D)"
        )
    normal, plane = laser.plane[0], calibration.laser
    there = plane.normal * np.sign(plane.normal @ normal)
    axis = np.cross(normal, there)
    angle = float(np.degrees(np.arctan2(np.linalg.norm(axis), normal @ there)))
    pose = laser.pose
    if angle:
        pose = pose.moved(Pose.turn(angle, axis, laser.target_mm))
    off_mm = plane.offset_mm * np.sign(plane.normal @ normal) - there @ laser.target_mm
    laser = laser.with_pose(pose.moved(Pose.shift(off_mm * there)))
    seen = {scene.camera_name: scene.camera.with_chief(camera)}
    same = replace(scene, cameras=seen, sources={scene.source_name: laser})
    nominal, real = (triangulate(each, measured.pixel) for each in (scene, same))
    apart = np.linalg.norm(real - nominal, axis=1)
    apart_mm = float(np.max(apart[np.isfinite(apart)], initial=0.0))
    lost = int(np.sum(np.isfinite(measured.pixel[:, 0]) & ~np.isfinite(apart)))
    if lost or apart_mm > _SAME_SENSOR_MM:
        raise InputError(
            f"{measured.name}: the sensor of {scene.path} is not the calibration's: its points lie"
            f" {f'up to {apart_mm:.3g} mm' if not lost else 'nowhere near'} beside those of the"
            f" calibration, whose laser plane is turned by {angle:.3g} degrees; give the scene in"
            " which this sensor stands (-D, --scene), and the calibration in the scene's world"
        )
    return replace(measured, scene=same, notes=_with_shift(measured, apart_mm))


def fringes_calibrated(measured: Measured, path: Path) -> Measured:
    """Decoded fringes, seen by a calibration's camera, in the light of its projector.

    The calibration's camera is put where the scene's stands, and the projector beside it.

    Raises
    ------
    InputError
        If it can't be read, or is of another sensor.
    """
    scene, decoded = measured.scene, measured.fringes
    assert decoded is not None
    read = FringeCalibration.read(path, scene.camera.size, scene.projector.size)
    calibration = read.placed(scene.camera.pose)
    camera, projector = calibration.camera, calibration.projector
    for name, mine, theirs in (
        ("camera", camera, scene.camera),
        ("projector", projector, scene.projector),
    ):
        if tuple(mine.size) != tuple(theirs.size):
            raise InputError(
                f"{measured.name}: the calibration's {name} has {mine.size[0]} x {mine.size[1]} px,"
                f" and that of {scene.path} {theirs.size[0]} x {theirs.size[1]}; give the scene of"
                " this sensor (--scene, -D)"
            )
    same = replace(
        scene,
        cameras={scene.camera_name: scene.camera.with_chief(camera)},
        sources={scene.source_name: replace(scene.projector, family=projector)},
    )
    apart = reconstruct(same, decoded).point_mm - reconstruct(scene, decoded).point_mm
    apart_mm = float(np.nanmax(np.linalg.norm(apart, axis=-1), initial=0.0))
    if apart_mm > _SAME_SENSOR_MM:
        raise InputError(
            f"{measured.name}: the sensor of {scene.path} is not the calibration's: its points lie"
            f" up to {apart_mm:.3g} mm beside those of the calibration; give the scene in which"
            " this sensor stands (-D, --scene)"
        )
    again = of_fringes(measured.name, same, decoded)
    return replace(again, notes=_with_shift(measured, apart_mm))


def _with_shift(measured: Measured, apart_mm: float) -> tuple[str, ...]:
    """The notes, with one on how far a calibration moves the points, where that is worth one."""
    if apart_mm <= _NOTED_MM:
        return measured.notes
    note = f"{measured.name}: the calibration's points lie up to {apart_mm:.3g} mm beside those of"
    return *measured.notes, f"{note} the scene's own sensor; the calibration's are taken"


def _with_names(found: list[Measured]) -> list[Measured]:
    """The same with names that all differ."""
    names: list[str] = []
    for each in found:
        name, number = each.name or "measured", 2
        while name in names:
            name, number = f"{each.name}_{number}", number + 1
        names.append(name)
    return [replace(each, name=name) for each, name in zip(found, names, strict=True)]
