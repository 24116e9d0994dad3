"""A medial axis as a graph, pruned and cut into chains.

Nodes are arrays, `links[3 i + k]` are the neighbours of node i or -1.
"""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

# A generic direction: coordinates along it order nodes, ties being as unlikely as can be.
ORDER_X, ORDER_Y = math.cos(0.7345), math.sin(0.7345)
SAME_LENGTH_M = 1e-3


@njit(cache=True, nogil=True)
def _degree(i, links, alive):
    degree = 0
    for k in range(3 * i, 3 * i + 3):
        if links[k] >= 0 and alive[links[k]]:
            degree += 1
    return degree


@njit(cache=True, nogil=True)
def prune_graph(nx, ny, nr, links, alive, corner_factor, branch_factor):
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
def chains_of_graph(nx, ny, nr, links, alive):
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
