"""The compiled part of fitting crowns that moves discs to the outline of covered ground and matches its area."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.crown_discs_kernel import SHOWN

kernel: Any = njit(cache=True, nogil=True)

REACH, REACH_LEAST = 0.35, 1.5
"""Farthest that the outline may be from a crown's rim to be its own: a share of the radius, and cells at least."""
EDGES_A_RADIUS = 8.0
"""Points of the outline all around a crown, over its radius in cells: each side of its square crosses 2 r edges."""
HOLD, HOLD_RADIUS = 0.12, 0.5
"""Damping as a share of the points of a whole outline, and that of the radius over that of the place: a crown whose
outline shows in a short arc alone hardly moves."""
POINTS_LEAST = 3.0
"""Points that make a circle."""
SHRINKS_MOST, GROWS_MOST, MOVES_MOST = 0.6, 1.4, 0.5
"""Bounds on radii over those at the start, and on the way of a centre over it (with half a cell more to each)."""
SWALLOWED = 0.6
"""A crown is swallowed by a larger one that holds this share of its radius on the far side."""
SCALE_LEAST, SCALE_MOST, SCALE_STEPS = 0.75, 1.4, 260
"""Bounds on the one factor that matches the area, in steps of 1/400."""
BIN = 4
"""Cells a side of the bins that the outline's points are looked up in."""


@kernel
def rim_points(percent, ground, covered):
    """Return the points (n, 2) where the percentage passes 50 between the centres of two neighbouring cells.

    Edges towards ground that crowns have taken already are no outline and are left out.
    """
    height, width = percent.shape
    points = np.empty((2 * percent.size, 2))
    count = 0
    for row in range(height):
        for col in range(width):
            for down in range(2):
                r, c = row + down, col + 1 - down
                if r >= height or c >= width or covered[row, col] == covered[r, c]:
                    continue
                if not (ground[row, col] or ground[r, c]):
                    continue
                a = 0.0 if percent[row, col] > 100 else float(percent[row, col])
                b = 0.0 if percent[r, c] > 100 else float(percent[r, c])
                t = (49.5 - a) / (b - a)
                points[count, 0] = col + 0.5 + t * (c - col)
                points[count, 1] = row + 0.5 + t * (r - row)
                count += 1
    return points[:count].copy()


@kernel
def move_to_rims(discs, kinds, count, rims, stems, turns):
    """Move and size the crowns that the outline shows so that they pass through the outline next to them.

    Each point of the outline belongs to the crown whose rim is nearest; a crown takes damped Gauss-Newton steps of the
    least-squares circle through its points. Short arcs say little and are held by the damping. A crown moves only
    where a stem may stand.
    """
    if len(rims) == 0 or count == 0:
        return
    height, width = stems.shape
    start = discs[:count].copy()
    across, down = width // BIN + 1, height // BIN + 1
    offsets, listed = _in_bins(rims, across, down)
    owner = np.empty(len(rims), dtype=np.int64)
    sums = np.empty((count, 9))
    for _ in range(turns):
        _find_owners(discs, count, rims, offsets, listed, across, down, owner)
        _sum_misfits(discs, kinds, rims, owner, sums)
        for k in range(count):
            if kinds[k] == SHOWN and sums[k, 5] >= POINTS_LEAST:
                _step(discs[k], start[k], sums[k], stems)


@kernel
def _in_bins(points, across, down):
    """Sort points into square bins; return where each bin begins in the list of points, and the list."""
    n = len(points)
    offsets = np.zeros(across * down + 1, dtype=np.int64)
    place = np.empty(n, dtype=np.int64)
    for i in range(n):
        place[i] = int(points[i, 1]) // BIN * across + int(points[i, 0]) // BIN
        offsets[place[i] + 1] += 1
    for b in range(across * down):
        offsets[b + 1] += offsets[b]
    fill = offsets[:-1].copy()
    listed = np.empty(n, dtype=np.int64)
    for i in range(n):
        listed[fill[place[i]]] = i
        fill[place[i]] += 1
    return offsets, listed


@kernel
def _find_owners(discs, count, rims, offsets, listed, across, down, owner):
    """Write the crown whose rim is nearest to each point, -1 where none is near."""
    owner[:] = -1
    misfit = np.full(len(rims), np.inf)
    for k in range(count):
        x, y, radius = discs[k, 0], discs[k, 1], discs[k, 2]
        slack = max(REACH * radius, REACH_LEAST)
        outer = radius + slack
        for br in range(max(0, int(y - outer) // BIN), min(down, int(y + outer) // BIN + 1)):
            for bc in range(max(0, int(x - outer) // BIN), min(across, int(x + outer) // BIN + 1)):
                for at in range(offsets[br * across + bc], offsets[br * across + bc + 1]):
                    i = listed[at]
                    off = abs(np.sqrt((rims[i, 0] - x) ** 2 + (rims[i, 1] - y) ** 2) - radius)
                    if off <= slack and off < misfit[i]:
                        misfit[i] = off
                        owner[i] = k


@kernel
def _sum_misfits(discs, kinds, rims, owner, sums):
    """Sum over the points of each crown what the normal equations of its circle need.

    With (u, v) the direction from its centre to a point and e how far the point lies beyond its rim, the sums are
    those of u u, u v, v v, u, v, 1, u e, v e and e.
    """
    sums[:] = 0.0
    for i in range(len(rims)):
        k = owner[i]
        if k < 0 or kinds[k] != SHOWN:
            continue
        dx, dy = rims[i, 0] - discs[k, 0], rims[i, 1] - discs[k, 1]
        away = np.sqrt(dx * dx + dy * dy)
        if away < 1e-9:
            continue
        u, v, e = dx / away, dy / away, away - discs[k, 2]
        s = sums[k]
        s[0] += u * u
        s[1] += u * v
        s[2] += v * v
        s[3] += u
        s[4] += v
        s[5] += 1.0
        s[6] += u * e
        s[7] += v * e
        s[8] += e


@kernel
def _step(disc, start, s, stems):
    """Take one damped step (J^T J + hold) step = J^T e with J = (u, v, 1), by Cramer's rule, within bounds."""
    height, width = stems.shape
    hold = HOLD * EDGES_A_RADIUS * disc[2]
    a, b, c, d, f, g = s[0] + hold, s[1], s[3], s[2] + hold, s[4], s[5] + HOLD_RADIUS * hold
    det = a * (d * g - f * f) - b * (b * g - f * c) + c * (b * f - d * c)
    if abs(det) < 1e-9:
        return
    p, q, r = s[6], s[7], s[8]
    x = disc[0] + (p * (d * g - f * f) - b * (q * g - f * r) + c * (q * f - d * r)) / det
    y = disc[1] + (a * (q * g - f * r) - p * (b * g - f * c) + c * (b * r - q * c)) / det
    radius = disc[2] + (a * (d * r - q * f) - b * (b * r - q * c) + p * (b * f - d * c)) / det
    far = np.sqrt((x - start[0]) ** 2 + (y - start[1]) ** 2)
    if 0.0 <= x < width and 0.0 <= y < height and stems[int(y), int(x)] and far <= MOVES_MOST * start[2] + 0.5:
        disc[0], disc[1] = x, y
    disc[2] = min(max(radius, SHRINKS_MOST * start[2]), GROWS_MOST * start[2] + 0.5)


@kernel
def drop_swallowed(discs, kinds, count):
    """Drop crowns that lie almost wholly in another; return how many are left."""
    kept = 0
    for i in range(count):
        swallowed = False
        if kinds[i] == SHOWN:
            for j in range(count):
                if i == j or (discs[j, 2] < discs[i, 2]) or (discs[j, 2] == discs[i, 2] and j > i):
                    continue
                away = np.sqrt((discs[i, 0] - discs[j, 0]) ** 2 + (discs[i, 1] - discs[j, 1]) ** 2)
                if away + SWALLOWED * discs[i, 2] < discs[j, 2]:
                    swallowed = True
                    break
        if not swallowed:
            discs[kept] = discs[i]
            kinds[kept] = kinds[i]
            kept += 1
    return kept


@kernel
def match_area(discs, count, ground, covered, target):
    """Scale all radii by one factor, so that the crowns cover `target` cells not taken by crowns that stand already."""
    height, width = ground.shape
    reach = np.full((height, width), 1e9)
    for k in range(count):
        x, y, radius = discs[k, 0], discs[k, 1], discs[k, 2]
        outer = SCALE_MOST * radius
        for row in range(max(0, int(y - outer)), min(height, int(y + outer) + 1)):
            for col in range(max(0, int(x - outer)), min(width, int(x + outer) + 1)):
                share = np.sqrt((col + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2) / radius
                reach[row, col] = min(reach[row, col], share)
    counts = np.zeros(SCALE_STEPS + 1)
    for row in range(height):
        for col in range(width):
            if ground[row, col] or not covered[row, col]:
                step = int(np.ceil((reach[row, col] - SCALE_LEAST) / (SCALE_MOST - SCALE_LEAST) * SCALE_STEPS))
                if step <= SCALE_STEPS:
                    counts[max(step, 0)] += 1.0
    total = counts[0]
    scale = SCALE_LEAST
    for step in range(1, SCALE_STEPS + 1):
        if total >= target:
            break
        before = total
        total += counts[step]
        part = 1.0 if total <= target else (target - before) / (total - before)
        scale = SCALE_LEAST + (SCALE_MOST - SCALE_LEAST) * (step - 1 + part) / SCALE_STEPS
    for k in range(count):
        discs[k, 2] *= scale
