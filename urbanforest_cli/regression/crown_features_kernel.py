"""The compiled part of the features that come of crowns told apart: radii, gaps, places, groups, saturation."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.distance_kernel import distances_to
from urbanforest_cli.regression.features_kernel import mean_and_variance, quantile

kernel: Any = njit(cache=True, nogil=True)

CROWN_COUNT = 66
JAMMED, EDGE_GAIN = 0.547, 0.8
"""Cover of a saturated ground, and by how many mean radii ground grows at its edge (`placement.poisson`)."""
WELL_SEEN = 0.7
LINKS = (1.0, 2.5, 4.0)
"""Gaps in mean radii below which crowns belong to one group."""
REACHES = (1.0, 1.5, 2.0, 3.0, 4.5, 7.0)
"""Distances from the nearest crown's middle, in mean radii, at which empty space is looked at."""


@kernel
def crown_features(crowns, lot, ground, edge_dm, pixel_m, room, out):
    """Write `CROWN_COUNT` features of one window, whose names `features.CROWN_FEATURES` holds.

    Parameters
    ----------
    crowns : (k, 4) of `crowns_kernel.find_crowns`; those whose middle is in the lot are counted.
    lot, ground, edge_dm : (height, width) uint8.
    room
        A bool mask and two float32 distances to work in.
    """
    out[:CROWN_COUNT] = 0.0
    height, width = lot.shape
    mine = np.empty((len(crowns), 4))
    edge = np.empty(len(crowns))
    rows, cols = np.empty(len(crowns), np.int64), np.empty(len(crowns), np.int64)
    n = 0
    for k in range(len(crowns)):
        row, col = int(crowns[k, 1] / pixel_m), int(crowns[k, 0] / pixel_m)
        if 0 <= row < height and 0 <= col < width and lot[row, col] >= 50:
            mine[n] = crowns[k]
            edge[n] = 0.1 * edge_dm[row, col]
            rows[n], cols[n] = row, col
            n += 1
    if n == 0:
        return
    mine, edge, rows, cols = mine[:n], edge[:n], rows[:n], cols[:n]
    mean = _radii(mine, out)
    _gaps(mine, mean, out)
    ordered = np.sort(edge)
    out[22], out[23], out[24] = edge.mean(), ordered[0], quantile(ordered, 0.25)
    out[25], out[26], out[27] = quantile(ordered, 0.5), quantile(ordered, 0.75), quantile(ordered, 0.9)
    out[28] = ordered[-1]
    out[29] = ordered[-2] if n > 1 else ordered[0]
    out[30] = quantile(np.sort(edge[mine[:, 3] >= WELL_SEEN]), 1.0)
    top, bottom, west, east = _bounds(lot)
    part = (slice(top, bottom), slice(west, east))
    mask, to_house, to_crown = room
    _ground_features(
        mine, mean, ordered, rows - top, cols - west, lot[part], ground[part], edge_dm[part], pixel_m, mask[part],
        to_house[part], to_crown[part], out,
    )  # fmt: skip
    _group_features(mine, mean, out)


@kernel
def _bounds(lot):
    """Return first and last row and column, the last not included, of a lot and the cells around it."""
    height, width = lot.shape
    top, bottom, west, east = height, 0, width, 0
    for row in range(height):
        for col in range(width):
            if lot[row, col] >= 50:
                top, bottom = min(top, row), max(bottom, row)
                west, east = min(west, col), max(east, col)
    return max(top - 1, 0), min(bottom + 2, height), max(west - 1, 0), min(east + 2, width)


@kernel
def _radii(mine, out):
    """Write features 0 to 14; return the mean radius."""
    n = len(mine)
    radius = np.sort(mine[:, 2])
    mean, variance = mean_and_variance(radius)
    out[0], out[1], out[2] = math.log1p(n), 1.0 / n, mean
    out[3], out[4] = variance, math.sqrt(variance)
    out[5], out[6], out[7] = radius[0], quantile(radius, 0.25), quantile(radius, 0.5)
    out[8], out[9] = quantile(radius, 0.75), radius[-1]
    seen = mine[:, 2][mine[:, 3] >= WELL_SEEN]
    well_mean, well_variance = mean_and_variance(seen)
    out[10], out[11], out[12] = math.log1p(len(seen)), well_mean, well_variance
    out[13] = mine[:, 3].mean()
    out[14] = 0.7413 * (quantile(radius, 0.75) - quantile(radius, 0.25))
    return max(mean, 0.3)


@kernel
def _gaps(mine, mean, out):
    """Write features 15 to 21: of the gaps to nearest crowns, and of how many crowns are near."""
    n = len(mine)
    if n < 2:
        return
    gaps = np.full(n, np.inf)
    near = np.zeros(3)
    for i in range(n):
        for j in range(n):
            if i != j:
                apart = math.sqrt((mine[i, 0] - mine[j, 0]) ** 2 + (mine[i, 1] - mine[j, 1]) ** 2)
                gaps[i] = min(gaps[i], apart - mine[i, 2] - mine[j, 2])
                for k in range(3):
                    near[k] += apart < (3.0, 5.0, 8.0)[k] * mean
    gaps = np.sort(gaps) / mean
    out[15], out[16], out[17] = gaps.mean(), gaps[0], quantile(gaps, 0.5)
    out[18] = gaps[-1]
    out[19], out[20], out[21] = near[0] / n, near[1] / n, near[2] / n


@kernel
def _ground_features(
    mine, mean, ordered, rows, cols, lot, ground, edge_dm, pixel_m, mask, to_house, to_crown, out
):  # fmt: skip
    """Write features 31 to 52: crowns against the ground that they might stand in."""
    n = len(mine)
    height, width = lot.shape
    houses = False
    for row in range(height):
        for col in range(width):
            mask[row, col] = lot[row, col] >= 50 and 2 * ground[row, col] < lot[row, col]
            houses = houses or mask[row, col]
    distances_to(mask, to_house)
    nearest = np.empty(n)
    for k in range(n):
        nearest[k] = max(to_house[rows[k], cols[k]] - 0.5, 0.0) * pixel_m
    nearest = np.sort(nearest)
    clearance = min(nearest[0], 6.0) if houses else 0.0
    out[31], out[32] = clearance, min(quantile(nearest, 0.1), 12.0) if houses else 12.0
    mask[:] = False
    for k in range(n):
        mask[rows[k], cols[k]] = True
    distances_to(mask, to_crown)
    deepest = ordered[-1] + 0.5 * pixel_m
    area, rim, band_area, band_rim, edge_sum = 0.0, 0.0, 0.0, 0.0, 0.0
    within = np.zeros(len(REACHES))
    farthest = 0.0
    for row in range(height):
        for col in range(width):
            if not _free(lot, ground, to_house, row, col, clearance, pixel_m):
                continue
            depth = 0.1 * edge_dm[row, col]
            in_band = depth <= deepest
            area += 1.0
            edge_sum += depth
            band_area += in_band
            for way in range(4):
                r, c = row + (0, 0, 1, -1)[way], col + (1, -1, 0, 0)[way]
                if r < 0 or c < 0 or r >= height or c >= width:
                    continue
                if not _free(lot, ground, to_house, r, c, clearance, pixel_m):
                    rim += 1.0
                    band_rim += in_band
                elif in_band and 0.1 * edge_dm[r, c] > deepest:
                    band_rim += 1.0
            away = to_crown[row, col] * pixel_m / mean
            farthest = max(farthest, away)
            for k in range(len(REACHES)):
                within[k] += away <= REACHES[k]
    if area == 0.0:
        return
    crown_area = math.pi * (mine[:, 2] ** 2).sum()
    full, full_band = _saturated(area, rim, mean, pixel_m), _saturated(band_area, band_rim, mean, pixel_m)
    out[33] = crown_area / (area * pixel_m * pixel_m)
    out[34], out[35] = min(n / full, 3.0), min(n / full_band, 3.0)
    out[36], out[37] = math.log(full), math.log(full_band)
    out[38] = band_area / area
    out[39] = max(n * math.log(max(band_area / area, 1e-3)), -40.0)
    out[40] = (ordered.mean() + 0.1) / (edge_sum / area + 0.1)
    for k in range(len(REACHES)):
        out[41 + k] = within[k] / area
    out[47] = farthest
    for k in range(3):
        cells = max(within[2 + k], 1.0)
        out[48 + k] = min(n * math.pi * mean * mean / (JAMMED * cells * pixel_m * pixel_m), 3.0)
    out[51] = math.log(area * pixel_m * pixel_m)
    out[52] = deepest * (n + 1.0) / n


@kernel
def _free(lot, ground, to_house, row, col, clearance, pixel_m):
    if lot[row, col] < 50 or 2 * ground[row, col] < lot[row, col]:
        return False
    return (to_house[row, col] - 0.5) * pixel_m >= clearance - 0.5 * pixel_m


@kernel
def _saturated(cells, rim_cells, mean, pixel_m):
    """Return how many crowns of a mean radius fill some ground, whose rim of cells is by 4/pi longer than it is."""
    area = cells * pixel_m * pixel_m + EDGE_GAIN * mean * rim_cells * pixel_m * math.pi / 4.0
    return max(JAMMED * area / (math.pi * mean * mean), 1.0)


@kernel
def _group_features(mine, mean, out):
    """Write features 53 to 65: groups of crowns linked over small gaps, and how far all reach."""
    n = len(mine)
    group = np.empty(n, np.int64)
    for link in range(len(LINKS)):
        count = _link(mine, LINKS[link] * mean, group)
        sizes = np.zeros(count)
        for k in range(n):
            sizes[group[k]] += 1.0
        out[53 + 3 * link] = count
        out[54 + 3 * link] = sizes.max() / n
        out[55 + 3 * link] = _widest(mine, group, int(sizes.argmax()))
    x, y = mine[:, 0] - mine[:, 0].mean(), mine[:, 1] - mine[:, 1].mean()
    xx, yy, xy = (x * x).mean(), (y * y).mean(), (x * y).mean()
    half, root = 0.5 * (xx + yy), math.sqrt(0.25 * (xx - yy) ** 2 + xy * xy)
    out[62], out[63] = math.sqrt(max(half + root, 0.0)), math.sqrt(max(half - root, 0.0))
    _link(mine, LINKS[1] * mean, group)
    total = 0.0
    for k in range(n):
        total += _widest(mine, group, group[k]) if n <= 200 or k % (n // 100) == 0 else 0.0
    out[64] = total / (n if n <= 200 else math.ceil(n / (n // 100)))
    out[65] = math.sqrt(xx + yy) / mean


@kernel
def _link(mine, gap_m, group):
    """Number groups of crowns whose rims are within a gap of one another; return how many."""
    n = len(mine)
    group[:] = -1
    waiting = np.empty(n, np.int64)
    count = 0
    for first in range(n):
        if group[first] >= 0:
            continue
        group[first] = count
        waiting[0] = first
        size = 1
        while size > 0:
            size -= 1
            i = waiting[size]
            for j in range(n):
                if group[j] < 0:
                    reach = mine[i, 2] + mine[j, 2] + gap_m
                    if (mine[i, 0] - mine[j, 0]) ** 2 + (mine[i, 1] - mine[j, 1]) ** 2 <= reach * reach:
                        group[j] = count
                        waiting[size] = j
                        size += 1
        count += 1
    return count


@kernel
def _widest(mine, group, which):
    """Return how far the middles of a group's crowns lie from the middle of their bounds, at most."""
    west, east, north, south = np.inf, -np.inf, np.inf, -np.inf
    for k in range(len(mine)):
        if group[k] == which:
            west, east = min(west, mine[k, 0]), max(east, mine[k, 0])
            north, south = min(north, mine[k, 1]), max(south, mine[k, 1])
    x, y, most = 0.5 * (west + east), 0.5 * (north + south), 0.0
    for k in range(len(mine)):
        if group[k] == which:
            most = max(most, math.sqrt((mine[k, 0] - x) ** 2 + (mine[k, 1] - y) ** 2))
    return most
