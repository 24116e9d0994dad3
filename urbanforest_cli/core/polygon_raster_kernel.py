"""The compiled part of rasterising polygons: each edge's share of each cell, summed along rows.

An edge adds to the cells it crosses the area between itself and their right sides, and to all cells further right its
height in the row, with the sign of its direction; summed over closed rings and from left to right that is the exact
area of each cell inside (the accumulation buffer of font rasterisers).
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

kernel: Any = njit(cache=True, nogil=True)


@kernel
def _add_span(acc, row, left, right, height):
    """Add an edge that passes from column `left` to `right` within a row, both inside the grid."""
    width = acc.shape[1] - 1
    if right - left < 1e-12:
        col = min(int(left), width - 1)
        middle = left - col
        acc[row, col] += height * (1.0 - middle)
        acc[row, col + 1] += height * middle
        return
    scale = height / (right - left)
    col = int(left)
    while col < width and col < right:
        a, b = max(left, col), min(right, col + 1.0)
        part = scale * (b - a)
        middle = 0.5 * (a + b) - col
        acc[row, col] += part * (1.0 - middle)
        acc[row, col + 1] += part * middle
        col += 1


@kernel
def _add_edge(acc, ax, ay, bx, by, sign):
    """Add one edge, in cells from the upper left corner; what lies above, below or right of the grid adds nothing."""
    height, width = acc.shape[0], acc.shape[1] - 1
    if ay == by:
        return
    if ay > by:
        ax, ay, bx, by, sign = bx, by, ax, ay, -sign
    if by <= 0.0 or ay >= height or (ax >= width and bx >= width):
        return
    slope = (bx - ax) / (by - ay)
    top, bottom = max(ay, 0.0), min(by, float(height))
    row = int(top)
    while row < bottom:
        y0, y1 = max(top, row), min(bottom, row + 1.0)
        x0, x1 = ax + (y0 - ay) * slope, ax + (y1 - ay) * slope
        left, right = min(x0, x1), max(x0, x1)
        d = sign * (y1 - y0)
        if right <= 0.0:
            acc[row, 0] += d
        elif left < width:
            whole = right - left
            if left < 0.0:
                acc[row, 0] += d * (-left / whole)
            inner_left, inner_right = max(left, 0.0), min(right, float(width))
            share = (inner_right - inner_left) / whole if whole >= 1e-12 else 1.0
            _add_span(acc, row, inner_left, inner_right, d * share)
        row += 1


@kernel
def add_rings(acc, xy, ring_offsets, signs, first, last, x0, y_top, pixel_m):
    """Add rings `first` to `last` (not included) to an accumulation buffer.

    Parameters
    ----------
    acc : (height, width + 1) float64
        Zeros at first; several shapes may be added before it is settled.
    xy, ring_offsets, signs
        (m, 2) vertices, closed rings ``xy[ring_offsets[k]:ring_offsets[k + 1]]``, +1 or -1 for rings that add or take
        away, whichever way they turn (`core.polygon_raster.Rings`).
    x0, y_top, pixel_m
        Upper left corner of the grid, and side of a cell.
    """
    for ring in range(first, last):
        for k in range(ring_offsets[ring], ring_offsets[ring + 1] - 1):
            _add_edge(
                acc,
                (xy[k, 0] - x0) / pixel_m,
                (y_top - xy[k, 1]) / pixel_m,
                (xy[k + 1, 0] - x0) / pixel_m,
                (y_top - xy[k + 1, 1]) / pixel_m,
                signs[ring],
            )


@kernel
def settle(acc, shares):
    """Turn an accumulation buffer into shares (height, width), from 0 to 1, and clear it."""
    height, width = shares.shape
    for row in range(height):
        total = 0.0
        for col in range(width):
            total += acc[row, col]
            acc[row, col] = 0.0
            shares[row, col] = min(max(total, 0.0), 1.0) if total > 1e-9 else 0.0
        acc[row, width] = 0.0


@kernel
def signed_areas(xy, ring_offsets, areas):
    """Write the area of each ring, positive where it turns counter-clockwise."""
    for ring in range(len(ring_offsets) - 1):
        first = ring_offsets[ring]
        total = 0.0
        for k in range(first, ring_offsets[ring + 1] - 1):
            ax, ay = xy[k, 0] - xy[first, 0], xy[k, 1] - xy[first, 1]
            bx, by = xy[k + 1, 0] - xy[first, 0], xy[k + 1, 1] - xy[first, 1]
            total += ax * by - ay * bx
        areas[ring] = 0.5 * total


@kernel
def raster_all(xy, ring_offsets, signs, shape_offsets, x0, y_top, pixel_m, shares):
    """Rasterise shapes, each into a grid of its own: shares (n, height, width)."""
    acc = np.zeros((shares.shape[1], shares.shape[2] + 1))
    for shape in range(len(shape_offsets) - 1):
        first, last = shape_offsets[shape], shape_offsets[shape + 1]
        add_rings(acc, xy, ring_offsets, signs, first, last, x0[shape], y_top[shape], pixel_m[shape])
        settle(acc, shares[shape])
