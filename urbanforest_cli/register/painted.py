"""Painted ground as sketches: outlines without stair steps, one a patch, and the share that crowns shall cover."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import contourpy
import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray
from scipy import ndimage

from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid

MEANT_SHARE = 0.005
"""Part of the painted ground that lies amid its own level from which on that was meant, and is no edge of a brush."""
MODE_SHARE = 0.2
"""The same where paint is too thin to lie amid anything, of the commonest level."""
EDGE_PX = 2.5
SHADED_SHARE = 0.2
"""Part of the painted ground beyond the edges of what was meant, from which on a drawing is shaded."""
STEPS_PERCENT = (25, 50, 75, 100)
FAINTEST_PERCENT = 12
SMOOTHED_PX, SMOOTHED_NARROW_PX = 1.3, 0.7
"""Standard deviation of the blur that takes the stair steps, and of one for patches less than `NARROW_PX` wide."""
NARROW_PX = 6
PAD_PX = 6
AREA_TOLERANCE = 0.01
TRIES = 24
SIMPLIFIED_PX = 0.1
CONNECTED = np.ones((3, 3), dtype=bool)

Shapes = NDArray[Any]


def painted_sketches(
    percent: NDArray[np.uint8], grid: RasterGrid, *, least_m2: float, notices: Notices, where: object = None
) -> gpd.GeoDataFrame:
    """Turn painted ground into sketches: a polygon a patch of one level.

    Parameters
    ----------
    percent
        (row, col) share that crowns shall cover, 0 where nothing is painted.
    grid
        Where the pixels lie.
    least_m2
        Patches below this are left out and counted, holes below it filled.

    Returns
    -------
    Columns ``sketch_id``, which says at which row and column the patch begins, so that it stays when another is
    painted, and ``coverage``, a share of 1; the outline's area is that of the patch's pixels to 1 %. From north to
    south, in the grid's CRS.
    """
    wide_m, high_m = grid.resolution_m
    least_px = least_m2 / (wide_m * high_m)
    levels = settled_levels(percent)
    names, shares, shapes, small = [], [], [], 0
    for level in np.unique(levels[levels > 0]):
        labels, _ = ndimage.label(levels == level, CONNECTED)
        for number, (rows, cols) in enumerate(ndimage.find_objects(labels), 1):
            patch = labels[rows, cols] == number
            if patch.sum() < least_px:
                small += 1
                continue
            patch = _without_small_holes(patch, least_px)
            names.append((rows.start, cols.start + int(patch[0].argmax())))
            shares.append(level / 100)
            shapes.append(_on_the_map(outline_of(patch), rows.start, cols.start, grid))
    notices.add("W_PAINT_SMALL", "painted patches below coverage.smallest_region_m2, left out", small, [where])
    order = sorted(range(len(names)), key=names.__getitem__)
    column = np.empty(len(shapes), dtype=object)
    column[:] = shapes
    return gpd.GeoDataFrame(
        {
            "sketch_id": [f"painted:{names[i][0]}:{names[i][1]}" for i in order],
            "coverage": np.array(shares, dtype=np.float64)[order],
        },
        geometry=column[order],
        crs=grid.crs,
    )


def settled_levels(percent: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the level that was meant for each pixel, 0 for none: the edges of a brush belong to what is beside them.

    Where hardly any level was meant, as in a drawing that is shaded, levels are rounded to quarters.
    """
    painted = percent > 0
    strong = _meant_levels(percent, painted)
    meant = strong[percent]
    if bool(meant[painted].all()):
        return percent.copy()
    away_px, (rows, cols) = ndimage.distance_transform_edt(~meant, return_indices=True)
    shaded = not strong.any() or bool((away_px[painted] > EDGE_PX).mean() > SHADED_SHARE)
    if shaded:
        steps = np.array((0, *STEPS_PERCENT), np.uint8)
        return steps[(percent.astype(np.int64) + FAINTEST_PERCENT) // 25]
    beside = percent[rows, cols]
    return np.where(painted & (2 * percent.astype(np.int64) >= beside), beside, np.uint8(0))


def _meant_levels(percent: NDArray[np.uint8], painted: NDArray[np.bool_]) -> NDArray[np.bool_]:
    """Tell of the levels 0 to 100 which were meant."""
    cross = ndimage.generate_binary_structure(2, 1)
    amid = ndimage.minimum_filter(percent, footprint=cross) == ndimage.maximum_filter(percent, footprint=cross)
    least = MEANT_SHARE * painted.sum()
    counts = np.bincount(percent[painted & amid], minlength=101)
    if not counts.any():
        counts, least = np.bincount(percent[painted], minlength=101), MODE_SHARE * painted.sum()
    faint = np.arange(101) <= FAINTEST_PERCENT
    strong = (counts > 0) & (counts >= least)
    return np.asarray(strong & ~faint if (strong & ~faint).any() else strong)


def outline_of(patch: NDArray[np.bool_]) -> Any:
    """Return the outline of (row, col) pixels as a valid polygon in (column, row) from their first corner.

    The blur that takes the steps also shrinks what is narrow; the level at which the outline is drawn makes up for it.
    """
    padded = np.pad(patch, PAD_PX)
    wide = bool((ndimage.distance_transform_edt(padded) > NARROW_PX / 2).any())
    field = ndimage.gaussian_filter(padded.astype(np.float64), SMOOTHED_PX if wide else SMOOTHED_NARROW_PX)
    wanted = float(patch.sum())
    low, high, level = 0.0, 1.0, 0.5
    for _ in range(TRIES):
        shape = _contour(field, level)
        area = shape.area
        if abs(area - wanted) <= AREA_TOLERANCE / 2 * wanted:
            break
        low, high = (level, high) if area > wanted else (low, level)
        level = (low + high) / 2
    plain = shapely.simplify(shape, SIMPLIFIED_PX)
    if not plain.is_valid or abs(plain.area - wanted) > AREA_TOLERANCE * wanted:
        plain = shapely.make_valid(shape, method="structure", keep_collapsed=False)
    return plain


def _contour(field: NDArray[np.float64], level: float) -> Any:
    """Return where a field reaches a level, in (column, row) from the corner of what was padded."""
    if level >= field.max():
        return shapely.Polygon()
    ticks = [np.arange(length) - (PAD_PX - 0.5) for length in field.shape]
    found = contourpy.contour_generator(
        ticks[1], ticks[0], field, fill_type=contourpy.FillType.OuterOffset
    ).filled(level, np.inf)  # fmt: skip
    parts = []
    for points, offsets in zip(*found, strict=True):
        rings = [points[start:end] for start, end in pairwise(offsets)]
        parts.append(shapely.Polygon(rings[0], rings[1:]))
    return shapely.multipolygons(parts) if len(parts) != 1 else parts[0]


def _without_small_holes(patch: NDArray[np.bool_], least_px: float) -> NDArray[np.bool_]:
    holes, count = ndimage.label(ndimage.binary_fill_holes(patch) & ~patch)
    if not count:
        return patch
    small = np.bincount(holes.ravel()) < least_px
    small[0] = False
    return np.asarray(patch | small[holes])


def _on_the_map(shape: Any, row: int, col: int, grid: RasterGrid) -> Any:
    a, _, c, _, e, f = grid.transform

    def move(xy: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.column_stack((c + a * (col + xy[:, 0]), f + e * (row + xy[:, 1])))

    return shapely.transform(shape, move)
