"""Polygons on a grid: the exact share of each cell that they cover."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import ArrayLike, NDArray

from urbanforest_cli.core.polygon_raster_kernel import raster_all, signed_areas

Shapes = NDArray[Any]


@dataclass(frozen=True)
class Rings:
    """Rings of polygons as flat arrays, which is how kernels see them.

    Parameters
    ----------
    xy
        (m, 2) float64 vertices, first and last of a ring alike.
    ring_offsets
        (k + 1,) ring j has vertices ``ring_offsets[j]:ring_offsets[j + 1]``.
    signs
        (k,) float64: +1 or -1, so that shells add and holes take away whichever way they turn.
    shape_offsets
        (n + 1,) shape i has rings ``shape_offsets[i]:shape_offsets[i + 1]``; none where it is missing, empty or no
        polygon.
    """

    xy: NDArray[np.float64]
    ring_offsets: NDArray[np.int64]
    signs: NDArray[np.float64]
    shape_offsets: NDArray[np.int64]


def rings_of(shapes: Shapes) -> Rings:
    """Flatten polygons and multipolygons to rings; of collections the polygons are taken."""
    parts, owner = shapely.get_parts(shapes, return_index=True)
    while np.isin(shapely.get_type_id(parts), (6, 7)).any():
        parts, index = shapely.get_parts(parts, return_index=True)
        owner = owner[index]
    polygon = shapely.get_type_id(parts) == 3
    parts, owner = parts[polygon], owner[polygon]
    rings, ring_part = shapely.get_rings(parts, return_index=True)
    xy, vertex_ring = shapely.get_coordinates(rings, return_index=True)
    xy = np.ascontiguousarray(xy, dtype=np.float64)
    ring_offsets = np.searchsorted(vertex_ring, np.arange(len(rings) + 1)).astype(np.int64)
    areas = np.zeros(len(rings))
    signed_areas(xy, ring_offsets, areas)
    shell = np.diff(ring_part, prepend=-1) != 0
    signs = np.where(shell, 1.0, -1.0) * np.where(areas < 0, -1.0, 1.0)
    shape_offsets = np.searchsorted(owner[ring_part], np.arange(len(shapes) + 1)).astype(np.int64)
    return Rings(xy, ring_offsets, signs, shape_offsets)


def raster_shares(
    polygons: Shapes, x0: ArrayLike, y_top: ArrayLike, pixel_m: ArrayLike, height: int, width: int
) -> NDArray[np.float32]:
    """Return the exact share of each cell that polygons cover.

    Parameters
    ----------
    polygons
        (n,) valid polygons or multipolygons; missing and empty ones cover nothing.
    x0, y_top, pixel_m
        Upper left corner of the grid and side of a cell, in the polygons' units: one for all, or (n,).

    Returns
    -------
    (n, height, width) float32, row 0 in the north.
    """
    rings = rings_of(polygons)
    count = len(polygons)
    place = [np.ascontiguousarray(np.broadcast_to(np.asarray(v, np.float64), count)) for v in (x0, y_top, pixel_m)]
    shares = np.empty((count, height, width), dtype=np.float32)
    raster_all(rings.xy, rings.ring_offsets, rings.signs, rings.shape_offsets, *place, shares)
    return shares
