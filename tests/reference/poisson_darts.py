"""The slow twin of the saturated sampler, plain dart throwing, and checks of any sample that share none of its code."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import cKDTree
from scipy.stats import truncnorm


def throw_darts(
    area: shapely.Polygon,
    *,
    mean_m: float,
    parent_sd_m: float,
    width_m: float,
    plants: int,
    rng: np.random.Generator,
    stop_m: float = 0.0,
) -> NDArray[np.float64]:
    """Throw darts with a new radius each until some number stand (paper, section Placement Strategies).

    A dart is accepted if its disc overlaps none that stands, and if a disc of radius `stop_m` would not either.

    Returns
    -------
    (plants, 3) x, y, radius in the order of acceptance.
    """
    radii = truncnorm(-width_m / parent_sd_m, width_m / parent_sd_m, loc=mean_m, scale=parent_sd_m)
    west, south, east, north = area.bounds
    placed: list[tuple[float, float, float]] = []
    while len(placed) < plants:
        batch = rng.uniform((west, south), (east, north), (200, 2))
        drawn = radii.rvs(200, random_state=rng)
        inside = shapely.contains_xy(area, batch[:, 0], batch[:, 1])
        for (x, y), radius in zip(batch[inside], drawn[inside], strict=True):
            clearance = min((np.hypot(x - a, y - b) - r for a, b, r in placed), default=np.inf)
            if clearance >= max(radius, stop_m) and len(placed) < plants:
                placed.append((x, y, radius))
    return np.array(placed)


def smallest_slack(xy: NDArray[np.float64], radius_m: NDArray[np.float64]) -> float:
    """Return the smallest distance between the rims of two discs, negative where two overlap."""
    if len(xy) < 2:
        return np.inf
    one, other = cKDTree(xy).query_pairs(2 * radius_m.max(), output_type="ndarray").T
    slack = np.hypot(*(xy[one] - xy[other]).T) - radius_m[one] - radius_m[other]
    return float(slack.min(initial=np.inf))


def largest_gap(
    area: shapely.Polygon,
    xy: NDArray[np.float64],
    radius_m: NDArray[np.float64],
    step_m: float = 0.1,
    edge_m: float = 0.001,
) -> float:
    """Return the largest disc that still fits, its centre on a grid in the area and `edge_m` off its edge."""
    west, south, east, north = area.bounds
    columns, rows = np.arange(west, east, step_m), np.arange(south, north, step_m)
    grid = np.stack(np.meshgrid(columns, rows), axis=-1).reshape(-1, 2)
    shapely.prepare(area)
    grid = grid[shapely.contains_xy(area, grid[:, 0], grid[:, 1])]
    if not len(grid):
        return -np.inf
    clearance = np.full(len(grid), np.inf)
    octave = np.floor(np.log2(radius_m))
    for size in np.unique(octave):  # of discs alike in size the one that sets a clearance is among the nearest centres
        centres, radii = xy[octave == size], radius_m[octave == size]
        distance, index = cKDTree(centres).query(grid, k=[*range(1, min(len(radii), 12) + 1)])
        clearance = np.minimum(clearance, (distance - radii[index]).min(axis=1))
    doubtful = np.argsort(clearance)[::-1]
    for k in doubtful[:2000]:  # the edge's distance is slow, and matters only to the largest
        if shapely.distance(shapely.Point(grid[k]), area.boundary) >= edge_m:
            return float(clearance[k])
    return -np.inf
