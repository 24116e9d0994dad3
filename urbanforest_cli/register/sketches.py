"""Zones that a person drew: each a placement unit of its own, on the ground of the lots it covers."""

from __future__ import annotations

from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.register.cleaning import id_order
from urbanforest_cli.register.envelopes import difference

SATURATED_COVER = 0.53
"""Share of the ground under the discs of a saturated random packing with the default radius law (mean 3.13 m,
variance 0.35 m2, saturated for a disc of mean radius); equal discs jam at 0.547 (Feder 1980)."""

Shapes = NDArray[Any]


def density_for_cover(coverage: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the density at which randomly placed crowns cover a share of the ground."""
    return np.minimum(1.0, np.asarray(coverage, dtype=np.float64) / SATURATED_COVER)


def numbers_of(column: pd.Series[Any], labels: NDArray[np.object_], where: object) -> NDArray[np.float64]:
    """Return a column ``coverage`` as numbers from 0 to 1, NaN where it is not set.

    Raises
    ------
    InputError
        A value is no number or outside 0 to 1.
    """
    values = np.full(len(column), np.nan)
    faults = []
    for row in np.flatnonzero(column.notna().to_numpy()):
        value = column.iloc[row]
        fits = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
        if fits and 0 <= float(value) <= 1:
            values[row] = float(value)
        else:
            faults.append(f"{labels[row]}: coverage is {value!r}")
    if faults:
        raise InputError(
            "column 'coverage' holds values that cannot be used",
            where=where,
            found="; ".join(faults[:10]),
            expected="a share of the ground from 0 to 1, or nothing",
        )
    return values


def stack_sketches(shapes: Shapes, ids: NDArray[np.object_]) -> Shapes:
    """Return sketches without overlaps: the one drawn last, by its id, lies on top.

    Parameters
    ----------
    shapes
        (n,) valid polygons in metres, None for none.
    """
    left = np.array(shapes, dtype=object)
    one, other = shapely.STRtree(left).query(left, predicate="intersects")
    for row, above in sorted(zip(one.tolist(), other.tolist(), strict=True)):
        if id_order(str(ids[above])) > id_order(str(ids[row])):
            left[row] = difference(left[row : row + 1], shapes[above : above + 1])[0]
    left[shapely.is_empty(left) | (shapely.get_dimensions(left) != 2)] = None
    return left


def lot_under(shapes: Shapes, lots: Shapes) -> NDArray[np.int64]:
    """Return the row of the lot under each shape's inner point, -1 where there is none."""
    under = np.full(len(shapes), -1, dtype=np.int64)
    present = np.flatnonzero(~shapely.is_missing(lots))
    if not len(present):
        return under
    point, lot = shapely.STRtree(lots[present]).query(shapely.point_on_surface(shapes), predicate="intersects")
    order = np.lexsort((-lot, point))
    under[point[order]] = present[lot[order]]
    return under
