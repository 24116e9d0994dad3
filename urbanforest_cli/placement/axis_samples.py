"""Samples of a polygon's boundary, and their Delaunay triangulation.

All coordinates are relative to the polygon's bounding box and on the triangulation's grid.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from urbanforest_cli.placement.delaunay import (
    find_half_edge,
    insert_point,
    orientation,
    previous,
    snapped,
    start_triangulation,
)

FOUND, TOO_THIN, FAILED = 0, 1, 2

SAME_POINT_M = 1e-6
SPIKE_M = 1e-5
MIN_SAMPLE_STEP_M = 0.01
REFINE_ROUNDS = 24
# No edge of natural length, a whole number of steps, lies near a change of the number of its samples.
STEP_SLACK = 0.0618


@njit(cache=True, nogil=True)
def corners_of_part(xy, ring_offsets, r0, r1):
    """Copy a polygon's corners: relative to its box, on the grid, no two alike in a row, the inside on the left."""
    first, last = ring_offsets[r0], ring_offsets[r1]
    west = south = np.inf
    for i in range(first, last):
        west = min(west, xy[i, 0])
        south = min(south, xy[i, 1])
    x = np.empty(last - first + 1)
    y = np.empty(last - first + 1)
    offsets = np.zeros(r1 - r0 + 1, dtype=np.int64)
    count = 0
    rings = 0
    total = 0.0
    perimeter = 0.0
    for ring in range(r0, r1):
        begin = count
        a, b = ring_offsets[ring], ring_offsets[ring + 1]
        twice = 0.0
        for i in range(a, b - 1):
            twice += (xy[i, 0] - west) * (xy[i + 1, 1] - south) - (xy[i + 1, 0] - west) * (xy[i, 1] - south)
        backward = (twice < 0.0) == (ring == r0)
        for j in range(b - a - 1):
            i = b - 1 - j if backward else a + j
            px, py = snapped(xy[i, 0] - west), snapped(xy[i, 1] - south)
            count = _without_last(x, y, begin, count, px, py)
            x[count] = px
            y[count] = py
            count += 1
        count = _without_last(x, y, begin, count, x[begin], y[begin])
        while count - begin > 2 and _is_idle(x, y, count - 1, begin, begin + 1):
            # the ring was begun at the tip of a spike
            count -= 1
            for i in range(begin, count):
                x[i] = x[i + 1]
                y[i] = y[i + 1]
            count = _without_last(x, y, begin, count, x[begin], y[begin])
        if count - begin < 3:
            count = begin
            if ring == r0:
                break
            continue
        total += abs(twice) / 2 if ring == r0 else -abs(twice) / 2
        for i in range(begin, count):
            j = i + 1 if i + 1 < count else begin
            perimeter += math.hypot(x[j] - x[i], y[j] - y[i])
        rings += 1
        offsets[rings] = count
    return x[:count], y[:count], offsets[: rings + 1], west, south, total, perimeter


@njit(cache=True, nogil=True)
def _without_last(x, y, begin, count, px, py):
    """Drop corners from the end of a ring while, with the next one known, they add nothing to it."""
    x[count] = px
    y[count] = py
    while count > begin:
        if math.hypot(px - x[count - 1], py - y[count - 1]) >= SAME_POINT_M and (
            count - 1 == begin or not _is_idle(x, y, count - 2, count - 1, count)
        ):
            break
        count -= 1
        x[count] = px
        y[count] = py
    return count


@njit(cache=True, nogil=True)
def _is_idle(x, y, a, b, c):
    """Tell whether corner b is the tip of a spike without width between its neighbours a and c."""
    ux, uy, vx, vy = x[b] - x[a], y[b] - y[a], x[c] - x[b], y[c] - y[b]
    if ux * vx + uy * vy >= 0.0:
        return False
    longer = max(math.hypot(ux, uy), math.hypot(vx, vy))
    return abs(ux * vy - uy * vx) < SPIKE_M * longer


@njit(cache=True, nogil=True)
def boundary_samples(cx, cy, corner_offsets, step):
    """Sample every edge, its ends included.

    Row i of `edges` is the start of an edge of the polygon, the vector along it and one over its length squared. A
    sample stands for the edges in its row of `features`, the second -1 but at corners. Pieces between samples run
    from ``ea`` to ``eb`` on edge ``es``.
    """
    corners = len(cx)
    edges = np.empty((corners, 5))
    pieces = np.empty(corners, dtype=np.int64)
    total = 0
    for ring in range(len(corner_offsets) - 1):
        a, b = corner_offsets[ring], corner_offsets[ring + 1]
        for i in range(a, b):
            j = i + 1 if i + 1 < b else a
            dx, dy = cx[j] - cx[i], cy[j] - cy[i]
            square = dx * dx + dy * dy
            edges[i, 0], edges[i, 1], edges[i, 2], edges[i, 3], edges[i, 4] = cx[i], cy[i], dx, dy, 1.0 / square
            pieces[i] = max(1, math.ceil(math.sqrt(square) / step - STEP_SLACK))
            total += pieces[i]
    room = 2 * total + 256
    x = np.empty(room)
    y = np.empty(room)
    features = np.empty((room, 2), dtype=np.int32)
    ea = np.empty(room, dtype=np.int32)
    eb = np.empty(room, dtype=np.int32)
    es = np.empty(room, dtype=np.int32)
    ring_starts = np.zeros(len(corner_offsets), dtype=np.int64)
    n = 0
    for ring in range(len(corner_offsets) - 1):
        a, b = corner_offsets[ring], corner_offsets[ring + 1]
        begin = n
        for i in range(a, b):
            dx, dy = edges[i, 2], edges[i, 3]
            for k in range(pieces[i]):
                x[n] = snapped(cx[i] + dx * k / pieces[i])
                y[n] = snapped(cy[i] + dy * k / pieces[i])
                features[n, 0] = i
                features[n, 1] = -1
                if k == 0:
                    features[n, 1] = i - 1 if i > a else b - 1
                ea[n] = n
                eb[n] = n + 1
                es[n] = i
                n += 1
        eb[n - 1] = begin
        ring_starts[ring + 1] = n
    return n, x, y, features, ea, eb, es, n, ring_starts, edges


@njit(cache=True, nogil=True)
def triangulated(x, y, sampled, features, ea, eb, es, edge_count, ring_starts):
    """Triangulate the samples and split pieces of the boundary until all are edges and none is encroached upon."""
    room = len(x)
    ghost = room - 1
    origin = np.empty(8 * room, dtype=np.int32)
    twin = np.empty(8 * room, dtype=np.int32)
    start = np.full(room, -1, dtype=np.int32)
    stack = np.empty(2 * room + 8, dtype=np.int32)
    edge_at = np.full(room, -1, dtype=np.int32)
    a, b, c = 0, 0, 0
    farthest = -1.0
    for i in range(sampled):
        apart = (x[i] - x[a]) ** 2 + (y[i] - y[a]) ** 2
        if apart > farthest:
            farthest = apart
            b = i
    widest = 0.0
    for i in range(sampled):
        turn = abs(orientation(x[a], y[a], x[b], y[b], x[i], y[i]))
        if turn > widest:
            widest = turn
            c = i
    if widest == 0.0:
        return TOO_THIN, sampled, edge_count, 0, origin, twin, edge_at
    count = start_triangulation(x, y, a, b, c, ghost, origin, twin, start)
    same = np.arange(room).astype(np.int32)
    near = a
    for ring in range(len(ring_starts) - 1):
        begin, size = ring_starts[ring], ring_starts[ring + 1] - ring_starts[ring]
        stride = 1
        while 2 * stride < size:
            stride *= 2
        # coarse to fine along the ring, each sample found from one beside it
        count, near = _insert(x, y, begin, near, ghost, origin, twin, start, count, stack, same)
        while stride >= 1 and count > 0:
            for i in range(begin + stride, begin + size, 2 * stride):
                count, near = _insert(x, y, i, same[i - stride], ghost, origin, twin, start, count, stack, same)
                if count < 0:
                    break
            stride //= 2
        if count < 0:
            return FAILED, sampled, edge_count, 0, origin, twin, edge_at
    for e in range(edge_count):
        ea[e] = same[ea[e]]
        eb[e] = same[eb[e]]
    vertices = sampled
    for _ in range(REFINE_ROUNDS):
        split = 0
        missing = 0
        for e in range(edge_count):
            edge_at[e] = find_half_edge(ea[e], eb[e], origin, twin, start)
        before = edge_count
        for e in range(before):
            u, w, h = ea[e], eb[e], edge_at[e]
            wanted = h < 0
            if not wanted:
                apex = origin[previous(h)]
                if apex == ghost:
                    return FAILED, vertices, edge_count, 0, origin, twin, edge_at
                toward = (x[u] - x[apex]) * (x[w] - x[apex]) + (y[u] - y[apex]) * (y[w] - y[apex])
                wanted = toward < 0.0
            else:
                missing += 1
            if not wanted or vertices >= ghost:
                continue
            length = math.hypot(x[w] - x[u], y[w] - y[u])
            if length < (SAME_POINT_M if h < 0 else 2 * MIN_SAMPLE_STEP_M):
                continue
            # pieces at corners end on circles about them, so that the two sides of a sharp corner are split alike
            share = 0.5
            if (features[u, 1] >= 0) != (features[w, 1] >= 0):
                share = 2.0 ** round(math.log2(length / 2)) / length
                if features[w, 1] >= 0:
                    share = 1.0 - share
            m = vertices
            x[m] = snapped(x[u] + share * (x[w] - x[u]))
            y[m] = snapped(y[u] + share * (y[w] - y[u]))
            features[m, 0] = es[e]
            features[m, 1] = -1
            vertices += 1
            ea[edge_count] = m
            eb[edge_count] = w
            es[edge_count] = es[e]
            eb[e] = m
            edge_count += 1
            split += 1
        if split == 0:
            state = FOUND if missing == 0 else FAILED
            return state, vertices, edge_count, count, origin, twin, edge_at
        for e in range(before, edge_count):
            m = ea[e]
            count, near = _insert(x, y, m, eb[e], ghost, origin, twin, start, count, stack, same)
            if count < 0:
                return FAILED, vertices, edge_count, 0, origin, twin, edge_at
        if vertices > sampled:
            for e in range(edge_count):
                ea[e] = same[ea[e]]
                eb[e] = same[eb[e]]
    return FAILED, vertices, edge_count, 0, origin, twin, edge_at


@njit(cache=True, nogil=True)
def _insert(x, y, p, near, ghost, origin, twin, start, count, stack, same):
    """Insert a sample once; `same` tells which vertex stands at its place."""
    if start[p] >= 0:
        return count, p
    count, vertex = insert_point(x, y, p, start[near], ghost, origin, twin, start, count, stack)
    if vertex < 0:
        return -1, near
    same[p] = vertex
    return count, vertex
