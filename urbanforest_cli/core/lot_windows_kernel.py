"""The compiled part of cutting windows out of lots and what stands and grows on them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.polygon_raster_kernel import add_rings, settle

kernel: Any = njit(cache=True, nogil=True)


@kernel
def fill_windows(
    owner,
    places,
    lot_rings,
    plants,
    plant_rings,
    built,
    built_rings,
    edge_max_m,
    coverage,
    lot,
    ground,
    edge_dm,
):
    """Rasterise windows (n, height, width) of uint8.

    Parameters
    ----------
    owner : (n,) row of the lot that a window shows.
    places : (n, 3) upper left corner and side of a pixel, in metres.
    lot_rings, plant_rings, built_rings
        xy, ring_offsets, signs, shape_offsets of `core.polygon_raster.Rings`.
    plants, built
        (n + 1,) offsets and (m,) shapes of the vegetation and the buildings near each window.
    """
    count, height, width = coverage.shape
    acc = np.zeros((height, width + 1))
    shares = np.zeros((height, width), np.float32)
    nearest = np.zeros((height, width))
    for window in range(count):
        x0, y_top, pixel_m = places[window, 0], places[window, 1], places[window, 2]
        xy, ring_offsets, signs, shape_offsets = plant_rings
        for k in range(plants[0][window], plants[0][window + 1]):
            shape = plants[1][k]
            first, last = shape_offsets[shape], shape_offsets[shape + 1]
            add_rings(acc, xy, ring_offsets, signs, first, last, x0, y_top, pixel_m)
        settle(acc, shares)
        _to_percent(shares, coverage[window])

        xy, ring_offsets, signs, shape_offsets = lot_rings
        first, last = shape_offsets[owner[window]], shape_offsets[owner[window] + 1]
        add_rings(acc, xy, ring_offsets, signs, first, last, x0, y_top, pixel_m)
        settle(acc, shares)
        _to_percent(shares, lot[window])
        _edge_distances(xy, ring_offsets, first, last, x0, y_top, pixel_m, edge_max_m, nearest)
        for row in range(height):
            for col in range(width):
                inside = lot[window, row, col] >= 50
                edge_dm[window, row, col] = round(10.0 * nearest[row, col]) if inside else 0

        xy, ring_offsets, signs, shape_offsets = built_rings
        for k in range(built[0][window], built[0][window + 1]):
            shape = built[1][k]
            first, last = shape_offsets[shape], shape_offsets[shape + 1]
            add_rings(acc, xy, ring_offsets, signs, first, last, x0, y_top, pixel_m)
        settle(acc, shares)
        for row in range(height):
            for col in range(width):
                free = round(100.0 * (1.0 - shares[row, col]))
                ground[window, row, col] = min(free, int(lot[window, row, col]))


@kernel
def _to_percent(shares, percent):
    for row in range(shares.shape[0]):
        for col in range(shares.shape[1]):
            percent[row, col] = round(100.0 * shares[row, col])


@kernel
def _edge_distances(xy, ring_offsets, first_ring, last_ring, x0, y_top, pixel_m, most_m, nearest):
    """Write the distance of each pixel's centre to the nearest edge of some rings, at most `most_m`."""
    height, width = nearest.shape
    nearest[:] = most_m * most_m
    for ring in range(first_ring, last_ring):
        for k in range(ring_offsets[ring], ring_offsets[ring + 1] - 1):
            ax, ay = xy[k, 0] - x0, y_top - xy[k, 1]
            bx, by = xy[k + 1, 0] - x0, y_top - xy[k + 1, 1]
            first_col = max(0, math.floor((min(ax, bx) - most_m) / pixel_m))
            last_col = min(width - 1, math.floor((max(ax, bx) + most_m) / pixel_m))
            first_row = max(0, math.floor((min(ay, by) - most_m) / pixel_m))
            last_row = min(height - 1, math.floor((max(ay, by) + most_m) / pixel_m))
            ex, ey = bx - ax, by - ay
            square = ex * ex + ey * ey
            for row in range(first_row, last_row + 1):
                wy = (row + 0.5) * pixel_m - ay
                for col in range(first_col, last_col + 1):
                    wx = (col + 0.5) * pixel_m - ax
                    t = (wx * ex + wy * ey) / square if square > 0.0 else 0.0
                    t = min(max(t, 0.0), 1.0)
                    dx, dy = wx - t * ex, wy - t * ey
                    nearest[row, col] = min(nearest[row, col], dx * dx + dy * dy)
    for row in range(height):
        for col in range(width):
            nearest[row, col] = math.sqrt(nearest[row, col])
