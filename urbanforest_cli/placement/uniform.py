"""Uniform points in polygons, a stream a lot."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.placement.inside import GUARD_M, inside_by_margin

TRIES_A_ROUND = 16
ROUNDS = 16


def uniform_points(
    areas: NDArray[np.object_], keys: NDArray[np.uint64], count: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Draw points uniformly in each area, by area over its parts and a millimetre inside its edge.

    The point number j of an area takes the first that lies inside of a stream of points in the area's bounding
    box; where 256 tries find none, the area is a sliver in its box and is drawn from by its triangles instead.

    Parameters
    ----------
    areas
        (n,) polygons or multipolygons; an empty one yields no point.
    keys
        (n,) stream keys.
    count
        (n,) points wanted.

    Returns
    -------
    (m,) index of the area, non-decreasing, and (m, 2) positions.
    """
    owner = np.repeat(np.arange(len(areas)), np.where(shapely.is_empty(areas), 0, count))
    if len(owner) == 0:
        return np.zeros(0, dtype=np.int64), np.zeros((0, 2))
    number = np.arange(len(owner)) - np.searchsorted(owner, owner)
    bounds = shapely.bounds(areas)
    xy = np.full((len(owner), 2), np.nan)
    open_ = np.arange(len(owner))
    for first in range(0, TRIES_A_ROUND * ROUNDS, TRIES_A_ROUND):
        if len(open_) == 0:
            break
        drawn, inside = _round(areas, bounds, keys, owner[open_], number[open_], first)
        hit = inside.any(axis=1)
        xy[open_[hit]] = drawn[hit, inside[hit].argmax(axis=1)]
        open_ = open_[~hit]
    for point in open_:
        xy[point] = _by_triangles(areas[owner[point]], keys[owner[point]], int(number[point]))
    found = np.isfinite(xy[:, 0])
    return owner[found], xy[found]


def _round(
    areas: NDArray[np.object_],
    bounds: NDArray[np.float64],
    keys: NDArray[np.uint64],
    owner: NDArray[np.int64],
    number: NDArray[np.int64],
    first: int,
) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Return the next tries of each open point, (n, tries, 2), and which of them lie inside."""
    tries = first + np.arange(TRIES_A_ROUND)
    index = (number[:, None] << 20) + 2 * tries
    key = np.broadcast_to(keys[owner][:, None], index.shape)
    box = bounds[owner][:, None]
    x = box[..., 0] + hash_uniform(key, index) * (box[..., 2] - box[..., 0])
    y = box[..., 1] + hash_uniform(key, index + 1) * (box[..., 3] - box[..., 1])
    drawn = np.stack((x, y), axis=-1)
    polygons, polygon = np.unique(owner, return_inverse=True)
    inside = inside_by_margin(areas[polygons], np.repeat(polygon, TRIES_A_ROUND), drawn.reshape(-1, 2))
    return drawn, inside.reshape(index.shape)


def _by_triangles(area: shapely.Geometry, key: np.uint64, number: int) -> NDArray[np.float64]:
    inner = shapely.buffer(area, -GUARD_M)
    if inner.is_empty:
        return np.full(2, np.nan)
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(inner))
    corners = shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]
    order = np.lexsort(corners.mean(axis=1).T)
    corners = corners[order]
    cumulative = np.cumsum(shapely.area(triangles)[order])
    u, v, w = hash_uniform(np.repeat(key, 3), (np.int64(number) << 20) + np.arange(1 << 19, (1 << 19) + 3))
    a, b, c = corners[min(int(np.searchsorted(cumulative, u * cumulative[-1])), len(corners) - 1)]
    if v + w > 1:
        v, w = 1 - v, 1 - w
    return np.asarray(a + v * (b - a) + w * (c - a))
