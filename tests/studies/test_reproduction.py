"""Section 5 of the paper, remade: the logic on made curves, and the whole thing once (slow)."""

import csv
import dataclasses
import json
import re
from pathlib import Path

import numpy as np
import pytest
from command_line import command

from virtual_sensor.errors import InputError
from virtual_sensor.records import write_csv
from virtual_sensor.studies.reproduction import broadening_fit
from virtual_sensor.studies.reproduction.broadening_fit import fit_broadening
from virtual_sensor.studies.reproduction.curves import (
    DOTS,
    LINE,
    SEARCHED,
    Curve,
    Curves,
    from_dots,
    from_line,
    read_columns,
)
from virtual_sensor.studies.reproduction.paper import (
    FITTED,
    REASONS,
    STATEMENTS,
    Quantity,
    Statement,
    check,
    judge,
)
from virtual_sensor.studies.reproduction.reproduce import (
    Searches,
    rendered_cases,
    reproduce,
)
from virtual_sensor.studies.reproduction.settings import (
    AIRS,
    BLURRED,
    NINE_RAYS_MM,
    RESOLVED,
    WIDENED,
    Broadening,
    Scenes,
    Setting,
    settings,
)

AIR = "made"


@pytest.fixture(scope="module")
def sensors():
    """The paper's sensor in its three poses."""
    scenes = Scenes({})
    return {beta: scenes.pose(beta).sensor for beta in (0.0, 15.0, 30.0)}


def made_curve(sensor, temperature_c, beta_deg, moved_mm, bent_px):
    """Nine rays whose spot moves by moved_mm (9, 3), seen bent by bent_px (9, 2) besides."""
    A = np.stack([0.0 * NINE_RAYS_MM, NINE_RAYS_MM, -(13.5 - np.sqrt(182.25 - NINE_RAYS_MM**2))], 1)
    A[:, 0] = -A[:, 2] * np.tan(np.radians(30.0))  # in the laser's plane
    B = A + moved_mm
    return Curve(
        Setting(AIR, temperature_c, beta_deg),
        SEARCHED,
        sensor,
        NINE_RAYS_MM,
        A,
        B,
        sensor.camera.project(A),
        sensor.camera.project(B) + bent_px,
        np.full(9, 0.5),
    )


def made_curves(sensors, scale=1.0):
    """Curves that run as the paper's: what its text says, put into numbers."""
    s = -NINE_RAYS_MM / 10.0
    nine = {}
    for temperature, hot in ((900.0, 0.8), (1100.0, 0.9), (1250.0, 1.0)):
        for beta, turned in ((0.0, 1.0), (15.0, 0.1), (30.0, 0.02)):
            factor = scale * hot * turned
            down = -0.088 * s * factor
            moved = np.stack([0.02 * s * factor, down, 1.1 * down], 1)
            bent = np.stack([2.9 * s * factor, (0.6 - 3.5 * s**2) * factor], 1)
            curve = made_curve(sensors[beta], temperature, beta, moved, bent)
            nine[curve.setting, SEARCHED] = curve
    return Curves(nine)


# What Beermann et al. 2018 print of the nine rays, in their words, and where.
PRINTED = {
    "largest |B - B_m|": ("fig. 7(b)", "Euclidean distances up to 75 um"),
    "Δu laser → object at y = -10 mm": (
        "fig. 9(a)",
        "decreasing to a pixel value of approximately -4 for y = -10 mm",
    ),
    "largest Δu object → camera": ("fig. 9(b)", "increases to a value of more than 2 pixel"),
    "Δu laser → camera, middle of its range": (
        "fig. 9(c)",
        "varies around a value of -0.5 pixel",
    ),
    "largest |B_m - A_m| at beta = 15 deg (900 °C)": (
        "5.3",
        "below 20 um for all laser rays for 15 deg",
    ),
    "largest |B_m - A_m| at beta = 30 deg (900 °C)": ("5.3", "below 7 um for 30 deg"),
}
SENSES = {
    "below": "below",
    "more than": "above",
    "up to": "number",
    "approximately": "number",
    "around": "number",
}
# Figure by figure what section 5 says in words, and how many statements it makes.
SAID = {
    "fig. 6": ["below 1 µm"],
    "fig. 7(a)": ["continuously", "continuously", "increases", "not or only slightly"],
    "fig. 7(b)": ["about 75 µm", "demonstrated"],
    "fig. 7(c)": ["decreases, lowest, increases", "maximum"],
    "fig. 7(d)": ["y = -7.5 mm"],
    "fig. 7(c, d)": ["yes"],
    "fig. 7(a, c)": ["oddly enough"],
    "fig. 7(e)": ["about 2.7 µm", "2.75 µm", "exclusively"],
    "fig. 9(a)": ["about -4 px", "is decreasing"],
    "fig. 9(b)": ["above 2 px", "increases"],
    "fig. 9": ["opposite"],
    "fig. 9(c)": ["about -0.5 px", "the same"],
    "fig. 9(d-f)": ["a reduction"],
    "fig. 10(b)": ["slight difference", "bigger"],
    "fig. 10": ["marginally"],
    "fig. 10(a)": ["above"],
    "fig. 11(a)": ["an increase", "no differences", "except"],
    "fig. 11(a.2)": ["more"],
    "fig. 11(c)": ["an increase"],
    "fig. 11(d)": ["reduced"],
    "": ["below 20 µm", "below 7 µm", "obvious"],
}


def test_all_that_section_5_says_is_judged_and_nothing_else():
    """Rationale: its sentences, figure by figure; a statement left out would never be missed."""
    judged = {}
    for statement in STATEMENTS:
        figure = statement.where.partition(", ")[2]
        judged.setdefault(figure, []).append(statement.paper)
    assert {figure: sorted(words) for figure, words in judged.items()} == {
        figure: sorted(words) for figure, words in SAID.items()
    }
    assert len({(s.where, s.claim) for s in STATEMENTS}) == len(STATEMENTS)


def test_numbers_are_those_that_the_paper_prints():
    """Rationale: value, unit, sense and pose, read from its own words."""
    assert {statement.claim for statement in FITTED} == set(PRINTED)
    for statement in FITTED:
        where, words = PRINTED[statement.claim]
        assert where in statement.where
        number, unit = re.search(r"(-?[\d.]+) ?(um|pixel|for)", words).groups()
        sense = next(sense for word, sense in SENSES.items() if word in words)
        given = {name: getattr(statement, name) for name in ("number", "below", "above", "at_most")}
        assert {k: v for k, v in given.items() if v is not None} == {sense: float(number)}
        assert f"{float(number):g} {'µm' if unit == 'um' else 'px'}" in statement.paper
        assert ("_um" if unit == "um" else "_px") in statement.of.series
        pose = re.search(r"for (\d+) deg", words.replace("all laser rays for ", ""))
        assert statement.of.beta_deg == (float(pose[1]) if pose else 0.0)
        assert statement.of.temperature_c == (900.0 if pose else 1250.0)  # 5.1, and figure 11(d)


MET = {
    "largest |B - B_m|": ([64.0, 75.0, 86.0], [0.0, 63.5, 86.5, -75.0]),
    "Δu laser → object at y = -10 mm": ([-3.41, -4.0, -4.59], [-3.39, -4.61, 4.0]),
    "largest Δu object → camera": ([2.01, 2.5, 30.0], [1.99, 0.0, -3.0]),
    "Δu laser → camera, middle of its range": ([-0.43, -0.5, -0.57], [-0.42, -0.58, 0.5]),
    "largest |B_m - A_m| at beta = 15 deg (900 °C)": ([0.0, 19.9], [20.1, 40.0]),
    "largest |B_m - A_m| at beta = 30 deg (900 °C)": ([0.0, 6.9], [7.1, 20.0]),
}


class OneValue:
    """In place of a quantity: the same value in all curves."""

    def __init__(self, value):
        self.value = value

    def values(self, curves, air, **setting):
        return np.array([self.value])


def test_a_number_is_met_within_15_percent_and_a_bound_only_if_it_is_kept():
    """Rationale: the acceptance's own tolerance, worked out by hand from the printed values."""
    for statement in FITTED:
        for wanted, values in zip((True, False), MET[statement.claim], strict=True):
            for ours in values:
                found = check(dataclasses.replace(statement, of=OneValue(ours)), None, AIR)
                assert found.met == wanted, (statement.claim, ours)
                assert (statement.residual(ours) == 0.0) <= wanted


# What each kind of check says of nine rays whose |B_m - A_m| is given: met, not met.
FALLING, RISING = np.arange(9.0, 0.0, -1.0), np.arange(1.0, 10.0)
VALLEY = np.abs(np.arange(9.0) - 6.0) + 1.0
SIZE = {"series": "measured_shift_um.norm"}
OTHER = {"series": "pixel_shift_px.norm"}
CHECKS = [
    ({"check": "monotone", "of": SIZE, "going": "falls"}, [FALLING], [RISING, VALLEY]),
    ({"check": "monotone", "of": SIZE, "going": "rises"}, [RISING], [FALLING, VALLEY]),
    (
        {"check": "monotone", "of": SIZE, "going": "falls then rises"},
        [VALLEY],
        [FALLING, RISING, np.roll(VALLEY, 1)],
    ),
    ({"check": "bound", "of": SIZE, "below": 9.5}, [FALLING], [1.1 * FALLING]),
    ({"check": "bound", "of": SIZE, "above": 0.5}, [FALLING], [0.4 * FALLING]),
    (
        {"check": "bound", "of": SIZE | {"take": "largest"}, "at_most": 9.0},
        [0.9 * FALLING],
        [VALLEY + 5.0],
    ),
    (
        {"check": "about", "of": SIZE | {"take": "largest"}, "number": 9.0},
        [FALLING, 0.9 * FALLING, 1.1 * RISING],
        [0.8 * FALLING, 1.2 * RISING],
    ),
    (
        {"check": "about", "of": SIZE | {"take": "middle"}, "number": 5.0},
        [FALLING],
        [2.0 * FALLING],
    ),
    (
        {
            "check": "compare",
            "less": SIZE | {"y_mm": -7.5},
            "more": SIZE | {"y_mm": 0.0},
            "times": 2.0,
        },
        [FALLING, VALLEY],
        [RISING, FALLING + 9.0],
    ),
    (
        {
            "check": "compare",
            "less": SIZE | {"y_mm": [-6.25, -10.0], "take": "mean"},
            "more": [SIZE | {"y_mm": 0.0}, SIZE | {"y_mm": [0.0, -5.0], "take": "least"}],
        },
        [FALLING, VALLEY],
        [RISING],
    ),
    (
        {"check": "locate", "of": SIZE, "extreme": "least", "at_mm": -7.5},
        [VALLEY],
        [FALLING, np.roll(VALLEY, 1)],
    ),
    (
        {"check": "locate", "of": SIZE, "extreme": "least", "at_mm": -7.5, "rays": 1},
        [VALLEY, np.roll(VALLEY, -1)],
        [FALLING, np.roll(VALLEY, -2)],
    ),
    ({"check": "locate", "of": SIZE, "extreme": "largest", "at_mm": 0.0}, [FALLING], [RISING]),
]


def sized(norms, pixels=None):
    """Curves of an air whose quantities are given: |B_m - A_m| and the pixel's shift."""

    class Rays:
        def of(self, series):
            return {SIZE["series"]: np.asarray(norms), OTHER["series"]: np.asarray(pixels)}[series]

    class Known:
        y_mm = NINE_RAYS_MM

        def rays(self, step_px=0.0):
            return Rays()

    return Curves({(Setting(AIR), SEARCHED): Known()})


def statement(entry):
    """A statement of its kind of check alone."""
    from virtual_sensor.studies.reproduction.paper import _statement

    return _statement({"where": "", "claim": "", "paper": "", "found": "", **entry})


def test_every_kind_of_check_can_be_met_and_missed():
    """Rationale: curves whose answer is seen at a glance; the sixth kind is below."""
    for entry, met, missed in CHECKS:
        for wanted, curves in ((True, met), (False, missed)):
            for norms in curves:
                assert check(statement(entry), sized(norms), AIR).met == wanted, (entry, norms)
    assert {s.check for s in STATEMENTS} == {entry["check"] for entry, _, _ in CHECKS} | {
        "correlate"
    }


def test_curves_are_correlated_or_opposed():
    """Rationale: the sixth kind, of two series: by coefficient, by signs, by signs of steps."""
    pair = {"check": "correlate", "of": SIZE, "with": OTHER}
    alike = statement(pair | {"above": 0.9, "found": "{coefficient:.2f}"})
    assert check(alike, sized(FALLING, 3.0 * FALLING + 1.0), AIR).words == "1.00"
    assert check(alike, sized(FALLING, FALLING), AIR).met
    assert not check(alike, sized(FALLING, RISING), AIR).met
    rays = statement(pair | {"opposed": "rays", "found": "{number} of {count}"})
    assert check(rays, sized(RISING, -FALLING), AIR).words == "9 of 9"
    assert not check(rays, sized(RISING, VALLEY - 2.5), AIR).met
    steps = statement(pair | {"opposed": "steps", "found": "{number} of {count}"})
    assert check(steps, sized(RISING, VALLEY), AIR).words == "6 of 8"
    assert check(steps, sized(RISING, VALLEY), AIR).met
    assert not check(steps, sized(FALLING, RISING), AIR).met


def test_checks_go_over_temperatures_and_poses():
    """Rationale: each ray by itself, or one number of all; in made curves hotter is more."""
    scenes = Scenes({})
    curves = made_curves({beta: scenes.pose(beta).sensor for beta in (0.0, 15.0, 30.0)})
    hotter = {"check": "monotone", "of": SIZE, "over": "temperature_c", "going": "rises"}
    found = check(statement(hotter | {"found": "{right} of {count}"}), curves, AIR)
    assert (found.met, found.words) == (True, "9 of 9")
    aside = SIZE | {"take": "largest"}
    turned = {"check": "monotone", "of": aside, "over": "beta_deg", "going": "falls"}
    found = check(statement(turned | {"found": "{values:.2g}"}), curves, AIR)
    assert found.met
    assert len(found.words.split(", ")) == 3
    assert not check(statement(turned | {"going": "rises"}), curves, AIR).met
    both = {
        "check": "compare",
        "less": aside | {"beta_deg": 15.0},
        "more": aside,
        "over": "temperature_c",
    }
    assert check(statement(both | {"times": 5.0}), curves, AIR).met
    assert not check(statement(both | {"times": 20.0}), curves, AIR).met
    change = SIZE | {"change_from_c": 900.0}
    unchanged = {"check": "bound", "of": change | {"temperature_c": 900.0}, "below": 1e-9}
    assert check(statement(unchanged), curves, AIR).met
    assert not check(statement(unchanged | {"of": change}), curves, AIR).met


def test_residues_of_rounding_are_not_printed_with_their_digits():
    """Rationale: 3e-12 um is another number on another machine."""
    words = statement(
        {"check": "bound", "of": SIZE, "below": 1.0, "found": "{largest:1e-6|.2g} µm"}
    )
    assert check(words, sized(np.full(9, 3e-12)), AIR).words == "below 1e-06 µm"
    assert check(words, sized(np.full(9, 0.021)), AIR).words == "0.021 µm"


def test_reasons_and_panels_that_are_named_are_there():
    """Rationale: a key that is spelt wrong would leave a difference without its reason."""
    assert {s.why for s in STATEMENTS if s.why} == set(REASONS)
    assert {s.check for s in STATEMENTS if s.panel} <= {"about", "bound"}
    for s in STATEMENTS:
        assert isinstance(s, Statement)
        assert all(isinstance(q, Quantity) for q in (*s.less, *s.more, s.of, s.with_))


def pinhole(beta_deg):
    """The paper's camera and laser plane by table 1: centre, axes u, v and forward; normal.

    Turned by beta about the cylinder's axis, which runs along x at z = -13.5 mm.
    """
    beta, tilt = np.radians([beta_deg, 30.0])
    turn = np.array([[1, 0, 0], [0, np.cos(beta), -np.sin(beta)], [0, np.sin(beta), np.cos(beta)]])
    pivot = np.array([0.0, 0.0, -13.5])
    towards = np.array([np.sin(tilt), 0.0, np.cos(tilt)])  # from the origin to the camera
    axes = np.array([[0.0, 1.0, 0.0], [np.cos(tilt), 0.0, -np.sin(tilt)], -towards])
    normal = np.array([np.cos(tilt), 0.0, np.sin(tilt)])
    centre = pivot + turn @ (300.0 * towards - pivot)
    origin = pivot + turn @ -pivot  # in the laser's plane
    return centre, axes @ turn.T, turn @ normal, origin


FOCAL_PX = 75.0 / 0.0055


def seen_straight(beta_deg, points):
    centre, axes, _, _ = pinhole(beta_deg)
    x, y, z = axes @ (points - centre).T
    return 1023.5 + FOCAL_PX * np.stack([x / z, y / z], axis=1)


def measured(beta_deg, pixel):
    """Where the lines of sight through pixels meet the laser's plane."""
    centre, axes, normal, origin = pinhole(beta_deg)
    ray = np.column_stack([(pixel - 1023.5) / FOCAL_PX, np.ones(len(pixel))]) @ axes
    return centre + ray * ((origin - centre) @ normal / (ray @ normal))[:, None]


def bent_by(number):
    """Random displacements of nine spots, mm, and of their images, px."""
    rng = np.random.default_rng(number)
    return rng.normal(0.0, 0.05, (9, 3)), rng.normal(0.0, 2.0, (9, 2))


@pytest.mark.parametrize("beta_deg", [0.0, 15.0, 30.0])
def test_our_numbers_are_those_of_the_papers_geometry(sensors, beta_deg):
    """Rationale: by table 1 alone, without the package's camera, triangulation or differences."""
    moved, bent = bent_by(int(beta_deg))
    curve = made_curve(sensors[beta_deg], 1250.0, beta_deg, moved, bent)
    curves = Curves({(curve.setting, SEARCHED): curve})
    straight = seen_straight(beta_deg, curve.incidence_hot_mm)
    pixel_A = seen_straight(beta_deg, curve.incidence_cold_mm)
    B_m, A_m = measured(beta_deg, straight + bent), measured(beta_deg, pixel_A)
    total = straight + bent - pixel_A
    expected = [
        1e3 * np.linalg.norm(curve.incidence_hot_mm - B_m, axis=1).max(),
        (straight - pixel_A)[8, 0],
        bent[:, 0].max(),
        (total[:, 0].min() + total[:, 0].max()) / 2.0,
        1e3 * np.linalg.norm(B_m - A_m, axis=1).max(),
        1e3 * np.linalg.norm(B_m - A_m, axis=1).max(),
    ]
    here = {"temperature_c": 1250.0, "beta_deg": beta_deg}
    ours = [statement.of.values(curves, AIR, **here).item() for statement in FITTED]
    np.testing.assert_allclose(ours, expected, rtol=1e-4)  # the scene is in float32


def test_a_verdict_follows_the_curves(sensors):
    """Rationale: a table that says "met" whatever the curves do would be worse than none."""
    verdicts = {v.statement.claim: v for v in judge(made_curves(sensors), [AIR])}
    doubled = {v.statement.claim: v for v in judge(made_curves(sensors, 2.0), [AIR])}
    number = "Δu laser → object at y = -10 mm"
    assert verdicts[number].found[AIR].met
    assert verdicts[number].words == "met"
    assert verdicts[number].why == ""
    assert not doubled[number].found[AIR].met
    assert doubled[number].words == "differs"
    assert doubled[number].why
    found, unit = doubled[number].found[AIR].words.split()
    assert float(found) == pytest.approx(-8.0, rel=0.05)  # 2 * 88 um, of some 22 um a pixel
    assert unit == "px"
    for claim in ("Δy of B - A falls with -y", "Δu object → camera increases with -y"):
        assert verdicts[claim].found[AIR].words.startswith("8 of 8")


def test_a_statement_turned_round_is_not_met(sensors):
    """Rationale: each ordering must be able to fail."""
    curves = made_curves(sensors)
    turned = {
        key: dataclasses.replace(
            c,
            incidence_hot_mm=2.0 * c.incidence_cold_mm - c.incidence_hot_mm,
            pixel_hot=2.0 * c.pixel_cold - c.pixel_hot,
        )
        for key, c in curves.nine.items()
    }
    verdicts = {v.statement.claim: v for v in judge(Curves(turned), [AIR])}
    for claim in (
        "Δy of B - A falls with -y",
        "Δz of B - A falls with -y",
        "Δx of B - A rises with -y",
        "Δu laser → object decreases with -y",
        "Δu object → camera increases with -y",
        "Δu laser → camera, middle of its range",
    ):
        assert not verdicts[claim].found[AIR].met, claim
    hotter_is_less = {
        (dataclasses.replace(key[0], temperature_c=2150.0 - key[0].temperature_c), key[1]): c
        for key, c in curves.nine.items()
        if key[0].temperature_c != 1100.0
    } | {key: c for key, c in curves.nine.items() if key[0].temperature_c == 1100.0}
    verdicts = {v.statement.claim: v for v in judge(Curves(hotter_is_less), [AIR])}
    assert not verdicts["hotter is more |B_m - A_m| from y = 0 to -5 mm"].found[AIR].met


@pytest.mark.parametrize("beta_deg", [0.0, 15.0, 30.0])
def test_the_separated_paths_are_those_that_displaced_the_spot(sensors, beta_deg):
    """Rationale: figure 8: B seen straight is the laser's part, what air bends the camera's."""
    moved, bent = bent_by(7 + int(beta_deg))
    curve = made_curve(sensors[beta_deg], 1250.0, beta_deg, moved, bent)
    A, B = curve.incidence_cold_mm, curve.incidence_hot_mm
    by_laser = seen_straight(beta_deg, B) - seen_straight(beta_deg, A)
    paths = curve.rays()
    np.testing.assert_allclose(paths.laser_to_object_px, by_laser, atol=2e-4)  # of up to 5 px
    np.testing.assert_allclose(paths.object_to_camera_px, bent, rtol=0, atol=1e-9)
    np.testing.assert_allclose(paths.laser_to_camera_px, by_laser + bent, atol=2e-4)


def test_the_fit_finds_the_parameter_that_made_the_numbers(monkeypatch):
    """Rationale: numbers that go linearly with a known parameter have their least cost there."""
    paper = np.array([statement.stated for statement in FITTED])
    numbers = lambda scenes, b: paper * (1.0 + 0.1 * (b.blur_mm - 6.34))  # noqa: E731
    monkeypatch.setattr(broadening_fit, "stated", numbers)
    fit = fit_broadening(Scenes({}), BLURRED)
    assert fit.fitted_mm == pytest.approx(6.3, abs=1e-12)
    assert fit.broadening == Broadening(blur_mm=6.3)
    np.testing.assert_allclose(fit.residual[[0, 1, 3]], 0.1 * (6.3 - 6.34), atol=1e-12)
    assert np.all(np.diff(fit.tried_mm) > 0.0)
    assert fit.cost[np.searchsorted(fit.tried_mm, 6.3)] <= fit.cost.min() + 1e-3
    np.testing.assert_allclose(fit.resolved, paper * (1.0 - 0.634))


def test_rendered_curves_are_read_from_a_measurements_files(sensors, tmp_path):
    """Rationale: a line's curve is that of its centres between columns; dots are taken as found."""
    curve = next(iter(made_curves(sensors).nine.values()))
    dots = {s: curve.pixel_cold + shift for s, shift in (("cold", 0.25), ("hot", [1.0, -2.0]))}
    column = np.arange(400, 1100)
    for name, pixel in dots.items():
        columns = {"pixel_u": pixel[:, 0], "pixel_v": pixel[:, 1]}
        write_csv(tmp_path / f"dots_{name}.csv", columns)
        row = 1000.0 + 1e-4 * (column - 800.0) ** 2 + (0.5 if name == "hot" else 0.0)
        status = np.where(column == 700, "no_peak", "ok")
        row = np.where(column == 700, np.nan, row)
        write_csv(
            tmp_path / f"line_{name}.csv", {"column_px": column, "row_px": row, "status": status}
        )
    seen = from_dots(curve, tmp_path)
    assert seen.method == DOTS
    np.testing.assert_allclose(
        seen.rays().pixel_shift_px, np.tile([0.75, -2.25], (9, 1)), atol=1e-8
    )
    line = from_line(curve, tmp_path)
    assert line.method == LINE
    np.testing.assert_array_equal(line.pixel_hot[:, 0], curve.pixel_hot[:, 0])
    expected = 1000.5 + 1e-4 * (curve.pixel_hot[:, 0] - 800.0) ** 2
    np.testing.assert_allclose(line.pixel_hot[:, 1], expected, atol=1e-6)


def test_the_rendered_cases_are_all_18_and_what_the_figures_show():
    """Rationale: three temperatures, three poses, each cold and hot, as a line and as dots."""
    wanted = rendered_cases()
    assert len(set(wanted)) == len(wanted)
    for method in (LINE, DOTS):
        seen = {s for s, m in wanted if m == method and s.air == RESOLVED}
        assert seen == set(settings(RESOLVED))
    assert len(settings(RESOLVED)) == 9


@pytest.mark.parametrize("given", [{"beta": "7"}, {"width": "512"}, {"dots": "0"}])
def test_what_the_reproduction_chooses_is_refused(tmp_path, given):
    """Rationale: with another pose or other pixels the paper would be judged by other numbers."""
    with pytest.raises(InputError, match="reproduce takes the paper's set-up"):
        reproduce(tmp_path / "r", print, given)
    assert not (tmp_path / "r").exists()


@pytest.mark.parametrize("wrong", ["spp=many", "method=heun", "widht=512"])
def test_what_cannot_be_loaded_is_told_before_anything_is_written(tmp_path, wrong):
    """Rationale: not after the first fit, and no folder is left behind."""
    status, _, err = command("reproduce", "-D", wrong, "-o", tmp_path / "r")
    assert status == 2
    assert wrong.split("=")[0] in err or wrong.split("=")[1] in err
    assert not (tmp_path / "r").exists()


def test_a_folder_of_something_else_is_left_alone(tmp_path):
    """Rationale: nothing that is not ours may be overwritten."""
    (tmp_path / "thesis.tex").write_text("mine")
    status, _, err = command("reproduce", "-o", tmp_path)
    assert status == 2
    assert f"{tmp_path}: holds other files" in err
    assert [file.name for file in tmp_path.iterdir()] == ["thesis.tex"]


def test_a_finished_search_is_read_as_it_was(tmp_path):
    """Rationale: floats, names and arrays must come back to the bit."""
    searches = Searches(tmp_path, Scenes({}))
    made = []

    def make():
        made.append(1)
        blurs, costs = np.array([0.1, 1 / 3]), np.array([1e-9, np.nan])
        return broadening_fit.Fit(BLURRED, blurs, costs, 7.1, *(np.arange(2.0) for _ in range(3)))

    first, second = (broadening_fit.Fit(**searches.stored("fit", {"x": 1}, make)) for _ in range(2))
    assert len(made) == 1
    for name, value in vars(make()).items():
        np.testing.assert_array_equal(getattr(first, name), value)
        np.testing.assert_array_equal(getattr(second, name), value)
    assert isinstance(second.fitted_mm, float)
    assert second.broadening == Broadening(blur_mm=7.1)


@pytest.fixture(scope="module")
def whole(tmp_path_factory):
    """The reproduction as a user gets it, full size."""
    folder = tmp_path_factory.mktemp("reproduced") / "r"
    status, out, err = command("reproduce", "-o", folder)
    assert status == 0, err
    return folder, json.loads((folder / "report/summary.json").read_text(encoding="utf-8")), out


@pytest.mark.slow
def test_rendered_and_searched_agree_in_all_18_cases(whole):
    """Rationale: the acceptance: 0.005 px rms across the line, dots 0.02 px in both axes."""
    folder, summary, _ = whole
    columns = read_columns(folder / "report/rendered_minus_searched.csv")
    lines = [columns[f"{state}_line_rms_px"] for state in ("cold", "hot")]
    assert sum(np.isfinite(rms).sum() for rms in lines) == 18
    assert np.nanmax(lines) <= 0.005
    for axis in "uv":
        dots = [columns[f"{state}_dots_largest_{axis}_px"] for state in ("cold", "hot")]
        assert sum(np.isfinite(largest).sum() for largest in dots) >= 18
        assert np.nanmax(dots) <= 0.02
    assert summary["rendered_minus_searched"]["figures_dots_px"] <= 0.02
    assert summary["paths_minus_whole_px"] <= 1e-9


@pytest.mark.slow
def test_the_broadened_air_bears_the_paper_out(whole):
    """Rationale: the acceptance; the cold |A - A_m| is geometry, which no air can change."""
    folder, summary, _ = whole
    assert summary["not_met"][WIDENED] == ["cold |A - A_m|, rounded to 0.25 px, at most"]
    with (folder / "report/statements.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["statement"]: row for row in csv.DictReader(file)}
    assert len(rows) == summary["statements"] >= 20
    for name in PRINTED:
        assert rows[name][f"{BLURRED}_met"] == rows[name][f"{WIDENED}_met"] == "true", name
    assert rows["largest |B - B_m|"][f"{RESOLVED}_met"] == "false"


@pytest.mark.slow
def test_the_table_in_the_documentation_is_the_programs(whole):
    """Rationale: the same verdicts, and numbers to their last digit, as readers find them."""
    page = Path(__file__).parents[2] / "docs/explanation/reproduction.md"
    printed, made = (
        [line.split(" | ") for line in text.splitlines() if line.startswith("| 5.")]
        for text in (
            file.read_text(encoding="utf-8") for file in (page, whole[0] / "report/statements.md")
        )
    )
    assert len(printed) == len(made) == len(STATEMENTS)
    number = re.compile(r"-?\d+\.?\d*(?:e-\d+)?")
    for before, now in zip(printed, made, strict=True):
        for one, other in zip(before, now, strict=True):
            assert number.sub("", one) == number.sub("", other)
            values = [np.array(number.findall(cell), float) for cell in (one, other)]
            np.testing.assert_allclose(*values, rtol=0.01, atol=0.01)


@pytest.mark.slow
def test_whole_lines_are_mirror_images_from_above(whole):
    """Rationale: field and cylinder are even in y, so from above both sides must see the same."""
    columns = read_columns(whole[0] / "report/whole_line.csv")
    for air in AIRS:
        taken = (columns["air"] == air) & (columns["beta_deg"] == 0.0)
        taken &= columns["temperature_c"] == 1250.0
        y, d = columns["y_mm"][taken], columns["measured_shift_um_norm"][taken]
        assert len(y) >= 20
        np.testing.assert_allclose(y, -y[::-1], atol=1e-9)
        np.testing.assert_allclose(d, d[::-1], atol=1e-3)
        assert d.max() > 20.0


@pytest.mark.slow
def test_the_radius_error_comes_with_an_interval(whole):
    """Rationale: the acceptance; what is in the report must be numbers, not words alone."""
    columns = read_columns(whole[0] / "report/reconstruction.csv")
    low, high = columns["radius_error_low_um"], columns["radius_error_high_um"]
    error = columns["radius_error_um"]
    assert np.all(np.isfinite(error))
    assert np.all((low <= error) & (error <= high))


@pytest.mark.slow
def test_a_second_run_takes_all_from_what_is_kept(whole):
    """Rationale: seconds in place of minutes, and the same bits."""
    folder, summary, _ = whole
    names = ["statements.csv", "rendered_minus_searched.csv", "reconstruction.csv"]
    names += [p.name for p in (folder / "report").glob("figure_*.csv")]
    first = {name: (folder / "report" / name).read_bytes() for name in names}
    status, _, err = command("reproduce", "-o", folder)
    assert status == 0, err
    again = json.loads((folder / "report/summary.json").read_text(encoding="utf-8"))
    assert summary["made_now"] == len(rendered_cases())
    assert again["made_now"] == 0
    assert {name: (folder / "report" / name).read_bytes() for name in names} == first
