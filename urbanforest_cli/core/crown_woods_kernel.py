"""The compiled part of fitting crowns where covered ground is wider than a crown: large single crowns and woods."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.crown_discs_kernel import (
    FILLED,
    HALF,
    SHOWN,
    apart,
    bare_ring,
    drawn_radius,
    paint,
    stand,
    uniform,
)
from urbanforest_cli.core.distance_kernel import label, squared_distances

kernel: Any = njit(cache=True, nogil=True)

RING_BARE, RING_BARE_LARGE, LARGER_BY = 0.25, 0.8, 1.5
"""Share of the ring around a large disc that must be bare for it to be one crown: just above the law's largest radius,
and 1 / LARGER_BY of that radius beyond it. The larger a disc, the more it must stand by itself to be no wood."""
ROUND = 1.35
"""Area of a large disc's inner part over that of a disc, up to which it is round enough to be one crown."""
REACH_OVER = 0.85
"""Least room to the edge of a crown that fills closed canopy, over its radius: its rim may reach over a little."""
MISSES = 60
"""Places that a drawn radius is tried at before another is drawn, so that large crowns are not always refused."""
FILL_ORDER, FILL_RADIUS, FILL_X, FILL_Y = 0xF111, 0xF112, 0xF113, 0xF114
"""Streams of chance, laid over the key."""


@kernel
def deep_ground(squares, law):
    """Return a mask of cells whose discs are too large for the law."""
    height, width = squares.shape
    deep = np.zeros((height, width), dtype=np.uint8)
    for row in range(height):
        for col in range(width):
            deep[row, col] = np.sqrt(squares[row, col]) - HALF > law.most
    return deep


@kernel
def large_crowns(standing, deep, labels, taken, ground, squares, stems, law, largest, coverage):
    """Put a large crown up where deep ground is round and stands by itself, and take that out of it.

    What is left of `deep` are woods; parts of it where no stem may stand are taken out, too.
    """
    height, width = deep.shape
    parts = label(deep, labels, np.empty(deep.size, dtype=np.int64))
    if parts == 0:
        return 0
    peak = np.full(parts + 1, -1, dtype=np.int64)
    highest = np.zeros(parts + 1)
    size = np.zeros(parts + 1)
    for row in range(height):
        for col in range(width):
            part = labels[row, col]
            size[part] += 1.0
            if part and stems[row, col] and squares[row, col] > highest[part]:
                highest[part] = squares[row, col]
                peak[part] = row * width + col
    is_wood = peak >= 0
    count = 0
    for part in range(1, parts + 1):
        if not is_wood[part]:
            continue
        radius = np.sqrt(highest[part]) - HALF
        x, y = peak[part] % width + 0.5, peak[part] // width + 0.5
        asked = RING_BARE + (RING_BARE_LARGE - RING_BARE) * min(LARGER_BY * (radius / law.most - 1.0), 1.0)
        is_round = size[part] <= ROUND * np.pi * (radius - law.most + 1.0) ** 2
        if coverage >= 1.0 and radius <= largest and is_round and bare_ring(ground, x, y, radius) >= asked:
            stand(standing, count, x, y, radius, SHOWN)
            paint(taken, x, y, radius, 1)
            count += 1
            is_wood[part] = False
    for row in range(height):
        for col in range(width):
            if deep[row, col] and not is_wood[labels[row, col]]:
                deep[row, col] = 0
    return count


@kernel
def beyond(woods, ground, reach):
    """Return ground farther than `reach` from deep woods: what is not closed canopy."""
    height, width = ground.shape
    squares = np.empty((height, width))
    squared_distances(woods, float(height + width), squares)
    open_ground = ground.copy()
    for row in range(height):
        for col in range(width):
            if squares[row, col] <= reach * reach:
                open_ground[row, col] = 0
    return open_ground


@kernel
def fill_woods(standing, count, ground, open_ground, squares, stems, law, key):
    """Fill closed canopy with crowns in random places: first of drawn radii, each tried for a while, then of the mean.

    Every cell is tried once each time, in random order, at a random place in it.
    """
    height, width = ground.shape
    cells = np.empty(ground.size, dtype=np.int64)
    total = 0
    for row in range(height):
        for col in range(width):
            if ground[row, col] and not open_ground[row, col] and stems[row, col]:
                cells[total] = row * width + col
                total += 1
    cells = cells[:total]
    order = np.empty(total)
    for i in range(total):
        order[i] = uniform(key ^ np.uint64(FILL_ORDER), cells[i])
    cells = cells[np.argsort(order, kind="mergesort")]
    for drawn in (True, False):
        number, tried = 0, 0
        radius = drawn_radius(key ^ np.uint64(FILL_RADIUS), number, law.mean, law.sd, law.spread) if drawn else law.mean
        for cell in cells:
            if count == len(standing.discs):
                return count
            row, col = cell // width, cell % width
            x = col + uniform(key ^ np.uint64(FILL_X), cell)
            y = row + uniform(key ^ np.uint64(FILL_Y), cell)
            room = np.sqrt(squares[row, col]) - HALF
            fits = room >= REACH_OVER * radius and apart(standing, x, y, radius, law.near)
            if fits:
                stand(standing, count, x, y, radius, FILLED)
                count += 1
            tried += 1
            if drawn and (fits or tried == MISSES):
                number, tried = number + 1, 0
                radius = drawn_radius(key ^ np.uint64(FILL_RADIUS), number, law.mean, law.sd, law.spread)
    return count
