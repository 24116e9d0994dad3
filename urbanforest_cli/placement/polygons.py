"""Polygons as flat arrays of edges, which is how the samplers' kernels see them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

POLYGON_TYPES = (3, 6)  # shapely's type numbers of Polygon and MultiPolygon


@dataclass(frozen=True)
class EdgeTable:
    """The edges of many areas, each area relative to the south-west corner of its bounds.

    Attributes
    ----------
    edges : (m, 4) metres
        x, y of an edge's start, x, y of its end, relative to the area's `origin`; edges without length are left out.
    offsets : (n + 1,)
        Area i has edges ``offsets[i]:offsets[i + 1]``.
    origin, size : (n, 2) metres
        South-west corner and extent of the bounds.
    area_m2, perimeter_m : (n,)
    """

    edges: NDArray[np.float64]
    offsets: NDArray[np.int64]
    origin: NDArray[np.float64]
    size: NDArray[np.float64]
    area_m2: NDArray[np.float64]
    perimeter_m: NDArray[np.float64]


def edge_table(areas: NDArray[np.object_]) -> EdgeTable:
    """Flatten areas to edges; what is empty, missing or no polygon has none.

    Rings are taken by the even-odd rule, so neither their orientation nor their order or first vertex matters.
    """
    count = len(areas)
    parts, part_area = shapely.get_parts(areas, return_index=True)
    polygonal = np.isin(shapely.get_type_id(parts), POLYGON_TYPES)
    if shapely.get_type_id(parts[polygonal]).max(initial=0) == POLYGON_TYPES[1]:  # out of a geometry collection
        inner, index = shapely.get_parts(parts[polygonal], return_index=True)
        parts, part_area = inner, part_area[polygonal][index]
    else:
        parts, part_area = parts[polygonal], part_area[polygonal]
    rings, ring_part = shapely.get_rings(parts, return_index=True)
    points, point_ring = shapely.get_coordinates(rings, return_index=True)
    edge_area = part_area[ring_part][point_ring]

    origin = np.full((count, 2), np.inf)
    far = np.full((count, 2), -np.inf)
    if len(points):
        starts = np.flatnonzero(np.diff(edge_area, prepend=-1))
        origin[edge_area[starts]] = np.minimum.reduceat(points, starts)
        far[edge_area[starts]] = np.maximum.reduceat(points, starts)
    empty = ~np.isfinite(origin).all(axis=1)
    origin[empty] = far[empty] = 0.0

    relative = points - origin[edge_area]
    joined = point_ring[1:] == point_ring[:-1]
    edges = np.concatenate([relative[:-1], relative[1:]], axis=1)[joined]
    owner = edge_area[1:][joined]
    long = (edges[:, :2] != edges[:, 2:]).any(axis=1)
    edges, owner = np.ascontiguousarray(edges[long]), owner[long]
    offsets = np.concatenate([[0], np.cumsum(np.bincount(owner, minlength=count))]).astype(np.int64)
    area = np.bincount(part_area, weights=shapely.area(parts), minlength=count).astype(np.float64)
    perimeter = np.bincount(part_area, weights=shapely.length(parts), minlength=count).astype(np.float64)
    return EdgeTable(edges, offsets, origin, far - origin, area, perimeter)
