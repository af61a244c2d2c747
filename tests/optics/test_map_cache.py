"""Which ray maps are made again, and which are not; makings are counted by what makes them."""

import gc
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from virtual_sensor.medium.exact_fields import hot_spot
from virtual_sensor.medium.index_field import IndexField
from virtual_sensor.optics.map_cache import MapCache, roomier
from virtual_sensor.optics.ray_families import Pinhole, Pose, Sheet
from virtual_sensor.optics.ray_maps import CausticError, MapRequest, forward_map, inverse_map
from virtual_sensor.optics.rays import March

MARCH = March(step_mm=4.0, method="leapfrog")
BOX = np.array([-0.05, -0.04, 110.0]), np.array([0.05, 0.045, 121.0])
TOLERANCE_MM = 1e-2


def pose(origin, turned_deg=(0.0, 180.0, 20.0)):
    return Pose(Rotation.from_euler("xyz", turned_deg, degrees=True).as_matrix(), np.array(origin))


CAMERA = Pinhole(np.eye(3), pose([1.0, -2.0, 115.0]), (1, 1))
LASER = Sheet(pose([1.0, -2.0, 115.0]), 110.0)


class Counter:
    """Makes maps and counts them."""

    def __init__(self, make):
        self._make = make
        self.count = 0

    def __call__(self, *asked):
        self.count += 1
        return self._make(*asked)


class Maps(MapCache):
    """A cache that counts what it makes."""

    def __init__(self, most_bytes=1 << 30, inverse=inverse_map):
        self.made = Counter(forward_map)
        self.inverted = Counter(inverse)
        super().__init__(most_bytes, self.made, self.inverted)

    def sight(self, medium, family=CAMERA, box=BOX, march=MARCH, tolerance_mm=TOLERANCE_MM):
        low, high = box
        return self.forward(MapRequest(medium, family, low, high, march, tolerance_mm))


@pytest.fixture(scope="module")
def spot():
    """A hot spot of some tenths of a mm."""
    return hot_spot(0.02, 8.0, box=np.array([[-40.0] * 3, [40.0] * 3]))


def gridded(contrast=1.0):
    """A field on a grid."""
    x = np.linspace(-30.0, 30.0, 21)
    r2 = np.add.outer(np.add.outer(x**2, x**2), x**2)
    return IndexField.from_arrays(
        -0.01 * contrast * np.exp(-r2 / 128.0), [-30.0] * 3, [3.0] * 3, ambient=0.0
    )


def test_what_does_not_bend_rays_makes_no_map_again(spot):
    """Rationale: exposures, films, lenses and lines' lengths change far more often than air."""
    maps = Maps()
    first = maps.sight(spot)
    other = Pinhole(2.0 * np.eye(3), replace(CAMERA.pose), (640, 480), np.full(5, 0.01))
    assert maps.sight(spot).table is first.table
    assert maps.sight(spot, other).table is first.table
    assert maps.sight(spot, other).family is other
    assert maps.made.count == 1


def test_what_bends_rays_otherwise_makes_another(spot):
    """Rationale: a map of other air, of another march or tolerance, is a wrong one."""
    maps = Maps()
    maps.sight(spot)
    asked = [
        {"medium": None},
        {"medium": replace(spot, box=spot.box)},  # another medium, though of equal numbers
        {"march": replace(MARCH, step_mm=2.0)},
        {"march": replace(MARCH, first_order=True)},
        {"tolerance_mm": TOLERANCE_MM / 2.0},
        {"family": LASER, "box": (np.array([-5.0, -5, 110]), np.array([5.0, 5.0, 121.0]))},
        {"box": (BOX[0], BOX[1] + [0.1, 0.0, 0.0])},
    ]
    for number, each in enumerate(asked):
        for _ in range(2):
            maps.sight(**({"medium": spot} | each))
        assert maps.made.count == number + 2
    maps.inverse(MapRequest(spot, CAMERA, *BOX, MARCH, TOLERANCE_MM))
    assert (maps.made.count, maps.inverted.count) == (len(asked) + 1, 1)


def test_a_moved_device_has_another_map_and_a_turned_one_too(spot):
    """Rationale: in still air, it looks through another part of it, by a micrometre or a metre."""
    maps = Maps()
    seen = {id(maps.sight(spot).table)}
    for shift in ([1e-3, 0.0, 0.0], [0.0, 0.0, 1.0]):
        there = replace(CAMERA, pose=pose(CAMERA.pose.origin_mm + shift))
        seen.add(id(maps.sight(spot, there).table))
    turned = replace(CAMERA, pose=pose(CAMERA.pose.origin_mm, (0.0, 180.0, 20.01)))
    seen.add(id(maps.sight(spot, turned).table))
    assert maps.made.count == len(seen) == 4


def test_fields_on_grids_are_known_by_their_nodes():
    """Rationale: notes and names are not air; other nodes, and how they are joined, are."""
    maps, field = Maps(), gridded()
    maps.sight(field)
    maps.sight(replace(field, notes=("read twice",), source="elsewhere"))
    assert maps.made.count == 1
    for other in (gridded(), field.simplified(dimensions=2), replace(field, ambient=1e-4)):
        maps.sight(other)
    assert maps.made.count == 4


def test_maps_of_a_medium_that_is_gone_are_gone():
    """Rationale: a sweep over fields must not fill the memory; another may take its address."""
    maps, field = Maps(), gridded()
    maps.sight(field)
    held = maps.bytes
    del field
    gc.collect()
    maps.sight(None)
    assert 0 < maps.bytes < held


@pytest.mark.parametrize("asked", [[0.0109, 0.0095], [0.0095, 0.0109], [1e-30, 1.05e-30]])
def test_a_tolerance_near_by_has_the_same_map_and_a_tighter_one(spot, asked):
    """Rationale: a pixel's size on the part changes with each part that it sees."""
    made = []

    def note(asked):
        made.append(asked.tolerance_mm)
        return forward_map(replace(asked, tolerance_mm=TOLERANCE_MM))

    maps = MapCache(forward=note)
    for tolerance_mm in asked:
        maps.forward(MapRequest(spot, CAMERA, *BOX, MARCH, tolerance_mm))
    (tolerance_mm,) = made
    assert 0.8 * max(asked) < tolerance_mm <= min(asked)
    maps.forward(MapRequest(spot, CAMERA, *BOX, MARCH, tolerance_mm))
    assert len(made) == 1


# ------------------------------------------------------------------------------------------ boxes


def test_a_box_holds_what_was_asked_for_and_little_more():
    """Rationale: a place beyond the box has no answer; each node beyond it takes time."""
    random = np.random.default_rng(3)
    for _ in range(200):
        low = random.normal(size=3) * [0.1, 30.0, 0.0] + [0.0, 0.0, random.uniform(0.01, 400.0)]
        high = low + 10.0 ** random.uniform(-4.0, 2.5, 3)
        first, last = roomier(low, high)
        assert np.all((first <= low) & (last >= high))
        assert first[2] > 0.0
        assert np.all((last - first)[:2] <= 1.51 * (high - low)[:2])
        np.testing.assert_array_equal(roomier(low, high), (first, last))


def test_a_box_near_by_has_the_same_map_and_order_does_not_matter(spot):
    """Rationale: another part needs about the same box; frames must not depend on history."""
    near = BOX[0] + [0.002, -0.003, 0.4], BOX[1] + [-0.003, 0.001, 0.7]
    far = BOX[0] - [0.05, 0.05, 2.0], BOX[1] + [0.05, 0.05, 2.0]
    one, other = Maps(), Maps()
    tables = [one.sight(spot, box=box).table for box in (BOX, near, far)]
    again = [other.sight(spot, box=box).table for box in (far, near, BOX)]
    assert one.made.count == other.made.count == 2
    assert tables[0] is tables[1]
    places = BOX[0] + np.random.default_rng(1).random((50, 3)) * (BOX[1] - BOX[0])
    for table, same in zip(tables, reversed(again), strict=True):
        np.testing.assert_array_equal(table.at(places), same.at(places))


def test_a_map_is_the_same_whatever_was_asked_before(spot):
    """Rationale: a frame's bits must not tell which other frames were made before it.

    Of devices that stand a hair's breadth apart, or that were moved with their medium.
    """
    motion = pose([30.0, -4.0, 7.0], (10.0, 20.0, 30.0))
    there = replace(CAMERA, pose=CAMERA.pose.moved(motion))
    moved = [(spot.moved(motion), there)]
    hair = replace(CAMERA, pose=pose(CAMERA.pose.origin_mm + 1e-7))
    asked = [(spot, CAMERA), (spot, hair), *moved]
    one, other = Maps(), Maps()
    tables = [one.sight(medium, family).table for medium, family in asked]
    again = [other.sight(medium, family).table for medium, family in reversed(asked)]
    places = BOX[0] + np.random.default_rng(1).random((50, 3)) * (BOX[1] - BOX[0])
    for table, same in zip(tables, reversed(again), strict=True):
        np.testing.assert_array_equal(table.at(places), same.at(places))


# ------------------------------------------------------------------- memory, threads and failures


def test_memory_is_bounded_and_what_was_not_used_goes_first(spot):
    """Rationale: each new pose of a sweep has a map; the scene's other ones are wanted again."""
    whole = Maps()
    size = whole.sight(spot).table.bytes
    maps = Maps(most_bytes=int(3.5 * size))
    start = CAMERA.pose.origin_mm
    poses = [replace(CAMERA, pose=pose(start + np.array([0.1 * k, 0, 0]))) for k in range(6)]
    for each in poses:
        maps.sight(spot, each)
        maps.sight(spot, poses[0])
        assert maps.bytes <= 3.5 * size
    assert maps.made.count == len(poses)
    maps.sight(spot, poses[1])
    assert maps.made.count == len(poses) + 1
    assert Maps(most_bytes=1).sight(spot).nodes == whole.sight(spot).nodes


def test_threads_that_ask_at_once_get_one_map(spot):
    """Rationale: it is made once, and by one of them."""
    maps, together = Maps(), threading.Barrier(6)

    def ask(_):
        together.wait()
        return maps.sight(spot).table

    with ThreadPoolExecutor(6) as pool:
        tables = list(pool.map(ask, range(6)))
    assert maps.made.count == 1
    assert len({id(table) for table in tables}) == 1


def test_that_there_is_no_map_is_not_found_out_twice(spot):
    """Rationale: where a map folds, frames are marched; each must not first try for seconds."""

    def folds(*asked):
        raise CausticError("the map folds: a caustic")

    maps = Maps(inverse=folds)
    for _ in range(3):
        with pytest.raises(CausticError, match="folds"):
            maps.inverse(MapRequest(spot, CAMERA, *BOX, MARCH, TOLERANCE_MM))
    assert maps.inverted.count == 2  # of the roomier box, and of the box itself


def test_a_fold_just_beyond_a_box_leaves_its_map(spot):
    """Rationale: the roomier box is the cache's own wish, no reason to do without."""

    def folds_beyond(asked):
        if asked.high[2] > BOX[1][2]:
            raise CausticError("the map folds: a caustic")
        return inverse_map(asked)

    found = Maps(inverse=folds_beyond).inverse(MapRequest(spot, CAMERA, *BOX, MARCH, TOLERANCE_MM))
    np.testing.assert_array_equal(found.table.grid.high, BOX[1])


# ------------------------------------------------------------------------------------ rigid motion


def test_device_and_medium_moved_together_keep_their_map():
    """Rationale: nothing changes between them; the map's points move along, as if made there."""
    maps, field, motion = Maps(), gridded(), pose([30.0, -4.0, 7.0], (10.0, 20.0, 30.0))
    there, moved_field = replace(CAMERA, pose=CAMERA.pose.moved(motion)), field.moved(motion)
    first = maps.sight(field)
    moved = maps.sight(moved_field, there)
    assert maps.made.count == 1
    assert moved.table is first.table
    assert first.largest_mm > 0.1
    places = BOX[0] + np.random.default_rng(6).random((40, 3)) * (BOX[1] - BOX[0])
    points = moved.points(places).point_mm
    expected = motion.to_world(first.points(places).point_mm)
    np.testing.assert_allclose(points, expected, rtol=0, atol=1e-10)
    made_again = forward_map(MapRequest(moved_field, there, *BOX, MARCH, TOLERANCE_MM))
    expected = made_again.points(places).point_mm
    np.testing.assert_allclose(points, expected, rtol=0, atol=TOLERANCE_MM)


def test_a_device_or_a_medium_moved_alone_needs_another_map():
    """Rationale: the device then looks through another part of the medium."""
    maps, field, motion = Maps(), gridded(), pose([30.0, -4.0, 7.0], (10.0, 20.0, 30.0))
    maps.sight(field)
    maps.sight(field.moved(motion))
    maps.sight(field, replace(CAMERA, pose=CAMERA.pose.moved(motion)))
    assert maps.made.count == 3
