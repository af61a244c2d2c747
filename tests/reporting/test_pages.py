"""Pages, tables and pictures show what they are given, whatever the names in it."""

import base64
import io
import re
from html.parser import HTMLParser
from xml.etree import ElementTree

import numpy as np
import pytest
from matplotlib.figure import Figure
from PIL import Image

from virtual_sensor.errors import InputError
from virtual_sensor.reporting.page import (
    Details,
    Listing,
    Page,
    Paragraph,
    Section,
    page_html,
    write_page,
)
from virtual_sensor.reporting.pictures import Panel, draw_picture, write_vector
from virtual_sensor.reporting.style import (
    COLOURS,
    colour,
    colours,
    drawable,
    write_beside,
    write_on_line,
)
from virtual_sensor.reporting.tables import Column, Link, TextTable, pair_table, text_table

NASTY = "<script>alert('1')</script> \"quoted\" & $x$ a|b \x1b[31m"


class Parsed(HTMLParser):
    """The elements, texts and links of a page, as Python's own parser reads them."""

    def __init__(self, html):
        super().__init__()
        self.elements, self.texts, self.ids, self.links, self.pictures = [], [], set(), [], []
        self.feed(html)

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        self.elements.append(tag)
        self.ids |= {given["id"]} if "id" in given else set()
        self.links += [given["href"]] if tag == "a" else []
        self.pictures += [given] if tag == "img" else []

    def handle_data(self, data):
        self.texts.append(data)


def panels():
    """Two panels of one cell and one of two, of plain colours."""

    def fill(value):
        return lambda axes: axes.imshow(np.full((2, 2), value), vmin=0, vmax=1, aspect="auto")

    return [Panel("a", fill(0), "is a"), Panel("b", fill(1), "is b"), Panel("c", fill(0), NASTY, 2)]


@pytest.fixture(scope="module")
def picture():
    """A drawn picture."""
    return draw_picture("Title " + drawable(NASTY), panels())


def test_a_picture_may_be_of_curves_and_letters(tmp_path):
    """Rationale: for a paper; a title with markup in it stays a title."""
    write_vector(tmp_path / "a.svg", drawable(NASTY), panels())
    root = ElementTree.parse(tmp_path / "a.svg").getroot()
    assert root.tag.endswith("svg")
    assert len(root.findall(".//{*}image")) == 3


def page(picture):
    """A page with a nasty name in every place that there is."""
    table = TextTable((NASTY, "b"), ((NASTY, Link(NASTY, "x y.html")), ("1", "2")), NASTY)
    content = (NASTY, table, picture, Listing((NASTY, Link(NASTY, "#second"))))
    more = Details(NASTY, (Paragraph((NASTY, Link("doi", "https://doi.org/1"), NASTY)), table))
    sections = (Section(NASTY, *content), Section("Second", more))
    return Page(NASTY, NASTY, sections, NASTY, {"version": NASTY, "llvm": None}, (NASTY,))


def test_names_of_users_are_escaped_in_every_place_of_a_page(picture):
    """Rationale: a scene called <script> must be read, not run."""
    html = page_html(page(picture))
    parsed = Parsed(html)
    assert "script" not in parsed.elements
    assert "\x1b" not in html
    shown = NASTY.replace("\x1b", "\\x1b")
    assert " ".join(parsed.texts).count(shown) >= 12


def test_a_page_holds_all_that_it_shows(picture):
    """Rationale: a page that is mailed arrives without the files beside it."""
    parsed = Parsed(page_html(page(picture)))
    assert len(parsed.pictures) == 3
    for shown, drawn in zip(parsed.pictures, picture.panels, strict=True):
        kind, _, data = shown["src"].partition(",")
        assert kind == "data:image/png;base64"
        assert base64.b64decode(data) == drawn.png
        assert shown["alt"]
        assert (int(shown["width"]), int(shown["height"])) == (drawn.width_px, drawn.height_px)


def test_links_within_a_page_lead_somewhere(picture):
    """Rationale: contents that lead nowhere are worse than none."""
    parsed = Parsed(page_html(page(picture)))
    inside = [link[1:] for link in parsed.links if link.startswith("#")]
    assert len(inside) == 3
    assert set(inside) <= parsed.ids


def test_a_page_says_its_command_and_versions(picture):
    """Rationale: a result that can't be made again is an anecdote."""
    given = Page("t", "l", (), "virtual-sensor measure 'a b'", {"mitsuba": "3.9.1", "llvm": None})
    texts = " ".join(Parsed(page_html(given)).texts)
    assert "virtual-sensor measure 'a b'" in texts
    assert "mitsuba: 3.9.1" in texts
    assert "llvm" not in texts


def test_a_page_is_written_whole_or_not_at_all(tmp_path):
    """Rationale: half a page looks like a result."""
    with pytest.raises(InputError):
        write_page(tmp_path / ("n" * 300), Page("t", "l", (), "c", {}))
    assert list(tmp_path.iterdir()) == []


def test_panels_are_cut_from_the_picture_that_was_drawn(picture):
    """Rationale: what the page shows is what the file beside it shows."""
    whole = np.asarray(Image.open(io.BytesIO(picture.png)))
    heights = set()
    for part, (row, column) in zip(picture.panels, ((0, 0), (0, 1), (1, 0)), strict=True):
        image = np.asarray(Image.open(io.BytesIO(part.png)))
        assert image.shape == (part.height_px, part.width_px, 3)
        top = whole.shape[0] - (2 - row) * part.height_px
        left = column * whole.shape[1] // 2
        cut = whole[top : top + part.height_px, left : left + part.width_px]
        np.testing.assert_array_equal(cut, image)
        heights.add(part.height_px)
    assert len(heights) == 1


def test_one_table_says_the_same_in_every_form():
    """Rationale: a figure in README, page and console is one figure."""
    rows = [{"name": "a|b <i>", "rms_px": 0.00123, "ok": True}, {"name": "c", "rms_px": np.nan}]
    rows[1]["ok"] = None
    table = text_table(rows, ["name", Column("rms_px", shape="{:.4f}"), Column("ok", nothing="-")])
    assert table.head == ("name", "rms in px", "ok")
    assert table.rows == (("a|b <i>", "0.0012", "yes"), ("c", "", "-"))
    first = table.markdown().splitlines()[2]
    assert re.split(r"(?<!\\)\|", first)[1:-1] == [" a\\|b &lt;i> ", " 0.0012 ", " yes "]
    html = page_html(Page("", "", (Section("", table),), "", {}))
    html = html.partition("<main>")[2].partition("</main>")[0]
    texts = [text.strip() for text in Parsed(html).texts if text.strip()]
    assert texts == ["name", "rms in px", "ok", "a|b <i>", "0.0012", "yes", "c", "-"]
    columns = [list(column.cells) for column in table.rich().columns]
    assert columns == [["a|b <i>", "c"], ["0.0012", ""], ["yes", "-"]]


def test_a_table_whose_rows_differ_in_length_is_refused():
    """Rationale: a cell too few moves all others under the wrong heading."""
    with pytest.raises(ValueError, match="has not 2 cells"):
        TextTable(("a", "b"), (("1",),))


def test_a_thing_has_one_colour_and_several_things_have_several():
    """Rationale: who has learnt that hot is red must not unlearn it on the next page."""
    assert colour("hot") == COLOURS["hot"]
    assert colour("my.module:detector") == colour("my.module:detector")
    given = colours(["hot", "mine", "yours", "cold"])
    assert given["hot"] == COLOURS["hot"]
    assert given["cold"] == COLOURS["cold"]
    assert len(set(given.values())) == 4


def test_colours_are_told_apart_by_any_eye():
    """Rationale: one man in twelve sees red and green alike (simulated as Machado et al. 2009)."""
    from matplotlib.colors import to_rgb

    deuteranopia = np.array(
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.011820, 0.042940, 0.968881],
        ]
    )
    protanopia = np.array(
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ]
    )
    together = (
        ("cold", "hot", "search"),
        ("resolved", "blurred", "widened"),
        ("straight", "first_order", "marched", "tabulated"),
        ("parabola", "log_parabola", "centre_of_gravity", "gaussian", "max_likelihood"),
    )

    def linear(value):
        value = np.asarray(value)
        return np.where(value <= 0.04045, value / 12.92, ((value + 0.055) / 1.055) ** 2.4)

    for group in together:
        seen = linear([to_rgb(COLOURS[name]) for name in group])
        for matrix in (np.eye(3), deuteranopia, protanopia):
            shown = np.clip(seen @ matrix.T, 0.0, 1.0) ** (1.0 / 2.4)
            apart = np.linalg.norm(shown[:, None] - shown[None], axis=-1)
            assert apart[~np.eye(len(group), dtype=bool)].min() > 0.12, group


def test_pairs_are_a_table_with_a_word_for_what_is_not_there():
    """Rationale: a setting that was not given must not look like a text "None"."""
    table = pair_table(("setting", "value"), {"gain": 0.5, "noise": None, "own": True}, "not given")
    assert table.rows == (("gain", "0.5"), ("noise", "not given"), ("own", "yes"))


def test_words_stand_beside_their_point_and_above_their_line():
    """Rationale: words on a marker hide it, and are not read themselves."""
    axes = Figure().add_subplot()
    axes.set(xlim=(0.0, 1.0), ylim=(0.0, 1.0))
    for offset in ((5.0, 0.0), (-5.0, 0.0), (0.0, 9.0)):
        write_beside(axes, "words", (0.5, 0.5), offset)
    for right in (False, True):
        write_on_line(axes, "words", 0.5, right)
    axes.figure.canvas.draw()
    x, y = axes.transData.transform((0.5, 0.5))
    after, before, above, left, right = (text.get_window_extent() for text in axes.texts)
    assert after.x0 > x > before.x1
    assert above.x0 < x < above.x1
    assert left.x1 < x < right.x0
    assert min(each.y0 for each in (above, left, right)) > y
