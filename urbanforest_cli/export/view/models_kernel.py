"""Puts branches and leaves of many plants in the order in which they are drawn: see `models`."""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.export.plant_light_kernel import hash_pair
from urbanforest_cli.export.view.draw_kernel import encoded


@njit(cache=True, nogil=True, error_model="numpy")
def order_wood(owner, start, end, start_radius, end_radius, rgb, thinnest, count):
    """Put each plant's branches from thick to thin and leave out thinner ones than `thinnest` (s,).

    Returns
    -------
    first
        (s + 1,) where each plant's begin.
    branch, colour
        (m, 8) both ends and both radii, (m, 3) bytes.
    reach, top
        (s,) how far from the root's vertical, and how high, the branches go, those left out too.
    """
    reach, top = np.zeros(count), np.zeros(count)
    first = np.zeros(count + 1, np.int64)
    thick = np.empty(len(owner), np.float32)
    for s in range(len(owner)):
        n = owner[s]
        wide = max(start_radius[s], end_radius[s])
        thick[s] = wide
        reach[n] = max(reach[n], np.sqrt(end[s, 0] ** 2 + end[s, 1] ** 2) + wide)
        top[n] = max(top[n], end[s, 2] + wide)
        if thick[s] >= thinnest[n]:
            first[n + 1] += 1
    for n in range(count):
        first[n + 1] += first[n]
    held = np.empty(first[count], np.int64)
    filled = first.copy()
    for s in range(len(owner)):
        n = owner[s]
        if thick[s] >= thinnest[n]:
            held[filled[n]] = s
            filled[n] += 1
    branch = np.empty((len(held), 8), np.float32)
    colour = np.empty((len(held), 3), np.uint8)
    for n in range(count):
        mine = held[first[n] : first[n + 1]]
        order = np.argsort(-thick[mine], kind="mergesort")
        for k in range(len(mine)):
            s, row = mine[order[k]], first[n] + k
            for c in range(3):
                branch[row, c], branch[row, 3 + c] = start[s, c], end[s, c]
                colour[row, c] = encoded(rgb[s, c])
            branch[row, 6], branch[row, 7] = start_radius[s], end_radius[s]
    return first, branch, colour, reach, top


@njit(cache=True, nogil=True, error_model="numpy")
def shuffle_leaves(first, centre, along, across, rgb):
    """Put each plant's leaves in an order by chance, the same for a plant whatever the others.

    Parameters
    ----------
    first
        (s + 1,) where each plant's leaves begin.
    centre, along, across, rgb
        (k, 3) each.

    Returns
    -------
    leaf, colour
        (k, 9) vectors, (k, 3) bytes.
    longest, middle
        (s,) no leaf reaches farther from its middle; (s, 3) of all.
    """
    leaf = np.empty((len(centre), 9), np.float32)
    colour = np.empty((len(centre), 3), np.uint8)
    order = np.arange(len(centre))
    longest, middle = np.zeros(len(first) - 1, np.float32), np.zeros((len(first) - 1, 3))
    for n in range(len(first) - 1):
        low = first[n]
        for last in range(first[n + 1] - low - 1, 0, -1):
            other = low + np.int64(hash_pair(last, 0) % np.uint64(last + 1))
            order[low + last], order[other] = order[other], order[low + last]
        for k in range(low, first[n + 1]):
            s, far = order[k], 0.0
            for c in range(3):
                leaf[k, c], leaf[k, 3 + c], leaf[k, 6 + c] = centre[s, c], along[s, c], across[s, c]
                colour[k, c] = encoded(rgb[s, c])
                far += along[s, c] ** 2 + across[s, c] ** 2
                middle[n, c] += centre[s, c]
            longest[n] = max(longest[n], np.sqrt(far))
        for c in range(3):
            middle[n, c] /= max(first[n + 1] - low, 1)
    return leaf, colour, longest, middle
