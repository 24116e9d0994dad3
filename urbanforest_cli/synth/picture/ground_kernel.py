"""Colours of the ground: lots, streets and fields, with the grain that each has."""

from __future__ import annotations

import math

from numba import njit

from urbanforest_cli.synth.picture.grain_kernel import CODE, chance, grain, ramp, speck, streak
from urbanforest_cli.synth.picture.grounds import (
    ALONG_X,
    ALONG_Y,
    BACK,
    BACK_GROUND,
    BACK_LUSH,
    DEPTH,
    FRONT,
    FRONT_GROUND,
    FRONT_LUSH,
    GREENS,
    HOME,
    LEFT,
    PATH_X,
    PATIO_DEPTH,
    PATIO_LEFT,
    PATIO_RIGHT,
    RIGHT,
    SALT,
    SCHOOL,
    SHOP,
    SIDE_GROUND,
    TONE,
    USE,
    WIDTH,
    WORKS,
    X,
    Y,
)
from urbanforest_cli.synth.picture.looks import (
    AISLE_M,
    ASPHALT,
    BALLAST,
    CONCRETE,
    FIELD,
    GRAVEL,
    LAWN,
    MULCH,
    PAVERS,
    POOL,
    ROAD,
    SOIL,
    STALL_DEEP_M,
    STALL_M,
    WATER,
)

LIVING = 0.4
"""From this greenness on grass counts as vegetation."""


@njit(**CODE)
def grass_green(x, y, lush, salt):
    """Return how green grass is at a place, from 0, straw, to 1."""
    patches = 0.55 * grain(x, y, 7.0, salt) + 0.3 * grain(x, y, 2.3, salt + 1) + 0.15 * grain(x, y, 0.9, salt + 2)
    return ramp(patches + 1.15 * lush - 0.58, 0.18, 0.82)


@njit(**CODE)
def covered(looks, kind, x, y, tone, salt):
    """Return the colour of a kind of ground other than grass."""
    fine = speck(x, y, 0.4, salt) - 0.5
    mid = grain(x, y, 1.6, salt + 3) - 0.5
    wide = grain(x, y, 9.0, salt + 4) - 0.5
    rough = 0.05 * fine + 0.05 * mid + 0.07 * wide
    if kind in (SOIL, MULCH):
        rough = 0.12 * fine + 0.14 * mid + 0.16 * wide
    elif kind in (GRAVEL, BALLAST):
        rough = 0.22 * fine + 0.07 * mid + 0.07 * wide
    elif kind in (CONCRETE, PAVERS):
        rough = 0.05 * fine + 0.05 * mid + 0.09 * wide
        slab = chance(math.floor(x / 3.0), math.floor(y / 3.0), salt + 5) - 0.5
        rough += 0.06 * slab
    elif kind in (ASPHALT, ROAD):
        stain = grain(x, y, 3.1, salt + 6)
        rough = 0.08 * fine + 0.06 * mid + 0.12 * wide - 0.16 * ramp(stain, 0.76, 0.95)
    elif kind == WATER:
        rough = 0.05 * fine + 0.1 * wide
    elif kind == POOL:
        rough = 0.1 * mid
    f = tone * (1.0 + rough)
    return looks[kind, 0] * f, looks[kind, 1] * f, looks[kind, 2] * f, looks[kind, 3] * f


@njit(**CODE)
def grassy(looks, x, y, lush, stripes, tone, salt):
    """Return the colour of grass at a place and whether it lives there."""
    green = grass_green(x, y, lush, salt)
    fine = speck(x, y, 0.35, salt + 8) - 0.5
    f = tone * (1.0 + 0.13 * fine + 0.08 * (grain(x, y, 1.2, salt + 9) - 0.5) + stripes)
    dry = 1.0 + 0.12 * (grain(x, y, 14.0, salt + 10) - 0.5)
    lusher = 1.0 - 0.12 * ramp(green, 0.6, 1.0)
    r = (looks[FIELD, 0] * dry * (1 - green) + looks[LAWN, 0] * lusher * green) * f
    g = (looks[FIELD, 1] * dry * (1 - green) + looks[LAWN, 1] * lusher * green) * f
    b = (looks[FIELD, 2] * dry * (1 - green) + looks[LAWN, 2] * lusher * green) * f
    n = (looks[FIELD, 3] * (1 - green) + looks[LAWN, 3] * green) * f
    return r, g, b, n, 1.0 if green > LIVING else 0.0


@njit(**CODE)
def painted(r, g, b, n, share, white):
    """Lay a line over a colour, white or yellow."""
    pr, pg, pb, pn = (206.0, 205.0, 200.0, 190.0) if white else (196.0, 164.0, 92.0, 170.0)
    return r + (pr - r) * share, g + (pg - g) * share, b + (pb - b) * share, n + (pn - n) * share


@njit(**CODE)
def street(looks, roads, number, beyond, offset, along, other, x, y):
    """Return the colour of a carriageway.

    Parameters
    ----------
    roads
        (roads, 4) half width, tone, greenness of the verge, and a whole number; a road of negative half width is a
        track for trains.
    """
    half, tone, salt = roads[number, 0], roads[number, 1], int(roads[number, 3])
    r, g, b, n = covered(looks, ROAD, x, y, tone, salt)
    lane = half / max(round(2 * half / 3.6), 1.0)
    in_lane = abs((abs(offset) / (2 * lane)) % 1.0 - 0.5) * 2
    worn = 0.05 * (1.0 - abs(2 * in_lane - 1.0)) - 0.045 * ramp(1 - in_lane, 0.75, 1.0)
    streaks = 0.09 * (streak(along / 13.0, offset / 0.9, salt + 1) - 0.5)
    crack = abs(grain(x, y, 6.0, salt + 2) - 0.5)
    patch = chance(math.floor(along / 9.0), math.floor(offset / 2.1), salt + 7)
    mended = -0.09 if patch < 0.04 else (0.06 if patch > 0.96 else 0.0)
    f = 1.0 + mended + worn + streaks - (0.1 if crack < 0.006 else 0.0)
    r, g, b, n = r * f, g * f, b * f, n * f
    if beyond > -0.3:
        return painted(r, g, b, n, 0.45, True)
    if other < 0.6:
        return r, g, b, n
    side = abs(offset)
    if other < 3.2 and half > 3.0:
        if (offset / 1.2) % 1.0 < 0.45 and chance(salt, 5, 1) < 0.45 and side < half - 0.5:
            return painted(r, g, b, n, 0.55, True)
        return r, g, b, n
    if other < 5.0:
        return (*painted(r, g, b, n, 0.6, True),) if 4.2 < other < 4.6 and half > 4.0 else (r, g, b, n)
    if half > 4.0:
        if 0.12 < side < 0.26:
            return painted(r, g, b, n, 0.75, False)
        if half > 6.0:
            for mark in range(1, int(half / 3.4) + 1):
                if abs(side - 3.4 * mark) < 0.08 and along % 9.0 < 3.2 and side < half - 2.0:
                    return painted(r, g, b, n, 0.8, True)
            if abs(side - (half - 2.3)) < 0.07:
                return painted(r, g, b, n, 0.55, True)
    elif half > 3.2 and chance(salt, 6, 1) < 0.4 and side < 0.08 and along % 7.0 < 2.5:
        return painted(r, g, b, n, 0.6, True)
    return r, g, b, n


@njit(**CODE)
def sidewalk(looks, roads, number, beyond, along, x, y):
    """Return the colour of the strip between a curb and the lots, and whether grass lives there."""
    salt, green = int(roads[number, 3]), roads[number, 2]
    if beyond < 0.22:
        r, g, b, n = covered(looks, CONCRETE, x, y, 1.08, salt)
        return r, g, b, n, 0.0
    if 0.22 <= beyond < 2.7 and green >= 0.0:
        cut = chance(math.floor(along / 7.0), salt, 3)
        if cut > 0.14:
            return grassy(looks, x, y, green + 0.25 * (cut - 0.5), 0.0, 1.0, salt)
    r, g, b, n = covered(looks, CONCRETE, x, y, 0.98 + 0.06 * chance(math.floor(along / 9.0), salt, 4), salt)
    return r, g, b, n, 0.0


@njit(**CODE)
def lot_ground(looks, lots, lot, x, y):
    """Return the colour of a lot at a place, and whether grass lives there.

    Parameters
    ----------
    lots
        The table of `Grounds`.
    """
    row = lots[lot]
    dx, dy = x - row[X], y - row[Y]
    u = dx * row[ALONG_X] + dy * row[ALONG_Y]
    v = dy * row[ALONG_X] - dx * row[ALONG_Y]
    salt, tone, use = int(row[SALT]), row[TONE], int(row[USE])
    wobble = 0.7 * (grain(x, y, 2.0, salt + 20) - 0.5)
    house = row[RIGHT] > row[LEFT]
    if not house:
        kind, lush = row[BACK_GROUND], row[BACK_LUSH]
    elif v < row[FRONT]:
        kind, lush = row[FRONT_GROUND], row[FRONT_LUSH]
    elif v > row[BACK]:
        kind, lush = row[BACK_GROUND], row[BACK_LUSH]
    else:
        kind, lush = row[SIDE_GROUND], 0.5 * (row[FRONT_LUSH] + row[BACK_LUSH])
    kind = int(kind)
    stripes = 0.0
    if use == HOME and house:
        if v > row[BACK] and v < row[BACK] + row[PATIO_DEPTH] and row[PATIO_LEFT] < u < row[PATIO_RIGHT]:
            kind = CONCRETE if salt % 3 else PAVERS
        elif v < row[FRONT] and abs(u - row[PATH_X]) < 0.65:
            kind = CONCRETE
        elif row[FRONT] - 1.5 - wobble < v < row[FRONT] and row[LEFT] < u < row[RIGHT] and salt % 4:
            kind = MULCH
        elif (v > row[DEPTH] - 1.1 - wobble or u < 0.9 + wobble or u > row[WIDTH] - 0.9 - wobble) and salt % 5 < 3:
            kind = MULCH if kind == LAWN else kind
    elif use == GREENS:
        bend = 5.0 * math.sin(u / 17.0 + salt % 7) + 3.0 * math.sin(u / 7.3)
        if abs(v - 0.52 * row[DEPTH] - bend) < 1.3 or abs(u - 0.4 * row[WIDTH] - 0.7 * bend) < 1.1:
            kind = CONCRETE if salt % 2 else SOIL
        lush = lush - 0.25 * ramp(grain(x, y, 23.0, salt + 21), 0.5, 0.9)
        stripes = 0.03 * math.sin(v * 1.6)
    elif use == SCHOOL:
        stripes = 0.05 if math.floor(v / 5.0) % 2 else -0.05
    elif use == WORKS and kind != SOIL:
        kind = CONCRETE if grain(x, y, 31.0, salt + 22) > 0.55 else kind
    if kind == LAWN:
        return grassy(looks, x, y, lush, stripes, tone, salt)
    if kind == SOIL and use == HOME:
        weeds = grain(x, y, 3.3, salt + 23)
        if weeds > 0.64:
            return grassy(looks, x, y, lush + 0.35 * (weeds - 0.64), 0.0, tone, salt)
    r, g, b, n = covered(looks, kind, x, y, tone, salt)
    if kind == ASPHALT and use != HOME:
        deep = v % (2 * STALL_DEEP_M + AISLE_M)
        line = u % STALL_M
        stall = deep < 2 * STALL_DEEP_M and (line < 0.07 or line > STALL_M - 0.07)
        if stall or (use == SCHOOL and (abs(deep - 2.0) < 0.08 or u % 14.0 < 0.12)):
            r, g, b, n = painted(r, g, b, n, 0.6, True)
    elif use == SHOP and kind == CONCRETE and u % 4.5 < 0.1:
        r, g, b, n = r * 0.9, g * 0.9, b * 0.9, n * 0.9
    return r, g, b, n, 0.0
