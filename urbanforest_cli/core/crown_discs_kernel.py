"""The compiled parts that fitting crowns is made of: discs on masks, discs that keep apart, numbers by hash.

Lengths are in cells and places in cells from the upper left corner of the grid, x to the right, y down.
"""

from __future__ import annotations

from typing import Any, NamedTuple

import numpy as np
from numba import njit

from urbanforest_cli.core.distance_kernel import squared_distances

kernel: Any = njit(cache=True, nogil=True)

SHOWN, FILLED = 1, 2
"""Kinds of crowns: those that an outline shows, and those that fill closed canopy."""
HALF = 0.5
"""From a cell's centre to its rim: the disc in covered ground ends where the nearest bare cell begins."""
RING = 1.15
"""Outer radius of the ring around a disc in which bare ground is looked for, over the disc's; half a cell more."""
CUT_IN_DRAWS = 1.137
"""Deviations of the law before it is cut in one of the law after, for a cut at two (`placement.radius_law`)."""
WIDER = 1.25
"""Discs larger than this many mean radii are one large crown or closed canopy, not a crown of the law."""
LOBE_OF_LEAST, LOBE_OF_MEAN = 0.6, 0.35
"""Least radius of a further crown in a blob that has one, over the law's least and its mean: smaller ones are bulges
of a ragged outline."""
PLATEAU = 0.1
"""Cells by which a neighbour's disc must be larger to take a cell off the ridge, so that no crown is lost to a ridge
that runs between cells; in round trips 0 does as well."""
TURNS = 16
"""Draws of a radius before the mean is taken; a cut at two deviations refuses one draw in 22."""


class Standing(NamedTuple):
    """Crowns found so far, and chains of those whose centres lie in one bin.

    Parameters
    ----------
    discs : (capacity, 3) float64 x, y, radius.
    kinds : (capacity,) int64 SHOWN or FILLED.
    first : (bins,) int64 the last crown put into a bin, -1 for none.
    following : (capacity,) int64 the crown before it in the same bin.
    bin_size, bins_across : side of a bin, and bins in a row.
    widest : (1,) float64 the largest radius that stands or stood.
    """

    discs: Any
    kinds: Any
    first: Any
    following: Any
    bin_size: float
    bins_across: int
    widest: Any


class Law(NamedTuple):
    """Radii that crowns have, in cells.

    Parameters
    ----------
    mean, sd, spread
        Normal law cut at `spread` either side of the mean.
    most
        Larger discs are no crowns of the law.
    lobe
        Least radius of a further crown in a blob.
    least
        Least radius of any crown.
    near
        Least distance of two crowns over the sum of their radii.
    """

    mean: float
    sd: float
    spread: float
    most: float
    lobe: float
    least: float
    near: float


@kernel
def uniform(key, index):
    """Hash a key and an index to a number in [0, 1), as `core.randomness.hash_uniform` does."""
    z = key + (np.uint64(index) + np.uint64(1)) * np.uint64(0x9E3779B97F4A7C15)
    z = (z ^ (z >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    z = (z ^ (z >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    z = z ^ (z >> np.uint64(31))
    return np.float64(z >> np.uint64(11)) * 2.0**-53


@kernel
def drawn_radius(key, number, mean, sd, width):
    """Draw a radius of the normal law cut at `width` either side of the mean."""
    if width <= 0.0:
        return mean
    for turn in range(TURNS):
        u = 1.0 - uniform(key, 64 * number + 2 * turn)
        v = uniform(key, 64 * number + 2 * turn + 1)
        away = sd * np.sqrt(-2.0 * np.log(u)) * np.cos(2.0 * np.pi * v)
        if abs(away) <= width:
            return mean + away
    return mean


@kernel
def paint(mask, x, y, radius, value):
    """Set the cells whose centres lie in a disc."""
    height, width = mask.shape
    for row in range(max(0, int(y - radius)), min(height, int(y + radius) + 1)):
        for col in range(max(0, int(x - radius)), min(width, int(x + radius) + 1)):
            if (col + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2 <= radius * radius:
                mask[row, col] = value


@kernel
def new_share(ground, taken, x, y, radius):
    """Return the share of a disc that is ground which no crown has taken yet."""
    height, width = taken.shape
    count, new = 0, 0
    for row in range(max(0, int(y - radius)), min(height, int(y + radius) + 1)):
        for col in range(max(0, int(x - radius)), min(width, int(x + radius) + 1)):
            if (col + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2 <= radius * radius:
                count += 1
                if ground[row, col] and not taken[row, col]:
                    new += 1
    return new / count if count else 1.0


@kernel
def bare_ring(ground, x, y, radius):
    """Return the share of a ring just outside a disc that is not ground; beyond the grid nothing is known."""
    height, width = ground.shape
    outer = RING * radius + 0.5
    count, bare = 0, 0
    for row in range(max(0, int(y - outer)), min(height, int(y + outer) + 1)):
        for col in range(max(0, int(x - outer)), min(width, int(x + outer) + 1)):
            square = (col + 0.5 - x) ** 2 + (row + 0.5 - y) ** 2
            if radius * radius < square <= outer * outer:
                count += 1
                if not ground[row, col]:
                    bare += 1
    return bare / count if count else 0.0


@kernel
def law_of(mean, variance, cut_sd, radius_min, overlap):
    """Return the law of radii with all that follows from it."""
    sd = np.sqrt(variance)
    spread = max(min(cut_sd * CUT_IN_DRAWS * sd, mean - radius_min), 0.0)
    smallest = mean - spread
    most = max(WIDER * mean, mean + spread) + HALF
    lobe = max(LOBE_OF_LEAST * smallest, LOBE_OF_MEAN * mean)
    least = max(0.7, min(radius_min, 0.5 * smallest))
    return Law(mean, CUT_IN_DRAWS * sd, spread, most, lobe, least, 1.0 - overlap)


@kernel
def squares_in(ground):
    """Return the squared distance of cells to the nearest cell that is not ground."""
    height, width = ground.shape
    squares = np.empty((height, width))
    squared_distances(np.uint8(1) - ground, float(height + width), squares)
    return squares


@kernel
def ridge_cells(squares, stems, allowed, least):
    """Return the flat indices of cells whose disc, `least` or more in radius, no neighbouring cell's disc exceeds.

    Parameters
    ----------
    squares : (height, width) float64 squared distances to what is not ground.
    stems, allowed : (height, width) uint8 cells that may bear a stem, and those that are looked at.
    """
    height, width = squares.shape
    found = np.empty(squares.size, dtype=np.int64)
    count = 0
    for row in range(height):
        for col in range(width):
            if not stems[row, col] or not allowed[row, col]:
                continue
            d = np.sqrt(squares[row, col])
            if d - HALF < least:
                continue
            ridge = True
            for r in range(max(0, row - 1), min(height, row + 2)):
                for c in range(max(0, col - 1), min(width, col + 2)):
                    if stems[r, c] and allowed[r, c] and np.sqrt(squares[r, c]) > d + PLATEAU:
                        ridge = False
            if ridge:
                found[count] = row * width + col
                count += 1
    return found[:count]


@kernel
def stand_in(capacity, law, height, width):
    """Return room for crowns of a grid, none of them standing yet."""
    bin_size = 2.0 * law.most
    across, down = int(width / bin_size) + 1, int(height / bin_size) + 1
    return Standing(
        np.empty((capacity, 3)),
        np.empty(capacity, dtype=np.int64),
        np.full(across * down, -1, dtype=np.int64),
        np.full(capacity, -1, dtype=np.int64),
        bin_size,
        across,
        np.zeros(1),
    )


@kernel
def stand(standing, number, x, y, radius, kind):
    """Put up a crown as number `number`."""
    standing.discs[number, 0], standing.discs[number, 1], standing.discs[number, 2] = x, y, radius
    standing.kinds[number] = kind
    _into_bin(standing, number, x, y)


@kernel
def _into_bin(standing, number, x, y):
    place = int(y / standing.bin_size) * standing.bins_across + int(x / standing.bin_size)
    standing.following[number] = standing.first[place]
    standing.first[place] = number
    standing.widest[0] = max(standing.widest[0], standing.discs[number, 2])


@kernel
def sort_into_bins(standing, count, height, width):
    """Sort crowns that have moved into bins again."""
    standing.first[:] = -1
    for i in range(count):
        x = min(max(standing.discs[i, 0], 0.0), width - 1e-6)
        y = min(max(standing.discs[i, 1], 0.0), height - 1e-6)
        _into_bin(standing, i, x, y)


@kernel
def apart(standing, x, y, radius, near):
    """Tell whether a disc keeps the distance `near` (r + r') from all crowns that stand."""
    bins_down = len(standing.first) // standing.bins_across
    reach = near * (radius + standing.widest[0])
    top, left = int((y - reach) / standing.bin_size), int((x - reach) / standing.bin_size)
    bottom, right = int((y + reach) / standing.bin_size), int((x + reach) / standing.bin_size)
    for r in range(max(0, top), min(bins_down, bottom + 1)):
        for c in range(max(0, left), min(standing.bins_across, right + 1)):
            other = standing.first[r * standing.bins_across + c]
            while other >= 0:
                least = near * (radius + standing.discs[other, 2])
                dx, dy = standing.discs[other, 0] - x, standing.discs[other, 1] - y
                if dx**2 + dy**2 < least * least:
                    return False
                other = standing.following[other]
    return True
