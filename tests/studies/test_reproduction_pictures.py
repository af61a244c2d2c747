"""The paper's figures, and those that it could not draw, as pictures of made-up results."""

import dataclasses

import cv2
import numpy as np
import pytest
from invented_curves import RADIUS_MM, invented_curves, only

from virtual_sensor.studies.reproduction import drawing
from virtual_sensor.studies.reproduction.beta_map import BetaMap
from virtual_sensor.studies.reproduction.broadening_fit import Fit
from virtual_sensor.studies.reproduction.curves import BLURRED, DOTS, RESOLVED, Setting
from virtual_sensor.studies.reproduction.drawing import draw_figures
from virtual_sensor.studies.reproduction.extra_drawing import (
    draw_beta_map,
    draw_fit,
    draw_reconstruction,
    draw_whole_line,
    radial_residual_um,
)
from virtual_sensor.studies.reproduction.panels import TEMPERATURES
from virtual_sensor.studies.reproduction.reconstruction import Reconstruction

PICTURES = {"6", "7", "9", "10b", "11"}


@pytest.fixture(scope="module")
def curves():
    """All ways in the resolved air, the search alone in the blurred one."""
    return invented_curves()


def colours(path):
    """Red, green and blue of a picture, (H, W, 3); all pixels must be there and not all alike."""
    picture = cv2.imread(str(path))
    assert picture.std() > 5.0
    return picture[..., ::-1].astype(int)


def painted(picture, colour):
    """Pixels (H, W) of just this colour, given as #rrggbb."""
    return (picture == [int(colour[i : i + 2], 16) for i in (1, 3, 5)]).all(axis=-1)


def test_pictures_show_search_and_frames_side_by_side(curves, tmp_path):
    """Rationale: a curve of each half is found by its colour, and covers the same pixels."""
    draw_figures(curves, [RESOLVED], tmp_path, {})
    paths = {name: tmp_path / f"figure_{name}_resolved.png" for name in PICTURES}
    assert {path.name for path in tmp_path.iterdir()} == {path.name for path in paths.values()}
    pictures = {name: colours(path) for name, path in paths.items()}
    for name, picture in pictures.items():
        height, width, _ = picture.shape
        assert 700 < width <= 16 * drawing.DPI
        assert 500 < height <= 10 * drawing.DPI
        if name == "6":
            continue
        colour = TEMPERATURES[1250.0][1] if name == "11" else "#009e73"  # or of what is across
        halves = np.split(painted(picture, colour), [width // 2], axis=1)
        search, frames = (half.sum() for half in halves)
        assert search > 500
        assert frames > 0.8 * search


def test_pictures_are_drawn_of_what_there_is(curves, tmp_path, monkeypatch):
    """Rationale: an air that only the search has seen takes one half, unknown rays take nothing."""
    few = [picture for picture in drawing.PICTURES if picture.name in ("9", "11")]
    monkeypatch.setattr(drawing, "PICTURES", few)
    draw_figures(curves, [BLURRED], tmp_path / "search", {BLURRED: "blurred by 7.2 mm"})
    lines = only(curves, lambda setting, way: way != DOTS and setting.temperature_c == 1250.0)
    draw_figures(lines, [RESOLVED], tmp_path / "lines", {})
    widths = {
        (path.parent.name, path.name): colours(path).shape[1] for path in tmp_path.rglob("*.png")
    }
    narrow = widths["search", "figure_9_blurred.png"]
    assert widths == {
        ("search", "figure_9_blurred.png"): narrow,
        ("search", "figure_11_blurred.png"): narrow,
        ("lines", "figure_9_resolved.png"): widths["lines", "figure_9_resolved.png"],
        ("lines", "figure_11_resolved.png"): narrow,  # a line has no norm
    }
    assert widths["lines", "figure_9_resolved.png"] > 1.5 * narrow
    lost = {
        key: dataclasses.replace(c, B_mm=np.nan * c.B_mm, pixel_B=np.nan * c.pixel_B)
        for key, c in curves.nine.items()
    }
    draw_figures(dataclasses.replace(curves, nine=lost), [RESOLVED], tmp_path / "lost", {})
    assert not (tmp_path / "lost").exists()


def test_the_whole_line_is_drawn_on_both_sides(curves, tmp_path):
    """Rationale: the paper's half is shaded, and curves run through both halves of a panel."""
    draw_whole_line(curves, tmp_path / "line.png")
    picture = colours(tmp_path / "line.png")
    hot = painted(picture, TEMPERATURES[1250.0][1])[: int(0.88 * len(picture))]  # without the key
    shaded = painted(picture, "#f2f2f2")
    columns = np.flatnonzero(hot.any(axis=0))
    middle = np.flatnonzero(shaded.sum(axis=0) > 300)[0]
    assert columns[0] < middle < columns[-1]
    assert shaded.sum() > 0.1 * shaded.size


def test_maps_are_drawn_with_gaps(tmp_path):
    """Rationale: from some poses no ray returns, and small deviations cross no contour."""
    beta, y = np.linspace(0.0, 90.0, 7), np.linspace(-11.0, 11.0, 9)
    grey = []
    for unknown in (0, 3, 9):
        size = 100.0 * np.exp(-beta / 20.0)[:, None, None] * np.ones((7, 9, 3))
        size[:, :unknown] = np.nan
        maps = {
            air: BetaMap(air, 1250.0, beta, y, factor * size, size[..., :2])
            for air, factor in ((RESOLVED, 1.0), (BLURRED, 1e-3))
        }
        draw_beta_map(maps, tmp_path / "map.png")
        grey.append(painted(colours(tmp_path / "map.png"), "#d9d9d9").sum())
    none, some, everything = grey
    assert none < 1000  # edges of letters
    assert everything > 300_000
    assert some == pytest.approx(everything / 3.0, rel=0.05)


def test_fits_are_drawn_with_what_they_miss(tmp_path):
    """Rationale: teal is met within 15 %, orange is not; a number that is not there has no bar."""
    tried = np.array([4.0, 6.0, 7.2, 8.0])
    numbers = {
        "names": ("a, um", "b, px", "c, um"),
        "kind": ("about", "below", "about"),
        "paper": np.array([75.0, 20.0, -4.0]),
        "resolved": np.array([290.0, 3.0, -2.0]),
    }

    def fit(residual):
        ours = numbers["paper"] * (1.0 + np.array(residual))
        return Fit(BLURRED, "mm", tried, (tried - 7) ** 2 + 0.1, 7.2, **numbers, ours=ours,
                   residual=np.array(residual))  # fmt: skip

    teal, orange = {}, {}
    for name, residual in (
        ("met", [0.1, 0.0, -0.1]),
        ("missed", [3.0, 0.0, -0.4]),
        ("unknown", [np.nan, 0.0, np.nan]),
    ):
        draw_fit({BLURRED: fit(residual)}, tmp_path / f"{name}.png")
        picture = colours(tmp_path / f"{name}.png")
        teal[name], orange[name] = (painted(picture, c).sum() for c in ("#2a9d8f", "#e69f00"))
    assert teal["met"] > 1000
    assert orange["missed"] > 1000
    assert [orange["met"], orange["unknown"], teal["missed"], teal["unknown"]] == [0, 0, 0, 0]


def bumpy(bump_um, status=0):
    """Three lines round a cylinder of 13.5 mm, cold exact, hot with a bump; fits as given."""
    y, along = np.linspace(-11.0, 11.0, 23), np.array([-40.0, 0.0, 40.0])
    points = np.empty((2, 3, 23, 3))
    for state, bump in enumerate((0.0, bump_um)):
        r = RADIUS_MM + 1e-3 * bump * np.cos(y / 3.0)
        angle = np.arcsin(y / RADIUS_MM)
        for line, x in enumerate(along):
            points[state, line, :, 0] = x + 0.1 * y
            points[state, line, :, 1] = r * np.sin(angle)
            points[state, line, :, 2] = r * np.cos(angle) - RADIUS_MM
    points[1, :, 4], points[1, 0, 5] = np.nan, np.nan
    radius = np.full((1, 2), RADIUS_MM if status == 0 else np.nan)
    radius[:, 1] -= 0.1
    ones = np.ones((1, 2))
    return Reconstruction(
        along,
        y,
        points.reshape(2, -1, 3),
        np.array([RADIUS_MM, 0.0, -RADIUS_MM]),
        np.array([11.0]),
        radius,
        ones,
        radius[..., None] + [-0.01, 0.02],
        ones[..., None] * [0.0, 0.0, -RADIUS_MM],
        ones[..., None] * [1.0, 0.0, 0.0],
        (69 * ones).astype(int),
        (status * ones).astype(int),
    )


def test_residuals_are_distances_from_the_fitted_cylinder():
    """Rationale: a bump of known height on a known cylinder; the fit is 100 um too small."""
    result = bumpy(20.0)
    np.testing.assert_allclose(radial_residual_um(result, 0), 0.0, atol=1e-8)
    expected = 100.0 + 20.0 * np.cos(result.y_mm / 3.0)
    expected[4] = np.nan  # no line has a point there; one of three is missing beside it
    np.testing.assert_allclose(radial_residual_um(result, 1), expected, atol=1e-8)


def test_reconstructions_are_drawn_whether_or_not_fitted(tmp_path):
    """Rationale: one fit that did not end must not cost the others' picture."""
    results = {
        Setting(RESOLVED, 1250.0, 0.0): bumpy(20.0),
        Setting(RESOLVED, 1250.0, 30.0): bumpy(1.0),
        Setting(BLURRED, 1250.0, 0.0): bumpy(5.0, status=1),
    }
    draw_reconstruction(results, tmp_path / "cylinders.png")
    picture = colours(tmp_path / "cylinders.png")
    assert painted(picture, "#c8321e").sum() > 500
    assert painted(picture, "#1f5fa8").sum() > 500
