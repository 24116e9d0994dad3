"""Points at equal distances along chains of nodes."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import math

import numpy as np
from numba import njit

# Lengths and distances are compared this loosely, so that rounding decides nothing.
SLACK_M = 1e-3


@njit(cache=True, nogil=True)
def rows_along_chains(xy, chain_offsets, chain_part, chain_site, chain_closed, spacing):
    """Set points along chains, leaving out those too near to others of the same part.

    Parameters
    ----------
    xy, chain_offsets, chain_part, chain_site, chain_closed
        The chains, see `MedialAxes`.
    spacing
        Distance of points by site, above 0.

    Returns
    -------
    xy (n, 2), site (n,)
    """
    chains = len(chain_part)
    length = np.empty(chains)
    points = np.empty(chains, dtype=np.int64)
    total = 0
    for c in range(chains):
        length[c] = 0.0
        for i in range(chain_offsets[c] + 1, chain_offsets[c + 1]):
            length[c] += math.hypot(xy[i, 0] - xy[i - 1, 0], xy[i, 1] - xy[i - 1, 1])
        fit = int((length[c] + SLACK_M) / spacing[chain_site[c]])
        points[c] = max(1, fit) if chain_closed[c] else fit + 1
        total += points[c]
    out = np.empty((total, 2))
    site = np.empty(total, dtype=np.int64)
    count = 0
    begin = 0
    while begin < chains:
        end = begin
        room = 0
        while end < chains and chain_part[end] == chain_part[begin]:
            room += points[end]
            end += 1
        first = count
        apart = spacing[chain_site[begin]]
        size = 2
        while size < 2 * room:
            size *= 2
        heads = np.full(size, -1, dtype=np.int64)
        links = np.empty(room, dtype=np.int64)
        west, south = xy[chain_offsets[begin], 0], xy[chain_offsets[begin], 1]
        for c in range(begin, end):
            previous = -1
            i = chain_offsets[c]
            passed = 0.0
            here = (length[c] - (points[c] - 1) * apart) / 2
            for _ in range(points[c]):
                goal = max(0.0, min(length[c], here))
                here += apart
                step = 0.0
                while i + 1 < chain_offsets[c + 1]:
                    step = math.hypot(xy[i + 1, 0] - xy[i, 0], xy[i + 1, 1] - xy[i, 1])
                    if passed + step >= goal or i + 2 == chain_offsets[c + 1]:
                        break
                    passed += step
                    i += 1
                x, y = xy[i, 0], xy[i, 1]
                if step > 0.0:
                    t = min(1.0, (goal - passed) / step)
                    x += t * (xy[i + 1, 0] - x)
                    y += t * (xy[i + 1, 1] - y)
                column, row = math.floor((x - west) / apart), math.floor((y - south) / apart)
                if _is_free(x, y, column, row, apart - SLACK_M, previous, heads, links, out, first):
                    slot = _slot(column, row, size)
                    links[count - first] = heads[slot]
                    heads[slot] = count
                    out[count, 0] = x
                    out[count, 1] = y
                    site[count] = chain_site[c]
                    previous = count
                    count += 1
        begin = end
    return out[:count], site[:count]


@njit(cache=True, nogil=True)
def _slot(column, row, size):
    return (column * 73856093 ^ row * 19349663) & (size - 1)


@njit(cache=True, nogil=True)
def _is_free(x, y, column, row, apart, previous, heads, links, out, first):
    for i in range(column - 1, column + 2):
        for j in range(row - 1, row + 2):
            k = heads[_slot(i, j, len(heads))]
            while k >= 0:
                dx, dy = out[k, 0] - x, out[k, 1] - y
                if k != previous and dx * dx + dy * dy < apart * apart:
                    return False
                k = links[k - first]
    return True
