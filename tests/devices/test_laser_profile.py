"""A laser line's profile, uniformity and focus: power kept, widths, and tables from files."""

import numpy as np
import pytest
from artificial import paper_sensor
from numpy.testing import assert_allclose

import virtual_sensor as vs
from virtual_sensor.devices.laser import LaserLine
from virtual_sensor.devices.laser_profile import (
    Focus,
    Gaussian,
    MeasuredProfile,
    MeasuredUniformity,
    ParabolicUniformity,
    SuperGaussian,
    TailedGaussian,
    profile_of,
    uniformity_of,
)
from virtual_sensor.engine import mi
from virtual_sensor.errors import InputError
from virtual_sensor.optics.ray_families import Sheet

POWER_W, LENGTH_MM, RADIUS_MM = 0.1, 20.0, 0.15
PLACE_MM = np.linspace(0.0, 1.0, 201)
SKEWED = MeasuredProfile(
    PLACE_MM, np.clip(PLACE_MM - 0.1, 0, None) ** 2 * np.clip(0.9 - PLACE_MM, 0, None)
)
BRIGHT_END = MeasuredUniformity(np.arange(5.0), np.array([1.0, 1.0, 1.2, 2.0, 3.0]))
LASERS = {
    "tails": {"profile": TailedGaussian()},
    "super": {"profile": SuperGaussian(6.0)},
    "measured": {"profile": SKEWED},
    "parabola": {"uniformity": ParabolicUniformity(0.4)},
    "bright end": {"uniformity": BRIGHT_END, "profile": TailedGaussian(0.3, 4.0)},
    "focus": {"focus": Focus(300.0, 40.0)},
    "focus of tails": {"focus": Focus(200.0, 90.0), "profile": TailedGaussian()},
}


def laser_line(**parts):
    return LaserLine(
        Sheet(paper_sensor().laser.pose, 300.0), LENGTH_MM, RADIUS_MM, POWER_W, np.empty(0), **parts
    )


def cells(width_mm):
    """Midpoints over the sheet, flat, and a cell's area."""
    s, t = (np.arange(n) + 0.5 for n in (3000, 50))
    s, t = np.meshgrid((s / 3000 - 0.5) * width_mm, (t / 50 - 0.5) * LENGTH_MM)
    return s.ravel(), t.ravel(), width_mm * LENGTH_MM / s.size


def test_power_is_kept_at_all_depths():
    s, t, cell = cells(12.0)
    for name, parts in LASERS.items():
        for depth in (120.0, 300.0, 480.0):
            flux = laser_line(**parts).flux(s, t, np.full_like(s, depth))
            assert np.sum(flux) * cell == pytest.approx(POWER_W, rel=1e-3), (name, depth)


def test_drjit_computes_the_same():
    s, t, _ = cells(2.0)
    for name, parts in LASERS.items():
        laser, depth = laser_line(**parts), 300.0 + 3.0 * t
        found = laser.flux(*map(mi.Float64, (s, t, depth)))
        expected = laser.flux(s, t, depth)
        assert_allclose(found, expected, rtol=1e-9, atol=1e-9 * expected.max(), err_msg=name)


def test_light_lies_within_the_reach():
    """And what is cut off beyond is a millionth of the peak, where the formula goes on."""
    for name, parts in LASERS.items():
        laser = laser_line(**parts)
        s, t = np.linspace(-6.0, 6.0, 12001), np.zeros(12001)
        lit = laser.flux(s, t, np.full(12001, 250.0)) > 0.0
        assert np.all(laser.reaches(s, t)[lit]), name
        assert np.all(laser.reaches(s, t, depth=np.full(12001, 250.0))[lit]), name
        assert lit[s.size // 2]


def test_tails_are_those_of_real_lines():
    """At 2, 3 and 4 standard deviations of the core, of the line's own peak."""
    sigma = RADIUS_MM / 2.0
    low, high = (0.13, 0.02, 0.007), (0.19, 0.06, 0.025)
    found = TailedGaussian().at(sigma * np.array([2.0, 3.0, 4.0]), RADIUS_MM)
    assert np.all((found > low) & (found < high)), found
    plain = TailedGaussian(0.0, 3.0)
    assert_allclose(plain.at(np.array([0.1]), RADIUS_MM), Gaussian().at(np.array([0.1]), RADIUS_MM))
    assert plain.reach == Gaussian().reach


def test_a_table_of_a_gaussian_is_one_wherever_its_zero_is():
    x = np.linspace(3.0, 4.2, 1201)
    measured = MeasuredProfile(x, 7.0 * np.exp(-2.0 * ((x - 3.55) / 0.2) ** 2))
    assert measured.radius_mm == pytest.approx(0.2, rel=1e-4)
    across = np.linspace(-0.4, 0.4, 81)
    assert_allclose(measured.at(across, 0.2), Gaussian().at(across, 0.2), atol=2e-4)


def test_the_middle_of_a_measured_profile_is_its_centre_of_gravity():
    s = np.linspace(-2.0, 2.0, 40001)
    light = SKEWED.at(s, SKEWED.radius_mm)
    assert np.sum(s * light) / np.sum(light) == pytest.approx(0.0, abs=1e-4)
    assert abs(s[np.argmax(light)]) > 0.01


def test_uniformity_is_that_of_the_ends_over_the_middle():
    laser = laser_line(uniformity=uniformity_of("0.4"))
    ends, middle = laser.flux(np.zeros(2), np.array([-9.9999, 0.0]))
    assert ends / middle == pytest.approx(0.4, rel=1e-3)
    at = laser_line(uniformity=BRIGHT_END).flux(np.zeros(3), np.array([-9.999, 5.0, 9.999]))
    assert_allclose(at / at[0], [1.0, 2.0, 3.0], rtol=2e-3)
    assert uniformity_of("1") is None
    assert uniformity_of("") is None


def test_a_focused_beam_spreads_by_its_quality():
    """Far away by the half angle M^2 lambda / (pi w), ISO 11146; in the waist not at all."""
    focus = Focus.of_beam(300.0, 0.03, wavelength_nm=532.0, quality=1.5)
    laser = LaserLine(
        Sheet(paper_sensor().laser.pose, 300.0), 20.0, 0.03, 0.1, np.empty(0), focus=focus
    )
    half_angle = 1.5 * 532e-6 / (np.pi * 0.03)
    s = np.linspace(-30.0, 30.0, 60001)
    for depth, expected in ((300.0, 0.03), (1300.0, half_angle * 1000.0)):
        light = laser.flux(s, np.zeros_like(s), np.full_like(s, depth))
        width = 2.0 * np.sqrt(np.sum(s**2 * light) / np.sum(light))  # of the second moment
        assert width == pytest.approx(expected, rel=2e-3)
    points = laser.pose.to_world([[0.0, 0.0, 300.0], [0.0, 0.0, 1300.0]])
    assert_allclose(laser.radius_at(points), [0.03, half_angle * 1000.0], rtol=2e-3)
    assert laser.working_radius_mm == pytest.approx(0.03)


def test_a_rendered_line_is_as_wide_as_its_light():
    """Cold, at the paper's distance: the detectors' width of a waist there and 60 mm before."""
    where = {"field": "", "width": 96, "height": 96, "film_width": 1.2, "line_radius": 0.1}
    widths = [
        np.nanmedian(
            vs.line_centres(vs.render(vs.load_scene("hot_cylinder", **where, **focus))).width
        )
        for focus in (
            {},
            {"beam_quality": 2, "waist_distance": 300},
            {"beam_quality": 2, "waist_distance": 240},
        )
    ]
    rayleigh_mm = np.pi * 0.1**2 / (2.0 * 532e-6)
    assert widths[1] == pytest.approx(widths[0], rel=2e-3)
    assert widths[2] / widths[0] == pytest.approx(np.hypot(1.0, 60.0 / rayleigh_mm), rel=5e-3)


def test_tables_are_read_from_files(tmp_path):
    (tmp_path / "beam.csv").write_text(
        "x [mm],I\n" + "".join(f"{x},{np.exp(-2 * x**2)}\n" for x in np.linspace(-3, 3, 61))
    )
    (tmp_path / "along.txt").write_text("# place intensity\n0 1\n1 2\n2 3\n3 2\n4 1\n")
    beam = profile_of("beam.csv", (tmp_path,))
    assert isinstance(beam, MeasuredProfile)
    assert beam.radius_mm == pytest.approx(1.0, abs=1e-3)
    along = uniformity_of("along.txt", (tmp_path,))
    assert along is not None
    assert along.at(np.array([0.0])) == pytest.approx(1.5, rel=1e-3)
    text = vs.load_scene("hot_cylinder").path.read_text()
    (tmp_path / "own.xml").write_text(text)
    scene = vs.load_scene(
        tmp_path / "own.xml", field="", line_profile="beam.csv", line_uniformity="along.txt"
    )
    assert isinstance(scene.laser.profile, MeasuredProfile)
    assert isinstance(scene.laser.uniformity, MeasuredUniformity)
    assert scene.laser.radius_mm == pytest.approx(1.0, abs=1e-3)  # the table's, unless it is given
    assert scene.parameters["line_radius"] == f"{beam.radius_mm:.10g}"
    assert scene.with_parameters(line_radius=0.3).laser.radius_mm == pytest.approx(0.3)
    with pytest.raises(InputError, match="in mm"):
        scene.with_parameters(line_length=0.5)


def test_what_cannot_be_is_refused(tmp_path):
    (tmp_path / "cut.csv").write_text("\n".join(f"{x},{1 + x}" for x in range(9)))
    (tmp_path / "words.csv").write_text("no numbers at all\n")
    (tmp_path / "dark.csv").write_text("\n".join(f"{x},0" for x in range(9)))
    (tmp_path / "commas.csv").write_text("0,0,1,0\n0,1,1,5\n")
    (tmp_path / "lone.csv").write_text("0\n1\n")
    (tmp_path / "back.csv").write_text("\n".join(f"{-x},1" for x in range(9)))
    for text, said in {
        "tails 2 3": "0 to 1",
        "tails 0.1": "give",
        "super x": "super ORDER",
        "flat": "no such file",
        "cut.csv": "where its table ends",
        "words.csv": "no numbers",
        "dark.csv": "all are 0",
        "back.csv": "don't ascend",
        "commas.csv": "semicolons",
        "lone.csv": "two numbers in each",
    }.items():
        with pytest.raises(InputError, match=said):
            profile_of(text, (tmp_path,))
    for parameters, said in (
        ({"line_uniformity": "-1"}, "from 0 to 100"),
        ({"waist_distance": 200}, "beam_quality"),
        ({"beam_quality": 0.5}, "from 1 on"),
        ({"beam_quality": "good"}, "leave it empty"),
        ({"line_profile": "super 4", "dots": "0"}, "round Gaussian"),
    ):
        with pytest.raises(InputError, match=said):
            vs.load_scene("cold_cylinder", **parameters)
