"""The nodes of a medial axis: triangles inside a polygon, moved to where the axis is.

A node is moved from its triangle's circumcentre to where it is equally far from the straight edges, or corners, that
the triangle's samples stand for, so the axis of straight edges does not depend on where the samples lie; a triangle in
a convex corner becomes that corner. Nodes are arrays, `links[3 i + k]` are the neighbours of node i or -1.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

from urbanforest_cli.placement.axis_samples import FAILED, FOUND, SAME_POINT_M
from urbanforest_cli.placement.delaunay import following, previous

# Directions are told apart down to a sine of a thousandth.
SMALL = 1e-6
# Newton's steps double the figures that are right: what was this close is at its place after one more.
CLOSE_M = 1e-5


@njit(cache=True, nogil=True)
def axis_graph(x, y, features, es, edge_count, edge_at, triangles, origin, twin, edges):
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
