"""Names, numbers and times say what they say in the words that people read."""

import textwrap

import numpy as np

from virtual_sensor.reporting.words import (
    anchor,
    capital,
    counted,
    heading,
    in_words,
    time_in_words,
    unbroken,
)


def test_names_become_headings_with_their_unit():
    """Rationale: words and units are added where data are shown, and nowhere below."""
    for name, words in (
        ("rms_px", "rms in px"),
        ("largest_shift_um", "largest shift in µm"),
        ("point_mm_x", "point x in mm"),
        ("shift_um_norm", "shift norm in µm"),
        ("temperature_c", "temperature in °C"),
        ("gradient_per_mm", "gradient in 1/mm"),
        ("status", "status"),
        ("pixel_u", "pixel u"),
        ("mm", "in mm"),
        ("items", "items"),
    ):
        assert heading(name) == words


def test_what_has_no_answer_is_said():
    """Rationale: an empty cell may be a mistake; "none" is an answer."""
    for value, words in (
        (None, "none"),
        (np.nan, "none"),
        (np.float32("nan"), "none"),
        (0.12345, "0.1235"),
        (True, "yes"),
        (np.False_, "no"),
        ("a\x1b[31m", "a\\x1b[31m"),
    ):
        assert in_words(value) == words
    assert in_words(None, nothing="") == ""


def test_times_have_the_unit_that_they_are_read_in():
    """Rationale: 0.000232 s says less than 232 µs."""
    for seconds, words in (
        (2.32e-4, "232 µs"),
        (7.2e-9, "7.2 ns"),
        (0.5, "500 ms"),
        (12.0, "12 s"),
        (300.0, "5 min"),
        (np.nan, "unknown"),
        (None, "unknown"),
    ):
        assert time_in_words(seconds) == words


def test_one_is_counted_in_the_singular():
    """Rationale: "1 columns" makes a reader stop."""
    assert [counted(n, "column") for n in (0, 1, 2)] == ["0 columns", "1 column", "2 columns"]
    assert counted(2, "index", "indices") == "2 indices"


def test_links_within_a_page_are_plain_letters():
    """Rationale: a browser finds no anchor with a quote in it."""
    assert anchor('Where & why: "B - A" <i>') == "where-why-b-a-i"
    assert anchor("µ") == "section"


def test_words_begin_a_sentence_and_stay_on_a_line():
    """Rationale: an empty text has no first letter, and a number is not parted from its unit."""
    assert (capital("the mm"), capital("")) == ("The mm", "")
    assert textwrap.wrap("of " + unbroken("3 x 4 mm"), 5, break_long_words=False)[1:] == [
        "3\xa0x\xa04\xa0mm"
    ]


def test_a_sentence_begins_with_a_capital_but_a_name_stays():
    """Rationale: "Hot_bracket_air.nc" is no file."""
    assert capital("in hot air") == "In hot air"
    for told in ("hot_air.nc: coarse", "air.nc: coarse", "laser_line: not lit"):
        assert capital(told) == told
    assert capital("none. All is well") == "None. All is well"
