"""What a newcomer gives to the public functions works, or is told in a sentence with its name."""

import inspect
import re
from pathlib import Path

import numpy as np
import pandas
import pytest

import virtual_sensor as vs

NAN = float("nan")
WORDS = ["", "abc", "no such/file ä.xml", b"abc", Path("abc"), np.array(["a"]), ["1", "2"]]
THINGS = [None, object(), {}, {"a": 1}, slice(3), range(3), np.array([{}, []], object), [None, 1]]
NUMBERS = [True, 0, 5, -1, 1.5, NAN, float("inf"), 10**30, 1j, np.float32(2.5), np.int64(3)]
LISTS = [[], (), [[]], [1], [1, 2], (0.5, -5), [1, 2, 3], [[1, 2], [3]], [[1, 2, 3]]]
ARRAYS = [
    *map(np.zeros, [0, (0, 2), (0, 3), (5, 2), (2, 2, 3)]),
    np.zeros((4, 3), np.float16),
    np.full((3, 3), NAN),
    np.ones((3, 4), complex),
    np.array(2.0),
    np.eye(4),
    np.ma.masked_equal(np.eye(3), 0.0),
    pandas.Series([1.0, 2.0]),
    pandas.DataFrame({"u": [1.0], "v": [2.0]}),
]
IMAGES = [np.full((6, 8), 1, kind) for kind in (bool, np.uint8, np.int32, np.uint64, np.float16)]
GIVEN = [*WORDS, *THINGS, *NUMBERS, *LISTS, *ARRAYS, *IMAGES, -np.ones((6, 8))]
LENS = vs.Lens(75.0, 300.0, 3.75)
SCENE = vs.load_scene("hot_cylinder", width=64, height=64, spp=1)
PROJECTED = vs.load_scene("fringe_cylinder", width=64, height=64)
FRINGES = vs.load_scene("fringe_cylinder", width=16, height=16, spp=1).cold()
LINE = np.repeat(np.exp(-((np.arange(24.0)[:, None] - 11.3) ** 2) / 8.0), 16, 1)
CENTRES = vs.line_centres(LINE)
FIELD = vs.IndexField.from_arrays(np.full((5, 5, 5), 2e-4), [-20, -20, -20], [10, 10, 10])
POSE = vs.Pose(np.eye(3), np.zeros(3))
SENSOR = vs.image_sensor("cmos_5um5")
ARC = np.array([[x, np.sin(a), np.cos(a)] for x in (0, 1, 2) for a in (0.0, 0.4, 0.8)])
ESTIMATE = {
    "observations": vs.Observation(SCENE, [[20.0, 30.0], [40.0, 30.0], [30.0, 31.0]]),
    "names": (),
    "shape": vs.CylinderShape(),
}
V, U = np.mgrid[:64.0, :64.0]
MAPS = [400.0 + 8.0 * U, 200.0 + 8.0 * V, *[np.full((64, 64), 0.1, np.float32)] * 4]
DECODED = vs.DecodedFringes(
    *MAPS, phase={}, status=np.zeros((64, 64), np.uint8), size_px=(1280, 800)
)
PLATE = vs.CalibrationTarget(columns=4, rows=4)
TILTED = [vs.Pose.turn(25.0, (np.cos(k), np.sin(k), 0.2 * k)) for k in range(5)]
SEEN = SCENE.camera.with_pose(vs.Pose.shift((0.0, 0.0, -300.0)))
CALIBRATION = {
    "target_mm": PLATE.points_mm,
    "camera_px": [SEEN.project(pose.to_world(PLATE.points_mm)) for pose in TILTED],
    "projector_px": [SEEN.project(pose.to_world(PLATE.points_mm)) for pose in TILTED],
    "camera_size": (64, 64),
    "projector_size": (64, 48),
    "distortion": 0,
}
TETRAHEDRON = "v 0 0 0\nv 9 0 0\nv 0 9 0\nv 0 0 9\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
SHOT = vs.record(SCENE, np.ones((64, 64)))
CALLS = {
    "load_scene": (vs.load_scene, {"name": "hot_cylinder"}),
    "render": (vs.render, {"scene": SCENE}),
    "render_frame": (vs.render_frame, {"scene": SCENE}),
    "render_exposure": (vs.render_exposure, {"scene": SCENE, "exposure_s": 1e-3}),
    "render_sequence": (vs.render_sequence, {"scene": FRINGES, "patterns": ["white"]}),
    "grey_values": (vs.grey_values, {"photons": 100.0 * LINE}),
    "record": (vs.record, {"scene": SCENE, "frame": np.ones((64, 64))}),
    "difference": (vs.difference, {"on": SHOT, "off": SHOT}),
    "gaussian_blur": (vs.gaussian_blur, {"image": LINE, "sigma_px": 1.0}),
    "diffraction_blur": (
        vs.diffraction_blur,
        {"image": LINE, "aperture": vs.Aperture(f_number=8.0)},
    ),
    "speckled": (vs.speckled, {"image": LINE, "aperture": vs.Aperture(f_number=8.0)}),
    "save_png": (vs.save_png, {"image": LINE, "path": "a.png"}),
    "save_tiff": (vs.save_tiff, {"image": LINE, "path": "a.tif"}),
    "read_image": (vs.read_image, {"path": "line.png"}),
    "survey": (vs.survey, {"path": "part.obj"}),
    "line_centres": (vs.line_centres, {"image": LINE}),
    "lines_by_source": (vs.lines_by_source, {"scene": SCENE, "image": np.ones((64, 64))}),
    "dot_centres": (vs.dot_centres, {"image": LINE}),
    "triangulate": (vs.triangulate, {"sensor": SCENE, "pixel": [[30.0, 30.0]]}),
    "triangulated_points": (vs.triangulated_points, {"sensor": SCENE, "pixel": [[30.0, 30.0]]}),
    "bent_points": (vs.bent_points, {"scene": SCENE, "pixel": [[30.0, 30.0]]}),
    "fit_shape": (vs.fit_shape, {"points_mm": ARC, "direction": [1, 0, 0]}),
    "fit_cylinder": (vs.fit_cylinder, {"points_mm": ARC, "direction": [1, 0, 0]}),
    "estimate_air": (vs.estimate_air, ESTIMATE),
    "identifiability": (vs.identifiability, ESTIMATE),
    "error_budget": (
        vs.error_budget,
        {"estimate": vs.estimate_air(**ESTIMATE), "sigmas": {"sensor_x": 0.01}},
    ),
    "known_air_budget": (
        vs.known_air_budget,
        {"observation": ESTIMATE["observations"], "sigmas": {"sensor_x": 0.01}},
    ),
    "Observation": (vs.Observation, {"scene": SCENE, "pixel": [[20.0, 30.0]]}),
    "fringe_observation": (vs.fringe_observation, {"scene": PROJECTED, "decoded": DECODED}),
    "Prior": (vs.Prior, {"value": 1.0, "sigma": 1.0}),
    "compare_line": (vs.compare_line, {"line": CENTRES, "truth": np.full(16, 11.3)}),
    "read_calibration": (vs.read_calibration, {"path": "no.yaml"}),
    "ray_search": (vs.ray_search, {"scene": SCENE, "laser_y_mm": [0.0], "method": "newton"}),
    "pupil_search": (
        vs.pupil_search,
        {"scene": SCENE, "laser_y_mm": [0.0], "lens": LENS, "points": 2},
    ),
    "circle_of_confusion_px": (
        vs.circle_of_confusion_px,
        {"scene": SCENE, "points_mm": [[0.0, 0.0, 0.0]], "lens": LENS},
    ),
    "Lens": (
        vs.Lens,
        {"image_distance_mm": 75.0, "focus_distance_mm": 300.0, "pupil_radius_mm": 3.75},
    ),
    "pattern_of": (vs.pattern_of, {"text": "sine u 16"}),
    "Uniform": (vs.Uniform, {}),
    "Sine": (vs.Sine, {"axis": "u", "period_px": 16}),
    "GrayBit": (vs.GrayBit, {"axis": "u", "bit": 3}),
    "Checker": (vs.Checker, {"square_px": 16}),
    "Stripe": (vs.Stripe, {"axis": "u", "middle_px": 16, "width_px": 2}),
    "Picture": (vs.Picture, {"values": np.eye(4)}),
    "Projector": (vs.Projector, {"family": SCENE.camera}),
    "codec_of": (vs.codec_of, {"text": "phase 4"}),
    "CalibrationTarget": (vs.CalibrationTarget, {}),
    "find_marks": (vs.find_marks, {"image": LINE, "target": vs.CalibrationTarget()}),
    "projector_marks": (
        vs.projector_marks,
        {
            "marks": vs.find_marks(LINE, vs.CalibrationTarget()),
            "target": vs.CalibrationTarget(),
            "column": MAPS[0],
            "row": MAPS[1],
        },
    ),
    "calibrate_fringes": (vs.calibrate_fringes, CALIBRATION),
    "PhaseShift": (vs.PhaseShift, {"size_px": (64, 48)}),
    "PhaseShift.decode": (vs.PhaseShift(axes="u", steps=3).decode, {"images": np.ones((9, 4, 5))}),
    "GrayCode": (vs.GrayCode, {}),
    "SingleShot": (vs.SingleShot, {}),
    "reconstruct": (vs.reconstruct, {"sensor": PROJECTED, "decoded": DECODED}),
    "projector_pixels": (vs.projector_pixels, {"scene": PROJECTED, "pixel": [[20.0, 30.0]]}),
    "epipolar_residual": (
        vs.epipolar_residual,
        {
            "camera": SCENE.camera,
            "projector": SCENE.camera,
            "pixel": [[20.0, 30.0]],
            "projector_pixel": [[20.0, 30.0]],
        },
    ),
    "project": (vs.project, {"scene": SCENE, "points_mm": [[0.0, 0.0, 0.0]]}),
    "projected_points": (vs.projected_points, {"scene": SCENE, "points_mm": [[0.0, 0.0, 0.0]]}),
    "trace": (
        vs.trace,
        {"field": FIELD, "origins_mm": [0, 0, 10], "directions": [0, 0, -1], "length_mm": 5.0},
    ),
    "air_refractivity": (vs.air_refractivity, {}),
    "IndexField.read": (vs.IndexField.read, {"path": "field.nc"}),
    "IndexField.from_arrays": (
        vs.IndexField.from_arrays,
        {"refractivity": FIELD.nodes, "origin_mm": [0, 0, 0], "spacing_mm": [1, 1, 1]},
    ),
    "IndexField.refractivity": (FIELD.refractivity, {"points_mm": [[0, 0, 0]]}),
    "IndexField.gradient": (FIELD.gradient, {"points_mm": [[0, 0, 0]]}),
    "IndexField.write": (FIELD.write, {"path": "field.nc"}),
    "IndexField.moved": (FIELD.moved, {"motion": POSE}),
    "IndexField.simplified": (FIELD.simplified, {}),
    "Pose": (vs.Pose, {"rotation": np.eye(3), "origin_mm": [0, 0, 0]}),
    "Pose.from_matrix": (vs.Pose.from_matrix, {"to_world": np.eye(4)}),
    "Pose.turn": (vs.Pose.turn, {"angle_deg": 5.0, "axis": [0, 0, 1]}),
    "Pose.shift": (vs.Pose.shift, {"by_mm": [0, 0, 1]}),
    "Pose.to_world": (POSE.to_world, {"points_mm": [0, 0, 1]}),
    "Pose.to_local": (POSE.to_local, {"points_mm": [0, 0, 1]}),
    "ImageSensor": (vs.ImageSensor, {}),
    "ImageSensor.at_wavelength": (SENSOR.at_wavelength, {"wavelength_nm": 532.0}),
    "image_sensors": (vs.image_sensors, {}),
    "image_sensor": (vs.image_sensor, {"name": "cmos_5um5"}),
    "Aperture": (vs.Aperture, {"f_number": 8.0}),
    "Scene.with_medium": (SCENE.with_medium, {"medium": FIELD}),
    "Scene.with_pose": (SCENE.with_pose, {"name": "camera", "pose": SCENE.camera.pose}),
    "Scene.only": (SCENE.only, {}),
}
WITH_UNIT = {"time_s"}  # said of a file as its time
APART = {"new_scene"}  # whose options are tried apart


def told(function, named):
    """What is said against a call; "" where it works."""
    try:
        function(**named)
    except vs.InputError as error:
        return f"{error}"
    return ""


@pytest.fixture
def here(tmp_path, monkeypatch):
    """A folder of one's own, with an image, a field and a part in it."""
    monkeypatch.chdir(tmp_path)
    vs.save_png(LINE, "line.png")
    FIELD.write("field.nc")
    Path("part.obj").write_text(TETRAHEDRON, encoding="utf-8")


@pytest.mark.parametrize("name", CALLS)
def test_whatever_is_given_works_or_is_told(name, here):
    """Rationale: a traceback from within NumPy, Dr.Jit or Mitsuba says nothing to its reader."""
    function, good = CALLS[name]
    for argument, shown in inspect.signature(function).parameters.items():
        if shown.kind is shown.VAR_KEYWORD:
            continue
        for given in GIVEN:
            try:
                said = told(function, {**good, argument: given})
            except Exception as error:
                message = f"{name}({argument}={given!r}): {type(error).__name__}: {error}"
                raise AssertionError(message) from error
            assert len(said) < 700
            stem = argument.partition("_")[0] if argument in WITH_UNIT else argument
            named = re.search(rf"\b({argument}|{stem})\b", said) or (f"{given}" or "''") in said
            assert not said or named, f"{name}({argument}={given!r}): {said}"


def test_every_public_function_is_tried():
    """Rationale: a function that is new must forgive too."""
    functions = {name for name in vs.__all__ if inspect.isfunction(getattr(vs, name))}
    assert functions - APART <= CALLS.keys()


def test_what_a_new_scene_cant_have_is_told(here):
    """Rationale: its options are many, and each is easily given in another way."""
    wrong: list[dict] = [
        *({"path": given} for given in (None, 5, "", [], b"a")),
        *({"part": given} for given in (5, "none.stl", [], {})),
        *({"focal_length_mm": given} for given in ("a", NAN, -1, {}, [[1, 2], [3]], 1j)),
        *({"alpha": given} for given in ("a", 0, NAN, [30, "a"], {}, 500)),
        *({"film": given} for given in ("a", 5, {}, [1], [0, 5], "2448")),
        *({"unit": given} for given in (5, "yard")),
        {"focal_lenght_mm": 35},
    ]
    for options in wrong:
        (name,) = options
        said = told(vs.new_scene, {"path": "mine.xml", "part": "part.obj"} | options)
        stem = name.partition("_")[0]
        assert stem in said or f"{options[name]}" in said, f"new_scene({options}): {said}"
    assert "did you mean 'focal_length_mm'?" in told(vs.new_scene, {"path": "a", "focal_lenght": 3})
    assert not Path("mine.xml").exists()
