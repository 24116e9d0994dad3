"""What the camera counts: light on the topmost thing of each fine cell, averaged over the pixels."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numba import njit
from numpy.typing import NDArray

from urbanforest_cli.synth.picture.boxes import CAR, WATERY
from urbanforest_cli.synth.picture.country_kernel import open_land, track
from urbanforest_cli.synth.picture.grain_kernel import CODE, grain, ramp, speck
from urbanforest_cli.synth.picture.ground_kernel import (
    covered,
    lot_ground,
    sidewalk,
    street,
)
from urbanforest_cli.synth.picture.grounds import TONE
from urbanforest_cli.synth.picture.looks import CONCRETE, MEMBRANE, METAL, POOL, TILE, WATER
from urbanforest_cli.synth.picture.relief_kernel import BOX_TOP, PLANT_TOP, ROOF_TOP, in_sun
from urbanforest_cli.synth.plan import SIDEWALK_M

DRIVEWAY, WET = 1, 2
"""What lies over a lot's ground."""

LEAF_SKY = 0.5
"""Light in a shadow on leaves that the near infrared gets from the leaves around."""

HIGH_CELLS = 16
"""Side of the squares whose greatest heights let rays leap."""


class Land(NamedTuple):
    """Fine cells of a window, all (rows, cols)."""

    z: NDArray[np.float32]
    top: NDArray[np.uint8]
    owner: NDArray[np.int32]
    facing: NDArray[np.float32]
    lot: NDArray[np.int32]
    over: NDArray[np.uint8]
    road: NDArray[np.int32]
    beyond: NDArray[np.float32]
    offset: NDArray[np.float32]
    along: NDArray[np.float32]
    other: NDArray[np.float32]
    rail_beyond: NDArray[np.float32]
    rail_offset: NDArray[np.float32]
    rail_along: NDArray[np.float32]


class Looks(NamedTuple):
    """Tables of what things look like."""

    grounds: NDArray[np.float64]
    lots: NDArray[np.float64]
    roads: NDArray[np.float64]
    roofs: NDArray[np.float64]
    plant_colour: NDArray[np.float64]
    plants: NDArray[np.float64]
    box_colour: NDArray[np.float64]
    boxes: NDArray[np.float64]
    dark: NDArray[np.float64]
    sky: NDArray[np.float64]


@njit(**CODE)
def ground_at(
    grounds, lots, roads, lot, over, road, beyond, offset, along, other, railed, rail_offset, rail_along, x, y
):
    """Return the colour of the ground at a cell and whether grass lives there; road, rail and lot as in `Land`."""
    if beyond < 0.0:
        red, green, blue, near = street(grounds, roads, road, beyond, offset, along, other, x, y)
        return red, green, blue, near, 0.0
    if railed < 0.0:
        red, green, blue, near = track(grounds, rail_offset, rail_along, x, y)
        return red, green, blue, near, 0.0
    if over == WET:
        red, green, blue, near = covered(grounds, WATER, x, y, 1.0, 921)
        return red, green, blue, near, 0.0
    if over == DRIVEWAY:
        tone = lots[lot, TONE] if lot >= 0 else 1.0
        red, green, blue, near = covered(grounds, CONCRETE, x, y, tone, 931 + lot)
        oil = 1.0 - 0.2 * ramp(grain(x, y, 1.7, 932), 0.7, 0.95)
        return red * oil, green * oil, blue * oil, near * oil, 0.0
    if lot >= 0:
        return lot_ground(grounds, lots, lot, x, y)
    if beyond < SIDEWALK_M:
        return sidewalk(grounds, roads, road, beyond, along, x, y)
    return open_land(grounds, x, y)


@njit(**CODE)
def roof_at(roofs, b, x, y):
    """Return the colour of a roof.

    Parameters
    ----------
    roofs
        (buildings, 10) colour, sort, salt, and a corner and direction, x and y, to lay its pattern by.
    """
    sort, salt = int(roofs[b, 4]), int(roofs[b, 5])
    dx, dy, ux, uy = x - roofs[b, 6], y - roofs[b, 7], roofs[b, 8], roofs[b, 9]
    u, v = dx * ux + dy * uy, dy * ux - dx * uy
    fine = speck(u, v, 0.45, salt) - 0.5
    wide = grain(u, v, 4.5, salt + 1) - 0.5
    if sort == METAL:
        rough = 0.06 * fine + 0.1 * wide + (0.07 if math.floor(u / 1.2) % 2 else -0.05)
        rough += -0.1 if v % 9.0 < 0.3 else 0.0
    elif sort == MEMBRANE:
        rough = 0.06 * fine + 0.09 * wide - 0.22 * ramp(grain(u, v, 3.0, salt + 4), 0.72, 0.95)
        rough += -0.05 if (u % 6.0 < 0.18 or v % 9.0 < 0.18) else 0.0
        rough += 0.09 * (speck(u, v, 13.0, salt + 5) - 0.5)
    else:
        rough = 0.13 * fine + 0.12 * wide + 0.08 * (grain(u, v, 1.3, salt + 2) - 0.5)
        rough += 0.1 * (speck(u, v, 0.9, salt + 3) - 0.5) if sort == TILE else 0.0
    f = 1.0 + rough
    return roofs[b, 0] * f, roofs[b, 1] * f, roofs[b, 2] * f, roofs[b, 3] * f


@njit(**CODE)
def leaf_at(plants, colour, p, x, y, z):
    """Return the colour of leaves."""
    salt = int(plants[p, 5])
    depth = (z - plants[p, 4]) / max(plants[p, 2] - plants[p, 4], 0.1)
    f = 1.0 + 0.34 * (speck(x, y, 0.3, salt) - 0.5) + 0.34 * (grain(x, y, 0.9, salt + 1) - 0.5)
    f *= 0.8 + 0.26 * min(max(depth, 0.0), 1.0)
    return colour[p, 0] * f, colour[p, 1] * f, colour[p, 2] * f, colour[p, 3] * f


@njit(**CODE)
def box_at(grounds, boxes, colour, k, x, y):
    """Return the colour of a box: a car with its panes, water, or plain paint."""
    paint = boxes[k, 7]
    if paint == WATERY:
        return covered(grounds, POOL, x, y, 1.0, int(boxes[k, 8]))
    if paint == CAR:
        at = ((x - boxes[k, 0]) * boxes[k, 2] + (y - boxes[k, 1]) * boxes[k, 3]) / boxes[k, 4]
        f = 0.5 if 0.14 < at < 0.36 or -0.74 < at < -0.56 else 1.0
    else:
        f = 1.0 + 0.08 * (speck(x, y, 0.5, int(boxes[k, 8])) - 0.5)
    return colour[k, 0] * f, colour[k, 1] * f, colour[k, 2] * f, colour[k, 3] * f


@njit(**CODE)
def expose(land, looks, high, sun, first_row, first_col, west, north, step, factor, counts, green):
    """Fill pixels with the mean over their cells.

    Parameters
    ----------
    high
        `highest_around` of the heights, by `HIGH_CELLS`.
    first_row, first_col
        Cell of the window at the upper left corner of the first pixel.
    factor
        Cells along a pixel's side.
    counts, green
        Out: (4, rows, cols) counts of 0-255, and (2, rows, cols) shares from 0 to 1 of canopy and of vegetation.
    """
    z, top, owner, facing, lot, over = land.z, land.top, land.owner, land.facing, land.lot, land.over
    road, beyond, offset, along, other = land.road, land.beyond, land.offset, land.along, land.other
    railed, rail_offset, rail_along = land.rail_beyond, land.rail_offset, land.rail_along
    grounds, lots, roads, roofs, dark = looks.grounds, looks.lots, looks.roads, looks.roofs, looks.dark
    plants, plant_colour, boxes, box_colour = looks.plants, looks.plant_colour, looks.boxes, looks.box_colour
    highest = high.max()
    part = 1.0 / (factor * factor)
    for row in range(counts.shape[1]):
        for col in range(counts.shape[2]):
            for i in range(factor):
                r = first_row + row * factor + i
                y = north - (r + 0.5) * step
                for j in range(factor):
                    c = first_col + col * factor + j
                    x = west + (c + 0.5) * step
                    kind, mine = top[r, c], owner[r, c]
                    light, living = 1.0, 0.0
                    if kind == PLANT_TOP:
                        red, grn, blue, near = leaf_at(plants, plant_colour, mine, x, y, z[r, c])
                        light, living = facing[r, c], 1.0
                        green[0, row, col] += part
                    elif kind == ROOF_TOP:
                        red, grn, blue, near = roof_at(roofs, mine, x, y)
                        light = facing[r, c]
                    elif kind == BOX_TOP:
                        red, grn, blue, near = box_at(grounds, boxes, box_colour, mine, x, y)
                    else:
                        red, grn, blue, near, living = ground_at(
                            grounds, lots, roads, lot[r, c], over[r, c], road[r, c], beyond[r, c], offset[r, c],
                            along[r, c], other[r, c], railed[r, c], rail_offset[r, c], rail_along[r, c], x, y,
                        )  # fmt: skip
                    green[1, row, col] += part * living
                    seen = light * in_sun(z, top, high, HIGH_CELLS, r, c, sun, step, highest)
                    for band, value in ((0, red), (1, grn), (2, blue), (3, near)):
                        sky = LEAF_SKY if kind == PLANT_TOP and band == 3 else looks.sky[band]
                        lit = sky + (1.0 - sky) * seen
                        counts[band, row, col] += part * (dark[band] + max(value - dark[band], 0.0) * lit)
