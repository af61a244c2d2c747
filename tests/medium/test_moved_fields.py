"""A field after a rigid motion: the same air at another place."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from virtual_sensor.errors import InputError
from virtual_sensor.medium.broadening import blurred, widened
from virtual_sensor.medium.exact_fields import hot_spot
from virtual_sensor.medium.field_family import FieldFamily
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.poses import Pose

TURN = Rotation.from_euler("xyz", [20.0, -35.0, 110.0], degrees=True)
MOTION = Pose(TURN.as_matrix(), np.array([30.0, -250.0, 12.0]))
SHIFT = Pose(np.eye(3), np.array([5.0, -3.0, 70.0]))
AMBIENT = 2.7e-4


def there(points):
    """Points after the motion, by SciPy."""
    return TURN.apply(points) + MOTION.origin_mm


def made(scale=1.0, mirror=(True, False, False)):
    random = np.random.default_rng(4)
    nodes = AMBIENT - scale * 1e-4 * random.random((5, 6, 7))
    return IndexField.from_arrays(
        nodes, [2.0, -4.0, 1.0], [3.0, 1.0, 2.0], ambient=AMBIENT, mirror=mirror, source="random"
    )


@pytest.fixture(scope="module")
def field():
    return made()


@pytest.fixture(scope="module")
def points(field):
    low, high = field.box
    return low + (high - low) * np.random.default_rng(5).uniform(-0.2, 1.2, (300, 3))


def test_index_and_gradient_move_along(field, points):
    """At a moved point they are what they were, the gradient turned; the surroundings outside."""
    moved = field.moved(MOTION)
    n = field.refractivity(points)
    np.testing.assert_allclose(moved.refractivity(there(points)), n, rtol=0, atol=1e-16)
    gradient = TURN.apply(field.gradient(points))
    np.testing.assert_allclose(moved.gradient(there(points)), gradient, rtol=0, atol=1e-16)
    assert 50 < np.sum(n != AMBIENT) < 250
    assert np.isnan(moved.refractivity([[np.nan, 0.0, 0.0]])).all()


def test_motions_follow_one_another(field, points):
    """The later one moves what the earlier one has moved; there and back is where it was."""
    twice = field.moved(MOTION).moved(SHIFT)
    places = there(points) + SHIFT.origin_mm
    n = field.refractivity(points)
    np.testing.assert_allclose(twice.refractivity(places), n, rtol=0, atol=1e-16)
    back = Pose(MOTION.rotation.T, -MOTION.rotation.T @ MOTION.origin_mm)
    again = field.moved(MOTION).moved(back)
    np.testing.assert_allclose(again.refractivity(points), n, rtol=0, atol=1e-16)


def test_a_moved_field_takes_no_more_memory(field):
    """The same data, other place: a conveyor of a hundred places is one field."""
    moved = field.moved(MOTION)
    assert moved.nodes is field.nodes
    assert moved.lookup("double") is field.lookup("double")
    np.testing.assert_array_equal(moved.box, field.box)


@pytest.mark.parametrize(
    ("rotation", "origin", "match"),
    [
        (np.diag([1.0, 1.0, -1.0]), np.zeros(3), "determinant 1"),
        (1.01 * np.eye(3), np.zeros(3), "determinant 1"),
        (np.full((3, 3), np.nan), np.zeros(3), "determinant 1"),
        (np.eye(4), np.zeros(3), r"rotation has the shape \(4, 4\); give it \(3, 3\)"),
        (np.eye(3), [0.0, np.inf, 0.0], "finite"),
        (np.eye(3), [0.0, 1.0], r"origin_mm has the shape \(2,\)"),
    ],
)
@pytest.mark.parametrize("kind", [made, lambda: hot_spot(0.02, 8.0)])
def test_what_is_no_motion_is_refused(kind, rotation, origin, match):
    with pytest.raises(InputError, match=match):
        kind().moved(Pose(rotation, np.array(origin)))


def test_what_is_made_of_a_moved_field_stays_where_it_is(points):
    """Blurred, widened, simplified or with other nodes: as if it had been moved afterwards."""
    field = made()
    changes = [
        lambda f: blurred(f, 1.0),
        lambda f: widened(f, 1.5),
        lambda f: f.simplified("linear"),
        lambda f: f.with_nodes(2.0 * f.nodes, 0.5 * f.origin, 2.0 * f.spacing),
        lambda f: FieldFamily({900.0: f, 1100.0: f.with_nodes(2.0 * f.nodes)}).at(1000.0),
        lambda f: FieldFamily({9.0: f, 10.0: f.with_nodes(1.5 * f.nodes)}).derivative(9.5),
    ]
    for change in changes:
        expected = change(field).refractivity(points)
        found = change(field.moved(MOTION)).refractivity(there(points))
        np.testing.assert_allclose(found, expected, rtol=0, atol=1e-16)


def test_fields_of_a_family_share_a_pose():
    field = made()
    with pytest.raises(InputError, match="or pose"):
        FieldFamily({900.0: field, 1100.0: field.moved(SHIFT)})
    with pytest.raises(InputError, match="or pose"):
        FieldFamily({900.0: field.moved(MOTION), 1100.0: field.moved(SHIFT)})


def test_a_shifted_field_is_written_where_it_is(tmp_path, points):
    """A file's grid lies along the world's axes: a shift needs no word of its own in it."""
    moved = made().moved(SHIFT)
    moved.write(tmp_path / "shifted.nc")
    again = IndexField.read(tmp_path / "shifted.nc")
    places = points + SHIFT.origin_mm
    np.testing.assert_allclose(again.refractivity(places), moved.refractivity(places), rtol=1e-12)


def test_a_turned_field_is_not_written(tmp_path):
    """A file can't say so, and air resampled in silence is other air."""
    with pytest.raises(InputError, match="write it before it is moved"):
        made().moved(MOTION).write(tmp_path / "turned.nc")
    assert not (tmp_path / "turned.nc").exists()


def test_a_field_that_never_moved_has_no_pose():
    """Its frame is the world's."""
    field = made()
    assert field.pose is None
    assert replace(hot_spot(0.02, 8.0)).pose is None
    np.testing.assert_array_equal(field.axes(), np.eye(3))
    np.testing.assert_array_equal(field.to_local([[1.0, 2.0, 3.0]]), [[1.0, 2.0, 3.0]])
    np.testing.assert_array_equal(field.to_world([[1.0, 2.0, 3.0]]), [[1.0, 2.0, 3.0]])
