"""Scenes whose line is known in closed form, and their parts as files."""

from __future__ import annotations

import functools
import io
import struct
import zipfile
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import trimesh

FOV_DEG, FAR_MM, RADIUS_MM = 8.588941972, 300.0, 13.5

_CAMERA = """    <sensor type="perspective" id="camera">
        <string name="fov_axis" value="x"/>
        <float name="fov" value="8.588941972"/>
        <float name="near_clip" value="1"/>
        <float name="far_clip" value="1000"/>
        <transform name="to_world">
            <lookat origin="0, 0, 300" target="0, 0, 0" up="-1, 0, 0"/>
            <rotate y="1" angle="$tilt"/>
            <rotate y="1" angle="$alpha"/>
        </transform>
        <film type="hdrfilm">
            <integer name="width" value="$width"/>
            <integer name="height" value="$height"/>
            <string name="pixel_format" value="luminance"/>
            <string name="component_format" value="float32"/>
            <rfilter type="box"/>
        </film>
        <sampler type="stratified">
            <integer name="sample_count" value="$spp"/>
            <boolean name="jitter" value="false"/>
        </sampler>
    </sensor>
"""
_LASER = """    <emitter type="laser_line" id="laser">
        <float name="distance" value="300"/>
        <float name="length" value="$line_length"/>
        <float name="radius" value="$line_radius"/>
        <float name="power" value="0.1"/>
        <float name="fan" value="$fan"/>
        <string name="dots" value="$dots"/>
        <transform name="to_world">
            <lookat origin="0, 0, 300" target="0, 0, 0" up="0, 1, 0"/>
            <rotate y="1" angle="$tilt"/>
        </transform>
    </emitter>
"""
_STEEL = """    <bsdf type="diffuse" id="steel">
        <float name="reflectance" value="0.5"/>
    </bsdf>
"""
CYLINDER = """    <shape type="cylinder" id="part">
        <point name="p0" x="-85" y="0" z="-13.5"/>
        <point name="p1" x="85" y="0" z="-13.5"/>
        <float name="radius" value="13.5"/>
        <ref id="steel"/>
    </shape>
"""
FILE = """    <shape type="{kind}" id="part">
        <string name="filename" value="part.{ending}"/>
        <ref id="steel"/>
    </shape>
"""
DEFAULTS = {
    "alpha": 60.0, "tilt": -30.0, "line_length": 22.0, "line_radius": 0.8, "fan": 0.0, "dots": "",
    "width": 64, "height": 64, "spp": 4,
}  # fmt: skip


def scene(part: str, declared: str = '<?xml version="1.0" encoding="utf-8"?>\n') -> str:
    """A scene's text."""
    head = "".join(f'    <default name="{n}" value="{v}"/>\n' for n, v in DEFAULTS.items())
    body = '    <integrator type="refractive"/>\n' + _CAMERA + _LASER + _STEEL + part
    return f'{declared}<scene version="3.0.0">\n{head}{body}</scene>\n'


@dataclass(frozen=True)
class Written:
    """A scene, and where its line is.

    Attributes
    ----------
    files : dict
    part : str
        The part's file; empty where it is a cylinder.
    flat : bool
        Whether the part is the plane z = 0, else the cylinder under the x axis.
    plain : bool
        Whether it must be read.
    """

    files: dict[str, bytes]
    label: str
    part: str = ""
    flat: bool = False
    plain: bool = True
    options: dict[str, Any] = field(default_factory=dict)


def _turned(angle_deg, vector):
    """About y, as Mitsuba turns."""
    c, s = np.cos(np.radians(angle_deg)), np.sin(np.radians(angle_deg))
    return np.array([[c, 0.0, s], [0.0, 1.0, 0.0], [-s, 0.0, c]]) @ vector


def line_rows(flat: bool, said: dict[str, Any]):
    """Columns and rows of the line, by plane geometry: laser rays, part, pinhole.

    Returns
    -------
    columns, rows : ndarray
        Of 201 rays along the line, columns ascending; NaN where a ray misses.
    """
    used = DEFAULTS | said
    alpha, tilt, length, width, height = (
        float(used[n]) for n in ("alpha", "tilt", "line_length", "width", "height")
    )
    y = np.linspace(-0.5, 0.5, 201) * length
    down = _turned(tilt, np.array([0.0, 0.0, -1.0]))
    start = _turned(tilt, np.array([0.0, 0.0, FAR_MM]))
    points = start + np.outer(np.ones_like(y), [0, 0, 0]) + np.outer(y, [0.0, 1.0, 0.0])
    with np.errstate(invalid="ignore"):
        depth = 0.0 if flat else np.sqrt(RADIUS_MM**2 - y**2) - RADIUS_MM
    points = points + np.outer((depth - points[:, 2]) / down[2], down)
    eye = _turned(tilt + alpha, np.array([0.0, 0.0, FAR_MM]))
    forward = _turned(tilt + alpha, np.array([0.0, 0.0, -1.0]))
    up = _turned(tilt + alpha, np.array([-1.0, 0.0, 0.0]))
    right = np.cross(forward, up)
    seen = points - eye
    focal = width / 2.0 / np.tan(np.radians(FOV_DEG / 2.0))
    columns = focal * (seen @ right) / (seen @ forward) + width / 2.0 - 0.5
    rows = -focal * (seen @ up) / (seen @ forward) + height / 2.0 - 0.5
    order = np.argsort(columns)
    return columns[order], rows[order]


def _ply(form: str, vertices, faces) -> bytes:
    """A PLY file byte by byte: ASCII or binary, triangles or quads, floats or doubles."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}
    kind, real, index = form.split()
    head = f"ply\nformat {kind} 1.0\nobj_info made by hand\ncomment x\n"
    head += f"element vertex {len(vertices)}\n" + "".join(f"property {real} {n}\n" for n in "xyz")
    head += f"element face {len(faces)}\nproperty list uchar {index} vertex_indices\nend_header\n"
    if kind == "ascii":
        body = "".join(" ".join(f"{c:.9g}" for c in v) + "\n" for v in vertices)
        body += "".join(f"{len(f)} {' '.join(map(str, f))}\n" for f in faces)
        return (head + body).encode()
    letter, whole = {"float": "f", "double": "d"}[real], {"int": "i", "uint": "I", "ushort": "H"}
    body_bytes = b"".join(struct.pack(f"{order[kind]}3{letter}", *v) for v in vertices)
    for f in faces:
        body_bytes += struct.pack(f"{order[kind]}B{len(f)}{whole[index]}", len(f), *f)
    return head.encode() + body_bytes


def _plate(count: int = 4):
    """A plate at z = 0, 80 mm wide: vertices and quads, seen from above."""
    axis = np.linspace(-40.0, 40.0, count)
    vertices = np.array([[x, y, 0.0] for x in axis for y in axis])
    quads = [
        (i * count + j, (i + 1) * count + j, (i + 1) * count + j + 1, i * count + j + 1)
        for i in range(count - 1)
        for j in range(count - 1)
    ]
    return vertices, quads


def _triangles(quads):
    return [t for a, b, c, d in quads for t in ((a, b, c), (a, c, d))]


PLY_FORMS = (
    "ascii float int", "ascii double uint", "binary_little_endian float int",
    "binary_little_endian double uint", "binary_big_endian float ushort",
)  # fmt: skip


@functools.cache
def part(form: str, quads: bool) -> tuple[str, bytes]:
    """A plate's file: its ending and contents."""
    vertices, faces = _plate()
    faces = faces if quads else _triangles(faces)
    if form in PLY_FORMS:
        return "ply", _ply(form, vertices, faces)
    if form == "obj":
        text = "# by hand\n" + "".join("v {:.9g} {:.9g} {:.9g}\n".format(*v) for v in vertices)
        text += "".join("f " + " ".join(str(i + 1) for i in f) + "\n" for f in faces)
        return "obj", text.encode()
    mesh = trimesh.Trimesh(vertices, _triangles(_plate()[1]), process=False)
    if form == "3mf":
        return "3mf", _threemf(mesh)
    if form == "stl ascii":
        return "stl", mesh.export(file_type="stl_ascii").encode()
    return form.split()[0], mesh.export(file_type=form.split()[0])


def _threemf(mesh: trimesh.Trimesh) -> bytes:
    """A 3MF file, stored as it is: so that what is changed in it is XML."""
    rows = ['<vertex x="{:.9g}" y="{:.9g}" z="{:.9g}"/>'.format(*v) for v in mesh.vertices]
    rows += ["</vertices><triangles>"]
    rows += ['<triangle v1="{}" v2="{}" v3="{}"/>'.format(*face) for face in mesh.faces]
    text = f"""<?xml version="1.0"?><model unit="millimeter" xmlns="http://schemas.microsoft.com/\
3dmanufacturing/core/2015/02"><resources><object id="1"><mesh><vertices>{"".join(rows)}</triangles>\
</mesh></object></resources><build><item objectid="1"/></build></model>"""
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w") as archive:
        archive.writestr("3D/3dmodel.model", text)
    return file.getvalue()


PARTS = (*PLY_FORMS, "obj", "stl ascii", "stl binary", "ply trimesh", "3mf")
