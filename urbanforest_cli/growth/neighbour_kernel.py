"""The compiled part of `neighbours.py`: leafy points in the crowns of neighbours."""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.growth.grove import COLUMN_M, FRAME_STEP_M

POINT_CELL_M = 0.8
"""One point in each cell of this size; a whole number of them make a step of the frame's origin."""
CELLS_A_STEP = round(FRAME_STEP_M / POINT_CELL_M)


@njit(cache=True, nogil=True, error_model="numpy")
def crown_points(own_xy, own_crown, reach, near_xy, history, first, season_max, size, origin_cell, solid_top):
    """Scatter points in the crowns of neighbours, where they may meet the grove.

    Parameters
    ----------
    own_xy, near_xy
        (p, 2), (m, 2) positions in the frame; neighbours in an order of their own, not that of a table.
    own_crown
        (p, 3) ellipsoids of the grove's plants.
    reach
        (p,) no point is made farther than this from all of the grove's plants.
    history, first
        Ellipsoids of neighbours, a season each, as `crown_history` gives them.
    season_max
        Last season of the grove, and of all neighbours.
    size, origin_cell
        (3,) extent of the frame; (2,) which cell of the world its corner is.
    solid_top
        Heights of what is built in the frame's columns; there are no leaves inside.

    Returns
    -------
    Points (g, 3), and the seasons (g,) since when each has lain in its crown without a break, ascending.
    """
    count = 0
    points = np.empty((1024, 3), dtype=np.float32)
    seasons = np.empty(1024, dtype=np.int32)
    rivals = np.empty(len(near_xy), dtype=np.int64)
    hosts = np.empty(len(own_xy), dtype=np.int64)
    cells = np.empty(3, dtype=np.int64)
    for axis in range(3):
        cells[axis] = int(np.ceil(size[axis] / POINT_CELL_M))
    for plant in range(len(near_xy)):
        x0, y0 = near_xy[plant]
        radius, z0, half = history[first[plant + 1] - 1]
        host_count, rival_count = 0, 0
        for i in range(len(own_xy)):
            if (own_xy[i, 0] - x0) ** 2 + (own_xy[i, 1] - y0) ** 2 < (reach[i] + radius) ** 2:
                hosts[host_count] = i
                host_count += 1
        for i in range(len(near_xy)):
            other = history[first[i + 1] - 1, 0]
            if i != plant and (near_xy[i, 0] - x0) ** 2 + (near_xy[i, 1] - y0) ** 2 < (other + radius) ** 2:
                rivals[rival_count] = i
                rival_count += 1
        if host_count == 0:
            continue
        low_x, high_x = max(int((x0 - radius) / POINT_CELL_M), 0), min(int((x0 + radius) / POINT_CELL_M) + 1, cells[0])
        low_y, high_y = max(int((y0 - radius) / POINT_CELL_M), 0), min(int((y0 + radius) / POINT_CELL_M) + 1, cells[1])
        low_z, high_z = max(int((z0 - half) / POINT_CELL_M), 0), min(int((z0 + half) / POINT_CELL_M) + 1, cells[2])
        for ix in range(low_x, high_x):
            for iy in range(low_y, high_y):
                for iz in range(low_z, high_z):
                    bits = _hash(origin_cell[0] + ix, origin_cell[1] + iy, iz)
                    x = (ix + _part(bits, 0)) * POINT_CELL_M
                    y = (iy + _part(bits, 21)) * POINT_CELL_M
                    z = (iz + _part(bits, 42)) * POINT_CELL_M
                    q = _depth(x - x0, y - y0, z - z0, radius, half)
                    if q > 1.0 or x >= size[0] or y >= size[1] or z >= size[2]:
                        continue
                    within, mine = False, True
                    for n in range(host_count):
                        i = hosts[n]
                        dx, dy = x - own_xy[i, 0], y - own_xy[i, 1]
                        within |= dx * dx + dy * dy < reach[i] * reach[i]
                        mine &= q < _depth(dx, dy, z - own_crown[i, 1], own_crown[i, 0], own_crown[i, 2])
                    if not (within and mine):
                        continue
                    for n in range(rival_count):
                        i = rivals[n]
                        shape = history[first[i + 1] - 1]
                        its = _depth(x - near_xy[i, 0], y - near_xy[i, 1], z - shape[1], shape[0], shape[2])
                        if its < q or (its == q and i < plant):
                            mine = False
                            break
                    if not mine or (len(solid_top) > 1 and z < solid_top[int(y / COLUMN_M), int(x / COLUMN_M)]):
                        continue
                    row = first[plant + 1] - 1
                    while row > first[plant]:
                        shape = history[row - 1]
                        if _depth(x - x0, y - y0, z - shape[1], shape[0], shape[2]) > 1.0:
                            break
                        row -= 1
                    if count == len(seasons):
                        points = np.concatenate((points, np.empty_like(points)))
                        seasons = np.concatenate((seasons, np.empty_like(seasons)))
                    points[count, 0], points[count, 1], points[count, 2] = x, y, z
                    seasons[count] = max(season_max - (first[plant + 1] - 1 - row), 1)
                    count += 1
    order = np.argsort(seasons[:count], kind="mergesort")
    return points[:count][order], seasons[:count][order]


@njit(cache=True, nogil=True, error_model="numpy")
def _depth(dx, dy, dz, radius, half):
    """Return the squared depth q * q at which a point lies in an ellipsoid; 1 on its skin."""
    return (dx * dx + dy * dy) / (radius * radius) + dz * dz / (half * half)


@njit(cache=True, nogil=True, error_model="numpy")
def _hash(ix, iy, iz):
    """Hash a cell of the world to 64 bits by the finaliser of SplitMix64 (Steele, Lea and Flood 2014), axis by axis."""
    z = np.uint64(0x6C6561667963726F)
    for part in (ix, iy, iz):
        z = (z ^ np.uint64(part)) + np.uint64(0x9E3779B97F4A7C15)
        z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
        z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
        z ^= z >> np.uint64(31)
    return z


@njit(cache=True, nogil=True, error_model="numpy")
def _part(bits, shift):
    """Return 21 bits of a hash as a number in [0, 1)."""
    return np.float64((bits >> np.uint64(shift)) & np.uint64(0x1FFFFF)) * 2.0**-21
