"""The compiled part of the features: shares, regions, thicknesses, profiles and groups of what is covered."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.distance_kernel import distances_to, label

kernel: Any = njit(cache=True, nogil=True)

HAND_COUNT = 45
THICKNESSES_M = (0.75, 1.5, 2.5, 3.5, 5.0, 7.0)
BAND_ENDS_DM = (10, 20, 30, 45, 60, 90, 256)
ROUND = 1.35
"""Area over that of the largest disc inside, up to which a region may be one crown."""
CLOSING_M = 2.0


@kernel
def quantile(ordered, share):
    """Return a quantile of ascending numbers, 0 of none."""
    if len(ordered) == 0:
        return 0.0
    place = share * (len(ordered) - 1)
    low = int(place)
    high = min(low + 1, len(ordered) - 1)
    return ordered[low] + (place - low) * (ordered[high] - ordered[low])


@kernel
def mean_and_variance(values):
    """Return mean and unbiased variance, 0 where there are too few."""
    count = len(values)
    if count == 0:
        return 0.0, 0.0
    mean = values.mean()
    if count == 1:
        return mean, 0.0
    return mean, ((values - mean) ** 2).sum() / (count - 1)


@kernel
def hand_features(coverage, lot, ground, edge_dm, pixel_m, areas_m2, depth, room, out):
    """Write the `HAND_COUNT` features of one window, whose names `features.HAND_FEATURES` holds.

    Parameters
    ----------
    coverage, lot, ground, edge_dm : (height, width) uint8 of `core.lot_windows.LotWindows`.
    areas_m2 : of the lot and its ground.
    depth : (height, width) float32 distance of each cell's centre to uncovered ground, in metres.
    room
        mask, labels, stack and distance to work in.
    """
    mask, labels, stack, distance = room
    height, width = coverage.shape
    out[:HAND_COUNT] = 0.0
    cell_m2 = pixel_m * pixel_m
    whole, free, rim, covered, covered_free, deepest = 0.0, 0.0, 0.0, 0.0, 0.0, 0
    band_whole, band_covered = np.zeros(len(BAND_ENDS_DM)), np.zeros(len(BAND_ENDS_DM))
    by_depth = np.zeros(256)
    for row in range(height):
        for col in range(width):
            mine = 0.01 * lot[row, col]
            if mine == 0.0:
                mask[row, col] = False
                continue
            open_ = 0.01 * ground[row, col]
            share = 0.01 * coverage[row, col]
            dm = int(edge_dm[row, col])
            whole += mine
            free += open_
            rim += mine if dm < 30 else 0.0
            covered += mine * share
            covered_free += open_ * share
            deepest = max(deepest, dm)
            band = 0
            while dm >= BAND_ENDS_DM[band]:
                band += 1
            band_whole[band] += open_
            band_covered[band] += open_ * share
            by_depth[dm] += mine * share
            mask[row, col] = coverage[row, col] >= 50 and lot[row, col] >= 50
    out[0] = math.log1p(areas_m2[0])
    out[1] = math.log1p(areas_m2[1])
    out[2] = free / max(whole, 1.0)
    out[3] = rim / max(whole, 1.0)
    out[4] = 0.1 * deepest
    out[5] = pixel_m
    out[6] = covered / max(whole, 1.0)
    out[7] = covered_free / max(free, 1.0)
    for band in range(len(BAND_ENDS_DM)):
        out[31 + band] = band_covered[band] / band_whole[band] if band_whole[band] > 0.0 else 0.0
    running, half_seen = 0.0, False
    for dm in range(256):
        running += by_depth[dm]
        if running >= 0.5 * covered and not half_seen:
            out[39] = 0.1 * dm
            half_seen = True
        if running >= 0.95 * covered:
            out[38] = 0.1 * dm
            break
    if covered <= 0.0:
        return
    _regions(mask, labels, stack, depth, cell_m2, max(free, 1.0) * cell_m2, out)
    _groups(mask, labels, stack, distance, coverage, pixel_m, out)


@kernel
def _regions(mask, labels, stack, depth, cell_m2, ground_m2, out):
    """Write features 8 to 30: of the connected regions, and of how thick they are."""
    count = label(mask, labels, stack)
    if count == 0:
        return
    height, width = mask.shape
    area, deepest = np.zeros(count), np.zeros(count)
    thick = np.zeros(len(THICKNESSES_M))
    cells = 0.0
    for row in range(height):
        for col in range(width):
            k = labels[row, col] - 1
            if k >= 0:
                area[k] += cell_m2
                deepest[k] = max(deepest[k], depth[row, col])
                cells += 1.0
                for t in range(len(THICKNESSES_M)):
                    thick[t] += depth[row, col] >= THICKNESSES_M[t]
    radius = np.sort(np.sqrt(area / math.pi))
    mean, variance = mean_and_variance(radius)
    out[8] = math.log1p(count)
    out[9] = 1000.0 * count / ground_m2
    out[10], out[11], out[12] = mean, math.sqrt(variance), radius[0]
    out[13], out[14], out[15] = quantile(radius, 0.25), quantile(radius, 0.5), quantile(radius, 0.75)
    out[16] = radius[-1]
    out[17] = area.max() / area.sum()
    roundness = area / (math.pi * np.maximum(deepest, 0.25) ** 2)
    out[18] = np.minimum(roundness, 20.0).mean()
    mean, variance = mean_and_variance(deepest)
    out[19], out[20], out[21] = mean, math.sqrt(variance), deepest.max()
    alone = np.sqrt(area[roundness < ROUND] / math.pi)
    mean, variance = mean_and_variance(alone)
    out[22], out[23], out[24] = math.log1p(len(alone)), mean, variance
    for t in range(len(THICKNESSES_M)):
        out[25 + t] = thick[t] / cells


@kernel
def _groups(mask, labels, stack, distance, coverage, pixel_m, out):
    """Write features 40 to 44: of the groups that regions grow to when gaps under 4 m are closed."""
    height, width = mask.shape
    distances_to(mask, distance)
    for row in range(height):
        for col in range(width):
            mask[row, col] = distance[row, col] * pixel_m <= CLOSING_M
    count = label(mask, labels, stack)
    if count == 0:
        return
    area = np.zeros(count)
    box = np.empty((count, 4))
    box[:, :2] = 1e9
    box[:, 2:] = -1e9
    inside = 0.0
    for row in range(height):
        for col in range(width):
            k = labels[row, col] - 1
            if k >= 0:
                area[k] += 1.0
                inside += 0.01 * coverage[row, col]
                box[k, 0], box[k, 1] = min(box[k, 0], row), min(box[k, 1], col)
                box[k, 2], box[k, 3] = max(box[k, 2], row), max(box[k, 3], col)
    radius = np.sqrt(area / math.pi) * pixel_m
    out[40] = math.log1p(count)
    out[41], out[42] = radius.mean(), radius.max()
    out[43] = np.sqrt((box[:, 2] - box[:, 0]) ** 2 + (box[:, 3] - box[:, 1]) ** 2).mean() * pixel_m
    out[44] = inside / area.sum()
