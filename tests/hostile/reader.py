"""The child's side: reads one case after another as the commands would, twice, and answers.

Run by `runner.py`, with the file that takes what appears on the terminal as its only argument.
"""

from __future__ import annotations

import faulthandler
import functools
import json
import os
import pickle
import resource
import shutil
import sys
import traceback
import warnings
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from hostile.filled import fill_memory

from virtual_sensor import child

LIMIT_BYTES = 12 << 30  # of address space, as with `ulimit -v`
_FILL = (0x5A, 0xA5)
_run_in_child = child.run_in_child


def image(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    """Pixels of an image, and the line in them."""
    from virtual_sensor.imaging.image_files import read_image
    from virtual_sensor.metrology.line_peaks import line_centres

    read = read_image(path, options.get("channel"))
    line = line_centres(read.pixels, max_sigma=8.0, saturation=read.largest)
    return {"pixels": read.pixels, "notes": read.notes} | _line(line)


def field(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    """A field file's instant."""
    from virtual_sensor.medium.index_field import IndexField

    return _field(IndexField.read(path, **options))


def imported(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    """A field of another solver, through our own file."""
    from virtual_sensor.medium.imports.import_field import Choices, import_field
    from virtual_sensor.medium.index_field import IndexField
    from virtual_sensor.medium.netcdf import write_quantity

    made = import_field(path, Choices(**options))
    quantity = made.quantity
    written = Path.cwd() / "imported.nc"  # not beside the input: an OpenFOAM case is a folder
    write_quantity(written, quantity, packed=quantity.kind != "refractivity")
    values = np.array(quantity.values, dtype=np.float64)
    return _field(IndexField.read(written)) | {
        "kind": quantity.kind,
        "values": values,
        "origin": quantity.origin_mm,
        "spacing": quantity.spacing_mm,
        "notes": made.notes,
    }


def calibration(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    """A calibration, and the points that it makes of pixels."""
    from virtual_sensor.metrology.calibration import read_calibration
    from virtual_sensor.metrology.triangulation import triangulate

    read = read_calibration(path)
    points = triangulate(read, options["pixels"])
    return {"points": points, "size": read.camera.size, "notes": getattr(read, "notes", ())}


def scene(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    """A scene's frame, and the line in it."""
    from virtual_sensor.imaging.checks import check_scene
    from virtual_sensor.imaging.render import render
    from virtual_sensor.imaging.scene import load_scene
    from virtual_sensor.metrology.line_peaks import line_centres

    loaded = load_scene(path, **options)
    told = check_scene(loaded)
    frame = render(loaded)
    line = _line(line_centres(frame, "gaussian"))
    return {"pixels": frame, "notes": (*getattr(loaded, "notes", ()), *told)} | line


def call(_: Path, options: dict[str, Any]) -> dict[str, Any]:
    """A function of the package, called by a user's script."""
    import virtual_sensor as vs

    given = dict(options)
    function = given.pop("function")
    if function == "line_centres":
        return _line(vs.line_centres(**given))
    if function == "from_arrays":
        points = given.pop("points_mm")
        return {"value": vs.IndexField.from_arrays(**given).refractivity(points)}
    if function == "ray_search":
        found = vs.ray_search(_small_scene(), **given)
        return {"value": found.pixel, "status": found.status}
    if function == "trace":
        x, y, z = np.meshgrid(*[np.linspace(-6.0, 6.0, 5)] * 3, indexing="ij")
        air = vs.IndexField.from_arrays(
            1e-4 + 1e-6 * (x + 2 * y - z), [-6.0] * 3, [3.0] * 3, ambient=0.0
        )
        rays = vs.trace(air, **given)
        return {"value": rays.position, "status": rays.status}
    if function == "render":
        return {"value": vs.render(_small_scene(), **given)}
    if function == "triangulate":
        return {"value": vs.triangulate(_small_scene().sensor, **given)}
    if function == "grey_values":
        return {"value": vs.grey_values(given["irradiance"], vs.ImageSensor(**given["camera"]))}
    return {"value": vs.air_refractivity(**given)}


@functools.cache
def _small_scene() -> Any:
    import virtual_sensor as vs

    return vs.load_scene("cold_cylinder", width=32, height=32, spp=1, line_radius=1)


def in_child(target: str, *arguments: Any, **more: Any) -> Any:
    """In place of `run_in_child`: the same, with fresh memory filled in the child too."""
    fill = int(os.environ["MALLOC_PERTURB_"])
    return _run_in_child("hostile.filled:filled", fill, target, *arguments, **more)


def command(path: Path, options: dict[str, Any]) -> dict[str, Any]:
    """The program, as a user calls it, in this process."""
    from command_line import command as run

    from virtual_sensor.errors import InputError

    place = path.parent / "results"
    shutil.rmtree(place, ignore_errors=True)
    place.mkdir()
    names = {"{in}": str(path), "{out}": str(place / "made")}
    given = [
        functools.reduce(lambda t, n: t.replace(*n), names.items(), a) for a in options["line"]
    ]
    status, out, said = run(*given)
    if status == 2:
        raise InputError(said.strip())
    if status or "Traceback" in out + said:
        raise RuntimeError(f"exit status {status}: {out}{said}")
    written = {}
    for file in sorted(place.rglob("*")):
        if file.suffix == ".json":  # NaN is not JSON
            json.loads(file.read_text(encoding="utf-8"), parse_constant=_no_json)
        if file.suffix in (".csv", ".nc", ".ply", ".exr"):
            written[str(file.relative_to(place))] = file.read_bytes()
    tables = [content for name, content in sorted(written.items()) if name.endswith(".csv")]
    return {"files": sorted(written), "tables": tables}


def _no_json(constant: str) -> None:
    raise RuntimeError(f"{constant} is no JSON")


READERS: dict[str, Callable[[Path, dict[str, Any]], dict[str, Any]]] = {
    "image": image,
    "field": field,
    "import": imported,
    "calibration": calibration,
    "scene": scene,
    "call": call,
    "command": command,
}


def _line(line: Any) -> dict[str, Any]:
    return {"row": line.row, "column": line.column, "status": line.status, "sigma": line.sigma}


def _field(read: Any) -> dict[str, Any]:
    return {
        "nodes": read.nodes,
        "origin": read.origin,
        "spacing": read.spacing,
        "ambient": read.ambient,
        "mirror": read.mirror,
        "notes": getattr(read, "notes", ()),
    }


def _once(kind: str, path: Path, options: dict[str, Any], fill: int) -> dict[str, Any]:
    """One reading: outcome, text and result."""
    from virtual_sensor.errors import EngineError, InputError

    fill_memory(fill)
    os.environ["MALLOC_PERTURB_"] = str(fill)  # of a child that a reader starts
    try:
        result = READERS[kind](path, options)
    except (InputError, EngineError) as error:
        return {"outcome": "refused", "text": str(error)}
    except (Exception, SystemExit) as error:
        frames = traceback.extract_tb(error.__traceback__)[1:]
        places = ", ".join(f"{Path(f.filename).name}:{f.lineno}" for f in frames)
        said = " ".join(str(error).split())[:300]
        return {"outcome": "raised", "text": f"{type(error).__name__}: {said} ({places})"}
    return {"outcome": "accepted", "result": result}


def differing(first: Any, second: Any) -> bool:
    """Whether two results differ in a bit; NaN is NaN."""
    if isinstance(first, dict) and isinstance(second, dict):
        return first.keys() != second.keys() or any(differing(first[k], second[k]) for k in first)
    a, b = np.asarray(first), np.asarray(second)
    if a.dtype != b.dtype or a.shape != b.shape:
        return True
    return not np.array_equal(a, b, equal_nan=a.dtype.kind in "fc")


def main() -> None:
    """Answer until the parent closes the pipe."""
    child.run_in_child = in_child
    log = Path(sys.argv[1]).open("w+b", buffering=0)  # noqa: SIM115, until the end
    questions, answers = sys.stdin.buffer, os.fdopen(os.dup(1), "wb")
    for stream in (1, 2):
        os.dup2(log.fileno(), stream)
    faulthandler.enable(log)
    resource.setrlimit(resource.RLIMIT_AS, (LIMIT_BYTES, LIMIT_BYTES))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    while size := questions.read(8):
        kind, folder, name, options = pickle.loads(questions.read(int.from_bytes(size, "little")))
        log.seek(0)
        log.truncate()
        warnings.simplefilter("error")
        answer, again = (_once(kind, folder / name, options, fill) for fill in _FILL)
        answer["steady"] = not (
            answer["outcome"] != again["outcome"]
            or differing(answer.get("result", 0), again.get("result", 0))
        )
        sys.stdout.flush()
        sys.stderr.flush()
        log.seek(0)
        answer["printed"] = log.read().decode(errors="replace")
        message = pickle.dumps(answer)
        answers.write(len(message).to_bytes(8, "little") + message)
        answers.flush()


if __name__ == "__main__":
    main()
