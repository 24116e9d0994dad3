"""The compiled part of telling crowns apart in covered ground.

A crown shows as a place that is farther from bare ground than those around it. Such places are taken from the deepest
on, unless they lie in a disc taken already or overlap it much; then a circle is fitted to the rim that each can see
(Kasa 1976), which brings radii to a few centimetres where crowns are discs.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

kernel: Any = njit(cache=True, nogil=True)

LEAST_DEPTH_M = 0.35
OVERLAP = 0.8
"""Share of the sum of their radii that two crowns are apart, at least."""
INSIDE_M, INSIDE_SHARE = 0.35, 0.06
SECTORS = 16
SEEN_LEAST = 0.5
COLUMNS = 4


@kernel
def find_crowns(coverage, depth, pixel_m, crowns):
    """Find crowns, also those whose middle lies outside the lot.

    Parameters
    ----------
    coverage : (height, width) uint8 percent.
    depth : (height, width) float32 distance of each cell's centre to bare ground, in metres.
    crowns : (most, 4) float64
        Gets x to the east and y to the south of the upper left corner, radius, all in metres, and the share of the
        rim that was seen.

    Returns
    -------
    How many there are; the smallest are left out where they are too many.
    """
    height, width = coverage.shape
    places = np.empty(height * width, np.int64)
    depths = np.empty(height * width, np.float32)
    found = 0
    for row in range(height):
        for col in range(width):
            d = depth[row, col]
            if d >= LEAST_DEPTH_M and _is_peak(depth, row, col, d):
                places[found] = row * width + col
                depths[found] = -d
                found += 1
    order = np.argsort(depths[:found], kind="mergesort")
    count = 0
    for k in order:
        if count == len(crowns):
            break
        row, col = places[k] // width, places[k] % width
        x, y, d = (col + 0.5) * pixel_m, (row + 0.5) * pixel_m, -depths[k]
        apart = True
        for j in range(count):
            r = crowns[j, 2]
            away = max(OVERLAP * (r + d), r * (1.0 + INSIDE_SHARE) + INSIDE_M - d)
            dx, dy = crowns[j, 0] - x, crowns[j, 1] - y
            if dx * dx + dy * dy < away * away:
                apart = False
                break
        if apart:
            crowns[count, 0], crowns[count, 1], crowns[count, 2] = x, y, d
            count += 1
    for j in range(count):
        _fit_rim(coverage, pixel_m, crowns[j], 0.25, 1.0)
        _fit_rim(coverage, pixel_m, crowns[j], 0.08, 0.6)
    return count


@kernel
def _is_peak(depth, row, col, d):
    """Tell whether no cell around is deeper; of equal ones the first counts."""
    height, width = depth.shape
    for r in range(max(row - 1, 0), min(row + 2, height)):
        for c in range(max(col - 1, 0), min(col + 2, width)):
            if depth[r, c] > d or (depth[r, c] == d and (r < row or (r == row and c < col))):
                return False
    return True


@kernel
def _fit_rim(coverage, pixel_m, crown, band_share, band_px):
    """Move a crown to the circle that fits the rim near it, where enough of it can be seen."""
    height, width = coverage.shape
    x, y, radius = crown[0] / pixel_m - 0.5, crown[1] / pixel_m - 0.5, crown[2] / pixel_m
    band = band_share * radius + band_px
    reach = radius + band + 1.0
    sectors = np.zeros(SECTORS, np.bool_)
    n, su, sv, suu, svv, suv, sz, suz, svz = 0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    for row in range(max(0, math.floor(y - reach)), min(height, math.ceil(y + reach) + 1)):
        for col in range(max(0, math.floor(x - reach)), min(width, math.ceil(x + reach) + 1)):
            here = coverage[row, col] - 50.0
            for way in range(2):
                r, c = row + way, col + 1 - way
                if r >= height or c >= width:
                    continue
                there = coverage[r, c] - 50.0
                if (here >= 0.0) == (there >= 0.0):
                    continue
                t = here / (here - there)
                u, v = col + t * (1 - way) - x, row + t * way - y
                apart = math.sqrt(u * u + v * v)
                if abs(apart - radius) > band:
                    continue
                sectors[int((math.atan2(v, u) / (2.0 * math.pi) + 0.5) * SECTORS) % SECTORS] = True
                z = u * u + v * v
                n += 1
                su += u
                sv += v
                suu += u * u
                svv += v * v
                suv += u * v
                sz += z
                suz += u * z
                svz += v * z
    crown[3] = sectors.sum() / SECTORS
    if n < 8 or crown[3] < SEEN_LEAST:
        return
    suu, svv, suv = suu - su * su / n, svv - sv * sv / n, suv - su * sv / n
    suz, svz = suz - su * sz / n, svz - sv * sz / n
    determinant = suu * svv - suv * suv
    if determinant <= 1e-9 * suu * svv:
        return
    a = 0.5 * (suz * svv - svz * suv) / determinant
    b = 0.5 * (svz * suu - suz * suv) / determinant
    square = (sz - 2.0 * a * su - 2.0 * b * sv) / n + a * a + b * b
    if square <= 0.0:
        return
    fitted = math.sqrt(square)
    if a * a + b * b > (0.35 * radius + 1.0) ** 2 or not 0.7 * radius - 1.0 < fitted < 1.35 * radius + 1.0:
        return
    crown[0], crown[1], crown[2] = (x + a + 0.5) * pixel_m, (y + b + 0.5) * pixel_m, fitted * pixel_m
