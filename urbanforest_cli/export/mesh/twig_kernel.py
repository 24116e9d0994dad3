"""The compiled search for twigs that bear leaves, and for the light that leaves around leave them.

All is counted plant by plant, so that a plant's leaves do not hang on what else is in the arrays.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

MIDDLE_HEIGHT = 0.8  # the middle that leaves look away from lies lower than that of the twigs
TWIG_LENGTH_M = (0.04, 0.6)  # shorter and longer ones count as this long
GRID_CELLS = (3, 16)  # a side of the grid of leaf area
EXTINCTION = 0.5  # of each square metre of leaves
LIGHT_ABOVE, LIGHT_BESIDE = 0.4, 0.15  # share of the light from the zenith, and from each of four sides


class Twigs(NamedTuple):
    """Twigs that bear leaves, depth first, plant by plant."""

    first: NDArray[np.int64]  # (s + 1,)
    base: NDArray[np.float32]  # (n, 3)
    tip: NDArray[np.float32]  # (n, 3)
    area_m2: NDArray[np.float32]  # (n,) of leaves on each
    node: NDArray[np.int32]  # (n,) within its skeleton
    middle: NDArray[np.float64]  # (s, 3) of the crown


@njit(cache=True, nogil=True, error_model="numpy")
def find_twigs(first, rows, parent, xyz, order, birth, death, pipes, season_end, leaf_area_index, twig_pipes,
               twig_seasons, smooth, area_a_metre):  # fmt: skip
    """Find the twigs that bear leaves at the end of a season, and the area of leaves on each.

    `rows` are the nodes depth first. The rules are those of `plant_scene.build_wood` and `build_leaves`: wood that
    carries few twig ends or is young, moved as the bark of pictures is; the area of leaves gives a plant its leaf area
    index, between a least and a most area on each metre.
    """
    plants, nodes = len(first) - 1, len(parent)
    after = np.full(nodes, -1, np.int64)
    for s in range(plants):
        root = first[s]
        for i in range(root + 1, first[s + 1]):
            p = root + parent[i]
            if order[i] == order[p] and death[i] == 0:
                after[p] = i
    bears = np.zeros(nodes, np.bool_)
    total = 0
    for s in range(plants):
        root, end = first[s], np.int64(season_end[s])
        for i in range(root + 1, first[s + 1]):
            stands = birth[i] <= end and (death[i] == 0 or death[i] > end)
            if stands and (pipes[i] <= twig_pipes or end - np.int64(birth[i]) < twig_seasons):
                bears[i] = True
                total += 1
    out = Twigs(
        np.zeros(plants + 1, np.int64), np.empty((total, 3), np.float32), np.empty((total, 3), np.float32),
        np.empty(total, np.float32), np.empty(total, np.int32), np.zeros((plants, 3)),
    )  # fmt: skip
    filled = 0
    for s in range(plants):
        root, begin = first[s], filled
        x_sum, y_sum, z_sum, xx_sum, yy_sum, metres = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
        for k in range(root, first[s + 1]):
            i = rows[k]
            if not bears[i]:
                continue
            p = root + parent[i]
            square = 0.0
            for c in range(3):
                tip = _moved(xyz, parent, after, root, i, c, smooth)
                base = _moved(xyz, parent, after, root, p, c, smooth)
                out.tip[filled, c], out.base[filled, c] = tip, base
                square += (tip - base) ** 2
            length = min(max(np.sqrt(square), TWIG_LENGTH_M[0]), TWIG_LENGTH_M[1])
            x, y = np.float64(out.tip[filled, 0]), np.float64(out.tip[filled, 1])
            x_sum, y_sum, z_sum = x_sum + x, y_sum + y, z_sum + out.tip[filled, 2]
            xx_sum, yy_sum, metres = xx_sum + x * x, yy_sum + y * y, metres + length
            out.area_m2[filled] = length
            out.node[filled] = i - root
            filled += 1
        out.first[s + 1] = filled
        number = filled - begin
        if number == 0:
            continue
        mx, my = x_sum / number, y_sum / number
        out.middle[s, 0], out.middle[s, 1], out.middle[s, 2] = mx, my, MIDDLE_HEIGHT * z_sum / number
        spread = max(xx_sum / number - mx * mx, 0.0) + max(yy_sum / number - my * my, 0.0)
        # A disc's second moment about its middle is half of its squared radius.
        wanted = leaf_area_index[s] * 2.0 * np.pi * spread / max(metres, 1e-9)
        a_metre = min(max(wanted, area_a_metre[0]), area_a_metre[1])
        for t in range(begin, filled):
            out.area_m2[t] *= a_metre
    return out


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _moved(xyz, parent, after, root, i, c, share):
    here = np.float64(xyz[i, c])
    if i == root or after[i] < 0:
        return here
    middle = 0.5 * (np.float64(xyz[root + parent[i], c]) + np.float64(xyz[after[i], c]))
    return here + share * (middle - here)


@njit(cache=True, nogil=True, error_model="numpy")
def cells_a_side(twigs, s):
    """Return how many cells a side a plant's grid has: more where there are more twigs."""
    number = np.float64(twigs.first[s + 1] - twigs.first[s])
    return int(min(max(np.round(1.1 * number ** (1.0 / 3.0)), GRID_CELLS[0]), GRID_CELLS[1]))


@njit(cache=True, nogil=True, error_model="numpy")
def crown_light(twigs, s, low, size, light, area):
    """Fill a plant's grid with the share of light from above and four sides that reaches each cell.

    `low` (3,) and `size` (3,) are filled with its corner and a cell's sides; `light` and `area` (n, n, n) with z first.
    """
    n = len(light)
    for c in range(3):
        least, most = np.inf, -np.inf
        for t in range(twigs.first[s], twigs.first[s + 1]):
            least, most = min(least, twigs.tip[t, c]), max(most, twigs.tip[t, c])
        size[c] = max(most - least, 0.05) / n
        low[c] = least
    area[:] = 0.0
    light[:] = 0.0
    for t in range(twigs.first[s], twigs.first[s + 1]):
        i, j, k = _place(twigs, t, low, size, n)
        area[k, j, i] += twigs.area_m2[t]
    # Depth of leaves along x is area over the face of a cell across x; half of the own cell's counts.
    along_x = EXTINCTION / (size[1] * size[2])
    along_y = EXTINCTION / (size[0] * size[2])
    along_z = EXTINCTION / (size[0] * size[1])
    for a in range(n):
        for b in range(n):
            down, east, west, north, south = 0.0, 0.0, 0.0, 0.0, 0.0
            for d in range(n):
                e = n - 1 - d
                here = along_z * area[e, a, b]
                light[e, a, b] += LIGHT_ABOVE * np.exp(-down - 0.5 * here)
                down += here
                here = along_x * area[a, b, d]
                light[a, b, d] += LIGHT_BESIDE * np.exp(-west - 0.5 * here)
                west += here
                here = along_x * area[a, b, e]
                light[a, b, e] += LIGHT_BESIDE * np.exp(-east - 0.5 * here)
                east += here
                here = along_y * area[a, d, b]
                light[a, d, b] += LIGHT_BESIDE * np.exp(-south - 0.5 * here)
                south += here
                here = along_y * area[a, e, b]
                light[a, e, b] += LIGHT_BESIDE * np.exp(-north - 0.5 * here)
                north += here


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def cell_of(where, low, size, n):
    """Return which of n cells along an axis holds a place; the first or last for what lies outside."""
    return min(max(int((where - low) / size), 0), n - 1)


@njit(cache=True, nogil=True, error_model="numpy", inline="always")
def _place(twigs, t, low, size, n):
    i = cell_of(np.float64(twigs.tip[t, 0]), low[0], size[0], n)
    j = cell_of(np.float64(twigs.tip[t, 1]), low[1], size[1], n)
    k = cell_of(np.float64(twigs.tip[t, 2]), low[2], size[2], n)
    return i, j, k


@njit(cache=True, nogil=True, error_model="numpy")
def light_at(twigs, points):
    """Return (n,) the share of light from above and the sides that reaches points (n, 3) in the crown of one plant."""
    out = np.empty(len(points), np.float32)
    low, size = np.empty(3), np.empty(3)
    n = cells_a_side(twigs, 0)
    light, area = np.empty((n, n, n), np.float32), np.empty((n, n, n), np.float32)
    crown_light(twigs, 0, low, size, light, area)
    for p in range(len(points)):
        i = cell_of(np.float64(points[p, 0]), low[0], size[0], n)
        j = cell_of(np.float64(points[p, 1]), low[1], size[1], n)
        k = cell_of(np.float64(points[p, 2]), low[2], size[2], n)
        out[p] = light[k, j, i]
    return out
