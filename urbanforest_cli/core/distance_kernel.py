"""Compiled work on masks: exact Euclidean distances and connected parts."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

kernel: Any = njit(cache=True, nogil=True)

FAR = 1e6
"""Distance in cells where a mask holds nothing to measure to."""


@kernel
def squared_distances(targets, far, squares):
    """Write the squared distance in cells of each cell's centre to the centre of the nearest target.

    Columns first, then the lower envelope of parabolas along rows (Felzenszwalb and Huttenlocher 2012). Nothing beyond
    the mask is a target.

    Parameters
    ----------
    targets : (height, width) of bool or uint8, what is not 0 being a target.
    far
        Distance in cells where there is no target at all, at least height + width.
    squares : (height, width) float64, or float32 for masks of less than 2,800 cells a side, whose squares it holds
        exactly.
    """
    height, width = targets.shape
    for col in range(width):
        gap = far
        for row in range(height):
            gap = 0.0 if targets[row, col] else gap + 1.0
            squares[row, col] = min(gap, far)
        gap = far
        for row in range(height - 1, -1, -1):
            gap = 0.0 if targets[row, col] else gap + 1.0
            nearest = min(gap, float(squares[row, col]))
            squares[row, col] = nearest * nearest
    line = np.empty(width)
    apex = np.empty(width, np.int64)
    start = np.empty(width + 1)
    for row in range(height):
        all_targets = True
        for col in range(width):
            line[col] = squares[row, col]
            all_targets = all_targets and line[col] == 0.0
        if all_targets:
            continue
        top = 0
        apex[0] = 0
        start[0], start[1] = -np.inf, np.inf
        for col in range(1, width):
            while True:
                k = apex[top]
                meet = (line[col] + col * col - line[k] - k * k) / (2.0 * (col - k))
                if meet > start[top]:
                    break
                top -= 1
            top += 1
            apex[top] = col
            start[top], start[top + 1] = meet, np.inf
        k = 0
        for col in range(width):
            while start[k + 1] < col:
                k += 1
            squares[row, col] = min((col - apex[k]) ** 2 + line[apex[k]], far * far)


@kernel
def distances_to(targets, distance):
    """Write the distance in cells of each cell's centre to the centre of the nearest target, `FAR` if there is none.

    Parameters
    ----------
    targets : (height, width) of bool or uint8, what is not 0 being a target.
    distance : (height, width) float32, of less than 2,800 cells a side.
    """
    squared_distances(targets, FAR, distance)
    height, width = targets.shape
    for row in range(height):
        for col in range(width):
            distance[row, col] = math.sqrt(distance[row, col])


@kernel
def label(mask, labels, stack):
    """Number the connected parts of a mask, corners joining, from 1; return how many there are.

    Parameters
    ----------
    mask : (height, width) bool or uint8.
    labels : (height, width) of integers, 0 outside the mask.
    stack : (height * width,) int64, room for the search.
    """
    height, width = mask.shape
    labels[:] = 0
    count = 0
    for start in range(height * width):
        if not mask[start // width, start % width] or labels[start // width, start % width] != 0:
            continue
        count += 1
        labels[start // width, start % width] = count
        stack[0] = start
        size = 1
        while size > 0:
            size -= 1
            row, col = stack[size] // width, stack[size] % width
            for r in range(max(row - 1, 0), min(row + 2, height)):
                for c in range(max(col - 1, 0), min(col + 2, width)):
                    if mask[r, c] and labels[r, c] == 0:
                        labels[r, c] = count
                        stack[size] = r * width + c
                        size += 1
    return count
