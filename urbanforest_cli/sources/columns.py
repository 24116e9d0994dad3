"""Columns by any of the names they may bear, in plain, nested or packed form, and the numbers people write in them."""

from __future__ import annotations

import difflib
import re
from collections.abc import Sequence
from typing import Any

import numpy as np
import pandas as pd
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.sources.osm import TAGS_COLUMN, tag_values
from urbanforest_cli.sources.overture import nested_values

FOOT_M = 0.3048
INCH_M = 0.0254
_NUMBER = r"[-+]?(?:\d+(?:[.,]\d+)?|[.,]\d+)"
_MEASURE = re.compile(rf"^\s*~?\s*({_NUMBER})\s*(m|metres?|meters?|cm|ft|feet|foot|')?\s*$", re.IGNORECASE)
_FEET_AND_INCHES = re.compile(rf"^\s*(\d+)\s*(?:'|ft)\s*({_NUMBER})\s*(?:\"|''|in)?\s*$", re.IGNORECASE)


def find_column(frame: pd.DataFrame, names: Sequence[str]) -> pd.Series[Any] | None:
    """Return the first column there is under one of the names, whatever their capitals, hyphens and underscores.

    A name with a dot reaches into nested values (Overture: ``names.primary``); a name that is no column is sought
    among packed tags (OSM: ``other_tags``).
    """
    by_name = {_spelling(str(name)): name for name in reversed(list(frame.columns))}
    for name in names:
        own = by_name.get(_spelling(name))
        if own is not None:
            return frame[own]
        head, dot, rest = name.partition(".")
        if dot and _spelling(head) in by_name:
            return nested_values(frame[by_name[_spelling(head)]], rest)
        if TAGS_COLUMN in frame.columns:
            values = tag_values(frame[TAGS_COLUMN], name)
            if values.notna().any():
                return values
    return None


def first_values(frame: pd.DataFrame, names: Sequence[str]) -> pd.Series[Any] | None:
    """Return for each row the first value there is in the columns of these names; None where no column is there."""
    result: pd.Series[Any] | None = None
    for name in names:
        column = find_column(frame, (name,))
        if column is not None:
            column = column.astype(object)
            result = column if result is None else result.where(result.notna(), column)
    return result


def _spelling(name: str) -> str:
    return re.sub(r"[\W_]", "", name.casefold())


def require_column(frame: pd.DataFrame, names: Sequence[str], *, where: object, option: str) -> pd.Series[Any]:
    """Return a column a person named, or tell which there are.

    Raises
    ------
    InputError
        There is none of that name.
    """
    column = find_column(frame, names)
    if column is None:
        present = [str(name) for name in frame.columns if name != "geometry"]
        near = difflib.get_close_matches(names[0], present, n=1)
        raise InputError(
            f"no column {names[0]!r}",
            where=where,
            found=", ".join(present[:30]) or "no columns",
            next_step=f"did you mean {option} {near[0]}?" if near else f"give another with {option}",
        )
    return column


def metres(column: pd.Series[Any], factor: float = 1.0) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Read lengths: numbers, or texts like ``12 m``, ``12,5``, ``40 ft``, ``39'4"``.

    Parameters
    ----------
    factor
        Metres in one unit of a bare number.

    Returns
    -------
    Lengths in metres, NaN where there is none; and which cells hold something that is no length above 0.
    """
    if pd.api.types.is_numeric_dtype(column.dtype):
        values = column.to_numpy(dtype=np.float64, na_value=np.nan) * factor
        given = ~np.isnan(values)
    else:
        values = np.array([_metres(value, factor) for value in column], dtype=np.float64)
        given = np.array([value is not None and value == value and str(value).strip() != "" for value in column], bool)
    with np.errstate(invalid="ignore"):
        good = np.isfinite(values) & (values > 0)
    return np.where(good, values, np.nan), np.asarray(given & ~good)


def _metres(value: object, factor: float) -> float:
    text = str(value)
    match = _FEET_AND_INCHES.match(text)
    if match:
        return int(match[1]) * FOOT_M + float(match[2].replace(",", ".")) * INCH_M
    match = _MEASURE.match(text)
    if not match:
        return float("nan")
    number = float(match[1].replace(",", "."))
    unit = (match[2] or "").lower()
    if unit == "cm":
        return number / 100
    if unit in ("ft", "feet", "foot", "'"):
        return number * FOOT_M
    return number if unit else number * factor


def counts(column: pd.Series[Any]) -> NDArray[np.float64]:
    """Read numbers of storeys or lanes; NaN where there is none above 0."""
    values, _ = metres(column)
    return values
