"""The compiled part of `canopy.py`: twigs of plants pressed onto a grid of cells."""

from __future__ import annotations

import numpy as np
from numba import njit

SHIFT = 3
SUB = 1 << SHIFT  # cells are split into this many parts each way, one bit of 64 a part
PERCENT = 100.0


@njit(cache=True, nogil=True)
def stamp_twigs(first, twig_xyz, shape, east, south, turn, flip, scale, reach, cell, top, parts):
    """Press the twigs of plants onto a grid.

    Parameters
    ----------
    first
        (s + 1,) offsets into the twigs of s shapes.
    twig_xyz
        (m, 3) points of twigs, about the root of their shape.
    shape
        (n,) shape of each plant.
    east, south
        (n,) where it stands, metres from the grid's west and north edges.
    turn, flip, scale
        (n,) its turn in radians, -1 or 1 on y before it is turned, and its size.
    reach
        (n,) metres about a twig that its leaves cover.
    cell
        Side of a cell in metres.
    top
        (rows, cols) float32: highest twig of each cell; changed.
    parts
        (rows, cols) uint64: which parts of each cell are covered; changed.
    """
    rows, cols = top.shape
    step = cell / SUB
    for p in range(len(shape)):
        cos, sin = np.cos(turn[p]), np.sin(turn[p])
        radius = reach[p] / step
        for i in range(first[shape[p]], first[shape[p] + 1]):
            x = twig_xyz[i, 0]
            y = flip[p] * twig_xyz[i, 1]
            z = np.float32(scale[p] * twig_xyz[i, 2])
            px = (east[p] + scale[p] * (cos * x - sin * y)) / step
            py = (south[p] - scale[p] * (sin * x + cos * y)) / step
            row, col = int(np.floor(py)), int(np.floor(px))
            if 0 <= row < rows * SUB and 0 <= col < cols * SUB:
                _cover(row, col, col, z, top, parts)
            for row in range(
                max(int(np.ceil(py - radius - 0.5)), 0), min(int(np.floor(py + radius + 0.5)), rows * SUB)
            ):
                away = row + 0.5 - py
                half = np.sqrt(max(radius * radius - away * away, 0.0))
                low = max(int(np.ceil(px - half - 0.5)), 0)
                high = min(int(np.floor(px + half - 0.5)), cols * SUB - 1)
                if low <= high:
                    _cover(row, low, high, z, top, parts)


@njit(cache=True, nogil=True)
def _cover(row, low, high, z, top, parts):
    """Cover a run of parts of a row, both ends included."""
    r = row >> SHIFT
    line = np.uint64((row & (SUB - 1)) << SHIFT)
    for c in range(low >> SHIFT, (high >> SHIFT) + 1):
        start = max(low - (c << SHIFT), 0)
        stop = min(high - (c << SHIFT), SUB - 1) + 1
        run = ((np.uint64(1) << np.uint64(stop - start)) - np.uint64(1)) << np.uint64(start)
        parts[r, c] |= run << line
        if z > top[r, c]:
            top[r, c] = z


@njit(cache=True, nogil=True)
def share_covered(parts, percent):
    """Set (rows, cols) uint8: how much of each cell is covered, at least 1 where anything is."""
    rows, cols = parts.shape
    for r in range(rows):
        for c in range(cols):
            bits = parts[r, c]
            found = 0
            while bits:
                bits &= bits - np.uint64(1)
                found += 1
            share = np.uint8(np.rint(found * (PERCENT / SUB**2)))
            percent[r, c] = max(share, np.uint8(found > 0))
