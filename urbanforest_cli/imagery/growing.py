"""Regions grown from points over a field of costs."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray


def cost_distance_m(
    sources: NDArray[np.bool_], cost: NDArray[np.floating], resolution_m: tuple[float, float], *, limit_m: float
) -> NDArray[np.float32]:
    """Return the length of the cheapest way from any source to each pixel, each metre weighed by its cost.

    Steps go to the eight neighbours and cost their length in metres times the mean cost of both ends.

    Parameters
    ----------
    sources
        (row, col), true where ways begin.
    cost
        (row, col), at least 1: the weight of a metre.
    resolution_m
        Width and height of a pixel.
    limit_m
        Longer ways are not followed.

    Returns
    -------
    (row, col) float32
        `limit_m` where no way is shorter.
    """
    rows, cols = sources.shape
    found = np.full((rows + 2, cols + 2), limit_m, np.float32)
    inner = found[1:-1, 1:-1]
    inner[sources] = 0.0
    padded = np.pad(cost.astype(np.float32), 1, mode="edge")
    steps = []
    for down in (-1, 0, 1):
        for right in (-1, 0, 1):
            if down or right:
                there = (slice(1 + down, rows + 1 + down), slice(1 + right, cols + 1 + right))
                length = float(np.hypot(down * resolution_m[1], right * resolution_m[0]))
                steps.append((there, (0.5 * length) * (padded[1:-1, 1:-1] + padded[there])))
    while True:
        before = inner.copy()
        for there, length_m in steps:
            np.minimum(inner, found[there] + length_m, out=inner)
        if np.array_equal(before, inner):
            return before
