"""The medial axis of one polygon as a graph, pruned and cut into chains.

The polygon's edges are sampled, the samples triangulated, and edges are split until each is an edge of the Delaunay
triangulation and no triangle inside has its circumcentre beyond one. The triangles inside are then the nodes of the
axis and the edges they share its edges (Brandt and Algazi 1992). A node is moved from its circumcentre to where it is
equally far from the straight edges, or corners, that its samples stand for, so the axis of straight edges does not
depend on where the samples lie; a triangle in a convex corner becomes that corner.

All coordinates are relative to the polygon's bounding box. Nodes are arrays, `links[3 i + k]` are the neighbours of
node i or -1.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from urbanforest_cli.placement.delaunay import (
    find_half_edge,
    following,
    insert_point,
    orientation,
    previous,
    snapped,
    start_triangulation,
)

FOUND, TOO_THIN, FAILED = 0, 1, 2

SAME_POINT_M = 1e-6
SPIKE_M = 1e-5
MIN_WIDTH_M = 0.02
MIN_SAMPLE_STEP_M = 0.01
FINE_STEP_M, COARSE_STEP_M = 1.0, 2.0
MAX_SAMPLES = 500_000
REFINE_ROUNDS = 24
# No edge of natural length, a whole number of steps, lies near a change of the number of its samples.
STEP_SLACK = 0.0618
# A generic direction: coordinates along it order nodes, ties being as unlikely as can be.
ORDER_X, ORDER_Y = math.cos(0.7345), math.sin(0.7345)
SAME_LENGTH_M = 1e-3
# Directions are told apart down to a sine of a thousandth.
SMALL = 1e-6
# Newton's steps double the figures that are right: what was this close is at its place after one more.
CLOSE_M = 1e-5


@njit(cache=True, nogil=True)
def axes_of_parts(xy, ring_offsets, part_offsets, step, corner_factor, branch_factor):
    """Find the axes of many polygons.

    Parameters
    ----------
    xy, ring_offsets, part_offsets
        (n, 2) coordinates of closed rings, where each ring begins, and at which ring each polygon begins; the first
        ring of a polygon is its shell.
    step
        Distance of samples; 0 for one that fits the polygon's width, which is about twice its area by its perimeter.

    Returns
    -------
    node_xy (m, 2), node_radius (m,), chain_offsets (c + 1,), chain_part (c,), chain_closed (c,), status (parts,)
    """
    parts = len(part_offsets) - 1
    node_xy = np.empty((256, 2))
    radius = np.empty(256)
    offsets = np.zeros(65, dtype=np.int64)
    owner = np.empty(64, dtype=np.int64)
    closed = np.empty(64, dtype=np.bool_)
    status = np.empty(parts, dtype=np.int8)
    nodes = 0
    chains = 0
    for part in range(parts):
        r0, r1 = part_offsets[part], part_offsets[part + 1]
        state, west, south, x, y, r, starts, rings = _axis_of_part(
            xy, ring_offsets, r0, r1, step, corner_factor, branch_factor
        )
        status[part] = state
        more = len(x)
        if nodes + more > len(radius):
            size = max(2 * len(radius), nodes + more)
            wider = np.empty((size, 2))
            wider[:nodes] = node_xy[:nodes]
            node_xy = wider
            longer = np.empty(size)
            longer[:nodes] = radius[:nodes]
            radius = longer
        for i in range(more):
            node_xy[nodes + i, 0] = x[i] + west
            node_xy[nodes + i, 1] = y[i] + south
            radius[nodes + i] = r[i]
        for c in range(len(rings)):
            if chains == len(owner):
                offsets = _grown(offsets, 2 * chains + 1)
                owner = _grown(owner, 2 * chains)
                closed = _grown(closed, 2 * chains)
            owner[chains] = part
            closed[chains] = rings[c]
            offsets[chains + 1] = nodes + starts[c + 1]
            chains += 1
        nodes += more
    return node_xy[:nodes], radius[:nodes], offsets[: chains + 1], owner[:chains], closed[:chains], status


@njit(cache=True, nogil=True)
def _grown(array, size):
    longer = np.empty(size, dtype=array.dtype)
    longer[: len(array)] = array
    return longer


@njit(cache=True, nogil=True)
def _nothing(status):
    none = np.empty(0)
    return status, 0.0, 0.0, none, none, none, np.zeros(1, dtype=np.int64), np.empty(0, dtype=np.bool_)


@njit(cache=True, nogil=True)
def _axis_of_part(xy, ring_offsets, r0, r1, step, corner_factor, branch_factor):
    cx, cy, corner_offsets, west, south, area, perimeter = _corners(xy, ring_offsets, r0, r1)
    if len(cx) < 3 or not (area > 0.0 and perimeter < np.inf) or 2 * area / perimeter < MIN_WIDTH_M:
        return _nothing(TOO_THIN)
    if step <= 0.0:
        step = min(max(FINE_STEP_M, 0.4 * area / perimeter), COARSE_STEP_M)
    step = min(step, 0.9 * area / perimeter)
    step = max(step, perimeter / MAX_SAMPLES)
    sampled, x, y, features, ea, eb, es, edge_count, ring_starts, edges = _samples(cx, cy, corner_offsets, step)
    state, vertices, edge_count, triangles, origin, twin, edge_at = _triangulated(
        x, y, sampled, features, ea, eb, es, edge_count, ring_starts
    )
    if state != FOUND:
        return _nothing(state)
    state, nx, ny, nr, links = _dual(x, y, features, es, edge_count, edge_at, vertices, triangles, origin, twin, edges)
    if state != FOUND:
        return _nothing(state)
    alive = np.ones(len(nx), dtype=np.bool_)
    _prune(nx, ny, nr, links, alive, corner_factor, branch_factor)
    px, py, pr, starts, rings = _chains(nx, ny, nr, links, alive)
    return FOUND, west, south, px, py, pr, starts, rings


@njit(cache=True, nogil=True)
def _corners(xy, ring_offsets, r0, r1):
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
def _samples(cx, cy, corner_offsets, step):
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
def _triangulated(x, y, sampled, features, ea, eb, es, edge_count, ring_starts):
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


@njit(cache=True, nogil=True)
def _dual(x, y, features, es, edge_count, edge_at, vertices, triangles, origin, twin, edges):
    """Make the graph of the triangles inside: positions, radii and links."""
    ghost = len(x) - 1
    segment = np.full(4 * triangles, -1, dtype=np.int32)
    for e in range(edge_count):
        segment[edge_at[e]] = es[e]
    node_of = np.full(triangles, -1, dtype=np.int32)
    members = np.empty(triangles, dtype=np.int32)
    count = 0
    for e in range(edge_count):
        t = edge_at[e] // 4
        if node_of[t] < 0:
            node_of[t] = count
            members[count] = t
            count += 1
    visited = 0
    while visited < count:
        t = members[visited]
        visited += 1
        for h in range(4 * t, 4 * t + 3):
            if origin[h] == ghost:
                return FAILED, x, x, x, node_of
            if segment[h] < 0 and node_of[twin[h] // 4] < 0:
                node_of[twin[h] // 4] = count
                members[count] = twin[h] // 4
                count += 1
    east, north = edges[:, 0].max(), edges[:, 1].max()
    nx = np.empty(count)
    ny = np.empty(count)
    nr = np.empty(count)
    links = np.full(3 * count, -1, dtype=np.int32)
    for i in range(count):
        h = 4 * members[i]
        bounded = 0
        edge = h
        inner = h
        for k in range(3):
            if segment[h + k] >= 0:
                bounded += 1
                edge = h + k
            else:
                inner = h + k
                links[3 * i + k] = node_of[twin[h + k] // 4]
        if bounded == 2:
            tip = origin[previous(inner)]
            nx[i], ny[i], nr[i] = x[tip], y[tip], 0.0
        else:
            nx[i], ny[i], nr[i] = _centre(x, y, origin, edge, bounded, segment, features, edges, east, north)
    for i in range(count):
        if links[3 * i] >= 0 and links[3 * i + 1] >= 0 and links[3 * i + 2] >= 0:
            _draw_in(i, 4 * members[i], nx, ny, nr, links, origin, features, edges)
    return FOUND, nx, ny, nr, links


@njit(cache=True, nogil=True)
def _draw_in(i, h, nx, ny, nr, links, origin, features, edges):
    """Move nodes that lie beyond a junction, nearer to its third edge than to their own two, into the junction."""
    for k in range(3):
        before, j = i, links[3 * i + k]
        while True:
            onward = -1
            degree = 0
            for m in range(3 * j, 3 * j + 3):
                if links[m] >= 0:
                    degree += 1
                    if links[m] != before:
                        onward = links[m]
            if degree != 2:
                break
            nearest = np.inf
            for m in range(h, h + 3):
                apart, _, _, _ = _to_feature(nx[j], ny[j], origin[m], features, edges)
                nearest = min(nearest, apart)
            if nearest >= nr[j] - SAME_POINT_M:
                break
            nx[j], ny[j], nr[j] = nx[i], ny[i], nr[i]
            before, j = j, onward


@njit(cache=True, nogil=True)
def _to_edge(px, py, i, edges):
    """Return the vector from the nearest point of edge i to a point, and its length."""
    ux, uy, dx, dy = px - edges[i, 0], py - edges[i, 1], edges[i, 2], edges[i, 3]
    t = max(0.0, min(1.0, (ux * dx + uy * dy) * edges[i, 4]))
    ux, uy = ux - t * dx, uy - t * dy
    return ux, uy, math.sqrt(ux * ux + uy * uy)


@njit(cache=True, nogil=True)
def _to_feature(px, py, v, features, edges):
    """Return distance and direction from what a sample stands for to a point, and the nearer edge's number."""
    edge = features[v, 0]
    ux, uy, apart = _to_edge(px, py, edge, edges)
    if features[v, 1] >= 0:
        wx, wy, alternative = _to_edge(px, py, features[v, 1], edges)
        if alternative < apart:
            ux, uy, apart, edge = wx, wy, alternative, features[v, 1]
    if apart > 0.0:
        return apart, ux / apart, uy / apart, edge
    return 0.0, 0.0, 0.0, edge


@njit(cache=True, nogil=True)
def _centre(x, y, origin, edge, bounded, segment, features, edges, east, north):
    """Return where a triangle's node lies: equally far from its samples' edges, near the circumcentre."""
    a, b, c = origin[edge], origin[following(edge)], origin[previous(edge)]
    bx, by = x[b] - x[a], y[b] - y[a]
    dx, dy = x[c] - x[a], y[c] - y[a]
    twice = 2 * (bx * dy - by * dx)
    b2, d2 = bx * bx + by * by, dx * dx + dy * dy
    ox, oy = (dy * b2 - by * d2) / twice, (bx * d2 - dx * b2) / twice
    radius = math.sqrt(ox * ox + oy * oy)
    ox, oy = ox + x[a], oy + y[a]
    if bounded == 3:
        return ox, oy, radius
    if bounded == 0:
        if not (0.0 <= ox <= east and 0.0 <= oy <= north):
            ox, oy = (x[a] + x[b] + x[c]) / 3, (y[a] + y[b] + y[c]) / 3
        found, px, py, radius = _meeting_of_three(ox, oy, 0.25 * radius, a, b, c, features, edges)
        if found:
            return px, py, radius
        _, ax, ay, edge_a = _to_feature(ox, oy, a, features, edges)
        _, bx, by, edge_b = _to_feature(ox, oy, b, features, edges)
        _, cx, cy, _ = _to_feature(ox, oy, c, features, edges)
        ab = (ax - bx) ** 2 + (ay - by) ** 2
        bc = (bx - cx) ** 2 + (by - cy) ** 2
        ca = (cx - ax) ** 2 + (cy - ay) ** 2
        if bc >= ab and bc >= ca:
            px, py, _ = _middle_of_two(ox, oy, 0.25 * radius, edge_b, c, features, edges)
        else:
            px, py, _ = _middle_of_two(ox, oy, 0.25 * radius, edge_a, b if ab >= ca else c, features, edges)
        radius, _, _, _ = _to_feature(px, py, a, features, edges)
        other, _, _, _ = _to_feature(px, py, b, features, edges)
        third, _, _, _ = _to_feature(px, py, c, features, edges)
        return px, py, min(radius, other, third)
    if dx * (dx - bx) + dy * (dy - by) < 0.0:
        # too narrow to be sampled finely enough: half way from the third sample to the edge opposite
        ux, uy, width = _to_edge(x[c], y[c], segment[edge], edges)
        ox, oy, radius = x[c] - ux / 2, y[c] - uy / 2, width / 2
    return _middle_of_two(ox, oy, 0.25 * radius, segment[edge], c, features, edges)


@njit(cache=True, nogil=True)
def _middle_of_two(ox, oy, reach, edge, sample, features, edges):
    """Move a point to where it is as far from an edge as from what a sample stands for (Newton).

    A point that would have to move farther than `reach` stays where it is.
    """
    px, py = ox, oy
    for _ in range(5):
        ux, uy, apart = _to_edge(px, py, edge, edges)
        if apart == 0.0:
            break
        ux, uy = ux / apart, uy / apart
        other, wx, wy, _ = _to_feature(px, py, sample, features, edges)
        gap, gx, gy = apart - other, ux - wx, uy - wy
        slope = gx * gx + gy * gy
        if slope < SMALL:
            break
        move = gap / slope
        px, py = px - move * gx, py - move * gy
        if (px - ox) ** 2 + (py - oy) ** 2 > reach * reach:
            px, py = ox, oy
            break
        if abs(gap) < CLOSE_M:
            break
    _, _, apart = _to_edge(px, py, edge, edges)
    return px, py, apart


@njit(cache=True, nogil=True)
def _meeting_of_three(ox, oy, reach, a, b, c, features, edges):
    """Move a point to where it is as far from what each of three samples stands for (Newton), if there is one near."""
    px, py = ox, oy
    for _ in range(5):
        ra, ax, ay, sa = _to_feature(px, py, a, features, edges)
        rb, bx, by, sb = _to_feature(px, py, b, features, edges)
        rc, cx, cy, sc = _to_feature(px, py, c, features, edges)
        if sa in (sb, sc) or sb == sc:
            break
        g1, g1x, g1y = ra - rc, ax - cx, ay - cy
        g2, g2x, g2y = ra - rb, ax - bx, ay - by
        determinant = g1x * g2y - g1y * g2x
        if determinant * determinant <= SMALL * (g1x * g1x + g1y * g1y) * (g2x * g2x + g2y * g2y):
            break
        px -= (g2y * g1 - g1y * g2) / determinant
        py -= (g1x * g2 - g2x * g1) / determinant
        if (px - ox) ** 2 + (py - oy) ** 2 > reach * reach:
            break
        if abs(g1) + abs(g2) < CLOSE_M:
            return True, px, py, ra
    return False, ox, oy, 0.0


@njit(cache=True, nogil=True)
def _degree(i, links, alive):
    degree = 0
    for k in range(3 * i, 3 * i + 3):
        if links[k] >= 0 and alive[links[k]]:
            degree += 1
    return degree


@njit(cache=True, nogil=True)
def _prune(nx, ny, nr, links, alive, corner_factor, branch_factor):
    """Take off branches that end soon, until none is left.

    A branch from a junction of radius R to a corner, where the radius is 0, goes if it is at most `corner_factor` R
    long; at a corner of angle w it is R / sin(w / 2) long. One to an end of radius r goes if its length and r
    together are at most `branch_factor` R.
    """
    count = len(nx)
    degree = np.empty(count, dtype=np.int64)
    for i in range(count):
        degree[i] = _degree(i, links, alive)
    ends = np.empty(count, dtype=np.int32)
    size = 0
    for i in range(count):
        if degree[i] == 1:
            ends[size] = i
            size += 1
    gone = np.empty(size, dtype=np.int32)
    junction = np.empty(size, dtype=np.int32)
    while True:
        removed = 0
        for e in range(size):
            i, before, length = ends[e], -1, 0.0
            while degree[i] < 3:
                onward = -1
                for k in range(3 * i, 3 * i + 3):
                    j = links[k]
                    if j >= 0 and j != before and alive[j]:
                        onward = j
                if onward < 0:
                    break
                length += math.hypot(nx[onward] - nx[i], ny[onward] - ny[i])
                before, i = i, onward
            factor = branch_factor if nr[ends[e]] > 0.0 else corner_factor
            if degree[i] >= 3 and length + nr[ends[e]] <= factor * nr[i]:
                gone[removed] = ends[e]
                junction[removed] = i
                removed += 1
        if removed == 0:
            return
        for g in range(removed):
            i = gone[g]
            while i != junction[g]:
                alive[i] = False
                for k in range(3 * i, 3 * i + 3):
                    if links[k] >= 0 and alive[links[k]]:
                        i = links[k]
                        break
            degree[i] -= 1
        size = 0
        for i in range(count):
            if alive[i] and degree[i] == 1:
                ends[size] = i
                size += 1


@njit(cache=True, nogil=True)
def _order(x, y):
    return x * ORDER_X + y * ORDER_Y


@njit(cache=True, nogil=True)
def _chains(nx, ny, nr, links, alive):
    """Cut the graph into chains, in each component the longest path first, then what hangs on it, longest first."""
    count = len(nx)
    px = np.empty(3 * count + 1)
    py = np.empty(3 * count + 1)
    pr = np.empty(3 * count + 1)
    starts = np.zeros(count + 1, dtype=np.int64)
    rings = np.zeros(count, dtype=np.bool_)
    parent = np.full(count, -1, dtype=np.int32)
    dist = np.zeros(count)
    visit = np.empty(count, dtype=np.int32)
    reached = np.zeros(count, dtype=np.int8)
    height = np.zeros(count)
    tip = np.empty(count, dtype=np.int32)
    best = np.empty(count, dtype=np.int32)
    points = 0
    chains = 0
    for seed in range(count):
        if not alive[seed] or reached[seed] > 0:
            continue
        size = _walk(seed, 1, nx, ny, links, alive, parent, dist, visit, reached)
        halves = 0
        lowest = seed
        ring = True
        for v in range(size):
            i = visit[v]
            degree = _degree(i, links, alive)
            halves += degree
            ring = ring and degree == 2
            if _order(nx[i], ny[i]) < _order(nx[lowest], ny[lowest]):
                lowest = i
        ring = ring and size > 2
        if halves >= 2 * size:
            _cut_loops(visit[:size], nx, ny, links, alive)
        size = _walk(lowest, 2, nx, ny, links, alive, parent, dist, visit, reached)
        root = _farthest_end(visit, size, nx, ny, links, alive, dist)
        size = _walk(root, 3, nx, ny, links, alive, parent, dist, visit, reached)
        heads = 1
        for v in range(size - 1, -1, -1):
            i = visit[v]
            best[i] = -1
            height[i] = 0.0
            tip[i] = i
            children = 0
            for k in range(3 * i, 3 * i + 3):
                j = links[k]
                if j < 0 or not alive[j] or parent[j] != i or j == parent[i]:
                    continue
                children += 1
                reach = height[j] + dist[j] - dist[i]
                if best[i] < 0 or _comes_first(reach, tip[j], height[i], tip[i], nx, ny):
                    best[i] = j
                    height[i] = reach
                    tip[i] = tip[j]
            heads += max(0, children - 1)
        head = np.empty(heads, dtype=np.int32)
        length = np.empty(heads)
        n = 0
        for v in range(size):
            i = visit[v]
            up = parent[i]
            if up < 0 or best[up] != i:
                head[n] = i
                length[n] = height[i] + (dist[i] - dist[up] if up >= 0 else 0.0)
                n += 1
        _sort_chains(head, length, tip, nx, ny)
        for h in range(heads):
            i = head[h]
            begin = points
            if parent[i] >= 0:
                points = _append(px, py, pr, begin, points, nx, ny, nr, parent[i])
            while i >= 0:
                points = _append(px, py, pr, begin, points, nx, ny, nr, i)
                i = best[i]
            if ring:
                points = _append(px, py, pr, begin, points, nx, ny, nr, head[h])
            one, other = begin, points - 1
            if ring and other - one > 2:
                one, other = one + 1, other - 1
            if parent[head[h]] < 0 and _order(px[other], py[other]) < _order(px[one], py[one]):
                px[begin:points] = px[begin:points][::-1].copy()
                py[begin:points] = py[begin:points][::-1].copy()
                pr[begin:points] = pr[begin:points][::-1].copy()
            rings[chains] = ring
            chains += 1
            starts[chains] = points
    return px[:points], py[:points], pr[:points], starts[: chains + 1], rings[:chains]


@njit(cache=True, nogil=True)
def _append(px, py, pr, begin, points, nx, ny, nr, i):
    """Append a node to a chain unless it stands where the last one does."""
    if points > begin and math.hypot(nx[i] - px[points - 1], ny[i] - py[points - 1]) < 1e-9:
        return points
    px[points] = nx[i]
    py[points] = ny[i]
    pr[points] = nr[i]
    return points + 1


@njit(cache=True, nogil=True)
def _walk(root, turn, nx, ny, links, alive, parent, dist, visit, reached):
    """Visit a component from a root: parents before children, with distances along the graph.

    `reached` is marked with `turn`, a number not used before.
    """
    parent[root] = -1
    dist[root] = 0.0
    reached[root] = turn
    visit[0] = root
    size = 1
    done = 0
    while done < size:
        i = visit[done]
        done += 1
        for k in range(3 * i, 3 * i + 3):
            j = links[k]
            if j >= 0 and alive[j] and reached[j] != turn:
                reached[j] = turn
                parent[j] = i
                dist[j] = dist[i] + math.hypot(nx[j] - nx[i], ny[j] - ny[i])
                visit[size] = j
                size += 1
    return size


@njit(cache=True, nogil=True)
def _farthest_end(visit, size, nx, ny, links, alive, dist):
    """Return the farthest end among the nodes visited; of those equally far the first along the generic direction."""
    far = 0.0
    for v in range(size):
        far = max(far, dist[visit[v]])
    found = -1
    for v in range(size):
        i = visit[v]
        if dist[i] < far - SAME_LENGTH_M or _degree(i, links, alive) > 1:
            continue
        if found < 0 or _order(nx[i], ny[i]) < _order(nx[found], ny[found]):
            found = i
    return found


@njit(cache=True, nogil=True)
def _comes_first(length, tip, other_length, other_tip, nx, ny):
    if abs(length - other_length) > SAME_LENGTH_M:
        return length > other_length
    return _order(nx[tip], ny[tip]) < _order(nx[other_tip], ny[other_tip])


@njit(cache=True, nogil=True)
def _sort_chains(head, length, tip, nx, ny):
    """Sort chains but the first by length, then by where they end."""
    rest = np.argsort(-length[1:]) + 1
    head[1:] = head[rest]
    length[1:] = length[rest]
    for i in range(2, len(head)):
        h, l = head[i], length[i]
        j = i
        while j > 1 and _comes_first(l, tip[h], length[j - 1], tip[head[j - 1]], nx, ny):
            head[j] = head[j - 1]
            length[j] = length[j - 1]
            j -= 1
        head[j] = h
        length[j] = l


@njit(cache=True, nogil=True)
def _cut_loops(nodes, nx, ny, links, alive):
    """Cut every loop at its edge that comes first along the generic direction (Kruskal 1956)."""
    links_from = np.empty(3 * len(nodes), dtype=np.int32)
    links_to = np.empty(3 * len(nodes), dtype=np.int32)
    place = np.empty(3 * len(nodes))
    edges = 0
    for i in nodes:
        for k in range(3 * i, 3 * i + 3):
            j = links[k]
            if j > i and alive[j]:
                links_from[edges] = i
                links_to[edges] = j
                place[edges] = -_order(nx[i] + nx[j], ny[i] + ny[j])
                edges += 1
    group = np.arange(len(nx)).astype(np.int32)
    for e in np.argsort(place[:edges]):
        i, j = links_from[e], links_to[e]
        a = _group(group, i)
        b = _group(group, j)
        if a != b:
            group[a] = b
            continue
        for k in range(3):
            if links[3 * i + k] == j:
                links[3 * i + k] = -1
            if links[3 * j + k] == i:
                links[3 * j + k] = -1


@njit(cache=True, nogil=True)
def _group(group, i):
    while group[i] != i:
        group[i] = group[group[i]]
        i = group[i]
    return i
