"""Whose crowns a covered cell belongs to: cells of a coverage map, lots painted over them, discs in between.

Rows run south, columns east; cells are counted from the origin of the CRS, so that a cell's centre is the same number
in every window. A component of covered cells hangs together over sides, one of open ground over corners, too.
"""

from __future__ import annotations

import math

import numpy as np
from numba import njit

NOBODY = -1
UNKNOWN = 255
LARGER = 1.05
"""A crown takes the fringe of another lot's if it is larger by this."""
FAR = 1 << 20
RIDGE_SLACK = 0.2
"""In cells: how far a disc may reach out of a neighbour's and still count as held by it."""


@njit(cache=True, nogil=True, error_model="numpy")
def fill_rings(xy, rings, size, row_off, col_off, inside):
    """Set cells whose centres lie in rings, by the even-odd rule.

    Parameters
    ----------
    xy, rings
        (n, 2) positions in metres; where each ring begins, and the last ends. Rings are closed.
    size
        Side of a cell in metres.
    row_off, col_off
        Of the first cell, counted from the CRS's origin.
    inside
        (h, w) uint8, set to 0 and 1.
    """
    height, width = inside.shape
    inside[:] = 0
    for ring in range(len(rings) - 1):
        for k in range(rings[ring], rings[ring + 1] - 1):
            x0, y0, x1, y1 = xy[k, 0], xy[k, 1], xy[k + 1, 0], xy[k + 1, 1]
            if y0 == y1:
                continue
            if y0 < y1:  # walked the same way from both sides, so that neighbours share a border to the last bit
                x0, y0, x1, y1 = x1, y1, x0, y0
            first = max(math.ceil(-y0 / size - 0.5) - row_off, 0)
            last = min(math.ceil(-y1 / size - 0.5) - row_off, height)
            for i in range(first, last):
                y = -(row_off + i + 0.5) * size
                x = x0 + (x1 - x0) * ((y0 - y) / (y0 - y1))
                j = max(math.ceil(x / size - 0.5) - col_off, 0)
                if j < width:
                    inside[i, j] ^= 1
    for i in range(height):
        state = 0
        for j in range(width):
            state ^= inside[i, j]
            inside[i, j] = state


@njit(cache=True, nogil=True, error_model="numpy")
def paint(xy, rings, units, labels, boxes, size, row_off, col_off, owner):
    """Paint units over each other, the last on top.

    Parameters
    ----------
    xy, rings
        As for `fill_rings`.
    units
        Where the rings of each unit begin, and the last ends.
    labels, boxes
        (n,) what each is painted with; (n, 4) first row and column, rows and columns within the window.
    owner
        (h, w) int32, painted over.
    """
    for k in range(len(labels)):
        top, left, rows, cols = boxes[k]
        if rows <= 0 or cols <= 0:
            continue
        inside = np.empty((rows, cols), np.uint8)
        fill_rings(xy, rings[units[k] : units[k + 1] + 1], size, row_off + top, col_off + left, inside)
        for i in range(rows):
            for j in range(cols):
                if inside[i, j]:
                    owner[top + i, left + j] = labels[k]


@njit(cache=True, nogil=True, error_model="numpy")
def count_cells(xy, rings, size, row_off, col_off, percent, covered, inside):
    """Return how many cells of a shape are known, covered, and there at all."""
    fill_rings(xy, rings, size, row_off, col_off, inside)
    known = green = count = 0
    for i in range(inside.shape[0]):
        for j in range(inside.shape[1]):
            if inside[i, j]:
                count += 1
                known += percent[i, j] != UNKNOWN
                green += covered[i, j] and percent[i, j] != UNKNOWN
    return known, green, count


@njit(cache=True, nogil=True, error_model="numpy")
def cleaned(percent, threshold, least_cells):
    """Return covered cells (h, w), without regions and holes smaller than so many cells.

    What touches the window's edge is kept, for nobody knows how large it is; so is a hole with unknown ground in it.
    """
    height, width = percent.shape
    covered = np.empty((height, width), np.bool_)
    for i in range(height):
        for j in range(width):
            covered[i, j] = percent[i, j] != UNKNOWN and percent[i, j] >= threshold
    for wanted in (True, False):
        seen = np.zeros((height, width), np.bool_)
        stack = np.empty((height * width, 2), np.int32)
        for i in range(height):
            for j in range(width):
                if seen[i, j] or covered[i, j] != wanted:
                    continue
                seen[i, j] = True
                stack[0, 0], stack[0, 1] = i, j
                count, at, keep = 1, 0, False
                while at < count:
                    r, c = stack[at, 0], stack[at, 1]
                    at += 1
                    keep |= r == 0 or c == 0 or r == height - 1 or c == width - 1 or percent[r, c] == UNKNOWN
                    for dr in range(-1, 2):
                        for dc in range(-1, 2):
                            if (wanted and dr * dc != 0) or not (0 <= r + dr < height and 0 <= c + dc < width):
                                continue
                            if not seen[r + dr, c + dc] and covered[r + dr, c + dc] == wanted:
                                seen[r + dr, c + dc] = True
                                stack[count, 0], stack[count, 1] = r + dr, c + dc
                                count += 1
                if count < least_cells and not keep:
                    for k in range(count):
                        covered[stack[k, 0], stack[k, 1]] = not wanted
    return covered


@njit(cache=True, nogil=True, error_model="numpy")
def _along_columns(wanted, cap):
    """Return (h, w) int32 distances in cells to the nearest wanted cell of the same column, at most one above `cap`."""
    height, width = wanted.shape
    along = np.empty((height, width), np.int32)
    for i in range(height):
        for j in range(width):
            before = along[i - 1, j] if i else cap + 1
            along[i, j] = 0 if wanted[i, j] else min(before + 1, cap + 1)
    for i in range(height - 2, -1, -1):
        for j in range(width):
            along[i, j] = min(along[i, j], along[i + 1, j] + 1)
    return along


@njit(cache=True, nogil=True, error_model="numpy")
def squared_distances(wanted, cap):
    """Return (h, w) int32 squared distances in cells to the nearest wanted cell, exact up to `cap` cells.

    Columns first, then the lower envelope of each row within reach (Meijster, Roerdink, Hesselink 2000).
    """
    height, width = wanted.shape
    far = (cap + 1) * (cap + 1)
    along = _along_columns(wanted, cap)
    found = np.empty((height, width), np.int32)
    for i in range(height):
        for j in range(width):
            best = along[i, j] * along[i, j]
            for step in range(1, cap + 1):
                if step * step >= best:
                    break
                if j >= step:
                    best = min(best, step * step + along[i, j - step] * along[i, j - step])
                if j + step < width:
                    best = min(best, step * step + along[i, j + step] * along[i, j + step])
            found[i, j] = min(best, far)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def depths(covered, cap):
    """Return (h, w) float32 distances from covered cells to open ground, in cells, at most `cap`."""
    height, width = covered.shape
    squared = squared_distances(~covered, math.ceil(cap) + 1)
    found = np.zeros((height, width), np.float32)
    for i in range(height):
        for j in range(width):
            if covered[i, j]:
                found[i, j] = min(math.sqrt(squared[i, j]) - 0.5, cap)
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def settled(depth, owner, cap):
    """Return (h, w) int32: whose crowns covered cells belong to as stems go, `NOBODY` where open or another's fringe.

    A cell is the fringe of another lot's crown if a disc within the covered ground about a cell of that lot holds it
    and is larger than its own by `LARGER`. A lot whose own cell is such a fringe takes nothing by it: what all takers
    lose falls back to the owner.
    """
    height, width = depth.shape
    ridge = _ridges(depth, owner, cap)
    lost = np.zeros((height, width), np.bool_)
    for turn in range(2):
        before = lost.copy()
        lost[:] = False
        for i in range(height):
            for j in range(width):
                if not ridge[i, j] or (turn == 1 and before[i, j]):
                    continue
                radius, whose = depth[i, j], owner[i, j]
                reach = int(radius)
                for r in range(max(i - reach, 0), min(i + reach + 1, height)):
                    for c in range(max(j - reach, 0), min(j + reach + 1, width)):
                        if owner[r, c] == whose or owner[r, c] < 0 or depth[r, c] <= 0 or lost[r, c]:
                            continue
                        if (r - i) ** 2 + (c - j) ** 2 <= radius * radius and radius > LARGER * depth[r, c]:
                            lost[r, c] = True
    whose = np.full((height, width), NOBODY, np.int32)
    for i in range(height):
        for j in range(width):
            if depth[i, j] > 0 and owner[i, j] >= 0 and not lost[i, j]:
                whose[i, j] = owner[i, j]
    return whose


@njit(cache=True, nogil=True, error_model="numpy")
def _ridges(depth, owner, cap):
    """Return owned cells whose discs no neighbour's disc of the same owner holds."""
    height, width = depth.shape
    ridge = np.zeros((height, width), np.bool_)
    for i in range(height):
        for j in range(width):
            if depth[i, j] <= 0 or owner[i, j] < 0:
                continue
            held, level = False, True
            for dr in range(-1, 2):
                for dc in range(-1, 2):
                    r, c = i + dr, j + dc
                    if (dr == 0 and dc == 0) or not (0 <= r < height and 0 <= c < width):
                        continue
                    same = owner[r, c] == owner[i, j]
                    step = math.sqrt(dr * dr + dc * dc)
                    held |= same and depth[r, c] >= depth[i, j] + step - RIDGE_SLACK
                    level &= same and depth[r, c] >= cap
            ridge[i, j] = not held and not (level and depth[i, j] >= cap)
    return ridge


@njit(cache=True, nogil=True, error_model="numpy")
def reaching(depth, whose, cap):
    """Return (h, w) cells whose discs may reach over the border of what is settled for their lot."""
    height, width = depth.shape
    border = np.zeros((height, width), np.bool_)
    for i in range(height):
        for j in range(width):
            if depth[i, j] <= 0:
                continue
            if i + 1 < height and depth[i + 1, j] > 0 and whose[i + 1, j] != whose[i, j]:
                border[i, j] = border[i + 1, j] = True
            if j + 1 < width and depth[i, j + 1] > 0 and whose[i, j + 1] != whose[i, j]:
                border[i, j] = border[i, j + 1] = True
    along = _along_columns(border, math.ceil(cap) + 1)
    found = np.zeros((height, width), np.bool_)
    for i in range(height):
        for j in range(width):
            if whose[i, j] < 0:
                continue
            reach = depth[i, j] + 1.0
            span = math.ceil(reach) - 1
            for c in range(max(j - span, 0), min(j + span + 1, width)):
                if reach > math.sqrt((c - j) ** 2 + along[i, c] * along[i, c]):
                    found[i, j] = True
                    break
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def claims(depth, whose, reach):
    """Return who reaches farthest over covered cells that are settled for nobody, and by how much.

    Returns
    -------
    (h, w) int32, `NOBODY` where no disc comes near; (h, w) float32, how far the cell lies within the disc that reaches
    farthest over it, in cells, and the same of the next lot's. -1 for none, so that a cell has one taker.
    """
    height, width = depth.shape
    taker = np.full((height, width), NOBODY, np.int32)
    first = np.full((height, width), -1.0, np.float32)
    second = np.full((height, width), -1.0, np.float32)
    for i in range(height):
        for j in range(width):
            if not reach[i, j]:
                continue
            radius, label = depth[i, j], whose[i, j]
            span = int(radius) + 1
            for r in range(max(i - span, 0), min(i + span + 1, height)):
                for c in range(max(j - span, 0), min(j + span + 1, width)):
                    if depth[r, c] <= 0 or whose[r, c] >= 0:
                        continue
                    over = np.float32(radius - math.sqrt((r - i) ** 2 + (c - j) ** 2))
                    if label == taker[r, c]:
                        first[r, c] = max(first[r, c], over)
                    elif over > first[r, c]:
                        second[r, c] = first[r, c]
                        first[r, c], taker[r, c] = over, label
                    else:
                        second[r, c] = max(second[r, c], over)
    return taker, first, second


@njit(cache=True, nogil=True, error_model="numpy")
def heights(percent, threshold, covered, depth, whose, taker, first, second, label, top, left, field):
    """Fill a field that is above zero where the crowns of one lot are, and zero at their sub-cell outline.

    Open ground and the lot's own rise through the threshold as the percentages do; of what is settled for nobody the
    lot has what discs about its own cells hold, where no other lot's reach farther.

    Parameters
    ----------
    percent, covered, depth, whose, taker, first, second
        Of the window, as the functions of this module return them.
    label
        Of the lot in `whose`.
    top, left
        Where the field begins in the window.
    field
        (h, w) float32, in cells.
    """
    height, width = field.shape
    least = np.float32(1e-3)
    for i in range(height):
        for j in range(width):
            r, c = top + i, left + j
            share = -0.5 if percent[r, c] == UNKNOWN else (percent[r, c] - threshold) / 100.0
            edge = max(share, depth[r, c] - 0.5, least)
            if not covered[r, c]:
                field[i, j] = min(share, -least)
            elif whose[r, c] == label:
                field[i, j] = edge
            elif whose[r, c] >= 0 or taker[r, c] < 0:
                field[i, j] = -1.0
            else:
                apart = first[r, c] - max(second[r, c], np.float32(0.0))
                over = min(first[r, c], apart) if taker[r, c] == label else -max(apart, least)
                field[i, j] = min(over, edge) if over != 0.0 else -least
