"""The part of the report's page that tells of growth."""

from __future__ import annotations

from collections.abc import Sequence
from html import escape

from urbanforest_cli.export.page_table import (
    Column,
    Row,
    chip,
    count_cell,
    decimal,
    number_cell,
    table,
    text_cell,
    whole,
    words,
)

ENVIRONMENTS = {"both": "light and room", "shadow": "light", "markers": "room"}


def _explained(row: Row, key: str) -> str:
    return f"{words(row[key])}<br><small>{escape(row['meaning'])}</small>"


FATE_COLUMNS: list[Column] = [
    ("Fate", lambda row: _explained(row, "fate"), False),
    ("Plants", count_cell("plants"), True),
]
LIBRARY_COLUMNS: list[Column] = [
    ("Difference", lambda row: _explained(row, "figure"), False),
    ("Median", number_cell("median", 2), True),
    ("Worst tenth", number_cell("worst_tenth", 2), True),
]


def render_growth(growth: Row | None) -> str:
    """Return what became of the plants as HTML; nothing where they have not grown."""
    if growth is None:
        return ""
    fates = [row for row in growth["fates"] if row["plants"]]
    parts = [
        f'<p class="soft">{_lead(growth)}</p>',
        '<div class="side">',
        f"<div>{table(fates, FATE_COLUMNS, none='No plants.')}</div>",
        f"<div>{table(growth['heights'], _height_columns(growth['heights']), none='Nothing stands.')}</div>",
        "</div>",
        table(growth["species"], _size_columns(growth["species"]), none="Nothing stands."),
        '<p class="soft">Bars reach from the lowest tenth to the highest; the stroke is the median.</p>',
    ]
    library = growth.get("library")
    if library:
        parts.append(f"<h3>Library, held against {whole(library['compared'])} plants grown in their own place</h3>")
        if library["one_dead"]:
            parts.append(f"<p>{whole(library['one_dead'])} more stand in one of the two and died in the other.</p>")
        parts.append(table(library["figures"], LIBRARY_COLUMNS, none="None could be compared."))
    return "\n".join(parts)


def _lead(growth: Row) -> str:
    senses = ENVIRONMENTS.get(str(growth.get("environment")))
    told = ["Grown season by season" + (f" by {senses}" if senses else "")]
    if growth.get("year") is not None:
        told.append(f"shown in year {growth['year']} of the oldest plant")
    told.append(f"{whole(growth['internodes'])} internodes stand")
    account = growth.get("internodes_grown")
    if account:
        told.append(
            f"of {whole(account['generated'])} in the skeletons {whole(account['shed'])} were shed and "
            f"{whole(account['pruned'])} cut"
        )
    return escape("; ".join(told) + ".")


def _height_columns(rows: Sequence[Row]) -> list[Column]:
    most = max((row["trees"] + row["shrubs"] for row in rows), default=0) or 1

    def bars(row: Row) -> str:
        shown = [(row["trees"], "bar"), (row["shrubs"], "bar low")]
        drawn = [
            f'<span class="{kind}" style="width:{round(150 * count / most)}px"></span>'
            for count, kind in shown if count
        ]  # fmt: skip
        return "".join(drawn) + whole(row["trees"] + row["shrubs"])

    return [
        ("Height, m", lambda row: f"{row['from_m']:g}\u2013{row['to_m']:g}", False),
        ("Trees (green) and shrubs", bars, False),
    ]


def _size_columns(rows: Sequence[Row]) -> list[Column]:
    tallest = max((row["height_p90_m"] or 0 for row in rows), default=0) or 1
    widest = max((row["crown_diameter_p90_m"] or 0 for row in rows), default=0) or 1
    return [
        ("Species", lambda row: chip(row["colour"]) + f"<i>{escape(row['label'])}</i>", False),
        ("Habit", text_cell("habit"), False),
        ("Standing", count_cell("plants"), True),
        ("Height, m", lambda row: _range(row, "height", tallest), False),
        ("Crown diameter, m", lambda row: _range(row, "crown_diameter", widest), False),
        ("Stem, cm", lambda row: decimal(None if row["dbh_median_m"] is None else 100 * row["dbh_median_m"], 0), True),
        ("Internodes each", number_cell("internodes_mean", 0), True),
    ]


def _range(row: Row, name: str, largest: float) -> str:
    """Draw the range from the lowest tenth to the highest, and tell the median."""
    low, middle, high = (100 * (row[f"{name}_{key}_m"] or 0) / largest for key in ("p10", "median", "p90"))
    return (
        f'<span class="track"><i style="left:{low:.0f}%;width:{max(high - low, 1):.0f}%"></i>'
        f'<b style="left:{middle:.0f}%"></b></span> {decimal(row[f"{name}_median_m"], 1)}'
    )
