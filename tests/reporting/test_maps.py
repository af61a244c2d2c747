"""Maps are read off as they are: a number's colour, the pixels shown, and what is counted."""

import cv2
import numpy as np
import pytest
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from virtual_sensor.metrology.centres import Status
from virtual_sensor.reporting.maps import (
    draw_frames,
    draw_map,
    draw_statuses,
    map_panel,
    scale_of,
    window_of,
)
from virtual_sensor.reporting.pictures import Panel, draw_picture, write_vector


@pytest.fixture
def axes():
    figure = Figure(figsize=(6.0, 4.2))
    FigureCanvasAgg(figure)
    return figure.add_subplot()


def test_a_few_values_far_off_leave_the_scale_as_it_is_and_are_told():
    values = np.linspace(-1.0, 3.0, 1000).reshape(20, 50)
    assert scale_of("signed", values).low == pytest.approx(-3.0)
    assert scale_of("signed", values).beyond == "neither"
    values[0, 0] = -500.0
    signed = scale_of("signed", values)
    assert -signed.low == signed.high == pytest.approx(3.0, abs=0.1)
    assert signed.beyond in ("min", "both")
    span = scale_of("span", values)
    assert span.low == pytest.approx(-1.0, abs=0.1)
    assert (span.high, span.beyond) == (3.0, "min")
    assert scale_of("size", np.abs(values)).low == 0.0


def test_maps_that_are_compared_share_one_scale_and_one_window():
    one, other = np.full((40, 60), np.nan), np.full((40, 60), np.nan)
    one[10:20, 30:35], other[12:30, 32:40] = 2.0, -5.0
    scale = scale_of("signed", one, other)
    assert (scale.low, scale.high) == (-5.0, 5.0)
    rows, columns = window_of(one, other)
    assert (rows.start, rows.stop, columns.start, columns.stop) == (9, 31, 29, 41)
    strip = np.full((400, 600), np.nan)
    strip[200:204, 100:301] = 1.0
    rows, columns = window_of(strip)
    assert (rows.start + rows.stop) // 2 == 202
    assert 100 <= rows.stop - rows.start <= 110
    assert (columns.start, columns.stop) == (94, 307)
    assert window_of(one * np.nan) == (slice(0, 40), slice(0, 60))


def test_constant_and_empty_maps_have_a_scale():
    for kind in ("signed", "size", "span"):
        for values in (np.zeros((3, 3)), np.full((3, 3), 7.0), np.full((3, 3), np.nan)):
            scale = scale_of(kind, values)
            assert scale.low < scale.high, (kind, values)


def test_each_pixel_stands_where_it_is_in_the_image(axes):
    """Rationale: pixel centres are whole numbers, in a window and thinned out as well."""
    values = np.full((1300, 1400), np.nan)
    values[100:1300, 200:1400] = 1.0
    values[700:712, 800:812] = 9.0
    draw_map(axes, values, "height in mm", window=(slice(100, 1300), slice(200, 1400)))
    drawn = axes.images[0]
    left, right, bottom, top = drawn.get_extent()
    assert (left, right, bottom, top) == (199.5, 1399.5, 1299.5, 99.5)
    row, column = np.argwhere(drawn.get_array() == 9.0)[0]
    height = (bottom - top) / drawn.get_array().shape[0]
    assert top + row * height <= 700 < top + (row + 1) * height
    assert left + column * height <= 800 < left + (column + 1) * height
    assert axes.figure.axes[1].get_ylabel() == "height in mm"


def test_very_small_numbers_have_their_power_beside_the_bar(axes):
    """Rationale: matplotlib writes it above the bar, over the map."""
    draw_map(axes, np.linspace(0.0, 4e-6, 12).reshape(3, 4), "W", "size")
    axes.figure.canvas.draw()
    bar = axes.figure.axes[1]
    assert bar.get_ylabel() == "W in 10⁻⁶"
    assert [text.get_text() for text in bar.get_yticklabels()][:3] == ["0", "0.5", "1"]


def test_panels_of_maps_are_drawn_as_pixels_and_as_curves(tmp_path):
    """Rationale: the map is as wide as its pixels are, with the bar close beside it."""
    tall, wide = np.ones((60, 20)), np.ones((20, 60))
    for values in (tall, wide):
        panel = map_panel("a map", values, "mm")
        figure = Figure(figsize=(6.0, 4.2))
        panel.draw(figure)
        shown, bar = (axes.get_position() for axes in figure.axes)
        shape = shown.width * 6.0 / (shown.height * 4.2)
        rows, columns = window_of(values)
        expected = (columns.stop - columns.start) / (rows.stop - rows.start)
        assert shape == pytest.approx(expected)
        assert bar.x0 - shown.x1 == pytest.approx(0.02)
        assert bar.x1 < 0.9
    write_vector(tmp_path / "map.svg", "", [panel])
    assert (tmp_path / "map.svg").stat().st_size > 1000


def test_pixels_without_a_value_are_no_colour_of_the_bar(axes):
    values = np.array([[np.nan, 1.0], [2.0, 3.0]])
    draw_map(axes, values, "mm", "signed", (slice(0, 2), slice(0, 2)))
    drawn = axes.images[0]
    paint = drawn.to_rgba(drawn.get_array())
    assert np.ptp(paint[0, 0, :3]) == 0.0
    assert not any(np.allclose(paint[0, 0], other) for other in drawn.cmap(np.linspace(0, 1, 256)))


def test_statuses_are_counted_beside_their_map(axes):
    status = np.full((50, 40), Status.OK, np.uint8)
    status[:, :3] = Status.SATURATED
    draw_statuses(axes, status, Status)
    labels = [text.get_text() for text in axes.get_legend().get_texts()]
    assert labels == ["ok: 1\u202f850", "saturated: 150"]
    paints = [patch.get_facecolor() for patch in axes.get_legend().get_patches()]
    drawn = axes.images[0]
    shown = drawn.to_rgba(drawn.get_array())
    np.testing.assert_allclose(shown[0, -1], paints[0], atol=0.01)
    np.testing.assert_allclose(shown[0, 0], paints[1], atol=0.01)


def test_frames_stand_beside_each_other_with_one_white(axes):
    """Rationale: a frame that is half as bright looks it."""
    images = np.stack([np.full((30, 40), level) for level in (1.0, 0.5, 0.0, 0.25, 0.75, 0.1)])
    names = [f"frame {n}" for n in range(6)]
    draw_frames(axes, images, names)
    assert [text.get_text() for text in axes.texts] == names
    (sheet,) = axes.images
    grey = sheet.get_array().filled(np.nan)
    for level, text in zip((1.0, 0.5, 0.0, 0.25, 0.75, 0.1), axes.texts, strict=True):
        column, above = text.get_position()
        assert grey[int(above) + 5, int(column) + 5] == pytest.approx(level)


def test_frames_of_any_number_are_drawn(axes):
    for count in (1, 3, 16, 24, 42):
        axes.clear()
        draw_frames(axes, np.zeros((count, 8, 8), np.float32), ["x"] * count)
        assert len(axes.texts) == count


def test_titles_of_narrow_maps_are_whole():
    """Rationale: that of a tall map began at its axes, and was cut off at the picture's border."""
    image = np.arange(60.0).reshape(20, 3)
    title = "beta=30 temperature=1250: 2.11 µm rms"
    panel = Panel(title, lambda axes: draw_map(axes, image, "µm"), "")
    picture = draw_picture("", [panel])
    grey = cv2.imdecode(np.frombuffer(picture.png, np.uint8), cv2.IMREAD_GRAYSCALE)
    assert grey[:, -3:].min() == 255
    assert grey[:3].min() == 255
