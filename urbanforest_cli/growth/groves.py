"""Which plants grow together, and along which line a plant stands."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from urbanforest_cli.core.config import Growth

ROW_REACH_M = 20.0
ROW_NEIGHBOURS = 6
SAME_M = 0.01  # distances closer than this count as equal
LINE_CLARITY = 0.2  # how much of the neighbours' pull must be left when those at right angles have cancelled out


def cut_into_groves(
    lot: NDArray[np.int64], xy_m: NDArray[np.float64], keys: NDArray[np.uint64], growth: Growth
) -> NDArray[np.int64]:
    """Cut lots into groves that are neither too many plants nor too long.

    A lot that is one or the other is cut in two with equal numbers of plants, across its longer side, and so are the
    halves.

    Parameters
    ----------
    lot
        (n,) number of each plant's lot.
    keys
        (n,) of plants, to tell apart those that stand in the same spot.

    Returns
    -------
    (n,) number of each plant's grove, counted from 0 by lot, then from west or south; whatever the order of rows.
    """
    order = np.lexsort((keys, xy_m[:, 1], xy_m[:, 0], lot))
    starts = np.flatnonzero(np.diff(lot[order], prepend=np.nan))
    sorted_xy = xy_m[order]
    if not len(order):
        return np.empty(0, dtype=np.int64)
    spread = np.maximum.reduceat(sorted_xy, starts) - np.minimum.reduceat(sorted_xy, starts)
    sizes = np.diff(starts, append=len(order))
    large = (sizes > growth.grove_plants_max) | (spread.max(axis=1) > growth.grove_length_max_m)
    group = np.repeat(np.arange(len(starts)), sizes)
    part = np.zeros(len(order), dtype=np.int64)
    for start, size in zip(starts[large], sizes[large], strict=True):
        part[start : start + size] = _parts(sorted_xy[start : start + size], growth)
    fresh = np.lexsort((part, group))
    changes = (np.diff(group[fresh], prepend=-1) != 0) | (np.diff(part[fresh], prepend=-1) != 0)
    grove = np.empty(len(order), dtype=np.int64)
    grove[order[fresh]] = np.cumsum(changes) - 1
    return grove


def number_in_lot(lot: NDArray[np.int64], grove: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return the number, from 0, of each plant's grove within its lot."""
    if not len(lot):
        return np.empty(0, dtype=np.int64)
    _, place = np.unique(lot, return_inverse=True)
    least = np.full(place.max() + 1, np.iinfo(np.int64).max)
    np.minimum.at(least, place, grove)
    return np.asarray(grove - least[place])


def _parts(xy: NDArray[np.float64], growth: Growth) -> NDArray[np.int64]:
    """Return the part of each position; positions come sorted by x, then y."""
    part = np.empty(len(xy), dtype=np.int64)
    waiting = [np.arange(len(xy))]
    count = 0
    while waiting:
        rows = waiting.pop()
        spread = np.ptp(xy[rows], axis=0)
        if len(rows) == 1 or (len(rows) <= growth.grove_plants_max and spread.max() <= growth.grove_length_max_m):
            part[rows] = count
            count += 1
            continue
        axis = int(spread[1] > spread[0])
        rows = rows[np.argsort(xy[rows, axis], kind="stable")]
        middle = len(rows) // 2
        waiting += [np.sort(rows[middle:]), np.sort(rows[:middle])]
    return part


def row_azimuth(xy_m: NDArray[np.float64], lot: NDArray[np.int64]) -> NDArray[np.float64]:
    """Return the direction of the row that each plant stands in.

    That is the main direction of its up to six nearest plants of the same lot, nearer ones counting far more (by
    the fourth power of the distance). Where they point all ways alike, as in a square lattice, it is the direction of
    the nearest.

    Returns
    -------
    (n,) radians counter-clockwise from east, 0 to pi; 0 for a plant with none within `ROW_REACH_M` metres.
    """
    if len(xy_m) < 2:
        return np.zeros(len(xy_m))
    _, place = np.unique(lot, return_inverse=True)
    level = place * (2.0 * ROW_REACH_M)  # lots lie on storeys of their own, out of reach of each other
    local = xy_m - xy_m.min(axis=0)
    spots = np.column_stack((local, level))
    wanted = min(ROW_NEIGHBOURS + 2, len(xy_m))
    distance, near = cKDTree(spots).query(spots, k=wanted, distance_upper_bound=ROW_REACH_M)
    found = np.isfinite(distance) & (near != np.arange(len(xy_m))[:, None])
    offset = local[np.where(found, near, 0)] - local[:, None, :]
    length = np.where(found, np.hypot(offset[..., 0], offset[..., 1]), np.inf)
    if wanted == ROW_NEIGHBOURS + 2:  # of those as far as the first left out, which ones came is chance
        length = np.where(length < distance[:, -1:] - SAME_M, length, np.inf)
    length[length < SAME_M] = np.inf
    weight = length**-4.0
    angle = np.arctan2(offset[..., 1], offset[..., 0])
    along = (weight * np.cos(2 * angle)).sum(axis=1)
    aside = (weight * np.sin(2 * angle)).sum(axis=1)
    clear = np.hypot(along, aside) > LINE_CLARITY * weight.sum(axis=1)
    turn = (angle + SAME_M / ROW_REACH_M) % np.pi
    rank = np.where(np.isfinite(length), np.round(length / SAME_M) * 4 + turn / np.pi, np.inf)
    nearest = np.take_along_axis(angle, rank.argmin(axis=1)[:, None], axis=1)[:, 0]
    direction = np.where(clear, np.arctan2(aside, along) / 2, nearest) % np.pi
    return np.asarray(np.where(weight.sum(axis=1) > 0, direction, 0.0))
