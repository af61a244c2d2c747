"""Where an edge hides a part of a line's profile its centre is of what is left: CUT, never OK.

Drawn lines, whose truth is known, and the shipped stepped shaft beside a dense ray search.
"""

from itertools import product

import numpy as np
import pytest

from virtual_sensor.imaging.render import render_frame
from virtual_sensor.imaging.scene import load_scene
from virtual_sensor.metrology.centres import Status
from virtual_sensor.metrology.detectors import COLUMNWISE, NAMES
from virtual_sensor.metrology.line_peaks import line_centres
from virtual_sensor.optics.ray_search import SearchStatus, ray_search

FINE = 6
WRONG_PX = 0.1
FELT = {"centre_of_gravity": 0.2}  # feels the skirts most: it errs first, by at most so much


def hidden(sigma, width=480, height=120, far=5.0, near=-1.0, slope=0.05, upwards=False):
    """A line over an edge that comes nearer from column to column: image, rows, sigmas to the edge.

    FINE x FINE samples a pixel; beyond the edge it is dark.
    """
    u, v = (((np.arange(n * FINE) + 0.5) / FINE - 0.5) for n in (width, height))
    row = height / 2.0 + slope * (u - width / 2.0)
    away = np.interp(u, [40.0, width - 1.0], [far, near])
    below = v[:, None] - row
    fine = np.exp(-0.5 * (below / sigma) ** 2) * ((-below if upwards else below) < away * sigma)
    image = fine.reshape(height, FINE, width, FINE).mean(axis=(1, 3))
    return image, row.reshape(width, FINE).mean(axis=1), away.reshape(width, FINE).mean(axis=1)


def errors(line, truth):
    """Of the OK centres: how far from the nearest of some true rows (K, W), and where."""
    good = line.status == Status.OK
    u, v = line.column[good], line.row[good]
    apart = np.abs(v - np.array([np.interp(u, np.arange(len(t)), t) for t in np.atleast_2d(truth)]))
    return u, np.where(np.isnan(apart), np.inf, apart).min(axis=0), line.sigma[good]


@pytest.mark.parametrize("sigma", [2.0, pytest.param(3.5, marks=pytest.mark.slow)])
def test_no_centre_of_a_line_that_an_edge_cuts_is_ok_and_wrong(sigma):
    """On either side of it; and where the edge is 4 sigma away no centre is lost for it."""
    for upwards in (False, True):
        image, row, away = hidden(sigma, upwards=upwards)
        for noise, method in product((0.0, 0.01), NAMES):
            case = noise, sigma, upwards, method
            rng = np.random.default_rng(int(upwards))
            line = line_centres(image + rng.normal(0.0, noise, image.shape), method)
            u, error, _ = errors(line, row)
            clear = (away > 4.0) & (np.arange(away.size) > 20)
            whole = clear[np.rint(u).astype(int)]
            assert len(np.unique(np.rint(u[whole]))) > 0.97 * clear.sum(), case
            assert np.all(error < FELT.get(method, 0.0) + WRONG_PX + 1.3 * error[whole].max()), case
            deep = np.isin(np.rint(line.column), np.flatnonzero((away < 1.0) & (away > 0.3)))
            assert not np.any(line.status[deep] == Status.OK), case
            assert np.mean(line.status[deep] == Status.CUT) > (
                0.6 if method in COLUMNWISE else 0.3
            ), case


def test_the_second_of_two_lines_is_cut_as_well():
    """Of two lines in each column one is whole and one is not: each has its own neighbours."""
    image, row, away = hidden(3.0, height=160)
    whole = row - 55.0
    image += 1.5 * np.exp(-0.5 * ((np.arange(160)[:, None] - whole) / 3.0) ** 2)
    for method in COLUMNWISE:
        line = line_centres(image, method, peaks=2)
        assert np.mean(line.status[0] == Status.OK) > 0.98, method
        _, error, _ = errors(line, [whole, row])
        assert np.all(error < FELT.get(method, 0.0) + WRONG_PX), method
        assert np.mean(line.status[1, (away < 1.0) & (away > 0.3)] == Status.CUT) > 0.6, method


def test_what_is_no_cut_is_not_called_so():
    """A second line, a step of the background, clipping, noise and speckle have other names."""
    rng = np.random.default_rng(1)
    rows = np.arange(80)[:, None]
    centre = 40.0 + 0.01 * np.arange(300)
    one = np.exp(-0.5 * ((rows - centre) / 2.5) ** 2)
    pictures = (
        one + 0.7 * np.exp(-0.5 * ((rows - centre - 6.0) / 2.5) ** 2),
        one + 0.4 * (rows > centre + 1.0),
        one + rng.normal(0.0, 0.05, one.shape),
        one * rng.gamma(6.0, 1.0 / 6.0, one.shape),
    )
    for picture in pictures:
        status = line_centres(picture + rng.normal(0.0, 0.003, one.shape)).status
        assert np.mean(status == Status.CUT) < 0.03


@pytest.fixture(scope="module")
def shaft():
    """The stepped shaft's frame, cold, and the rows of each unbroken part of its line."""
    scene = load_scene("stepped_shaft").cold()
    found = ray_search(scene, np.linspace(-11.0, 11.0, 4001), "newton")
    ok = found.status == SearchStatus.FOUND
    step = np.linalg.norm(np.diff(found.pixel, axis=0), axis=1)
    breaks = np.flatnonzero(~(step < 4.0 * np.nanmedian(step))) + 1
    image = render_frame(scene).radiance
    columns, parts = np.arange(image.shape[1]), []
    for run in np.split(np.arange(len(ok)), breaks):
        part = found.pixel[run[ok[run]]]
        if len(part) > 3:
            u, v = part[np.argsort(part[:, 0])].T
            parts.append(np.interp(columns, u, v, left=np.nan, right=np.nan))
    around = slice(int(np.nanmin(parts)) - 200, int(np.nanmax(parts)) + 200)  # dark beyond
    return image[around], np.array(parts) - around.start


def test_centres_that_the_stepped_shafts_edges_cut_are_not_ok(shaft):
    """Of 694 OK ones 154 were off by over 0.1 px, up to 1.8; of Steger's 760 of 1598."""
    for method in NAMES:
        image, truth = shaft
        line = line_centres(image, method)
        u, error, sigma = errors(line, truth)
        assert np.sum(error > WRONG_PX) <= (20 if method == "centre_of_gravity" else 5), method
        assert np.all(error < 0.3), method
        if method in COLUMNWISE:
            assert not np.any((error > 10.0 * sigma) & (error > 0.01)), method
        # Columns that see the line whole, far from its steps, lose none.
        for first, last in ((960, 1088), (1440, 1512)):
            assert (
                len(np.unique(np.rint(u[(u > first - 0.5) & (u < last + 0.5)]))) == last - first + 1
            ), method
        assert np.sum(line.status == Status.CUT) > 150, method
