"""What is built around a grove: where nothing can grow, and how much light is left beside it.

Buildings are prisms. Two rasters are made of them: `solid_top`, conservative, in which every column that a footprint
touches is built to its top; and the sky field, the share of light that reaches the cells of a coarser grid past all
buildings within `SHADE_REACH_M`. For each direction of light the field finds the height under which each cell lies in
shadow, by a sweep over the raster against the light: the shadow's edge falls by the light's slope from cell to cell.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.growth.grove import COLUMN_M, SKY_CELL_M
from urbanforest_cli.growth.solids_kernel import burn, shares_left, sweep
from urbanforest_cli.growth.sunlight import Light

SHADE_REACH_M = 60.0
"""Buildings farther away than this from a frame throw no shade on it."""
PAD_M = 0.005
"""A column within this of a footprint counts as touched: skeletons are stored in steps of this size."""


@dataclass(frozen=True)
class Footprints:
    """The outlines of a city's buildings as flat arrays, one part for each polygon of a multipolygon.

    Ring r of all has the positions ``xy_m[rings[r] : rings[r + 1]]``, part p the rings ``parts[p]`` to
    ``parts[p + 1]``; `top_m` (p,) is the height of each part, `thin` (p,) marks those that slip between the cells of
    a raster, such as walls; `bounds` (p, 4).
    """

    xy_m: NDArray[np.float64]
    rings: NDArray[np.int64]
    parts: NDArray[np.int64]
    top_m: NDArray[np.float64]
    thin: NDArray[np.bool_]
    bounds: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.top_m)


def footprints_of(polygons: NDArray[Any], height_m: NDArray[np.float64], default_m: float) -> Footprints:
    """Return buildings, polygons or multipolygons with or without a height, as flat arrays; empty ones are left out."""
    known = np.where(np.isfinite(height_m), height_m, default_m)
    flat, owner = shapely.get_parts(np.asarray(polygons, dtype=object), return_index=True)
    kept = (shapely.get_type_id(flat) == shapely.GeometryType.POLYGON) & ~shapely.is_empty(flat) & (known[owner] > 0)
    flat, owner = flat[kept], owner[kept]
    if not len(flat):
        nothing = np.empty(0)
        zero = np.zeros(1, np.int64)
        return Footprints(np.empty((0, 2)), zero, zero, nothing, nothing.astype(bool), np.empty((0, 4)))
    _, xy, (rings, parts) = shapely.to_ragged_array(flat, include_z=False)
    thickness = 2 * shapely.area(flat) / shapely.length(flat)
    return Footprints(
        np.ascontiguousarray(xy), np.asarray(rings, np.int64), np.asarray(parts, np.int64),
        np.ascontiguousarray(known[owner], dtype=np.float64), thickness < math.sqrt(2) * COLUMN_M, shapely.bounds(flat),
    )  # fmt: skip


def solid_top(
    footprints: Footprints,
    near: NDArray[np.int64],
    origin_m: NDArray[np.float64],
    size_m: NDArray[np.float64],
) -> NDArray[np.float32]:
    """Return the height of what is built in each column of a frame that a footprint touches.

    Parameters
    ----------
    near
        Rows of the footprints to look at.

    Returns
    -------
    (ny, nx) float32, columns of `COLUMN_M`; (1, 1) zero if nothing is built in the frame.
    """
    shape = tuple(math.ceil(extent / COLUMN_M - 1e-9) for extent in (size_m[1], size_m[0]))
    top = np.zeros(shape, dtype=np.float32)
    touched = np.ones(len(footprints), dtype=bool)
    built = burn(
        footprints.xy_m, footprints.rings, footprints.parts, footprints.top_m, touched, near,
        origin_m[0], origin_m[1], COLUMN_M, PAD_M, top,
    )  # fmt: skip
    if not built:
        return np.zeros((1, 1), dtype=np.float32)
    return top


def sky_field(
    footprints: Footprints,
    near: NDArray[np.int64],
    origin_m: NDArray[np.float64],
    size_m: NDArray[np.float64],
    light: Light,
) -> NDArray[np.uint8]:
    """Return the share of light that buildings leave in a frame.

    Parameters
    ----------
    near
        Rows of the footprints to look at, those `within_shade`.

    Returns
    -------
    (nz, ny, nx) uint8, 255 for all of it, in the middles of cells of `SKY_CELL_M`; (1, 1, 1) if they take none.
    """
    counts = np.ceil(size_m / SKY_CELL_M - 1e-9).astype(np.int64)
    everywhere = np.full((1, 1, 1), 255, dtype=np.uint8)
    if not len(near):
        return everywhere
    cells = (footprints.bounds[near] - np.tile(origin_m, 2)) / SKY_CELL_M
    margin = math.ceil(SHADE_REACH_M / SKY_CELL_M)
    low = np.clip(np.floor(cells[:, :2].min(axis=0)), -margin, 0).astype(np.int64)
    high = np.clip(np.ceil(cells[:, 2:].max(axis=0)), counts[:2], counts[:2] + margin).astype(np.int64)
    fine = np.zeros(tuple(2 * (high - low)[::-1]), dtype=np.float32)
    burn(
        footprints.xy_m, footprints.rings, footprints.parts, footprints.top_m, footprints.thin, near,
        origin_m[0] + low[0] * SKY_CELL_M, origin_m[1] + low[1] * SKY_CELL_M, SKY_CELL_M / 2, 0.0, fine,
    )  # fmt: skip
    # built where any quarter is: that widens by a quarter of a cell what the sweep takes to begin at a cell's middle
    top = np.maximum(np.maximum(fine[::2, ::2], fine[1::2, ::2]), np.maximum(fine[::2, 1::2], fine[1::2, 1::2]))
    columns = np.ascontiguousarray(top.T)
    taken = np.zeros((counts[2] + 1, counts[1], counts[0]), dtype=np.float32)
    taken_of_columns = np.zeros((counts[2] + 1, counts[0], counts[1]), dtype=np.float32)
    for (x, y, up), share in zip(light.sky_ray.tolist(), light.sky_light.tolist(), strict=True):
        flat = math.hypot(x, y)
        if flat < 1e-6:
            continue  # nothing is above a plant
        if abs(x) > abs(y):
            sweep(columns, x / flat, y / flat, up / flat, share, -low[0], -low[1], taken_of_columns)
        else:
            sweep(top, y / flat, x / flat, up / flat, share, -low[1], -low[0], taken)
    left = np.asarray(shares_left(taken + taken_of_columns.transpose(0, 2, 1)))
    return left if left.min() < 255 else everywhere


def within_shade(
    footprints: Footprints,
    near: NDArray[np.int64],
    origin_m: NDArray[np.float64],
    size_m: NDArray[np.float64],
    light: Light,
) -> NDArray[np.int64]:
    """Return which of some footprints stand in a frame or so near that, by their height, they shade it."""
    lowest = float(light.sky_ray[:, 2].min())
    reach = np.minimum(footprints.top_m[near] * math.sqrt(1 - lowest**2) / lowest, SHADE_REACH_M)
    bounds = footprints.bounds[near]
    gap = np.maximum(np.maximum(bounds[:, :2] - origin_m - size_m[:2], origin_m - bounds[:, 2:]), 0)
    return np.asarray(near[np.hypot(*gap.T) <= reach], dtype=np.int64)
