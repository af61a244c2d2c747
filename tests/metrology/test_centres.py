"""Which statuses are those of a centre, and what is known where there is none."""

from dataclasses import replace

import numpy as np

import virtual_sensor as vs
from virtual_sensor.metrology.centres import FOUND, FOUND_NAMES
from virtual_sensor.studies.detect import CentreTable

STATUS = np.array([*vs.Status], np.uint8)
NUMBERS = ("sigma", "width", "amplitude", "background")


def _line():
    rows = 20.0 + 0.1 * np.arange(STATUS.size)
    known = dict.fromkeys(NUMBERS, np.ones(rows.size))
    return replace(vs.LineCentres.of_rows(rows), **known).judged(STATUS)


def test_a_centre_is_found_where_it_is_ok_clipped_or_corrected():
    line = _line()
    found = [vs.Status(number) for number in STATUS[line.found]]
    assert found == [*FOUND] == [vs.Status.OK, vs.Status.CLIPPED, vs.Status.CORRECTED]
    assert FOUND_NAMES == ("ok", "clipped", "corrected")
    np.testing.assert_array_equal(np.isfinite(line.pixel[:, 1]), line.found)
    assert repr(line) == "LineCentres: 1 of 15 ok, 1 clipped, 1 corrected, 1 ghost, rows 20 to 21.3"


def test_a_ghost_has_its_place_and_is_no_centre():
    line = _line()
    ghost = line.status == vs.Status.GHOST
    for name in ("row", *NUMBERS):
        np.testing.assert_array_equal(np.isfinite(getattr(line, name)), line.found | ghost, name)
    assert not line.found[ghost]
    assert np.isnan(line.pixel[ghost]).all()
    assert np.isfinite(CentreTable.of(line).row_px[ghost])


def test_what_is_not_quite_ok_is_compared_with_the_truth():
    line = _line()
    errors = vs.compare_line(line, 20.0 + 0.1 * np.arange(STATUS.size), end_px=-1.0)
    np.testing.assert_array_equal(errors.column, np.flatnonzero(line.found))
    assert vs.Status.GHOST in errors.lost
    assert not {*errors.lost} & {*FOUND}


def test_a_users_detector_may_give_a_ghost_but_none_off_the_image():
    def detector(image):
        line = vs.LineCentres.of_rows(np.full(3, 5.0))
        status = np.array([vs.Status.GHOST, vs.Status.CLIPPED, vs.Status.GHOST])
        return replace(line, row=np.array([5.0, 6.0, 99.0]), status=status.astype(np.uint8))

    line = vs.line_centres(np.ones((10, 3)), detector)
    expected = [vs.Status.GHOST, vs.Status.CLIPPED, vs.Status.POOR_FIT]
    assert [*vs.Status.of(line.status)] == expected
    np.testing.assert_array_equal(line.row, [5.0, 6.0, np.nan])
