"""Lattices in many lots: their frames, and the centres of their cells."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

SAME_AREA = 1e-6
SAME_LENGTH_M = 1e-3
# Cells are counted this loosely, in cells, so that rounding decides nothing where a lot is half a cell too long.
COUNT_SLACK = 1e-5
# A generic direction: frames begin here, so that no lot by design has its axes change places for a rounding error.
FRAME_START = math.radians(31.7173)


@njit(cache=True, nogil=True)
def convex_hull(xy):
    """Return the corners of the convex hull, counter-clockwise from the lowest left (Andrew 1979)."""
    order = np.argsort(xy[:, 0])
    n = len(order)
    # equal eastings by northing
    for i in range(1, n):
        k = order[i]
        j = i
        while j > 0 and xy[order[j - 1], 0] == xy[k, 0] and xy[order[j - 1], 1] > xy[k, 1]:
            order[j] = order[j - 1]
            j -= 1
        order[j] = k
    hull = np.empty((2 * n + 1, 2))
    size = 0
    for turn in range(2):
        floor = size + 1
        for m in range(n):
            k = order[m] if turn == 0 else order[n - 1 - m]
            x, y = xy[k, 0], xy[k, 1]
            while size > floor:
                ax, ay = hull[size - 2, 0], hull[size - 2, 1]
                bx, by = hull[size - 1, 0], hull[size - 1, 1]
                if (bx - ax) * (y - ay) - (by - ay) * (x - ax) > 0:
                    break
                size -= 1
            hull[size, 0] = x
            hull[size, 1] = y
            size += 1
        size -= 1
    return hull[:size]


@njit(cache=True, nogil=True)
def frame_angle(hull):
    """Return the direction of the smallest rectangle around a convex polygon, in radians within a right angle.

    The rectangle lies along an edge of the hull (Freeman and Shapira 1975). Of rectangles as small as each other
    the one along the longest edge is taken, and of those the one nearest to a fixed direction.
    """
    n = len(hull)
    area = np.empty(n)
    angle = np.empty(n)
    length = np.empty(n)
    smallest = np.inf
    for i in range(n):
        j = i + 1 if i + 1 < n else 0
        dx, dy = hull[j, 0] - hull[i, 0], hull[j, 1] - hull[i, 1]
        length[i] = math.hypot(dx, dy)
        area[i] = np.inf
        if length[i] < SAME_LENGTH_M:
            continue
        dx /= length[i]
        dy /= length[i]
        low = high = dx * hull[i, 0] + dy * hull[i, 1]
        deep = 0.0
        for k in range(n):
            along = dx * hull[k, 0] + dy * hull[k, 1]
            low = min(low, along)
            high = max(high, along)
            deep = max(deep, dx * (hull[k, 1] - hull[i, 1]) - dy * (hull[k, 0] - hull[i, 0]))
        area[i] = (high - low) * deep
        angle[i] = math.atan2(dy, dx)
        smallest = min(smallest, area[i])
    if not smallest < np.inf:
        return FRAME_START
    longest = 0.0
    for i in range(n):
        if area[i] <= smallest * (1 + SAME_AREA):
            longest = max(longest, length[i])
    best = -2.0
    found = FRAME_START
    for i in range(n):
        if area[i] <= smallest * (1 + SAME_AREA) and length[i] >= longest - SAME_LENGTH_M:
            likeness = math.cos(4 * (angle[i] - FRAME_START - 0.35))
            if likeness > best:
                best = likeness
                found = angle[i]
    return found


@njit(cache=True, nogil=True)
def frames_of_lots(xy, offsets, turn):
    """Return each lot's frame: origin (n, 2), direction (n, 2) of its first axis, and low and high sides (n, 4).

    Parameters
    ----------
    xy, offsets
        (m, 2) corners of all lots and where each lot's begin.
    turn
        (n,) angle in radians by which the frame is turned against the smallest rectangle around the lot.

    Returns
    -------
    The frame's first axis lies within a right angle of a fixed direction, so a turn by 90 degrees changes nothing.
    A lot without corners has sides that enclose nothing.
    """
    lots = len(offsets) - 1
    origin = np.zeros((lots, 2))
    direction = np.zeros((lots, 2))
    sides = np.zeros((lots, 4))
    quarter = math.pi / 2
    for i in range(lots):
        a, b = offsets[i], offsets[i + 1]
        sides[i, 0], sides[i, 2] = 0.0, 0.0
        sides[i, 1], sides[i, 3] = -1.0, -1.0
        if b - a < 3:
            continue
        origin[i, 0] = xy[a:b, 0].min()
        origin[i, 1] = xy[a:b, 1].min()
        local = xy[a:b] - origin[i]
        hull = convex_hull(local)
        if len(hull) < 3:
            continue
        angle = frame_angle(hull) + turn[i] - FRAME_START
        angle = angle - math.floor(angle / quarter) * quarter + FRAME_START
        dx, dy = math.cos(angle), math.sin(angle)
        direction[i, 0], direction[i, 1] = dx, dy
        sides[i, 0] = sides[i, 2] = np.inf
        sides[i, 1] = sides[i, 3] = -np.inf
        for k in range(len(hull)):
            u = dx * hull[k, 0] + dy * hull[k, 1]
            v = dx * hull[k, 1] - dy * hull[k, 0]
            sides[i, 0] = min(sides[i, 0], u)
            sides[i, 1] = max(sides[i, 1], u)
            sides[i, 2] = min(sides[i, 2], v)
            sides[i, 3] = max(sides[i, 3], v)
    return origin, direction, sides


@njit(cache=True, nogil=True)
def first_and_count(low, high, cell, phase):
    """Return where the first cell of a lattice has its centre along one axis, and how many follow.

    `phase` in [0, 1) shifts the lattice by that share of a cell; below 0 the row is centred, with as many cells
    as come nearest to the width, so that the plants' number is the area over the cell's on average.
    """
    if high < low:
        return 0.0, 0
    if phase < 0:
        count = max(1, math.ceil((high - low) / cell - 0.5 - COUNT_SLACK))
        return (low + high - (count - 1) * cell) / 2, count
    first = low + (phase - 1.0) * cell
    return first, math.floor((high - first) / cell + 1) + 1


@njit(cache=True, nogil=True)
def rows_and_columns(sides, cell, phase):
    """Return the numbers of rows and columns of each lot's lattice, (n,) each."""
    rows = np.empty(len(cell), dtype=np.int64)
    columns = np.empty(len(cell), dtype=np.int64)
    for i in range(len(cell)):
        _, columns[i] = first_and_count(sides[i, 0], sides[i, 1], cell[i], phase[i, 0])
        _, rows[i] = first_and_count(sides[i, 2], sides[i, 3], cell[i], phase[i, 1])
    return rows, columns


@njit(cache=True, nogil=True)
def cells_of_strips(sides, cell, phase, strip_site, strip_begin, strip_end):
    """Lay out cells, strip by strip of rows.

    Parameters
    ----------
    sides, cell, phase
        (n, 4), (n,) and (n, 2) of all lots.
    strip_site, strip_begin, strip_end
        (s,) lot of each strip, its first row, and the row after its last.

    Returns
    -------
    site (m,), row and column (m, 2), centre in the lot's frame (m, 2)
    """
    total = 0
    for s in range(len(strip_site)):
        i = strip_site[s]
        _, columns = first_and_count(sides[i, 0], sides[i, 1], cell[i], phase[i, 0])
        total += columns * (strip_end[s] - strip_begin[s])
    site = np.empty(total, dtype=np.int64)
    number = np.empty((total, 2), dtype=np.int64)
    centre = np.empty((total, 2))
    n = 0
    for s in range(len(strip_site)):
        i = strip_site[s]
        u, columns = first_and_count(sides[i, 0], sides[i, 1], cell[i], phase[i, 0])
        v, _ = first_and_count(sides[i, 2], sides[i, 3], cell[i], phase[i, 1])
        for row in range(strip_begin[s], strip_end[s]):
            for column in range(columns):
                site[n] = i
                number[n, 0] = row
                number[n, 1] = column
                centre[n, 0] = u + column * cell[i]
                centre[n, 1] = v + row * cell[i]
                n += 1
    return site, number, centre
