"""Camera and projector calibrated by a planar target: on pixels that OpenCV projects."""

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from virtual_sensor.errors import InputError
from virtual_sensor.metrology.fringes.calibration import (
    FringeCalibration,
    calibrate_fringes,
    nearest_points,
    turn_between,
)
from virtual_sensor.metrology.fringes.target import (
    CalibrationTarget,
    MarkStatus,
    find_marks,
    projector_marks,
)
from virtual_sensor.poses import Pose

CAMERA_SIZE, PROJECTOR_SIZE = (1200, 1000), (1280, 800)
CAMERA = np.array([[4000.0, 0, 590.0], [0, 4010.0, 505.0], [0, 0, 1]])
PROJECTOR = np.array([[3900.0, 0, 650.0], [0, 3890.0, 380.0], [0, 0, 1]])
LENS = np.array([-0.1, 0.3, 0.001, -0.0005]), np.array([0.08, -0.2, -0.0007, 0.0011])
TURN = Rotation.from_rotvec([np.radians(35.0), 0.02, 0.1])
MIDDLE = np.array([0.0, 0.0, 300.0])
PLACE = MIDDLE - 310.0 * TURN.as_matrix()[:, 2]  # of the projector, in the camera's frame
TARGET = CalibrationTarget(columns=8, rows=7, pitch_mm=8.0)
SIGMA_PX = 0.02


def views(count=9, lens=LENS, sigma=0.0, seed=0, tilt=25.0):
    """Pixels (count, N, 2) of camera and projector, by cv2.projectPoints."""
    rng, points = np.random.default_rng(seed), TARGET.points_mm
    seen, lit = [], []
    for i in range(count):
        about = np.radians(137.5 * i)
        turn = Rotation.from_rotvec([np.radians(17.0), 0, 0])
        turn *= Rotation.from_rotvec(np.radians(tilt) * np.array([np.cos(about), np.sin(about), 0]))
        place = MIDDLE + np.array([2.0 * np.sin(i), np.cos(i), 12.0 * (-1) ** i])
        shift = -TURN.inv().apply(PLACE)
        both = (turn, place), (TURN.inv() * turn, TURN.inv().apply(place) + shift)
        for found, K, each, (r, t) in zip(
            (seen, lit), (CAMERA, PROJECTOR), lens, both, strict=True
        ):
            pixel = cv2.projectPoints(points, r.as_rotvec(), t, K, each)[0][:, 0]
            found.append(pixel + sigma * rng.standard_normal(pixel.shape))
    return np.array(seen), np.array(lit)


def calibrated(seen, lit, **options):
    return calibrate_fringes(TARGET.points_mm, seen, lit, CAMERA_SIZE, PROJECTOR_SIZE, **options)


def focal(K):
    return K[[0, 1, 0, 1], [0, 1, 2, 2]]


def errors(found):
    """Errors of the parameters by their standard deviations, in the order of their names."""
    value = [
        number
        for device, coefficients in ((found.camera, 4), (found.projector, 4))
        for number in (
            *device.matrix[[0, 1, 0, 1], [0, 1, 2, 2]],
            *device.distortion[:coefficients],
        )
    ]
    truth = [
        number
        for K, lens in zip((CAMERA, PROJECTOR), LENS, strict=True)
        for number in (*K[[0, 1, 0, 1], [0, 1, 2, 2]], *lens)
    ]
    pose = Pose(TURN.as_matrix(), PLACE)
    value = [*value, *found.projector.pose.origin_mm, *turn_between(pose, found.projector.pose)]
    return np.array(value) - [*truth, *PLACE, 0.0, 0.0, 0.0]


@pytest.fixture(scope="module")
def exact():
    """The calibration of pixels without noise."""
    return calibrated(*views())


def test_exact_pixels_give_the_devices_that_made_them(exact):
    found = exact
    assert np.abs(errors(found)[[0, 1, 2, 3, 8, 9, 10, 11]]).max() < 1e-4  # px
    assert np.abs(errors(found)[-6:]).max() < 1e-6  # mm and rad
    np.testing.assert_allclose(found.camera.distortion, LENS[0], atol=1e-5)
    assert max(found.camera_rms_px, found.projector_rms_px) < 1e-6
    assert (found.status == MarkStatus.FOUND).all()
    assert found.parameters[0] == "camera_f_x_px"
    assert found.parameters[-1] == "projector_turn_z_rad"


def test_the_fit_is_opencvs_where_both_devices_are_as_good():
    """Expected: the minimum of stereoCalibrate, of all its parameters, within rounding."""
    seen, lit = views(sigma=SIGMA_PX, seed=3)
    found = calibrated(seen, lit, distortion=2)
    objects = [TARGET.points_mm.astype(np.float32)] * len(seen)
    seen, lit = seen.astype(np.float32), lit.astype(np.float32)
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3 | cv2.CALIB_ZERO_TANGENT_DIST
    stop = cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 300, 1e-12
    start = np.zeros(5)
    _, K, _, L, _, R, T, *_ = cv2.stereoCalibrate(
        objects, seen, lit, CAMERA.copy(), start, PROJECTOR.copy(), start.copy(), CAMERA_SIZE,
        flags=flags, criteria=stop,
    )  # fmt: skip
    sigma = found.sigma
    assert abs(K[0, 0] - found.camera.matrix[0, 0]) < 0.2 * sigma["camera_f_x_px"]
    assert abs(L[0, 2] - found.projector.matrix[0, 2]) < 0.2 * sigma["projector_c_x_px"]
    place = (-R.T @ T).ravel()
    apart = np.abs(place - found.projector.pose.origin_mm)
    assert (apart < 0.2 * np.array([sigma[f"projector_{axis}_mm"] for axis in "xyz"])).all()


@pytest.mark.slow
def test_parameters_scatter_as_their_covariance_says():
    """Expected: over 60 draws the spread by the predicted sigma within its own doubt, 1/sqrt(120).

    The sum of squares by the whole covariance has the mean of its 22 degrees of freedom.
    """
    drawn, squared = [], []
    for seed in range(60):
        found = calibrated(*views(sigma=SIGMA_PX, seed=seed))
        error = errors(found)
        drawn.append(error / np.sqrt(np.diag(found.covariance)))
        squared.append(error @ np.linalg.solve(found.covariance, error))
    spread = np.sqrt(np.mean(np.square(drawn), axis=0))
    assert (np.abs(spread - 1.0) < 4.0 / np.sqrt(120)).all()
    assert abs(np.mean(squared) / 22.0 - 1.0) < 4.0 * np.sqrt(2.0 / 22.0 / 60.0)


def test_camera_and_projector_are_weighted_by_their_own_residuals():
    seen, lit = views(sigma=0.01, seed=1)
    lit += np.random.default_rng(2).normal(0.0, 0.3, lit.shape)
    found = calibrated(seen, lit)
    assert abs(found.camera_rms_px / (0.01 * np.sqrt(2.0)) - 1.0) < 0.1
    assert abs(found.projector_rms_px / (0.3 * np.sqrt(2.0)) - 1.0) < 0.1
    assert found.sigma["camera_f_x_px"] < 0.1 * found.sigma["projector_f_x_px"]


def test_marks_that_are_missing_or_wrong_are_named_and_left_out():
    seen, lit = views(sigma=SIGMA_PX)
    seen[0, 3], lit[1, 5], lit[2, 7, 0] = np.nan, np.nan, lit[2, 7, 0] + 1.0
    lit[8] = np.nan  # the projector does not reach a pose
    found = calibrated(seen, lit)
    assert found.status[0, 3] == MarkStatus.NOT_FOUND
    assert found.status[1, 5] == MarkStatus.NO_PHASE
    assert found.status[2, 7] == MarkStatus.OUTLIER
    assert (found.status != MarkStatus.FOUND).sum() == 3 + len(TARGET.points_mm)
    assert np.isnan(found.projector_residual_px[2, 7]).all()
    assert np.isfinite(found.camera_residual_px[1, 5]).all()
    assert len(found.notes) == 2
    assert "pose 8 of the target is left out" in found.notes[0]
    assert (np.abs(errors(found)[-6:]) < 4 * np.sqrt(np.diag(found.covariance)[-6:])).all()


def test_what_leaves_a_choice_is_refused():
    seen, lit = views(sigma=SIGMA_PX)
    for given, said in (
        ((seen[:2], lit[:2]), "2 poses of the target"),
        (views(sigma=SIGMA_PX, tilt=0.0), "tilted by 10 to 30"),
        (views(4, sigma=5.0, tilt=8.0), "focal lengths would be known to"),
        ((seen, lit[:5]), "give it"),
    ):
        with pytest.raises(InputError, match=said):
            calibrated(*given)
    with pytest.raises(InputError, match="distortion is 3"):
        calibrated(seen, lit, distortion=3)
    with pytest.raises(InputError, match="no plane"):
        calibrate_fringes(TARGET.points_mm[:, ::-1], seen, lit, CAMERA_SIZE, PROJECTOR_SIZE)


# ------------------------------------------------------------------------------ files


def test_files_hold_it_whatever_their_format(exact, tmp_path):
    pose = Pose(Rotation.from_rotvec([1.0, -0.3, 0.2]).as_matrix(), [10.0, -5.0, 260.0])
    found = exact.placed(Pose.shift((5.0, 6.0, 7.0))).placed(pose)
    assert found.camera.pose == pose
    np.testing.assert_allclose(found.baseline_mm, exact.baseline_mm, atol=1e-12)
    for name in ("both.yaml", "both.xml", "both.json"):
        read = FringeCalibration.read(found.write(tmp_path / name))
        for one, other in ((read.camera, found.camera), (read.projector, found.projector)):
            np.testing.assert_allclose(one.matrix, other.matrix, rtol=1e-14)
            np.testing.assert_allclose(one.distortion, other.distortion, rtol=1e-14)
            np.testing.assert_allclose(one.pose.origin_mm, other.pose.origin_mm, atol=1e-10)
            np.testing.assert_allclose(one.pose.rotation, other.pose.rotation, atol=1e-12)
            assert one.size == other.size
        np.testing.assert_allclose(read.covariance, found.covariance, rtol=1e-14)
        assert read.parameters == found.parameters
        assert read.projector_rms_px == pytest.approx(found.projector_rms_px)
        assert read.notes == ()
    with pytest.raises(InputError, match="written as"):
        found.write(tmp_path / "both.txt")


def test_files_of_other_programs_are_read(tmp_path):
    """R and T go from camera to projector, as stereoCalibrate gives them."""
    R = TURN.as_matrix().T
    T = -R @ PLACE[:, None]
    named = {
        "scan3d.yml": ("cam_K", "cam_kc", "proj_K", "proj_kc", "R", "T"),
        "slstudio.xml": ("Kc", "kc", "Kp", "kp", "Rp", "Tp"),
        "stereo.yml": ("M1", "D1", "M2", "D2", "R", "T"),
        "procam.xml": ("cam_int", "cam_dist", "proj_int", "proj_dist", "rotation", "translation"),
    }
    values = CAMERA, LENS[0], PROJECTOR, LENS[1], R, T
    for name, names in named.items():
        storage = cv2.FileStorage(str(tmp_path / name), cv2.FILE_STORAGE_WRITE)
        for each, value in zip(names, values, strict=True):
            storage.write(each, value)
        storage.write("cam_error", 0.2)
        storage.release()
        with pytest.raises(InputError, match="give camera_size"):
            FringeCalibration.read(tmp_path / name)
        read = FringeCalibration.read(tmp_path / name, CAMERA_SIZE, PROJECTOR_SIZE)
        np.testing.assert_allclose(read.projector.pose.origin_mm, PLACE, atol=1e-9)
        np.testing.assert_allclose(read.projector.pose.rotation, TURN.as_matrix(), atol=1e-12)
        np.testing.assert_array_equal(read.projector.matrix, PROJECTOR)
        np.testing.assert_array_equal(read.camera.distortion, LENS[0])
        assert np.isnan(read.camera_rms_px)
        assert "not used: 'cam_error'" in read.notes[-1]


def test_a_file_without_a_part_says_which(exact, tmp_path):
    exact.write(tmp_path / "both.yaml")
    text = (tmp_path / "both.yaml").read_text(encoding="utf-8")
    for gone, said in (
        ("projector_matrix", "lacks 'projector_matrix'"),
        ("projector_translation", "no 'projector_translation'"),
        ("projector_width", "give projector_size"),
    ):
        (tmp_path / "part.yaml").write_text(text.replace(f"{gone}:", "other:"), encoding="utf-8")
        with pytest.raises(InputError, match=said):
            FringeCalibration.read(tmp_path / "part.yaml")


def test_rays_are_nearest_at_the_point_between_them():
    point, gap = nearest_points(
        np.array([[0.0, 0, 0], [0, 0, 0]]), np.array([[1.0, 0, 2], [1, 0, 0]]),
        np.array([[0.0, 0, 1], [0, 0, 1]]), np.array([[0.0, 1, 0], [0, 0, 1]]),
    )  # fmt: skip
    np.testing.assert_allclose(point[0], [0.5, 0.0, 2.0])
    assert gap[0] == pytest.approx(1.0)
    assert np.isnan(point[1]).all()


# ------------------------------------------------------------------------------ marks

FOCAL = np.array([[900.0, 0, 199.5], [0, 900.0, 209.5], [0, 0, 1]])
SIZE = 420, 400


def drawn(target, turn=(0.3, -0.25, 0.1), place=(0.0, 0.0, 260.0), fine=3):
    """An image of a target by a camera FOCAL, and the marks' true pixels."""
    r, t = np.array(turn), np.array(place)
    axes = Rotation.from_rotvec(r).as_matrix()
    inverse = np.linalg.inv(FOCAL @ np.column_stack([axes[:, 0], axes[:, 1], t]))
    steps = (np.arange(fine) + 0.5) / fine - 0.5
    v, u = (np.arange(n)[:, None] + steps for n in SIZE)
    u, v = np.meshgrid(u.ravel(), v.ravel())
    x, y, w = inverse @ np.stack([u.ravel(), v.ravel(), np.ones(u.size)])
    x, y = x / w / target.pitch_mm, y / w / target.pitch_mm
    column, row = x + (target.columns - 1) / 2.0, y + (target.rows - 1) / 2.0
    inside = (np.abs(x) < target.columns / 2 + 1.0) & (np.abs(y) < target.rows / 2 + 1.0)
    if target.kind == "dots":
        near = np.hypot(column - np.round(column), row - np.round(row)) < 0.25
        known = (np.round(column) >= 0) & (np.round(column) < target.columns)
        known &= (np.round(row) >= 0) & (np.round(row) < target.rows)
        black = near & known
    else:
        squares = (column > -1) & (column < target.columns) & (row > -1) & (row < target.rows)
        black = squares & ((np.floor(column) + np.floor(row)) % 2 == 0)
    grey = np.where(inside, np.where(black, target.dark, target.bright), 0.02)
    image = grey.reshape(SIZE[0], fine, SIZE[1], fine).mean(axis=(1, 3))
    return image, cv2.projectPoints(target.points_mm, r, t, FOCAL, None)[0][:, 0]


@pytest.mark.parametrize("kind", ["checkerboard", "dots"])
def test_marks_are_found_to_hundredths_of_a_pixel(kind):
    """Expected: 0.015 px, in light that grows by a third, searched for or expected."""
    target = CalibrationTarget(kind, 8, 7, 10.0)
    image, true = drawn(target, fine=6)
    image = image * np.linspace(1.0, 1.3, SIZE[1])
    rng = np.random.default_rng(0)
    for expected in (None, true + rng.uniform(-4.0, 4.0, true.shape)):
        found = find_marks(image, target, expected)
        assert (found.status == MarkStatus.FOUND).all()
        off = found.pixel - true
        if expected is None:  # it may be found turned by 180 degrees
            turned = found.pixel - true[::-1]
            off = min(off, turned, key=lambda each: np.abs(each).max())
        assert np.sqrt(np.mean(off**2)) < 0.015
        assert np.abs(off).max() < 0.03


def test_marks_that_are_cut_hidden_or_dark_are_named():
    target = CalibrationTarget("checkerboard", 8, 7, 10.0)
    image, true = drawn(target, place=(-35.0, 0.0, 260.0))
    u, v = true[20]
    hidden = image.copy()
    hidden[int(v) - 14 : int(v) + 15, int(u) - 14 : int(u) + 15] = 0.5
    found = find_marks(hidden, target, true)
    outside = ~((true > 15.0) & (true < np.array(SIZE[::-1]) - 16.0)).all(axis=1)
    assert 0 < outside.sum() < 30
    assert (found.status[true[:, 0] < 8.0] == MarkStatus.OUTSIDE).all()
    assert found.status[20] in (MarkStatus.DARK, MarkStatus.NOT_FOUND)
    good = found.status == MarkStatus.FOUND
    assert good.sum() > 25
    assert np.abs(found.pixel - true)[good].max() < 0.05
    assert np.isnan(found.pixel[~good]).all()
    dark, true = drawn(target)
    dark[:, 250:] *= 0.1
    status = find_marks(dark, target, true).status
    assert (status[true[:, 0] > 280.0] == MarkStatus.DARK).any()
    assert not (status[true[:, 0] > 280.0] == MarkStatus.FOUND).any()


def test_an_image_without_a_target_has_no_marks():
    target = CalibrationTarget("checkerboard", 8, 7, 10.0)
    for image in (np.zeros(SIZE), np.full(SIZE, np.nan), np.ones(SIZE)):
        found = find_marks(image, target)
        assert (found.status == MarkStatus.NOT_FOUND).all()
        assert np.isnan(found.pixel).all()
    with pytest.raises(InputError, match="give \\(H, W\\)"):
        find_marks(np.zeros((3, 4, 5)), target)
    with pytest.raises(InputError, match=r"give \(56, 2\)"):
        find_marks(np.zeros(SIZE), target, np.zeros((5, 2)))


def test_projector_pixels_at_marks_are_those_of_the_plane():
    """Expected: a plane's homography to 2e-3 px, with noise and holes, NaN where nothing is lit."""
    target = CalibrationTarget("checkerboard", 8, 7, 10.0)
    image, true = drawn(target)
    found = find_marks(image, target, true)
    homography = np.array([[1.9, 0.2, 100.0], [-0.1, 2.1, 50.0], [3e-5, -8e-5, 1.0]])
    v, u = np.mgrid[: SIZE[0], : SIZE[1]].astype(float)
    x, y, w = np.tensordot(homography, np.stack([u, v, np.ones_like(u)]), 1)
    decoded = np.stack([x / w, y / w])
    rng = np.random.default_rng(0)
    holes = rng.random(SIZE) < 0.2
    decoded[:, holes] = np.nan
    dark = u > 300.0
    decoded[:, dark] = np.nan
    decoded[:, rng.random(SIZE) < 0.03] += 5.0  # as of a wrong fringe order
    marks = projector_marks(found, target, *decoded)
    at = np.column_stack([found.pixel, np.ones(len(true))]) @ homography.T
    off = marks.pixel - at[:, :2] / at[:, 2:]
    lit = true[:, 0] < 285.0
    assert (marks.status[lit] == MarkStatus.FOUND).all()
    assert np.abs(off[lit]).max() < 2e-3
    assert (marks.status[true[:, 0] > 300.0] == MarkStatus.NO_PHASE).all()
    decoded += rng.normal(0.0, 0.1, decoded.shape)
    noisy = projector_marks(found, target, *decoded).pixel - at[:, :2] / at[:, 2:]
    assert np.nanstd(noisy) < 0.03


def test_a_target_knows_its_plate():
    target = CalibrationTarget("dots", 5, 4, 2.0)
    assert target.points_mm.shape == (20, 3)
    np.testing.assert_allclose(target.points_mm.mean(axis=0), 0.0, atol=1e-15)
    for kind in ("dots", "checkerboard"):
        plate = CalibrationTarget(kind, 5, 4, 2.0).drawn(16)
        assert plate.shape == (16 * 6, 16 * 7)
        assert target.size_mm == (14.0, 12.0)
    # Of the dots, a pitch's share is the circle's area.
    share = np.mean(CalibrationTarget("dots", 5, 4, 2.0, 0.0, 1.0).drawn(16) < 1.0)
    assert 0.9 * 20 * np.pi / 16 < share * 42 < 1.5 * 20 * np.pi / 16
    for wrong in ({"kind": "circles"}, {"columns": 2}, {"pitch_mm": -1.0}, {"dark": 0.9}):
        with pytest.raises(InputError):
            CalibrationTarget(**wrong)
