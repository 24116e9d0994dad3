"""The compiled part of painting crowns as a map shows them."""

from __future__ import annotations

import math
from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.distance_kernel import label

kernel: Any = njit(cache=True, nogil=True)

HARMONICS = 4
BLUR_REACH_SD = 2.5
FAR_PX = 1e9
"""Size of what reaches the rim of a window, and may go on beyond."""


@kernel
def hashed(key, index):
    """Hash (key, index) to a number in [0, 1), as `core.randomness.hash_uniform` does."""
    z = key + (np.uint64(index) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z ^= z >> np.uint64(31)
    return float(z >> np.uint64(11)) * 2.0**-53


@kernel
def paint_disc(shares, x, y, radius, wobble, turn):
    """Add a disc, in cells, whose rim runs up and down by harmonics 2, 3, 5 and 7 of some amplitudes and turns."""
    height, width = shares.shape
    swing = 0.0
    for k in range(HARMONICS):
        swing += abs(wobble[k])
    reach = radius * (1.0 + swing) + 1.0
    for row in range(max(0, math.floor(y - reach)), min(height, math.floor(y + reach) + 1)):
        dy = row + 0.5 - y
        for col in range(max(0, math.floor(x - reach)), min(width, math.floor(x + reach) + 1)):
            dx = col + 0.5 - x
            apart = math.sqrt(dx * dx + dy * dy)
            if apart > reach:
                continue
            rim = radius
            if swing > 0.0 and apart > radius * (1.0 - swing) - 1.0:
                angle = math.atan2(dy, dx)
                rim *= (
                    1.0
                    + wobble[0] * math.cos(2.0 * angle + turn[0])
                    + wobble[1] * math.cos(3.0 * angle + turn[1])
                    + wobble[2] * math.cos(5.0 * angle + turn[2])
                    + wobble[3] * math.cos(7.0 * angle + turn[3])
                )
            shares[row, col] += min(max(0.5 + rim - apart, 0.0), 1.0)


@kernel
def _blur(field, sd, spare):
    """Blur by a Gaussian, what lies beyond the grid being as its rim."""
    reach = math.ceil(BLUR_REACH_SD * sd)
    weights = np.empty(2 * reach + 1)
    for k in range(-reach, reach + 1):
        weights[k + reach] = math.exp(-0.5 * (k / sd) ** 2)
    weights /= weights.sum()
    height, width = field.shape
    for row in range(height):
        for col in range(width):
            total = 0.0
            for k in range(-reach, reach + 1):
                total += weights[k + reach] * field[row, min(max(col + k, 0), width - 1)]
            spare[row, col] = total
    for row in range(height):
        for col in range(width):
            field[row, col] = 0.0
        for k in range(-reach, reach + 1):
            other = min(max(row + k, 0), height - 1)
            for col in range(width):
                field[row, col] += weights[k + reach] * spare[other, col]


@kernel
def _grain(key, salt, x, y):
    """Return a smooth random number from -1 to 1 at a place on a lattice of side 1."""
    col, row = math.floor(x), math.floor(y)
    u, v = x - col, y - row
    u, v = u * u * (3.0 - 2.0 * u), v * v * (3.0 - 2.0 * v)
    total = 0.0
    for i in range(2):
        for j in range(2):
            corner = (row + i + 512) * 4096 + (col + j + 512) + salt * 16777216
            weight = (v if i else 1.0 - v) * (u if j else 1.0 - u)
            total += weight * (2.0 * hashed(key, corner) - 1.0)
    return total


@kernel
def paint_windows(offsets, discs, keys, places, faults, smallest_m2, coverage):
    """Paint windows (n, height, width) of uint8.

    Parameters
    ----------
    offsets, discs
        (n + 1,) and (m, 3) x, y and radius of the crowns near each window, in metres.
    keys : (m,) uint64, one a crown, so that neighbours' windows see it the same.
    places : (n, 3) upper left corner and side of a pixel.
    faults : (n, 6) what is wrong with the map: lumps of crowns, chance that a crown of 1 m is missed, blur in m,
        swing of the grain, threshold, key of the grain.
    smallest_m2
        Regions and holes below this are left out and filled; 0 leaves shares as they are painted.
    """
    count, height, width = coverage.shape
    shares = np.empty((height, width))
    spare = np.empty((height, width))
    mask = np.empty((height, width), np.bool_)
    labels = np.empty((height, width), np.int32)
    stack = np.empty(height * width, np.int64)
    wobble, turn = np.zeros(HARMONICS), np.zeros(HARMONICS)
    for window in range(count):
        x0, y_top, pixel_m = places[window]
        lumps, missed, blur_m, swing, threshold, grain_key = faults[window]
        shares[:] = 0.0
        for k in range(offsets[window], offsets[window + 1]):
            radius = discs[k, 2]
            if hashed(keys[k], 0) < missed * math.exp(1.0 - radius):
                continue
            for h in range(HARMONICS):
                wobble[h] = lumps * (2.0 * hashed(keys[k], 1 + h) - 1.0) / (1.0 + 0.5 * h)
                turn[h] = 2.0 * math.pi * hashed(keys[k], 16 + h)
            x, y = (discs[k, 0] - x0) / pixel_m, (y_top - discs[k, 1]) / pixel_m
            paint_disc(shares, x, y, radius / pixel_m, wobble, turn)
        for row in range(height):
            for col in range(width):
                shares[row, col] = min(shares[row, col], 1.0)
        if blur_m > 0.0:
            _blur(shares, blur_m / pixel_m, spare)
            _sharpen(shares, spare, threshold, swing, np.uint64(grain_key), pixel_m)
        if smallest_m2 > 0.0:
            least = smallest_m2 / (pixel_m * pixel_m)
            _drop_small(shares, mask, labels, stack, least, True)
            _drop_small(shares, mask, labels, stack, least, False)
        for row in range(height):
            for col in range(width):
                coverage[window, row, col] = round(100.0 * shares[row, col])


@kernel
def _sharpen(shares, spare, threshold, swing, key, pixel_m):
    """Cut a blurred map at a threshold that wanders from place to place; rims keep their share of a cell."""
    height, width = shares.shape
    for row in range(height):
        for col in range(width):
            level = threshold
            if swing > 0.0:
                x, y = col * pixel_m, row * pixel_m
                level += swing * (0.6 * _grain(key, 0, x / 1.6, y / 1.6) + 0.4 * _grain(key, 1, x / 4.0, y / 4.0))
            spare[row, col] = shares[row, col] - level
    for row in range(height):
        for col in range(width):
            up, down = spare[max(row - 1, 0), col], spare[min(row + 1, height - 1), col]
            left, right = spare[row, max(col - 1, 0)], spare[row, min(col + 1, width - 1)]
            slope = 0.5 * math.sqrt((down - up) ** 2 + (right - left) ** 2)
            shares[row, col] = min(max(0.5 + spare[row, col] / max(slope, 0.05), 0.0), 1.0)


@kernel
def _drop_small(shares, mask, labels, stack, least_px, covered):
    """Empty small regions, or fill small holes."""
    height, width = shares.shape
    for row in range(height):
        for col in range(width):
            mask[row, col] = (shares[row, col] >= 0.5) == covered
    count = label(mask, labels, stack)
    sizes = np.zeros(count + 1)
    for row in range(height):
        for col in range(width):
            if labels[row, col]:
                rim = row == 0 or col == 0 or row == height - 1 or col == width - 1
                part = shares[row, col] if covered else 1.0 - shares[row, col]
                sizes[labels[row, col]] += FAR_PX if rim else part
    for row in range(height):
        for col in range(width):
            if labels[row, col] and sizes[labels[row, col]] < least_px:
                for r in range(max(row - 1, 0), min(row + 2, height)):
                    for c in range(max(col - 1, 0), min(col + 2, width)):
                        if labels[r, c] == labels[row, col] or labels[r, c] == 0:
                            shares[r, c] = 0.0 if covered else 1.0
