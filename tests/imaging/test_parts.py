"""Parts from files as programs write them: the geometry is that of the writer, or refused."""

import io
import re
import struct
import zipfile
from pathlib import Path

import numpy as np
import pytest
import trimesh

import virtual_sensor as vs
from virtual_sensor.arrays import to_vectors
from virtual_sensor.engine import mi
from virtual_sensor.imaging.part_kinds import check_kind
from virtual_sensor.imaging.parts import read_part
from virtual_sensor.imaging.scene_file import shipped_scenes

BALL = trimesh.creation.icosphere(2, 13.5).apply_translation([1.0, 2.0, -13.5])
SQUARE = np.array([[-40, -40, 0], [40, -40, 0], [40, 40, 0], [-40, 40, 0]], float)
COLD = (shipped_scenes() / "cold_cylinder.xml").read_text(encoding="utf-8")
BEFORE = COLD[: COLD.index("    <shape")]


def ply(polygons, vertices=SQUARE, kind="ascii", types="float", index="int", extra="", remark=""):
    """A PLY file's bytes, by its definition."""
    order = {"ascii": "", "binary_little_endian": "<", "binary_big_endian": ">"}[kind]
    head = f"ply\nformat {kind} 1.0\ncomment by hand\n{remark}element vertex {len(vertices)}\n"
    head += "".join(f"property {types} {axis}\n" for axis in "xyz")
    head += f"{extra}element face {len(polygons)}\nproperty list uchar {index} vertex_indices\n"
    head += "end_header\n"
    if not order:
        rows = [*vertices, *([len(p), *p] for p in polygons)]
        return (head + "".join(" ".join(map(str, row)) + "\n" for row in rows)).encode()
    code = {"float": "f", "double": "d"}[types]
    body = b"".join(struct.pack(f"{order}3{code}", *row) for row in vertices)
    code = {"int": "i", "ushort": "H"}[index]
    for p in polygons:
        body += struct.pack(f"{order}B{len(p)}{code}", len(p), *p)
    return head.encode() + body


def obj(*faces, vertices=SQUARE, more=""):
    """An OBJ file's bytes."""
    rows = [f"v {x} {y} {z}" for x, y, z in vertices]
    return ("\n".join(rows) + f"\n{more}\n" + "".join(f"f {face}\n" for face in faces)).encode()


def stl(triangles, header=b"binary", count=None):
    """A binary STL file's bytes."""
    data = header.ljust(80) + struct.pack("<I", len(triangles) if count is None else count)
    for triangle in np.reshape(triangles, (-1, 9)):
        data += struct.pack("<12fH", 0.0, 0.0, 1.0, *triangle, 0)
    return data


def ascii_stl(mesh):
    """An ASCII STL file's text, by trimesh."""
    return mesh.export(file_type="stl_ascii")


@pytest.fixture
def read(tmp_path):
    """Write a file and read it as a part."""

    def reader(kind, data):
        path = tmp_path / f"part.{kind}"
        path.write_bytes(data if isinstance(data, bytes) else data.encode())
        return read_part(path, kind)

    return reader


@pytest.fixture
def scene(tmp_path):
    """Write a part and load the cold scene with it."""

    def load(kind, data, inside="", **parameters):
        (tmp_path / f"part 1.{kind}").write_bytes(
            data if isinstance(data, bytes) else data.encode()
        )
        shape = f'<shape type="{kind}"><string name="filename" value="part 1.{kind}"/>{inside}'
        path = tmp_path / "scene.xml"
        path.write_text(f'{BEFORE}{shape}<ref id="steel"/></shape></scene>', encoding="utf-8")
        return vs.load_scene(path, **({"width": 64, "height": 64} | parameters))

    return load


def triangles(part):
    """Corners (M, 3, 3) of a part's triangles."""
    return part.vertices[part.faces]


@pytest.mark.parametrize(
    ("kind", "options"),
    [
        *(("stl", {}), ("stl", {"file_type": "stl_ascii"})),
        *(("ply", {}), ("ply", {"encoding": "ascii"})),
        *(("obj", {}), ("obj", {"include_normals": True})),
    ],
)
def test_what_a_writer_wrote_is_read(read, kind, options):
    """Triangle by triangle, to the digits that trimesh writes."""
    part = read(kind, BALL.export(**({"file_type": kind} | options)))
    np.testing.assert_allclose(triangles(part), BALL.triangles, atol=2e-6)
    assert part.notes == ()


QUADS = [[0, 1, 2, 3]]
MIXED = [[0, 1, 2], [0, 1, 2, 3]]
HALVES = [[0, 1, 2], [0, 2, 3]]


@pytest.mark.parametrize(
    ("kind", "data", "expected", "by_mitsuba"),
    [
        ("ply", ply(HALVES), HALVES, True),
        ("ply", ply(HALVES, kind="binary_big_endian"), HALVES, True),
        ("ply", ply(QUADS), HALVES, False),
        ("ply", ply(QUADS, kind="binary_little_endian"), HALVES, False),
        ("ply", ply(MIXED, kind="binary_little_endian"), [HALVES[0], *HALVES], False),
        ("ply", ply(MIXED, kind="binary_big_endian", types="double"), [HALVES[0], *HALVES], False),
        ("ply", ply(HALVES, kind="binary_little_endian", index="ushort"), HALVES, False),
        ("ply", ply(HALVES, types="double"), HALVES, False),
        ("ply", ply(HALVES, remark="obj_info by a scanner\n"), HALVES, False),
        ("ply", ply([*HALVES, [0, 1]]), HALVES, False),
        ("ply", ply(HALVES).replace(b"\n", b"\r\n"), HALVES, True),
        ("obj", obj("1 2 3", "1 3 4"), HALVES, True),
        ("obj", obj("1 2 3 4"), HALVES, False),
        ("obj", obj("-4 -3 -2", "-4 -2 -1"), HALVES, False),
        ("obj", obj("1//1 2//1 3//1 4//1", more="vn 0 0 1"), HALVES, False),
        ("obj", obj("1 2 \\\n3 4 # all", more="# remark\ng a\no b\ns 1\nl 1 2"), HALVES, False),
        ("stl", stl(SQUARE[HALVES]), None, False),
        ("stl", stl(SQUARE[HALVES], header=b"solid but binary"), None, False),
    ],
    ids=range(18),
)
def test_a_square_is_two_triangles_in_any_writing(read, kind, data, expected, by_mitsuba):
    """Rationale: quads, doubles, obj_info, negative indices and STL were refused."""
    part = read(kind, data)
    np.testing.assert_array_equal(triangles(part), SQUARE[HALVES if expected is None else expected])
    assert part.by_mitsuba == by_mitsuba


@pytest.mark.parametrize("first", range(4))
def test_a_quad_with_a_corner_inwards_is_not_filled(read, first):
    """Rationale: on the other diagonal, triangles lie beside the face; area by the formula."""
    dart = np.array([[0, 0, 0], [10, 0, 0], [2, 2, 0], [0, 10, 0]], float)
    part = read("ply", ply([np.roll(range(4), first).tolist()], dart))
    corner = triangles(part)
    area = 0.5 * np.cross(corner[:, 1] - corner[:, 0], corner[:, 2] - corner[:, 0])[:, 2]
    assert (area > 0.0).all()
    assert area.sum() == pytest.approx(20.0)
    assert "1 faces of more than three corners" in part.notes[0]


def test_a_polygon_that_no_fan_fills_is_refused(read):
    """An M of which no corner sees all others."""
    m = [[0, 0, 0], [1, 0, 0], [1, 6, 0], [3, 3, 0], [5, 6, 0], [5, 0, 0], [6, 0, 0], [6, 9, 0]]
    m += [[3, 5, 0], [0, 9, 0]]
    with pytest.raises(vs.InputError, match=r"part\.ply: face 0 has 10 corners, and none .*triang"):
        read("ply", ply([list(range(10))], np.array(m, float)))


def test_a_vertex_may_have_several_normals_in_an_obj(read):
    """And the geometry is the same."""
    faces = ("1//1 2//1 3//1", "1//2 3//2 4//2", "-4//1 -3//1 -2//1")
    part = read("obj", obj(*faces, more="vn 0 0 2\nvn 0 3 0"))
    np.testing.assert_array_equal(triangles(part), SQUARE[[*HALVES, HALVES[0]]])
    normals = part.normals[part.faces]
    np.testing.assert_array_equal(normals[0], np.tile([0, 0, 2.0], (3, 1)))
    np.testing.assert_array_equal(normals[1], np.tile([0, 3.0, 0], (3, 1)))


BOX = trimesh.creation.box()
TEXT = ascii_stl(BOX)
REFUSED = [
    ("ply", ply([[0, 1, 100_000]]), "face 0 refers to vertex 100000, and there are 0 to 3"),
    ("ply", ply([[0, 1, 2], [0, -1, 2]]), "face 1 refers to vertex -1"),
    ("ply", ply([[0, 1, 1.5]]), "face 0 refers to vertex -1"),
    ("ply", ply(HALVES, [*SQUARE[:3], [0, np.nan, 0]]), "vertex 3 is at [0.0, nan, 0.0]"),
    ("ply", ply(HALVES, [*SQUARE[:3], [0, 1e39, 0]], types="double"), "give finite numbers"),
    ("ply", ply([]), "it has no faces"),
    ("ply", ply([], []), "it has no vertices"),
    ("ply", ply([[0, 1, 1]]), "its faces have no area"),
    ("ply", ply(HALVES)[:-4], "is not that long"),
    ("ply", ply(HALVES, kind="binary_little_endian")[:-4], "ends before what its header counts"),
    ("ply", ply(HALVES) + b"3 0 1 2\n", "more follows than its header counts"),
    ("ply", ply(HALVES, kind="binary_big_endian") + b"\0", "more follows than its header counts"),
    ("ply", ply(HALVES).replace(b"vertex 4", b"vertex 99999999999999"), "ends before what its hea"),
    ("ply", ply(HALVES).replace(b"3 0 1 2", b"99999999 0 1 2"), "counts 99999999 items"),
    ("ply", ply(HALVES).replace(b"3 0 1 2", b"3 0 one 2"), "a word for a number"),
    ("ply", ply(HALVES).replace(b"float z", b"float w"), "no x, y and z"),
    ("ply", ply(HALVES).replace(b"float x", b"quad x"), 'the type "quad"'),
    ("ply", ply(HALVES).replace(b"ascii", b"ebcdic"), 'has the line "format ebcdic 1.0"'),
    ("ply", b"ply\n", "no PLY file"),
    ("ply", b"", "no PLY file"),
    ("obj", obj("1 2 9"), 'face 0 refers to a "v" that is not there, of 4'),
    ("obj", obj("0 1 2"), 'a face with the corner "0"'),
    ("obj", obj("-9 1 2"), 'refers to a "v" that is not there'),
    ("obj", obj("1/7 2/7 3/7"), 'refers to a "vt" that is not there, of 0'),
    ("obj", obj("1//1 2//1 3//1"), 'refers to a "vn" that is not there, of 0'),
    ("obj", obj("a b c"), 'a face with the corner "a"'),
    ("obj", obj(), "it has no faces"),
    ("obj", b"v 1 2\nf 1 1 1\n", "fewer than three numbers"),
    ("obj", b"v 1 2 nan\nf 1 1 1\n", "vertex 0 is at [1.0, 2.0, nan]"),
    ("obj", obj(more="cstype bezier\nsurf 0 1 0 1 1 2 3 4"), "free forms"),
    ("obj", bytes(range(256)), "it has no vertices"),
    ("stl", stl(SQUARE[HALVES])[:-1], "as a binary one it counts 2 facets and holds 1"),
    ("stl", stl(SQUARE[HALVES], count=7), "it counts 7 facets and holds 2"),
    ("stl", stl(SQUARE[HALVES])[:96] + b"\1\0\x80\x7f" + stl(SQUARE[HALVES])[100:], "give finite"),
    ("stl", stl([]), "it has no facets"),
    ("stl", b"", "it counts 0 facets and holds 0"),
    ("stl", TEXT[: len(TEXT) // 2], "facets, 5 of them ended"),
    ("stl", TEXT.replace("0.5", "0,5", 1), "trimesh can't read it"),
    ("stl", TEXT.replace("0.5", "nan", 1), "give finite numbers"),
    ("stl", "solid\nendsolid\n", "it has no"),
]


@pytest.mark.parametrize(("kind", "data", "words"), REFUSED, ids=range(len(REFUSED)))
def test_a_damaged_part_is_refused_with_file_and_remedy(scene, kind, data, words):
    """Rationale: Mitsuba dies of indices out of range, and of other faults says something else."""
    with pytest.raises(vs.InputError) as refused:
        scene(kind, data)
    message = str(refused.value)
    assert f'<shape type="{kind}">: ' in message
    assert f"part 1.{kind}: " in message
    assert words in message
    assert "\n" not in message


@pytest.mark.parametrize(
    ("kind", "data", "words"),
    [
        ("ply", ply(QUADS), "1 faces of more than three corners cut to triangles"),
        ("ply", ply([*HALVES, [0, 1]]), "1 faces of fewer than three corners left out"),
        (
            "ply",
            ply(QUADS, extra="property float heat\n", vertices=np.c_[SQUARE, SQUARE[:, 0]]),
            "its vertices' heat are ignored",
        ),
        (
            "ply",
            ply(HALVES, extra="element edge 1\nproperty int a\n", vertices=[*SQUARE, [7]]),
            "its elements edge are ignored",
        ),
        ("obj", obj("1/1 2/1 3/1 4/1", more="vt 0 0"), "its texture coordinates are ignored"),
        ("obj", obj("1 2 3", more="mtllib a.mtl\nusemtl steel"), "its materials are ignored"),
        ("obj", obj("1//1 2//1 3//1", more="vn 0 0 0"), "its vertex normals are ignored: 3 are"),
        ("stl", stl(SQUARE[HALVES][:, ::-1]), "the normals of 2 facets contradict the order"),
    ],
    ids=range(8),
)
def test_what_is_left_out_of_a_part_is_noted(scene, kind, data, words):
    """Once, with the file, among the scene's notes."""
    if b"edge" in data if isinstance(data, bytes) else False:
        data = data.replace(b"element vertex 5", b"element vertex 4")
    notes = [note for note in scene(kind, data).notes if words in note]
    assert len(notes) == 1
    assert f"part 1.{kind}: " in notes[0]


@pytest.mark.parametrize("kind", ["stl", "ply", "obj"])
def test_a_part_stands_where_to_world_puts_it(scene, kind):
    """Turned, scaled from inches and moved; its emitter and its BSDF stay."""
    inches = trimesh.creation.box((2.0, 1.0, 0.5))
    data = inches.export(file_type=kind)
    if kind != "stl":
        data = data.replace(b"comment", b"obj_info") if kind == "ply" else data.replace("f ", "f\t")
    inside = '<transform name="to_world"><scale value="25.4"/><rotate z="1" angle="90"/>'
    inside += '<translate z="-10"/></transform><emitter type="glow"><float name="temperature"'
    inside += ' value="900"/></emitter>'
    loaded = scene(kind, data, inside)
    (shape,) = loaded.mitsuba.shapes()
    np.testing.assert_allclose(shape.bbox().min, [-12.7, -25.4, -16.35], atol=1e-5)
    np.testing.assert_allclose(shape.bbox().max, [12.7, 25.4, -3.65], atol=1e-5)
    assert shape.is_emitter()
    assert shape.bsdf().id() == "steel"


@pytest.mark.parametrize("kind", ["stl", "ply", "obj"])
def test_a_mirrored_part_keeps_its_outside(scene, kind):
    """Rationale: Mitsuba turned it inside out, and its frame was black."""
    flat = trimesh.creation.box((80.0, 80.0, 10.0)).apply_translation([0, 0, -5])
    data = flat.export(file_type=kind)
    mirrored = '<transform name="to_world"><scale x="-1"/></transform>'
    plain, other = (vs.render(scene(kind, data, inside)) for inside in ("", mirrored))
    assert plain.max() > 0.0
    np.testing.assert_allclose(other, plain, rtol=1e-4, atol=1e-6 * plain.max())


def test_quads_are_as_bright_as_triangles(scene):
    """The square of quads renders as that of triangles, which Mitsuba reads itself."""
    by_us, by_mitsuba = (vs.render(scene("ply", ply(p))) for p in (QUADS, HALVES))
    assert by_mitsuba.max() > 0.0
    np.testing.assert_allclose(by_us, by_mitsuba, rtol=1e-5)


def test_a_ball_of_stl_has_the_area_of_its_facets(scene):
    """No vertex is merged or moved: area and volume by trimesh."""
    mesh = scene("stl", BALL.export(file_type="stl")).mitsuba.shapes()[0]
    assert mesh.face_count() == len(BALL.faces)
    assert mesh.vertex_count() == 3 * len(BALL.faces)
    assert float(mi.Float(mesh.surface_area())[0]) == pytest.approx(BALL.area, rel=1e-6)


MODEL = "3D/3dmodel.model"


def threemf(
    build='<item objectid="1"/>',
    unit="millimeter",
    objects="",
    mesh=BALL,
    model=MODEL,
    encoding="UTF-8",
    **more,
):
    """A 3MF file's bytes, by its specification."""
    rows = [
        *(f'<vertex x="{x:.9g}" y="{y:.9g}" z="{z:.9g}"/>' for x, y, z in mesh.vertices),
        "</vertices><triangles>",
        *(f'<triangle v1="{a}" v2="{b}" v3="{c}"/>' for a, b, c in mesh.faces),
    ]
    text = (
        f'<?xml version="1.0" encoding="{encoding}"?><model unit="{unit}" xmlns="http://schemas.microsoft.com/'
        f'3dmanufacturing/core/2015/02"><resources><object id="1"><mesh><vertices>{"".join(rows)}'
        f"</triangles></mesh></object>{objects}</resources><build>{build}</build></model>"
    )
    file = io.BytesIO()
    with zipfile.ZipFile(file, "w", zipfile.ZIP_DEFLATED) as archive:
        for name, words in ({model: text} | more).items():
            archive.writestr(name, words)
    return file.getvalue()


def test_a_3mf_file_is_read_in_its_unit_with_its_transforms(read):
    """As it stands; in inches; twice, turned and mirrored within another object; of two files."""
    part = read("3mf", threemf())
    np.testing.assert_allclose(triangles(part), BALL.triangles, atol=2e-6)
    assert part.notes == ()
    part = read("3mf", threemf(unit="inch"))
    np.testing.assert_allclose(triangles(part), 25.4 * BALL.triangles, atol=1e-4)
    assert "its lengths are in the unit inch" in part.notes[0]
    twice = '<object id="2"><components><component objectid="1" transform="{}"/></components>'
    twice += "</object>"
    mirrored = twice.format("-1 0 0 0 1 0 0 0 1 5 0 0")
    turned = '<item objectid="2" transform="0 1 0 -1 0 0 0 0 1 0 100 0"/>'
    part = read("3mf", threemf(f'<item objectid="1"/>{turned}', objects=mirrored))
    one, other = np.split(triangles(part), 2)
    np.testing.assert_allclose(one, BALL.triangles, atol=2e-6)
    x, y, z = np.moveaxis(BALL.triangles[:, ::-1], -1, 0)
    np.testing.assert_allclose(other, np.stack([-y, 105.0 - x, z], -1), atol=2e-5)
    with zipfile.ZipFile(io.BytesIO(threemf())) as archive:
        other_file = {"a.model": archive.read(MODEL).decode()}
    held = twice.replace('transform="{}"', 'xmlns:p="p" p:path="/a.model"')
    part = read("3mf", threemf('<item objectid="2"/>', objects=held, **other_file))
    np.testing.assert_allclose(triangles(part), BALL.triangles, atol=2e-6)


def test_a_damaged_3mf_file_is_refused(read):
    """Cut off, of another kind, without what it builds, or with objects that hold themselves."""
    inside = '<object id="2"><components>{}</components></object>'
    inside = inside.format('<component objectid="2"/>' * 2)
    box = trimesh.Trimesh(SQUARE, [[0, 1, 9]], process=False)
    for data, words in (
        (threemf()[:-40], "no sound ZIP archive"),
        (b"", "no sound ZIP archive"),
        (threemf().replace(b"PK\1\2", b"PK\0\0"), "no sound ZIP archive"),
        (threemf(encoding="UTF-9"), "no sound XML (unknown encoding: UTF-9)"),
        (threemf(unit="yard"), 'its unit is "yard"; 3MF has micron, millimeter'),
        (threemf(build=""), "builds no object"),
        (threemf('<item objectid="7"/>'), "an object 7 that is not there"),
        (threemf("<item/>"), "a <item> lacks its objectid"),
        (threemf('<item objectid="1" transform="1 0"/>'), "not of 12 finite numbers"),
        (threemf('<item objectid="2"/>', objects=inside), "hold one another too often"),
        (threemf("</build>"), "no sound XML"),
        (
            threemf(mesh=box),
            "its object 1 refers to a vertex that is not there, of 4",
        ),
        (threemf(model="other.model"), "no 3D/3dmodel.model in it"),
    ):
        with pytest.raises(vs.InputError) as refused:
            read("3mf", data)
        assert "part.3mf: " in str(refused.value)
        assert words in str(refused.value)


def test_a_file_of_another_kind_is_named(read):
    """Rationale: who gives a STEP file is told how to come by a mesh."""
    for data, words in (
        (
            b"ISO-10303-21;\nHEADER;",
            "no STL file but a STEP file; export it as STL or 3MF",
        ),
        (b"  0\r\nSECTION\r\n  2\r\nHEADER\r\n", "a DXF file"),
        (b" " * 72 + b"S      1\n", "an IGES file"),
        (ply(HALVES), 'a PLY file; say <shape type="ply">'),
        (threemf(), 'a ZIP archive, such as 3MF; say <shape type="3mf">'),
    ):
        with pytest.raises(vs.InputError, match=re.escape(words)):
            read("stl", data)
    for name, words in (
        ("a.STEP", "exact surfaces; export it as STL"),
        ("a.off", "stl, obj"),
    ):
        with pytest.raises(vs.InputError, match=words):
            check_kind(Path(name))
    assert check_kind(Path("a b.STL")) == "stl"


def test_what_programs_add_to_stl_and_obj_files_does_no_harm(read):
    """A byte order mark, CRLF, bytes at the end, colours of facets and vertices, free spacing."""
    for data in (
        *(b"\xef\xbb\xbf" + TEXT.encode(), TEXT.replace("\n", "\r\n"), TEXT.upper()),
        *((binary := stl(BOX.triangles)) + b"\r\n", binary[:-2] + b"\x1f\xfc"),
    ):
        np.testing.assert_allclose(triangles(read("stl", data)), BOX.triangles, atol=1e-6)
    coloured = "\tv 0 0 0 1 0 0\r\nv 1 0 0 1 0 0\r\nv  1 1\t0 1 0 0 # red\r\n f 1/ 2 3//\r\n"
    part = read("obj", b"\xef\xbb\xbf" + coloured.encode())
    np.testing.assert_array_equal(triangles(part), [[[0, 0, 0], [1, 0, 0], [1, 1, 0]]])
    assert not part.by_mitsuba


def test_no_ray_falls_through_an_edge_between_triangles(scene):
    """Rationale: the line lay along the middle of a plate, and a third of its rays were hidden."""
    plate = trimesh.creation.box((60, 40, 10)).subdivide().subdivide().subdivide()
    plate.apply_translation([0, 0, -5])
    surface = scene("stl", plate.export(file_type="stl")).surface
    origin = np.array([80.0, 0.0, 138.564])
    toward = np.stack(np.broadcast_arrays(0.0, np.linspace(-15, 15, 401), 0.0), -1) - origin
    away = np.linalg.norm(toward, axis=1)
    rays = to_vectors(np.broadcast_to(origin, toward.shape)), to_vectors(toward / away[:, None])
    np.testing.assert_allclose(np.array(surface.distance(*rays, 1e6, True)), away, atol=1e-3)
