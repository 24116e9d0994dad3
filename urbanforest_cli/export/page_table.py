"""Tables, numbers and words as the report's page shows them."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from html import escape
from typing import Any

Row = Mapping[str, Any]
Cell = Callable[[Row], str]
Column = tuple[str, Cell, bool]
"""Heading, what stands in a cell as HTML, and whether it is a number."""


def table(rows: Sequence[Row], columns: Sequence[Column], *, none: str = "None.") -> str:
    """Return rows as an HTML table, or a line where there are none."""
    if not rows:
        return f'<p class="none">{escape(none)}</p>'
    marks = [' class="n"' if number else "" for _, _, number in columns]
    head = "".join(f"<th{mark}>{escape(name)}</th>" for mark, (name, _, _) in zip(marks, columns, strict=True))
    body = "\n".join(
        "<tr>" + "".join(f"<td{mark}>{cell(row)}</td>" for mark, (_, cell, _) in zip(marks, columns, strict=True))
        + "</tr>" for row in rows
    )  # fmt: skip
    return f"<table><thead><tr>{head}</tr></thead>\n<tbody>\n{body}\n</tbody></table>"


def whole(value: Any) -> str:
    """Return a whole number; a dash for None."""
    return "\u2013" if value is None else f"{value:,.0f}"


def decimal(value: Any, decimals: int) -> str:
    """Return a number with decimals; a dash for None."""
    return "\u2013" if value is None else f"{value:,.{decimals}f}"


def percent(value: Any) -> str:
    """Return a share in percent; a dash for None."""
    return "\u2013" if value is None else f"{100 * value:.1f}\u202f%"


def text_cell(key: str) -> Cell:
    """Show what stands under a key as text."""
    return lambda row: escape(str(row.get(key, "")))


def count_cell(key: str) -> Cell:
    """Show a whole number."""
    return lambda row: whole(row.get(key))


def number_cell(key: str, decimals: int) -> Cell:
    """Show a number with decimals."""
    return lambda row: decimal(row.get(key), decimals)


def share_cell(key: str) -> Cell:
    """Show a share in percent."""
    return lambda row: percent(row.get(key))


def chip(colour: str, shape: str = "") -> str:
    """Return a spot of colour."""
    return f'<span class="chip{shape}" style="background:{escape(colour)}"></span>'


def words(code: str) -> str:
    """Return a code as words."""
    return escape(code.replace("_", " "))
