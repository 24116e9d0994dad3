"""How large a plant still fits: a grid, a distance, nothing shared with the sampler."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree


def largest_gap_m(
    ground: shapely.Geometry, xy: NDArray[np.float64], radius_m: NDArray[np.float64], step_m: float
) -> float:
    """Return the largest clearance min(|y - x| - r(x)) over the points y of a grid that lie in the ground.

    The minimum is taken over the 16 nearest plants: were a further one nearer by its radius, the clearance told
    would be too large, never too small.
    """
    west, south, east, north = ground.bounds
    columns = np.arange(west + step_m / 2, east, step_m)
    tree = cKDTree(xy)
    neighbours = min(16, len(xy))
    shapely.prepare(ground)
    worst = -np.inf
    for y in np.arange(south + step_m / 2, north, step_m):
        inside = columns[shapely.contains_xy(ground, columns, y)]
        if len(inside):
            points = np.column_stack((inside, np.full(len(inside), y)))
            distance, plant = tree.query(points, k=[*range(1, neighbours + 1)])
            worst = max(worst, float((distance - radius_m[plant]).min(axis=1).max()))
    return worst
