"""Sums over the lots around each lot, weighted by distance."""

from __future__ import annotations

import numpy as np
from numba import njit


@njit(cache=True, nogil=True)
def sum_around(x, y, strip_starts, rows, radius, sigma, columns, speaks, total, heard):
    """Add up the columns of the lots within a radius of each of some lots, itself left out.

    Lots are sorted by strip, then by x; strip k holds lots ``strip_starts[k]`` to ``strip_starts[k + 1]``, has an
    y from k to k + 1 radii above the lowest, and may be empty.

    Parameters
    ----------
    rows
        (m,) lots to add up for.
    columns
        (n, c) what is added, with weight exp(-d^2 / (2 sigma^2)).
    speaks
        (n,) which lots are heard.
    total, heard
        (m, c) and (m,): written.
    """
    strips = len(strip_starts) - 1
    strip = 0
    for m in range(len(rows)):
        i = rows[m]
        while strip_starts[strip + 1] <= i:
            strip += 1
        count = 0
        for s in range(max(strip - 1, 0), min(strip + 2, strips)):
            k = strip_starts[s] + np.searchsorted(x[strip_starts[s] : strip_starts[s + 1]], x[i] - radius)
            while k < strip_starts[s + 1] and x[k] <= x[i] + radius:
                squared = (x[k] - x[i]) ** 2 + (y[k] - y[i]) ** 2
                if k != i and speaks[k] and squared <= radius * radius:
                    count += 1
                    weight = np.exp(-0.5 * squared / (sigma * sigma))
                    for c in range(columns.shape[1]):
                        total[m, c] += weight * columns[k, c]
                k += 1
        heard[m] = count


KERNELS = (sum_around,)
