"""Colours of land outside the lots: fields and scrub, and the tracks of trains."""

from __future__ import annotations

import math

import numpy as np
from numba import njit

from urbanforest_cli.synth.picture.grain_kernel import CODE, chance, grain, streak
from urbanforest_cli.synth.picture.ground_kernel import covered, grassy
from urbanforest_cli.synth.picture.looks import BALLAST, SOIL

PARCEL_M = 170.0
SCRUB_BELOW = 0.3
"""Share of the fields that nobody works."""


@njit(**CODE)
def parcel_at(x, y):
    """Return a hash of the field at a place, and metres to the border with the next one."""
    i0, j0 = math.floor(x / PARCEL_M), math.floor(y / PARCEL_M)
    best, second, found = 1e18, 1e18, 0.0
    bx, by, sx, sy = 0.0, 0.0, 0.0, 0.0
    for i in range(i0 - 1, i0 + 2):
        for j in range(j0 - 1, j0 + 2):
            px = (i + 0.1 + 0.8 * chance(i, j, 801)) * PARCEL_M
            py = (j + 0.1 + 0.8 * chance(i, j, 802)) * PARCEL_M
            far = (x - px) ** 2 + (y - py) ** 2
            if far < best:
                second, sx, sy = best, bx, by
                best, bx, by, found = far, px, py, chance(i, j, 803)
            elif far < second:
                second, sx, sy = far, px, py
    apart = math.sqrt((bx - sx) ** 2 + (by - sy) ** 2) + 1e-9
    return found, (second - best) / (2 * apart)


@njit(**CODE)
def parcels_at(x, y):
    """Return `parcel_at` of (n,) places."""
    found, border = np.empty(len(x)), np.empty(len(x))
    for k in range(len(x)):
        found[k], border[k] = parcel_at(x[k], y[k])
    return found, border


@njit(**CODE)
def open_land(looks, x, y):
    """Return the colour of land outside the town: fields, bare, dry or green, and scrub; and whether grass lives."""
    wx, wy = x + 6.0 * grain(x, y, 45.0, 906), y + 6.0 * grain(x, y, 45.0, 907)
    field, border = parcel_at(wx, wy)
    if border < 1.6 and field > 0.2:
        r, g, b, n = covered(looks, SOIL, x, y, 1.1, 903)
        return r, g, b, n, 0.0
    turn = 6.283 * field * 7.0
    u, v = x * math.cos(turn) + y * math.sin(turn), y * math.cos(turn) - x * math.sin(turn)
    tone = 0.9 + 0.25 * (field * 13.0 % 1.0)
    if field < SCRUB_BELOW:
        bare = grain(x, y, 19.0, 901) * 0.5 + grain(x, y, 5.0, 902) * 0.3 + grain(x, y, 1.7, 908) * 0.2
        if bare > 0.55:
            r, g, b, n = covered(looks, SOIL, x, y, tone, 903)
            return r, g, b, n, 0.0
        return grassy(looks, x, y, 0.3 * grain(x, y, 40.0, 904), 0.0, tone * 0.92, 905)
    rows = 0.05 * math.sin(v * 6.283 / 2.4) + 0.12 * (streak(u / 40.0, v / 1.8, 909) - 0.5)
    if field < 0.62:
        return grassy(looks, x, y, 0.06 + 0.3 * grain(x, y, 60.0, 904), rows, tone, 905)
    if field < 0.85:
        r, g, b, n = covered(looks, SOIL, x, y, tone * 0.88 * (1 + rows), 903)
        return r, g, b, n, 0.0
    return grassy(looks, x, y, 0.62 + 0.2 * grain(x, y, 60.0, 904), 1.2 * rows, tone * 0.92, 905)


@njit(**CODE)
def track(looks, offset, along, x, y):
    """Return the colour of a railway track at a place left of its middle."""
    r, g, b, n = covered(looks, BALLAST, x, y, 0.95, 911)
    side = abs(abs(offset) - 0.72)
    if side < 0.09:
        return r * 0.72 + 40, g * 0.72 + 36, b * 0.72 + 34, n * 0.72 + 34
    if abs(offset) < 1.3 and along % 0.65 < 0.26:
        return r * 0.8, g * 0.78, b * 0.76, n * 0.8
    return r, g, b, n
