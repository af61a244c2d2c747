"""Distances of measured points from the true section: independent references on known parts."""

import numpy as np
import pytest
from scipy.optimize import minimize_scalar

from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.studies.section import longest_gap, section_errors, true_section

RADIUS_MM = 13.5


@pytest.fixture(scope="module")
def cylinder():
    """The cylinder's section in the tilted laser's plane, and its scene."""
    scene = load_scene("cold_cylinder", width=256, height=256)
    return true_section(scene), scene


def in_plane(scene, along_mm, height_mm):
    """World points of the laser's plane: along the line, and towards the laser from the origin."""
    pose = scene.sensor.laser.pose
    origin_mm = pose.to_local(np.zeros(3))[2]
    along, height = np.broadcast_arrays(along_mm, height_mm)
    return pose.to_world(np.stack([0.0 * along, along, origin_mm - height], axis=-1))


def test_distances_are_those_from_the_ellipse(cylinder):
    """Rationale: a tilted plane cuts a cylinder in an ellipse; SciPy finds its nearest point."""
    section, scene = cylinder
    cosine = scene.sensor.laser.pose.rotation[2, 2]
    rng = np.random.default_rng(1)
    along, lifted = rng.uniform(-9.0, 9.0, 40), rng.uniform(-0.4, 0.4, 40)
    surface = (np.sqrt(RADIUS_MM**2 - along**2) - RADIUS_MM) / abs(cosine)
    points = in_plane(scene, along, surface + lifted)

    def nearest(y, height):
        def squared(t):
            z = (np.sqrt(RADIUS_MM**2 - t**2) - RADIUS_MM) / abs(cosine)
            return (y - t) ** 2 + (height - z) ** 2

        found = minimize_scalar(squared, bounds=(y - 1.0, y + 1.0), options={"xatol": 1e-12})
        return np.sqrt(found.fun)

    expected = [nearest(*each) for each in zip(along, surface + lifted, strict=True)]
    distance = section.distance_um(points)
    np.testing.assert_allclose(distance, 1e3 * np.sign(lifted) * expected, atol=2e-3)
    np.testing.assert_allclose(section.along_mm(points), along, atol=1e-9)


def test_points_of_the_surface_are_at_no_distance(cylinder):
    """Rationale: chords of a circle lie below it; what is drawn as an error must not be theirs."""
    section, scene = cylinder
    along = np.linspace(-10.9, 10.9, 501)
    height = (np.sqrt(RADIUS_MM**2 - along**2) - RADIUS_MM) / scene.sensor.laser.pose.rotation[2, 2]
    distance = section.distance_um(in_plane(scene, along, -np.abs(height)))
    assert np.abs(distance).max() < 1e-6


def test_before_a_step_of_the_part_there_is_no_distance():
    """Rationale: across the step of a shaft the picture had spikes of 1.2 mm."""
    scene = load_scene("stepped_shaft", width=256, height=256)
    section = true_section(scene)
    cosine = abs(scene.sensor.laser.pose.rotation[2, 2])
    seat_mm, shoulder_mm = 13.5, 13.0  # radii, up to |y| = 3.7 and 5.5

    def height(y, radius_mm):
        return (np.sqrt(radius_mm**2 - y**2) - seat_mm) / cosine

    for y, radius in ((0.0, seat_mm), (3.5, seat_mm), (4.5, shoulder_mm)):
        [distance] = section.distance_um(in_plane(scene, [y], [height(y, radius) + 0.05]))
        assert 20.0 < distance < 51.0
    middle = 0.5 * (height(3.69, seat_mm) + height(3.71, shoulder_mm))
    assert np.isnan(section.distance_um(in_plane(scene, [3.702], [middle]))).all()


def test_figures_leave_out_what_has_no_distance(cylinder):
    """Rationale: a count without its exceptions, or a NaN for all, would say nothing."""
    section, scene = cylinder
    points = in_plane(scene, [0.0, 0.0, 0.0, 60.0], [0.1, -0.2, np.nan, 0.0])
    errors = section_errors(section, points)
    assert (errors.points, errors.edge_points) == (2, 1)
    assert errors.mean_um == pytest.approx(-50.0, abs=1e-3)
    assert errors.rms_um == pytest.approx(np.sqrt(0.5 * (100.0**2 + 200.0**2)), abs=1e-3)
    assert errors.largest_um == pytest.approx(-200.0, abs=1e-3)
    nothing = section_errors(section, points[2:3])
    assert (nothing.points, nothing.edge_points) == (0, 0)
    assert np.isnan([nothing.mean_um, nothing.rms_um, nothing.largest_um]).all()


def test_the_longest_gap_is_between_points_or_at_an_end():
    """Rationale: points at both ends, or of one side only, have an rms that says nothing."""
    line = np.linspace(-10.0, 10.0, 201)
    both_ends = np.r_[np.nan, 9.0, -9.5, -10.2, 10.3]
    assert longest_gap(line, both_ends) == (-9.5, 9.0)
    assert longest_gap(line[::-1], line[line > 2.05]) == pytest.approx((-10.0, 2.1))
    assert longest_gap(line, np.full(3, np.nan)) == (-10.0, 10.0)
    assert np.isnan(longest_gap(np.full(3, np.nan), line)).all()
    bored = np.where(abs(line) < 5.0, np.nan, line)  # where there is no line none can be measured
    assert longest_gap(bored, line[line < -6.0]) == (5.0, 10.0)
