"""How far plants stand from what bounds them: the lot's edge and the buildings."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

Floats = NDArray[np.float64]

EDGE_SHARES = np.array([0.25, 0.5, 0.75])
FARTHEST_BUILDING_M = 50.0


def edge_distances(xy: Floats, lot: NDArray[np.int64], lots: NDArray[np.object_]) -> Floats:
    """Return the distance of each point to the outline (holes included) of its lot.

    Parameters
    ----------
    xy
        (n, 2) positions in metres.
    lot
        (n,) index into `lots`.
    lots
        (Multi)Polygons.
    """
    outlines = shapely.boundary(lots)
    return np.asarray(shapely.distance(shapely.points(xy), outlines[lot]))


def building_distances(xy: Floats, buildings: NDArray[np.object_]) -> Floats:
    """Return the distance of each point to the nearest building, at most `FARTHEST_BUILDING_M`."""
    distance = np.full(len(xy), FARTHEST_BUILDING_M)
    if len(buildings) and len(xy):
        tree = shapely.STRtree(buildings)
        (rows, _), found = tree.query_nearest(
            shapely.points(xy), max_distance=FARTHEST_BUILDING_M, return_distance=True, all_matches=False
        )
        distance[rows] = found
    return distance
