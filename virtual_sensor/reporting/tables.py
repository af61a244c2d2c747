"""Tables as people read them: one table as Markdown and on the console; `page` has it as HTML."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Any

from virtual_sensor.records import Record, Table
from virtual_sensor.reporting.words import heading, in_words

if TYPE_CHECKING:
    from rich.table import Table as RichTable


@dataclass(frozen=True)
class Column:
    """How a table's column is shown.

    Attributes
    ----------
    name : str
        Of the column or key in the data; dots lead into nested records.
    heading : str
        By default the name's own words with their unit.
    shape : str or callable
        Format of its numbers, or what makes words of them.
    nothing : str
        What stands where there is no answer.
    """

    name: str
    heading: str = ""
    shape: str | Callable[[Any], str] = "{:.3g}"
    nothing: str = ""

    @property
    def head(self) -> str:
        """The heading."""
        return self.heading or heading(self.name)


@dataclass(frozen=True)
class TextTable:
    """A table of texts.

    Attributes
    ----------
    head : tuple of str
    rows : tuple of tuple of str
        A cell that is a `Link` is one on a page, and its text in Markdown and on the console.
    caption : str
    emphasised : tuple of bool
        Rows that are to be seen first; () for none.
    numeric : tuple of bool
        Columns whose cells stand at the right; () for none.
    """

    head: tuple[str, ...]
    rows: tuple[tuple[str | Link, ...], ...]
    caption: str = ""
    emphasised: tuple[bool, ...] = ()
    numeric: tuple[bool, ...] = field(default=())

    def __post_init__(self) -> None:
        wrong = [row for row in self.rows if len(row) != len(self.head)]
        if wrong:
            raise ValueError(
                f"{self.caption or 'table'}: {wrong[0]} has not {len(self.head)} cells"
            )

    def markdown(self) -> str:
        """The table in GitHub's Markdown, without its caption."""
        lines = [self.head, ("---",) * len(self.head), *self.rows]
        return "".join(f"| {' | '.join(map(_in_markdown, cells))} |\n" for cells in lines)

    def rich(self) -> RichTable:
        """The table for the console."""
        from rich.table import Table as RichTable

        table = RichTable(title=self.caption or None, title_justify="left")
        for i, name in enumerate(self.head):
            right = bool(self.numeric) and self.numeric[i]
            table.add_column(name, justify="right" if right else "left")
        for i, row in enumerate(self.rows):
            bold = bool(self.emphasised) and self.emphasised[i]
            table.add_row(*map(str, row), style="bold" if bold else None)
        return table


@dataclass(frozen=True)
class Link:
    """A link, within its page (``#anchor``), to a file beside it, or to an address.

    Attributes
    ----------
    text, url : str
    """

    text: str
    url: str

    def __str__(self) -> str:
        return self.text


def text_table(
    rows: Table | Iterable[Record | Mapping[str, Any]],
    columns: Sequence[Column | str],
    caption: str = "",
    emphasised: Sequence[bool] = (),
) -> TextTable:
    """The rows of a table, of records or of mappings as texts.

    Parameters
    ----------
    rows : Table, or iterable of Record or mapping
    columns : sequence of Column or str
        Those that are shown, in order; a name alone has its own words as heading.
    caption : str
    emphasised : sequence of bool
        For each row whether it is to be seen first.
    """
    shown = [Column(c) if isinstance(c, str) else c for c in columns]
    values = [[_value(row, c.name) for c in shown] for row in _rows(rows)]
    cells = tuple(
        tuple(
            value if isinstance(value, Link) else in_words(value, c.shape, c.nothing)
            for value, c in zip(row, shown, strict=True)
        )
        for row in values
    )
    numeric = tuple(
        bool(values) and all(not isinstance(row[i], str | Link) for row in values)
        for i in range(len(shown))
    )
    return TextTable(tuple(c.head for c in shown), cells, caption, tuple(emphasised), numeric)


def pair_table(
    head: tuple[str, str], values: Mapping[str, Any], nothing: str = "none"
) -> TextTable:
    """Names and what each of them is, a row each."""
    rows = ((name, in_words(value, "{}", nothing)) for name, value in values.items())
    return TextTable(head, tuple(rows))


def _rows(rows: Any) -> Iterable[Any]:
    return rows.rows() if isinstance(rows, Table) else rows


def _value(row: Any, name: str) -> Any:
    """Value of a row under a name with dots; None where one of its parts is None."""
    for part in name.split("."):
        if row is None:
            return None
        row = row.get(part) if isinstance(row, Mapping) else getattr(row, part)
    return row


def _in_markdown(cell: str | Link) -> str:
    """A cell's text: no end of the cell, no HTML, no emphasis of its own."""
    text = " ".join(str(cell).split()).replace("\\", "\\\\")
    for letter in "|*`":
        text = text.replace(letter, f"\\{letter}")
    return text.replace("<", "&lt;")
