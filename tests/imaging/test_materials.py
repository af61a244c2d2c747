"""Materials of scenes, which are Mitsuba's own BSDFs, and the parts that shine most."""

import pickle
from pathlib import Path

import numpy as np
import pytest
from image_makers import write_exr
from virtual_sensor_scenes import make_bearing_ring as bearing_ring
from virtual_sensor_scenes import make_v_groove as v_groove

import virtual_sensor as vs
from virtual_sensor.engine import dr, mi
from virtual_sensor.imaging.checks import SeenSurface, check_scene
from virtual_sensor.imaging.materials import installed_materials, material_words
from virtual_sensor.imaging.scene_file import parameter_words, shipped_scenes

SMALL = {"width": 64, "height": 64, "spp": 1}


def bsdf_of(scene):
    """The BSDF of a scene's part."""
    return next(shape.bsdf() for shape in scene.mitsuba.shapes() if shape.id() == "part")


def ggx(cosine, alpha):
    """Density of the normals of GGX (Walter et al. 2007, equation 33)."""
    return alpha**2 / (np.pi * ((alpha**2 - 1.0) * cosine**2 + 1.0) ** 2)


@pytest.mark.parametrize(("roughness", "fraction"), [(0.1, 1 / 660), (0.3, 1 / 12)])
def test_ground_steel_has_the_normals_of_ggx(roughness, fraction):
    """Rationale: where light comes back to where it came from, the half vector is its direction.

    Seen from 30 degrees off the normal and from the normal, the values of the BSDF differ as the
    density of normals does, but for Smith's masking, which is known.
    """
    density = ggx(np.cos(np.radians(30.0)), roughness) / ggx(1.0, roughness)
    assert density == pytest.approx(fraction, rel=0.05)
    scene = vs.load_scene("v_groove", material="ground_steel", roughness=roughness, **SMALL)
    wi = mi.Vector3f([0.0, 0.5], [0.0, 0.0], [1.0, np.sqrt(0.75)])
    si = mi.SurfaceInteraction3f()
    si.wi = wi
    straight, slanted = np.ravel(bsdf_of(scene).eval(mi.BSDFContext(), si, wi))
    shadow = 2.0 / (1.0 + np.sqrt(1.0 + roughness**2 * np.tan(np.radians(30.0)) ** 2))
    expected = density * shadow**2 / np.cos(np.radians(30.0))  # D G / 4 cos, of equal directions
    assert slanted / straight == pytest.approx(expected, rel=1e-4)
    n, k = 2.895, 2.918  # Johnson and Christy (1974) at 521 and 549 nm, in between
    mirror = ((n - 1) ** 2 + k**2) / ((n + 1) ** 2 + k**2)
    assert straight == pytest.approx(mirror * ggx(1.0, roughness) / 4.0, rel=0.01)


def test_iron_is_as_it_is_at_the_wavelength():
    """Rationale: the BSDF is of one wavelength, the laser's; Johnson and Christy (1974), table."""
    metal = {"material": "ground_steel", **SMALL}
    for wavelength, n, k in ((451, 2.59, 2.77), (659, 2.92, 3.10)):
        scene = vs.load_scene("v_groove", wavelength=wavelength, **metal)
        held = mi.traverse(bsdf_of(scene))
        assert np.ravel([held["eta.value"], held["k.value"]]) == pytest.approx([n, k], rel=1e-6)
    own = vs.load_scene("v_groove", wavelength=3000, iron_n=4, iron_k=9, **metal)
    assert own.parameters["iron_k"] == "9"
    with pytest.raises(vs.InputError, match="known from 188 to 1937 nm; give iron_n and iron_k"):
        vs.load_scene("v_groove", wavelength=3000, **metal)


def test_a_material_is_any_bsdf_in_a_file(tmp_path, monkeypatch):
    """Whatever its id is, with its texture beside it; and the scene is the same when unpickled."""
    monkeypatch.chdir(tmp_path)
    write_exr(Path("halves.exr"), {"Y": np.array([[0.2, 0.8]], np.float32)})
    texture = '<string name="filename" value="halves.exr"/><boolean name="raw" value="true"/>'
    texture = f'<texture type="bitmap" name="reflectance">{texture}</texture>'
    wood = f'<bsdf version="3.0.0" type="diffuse" id="wood">{texture}</bsdf>'
    Path("wood.xml").write_text(wood, encoding="utf-8")
    scene = vs.load_scene("v_groove", material="wood.xml", **SMALL)
    si = mi.SurfaceInteraction3f()
    si.uv, si.wi = mi.Point2f([0.25, 0.75], 0.5), mi.Vector3f(0.0, 0.0, 1.0)
    seen = np.ravel(bsdf_of(scene).eval_diffuse_reflectance(si))
    np.testing.assert_allclose(seen, [0.2, 0.8], rtol=1e-3)
    assert pickle.loads(pickle.dumps(scene)) == scene
    path = vs.new_scene("scenes/mine", material="wood.xml")
    copied = {f.relative_to("scenes").as_posix() for f in Path("scenes").rglob("*") if f.is_file()}
    assert copied == {"mine.xml", "materials/wood.xml", "materials/halves.exr"}
    again = vs.new_scene("other/mine", from_scene=path)
    assert vs.load_scene(again).parameters["material"] == "wood"


def test_mitsuba_reads_files_with_a_second_thread(monkeypatch):
    """Rationale: a lone thread waits for ever where a texture is an OpenEXR file."""
    instantiate, threads, seen = mi.parser.instantiate, dr.thread_count(), []

    def counted(*given):
        seen.append(dr.thread_count())
        return instantiate(*given)

    monkeypatch.setattr(mi.parser, "instantiate", counted)
    try:
        for number in (1, 3):
            dr.set_thread_count(number)
            vs.load_scene("v_groove", **SMALL)
            assert dr.thread_count() == number
    finally:
        dr.set_thread_count(threads)
    assert seen == [2, 3]


REFUSED = {
    "": ("ground", "installed materials: .*did you mean ground_steel"),
    '<scene version="3.0.0"><emitter type="constant"/></scene>': ("own.xml", "<emitter> in the fi"),
    '<scene version="3.0.0"/>': ("own.xml", "no <bsdf>; add it"),
    '<shape type="sphere"/>': ("own.xml", "own.xml, line 1: <shape> in the file of a material"),
    "<bsdf": ("own.xml", "own.xml: not well-formed"),
    '<bsdf type="diffuse"/>': ("own.xml", 'own.xml, line 1: .* give it version="3.0.0"'),
    '<scene version="3.0.0"><bsdf type="diffuse"/><bsdf type="plastic"/></scene>': (
        *("own.xml", '2 <bsdf> elements; give the one that is the material id="steel"'),
    ),
    '<bsdf version="3.0.0" type="diffuse" id="laser"/>': ("own.xml", 'the id "laser"; give one an'),
}


def test_what_is_no_material_is_refused(tmp_path, monkeypatch):
    """Naming the file and the remedy; and a parameter that another material has."""
    monkeypatch.chdir(tmp_path)
    for text, (name, words) in REFUSED.items():
        Path("own.xml").write_text(text, encoding="utf-8")
        with pytest.raises(vs.InputError, match=words):
            vs.load_scene("v_groove", material=name, **SMALL)
    with pytest.raises(vs.InputError, match=r"materials that have it: .*ground_steel"):
        vs.load_scene("v_groove", roughness=0.2, **SMALL)
    for material, wrong, words in (
        (
            "ground_steel",
            {"roughness": 0},
            r"ground_steel.xml, line 8: .*alpha_u is 0; give a roughness above 0",
        ),
        ("turned_steel", {"roughness": -0.2}, r"alpha_v is -0\.2; give a roughness above 0"),
        ("diffuse", {"reflectance": 2}, "reflectance is 2; give a share from 0 to 1"),
    ):
        with pytest.raises(vs.InputError, match=words):
            vs.load_scene("v_groove", material=material, **wrong, **SMALL)
    with pytest.raises(vs.InputError, match=r"--roughness 0\.2: the material diffuse has none"):
        vs.new_scene("mine", material="diffuse", roughness=0.2)


def test_every_material_is_shown_on_every_part():
    """Rationale: a file that nobody loads may be wrong; light comes back from each."""
    for material in installed_materials():
        for name in ("cold_cylinder", "v_groove"):
            scene = vs.load_scene(name, material=material.stem, **SMALL)
            seen = SeenSurface.of(scene, np.array([[0.0, 0.0, -8.0 * (name == "v_groove")]]), [0.0])
            assert seen.sent[0] > 0.0, material
            assert material_words().keys() >= set(parameter_words(material))


@pytest.mark.parametrize(("roughness", "along"), [(0.3, 0.1), (0.2, 0.2)])
def test_the_lay_of_turned_steel_runs_round_the_part(roughness, along):
    """A half vector tilted along u meets the smaller alpha: GGX, anisotropic (Heitz 2014)."""
    tilt = np.radians(20.0)
    sine = float(np.sin(tilt))
    for name in ("cold_cylinder", "stepped_shaft"):
        scene = vs.load_scene(
            *(name,), material="turned_steel", roughness=roughness, roughness_along=along, **SMALL
        )
        si = scene.mitsuba.ray_intersect(mi.Ray3f([0.0, 0.0, 100.0], [0.0, 0.0, -1.0]))
        values = []
        for world in ([0.0, sine], [sine, 0.0]):  # round the part, along it
            si.wi = si.to_local(mi.Vector3f([*world, float(np.cos(tilt))]))
            values.append(np.ravel(si.bsdf().eval(mi.BSDFContext(), si, si.wi))[0])
        slope = np.tan(tilt) ** 2
        terms = [
            (1.0 + slope / a**2) ** -2 / (1 + np.sqrt(1 + a**2 * slope)) ** 2
            for a in (along, roughness)
        ]  # D and Smith's G of equal directions
        assert values[0] / values[1] == pytest.approx(terms[0] / terms[1], rel=1e-3)


@pytest.mark.parametrize("name", ["turned", "rolled", "ground", "blasted", "polished"])
def test_along_the_lay_the_roughness_is_that_along_it(name):
    """Of microfacets: u is along the lay, v across it."""
    parameters = {"roughness": 0.31, "roughness_along": 0.13, **SMALL}
    held = mi.traverse(bsdf_of(vs.load_scene("v_groove", material=f"{name}_steel", **parameters)))
    alpha = [np.ravel(held[f"alpha_{axis}.value"])[0] for axis in "uv"]
    assert alpha == pytest.approx([0.13, 0.31], rel=1e-6)


OF_THE_PART = {"u_mm", "v_mm", "u_0", "v_0"}  # which it says itself


@pytest.mark.parametrize("path", installed_materials(), ids=lambda path: path.stem)
def test_each_parameter_of_a_material_changes_how_it_reflects(path):
    """Somewhere on the part, and in some direction."""
    rng = np.random.default_rng(0)
    si = mi.SurfaceInteraction3f()
    si.uv = mi.Point2f(rng.uniform(-9.0, 9.0, (2, 4000)))
    wi, wo = ([*rng.uniform(-0.4, 0.4, (2, 4000)), np.full(4000, 0.9)] for _ in range(2))
    si.wi = mi.Vector3f(wi)

    def seen(**parameters):
        scene = vs.load_scene("v_groove", material=path.stem, **parameters, **SMALL)
        return np.ravel(bsdf_of(scene).eval(mi.BSDFContext(), si, mi.Vector3f(wo)))

    usual = seen()
    for name in parameter_words(path).keys() - OF_THE_PART:
        assert np.abs(seen(**{name: 0.37}) - usual).max() > 1e-3 * usual.max(), name


def test_a_mesh_without_texture_coordinates_has_its_lay_along_x(tmp_path):
    """Rationale: Mitsuba takes any tangent there, another one on each triangle."""
    path = vs.new_scene(tmp_path / "mine", part="bracket.stl", material="turned_steel")
    scene, plain = (vs.load_scene(path, material=m, **SMALL) for m in ("turned_steel", "diffuse"))
    assert "its material is laid on along the axes, in mm, the lay" in " ".join(scene.notes)
    assert plain.notes == ()
    origins = mi.Point3f([5.0, 5.0, 0.0], [5.0, 12.0, -60.0], [60.0, 60.0, 3.0])
    si = scene.mitsuba.ray_intersect(mi.Ray3f(origins, [[0, 0, 0], [0, 0, 1], [-1, -1, 0]]))
    np.testing.assert_allclose(np.transpose(si.p)[:, 2] > 0, True)
    np.testing.assert_allclose(np.abs(np.transpose(si.sh_frame.s)[:, 0]), 1.0, atol=0.01)
    np.testing.assert_allclose(np.transpose(si.uv)[:2], [[5, 5], [5, 12]], atol=1e-4)


def test_a_painted_edge_shifts_the_centroid_by_the_formula():
    """By sigma sqrt(2/pi) (1-r)/(1+r) where it runs through the line's middle, towards the bright.

    The camera's pixels average over their width, which leaves a hundredth of a pixel.
    """
    scene = {"width": 512, "height": 512, "line_radius": 1.0, "spp": 16}
    column, row = 255, np.arange(512)
    plain = vs.render(vs.load_scene("cold_cylinder", **scene))[:, column]
    middle = np.average(row, weights=plain)
    sigma = 0.5 / (45.056 / 512)  # mm across the sheet, which the camera sees alike, to px
    assert np.sqrt(np.average((row - middle) ** 2, weights=plain)) == pytest.approx(sigma, rel=0.02)
    for dark, angle, sign in ((0.05, 0, -1), (0.25, 0, -1), (0.05, 180, 1)):
        paint = {"material": "painted_edge", "dark_reflectance": dark, "edge_angle": angle}
        edge = vs.render(vs.load_scene("cold_cylinder", **paint, **scene))[:, column]
        r = dark / 0.5
        shift = np.average(row, weights=edge) - middle
        expected = sign * sigma * np.sqrt(2.0 / np.pi) * (1.0 - r) / (1.0 + r)
        assert shift == pytest.approx(expected, abs=0.02)
        assert abs(shift) > 0.5


def test_a_metal_by_name_is_told_to_be_of_all_light(tmp_path):
    """Rationale: in light of one wavelength Mitsuba averages its tables over the visible."""
    copper = (
        '<bsdf version="3.0.0" type="roughconductor"><string name="material" value="Cu"/></bsdf>'
    )
    (tmp_path / "copper.xml").write_text(copper, encoding="utf-8")
    scene = vs.load_scene("v_groove", material=tmp_path / "copper.xml", **SMALL)
    assert "n and k of Cu are taken as means of all visible light" in scene.notes[0]


def test_a_mirroring_metal_is_told():
    """A smooth round part loses the ends of its line, a dull one does not."""
    for roughness, told in ((0.05, 1), (0.5, 0)):
        scene = vs.load_scene(
            "cold_cylinder", material="ground_steel", roughness=roughness, **SMALL
        )
        notes = [note for note in check_scene(scene) if "mirrors it past the camera" in note]
        assert len(notes) == told


@pytest.mark.parametrize(
    ("mesh", "name", "volume"),
    [
        (v_groove.extruded(v_groove.profile()), "v_groove", 80.0 * (60.0 * 12.0 - 8.0**2)),
        (bearing_ring.revolved(), "bearing_ring", 20_327.7),
    ],
)
def test_meshes_are_closed_and_what_their_scripts_make(mesh, name, volume):
    """Each edge has two triangles that run along it in opposite directions, normals outward.

    The ring's volume is that of Pappus, less that of its coarse facets.
    """
    vertices, faces = mesh
    _, same = np.unique(np.round(vertices[:, :3], 4), axis=0, return_inverse=True)
    corners = same.ravel()[faces]
    edges = np.concatenate([corners[:, [i, (i + 1) % 3]] for i in range(3)])
    there = set(map(tuple, edges.tolist()))
    assert len(there) == len(edges)
    assert there == {(end, start) for start, end in there}
    a, b, c = (vertices[faces[:, i], :3].astype(float) for i in range(3))
    outward = np.cross(b - a, c - a)
    assert np.all(np.einsum("ij,ij->i", outward, vertices[faces[:, 0], 3:6]) > 0.0)
    assert np.einsum("ij,ij->", a, np.cross(b, c)) / 6.0 == pytest.approx(volume, rel=1e-3)
    file = shipped_scenes() / "meshes" / f"{name}.ply"
    held = mi.traverse(mi.load_dict({"type": "ply", "filename": str(file)}))
    np.testing.assert_array_equal(np.ravel(held["faces"]), faces.ravel())
    for part, columns in (("positions", slice(3)), ("texcoords", slice(6, 8))):
        values = np.reshape(held[f"vertex_{part}"], (len(vertices), -1))
        np.testing.assert_allclose(values, vertices[:, columns], atol=1e-5)


def test_the_line_is_seen_all_along_groove_and_raceway():
    """On walls at 45 degrees and the plates beside them; on a circle and its shoulders."""
    y = np.linspace(-10.9, 10.9, 41)
    middle = 27.0 + 6.6 - 30.0  # of the raceway's circle, in z
    raceway = middle - np.sqrt(np.maximum(6.6**2 - y**2, middle**2))
    for name, z in (("v_groove", np.minimum(np.abs(y) - 8.0, 0.0)), ("bearing_ring", raceway)):
        scene = vs.load_scene(name, **SMALL)
        assert scene.notes == ()
        on = np.abs(y) < (8.9 if name == "bearing_ring" else 11.0)
        found = vs.ray_search(scene, y[on], "newton")
        assert np.all(found.status == vs.SearchStatus.FOUND)
        np.testing.assert_allclose(found.laser_point_mm[:, 2], z[on], atol=1e-3)
