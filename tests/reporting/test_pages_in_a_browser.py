"""The pages' template in a real browser: it shows what it should, and faults are found.

The page of each command is opened in the test of that command (`faults_of`).
"""

import numpy as np

from virtual_sensor.reporting.page import Details, Listing, Page, Section, write_page
from virtual_sensor.reporting.pictures import Panel, draw_picture
from virtual_sensor.reporting.tables import Link, TextTable

NASTY = "<script>document.title = 'taken'; console.error('ran')</script> \"'&"


def page(*content):
    """A page of a picture and a table that are wider than a phone, and names that are code."""
    picture = draw_picture(
        "", [Panel("wide", lambda axes: axes.plot(np.arange(3)), "a line", width=2)], columns=2
    )
    table = TextTable(tuple("abcdefghijklm"), (tuple(["0.123456789"] * 13),), NASTY)
    more = Details(NASTY, (table, picture))
    sections = (Section(NASTY, picture, table, *content), Section("More", more))
    return Page(NASTY, NASTY, sections, NASTY * 9, {"a": NASTY}, (NASTY,))


def test_a_page_fits_every_screen_and_runs_nothing(faults_of, tab, tmp_path):
    """Rationale: tables scroll within themselves, and a name is a name."""
    write_page(tmp_path / "a.html", page(Listing((Link("more", "#more"), Link("self", "a.html")))))
    assert faults_of(tmp_path / "a.html") == []
    assert tab.title().startswith("<script>")


def test_faults_of_a_page_are_found(faults_of, tmp_path):
    """Rationale: a check that can't fail checks nothing."""
    broken = {
        '<img src="no.png" alt="none">': "pictures are missing",
        "<script>console.error('oh')</script>": "oh",
        "<script>no()</script>": "no is not defined",
        '<div style="width: 900px">wide</div>': "px wide",
        '<a href="#nowhere">there</a>': "#nowhere leads nowhere",
        '<a href="no.html">there</a>': "no.html is no file",
        "<style>body { background: #fff !important; color: #000 !important }</style>": "rgb",
    }
    path = tmp_path / "a.html"
    write_page(path, page())
    html = path.read_text(encoding="utf-8")
    path.write_text(html.replace("</main>", f"{''.join(broken)}</main>"), encoding="utf-8")
    found = "\n".join(faults_of(path))
    assert [fault for fault in broken.values() if fault not in found] == []
