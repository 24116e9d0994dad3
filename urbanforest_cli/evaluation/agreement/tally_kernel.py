"""The compiled part of comparing crowns with a map: discs on a grid, and sums over each lot's share of its cells."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.polygon_raster_kernel import add_rings, settle

kernel: Any = njit(cache=True, nogil=True)

SIDE = 8
"""Points along each side of a cell: a disc covers those whose place it covers, 64 of them a cell."""
CLOSE = 0.70711


@kernel
def mark_discs(marks, x, y, radius, x0, y_top, cell_m):
    """Set a bit for every point of a cell that a disc covers.

    Parameters
    ----------
    marks : (height, width) uint64
        Added to; row 0 in the north.
    x, y, radius : (n,) float64
        Discs in metres.
    x0, y_top, cell_m
        Upper left corner of the grid, and side of a cell.
    """
    height, width = marks.shape
    whole = ~np.uint64(0)
    for disc in range(len(x)):
        r = radius[disc] / cell_m
        if not r > 0.0:
            continue
        cx, cy = (x[disc] - x0) / cell_m, (y_top - y[disc]) / cell_m
        top, bottom = max(0, int(np.floor(cy - r))), min(height - 1, int(np.floor(cy + r)))
        for row in range(top, bottom + 1):
            left, right = max(0, int(np.floor(cx - r))), min(width - 1, int(np.floor(cx + r)))
            for col in range(left, right + 1):
                away = np.hypot(col + 0.5 - cx, row + 0.5 - cy)
                if away > r + CLOSE:
                    continue
                if away < r - CLOSE:
                    marks[row, col] = whole
                    continue
                bits = np.uint64(0)
                for j in range(SIDE):
                    dy = row + (j + 0.5) / SIDE - cy
                    for i in range(SIDE):
                        dx = col + (i + 0.5) / SIDE - cx
                        if dx * dx + dy * dy <= r * r:
                            bits |= np.uint64(1) << np.uint64(j * SIDE + i)
                marks[row, col] |= bits


@kernel
def marked_shares(marks, shares):
    """Write the share of each cell's points that are marked."""
    height, width = marks.shape
    for row in range(height):
        for col in range(width):
            bits = marks[row, col]
            count = 0
            while bits != np.uint64(0):
                bits &= bits - np.uint64(1)
                count += 1
            shares[row, col] = count / (SIDE * SIDE)


@kernel
def tally_lots(percent, threshold, crowns, xy, ring_offsets, signs, shape_offsets, lots, x0, y_top, cell_m, sums):
    """Add up, for each lot, the areas of a tile in cells, each cell by its share inside the lot.

    Parameters
    ----------
    percent : (height, width) uint8
        Of the map, 255 where unknown.
    threshold
        Percentage from which a cell counts as covered.
    crowns : (sets, height, width) float32
        Share of each cell under crowns.
    xy, ring_offsets, signs, shape_offsets
        Lots as rings (`core.polygon_raster.Rings`).
    lots : (n,) int64
        Row of each lot in `sums`.
    sums : (lots, 3 + 3 sets) float64
        Added to, on known ground alone: known, covered, covered by percentages; then of each set ground under crowns,
        cells of which half or more is, and those of them that are covered.
    """
    height, width = percent.shape
    sets = crowns.shape[0]
    for number in range(len(lots)):
        first, last = shape_offsets[number], shape_offsets[number + 1]
        if first == last:
            continue
        west, east, south, north = np.inf, -np.inf, np.inf, -np.inf
        for k in range(ring_offsets[first], ring_offsets[last]):
            west, east = min(west, xy[k, 0]), max(east, xy[k, 0])
            south, north = min(south, xy[k, 1]), max(north, xy[k, 1])
        left, right = max(0, int(np.floor((west - x0) / cell_m))), min(width, int(np.ceil((east - x0) / cell_m)))
        top, bottom = (
            max(0, int(np.floor((y_top - north) / cell_m))),
            min(height, int(np.ceil((y_top - south) / cell_m))),
        )
        if left >= right or top >= bottom:
            continue
        acc = np.zeros((bottom - top, right - left + 1))
        shares = np.zeros((bottom - top, right - left))
        add_rings(acc, xy, ring_offsets, signs, first, last, x0 + left * cell_m, y_top - top * cell_m, cell_m)
        settle(acc, shares)
        lot = lots[number]
        for row in range(top, bottom):
            for col in range(left, right):
                inside = shares[row - top, col - left]
                if inside == 0.0:
                    continue
                value = percent[row, col]
                if value == 255:
                    continue
                sums[lot, 0] += inside
                sums[lot, 2] += inside * min(value, 100) / 100.0
                covered = value >= threshold
                if covered:
                    sums[lot, 1] += inside
                for k in range(sets):
                    under = crowns[k, row, col]
                    sums[lot, 3 + 3 * k] += inside * under
                    if under >= 0.5:
                        sums[lot, 4 + 3 * k] += inside
                        if covered:
                            sums[lot, 5 + 3 * k] += inside
