"""The compiled fit of crowns to covered ground: discs found one after another on a grid.

Lengths are in cells and places in cells from the upper left corner of the grid, x to the right, y down.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.crown_discs_kernel import (
    HALF,
    SHOWN,
    apart,
    law_of,
    new_share,
    paint,
    ridge_cells,
    sort_into_bins,
    squares_in,
    stand,
    stand_in,
    uniform,
)
from urbanforest_cli.core.crown_rims_kernel import drop_swallowed, match_area, move_to_rims, rim_points
from urbanforest_cli.core.crown_woods_kernel import beyond, deep_ground, fill_woods, large_crowns
from urbanforest_cli.core.distance_kernel import label

kernel: Any = njit(cache=True, nogil=True)

COVERED = 50
"""Percentage from which a cell is covered."""
LARGEST = 4.0
"""Largest crown that a separate blob may be, over the largest of the law: larger blobs are woods."""
NEW_SHARE, NEW_SHARE_LEFT = 0.55, 0.45
"""Least share of a disc that no other crown covers: at first, and where gaps between crowns are filled. In round trips
of discs .45 to .65 moves counts by less than .5 %; less finds more crowns that are none, more misses some."""
TIE = 0.2
"""Cells by which chance shifts the order of discs of nearly one size, less than the steps between sizes."""
GROWN = 0.25
"""Cells by which crowns are taken larger when gaps between them are looked for: half a cell's rim is no gap."""
FIT_TURNS, REFIT_TURNS, REFILLS = 5, 3, 2
"""Steps of moving to the outline at first and after each filling of gaps, and how often gaps are filled."""
THIN_ORDER, THIN_LAST = 0xF115, 0xF116
"""Streams of chance, laid over the key."""


@kernel
def fit_kernel(percent, stems, mean, variance, cut_sd, radius_min, overlap, coverage, key, fixed):
    """Fit crowns to covered ground; `core.crown_fit.fit_crowns` tells how.

    Parameters
    ----------
    percent : (height, width) uint8
        Covered percentage; 50 and more is covered, over 100 is not known and counts as not covered.
    stems : (height, width) uint8
        Cells where stems may stand.
    mean, variance, cut_sd, radius_min
        Law of radii, in cells and cells squared; the cut in deviations.
    overlap, coverage
        Shares.
    key : uint64
    fixed : (m, 3) float64
        x, y and radius of crowns that stand already.

    Returns
    -------
    (n, 3) float64 x, y, radius; (n,) int64 SHOWN or FILLED.
    """
    height, width = percent.shape
    key = np.uint64(key)
    covered, ground = _free_ground(percent, fixed)
    area = covered.sum()
    target = coverage * area - (area - ground.sum())
    if target <= 0.0:
        return np.empty((0, 3)), np.empty(0, dtype=np.int64)
    squares = squares_in(ground)
    law = law_of(mean, variance, cut_sd, radius_min, overlap)
    largest = _largest(squares, stems, law)
    standing = stand_in(64 + 2 * int(area / (np.pi * law.least * law.least)), law, height, width)
    taken = np.zeros((height, width), dtype=np.uint8)

    woods = deep_ground(squares, law)
    labels = np.empty((height, width), dtype=np.int32)
    count = large_crowns(standing, woods, labels, taken, ground, squares, stems, law, largest, coverage)
    any_woods = woods.any()
    open_ground = beyond(woods, ground, law.most) if any_woods else ground
    count = _shown_crowns(standing, count, labels, taken, woods, ground, open_ground, squares, stems, law, key)
    rims = rim_points(percent, ground, covered)
    move_to_rims(standing.discs, standing.kinds, count, rims, stems, FIT_TURNS)
    if any_woods:
        count = fill_woods(standing, count, ground, open_ground, squares, stems, law, key)
    for _ in range(REFILLS):
        before = count
        count = _fill_gaps(standing, count, ground, stems, law, largest)
        move_to_rims(standing.discs, standing.kinds, count, rims, stems, REFIT_TURNS)
        count = drop_swallowed(standing.discs, standing.kinds, count)
        if count <= before:
            break
    if coverage < 1.0:
        count = _thin(standing, count, ground, target, key)
    match_area(standing.discs, count, ground, covered, target)
    return standing.discs[:count].copy(), standing.kinds[:count].copy()


@kernel
def _free_ground(percent, fixed):
    """Return masks of what is covered, and of what of it no crown that stands already covers."""
    height, width = percent.shape
    covered = np.zeros((height, width), dtype=np.uint8)
    for row in range(height):
        for col in range(width):
            covered[row, col] = COVERED <= percent[row, col] <= 100
    ground = covered.copy()
    for i in range(len(fixed)):
        paint(ground, fixed[i, 0], fixed[i, 1], fixed[i, 2], 0)
    return covered, ground


@kernel
def _largest(squares, stems, law):
    """Return the largest radius that a crown may have here."""
    height, width = squares.shape
    largest = law.most
    for row in range(height):
        for col in range(width):
            if stems[row, col]:
                largest = max(largest, np.sqrt(squares[row, col]))
    return min(largest, LARGEST * law.most)


@kernel
def _shown_crowns(standing, count, labels, taken, woods, ground, open_ground, squares, stems, law, key):
    """Put up discs inscribed in open ground, largest first, that keep apart and cover enough of their own.

    The first crown of a blob may have any size; further ones are at least as large as a lobe.
    """
    height, width = ground.shape
    parts = label(ground, labels, np.empty(ground.size, dtype=np.int64))
    has_crown = np.zeros(parts + 1, dtype=np.uint8)
    for i in range(count):
        has_crown[labels[int(standing.discs[i, 1]), int(standing.discs[i, 0])]] = 1
    for row in range(height):
        for col in range(width):
            if woods[row, col]:
                has_crown[labels[row, col]] = 1
    cells = ridge_cells(squares, stems, open_ground, law.least)
    rank = np.empty(len(cells))
    for i in range(len(cells)):
        rank[i] = -(np.sqrt(squares[cells[i] // width, cells[i] % width]) + TIE * uniform(key, cells[i]))
    for i in np.argsort(rank, kind="mergesort"):
        row, col = cells[i] // width, cells[i] % width
        x, y, radius = col + 0.5, row + 0.5, np.sqrt(squares[row, col]) - HALF
        if radius < law.lobe and has_crown[labels[row, col]]:
            continue
        if count == len(standing.discs) or taken[row, col]:
            continue
        if not apart(standing, x, y, radius, law.near) or new_share(ground, taken, x, y, radius) < NEW_SHARE:
            continue
        stand(standing, count, x, y, radius, SHOWN)
        paint(taken, x, y, radius, 1)
        has_crown[labels[row, col]] = 1
        count += 1
    return count


@kernel
def _fill_gaps(standing, count, ground, stems, law, largest):
    """Put up crowns in what the crowns so far leave uncovered, largest first, where a lobe or more fits.

    Gaps of one size come in the order of the compiled sort, which is fixed, but neither that of rows nor numpy's.
    """
    height, width = ground.shape
    left = ground.copy()
    for i in range(count):
        paint(left, standing.discs[i, 0], standing.discs[i, 1], standing.discs[i, 2] + GROWN, 0)
    squares = squares_in(left)
    cells = ridge_cells(squares, stems, left, law.lobe)
    rank = np.empty(len(cells))
    for i in range(len(cells)):
        rank[i] = -squares[cells[i] // width, cells[i] % width]
    taken = np.zeros((height, width), dtype=np.uint8)
    sort_into_bins(standing, count, height, width)
    for i in np.argsort(rank, kind="mergesort"):
        row, col = cells[i] // width, cells[i] % width
        x, y, radius = col + 0.5, row + 0.5, min(np.sqrt(squares[row, col]) - HALF, largest)
        if count == len(standing.discs) or taken[row, col]:
            continue
        if new_share(left, taken, x, y, radius) < NEW_SHARE_LEFT or not apart(standing, x, y, radius, law.near):
            continue
        stand(standing, count, x, y, radius, SHOWN)
        paint(taken, x, y, radius, 1)
        count += 1
    return count


@kernel
def _thin(standing, count, ground, target, key):
    """Keep crowns in random order until they cover `target` cells of the ground, the last one by its share's chance."""
    order = np.empty(count)
    for i in range(count):
        order[i] = uniform(key ^ np.uint64(THIN_ORDER), i)
    taken = np.zeros(ground.shape, dtype=np.uint8)
    keep = np.zeros(count, dtype=np.uint8)
    covered = 0.0
    for i in np.argsort(order, kind="mergesort"):
        x, y, radius = standing.discs[i, 0], standing.discs[i, 1], standing.discs[i, 2]
        gain = np.pi * radius * radius * new_share(ground, taken, x, y, radius)
        if covered + gain > target and uniform(key ^ np.uint64(THIN_LAST), i) * gain > target - covered:
            break
        keep[i] = 1
        covered += gain
        paint(taken, x, y, radius, 1)
        if covered >= target:
            break
    kept = 0
    for i in range(count):
        if keep[i]:
            standing.discs[kept] = standing.discs[i]
            standing.kinds[kept] = standing.kinds[i]
            kept += 1
    return kept
