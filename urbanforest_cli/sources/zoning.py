"""Which zoning polygon covers most of each lot."""

from __future__ import annotations

from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

SAME_SHARE = 1e-6

Shapes = NDArray[Any]


def covering(lots: Shapes, areas: Shapes) -> NDArray[np.int64]:
    """Return for each lot the row of the area that covers more of it than any other, or than none.

    Of areas that cover a lot equally, as a park inside a quarter does, the smaller counts.

    Parameters
    ----------
    lots, areas
        Valid polygons in one CRS; equal units either way.

    Returns
    -------
    (n,) int64, -1 where most of a lot lies in no area.
    """
    result = np.full(len(lots), -1, dtype=np.int64)
    if len(areas) == 0 or len(lots) == 0:
        return result
    shapely.prepare(areas)
    lot, area = shapely.STRtree(areas).query(lots, predicate="intersects")
    sizes = shapely.area(lots)
    whole = shapely.covers(areas[area], lots[lot])
    common = np.where(whole, sizes[lot], 0.0)
    common[~whole] = shapely.area(shapely.intersection(lots[lot[~whole]], areas[area[~whole]]))
    shares = np.round(common / sizes[lot] / SAME_SHARE) * SAME_SHARE
    order = np.lexsort((area, shapely.area(areas)[area], -shares, lot))
    lot, area, shares = lot[order], area[order], shares[order]
    first = np.r_[True, lot[1:] != lot[:-1]] if len(lot) else np.zeros(0, dtype=bool)
    # Areas may lie over one another, so the ground in none of them is measured only where no share is over half.
    best_lot, best_area, best_share = lot[first], area[first], shares[first]
    for place in np.flatnonzero(best_share < 0.5):
        row = best_lot[place]
        bare = (
            1.0 - shapely.area(shapely.intersection(lots[row], shapely.union_all(areas[area[lot == row]]))) / sizes[row]
        )
        if bare > best_share[place]:
            best_area[place] = -1
    result[best_lot] = best_area
    return result


def majority(lots: Shapes, things: Shapes, codes: NDArray[Any]) -> NDArray[Any]:
    """Return for each lot the code of the things in it that take most ground, None where there are none."""
    result = np.full(len(lots), None, dtype=object)
    given = np.array([code is not None and code == code for code in codes], dtype=bool)
    if not given.any() or len(lots) == 0:
        return result
    things, codes = things[given], codes[given]
    names, number = np.unique(codes.astype(str), return_inverse=True)
    thing, lot = shapely.STRtree(lots).query(shapely.point_on_surface(things), predicate="intersects")
    pairs, where = np.unique(np.column_stack((lot, number[thing])), axis=0, return_inverse=True)
    weights = np.bincount(where.ravel(), weights=shapely.area(things)[thing], minlength=len(pairs))
    order = np.lexsort((pairs[:, 1], -weights, pairs[:, 0]))
    rows, first = np.unique(pairs[order, 0], return_index=True)
    result[rows] = names[pairs[order[first], 1]]
    return result
