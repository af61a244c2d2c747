"""The faults that were found in use and by hostile inputs, each with its right outcome.

The small files lie in `inputs/`; the others are made here.
"""

from __future__ import annotations

import functools
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import OpenEXR
from hostile import calibrations, image_files, images, import_files, imports, scene_files, scenes
from hostile.cases import Case, Judge, Result
from hostile.fields import possible

INPUTS = Path(__file__).with_name("inputs")
KELVIN = {"units": "K", "length_units": "mm"}
_X, _Y, _Z = np.linspace(-40, 40, 5), np.linspace(-24, 24, 13), np.linspace(0.0, 40, 11)


def _plume(x, y, z):
    """Temperature in K of the files that `make_fields.py` made."""
    return 293.15 + 300 * np.exp(-((y / 9) ** 2) / 2 - ((z - 12) / 6) ** 2 / 2 - (x / 20) ** 2 / 2)


def _anything(_: Result) -> str:
    return ""


def _plumes(near: float = 0.01, extent: float = 40.0) -> Judge:
    """Whether an imported temperature is the plume's where it is not solid."""

    def judge(result: Result) -> str:
        values = result["values"]
        axes = [
            o + s * np.arange(n)
            for o, s, n in zip(result["origin"], result["spacing"], values.shape, strict=True)
        ]
        if abs(axes[0][0] + extent) > 1e-3:
            return f"x begins at {axes[0][0]:g} mm, not {-extent:g}"
        away = np.abs(values - _plume(*np.meshgrid(*axes, indexing="ij")))
        if np.nanmax(away) > near:
            return f"temperatures are up to {np.nanmax(away):.3g} K off"
        return possible(result)

    return judge


def _hidden(result: Result) -> str:
    """The plume, and solid where the points are blanked."""
    y, z = np.meshgrid(_Y, _Z, indexing="ij")
    blank = np.broadcast_to((abs(y) < 5) & (z > 18) & (z < 30), result["values"].shape)
    if not np.isnan(result["values"][blank]).all():
        return "blanked points are air"
    return _plumes()(result)


def _plume_field(result: Result) -> str:
    """Whether a field file is the plume, where it holds a value."""
    axes = [
        o + s * np.arange(n)
        for o, s, n in zip(result["origin"], result["spacing"], result["nodes"].shape, strict=True)
    ]
    truth = 293.15 / _plume(*np.meshgrid(*axes, indexing="ij"))
    away = np.abs(result["nodes"] / result["ambient"] - truth)
    away[2, 6, 5] = 0.0  # out of the valid range in one of them
    return f"off by {away.max():.2g} of ambient" if away.max() > 1e-4 else possible(result)


def _file(kind: str, place: str, judge: Judge = possible, **more: Any) -> Case:
    path = INPUTS / place
    options = more.pop("options", {})
    files = {path.name: path.read_bytes()}
    return Case(kind, f"seed/{path.name}", files, path.name, judge, options, **more)


def _text(name: str, text: str | bytes, judge: Judge, **options: Any) -> Case:
    data = text if isinstance(text, bytes) else text.encode()
    return Case("import", f"seed/{name}", {name: data}, name, judge, options)


def refused(case: Case) -> Case:
    """The same, which nobody can make sense of."""
    made = dict(case.__dict__) | {"must_be_refused": True}
    return Case(**made)


def vtk_seeds() -> Iterator[Case]:
    """VTK's files."""
    for name in ("extent.vti", "descending.vtr"):
        yield _file("import", f"vtk/{name}", _plumes(), options=KELVIN, must_be_read=True)
    yield _file("import", "vtk/hidden.vti", _hidden, options=KELVIN)
    yield _file("import", "vtk/hidden_zero.vti", _hidden, options=KELVIN)
    cells = KELVIN | {"variable": "T"}
    yield _file("import", "vtk/cell_T.vti", _plumes(0.01, 30.0), options=cells)
    degrees = {"units": "degC", "length_units": "mm"}
    for name in (
        "truncated_ascii.vtk", "seg_truncated_unstructured_ascii.vtk", "connectivity_9.vtu",
        "connectivity_out_of_range.vtu", "huge_extent.vti", "wide_extent.vti", "huge_points.vtp",
        "negative_extent.vti", "no_cells.vtu", "nan_point.vtu",
    ):  # fmt: skip
        options = degrees if "truncated" in name else KELVIN
        yield refused(_file("import", f"vtk/{name}", options=options))
    yield _file("import", "vtk/ok.vtk", possible, options=KELVIN)
    yield _file("import", "vtk/connectivity_ok.vtu", possible, options=KELVIN)
    whole = import_files.vtk("vtk grid", "ascii", "points").data
    yield _text("flip.vtk", whole.replace(b"\nY_COORD", b"\nJY_COORD"), possible, **KELVIN)
    whole = import_files.vtk("vtp", "raw", "points").data
    yield _text(
        "vertices.vtp", whole, imports.judged(import_files.vtk("vtp", "raw", "points")), **KELVIN
    )


def table_seeds() -> Iterator[Case]:
    """CSV, COMSOL and NumPy."""
    places = np.stack([p.ravel(order="F") for p in np.meshgrid(_X, _Y, _Z, indexing="ij")], 1)
    values = _plume(*places.T)
    x, y, z = places.T
    blank = (abs(y) < 5) & (z > 18) & (z < 30)
    head = "x [mm],y [mm],z [mm],T [K]\n"

    def rows(which: Any, shown: Any, ends: str = "\n") -> str:
        return "".join(
            ",".join(repr(float(v)) for v in p) + f",{t}{ends}"
            for p, t in zip(places[which], shown[which], strict=True)
        )

    every = slice(None)
    celsius = head + rows(every, values - 273.15)
    yield refused(_text("degC_said_K.csv", celsius, _plumes()))
    yield _text("degC_said_K_2.csv", celsius, _plumes(), units="degC")
    yield _text("duplicates.csv", head + rows(x <= 0, values) + rows(x >= 0, values), _plumes())
    empty = np.where(blank, "", values.astype(str))
    yield _text("empty_cells.csv", head + rows(every, empty), _hidden)
    said = f"% Model,air.mph\n% Version,COMSOL 6.0.0.354\n% Dimension,3\n% Nodes,{len(places)}\n"
    said += "% Expressions,1\n% Description,Temperature\n% Length unit,mm\n% x,y,z,T (K)\n"
    yield _text("comsol.csv", said + rows(every, values), _plumes())
    yield refused(_text("comsol_cut.csv", said + rows(slice(455), values), _plumes()))
    sweep = said.replace(",", ":  ", 7).partition("% x")[0]
    sweep += "% X                Y                Z                "
    sweep += "T (K) @ t=1, P0=50 T (K) @ t=1, P0=100\n"
    doubled = rows(every, np.array([f"{v},{v}" for v in values])).replace(",", "  ")
    yield _text("comsol_sweep.txt", sweep + doubled, _plumes())
    for name in ("claims_7_PiB.npy", "empty.npz", "comsol_time_label.txt"):
        yield refused(_file("import", f"importers/{name}", options=KELVIN))
    records = import_files.numpy_file("records").data.replace(b"('y', '<f8')", b"('y',  <f8')", 1)
    yield refused(_text("token.npy", records, possible, **KELVIN))
    zipped = import_files.numpy_file("axes").data
    for mark, at in ((b"PK\x03\x04", 8), (b"PK\x01\x02", 10)):
        place = zipped.index(mark) + at
        zipped = zipped[:place] + b"\x98\x0e" + zipped[place + 2 :]
    yield refused(_text("unknown_method.npz", zipped, possible, **KELVIN))


def field_seeds() -> Iterator[Case]:
    """Field files."""
    for name in ("unsigned.nc", "valid_range.nc"):
        yield _file("field", f"fields/{name}", _plume_field)
    for path in sorted((INPUTS / "fields").glob("*.nc")):
        if path.name not in ("unsigned.nc", "valid_range.nc"):
            sensible = path.name in ("terminal_escape.nc", "missing_array.nc")  # several fit CF
            case = _file("field", f"fields/{path.name}")
            yield case if sensible else refused(case)


def calibration_seeds() -> Iterator[Case]:
    """Calibrations."""
    turn = np.array(
        [
            [0.8243069049411029, -0.07603337474001379, -0.5610143067623712],
            [0.017872901892930625, 0.9939416174117621, -0.1084463948447152],
            [0.5658610128329615, 0.07936615842117363, 0.8206718753881602],
        ]
    )
    shift, plane = np.array([5.0, -3.0, 400.0]), np.array([0.2873478855663454, 0.9578262852211513])
    grid = np.stack(np.meshgrid([-40.0, 0.0, 60.0], [-30.0, 20.0]), -1).reshape(-1, 2)
    points = np.column_stack([grid, (2.0 - plane[0] * grid[:, 1]) / plane[1]])
    lens = {
        "fisheye": (cv2.fisheye.projectPoints, np.array([0.05, -0.02, 0.01, -0.003])),
        "radial": (cv2.projectPoints, np.array([-0.1, 0.02, 0.001, -0.0005, 0.003])),
    }
    names = {"rosfish4": "fisheye", "cvfish4": "fisheye", "rt5": "radial", "skewnames5": "radial"}
    for name, kind in names.items():
        project, coefficients = lens[kind]
        turned = cv2.Rodrigues(turn)[0]
        pixels = project(points[:, None], turned, shift[:, None], calibrations.K, coefficients)[0]
        model = calibrations.Model({}, points, pixels.reshape(-1, 2), False, name)
        yield _file(
            "calibration",
            f"calibrations/{name}.yaml",
            calibrations.judged(model),
            options={"pixels": model.pixels},
        )
    for ending, text in (
        ("json", '{"camera_matrix": ' + "[" * 100_000 + "]" * 100_000 + "}"),
        ("yaml", "%YAML:1.0\n---\ncamera_matrix: " + "[" * 100_000 + "]" * 100_000),
        ("xml", "<?xml version='1.0'?>\n<opencv_storage>" + "<a>" * 50_000),
    ):
        name = f"nested.{ending}"
        options = {"pixels": np.zeros((1, 2))}
        files: dict[str, bytes | str] = {name: text.encode()}
        yield refused(Case("calibration", f"seed/{name}", files, name, _anything, options))


def image_seeds() -> Iterator[Case]:
    """Images: a line of sigma 2 px at row 20 + 0.05 column."""
    picture = image_files.Picture((48, 60), 20.0, 0.05, 1.0)
    twelve = picture.grey(np.uint16, 4095)
    sixteen = picture.grey(np.uint16, 65535)
    decoy = np.ascontiguousarray(sixteen[::-1])
    tags = image_files.grey_tags(picture.shape, 16, 48)
    raw = sixteen.astype("<u2").tobytes()

    def case(
        label: str, name: str, data: bytes, *truths: Any, channel: str = "", excused: Any = ()
    ):
        written = image_files.Written(name, data, truths, excused=tuple(excused), label=label)
        judge = images.judged(written, picture)
        options = {"channel": channel} if channel else {}
        return Case("image", f"seed/{label}", {name: data}, name, judge, options)

    strips = [b"".join(image_files.packed(twelve, 12))]
    data = image_files.tiff([(image_files.grey_tags(picture.shape, 12, 48), strips)])
    yield case("packed12", "line.tif", data, twelve)
    data = image_files.tiff([(tags | {262: (3, [0])}, [(65535 - sixteen).astype("<u2").tobytes()])])
    yield case("white is zero", "line.tif", data, sixteen)
    more = {258: (3, [16] * 3), 262: (3, [2]), 277: (3, [3]), 284: (3, [2])}
    data = image_files.tiff([(tags | more, [raw, decoy.tobytes(), decoy.tobytes()])])
    yield case("planar", "line.tif", data, sixteen, channel="red")
    data = image_files.tiff([(tags, [raw]), (tags, [decoy.tobytes()])])
    yield case("pages", "line.tif", data, excused=[sixteen])
    data = image_files.tiff(
        [(tags | {274: (3, [3])}, [sixteen[::-1, ::-1].astype("<u2").tobytes()])]
    )
    yield case("orientation", "line.tif", data, sixteen)
    high = image_files.png(twelve << 4, 16, [(b"sBIT", bytes([12]))])
    yield case("top 12 bits", "line.png", high, twelve, twelve << 4)
    grey = picture.grey(np.float32)
    head = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    parts = [(dict(head), {"Y": grey}), (dict(head), {"Y": np.ascontiguousarray(grey[::-1])})]
    yield case("two parts", "line.exr", image_files.exr(parts), excused=[grey])
    first = {"Z": np.ascontiguousarray(grey[::-1])}
    parts = [(dict(head), first), (dict(head), {"Y": grey})]
    yield case("second part", "line.exr", image_files.exr(parts), grey, channel="Y")
    channels = {"R": grey, "G": grey * 0.5, "B": grey * 0.25}
    yield case(
        "rgb by its name", "line.exr", image_files.exr([(head, channels)]), grey, channel="R"
    )


def scene_seeds() -> Iterator[Case]:
    """Scenes."""
    whole = scene_files.scene(scene_files.CYLINDER)
    known = scene_files.Written({}, "seed")

    def case(label: str, text: str | bytes, judge: Judge = scenes.possible, **more: Any) -> Case:
        data = text if isinstance(text, bytes) else text.encode()
        files = {"scene.xml": data, **more.pop("files", {})}
        return Case("scene", f"seed/{label}", files, "scene.xml", judge, **more)

    accented = whole.replace("<scene", "<!-- schr\xe4g -->\n<scene", 1)
    right = scenes.judged(known)
    for name in ("ISO-8859-1", "utf-16", "foo", "utf-32"):
        text = accented.replace("utf-8", name, 1)
        data = text.encode("utf-8" if name == "foo" else name)
        yield case(f"encoding {name}", data, right)
    yield case("utf-16 without a declaration", whole.partition("\n")[2].encode("utf-16"), right)
    yield refused(
        case("undeclared latin-1", accented.encode("latin-1").replace(b"utf-8", b"utf-8"))
    )
    nested = '<shape type="sphere">' * 10_000 + "</shape>" * 10_000
    yield refused(case("10,000 nested shapes", scene_files.scene(scene_files.CYLINDER + nested)))
    deep = '<bsdf type="twosided">' * 1000 + '<bsdf type="diffuse"/>' + "</bsdf>" * 1000
    yield refused(case("1,000 nested bsdfs", scene_files.scene(scene_files.CYLINDER + deep)))
    grown = "".join(
        f'<default name="p{i}" value="{f"$p{i - 1}" * 30 if i else "x" * 30}"/>' for i in range(8)
    )
    yield case("growing parameters", whole.replace("<integrator", grown + "<integrator", 1))
    sampler = whole.replace('"stratified"', '"independent"')
    sampler = re.sub(r"\s*<boolean name=\"jitter\".*", "", sampler)
    yield case("no sample", sampler, options={"spp": "0"})
    eye = '<lookat origin="0,0,0" target="0,0,301" up="1,0,0"/>'
    inside = re.sub(r'<lookat origin="0, 0, 300".*?/>', eye, whole)
    yield refused(case("camera on the surface", inside))
    flat = scene_files.Written({}, "seed", flat=True)
    part = scene_files.FILE.format(kind="ply", ending="ply")
    for name, judge in (("quad", scenes.judged(flat)), ("flip", scenes.judged(flat))):
        data = (INPUTS / f"scenes/{name}.ply").read_bytes()
        yield case(name, scene_files.scene(part), judge, files={"part.ply": data})
    data = (INPUTS / "scenes/index_out_of_range.ply").read_bytes()
    yield refused(case("index out of range", scene_files.scene(part), files={"part.ply": data}))
    far = whole.replace('name="far_clip" value="1000"', 'name="far_clip" value="200"')
    yield case("far clip", far)
    for name, value in (
        ("line_radius", "nan"), ("line_length", "1e30"), ("alpha", "nan"), ("width", "1000000000"),
        ("dots", ", ".join(map(str, range(20_000)))), ("tilt", "inf"), ("fan", "nan"),
    ):  # fmt: skip
        yield case(f"{name} {value[:9]}", whole, options={name: value})
    emitter = '<lookat origin="0, 0, 300" target="0, 0, 0" up="0, 1, 0"/>'
    for scaled in ('<scale value="2"/>', '<scale x="-1"/>', '<scale x="1" y="2" z="1"/>'):
        text = whole.replace(emitter, f"{scaled}{emitter}")
        yield case(f"laser of {scaled}", text)
    moved = whole.replace(emitter, emitter + '<translate x="1e20"/>')
    yield refused(case("laser 1e20 mm away", moved))


def call_seeds() -> Iterator[Case]:
    """Calls of functions."""

    def case(label: str, judge: Judge, **options: Any) -> Case:
        return Case("call", f"seed/{label}", {}, "", judge, options)

    def nothing(result: Result) -> str:
        return "" if len(result["value"]) == 0 else "pixels of no rays"

    yield case("no rays", nothing, function="ray_search", laser_y_mm=np.zeros(0))
    yield case("no pixels", nothing, function="triangulate", pixel=[])
    ends = {"origins_mm": [], "directions": np.zeros((0, 3)), "length_mm": 1.0}
    yield case("no rays to trace", nothing, function="trace", **ends)
    many = {"function": "ray_search", "laser_y_mm": np.zeros((2, 2))}
    yield refused(case("rays in two dimensions", _anything, **many))
    for spp in (-1, 0, 2**70):
        yield refused(case(f"{spp:g} samples", _anything, function="render", spp=spp, seed=0))
    rows = np.arange(200)[:, None] + np.zeros(300)
    lines = 200 * np.exp(-(((rows - 60) / 2) ** 2) / 2) + 120 * np.exp(
        -(((rows - 130) / 2) ** 2) / 2
    )
    image = np.ma.masked_array(lines, abs(rows - 65) <= 15)

    def other_line(result: Result) -> str:
        away = np.abs(result["row"] - 130.0)
        return "" if np.nanmax(away) < 0.01 else f"rows are up to {np.nanmax(away):g} px off"

    yield case("a masked line", other_line, function="line_centres", image=image)


@functools.cache
def every() -> tuple[Case, ...]:
    """All of them."""
    makers = (
        vtk_seeds,
        table_seeds,
        field_seeds,
        calibration_seeds,
        image_seeds,
        scene_seeds,
        call_seeds,
        special_seeds,
    )
    return tuple(case for maker in makers for case in maker())


def special_seeds() -> Iterator[Case]:
    """What is no regular file: it would block for ever, or is not there."""
    for kind, names in {
        "image": ("a.png", "a.tif", "a.exr"),
        "field": ("a.nc",),
        "import": ("a.vti", "a.vtu", "a.csv", "a.txt", "a.npy", "a.npz", "a.vtk"),
        "calibration": ("a.yaml", "a.xml", "a.json"),
        "scene": ("a.xml",),
    }.items():
        options = {"pixels": np.zeros((1, 2))} if kind == "calibration" else {}
        for name in names:
            for what in ("fifo", "folder", "loop", "absent", b""):
                files = {} if what == "absent" else {name: what}
                label = f"seed/{name} is {what or 'empty'!r}"
                yield refused(Case(kind, label, files, name, _anything, options))
