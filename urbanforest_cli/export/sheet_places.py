"""Chooses the places of a sheet."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

STEPS_A_PLACE = 4
"""A place may stand anywhere on a grid of a quarter of its width."""


def densest_places(xy: NDArray[np.float64], within: shapely.Geometry, size_m: float, count: int) -> NDArray[np.float64]:
    """Return middles of squares that hold the most plants and do not overlap, (n, 2), the fullest first.

    Squares stand on a grid of a quarter of their width. Those that lie wholly in `within` are preferred; where there
    are none, or no plants, the middle of `within` is the one place.
    """
    west, south, east, north = np.nan_to_num(shapely.bounds(within))
    middle = np.array([[(west + east) / 2, (south + north) / 2]])
    inside = xy[shapely.contains_xy(within, xy[:, 0], xy[:, 1])] if len(xy) else xy
    if len(inside) == 0:
        return middle
    step = size_m / STEPS_A_PLACE
    corner = np.floor(inside.min(axis=0) / step).astype(np.int64)
    cell = np.floor(inside / step).astype(np.int64) - corner
    # Lower left cells from one place's width below the first plant on, so that every square with a plant is tried.
    shape = cell.max(axis=0) + 1
    grid = np.zeros(shape + 2 * (STEPS_A_PLACE - 1), dtype=np.int64)
    np.add.at(grid, tuple((cell + STEPS_A_PLACE - 1).T), 1)
    sums = np.lib.stride_tricks.sliding_window_view(grid, (STEPS_A_PLACE, STEPS_A_PLACE)).sum(axis=(2, 3))
    i, j = np.nonzero(sums)
    lower = (np.column_stack((i, j)) + corner - (STEPS_A_PLACE - 1)) * step
    squares = shapely.box(lower[:, 0], lower[:, 1], lower[:, 0] + size_m, lower[:, 1] + size_m)
    shapely.prepare(within)
    whole = shapely.covers(within, squares)
    order = np.lexsort((i, j, -sums[i, j], ~whole))
    chosen: list[NDArray[np.float64]] = []
    for place in order:
        if all(np.abs(lower[place] - other).max() >= size_m - 1e-6 for other in chosen):
            chosen.append(lower[place])
        if len(chosen) == count:
            break
    return np.array(chosen) + size_m / 2
