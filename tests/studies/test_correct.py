"""Points corrected through air: beside the ray search, which knows where light met the part."""

import json
from dataclasses import replace

import numpy as np
import pytest
from typer.testing import CliRunner

from virtual_sensor.cli.commands import app
from virtual_sensor.errors import InputError
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.medium.air_model import AirModel
from virtual_sensor.metrology.calibration import (
    Calibration,
    Plane,
    calibration_of,
    calibration_text,
)
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.observations import Prior
from virtual_sensor.metrology.truth import rms
from virtual_sensor.optics.ray_search import ray_search
from virtual_sensor.poses import Pose
from virtual_sensor.records import write_csv, write_json
from virtual_sensor.studies.correct.asked import Settings, names_of, priors_of
from virtual_sensor.studies.correct.correct import _apart, _groups, correct, few_alike
from virtual_sensor.studies.correct.measured import (
    Measured,
    Scenes,
    given_parameters,
    read_centres,
    read_measured,
)
from virtual_sensor.studies.provenance import scene_facts

Y = np.linspace(-10.5, 10.5, 22)


def run(*arguments):
    return CliRunner().invoke(app, ["correct", *map(str, arguments)])


@pytest.fixture(scope="module")
def searched():
    """Where rays meet the hot cylinder, and the pixels that see it, by a search: for two poses."""
    found = {}
    for beta in (0, 30):
        scene = load_scene("hot_cylinder", beta=beta)
        found[beta] = scene, ray_search(scene, Y, "newton")
    return found


@pytest.fixture
def folder(tmp_path, searched):
    """A folder as `measure` writes it, of one of these poses."""

    def make(beta, name):
        scene, found = searched[beta]
        (tmp_path / name).mkdir()
        centres = {"column_px": found.pixel[:, 0], "row_px": found.pixel[:, 1]}
        centres |= {"sigma_px": np.full(len(Y), 0.02), "status": ["ok"] * len(Y)}
        write_csv(tmp_path / name / "line_hot.csv", centres)
        facts = {**scene_facts(scene, ()).to_dict(), "states": {"cold": {}, "hot": {}}}
        write_json(tmp_path / name / "summary.json", facts)
        return tmp_path / name

    return make


def test_searched_pixels_are_corrected_to_where_light_met_the_part(searched, folder):
    """The issue's line is 0.05 um; uncorrected they err by 255 um rms."""
    result = correct(read_measured([str(folder(0, "flat")), str(folder(30, "turned"))], Scenes()))
    for each, beta in zip(result.measurements, (0, 30), strict=True):
        true_mm = searched[beta][1].laser_point_mm
        assert 1e3 * np.abs(each.point_mm - true_mm).max() < 0.05
        np.testing.assert_allclose(each.distance_um, 0.0, atol=0.05)
    assert np.abs(result.measurements[0].distance_uncorrected_um).max() > 150
    assert abs(result.circle.radius_error_um) < 0.1 < abs(result.circle_uncorrected.radius_error_um)
    assert 0.1 < result.circle.interval_95_um < 1.0  # of the centres' noise, 0.02 px
    assert result.circle_uncorrected.interval_95_um is None
    assert "measurements, air from scene" in repr(result)
    assert any("--estimate" in note for note in result.notes)


def test_points_of_a_mesh_are_compared_with_it_in_space(tmp_path):
    """Rationale: in the laser's plane, which bent light leaves, true points were 19 um off."""
    scene = load_scene("stepped_shaft")
    found = ray_search(scene, Y, "newton")
    write_csv(tmp_path / "line.csv", {"u": found.pixel[:, 0], "v": found.pixel[:, 1]})
    given = read_measured([str(tmp_path / "line.csv")], Scenes("stepped_shaft"))
    (each,) = correct(given).measurements
    known = np.isfinite(each.distance_um)
    assert known.sum() > 0.8 * np.isfinite(found.pixel[:, 0]).sum()
    assert np.abs(each.distance_um[known]).max() < 0.01
    assert np.nanmax(np.abs(each.distance_uncorrected_um)) > 50


def test_the_covariance_is_that_of_points_of_noisy_pixels(tmp_path, searched):
    """Rationale: drawn noise, triangulated, is an independent way to the same numbers."""
    _, found = searched[0]
    draws = 300
    v = found.pixel[10, 1] + np.random.default_rng(3).normal(0, 0.5, draws)
    write_csv(tmp_path / "n.csv", {"u": np.full(draws, found.pixel[10, 0]), "v": v})
    write_csv(
        tmp_path / "one.csv",
        {"u": found.pixel[10:11, 0], "v": found.pixel[10:11, 1], "sigma": [0.5]},
    )
    both = [str(tmp_path / name) for name in ("n.csv", "one.csv")]
    noisy, one = correct(read_measured(both, Scenes("hot_cylinder"))).measurements
    drawn = np.cov(noisy.point_mm.T)
    scale = np.sqrt(np.diag(drawn))
    assert np.abs((one.covariance_mm2[0] - drawn) / np.outer(scale, scale)).max() < 0.25
    assert 0.8 < np.std(noisy.distance_um) / one.sigma_um[0] < 1.2
    # What is known of the air and of the pose only so well adds to it.
    priors = {"scale": Prior(1.0, 0.05), "camera_y": Prior(0.0, 0.01)}
    (measured,) = read_measured(both[1:], Scenes("hot_cylinder"))
    (doubtful,) = correct([measured], Settings(priors=priors)).measurements
    thicker = measured.scene.medium.with_nodes(
        measured.scene.medium.ambient
        + 1.05 * (measured.scene.medium.nodes - measured.scene.medium.ambient)
    )
    other = correct([replace(measured, scene=measured.scene.with_medium(thicker))]).measurements[0]
    moved = other.distance_um - one.distance_um
    np.testing.assert_allclose(doubtful.budget.sigma_um["air"], np.abs(moved), rtol=0.02)
    assert doubtful.sigma_um[0] > one.sigma_um[0]
    with pytest.raises(InputError, match="--prior"):
        correct([measured], Settings(priors={"nothing": Prior(0.0, 1.0)}))


def test_air_is_found_from_the_measurements(folder):
    """A frame of a burst, on the known part: the field itself is found again from another."""
    (flat,) = read_measured([str(folder(0, "flat"))], Scenes())
    model = AirModel.of(flat.scene.medium)
    thinner = flat.scene.with_medium(model.at(scale=0.9))
    frame = replace(flat, scene=thinner, one_of_many=True)
    told = []
    settings = Settings(estimate=("scale",), shape="part", priors={"scale": Prior(1.0, 0.2)})
    result = correct([frame], settings, lambda stage, part: told.append(part))
    assert result.estimate["scale"] == pytest.approx(1.0 / 0.9, abs=1e-4)
    assert rms(result.measurements[0].distance_um) < 0.05
    assert sorted(told) == told
    (facts,) = result.summary.to_dict()["estimates"]
    assert facts["measurements"] == ["flat"]
    assert facts["status"] == {"scale": "found"}
    assert facts["sigma_total"]["scale"] >= facts["sigma"]["scale"] > 0.0
    assert facts["priors"] == {"scale": {"value": 1.0, "sigma": 0.2}}


@pytest.mark.slow
def test_two_poses_give_the_radius_through_air_of_another_family(folder):
    """The issue's headline: 1250 degC, by the field of 1100 degC, scaled and widened: 2 um."""
    both = [str(folder(0, "flat")), str(folder(30, "turned"))]
    settings = Settings(
        medium="hot_cylinder_1100C_quarter", estimate=("scale", "width"), tolerance_px=1e-3
    )
    result = correct(read_measured(both, Scenes()), settings)
    assert abs(result.circle.radius_error_um) < 2.0
    assert result.air.origin == "estimate"
    assert not result.caveats
    for each in result.measurements:
        assert np.abs(each.distance_um).max() < 4.0
        assert np.abs(each.residual_px).max() < 0.2
        assert each.covariance_mm2.shape == (len(Y), 3, 3)
        within = np.abs(each.distance_um) < 2.0 * each.budget.total_um
        assert within.mean() > 0.9
    (facts,) = result.summary.to_dict()["estimates"]
    assert facts["measurements"] == ["flat", "turned"]
    assert facts["status"]["scale"] == "found"
    assert 1.05 < facts["values"]["scale"] < 1.12
    assert facts["sigma_total"]["radius_mm"] > facts["sigma"]["radius_mm"]
    # One pose alone errs by far more, and says so.
    alone = correct(read_measured(both[:1], Scenes()), settings)
    assert any("from one pose" in caveat for caveat in alone.caveats)


def test_each_kind_of_known_air_is_taken(folder):
    """What is said of the air holds for all; the family is exact where it has a field."""
    (flat,) = read_measured([str(folder(0, "flat"))], Scenes())
    own, hotter, other, between = (
        correct([flat], Settings(**kwargs))
        for kwargs in (
            {},
            {"temperature_c": 1250.0},
            {"medium": "hot_cylinder_1100C_quarter"},
            {"temperature_c": 1200.0},
        )
    )
    sure = correct([flat], Settings(priors={"scale": Prior(1.0, 0.05)}))
    told = ["taken for exact" in "".join(each.notes) for each in (own, hotter, other, sure)]
    assert told == [True, True, True, False]
    origins = [each.air.origin for each in (own, hotter, other, between)]
    assert origins == ["scene", "temperature", "medium", "temperature"]
    points = [each.measurements[0].point_mm for each in (own, hotter, other, between)]
    np.testing.assert_allclose(points[1], points[0], atol=1e-6)
    left = [rms(each.measurements[0].distance_um) for each in (own, between, other)]
    assert left[0] < 0.05 < left[1] < left[2] < 30.0
    (cold,) = read_measured([str(folder(0, "again"))], Scenes(given={"field": ""}))
    straight = correct([cold])
    assert any("nothing is to be corrected" in note for note in straight.notes)
    assert straight.air.origin == "none"
    np.testing.assert_allclose(straight.measurements[0].moved_um, 0.0, atol=1e-6)
    with pytest.raises(InputError, match="no air whose parameters"):
        correct([cold], Settings(estimate=("scale",)))


def test_a_calibration_takes_the_place_of_the_scenes_sensor(tmp_path, searched):
    """Rationale: a real sensor is never quite where the scene has it."""
    scene, found = searched[0]
    write_csv(tmp_path / "line.csv", {"u": found.pixel[:, 0], "v": found.pixel[:, 1]})
    real = calibration_of(scene.sensor)

    def written(name, calibration):
        (tmp_path / name).write_text(calibration_text(calibration, name))
        return read_measured([str(tmp_path / "line.csv")], Scenes("hot_cylinder"), tmp_path / name)

    (same,) = written("same.yaml", real)
    assert not [note for note in same.notes if "lie up to" in note]
    shift = Pose.shift([0.02, 0.03, -0.05])
    camera = real.camera.with_pose(real.camera.pose.moved(shift))
    normal, offset = real.laser.plane
    plane = Plane(-normal, -(offset + normal @ shift.origin_mm))  # another sign, the same plane
    (moved,) = written("moved.yaml", Calibration(camera, plane))
    assert any("lie up to" in note for note in moved.notes)
    # Pixels that the moved sensor would see of points that moved with it, but for the air.
    points = [correct([each]).measurements[0].point_mm for each in (same, moved)]
    np.testing.assert_allclose(points[1] - points[0], [shift.origin_mm] * len(Y), atol=5e-3)
    far = Calibration(real.camera.with_pose(real.camera.pose.moved(Pose.shift([0, 20, 0]))), plane)
    with pytest.raises(InputError, match="is not the calibration's: its points lie up to 20"):
        written("far.yaml", far)
    small = replace(real.camera, size=(1024, 768))
    with pytest.raises(InputError, match="the calibration is of 1024 x 768 px"):
        written("small.yaml", Calibration(small, plane))
    text = (tmp_path / "same.yaml").read_text()
    (tmp_path / "blind.yaml").write_text(text[: text.index("laser_plane")])
    with pytest.raises(InputError, match="lacks 'laser_plane'; add it"):
        read_measured([str(tmp_path / "line.csv")], Scenes("hot_cylinder"), tmp_path / "blind.yaml")


def test_what_cannot_be_corrected_is_refused_with_the_remedy(folder):
    """Fields that end before the light has left the air, and parameters that nothing tells."""
    (flat,) = read_measured([str(folder(0, "flat"))], Scenes())
    field = flat.scene.medium
    lower = field.nodes[:, :, : field.shape[2] // 2]
    short = field.with_nodes(lower)
    with pytest.raises(
        InputError, match=r"22 centres.*give a field that reaches further out.*camera's side, at"
    ):
        correct([replace(flat, scene=flat.scene.with_medium(short))])
    dots = replace(flat, along_mm=Y, normal_deg=np.full(len(Y), np.nan))
    for measured, kwargs, said in (
        (flat, {"shape": "none"}, "lines say nothing without a shape"),
        (flat, {"tolerance_px": -1.0}, "--tolerance is"),
        (flat, {"free": ("size",)}, "the shape has radius, y, z, turn_y, turn_z"),
        (
            flat,
            {"estimate": ("scale", "sensor_x", "camera_x")},
            r"can't tell .*--prior NAME=VALUE",
        ),
        (flat, {"estimate": ("scale", "hight")}, "did you mean 'height'"),
        (
            flat,
            {"estimate": ("temperature",), "medium": "hot_cylinder_1100C_quarter"},
            "leave out --medium",
        ),
        (dots, {"priors": {"width": Prior(1.0, 0.1)}}, "'width', which is not sought"),
    ):
        with pytest.raises(InputError, match=said):
            correct([measured], Settings(**({"estimate": ("scale",)} | kwargs)))
    for kwargs in ({"shape": "cone"}, {"free": ("y",)}, {"medium": "a.nc", "temperature_c": 900.0}):
        with pytest.raises(InputError, match=r"there are cylinder|say what is|choose one"):
            Settings(**kwargs)


def test_air_that_ends_a_little_early_is_told(folder, searched):
    """Cut at 160 mm above the part, where it has faded to a tenth of what is refused: 1 µm left."""
    scene, found = searched[0]
    field = scene.medium
    top = round((160.0 - field.origin[2]) / field.spacing[2]) + 1
    (measured,) = read_measured([str(folder(0, "flat"))], Scenes())
    for nodes, short in ((None, False), (top, True)):
        cut = field.with_nodes(field.nodes[:, :, :nodes])
        result = correct([replace(measured, scene=scene.with_medium(cut))])
        off_um = 1e3 * np.abs(result.measurements[0].point_mm - found.laser_point_mm).max()
        assert (off_um > 0.1) == short
        assert any("the field of the air is short" in each for each in result.caveats) == short


def test_points_off_the_part_and_notes_that_repeat_are_told(folder):
    turned = str(folder(30, "turned"))
    (far,) = read_measured([turned], Scenes())
    far = replace(far, pixel=far.pixel + np.array([0.0, 150.0]))  # of a sensor that was moved
    assert any("mm rms off the part" in caveat for caveat in correct([far]).caveats)
    assert few_alike(["a 1", "b", "a 2.5e-3", "b"]) == ["a 1 (and 1 more like this)", "b"]


def test_a_lens_in_hot_air_is_told(folder):
    (measured,) = read_measured([str(folder(30, "turned"))], Scenes())
    for f_number, told in (("", False), ("8", True)):
        scene = load_scene("hot_cylinder", beta=30, f_number=f_number)
        notes = correct([replace(measured, scene=scene)]).notes
        assert any("across the pupil" in note for note in notes) == told


def test_options_say_names_and_priors():
    assert names_of(" scale, width,scale,") == ("scale", "width")
    assert priors_of(["scale=1:0.05,width=1:.2", "offset=-1:2"]) == {
        "scale": Prior(1.0, 0.05),
        "width": Prior(1.0, 0.2),
        "offset": Prior(-1.0, 2.0),
    }
    for text in ("scale", "scale=1", "scale=1:0", "=1:2", "scale=a:b", "scale=1:2:3"):
        with pytest.raises(InputError, match=r"NAME=VALUE:SIGMA"):
            priors_of([text])


def test_folders_name_their_scene_and_may_be_changed(folder, searched):
    """What the folder says on its parameters holds, and -D on top has its usual effect."""
    turned = str(folder(30, "turned"))
    (as_it_was,) = read_measured([turned], Scenes())
    assert as_it_was.scene == searched[30][0]
    (colder,) = read_measured([turned], Scenes(given={"temperature": "1100"}))
    assert colder.scene == load_scene("hot_cylinder", beta=30, temperature=1100)
    (line,) = read_measured([f"{turned}/line_hot.csv"], Scenes())
    assert line.scene == searched[30][0]
    (other,) = read_measured([f"{turned}:beta=15"], Scenes())
    assert other.scene.parameters["beta"] == "15"
    path = searched[0][0].path
    for wanted in ({"width": "1024"}, {"pixel": "11"}, {"focal_length": "50"}, {"fov": "12"}, {}):
        used = load_scene(path, **wanted).parameters
        given = given_parameters(path, used)
        assert load_scene(path, **given).parameters == used
        assert len(given) == len(wanted)


def test_folders_of_several_pairs_and_of_detect_hold_several_measurements(tmp_path, folder):
    (tmp_path / "pairs").mkdir()
    for name in ("one", "other"):
        folder(0 if name == "one" else 30, f"pairs/{name}")
    write_json(tmp_path / "pairs/summary.json", {"pairs": {"one": {}, "other": {}}})
    found = read_measured([str(tmp_path / "pairs")], Scenes())
    assert [each.name for each in found] == ["one", "other"]
    assert [each.scene.parameters["beta"] for each in found] == ["0", "30"]
    (tmp_path / "found").mkdir()
    line = (tmp_path / "pairs/one/line_hot.csv").read_text()
    for name in ("shot.csv", "shot_2.csv"):
        (tmp_path / "found" / name).write_text(line)
    size = {"columns": 2048, "rows": 2048}
    write_json(tmp_path / "found/summary.json", {"images": {"shot": size, "shot_2": size}})
    found = read_measured([str(tmp_path / "found")], Scenes("hot_cylinder"), sigma_px=0.1)
    assert [each.name for each in found] == ["shot", "shot_2"]
    assert (found[0].sigma_px == 0.1).all()


@pytest.mark.parametrize(
    ("text", "u", "sigma"),
    [
        ("u,v\n1,2\n3,4\n", [1, 3], None),
        ("10 20\n11 21\n", [10, 11], None),
        ("# of a camera\n10;20;0.1\n11;21;0.2\n", [10, 11], [0.1, 0.2]),
        ("x [px];y [px];std\n1;2;0.3\n;;\nnan;4;0.1\n", [1, np.nan, np.nan], [0.3, np.nan, 0.1]),
        ("\ufeffrow,column\n2,1\n", [1], None),
        ("u;v;std\n1,5;2;0,3\n3;4;1e-9\n", [1.5, 3], [0.3, 1e-9]),
    ],
)
def test_tables_of_others_are_read(tmp_path, text, u, sigma):
    path = tmp_path / "line.csv"
    path.write_text(text, encoding="utf-8")
    columns = read_centres(path)
    np.testing.assert_array_equal(columns["u"], u)
    assert (sigma is None) == ("sigma" not in columns)
    np.testing.assert_array_equal(columns.get("sigma", sigma or 0), sigma or 0)
    (measured,) = read_measured([str(path)], Scenes("hot_cylinder"))
    assert ((measured.centre_status == Status.OK) == np.isfinite(u)).all()
    assert (measured.sigma_px >= 0.001).all()


def test_what_is_no_measurement_is_refused_with_the_remedy(tmp_path, folder):
    (tmp_path / "empty").mkdir()
    (tmp_path / "over").mkdir()
    folder(0, "over/one")
    (tmp_path / "other").mkdir()
    (tmp_path / "small").mkdir()
    (tmp_path / "other/summary.json").write_text("{}")
    (tmp_path / "broken").mkdir()
    (tmp_path / "broken/summary.json").write_text("{")
    for name, text in {
        "names.csv": "a,b\n1,2\n",
        "one.csv": "1\n2\n",
        "words.csv": "u,v\n1,two\n",
        "short.csv": "u,v\n1,2\n3\n",
        "status.csv": "u,v,status\n1,2,fine\n",
        "none.csv": "\n",
        "wide.csv": "u,v\n3,4\n3000,12\n",
        "small/1.csv": "u,v\n3,4\n",
        "small/summary.json": '{"images": {"1": {"columns": 640, "rows": 480}}}',
        "line.doc": "1,2",
    }.items():
        (tmp_path / name).write_text(text)
    for name, said in {
        "gone": "can't be read",
        "gone.csv:beta=3": "gone.csv: can't be read",
        "empty": "holds no results",
        "over": "give those within it: one",
        "other": "results of another kind",
        "broken": "summary.json: can't be read",
        "names.csv": "name those of the line's centres u and v",
        "one.csv": "one column",
        "words.csv": r"line 2: 'two' is no number",
        "short.csv": "line 3: has too few columns",
        "status.csv": "knows a status 'fine'",
        "none.csv": "is empty",
        "wide.csv": r"\(3000, 12\) lies beside the camera",
        "small": r"1.csv: is of 640 x 480 px, but the camera .* has 2048 x 2048",
        "line.doc": "is no measurement",
    }.items():
        with pytest.raises(InputError, match=said):
            read_measured([str(tmp_path / name)], Scenes("hot_cylinder"))
    (tmp_path / "good.csv").write_text("1,2\n")
    with pytest.raises(InputError, match="--scene"):
        read_measured([str(tmp_path / "good.csv")], Scenes())


def test_a_wall_temperature_may_be_known_within_limits(folder):
    """Its sigma is what other temperatures do to the points: 50 K, by differences."""
    given = read_measured([str(folder(0, "flat"))], Scenes())
    known = {"temperature": Prior(1200.0, 50.0)}
    here = correct(given, Settings(temperature_c=1200.0, priors=known)).measurements[0]
    there = correct(given, Settings(temperature_c=1250.0)).measurements[0]
    bare = correct(given, Settings(temperature_c=1200.0)).measurements[0]
    by_air = np.sqrt(here.sigma_um**2 - bare.sigma_um**2)
    moved = np.abs(there.distance_um - here.distance_um)
    assert np.median(np.abs(by_air - moved)) < 0.1 * moved.max()


def test_measurements_in_several_kinds_of_air_are_told(folder):
    """Rationale: each was estimated by itself without a word, where two poses were meant."""
    given = [str(folder(0, "flat")), f"{folder(30, 'turned')}:widen=1.1"]
    (caveat,) = _apart(_groups(read_measured(given, Scenes()), True))
    assert "2 kinds of air (flat; turned)" in caveat
    assert not _apart(_groups(read_measured(given[:1] * 2, Scenes()), True))


def test_measurements_that_do_not_go_together_are_refused_or_told(folder):
    """Rationale: they were fitted all the same, with standard deviations of a hundredth."""
    hot, turned = str(folder(0, "flat")), str(folder(30, "turned"))
    settings = Settings(medium="hot_cylinder_1100C_quarter", estimate=("scale",))
    twice = read_measured([hot, hot], Scenes())
    with pytest.raises(InputError, match="flat_2: holds the very centres of flat"):
        correct(twice, settings)
    both = read_measured([hot, turned], Scenes())
    other = replace(both[1], scene=load_scene("stepped_shaft"))
    with pytest.raises(InputError, match=r"turned: is of another part .*, and an estimate is of"):
        correct([both[0], other], settings)
    (cold,) = read_measured([turned], Scenes("cold_cylinder", {"beta": "30"}))
    known = replace(settings, estimate=())
    told = [note for note in correct([both[0], cold], known).caveats if "runs straight" in note]
    assert [note.partition(":")[0] for note in told] == ["turned"]
    assert not any("runs straight" in note for note in correct([cold], known).caveats)


def test_air_that_is_not_of_the_part_is_told(folder):
    """Rationale: a cylinder's field corrected a bracket, without the note that `measure` has."""
    (flat,) = read_measured([str(folder(0, "flat"))], Scenes())
    assert not any("not of this part" in note for note in correct([flat]).notes)
    moved = flat.scene.medium.moved(Pose.shift([0.0, 0.0, -20.0]))
    result = correct([replace(flat, scene=flat.scene.with_medium(moved))])
    assert any("the given air is not of this part" in note for note in result.notes)


def test_dots_of_one_pose_that_find_the_air_are_told():
    """Of 1250 degC by the field of 1100 degC: the residual is 1e-6 px, the radius 47 um off."""
    scene = load_scene("hot_cylinder")
    y = np.linspace(-8.0, 8.0, 5)
    found = ray_search(scene, y, "newton")
    dots = Measured(
        *("dots", scene, found.pixel, np.full(5, 0.02), np.full(5, np.nan)),
        *(np.full(5, Status.OK, np.uint8), y),
        one_of_many=True,  # whose budget is quick
    )
    settings = Settings(medium="hot_cylinder_1100C_quarter", estimate=("scale", "width"))
    result = correct([dots], settings)
    assert rms(result.measurements[0].residual_px) < 0.001
    assert abs(result.circle.radius_error_um) > 20.0
    assert any("dots of one pose" in caveat for caveat in result.caveats)


def test_decimal_commas_between_commas_are_refused(tmp_path):
    """Rationale: u 538,0 and v 1278,02 were read as u = 538 and v = 0."""
    (tmp_path / "line.csv").write_text("u,v\n538,0,1278,02\n")
    with pytest.raises(InputError, match="line 2: has 4 columns, and the first line 2; put semi"):
        read_centres(tmp_path / "line.csv")
    (tmp_path / "line.csv").write_text("u,v,\n538,1278.02,\n")  # a comma at the end is none
    assert read_centres(tmp_path / "line.csv")["v"] == [1278.02]


def test_a_given_sigma_is_taken_without_a_note_that_it_is_missing(tmp_path):
    (tmp_path / "line.csv").write_text("u,v\n1,2\n2,2\n")
    for sigma_px, taken, notes in ((None, 0.02, 1), (0.05, 0.05, 0)):
        (line,) = read_measured(
            [str(tmp_path / "line.csv")], Scenes("hot_cylinder"), sigma_px=sigma_px
        )
        np.testing.assert_array_equal(line.sigma_px, taken)
        assert len(line.notes) == notes


def test_the_command_writes_points_and_says_how_far_they_moved(tmp_path, folder):
    flat, out = folder(0, "flat"), tmp_path / "out"
    ended = run(flat, "-o", out)
    assert ended.exit_code == 0, ended.output
    figures = json.loads((out / "summary.json").read_text())
    assert figures["measurements"]["flat"]["distance"]["rms_um"] < 0.05
    assert figures["measurements"]["flat"]["distance_uncorrected"]["rms_um"] > 100
    assert run(flat, "-o", out).exit_code != 0  # nothing is overwritten
    line = (flat / "line_hot.csv").read_bytes()
    for given in (flat, f"{flat}:beta=0", flat / "line_hot.csv"):  # which it would replace
        assert "name another folder" in str(run(given, "-o", flat, "--overwrite").exception)
        assert (flat / "line_hot.csv").read_bytes() == line
    (tmp_path / "away.csv").write_text("u,v\n,\n")
    ended = run(tmp_path / "away.csv", "--scene", "hot_cylinder", "-o", tmp_path / "none")
    assert ended.exit_code == 3
    assert "away: holds no centre (no_peak 1)" in " ".join(ended.output.split())
