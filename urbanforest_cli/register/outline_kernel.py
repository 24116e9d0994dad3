"""Outlines of where a field is above zero: traced between cells, rounded, thinned out, true to area.

Marching squares gives the line where the field is zero, interpolated along the sides between cell centres. A map of
percentages has it nearly right; a mask of 0 and 100 makes stairs of it. So a ring's corners are averaged with their
neighbours a few times, points nearer than a tolerance to the line are left out, and the ring is moved outward by as
much as it lost in area.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

ROUNDS = 6
"""How often corners are averaged with their neighbours."""
MOVES = 2
ROUNDED_LEAST = 8
"""Corners of the smallest ring that is rounded."""
TAKEN_OFF = 0.55
"""In square cells: what averaging over cells and interpolation between them take off a disc, of any radius above one
and a half cells, beside what its chords do."""


@njit(cache=True, nogil=True, error_model="numpy")
def outlines(field, tolerance):
    """Return the outlines of a field's positive parts.

    Parts hang together over the sides of cells. The field's edge must be below zero.

    Parameters
    ----------
    field
        (h, w) float32, nowhere zero.
    tolerance
        In cells.

    Returns
    -------
    (n, 2) column and row of corners, cell centres being whole numbers; where each ring begins, and the last ends; the
    part that each bounds. The part is on the left of its rings as columns run east and rows south are turned north.
    """
    part, part_count = _parts(field)
    follows, count = _segments(field)
    xy = np.empty((count, 2), np.float64)
    rings = np.empty(count // 3 + 2, np.int64)
    owner = np.empty(count // 3 + 1, np.int64)
    raw = np.empty((count, 2), np.float64)
    width = field.shape[1]
    used = ring_count = 0
    rings[0] = 0
    for first in range(len(follows)):
        if follows[first] < 0:
            continue
        length, edge = 0, first
        while follows[edge] >= 0:
            raw[length] = _crossing(field, edge)
            length += 1
            after = follows[edge]
            follows[edge] = -1
            edge = after
        node = first // 2
        i, j = node // width, node % width
        if field[i, j] < 0:
            i, j = (i, j + 1) if first % 2 == 0 else (i + 1, j)
        kept = _rounded(raw[:length], tolerance, xy[used:])
        used += kept
        owner[ring_count] = part[i, j]
        ring_count += 1
        rings[ring_count] = used
    return xy[:used], rings[: ring_count + 1], owner[:ring_count], part_count


@njit(cache=True, nogil=True, error_model="numpy")
def _parts(field):
    """Number the positive parts, and return how many there are."""
    height, width = field.shape
    part = np.full((height, width), -1, np.int32)
    stack = np.empty((height * width, 2), np.int32)
    count = 0
    for i in range(height):
        for j in range(width):
            if field[i, j] < 0 or part[i, j] >= 0:
                continue
            part[i, j] = count
            stack[0, 0], stack[0, 1] = i, j
            left = 1
            while left:
                left -= 1
                r, c = stack[left, 0], stack[left, 1]
                for k in range(4):
                    a, b = r + (k == 0) - (k == 1), c + (k == 2) - (k == 3)
                    if 0 <= a < height and 0 <= b < width and field[a, b] > 0 and part[a, b] < 0:
                        part[a, b] = count
                        stack[left, 0], stack[left, 1] = a, b
                        left += 1
            count += 1
    return part, count


@njit(cache=True, nogil=True, error_model="numpy")
def _segments(field):
    """Return which crossing follows each, -1 for none: sides are numbered 2 (row width + col), south sides one more."""
    height, width = field.shape
    follows = np.full(2 * height * width, -1, np.int64)
    count = 0
    for i in range(height - 1):
        for j in range(width - 1):
            kind = (
                (field[i, j] > 0)
                + 2 * (field[i, j + 1] > 0)
                + 4 * (field[i + 1, j + 1] > 0)
                + 8 * (field[i + 1, j] > 0)
            )
            if kind == 0 or kind == 15:
                continue
            north, south = 2 * (i * width + j), 2 * ((i + 1) * width + j)
            west, east = 2 * (i * width + j) + 1, 2 * (i * width + j + 1) + 1
            count += 1
            if kind == 1:
                follows[west] = north
            elif kind == 2:
                follows[north] = east
            elif kind == 3:
                follows[west] = east
            elif kind == 4:
                follows[east] = south
            elif kind == 5:
                follows[west] = north
                follows[east] = south
                count += 1
            elif kind == 6:
                follows[north] = south
            elif kind == 7:
                follows[west] = south
            elif kind == 8:
                follows[south] = west
            elif kind == 9:
                follows[south] = north
            elif kind == 10:
                follows[north] = east
                follows[south] = west
                count += 1
            elif kind == 11:
                follows[south] = east
            elif kind == 12:
                follows[east] = west
            elif kind == 13:
                follows[east] = north
            else:
                follows[north] = west
    return follows, count


@njit(cache=True, nogil=True, error_model="numpy")
def _crossing(field, edge):
    """Return column and row where the field is zero on a side between two cell centres."""
    width = field.shape[1]
    node = edge // 2
    i, j = node // width, node % width
    here = float(field[i, j])
    there = float(field[i, j + 1]) if edge % 2 == 0 else float(field[i + 1, j])
    share = min(max(here / (here - there), 1e-3), 1.0 - 1e-3)
    return np.array([j + share, float(i)]) if edge % 2 == 0 else np.array([float(j), i + share])


@njit(cache=True, nogil=True, error_model="numpy")
def _rounded(raw, tolerance, out):
    """Round a ring, thin it out and bring it to its area; return how many corners were written to `out`."""
    count = len(raw)
    area = _area(raw)
    ring = raw.copy()
    if count >= ROUNDED_LEAST:
        area += _beyond_chords(raw) + math.copysign(TAKEN_OFF, area)
        other = np.empty_like(ring)
        for _ in range(ROUNDS):
            for k in range(count):
                before, after = ring[k - 1], ring[k + 1 if k + 1 < count else 0]
                other[k, 0] = 0.25 * before[0] + 0.5 * ring[k, 0] + 0.25 * after[0]
                other[k, 1] = 0.25 * before[1] + 0.5 * ring[k, 1] + 0.25 * after[1]
            ring, other = other, ring
        for _ in range(MOVES):
            ring = _moved(ring, area)
    kept = _thinned(ring, tolerance, out)
    if kept >= ROUNDED_LEAST:
        out[:kept] = _moved(out[:kept].copy(), area)
    return kept


@njit(cache=True, nogil=True, error_model="numpy")
def _area(ring):
    """Return the area in a ring, positive where its left is inside as seen with rows running north."""
    total = 0.0
    for k in range(len(ring)):
        total -= ring[k - 1, 0] * ring[k, 1] - ring[k, 0] * ring[k - 1, 1]
    return 0.5 * total


@njit(cache=True, nogil=True, error_model="numpy")
def _beyond_chords(ring):
    """Return the area between a ring and the curve through its corners: a chord L that turns by t has L^2 t / 12."""
    total, count = 0.0, len(ring)
    for k in range(count):
        after = ring[k + 1 if k + 1 < count else 0]
        x0, y0 = ring[k, 0] - ring[k - 1, 0], ring[k, 1] - ring[k - 1, 1]
        x1, y1 = after[0] - ring[k, 0], after[1] - ring[k, 1]
        turn = -math.atan2(x0 * y1 - y0 * x1, x0 * x1 + y0 * y1)
        total += turn * (x0 * x0 + y0 * y0 + x1 * x1 + y1 * y1) / 24.0
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def _moved(ring, area):
    """Return a ring moved along its normals by what it lacks in area, at most a quarter of a cell."""
    count = len(ring)
    length = 0.0
    for k in range(count):
        length += math.hypot(ring[k, 0] - ring[k - 1, 0], ring[k, 1] - ring[k - 1, 1])
    if length == 0.0:
        return ring
    step = min(max((area - _area(ring)) / length, -0.25), 0.25)
    moved = np.empty_like(ring)
    for k in range(count):
        before, after = ring[k - 1], ring[k + 1 if k + 1 < count else 0]
        x, y = after[0] - before[0], after[1] - before[1]
        size = math.hypot(x, y)
        if size == 0.0:
            moved[k] = ring[k]
        else:  # rows run south: the right of (x, -y) is (-y, -x), whose row is x
            moved[k, 0] = ring[k, 0] - step * y / size
            moved[k, 1] = ring[k, 1] + step * x / size
    return moved


@njit(cache=True, nogil=True, error_model="numpy")
def _thinned(ring, tolerance, out):
    """Leave out corners nearer than a tolerance to the line between those kept (Douglas, Peucker 1973)."""
    count = len(ring)
    keep = np.zeros(count, np.bool_)
    far, most = 0, -1.0
    for k in range(count):
        apart = (ring[k, 0] - ring[0, 0]) ** 2 + (ring[k, 1] - ring[0, 1]) ** 2
        if apart > most:
            far, most = k, apart
    keep[0] = keep[far] = True
    stack = np.empty((count + 2, 2), np.int64)
    stack[0, 0], stack[0, 1], stack[1, 0], stack[1, 1] = 0, far, far, count
    left = 2
    while left:
        left -= 1
        start, end = stack[left, 0], stack[left, 1]
        x0, y0 = ring[start, 0], ring[start, 1]
        x1, y1 = ring[end % count, 0] - x0, ring[end % count, 1] - y0
        size = math.hypot(x1, y1)
        worst, at = tolerance, -1
        for k in range(start + 1, end):
            x, y = ring[k, 0] - x0, ring[k, 1] - y0
            off = math.hypot(x, y) if size == 0.0 else abs(x * y1 - y * x1) / size
            if off > worst:
                worst, at = off, k
        if at >= 0:
            keep[at] = True
            stack[left, 0], stack[left, 1] = start, at
            stack[left + 1, 0], stack[left + 1, 1] = at, end
            left += 2
    kept = 0
    for k in range(count):
        if keep[k]:
            out[kept] = ring[k]
            kept += 1
    if kept < 3:
        for k in range(count):
            out[k] = ring[k]
        kept = count
    return kept
