"""Which points lie in polygons, and a margin away from their edges."""

from __future__ import annotations

import numpy as np
from numba import njit
from numpy.typing import NDArray

from urbanforest_cli.placement.polygons import edge_table

GUARD_M = 0.001


def inside_by_margin(
    polygons: NDArray[np.object_],
    site: NDArray[np.int64],
    xy: NDArray[np.float64],
    margin_m: float = GUARD_M,
) -> NDArray[np.bool_]:
    """Tell which points lie in their polygon, at least `margin_m` from its edge.

    Parameters
    ----------
    polygons
        (n,) polygons or multipolygons.
    site
        (m,) index of each point's polygon, non-decreasing.
    xy
        (m, 2) positions.
    """
    table = edge_table(polygons)
    point_offsets = np.searchsorted(site, np.arange(len(polygons) + 1))
    local = xy - table.origin[site]
    return np.asarray(_inside(table.edges, table.offsets, local, point_offsets, margin_m))


@njit(cache=True, nogil=True)
def _inside(edges, edge_offsets, xy, point_offsets, margin):  # type: ignore[no-untyped-def]
    """Count crossings of a ray to the east, edges sorted into bands of northing so that few are looked at."""
    result = np.zeros(len(xy), dtype=np.bool_)
    for polygon in range(len(edge_offsets) - 1):
        e0, e1 = edge_offsets[polygon], edge_offsets[polygon + 1]
        p0, p1 = point_offsets[polygon], point_offsets[polygon + 1]
        if e0 == e1 or p0 == p1:
            continue
        bottom = min(edges[e0:e1, 1].min(), edges[e0:e1, 3].min()) - margin
        top = max(edges[e0:e1, 1].max(), edges[e0:e1, 3].max()) + margin
        bands = max(1, min((e1 - e0) // 4, (p1 - p0) // 2, 65536))
        scale = bands / (top - bottom) if top > bottom else 0.0
        first = np.empty(e1 - e0, dtype=np.int64)
        last = np.empty(e1 - e0, dtype=np.int64)
        offsets = np.zeros(bands + 1, dtype=np.int64)
        for e in range(e0, e1):
            low = min(edges[e, 1], edges[e, 3]) - margin
            high = max(edges[e, 1], edges[e, 3]) + margin
            first[e - e0] = max(0, min(bands - 1, int((low - bottom) * scale)))
            last[e - e0] = max(0, min(bands - 1, int((high - bottom) * scale)))
            for band in range(first[e - e0], last[e - e0] + 1):
                offsets[band + 1] += 1
        for band in range(bands):
            offsets[band + 1] += offsets[band]
        listed = np.empty(offsets[bands], dtype=np.int64)
        fill = offsets[:bands].copy()
        for e in range(e0, e1):
            for band in range(first[e - e0], last[e - e0] + 1):
                listed[fill[band]] = e
                fill[band] += 1
        for p in range(p0, p1):
            x, y = xy[p, 0], xy[p, 1]
            if not (bottom < y < top):
                continue
            band = max(0, min(bands - 1, int((y - bottom) * scale)))
            odd = False
            apart = True
            for k in range(offsets[band], offsets[band + 1]):
                e = listed[k]
                ax, ay = edges[e, 0] - x, edges[e, 1] - y
                bx, by = edges[e, 2] - x, edges[e, 3] - y
                if (ay > 0) != (by > 0):
                    cross = ax * by - ay * bx
                    if (cross > 0) == (by > ay):
                        odd = not odd
                dx, dy = bx - ax, by - ay
                square = dx * dx + dy * dy
                t = -(ax * dx + ay * dy) / square if square > 0 else 0.0
                t = max(0.0, min(1.0, t))
                nx, ny = ax + t * dx, ay + t * dy
                if nx * nx + ny * ny < margin * margin:
                    apart = False
                    break
            result[p] = odd and apart
    return result
