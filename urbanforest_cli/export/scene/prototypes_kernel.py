"""Outlines of crowns in eight sectors and three bands, how unlike two are, and which few stand for all."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

SECTORS, BANDS = 8, 3
TURNS = 16  # eight by 45 degrees, then eight of the mirrored shape
REACHES = SECTORS * BANDS
SLACK = 1e-9  # gains and distances nearer than this are alike, so that rounding decides nothing


@njit(cache=True, nogil=True, error_model="numpy")
def crown_reaches(first, xyz, birth, death, season_end, base, height):
    """Return (s, 24) the largest distance of standing nodes from the root's vertical, by band and then sector.

    Bands are thirds from crown base to top, what is below belongs to the lowest; sector k looks 45 k degrees to the
    left of x.
    """
    reach = np.zeros((len(first) - 1, REACHES))
    for s in range(len(first) - 1):
        tall = max(height[s] - base[s], 1e-6)
        for i in range(first[s] + 1, first[s + 1]):
            if birth[i] > season_end[s] or (death[i] != 0 and death[i] <= season_end[s]):
                continue
            x, y = np.float64(xyz[i, 0]), np.float64(xyz[i, 1])
            sector = int(np.floor(np.arctan2(y, x) / (np.pi / 4) + 0.5)) % SECTORS
            band = min(max(int(BANDS * (np.float64(xyz[i, 2]) - base[s]) / tall), 0), BANDS - 1)
            place = band * SECTORS + sector
            reach[s, place] = max(reach[s, place], x * x + y * y)
    return np.sqrt(reach)


@njit(cache=True, nogil=True, error_model="numpy")
def turned(reach, turn):
    """Return the 24 reaches of a shape after a turn."""
    found = np.empty(REACHES)
    for band in range(BANDS):
        for k in range(SECTORS):
            source = (k - turn) % SECTORS if turn < SECTORS else (turn - k) % SECTORS
            found[band * SECTORS + k] = reach[band * SECTORS + source]
    return found


@njit(cache=True, nogil=True, error_model="numpy")
def distances(reach, sizes, others, other_sizes, weights, limits):
    """Tell how unlike shapes are to others that are turned and scaled to their height in their place.

    Parameters
    ----------
    reach, others
        (s, 24), (e, 24) metres.
    sizes, other_sizes
        (s, 2), (e, 2) height and crown base in metres.
    weights
        (3,) of a metre of crown base, of a metre of height that the limits of scale leave, and of a factor of e in
        scale, for each metre of height.
    limits
        (2,) of the factor on the others' size.

    Returns
    -------
    (s, e) metres, the mean over the 24 reaches and more for the rest; (s, e) uint8 the best turn, the first of those
    alike.
    """
    count = len(others)
    distance = np.empty((len(reach), count))
    turn = np.zeros((len(reach), count), dtype=np.uint8)
    shapes = np.empty((count, TURNS, REACHES))
    for e in range(count):
        for t in range(TURNS):
            shapes[e, t] = turned(others[e], t)
    for s in range(len(reach)):
        for e in range(count):
            ratio = sizes[s, 0] / other_sizes[e, 0] if other_sizes[e, 0] > 0.0 and sizes[s, 0] > 0.0 else 1.0
            scale = min(max(ratio, limits[0]), limits[1])
            best, best_turn = np.inf, 0
            for t in range(TURNS):
                total = 0.0
                for k in range(REACHES):
                    total += abs(reach[s, k] - scale * shapes[e, t, k])
                    if k % SECTORS == SECTORS - 1 and total >= best:
                        break
                if total < best - SLACK:
                    best, best_turn = total, t
            rest = weights[0] * abs(sizes[s, 1] - scale * other_sizes[e, 1])
            rest += weights[1] * abs(sizes[s, 0] - scale * other_sizes[e, 0])
            rest += weights[2] * sizes[s, 0] * abs(np.log(scale))
            distance[s, e] = best / REACHES + rest
            turn[s, e] = best_turn
    return distance, turn


@njit(cache=True, nogil=True, error_model="numpy")
def summed_costs(cost):
    """Return (e,) the summed cost of each shape standing for all of its kind."""
    total = np.zeros(cost.shape[1])
    for s in range(cost.shape[0]):
        for e in range(cost.shape[1]):
            total[e] += cost[s, e]
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def add_chosen(cost, near, gain, pick):
    """Let another shape be chosen: lowers `near` (s,), what each costs now, and `gain` (e,), what each would save."""
    for s in range(cost.shape[0]):
        before, after = near[s], cost[s, pick]
        if after >= before:
            continue
        near[s] = after
        for e in range(cost.shape[1]):
            if cost[s, e] < before:
                gain[e] -= before - max(cost[s, e], after)


@njit(cache=True, nogil=True, error_model="numpy")
def outline_errors(shape, stand_in, turn, own_scale, scale, reach, others):
    """Return (n,) mean difference of plants' 24 reaches from their stand-ins', as a share of their own mean reach.

    Parameters
    ----------
    shape, stand_in, turn
        (n,) rows of `reach` and of `others`, and how the stand-in is turned against the shape.
    own_scale, scale
        (n,) how plants scale their own shape, and the stand-in.
    """
    errors = np.zeros(len(shape))
    for i in range(len(shape)):
        other = turned(others[stand_in[i]], np.int64(turn[i]))
        difference, own = 0.0, 0.0
        for k in range(REACHES):
            own += own_scale[i] * reach[shape[i], k]
            difference += abs(own_scale[i] * reach[shape[i], k] - scale[i] * other[k])
        errors[i] = difference / own if own > 0.0 else np.float64(difference > 0.0)
    return errors
