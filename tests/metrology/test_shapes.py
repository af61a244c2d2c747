"""Shapes: distances known from the drawing, derivatives against differences."""

import numpy as np
import pytest

import virtual_sensor as vs
from virtual_sensor.errors import InputError
from virtual_sensor.metrology.shapes import (
    CylinderShape,
    PartShape,
    PlaneShape,
    SectionShape,
    SphereShape,
)
from virtual_sensor.optics.surfaces import Cylinder
from virtual_sensor.poses import Pose

FRAME = Pose.turn(20.0, (1.0, 2.0, -1.0), (3.0, 4.0, 5.0))
ANGLE = np.linspace(0.3, 2.8, 12)
SECTION = np.column_stack([0.0 * ANGLE, 9.0 * np.cos(ANGLE), 9.0 * np.sin(ANGLE)])
SHAPES = (
    CylinderShape(9.0, 1.0, -2.0, 3.0, -5.0, FRAME),
    PlaneShape(2.0, 10.0, -4.0, FRAME),
    SphereShape(9.0, 1.0, -2.0, 0.5),
    PartShape(Cylinder(9.0, 50.0, 0.5, 1.0), (0.0, 0.0, 1.0), 1.0, 2.0, -1.0, 3.0, 4.0, 5.0),
    SectionShape(SECTION, (0.0, 0.1, 1.0), 0.1, 0.2),
)


def test_distances_are_those_of_points_that_were_put_there():
    angle = np.linspace(0.0, 3.0, 7)
    local = np.column_stack([angle, 9.5 * np.cos(angle), 9.5 * np.sin(angle)])
    on_axis = CylinderShape(9.0, 0.0, 0.0, pose=FRAME).distance(FRAME.to_world(local))
    assert np.allclose(on_axis.distance_mm, 0.5, atol=1e-12)
    above = FRAME.to_world(np.column_stack([angle, -angle, np.full(7, 3.25)]))
    assert np.allclose(PlaneShape(3.0, pose=FRAME).distance(above).distance_mm, 0.25, atol=1e-12)
    ball = SphereShape(2.0, 1.0, 2.0, 3.0).distance([[1.0, 2.0, 6.0], [np.nan, 0.0, 0.0]])
    assert np.allclose(ball.distance_mm, [1.0, np.nan], equal_nan=True)
    part = PartShape(Cylinder(), z_mm=0.25).distance([[0.0, 0.0, 1.0]])
    assert np.allclose(part.distance_mm, 0.75)
    section = SectionShape(SECTION).distance([[5.0, 0.0, 9.0], [0.0, 20.0, 0.0]])
    assert np.allclose(section.distance_mm, [0.03, np.nan], atol=0.06, equal_nan=True)


def test_derivatives_are_those_of_differences():
    random = np.random.default_rng(3)
    points = 3.0 * random.normal(size=(40, 3)) + [0.0, 0.0, 12.0]
    points = points[np.isfinite(SHAPES[-1].distance(points).distance_mm)]
    step = 1e-5
    for shape in SHAPES:
        at = shape.distance(points)
        for axis in np.eye(3) * step:
            change = (
                shape.distance(points + axis).distance_mm
                - shape.distance(points - axis).distance_mm
            )
            assert np.allclose(at.by_point @ axis, change / 2.0, atol=1e-9), shape
        for name, value in shape.values.items():
            more, less = (shape.with_values(**{name: value + by}) for by in (step, -step))
            change = more.distance(points).distance_mm - less.distance(points).distance_mm
            assert np.allclose(at.by_parameter[name], change / (2.0 * step), atol=1e-6), (
                shape,
                name,
            )


def test_a_fit_finds_the_shape_that_points_lie_on():
    random = np.random.default_rng(4)
    for shape in SHAPES[:3]:
        points = 9.0 * random.normal(size=(60, 3))
        for _ in range(3):  # onto the shape
            at = shape.distance(points)
            points = points - at.distance_mm[:, None] * at.by_point
        points[3] = np.nan
        start = shape.with_values(**{name: value + 0.3 for name, value in shape.values.items()})
        found = start.fitted(points)
        assert np.allclose(list(found.values.values()), list(shape.values.values()), atol=1e-8)
    with pytest.raises(InputError, match="did you mean 'radius_mm'"):
        shape.fitted(points, ["radius"])
    with pytest.raises(InputError, match="2 points for 4 unknowns"):
        shape.fitted(points[:2])


def test_a_part_of_triangles_is_found_from_its_sensors():
    scene = vs.load_scene("stepped_shaft")
    part = PartShape.of(scene)
    met = vs.ray_search(scene, np.linspace(-9.0, 9.0, 9), "newton")
    points = met.laser_point_mm[np.isfinite(met.pixel).all(axis=1)]
    on_it = part.distance(points)
    assert np.abs(on_it.distance_mm).max() < 1e-3
    assert np.allclose(np.linalg.norm(on_it.by_point, axis=1), 1.0)
    off = part.with_values(z_mm=0.01).distance(np.vstack([points, np.full(3, np.nan)]))
    assert np.allclose(off.distance_mm[:-1], -0.01 * on_it.by_point[:, 2], atol=1e-3)
    assert np.isnan(off.distance_mm[-1])
    far = part.distance(points + np.array([0.0, 0.0, 30.0]))
    assert np.isnan(far.distance_mm).all()
