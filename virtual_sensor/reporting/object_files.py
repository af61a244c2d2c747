"""An object as a file, by the file's suffix, and its columns as a data frame."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Iterator, Mapping
from enum import Enum, IntEnum
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from virtual_sensor.display import Displayed, names_of
from virtual_sensor.errors import InputError, a, naming
from virtual_sensor.files import path_of, written_whole
from virtual_sensor.records import (
    Table,
    plain,
    status_names,
    write_arrays,
    write_csv,
    write_json,
    write_ply,
    write_ply_mesh,
)

Writer = Callable[[Path, Any], None]

PICTURES = (".png", ".svg", ".pdf")
_AXES = {2: "uv", 3: "xyz"}
_MOST_IN_JSON = 1_000_000  # numbers
_MOST_NUMBERS = 16  # of an array in one cell's place: a pose's matrix, a lens's coefficients


def data_frame(thing: Displayed) -> Any:
    """The columns of an object as a `pandas.DataFrame`.

    Raises
    ------
    InputError
        If pandas is not installed, or the object has no table.
    """
    try:
        import pandas
    except ImportError:
        raise InputError(
            'to_dataframe: pandas is missing; pip install "virtual-sensor[dataframe]"'
        ) from None
    columns = columns_of(thing)
    if not columns:
        raise InputError(
            f"to_dataframe: {a(type(thing).__name__)} has no table: it holds no numbers"
        )
    return pandas.DataFrame(columns)


def save(thing: Displayed, path: str | Path) -> Path:
    """Write an object to a file, by its suffix; see `Displayed.save`."""
    path = path_of("save: path", path)
    writers = formats_of(thing)
    write = writers.get(path.suffix.lower())
    if write is None:
        *others, last = sorted(writers)
        raise InputError(
            f"{path}: {a(type(thing).__name__)} is written as {', '.join(others)} or {last}, as the"
            " file's suffix says"
        )
    write(path, thing)
    return path


def formats_of(thing: Displayed) -> dict[str, Writer]:
    """What an object is written by, for each suffix of a file."""
    from virtual_sensor.reporting import objects

    found: dict[str, Writer] = {".csv": _write_csv, ".json": _write_json, ".npz": _write_npz}
    if objects.drawing_of(thing):
        found |= dict.fromkeys(PICTURES, objects.write_picture)
    for names in reversed(list(names_of(thing))):
        found |= _OWN.get(names, {})
    return found


# ------------------------------------------------------------------------------------- columns


def columns_of(thing: Displayed) -> dict[str, NDArray[Any]]:
    """Columns of equal length by their names: its own, those of its arrays, or one row of all."""
    if isinstance(thing, Table):
        return thing.columns()
    if own := getattr(thing, "_columns", None):
        return {name: _named(thing, name, np.asarray(values)) for name, values in own().items()}
    if thing._by_row:
        return dict(_row_columns(thing))
    return {name: np.array([value]) for name, value in _cells(thing, "")}


def _row_columns(thing: Displayed) -> Iterator[tuple[str, NDArray[Any]]]:
    """A column for each number of each row: of arrays whose shapes begin with the rows' shape."""
    held = dict(_public(thing))
    for name, value in [*held.items()]:
        if isinstance(value, Mapping):
            held |= {f"{name}_{key}": each for key, each in value.items()}
    arrays = {name: value for name, value in held.items() if isinstance(value, np.ndarray)}
    shape = arrays["status"].shape if "status" in arrays else next(iter(arrays.values())).shape[:1]
    for name, array in arrays.items():
        if array.shape == shape:
            yield name, _named(thing, name, array.ravel())
        elif array.shape[:-1] == shape:
            axes = _AXES.get(array.shape[-1], range(array.shape[-1]))
            for i, axis in enumerate(axes):
                yield f"{name}_{axis}", array[..., i].ravel()


def _cells(value: Any, name: str) -> Iterator[tuple[str, Any]]:
    """The numbers and words of an object, each under its name, objects within it too."""
    inner = f"{name}_" if name else ""
    if isinstance(value, IntEnum):
        yield name, value.name.lower()
    elif isinstance(value, Enum):
        yield from _cells(value.value, name)
    elif isinstance(value, bool | int | float | str | np.generic):
        yield name, value
    elif isinstance(value, Path):
        yield name, str(value)
    elif isinstance(value, np.ndarray | list | tuple):
        array = np.asarray(value) if not isinstance(value, np.ndarray) else value
        if array.ndim == 0:
            yield name, array.item()
        elif array.size <= _MOST_NUMBERS and array.dtype.kind in "bufiU":
            axes = _AXES.get(array.size, range(array.size)) if array.ndim == 1 else None
            for i, index in enumerate(np.ndindex(array.shape)):
                axis = axes[i] if axes else "".join(map(str, index))
                yield f"{inner}{axis}", array[index]
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _cells(each, f"{inner}{key}")
    elif dataclasses.is_dataclass(value):
        for key, each in _public(value):
            yield from _cells(each, f"{inner}{key}")


def _public(thing: Any) -> Iterator[tuple[str, Any]]:
    """The fields of an object that are data for others."""
    for each in dataclasses.fields(thing):
        if not each.name.startswith("_") and not each.metadata.get("internal"):
            yield each.name, getattr(thing, each.name)


def _named(thing: Any, name: str, value: Any) -> Any:
    """Numbers of a status as names; all else as it is."""
    kind = getattr(thing, "_statuses", {}).get(name)
    if kind is None:
        return value
    if isinstance(value, Mapping):
        return {key: _named(thing, name, each) for key, each in value.items()}
    names = status_names(value, kind).reshape(np.shape(value))
    return names if names.ndim else str(names)


# --------------------------------------------------------------------------------------- files


def _write_csv(path: Path, thing: Displayed) -> None:
    write_csv(path, columns_of(thing))


def _write_json(path: Path, thing: Displayed) -> None:
    with naming(path):
        tree = _tree(thing)
    write_json(path, tree)


def _tree(value: Any) -> Any:
    """An object as JSON has it, statuses by their names; what is no data is left out."""
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        found = {name: _part(_named(value, name, each)) for name, each in _public(value)}
        return {name: each for name, each in found.items() if each is not _NO_DATA}
    if isinstance(value, Mapping):
        return {str(key): _part(each) for key, each in value.items()}
    if isinstance(value, list | tuple):
        return [_part(each) for each in value]
    if isinstance(value, np.ndarray) and value.size > _MOST_IN_JSON:
        raise InputError(f"an array of shape {value.shape} is too large for JSON; write .npz")
    found = plain(value)
    data = found is None or isinstance(found, bool | int | float | str | list)
    return found if data else _NO_DATA


def _part(value: Any) -> Any:
    """What an object holds, as JSON has it: of air its line, since its nodes are a file's own."""
    is_air = isinstance(value, Displayed) and "medium.index_field.IndexField" in names_of(value)
    return repr(value) if is_air else _tree(value)


_NO_DATA = object()


def _write_npz(path: Path, thing: Displayed) -> None:
    arrays: dict[str, Any] = dict(_arrays(thing, ""))
    write_arrays(path, arrays)


def _arrays(value: Any, name: str) -> Iterator[tuple[str, NDArray[Any]]]:
    """The arrays, numbers and words of an object, as NumPy's, each under its name."""
    inner = f"{name}_" if name else ""
    if isinstance(value, np.ndarray):
        if value.dtype.kind in "bufiU":
            yield name, value
    elif isinstance(value, Mapping):
        for key, each in value.items():
            yield from _arrays(each, f"{inner}{key}")
    elif dataclasses.is_dataclass(value):
        for key, each in _public(value):
            yield from _arrays(_named(value, key, each), f"{inner}{key}")
    elif isinstance(value, list | tuple) and value and dataclasses.is_dataclass(value[0]):
        for i, each in enumerate(value):
            yield from _arrays(each, f"{inner}{i}")
    elif value is not None and isinstance(value, bool | int | float | str | list | tuple | Path):
        array = np.asarray(str(value) if isinstance(value, str | Path) else value)
        if array.dtype.kind in "bufiU":
            yield name, array


_MESHES = ("imaging.parts.Part", "imaging.part_survey.Mesh", "metrology.range_mesh.RangeMesh")
_POINTS = {
    "metrology.triangulation.TriangulatedPoints": "point_mm",
    "metrology.error_budget.PointBudget": "point_mm",
    "optics.bent_points.BentPoints": "point_mm",
    "optics.crossings.Crossings": "point_mm",
    "optics.ray_maps.RayPoints": "point_mm",
    "optics.projector_pixels.ProjectorPixels": "point_mm",
    "optics.ray_search.FoundPixels": "laser_point_mm",
    "optics.sensitivity.Sensitivity": "laser_point_mm",
    "optics.trace.Rays": "position",
    "imaging.render.PixelTruth": "point_mm",
    "imaging.checks.LitLine": "points_mm",
    "studies.measure.State": "points_mm",
    "studies.detect.Detected": "points_mm",
}
"""Which attribute of an object are its points (..., 3), world, mm."""


def _write_points(path: Path, thing: Any) -> None:
    name = next(_POINTS[each] for each in names_of(thing) if each in _POINTS)
    if (held := getattr(thing, name)) is None:
        raise InputError(f"{path}: without a calibration there are no points; write another format")
    points = np.asarray(held, float).reshape(-1, 3)
    line = getattr(thing, "line", None)
    light = np.ones(len(points)) if line is None else np.ravel(line.amplitude)
    write_ply(path, points, light if len(light) == len(points) else np.ones(len(points)))


def _write_mesh(path: Path, mesh: Any) -> None:
    import trimesh

    vertices = mesh.vertices if hasattr(mesh, "vertices") else mesh.places_mm
    whole = trimesh.Trimesh(vertices, mesh.faces, process=False)
    data = whole.export(file_type=path.suffix.lower().lstrip("."))
    with written_whole(path) as temporary:
        temporary.write_bytes(data if isinstance(data, bytes) else data.encode("utf-8"))


def _write_range_image(path: Path, image: Any) -> None:
    mesh = image.mesh()
    values = {} if image.sigma_um is None else {"sigma_um": image.sigma_um.ravel()[mesh.index]}
    write_ply_mesh(path, mesh.vertices, mesh.faces, **values)


def _write_surface(path: Path, surface: Any) -> None:
    from virtual_sensor.reporting.fringes import write_surface

    write_surface(path, surface, None)


def _image_of(thing: Any) -> tuple[NDArray[Any], int | None]:
    """An object's image (H, W), and its bits; None of floats."""
    names = ("radiance", "pixels", "values", "grey")
    image = next(getattr(thing, name) for name in names if hasattr(thing, name))
    if image.dtype.kind not in "iu":
        return image, None
    clips = getattr(thing, "largest", None)
    bits = int(clips).bit_length() if clips else getattr(thing, "bits", None)
    return image, max(bits or 1, int(image.max(initial=0)).bit_length(), 1)


def _write_grey(path: Path, thing: Any) -> None:
    from virtual_sensor.imaging.image_files import save_png

    image, bits = _image_of(thing)
    save_png(image, path, bits or 16)


def _write_tiff(path: Path, thing: Any) -> None:
    import tifffile

    with written_whole(path) as temporary:
        tifffile.imwrite(temporary, _image_of(thing)[0])


def _write_exr(path: Path, frame: Any) -> None:
    from virtual_sensor.imaging.render import write_exr

    write_exr(path, frame, {})


def _write_field(path: Path, field: Any) -> None:
    field.write(path)


def _write_calibration(path: Path, calibration: Any) -> None:
    from virtual_sensor.metrology.calibration import calibration_text

    text = calibration_text(calibration, path.name)
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8")


def _write_fringe_calibration(path: Path, calibration: Any) -> None:
    calibration.write(path)


def _write_scene(path: Path, scene: Any) -> None:
    write_json(path, {"notes": scene.notes, **_tree(scene)})


def _write_decoded(path: Path, decoded: Any) -> None:
    from virtual_sensor.studies.fringes.decoded_files import write_decoded

    write_decoded(path, decoded)


def _write_own_summary(path: Path, result: Any) -> None:
    write_json(path, result.summary)


def _write_summary(path: Path, result: Any) -> None:
    from virtual_sensor.studies.measure import summary

    write_json(path, summary(result))


_IMAGES: dict[str, Writer] = {".png": _write_grey, **dict.fromkeys((".tif", ".tiff"), _write_tiff)}
_OWN: dict[str, dict[str, Writer]] = {
    **{name: {".ply": _write_points} for name in _POINTS},
    **{name: dict.fromkeys((".ply", ".stl", ".obj"), _write_mesh) for name in _MESHES},
    "imaging.render.Frame": {**_IMAGES, ".exr": _write_exr},
    "imaging.image_files.Image": _IMAGES,
    "imaging.image_formats.StoredImage": _IMAGES,
    "studies.trial.images.TrialImage": _IMAGES,
    "medium.index_field.IndexField": {".nc": _write_field},
    "metrology.calibration.Calibration": dict.fromkeys(
        (".yaml", ".yml", ".xml", ".json"), _write_calibration
    ),
    "metrology.fringes.calibration.FringeCalibration": dict.fromkeys(
        (".yaml", ".yml", ".xml", ".json"), _write_fringe_calibration
    ),
    "imaging.scene.Scene": {".json": _write_scene},
    "metrology.range_image.RangeImage": {".ply": _write_range_image},
    "metrology.fringes.decoded.DecodedFringes": {".exr": _write_decoded},
    "studies.fringes.result.Surface": {".ply": _write_surface},
    "studies.fringes.result.FringeMeasurement": {".json": _write_own_summary},
    "studies.measure.Measurement": {".json": _write_summary},
}
"""Formats that only some objects have, by their classes' names (see `display.names_of`)."""
