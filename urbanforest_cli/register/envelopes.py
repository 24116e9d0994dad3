"""Envelopes, and areas less other areas.

Distances are true ones. A buffer's arcs are chords, which would let plants come nearer than asked; here the radius is
enlarged so that every chord stays outside the true arc, by at most 8 mm. Notches of a wall shallower than a hundredth
of the distance may be bridged, which makes an envelope wider there, never narrower.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.errors import GEOSException

ARC_EXCESS_M = 0.008
WIDEST_STEP = 0.75
"""Half of the widest arc step that GEOS takes, in steps of 90 degrees / quad_segs: it rounds their number, so that a
corner that turns by just under 1.5 steps gets one."""
SLIVER_M = 0.02
RESCUE_GRID_M = 1e-6

Shapes = NDArray[Any]


def arc_segments(distance_m: float) -> int:
    """Return into how many chords a quarter circle is cut so that the excess stays below 8 mm."""
    if distance_m <= 0:
        return 1
    widest = math.acos(distance_m / (distance_m + ARC_EXCESS_M))
    return max(2, math.ceil(WIDEST_STEP * math.pi / 2 / widest))


def outer_distance(distance_m: float) -> float:
    """Return the radius whose chords stay outside the arc of `distance_m`."""
    return distance_m / math.cos(WIDEST_STEP * math.pi / 2 / arc_segments(distance_m))


def outer_buffer(shapes: Shapes, distance_m: float) -> Shapes:
    """Return areas that hold every point nearer than `distance_m`, and few others.

    Parameters
    ----------
    shapes
        (n,) geometries in metres.
    """
    if distance_m == 0:
        return np.asarray(shapes, dtype=object)
    wide = shapely.buffer(shapes, outer_distance(distance_m), quad_segs=arc_segments(distance_m))
    return np.asarray(wide, dtype=object)


def subtract(lots: Shapes, owner: NDArray[np.integer], cutters: Shapes) -> Shapes:
    """Return lots less areas, any number a lot.

    Parameters
    ----------
    lots
        (n,) polygons.
    owner, cutters
        (m,) the row of the lot that each area is taken from, and the area.
    """
    left = np.array(lots, dtype=object)
    order = np.argsort(owner, kind="stable")
    owner, cutters = owner[order], cutters[order]
    start = np.searchsorted(owner, owner, side="left")
    rank = np.arange(len(owner)) - start
    for level in range(int(rank.max(initial=-1)) + 1):
        here = rank == level
        rows, shapes = owner[here], cutters[here]
        if level:
            meet = shapely.intersects(left[rows], shapes)
            rows, shapes = rows[meet], shapes[meet]
        left[rows] = difference(left[rows], shapes)
    return left


def difference(shapes: Shapes, cutters: Shapes) -> Shapes:
    """Return `shapely.difference`, with pairs that its fast arithmetic cannot resolve done again on a fine grid."""
    try:
        return np.asarray(shapely.difference(shapes, cutters), dtype=object)
    except GEOSException:  # one pair of many; find it
        if len(shapes) == 1:
            sound = shapely.make_valid(cutters, method="structure", keep_collapsed=False)
            return np.asarray(shapely.difference(shapes, sound, grid_size=RESCUE_GRID_M), dtype=object)
        middle = len(shapes) // 2
        return np.concatenate(
            (difference(shapes[:middle], cutters[:middle]), difference(shapes[middle:], cutters[middle:]))
        )


def drop_small(areas: Shapes, least_m2: float, *, half_width_m: float = SLIVER_M) -> tuple[Shapes, NDArray[np.int64]]:
    """Drop pieces below an area, and slivers nowhere wider than twice `half_width_m`, by default 4 cm.

    Returns
    -------
    The areas, None where nothing is left, and how many pieces each lost.
    """
    parts, owner = shapely.get_parts(areas, return_index=True)
    return keep_parts(parts, owner, len(areas), least_m2, half_width_m)


def keep_parts(
    parts: Shapes, owner: NDArray[np.integer], count: int, least_m2: float, half_width_m: float = SLIVER_M
) -> tuple[Shapes, NDArray[np.int64]]:
    """Join pieces to one area an owner, as `drop_small` does."""
    area, length = shapely.area(parts), shapely.length(parts)
    keep = (shapely.get_dimensions(parts) == 2) & (area >= least_m2) & (area > 0)
    # the inscribed circle's radius is at least area / perimeter, so most need no closer look
    thin = np.flatnonzero(keep & (area < half_width_m * length))
    keep[thin] = ~shapely.is_empty(shapely.buffer(parts[thin], -half_width_m, quad_segs=1))
    dropped = np.bincount(owner[~keep & (area > 0)], minlength=count)
    result = np.full(count, None, dtype=object)
    kept, kept_owner = parts[keep], owner[keep]
    single = np.bincount(kept_owner, minlength=count)[kept_owner] == 1
    result[kept_owner[single]] = kept[single]
    many, place = np.unique(kept_owner[~single], return_inverse=True)
    if len(many):
        result[many] = shapely.multipolygons(kept[~single], indices=place)
    return result, dropped.astype(np.int64)
