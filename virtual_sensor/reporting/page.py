"""Pages: one HTML file with all that it shows, for any screen, in light and dark."""

from __future__ import annotations

import base64
import re
from collections.abc import Mapping
from dataclasses import dataclass
from functools import cache
from pathlib import Path
from typing import TYPE_CHECKING

from virtual_sensor.errors import printable
from virtual_sensor.files import written_whole
from virtual_sensor.records import Record, plain
from virtual_sensor.reporting.pictures import PanelPicture, Picture
from virtual_sensor.reporting.tables import Link, TextTable
from virtual_sensor.reporting.words import anchor

if TYPE_CHECKING:
    from jinja2 import Environment
    from markupsafe import Markup

PAGE = "report.html"
"""Name of the page of a folder of results."""

LIMITS = "What limits these figures"
"""What stands before their caveats."""


@dataclass(frozen=True)
class Listing:
    """A list of items, each a text or a link.

    Attributes
    ----------
    items : tuple of str or Link
    """

    items: tuple[str | Link, ...]


@dataclass(frozen=True)
class Details:
    """Content that is folded under a summary until it is asked for.

    Attributes
    ----------
    summary : str
    content : tuple
        As a section's.
    """

    summary: str
    content: tuple[Content, ...]


@dataclass(frozen=True)
class Paragraph:
    """A paragraph in which links stand among the words.

    Attributes
    ----------
    parts : tuple of str or Link
    """

    parts: tuple[str | Link, ...]


Content = str | Link | Paragraph | Listing | TextTable | Picture | PanelPicture | Details


class Section:
    """A part of a page under a heading of its own, which the contents list.

    Parameters
    ----------
    title : str
    *content : str, Link, Paragraph, Listing, TextTable, Picture, PanelPicture or Details
        In the order of reading. A text is a paragraph; of a `Picture`, its panels are shown.
    """

    def __init__(self, title: str, *content: Content) -> None:
        self.title = title
        self.content = content
        self.anchor = anchor(title)


@dataclass(frozen=True)
class Page:
    """What a page says.

    Attributes
    ----------
    title : str
    lead : str
        What the reader wants to know first, in one or two sentences.
    sections : tuple of Section
    command : str
        The exact command that the results come from.
    made_with : Record or mapping
        Versions and machine, by their names.
    notes : tuple of str
        What the reader should know besides; shown below the lead. What stands between backticks is
        code.
    caveats : tuple of str
        What limits the figures; shown before the notes, and marked so.
    """

    title: str
    lead: str
    sections: tuple[Section, ...]
    command: str
    made_with: Record | Mapping[str, object]
    notes: tuple[str, ...] = ()
    caveats: tuple[str, ...] = ()

    @property
    def facts(self) -> dict[str, object]:
        """What it was made with, one by one: records within it are opened."""
        return _opened(plain(self.made_with))


def write_page(path: Path, page: Page) -> None:
    """Write a page, which holds its pictures and its style; all of it or nothing.

    Raises
    ------
    InputError
        If it can't be written.
    """
    text = page_html(page)
    with written_whole(path) as temporary:
        temporary.write_text(text, encoding="utf-8", errors="backslashreplace")


def page_html(page: Page) -> str:
    """A page as HTML."""
    return _environment().get_template("report.html.j2").render(page=page)


def _opened(values: Mapping[str, object]) -> dict[str, object]:
    opened: dict[str, object] = {}
    for name, value in values.items():
        opened |= _opened(value) if isinstance(value, Mapping) else {name: value}
    return opened


@cache
def _environment() -> Environment:
    from jinja2 import Environment, FileSystemLoader, StrictUndefined

    environment = Environment(
        loader=FileSystemLoader(Path(__file__).with_name("templates")),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    environment.tests |= {
        kind.__name__.lower(): lambda value, kind=kind: isinstance(value, kind)
        for kind in (str, Link, Paragraph, Listing, TextTable, Picture, PanelPicture, Details)
    }
    environment.filters |= {
        "printable": lambda value: printable(str(value)),
        "prose": _prose,
        "base64": lambda data: base64.b64encode(data).decode("ascii"),
    }
    environment.globals["LIMITS"] = LIMITS
    return environment


def _prose(text: object) -> Markup:
    """A text as HTML, with code where it stands between backticks."""
    from markupsafe import Markup, escape

    words, *others = re.split(r"`([^`]+)`", printable(str(text)))
    found = escape(words)
    for code, words in zip(others[::2], others[1::2], strict=True):
        found += Markup("<code>{}</code>{}").format(code, words)
    return found
