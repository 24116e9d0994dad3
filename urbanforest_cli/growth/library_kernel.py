"""Distances between plants under turns by 45 degrees and mirroring: choosing entries, finding the nearest."""

# mypy: disable-error-code="no-untyped-def"

from __future__ import annotations

import numpy as np
from numba import njit

TURNS = 16  # eight rotations, then eight of the mirrored plant
SLACK = 1e-12  # distances nearer than this are alike, so that rounding decides nothing


@njit(cache=True, nogil=True, error_model="numpy")
def turned_sector(turn, sector):
    """Return which sector of an entry lies in a sector of the world after a turn."""
    if turn < 8:
        return (sector - turn) % 8
    return (turn - sector) % 8


@njit(cache=True, nogil=True, error_model="numpy")
def turn_cost(turn, across, across_mirrored, stiffness):
    """Return the squared distance that a turn costs because rows then lie across each other.

    `across` and `across_mirrored` are the squared sines of twice the angle between two rows: 0 if they lie along each
    other or at right angles, 1 at 45 degrees; an odd turn makes the one the other.
    """
    share = across if turn < 8 else across_mirrored
    return stiffness * (1.0 - share if turn % 2 == 1 else share)


@njit(cache=True, nogil=True, error_model="numpy")
def square_distance(sectors, entry_sectors, turn, start, limit):
    """Return the squared distance of eight weighted sectors to those of an entry turned; above `limit` any part."""
    total = start
    for k in range(8):
        if total > limit:
            break
        difference = sectors[k] - entry_sectors[turned_sector(turn, k)]
        total += difference * difference
    return total


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_turn(sectors, entry_sectors, limit, across, across_mirrored, stiffness):
    """Return the least squared distance over all turns, if below `limit`, and the first turn that has it, or -1."""
    best, best_turn = limit, -1
    for turn in range(TURNS):
        cost = turn_cost(turn, across, across_mirrored, stiffness)
        square = square_distance(sectors, entry_sectors, turn, cost, best)
        if square < best - SLACK:
            best, best_turn = square, turn
    return best, best_turn


@njit(cache=True, nogil=True, error_model="numpy")
def spread_out(sectors, others, begin, end, seed, budget):
    """Choose plants of classes by greedy k-centre: each next is the farthest from all chosen so far.

    Parameters
    ----------
    sectors, others
        (n, 8), (n, q) features of plants, classes in one piece each.
    begin, end, seed, budget
        (c,) rows of each class, the row it starts from, and how many it may choose. Of plants alike far the first
        row is taken; no plant is chosen that is like one chosen.

    Returns
    -------
    chosen (m,) rows, near (n,) distance of each plant to the nearest chosen one of its class.
    """
    chosen = np.empty(budget.sum(), dtype=np.int64)
    near = np.full(len(sectors), np.inf)
    count = 0
    for c in range(len(begin)):
        pick = seed[c]
        for _ in range(budget[c]):
            chosen[count] = pick
            count += 1
            farthest, pick_next = SLACK, -1
            for i in range(begin[c], end[c]):
                square = 0.0
                for q in range(others.shape[1]):
                    square += (others[i, q] - others[pick, q]) ** 2
                if square < near[i]:
                    turned, turn = nearest_turn(sectors[i], sectors[pick], near[i] - square, 0.0, 0.0, 0.0)
                    if turn >= 0:
                        near[i] = square + turned
                if near[i] > farthest + SLACK:
                    farthest, pick_next = near[i], i
            if pick_next < 0:
                break
            pick = pick_next
    return chosen[:count], np.sqrt(near)


@njit(cache=True, nogil=True, error_model="numpy")
def settle(sectors, others, begin, end, chosen, rounds, sample):
    """Move each chosen plant to the middle of those it is the nearest for, in its class, a few times.

    The middle is the plant with the least summed distance to the others; of more than `sample` plants the first rows
    speak for all.

    Parameters
    ----------
    sectors, others, begin, end
        As above.
    chosen
        (m,) rows by class, changed.
    """
    members = np.empty(sample, dtype=np.int64)
    nearest = np.empty(len(sectors), dtype=np.int64)
    first = 0
    for c in range(len(begin)):
        last = first
        while last < len(chosen) and chosen[last] < end[c]:
            last += 1
        for _ in range(rounds):
            for i in range(begin[c], end[c]):
                best = np.inf
                for m in range(first, last):
                    square = _square(sectors, others, i, chosen[m], best)
                    if square < best - SLACK:
                        best, nearest[i] = square, m
            for m in range(first, last):
                count = 0
                for i in range(begin[c], end[c]):
                    if nearest[i] == m and count < sample:
                        members[count] = i
                        count += 1
                least = np.inf
                for a in range(count):
                    total = 0.0
                    for b in range(count):
                        total += np.sqrt(_square(sectors, others, members[b], members[a], np.inf))
                        if total >= least - SLACK:
                            break
                    if total < least - SLACK:
                        least, chosen[m] = total, members[a]
        first = last


@njit(cache=True, nogil=True, error_model="numpy")
def _square(sectors, others, i, j, limit):
    """Return the squared distance of two plants in their best turn, or `limit` if it is not below."""
    square = 0.0
    for q in range(others.shape[1]):
        square += (others[i, q] - others[j, q]) ** 2
    if square >= limit:
        return limit
    return square + nearest_turn(sectors[i], sectors[j], limit - square, 0.0, 0.0, 0.0)[0]


@njit(cache=True, nogil=True, error_model="numpy")
def nearest_entries(
    sectors, others, row, stiffness, bounds, entry_sectors, entry_others, entry_row, entry_bounds, draw, slack
):  # fmt: skip
    """Find for each plant the nearest entry of its species and how to turn it.

    Parameters
    ----------
    sectors, others
        (n, 8), (n, q) features of plants, species in one piece each.
    row, stiffness
        (n,) azimuth of a plant's row in radians; squared distance of rows that lie across each other.
    bounds, entry_bounds
        (s + 1,) where each species starts among the plants and among the entries.
    entry_sectors, entry_others, entry_row
        (m, 8), (m, q), (m,) the same of entries.
    draw
        (n,) numbers in [0, 1): which of the turns that fit within `slack` of the best is taken.

    Returns
    -------
    entry (n,), turn (n,), distance (n,)
    """
    count = len(sectors)
    entry, turn, distance = np.full(count, -1), np.zeros(count, dtype=np.int64), np.full(count, np.inf)
    fits = np.empty(TURNS)
    for s in range(len(bounds) - 1):
        for i in range(bounds[s], bounds[s + 1]):
            best = np.inf
            for e in range(entry_bounds[s], entry_bounds[s + 1]):
                rest = _rest(others, entry_others, i, e)
                if rest >= best - SLACK:
                    continue
                plain = np.sin(2.0 * (row[i] - entry_row[e])) ** 2 if stiffness[i] > 0.0 else 0.0
                mirrored = np.sin(2.0 * (row[i] + entry_row[e])) ** 2 if stiffness[i] > 0.0 else 0.0
                turned, found = nearest_turn(
                    sectors[i], entry_sectors[e], best - rest, plain, mirrored, stiffness[i]
                )  # fmt: skip
                if found >= 0:
                    best, entry[i] = rest + turned, e
            if entry[i] < 0:
                continue
            e = entry[i]
            rest = _rest(others, entry_others, i, e)
            plain, mirrored = np.sin(2.0 * (row[i] - entry_row[e])) ** 2, np.sin(2.0 * (row[i] + entry_row[e])) ** 2
            allowed, fitting = np.sqrt(best) + slack, 0
            for t in range(TURNS):
                cost = rest + turn_cost(t, plain, mirrored, stiffness[i])
                fits[t] = np.sqrt(square_distance(sectors[i], entry_sectors[e], t, cost, np.inf))
                fitting += fits[t] <= allowed
            wanted = int(draw[i] * fitting)
            for t in range(TURNS):
                if fits[t] <= allowed:
                    if wanted == 0:
                        turn[i], distance[i] = t, fits[t]
                        break
                    wanted -= 1
    return entry, turn, distance


@njit(cache=True, nogil=True, error_model="numpy")
def _rest(others, entry_others, i, e):
    """Return the squared distance in all that no turn changes."""
    total = 0.0
    for q in range(others.shape[1]):
        total += (others[i, q] - entry_others[e, q]) ** 2
    return total
