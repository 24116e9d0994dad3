"""Chance that depends on a place alone: hashes and smooth noise, the same from whichever window they are asked."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.randomness import rng_for

MASK = 255
TABLE = rng_for(0, "picture", "grain").random((MASK + 1, MASK + 1), dtype=np.float32)
"""Chance to look up where a hash would take too long; it comes again after `MASK` + 1 spots."""

CODE: dict[str, Any] = {"cache": True, "nogil": True, "error_model": "numpy"}


@njit(**CODE)
def chance(i, j, salt):
    """Hash two integers and a salt to a number in [0, 1)."""
    h = np.uint64(i) * np.uint64(0x9E3779B97F4A7C15)
    h ^= np.uint64(j) * np.uint64(0xC2B2AE3D27D4EB4F) + np.uint64(salt) * np.uint64(0x165667B19E3779F9)
    h ^= h >> np.uint64(31)
    h *= np.uint64(0x7FB5D329728EA185)
    h ^= h >> np.uint64(27)
    h *= np.uint64(0x81DADEF4BC2DD44D)
    h ^= h >> np.uint64(33)
    return np.float64(h >> np.uint64(11)) * 2.0**-53


@njit(**CODE)
def speck(x, y, size, salt):
    """Return noise from 0 to 1 that is constant on squares of a size."""
    return TABLE[(int(np.floor(x / size)) + 37 * salt) & MASK, (int(np.floor(y / size)) + 101 * salt) & MASK]


@njit(**CODE)
def streak(u, v, salt):
    """Return smooth noise from 0 to 1 with spots of size 1 along both axes."""
    i, j = int(np.floor(u)), int(np.floor(v))
    fu, fv = u - i, v - j
    fu, fv = fu * fu * (3 - 2 * fu), fv * fv * (3 - 2 * fv)
    i, j = i + 37 * salt, j + 101 * salt
    i0, i1, j0, j1 = i & MASK, (i + 1) & MASK, j & MASK, (j + 1) & MASK
    a, b, c, d = TABLE[i0, j0], TABLE[i1, j0], TABLE[i0, j1], TABLE[i1, j1]
    return (a * (1 - fu) + b * fu) * (1 - fv) + (c * (1 - fu) + d * fu) * fv


@njit(**CODE)
def grain(x, y, size, salt):
    """Return smooth noise from 0 to 1 with spots of a size, on a lattice turned by the salt."""
    if salt % 2:
        return streak((0.8 * x + 0.6 * y) / size, (0.8 * y - 0.6 * x) / size, salt)
    return streak((0.28 * x + 0.96 * y) / size, (0.28 * y - 0.96 * x) / size, salt)


@njit(**CODE)
def ramp(value, low, high):
    """Return how far a value lies between two others, smoothly from 0 to 1."""
    t = min(max((value - low) / (high - low), 0.0), 1.0)
    return t * t * (3 - 2 * t)
