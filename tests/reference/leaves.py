"""Leaves in plain words: the light that leaves around leave a cell, and which twig each card sits on."""

import numpy as np


def light_of_cells(tips, area_m2, cells, extinction=0.5, above=0.4, beside=0.15):
    """Return the (n, n, n) share of light from above and four sides in cells of a box around twigs, z first.

    A cell's leaves, spread over its face, take exp(-extinction * area / face) of what comes through; half of its own
    leaves stand before its middle.
    """
    low = tips.min(axis=0)
    size = np.maximum(np.ptp(tips, axis=0), 0.05) / cells
    area = np.zeros((cells, cells, cells))
    for tip, leaves in zip(tips, area_m2, strict=True):
        i, j, k = np.minimum(((tip - low) / size).astype(int), cells - 1)
        area[k, j, i] += leaves
    light = np.zeros_like(area)
    ways = [(0, 1, above), (1, 1, beside), (1, -1, beside), (2, 1, beside), (2, -1, beside)]  # axis, toward, share
    for axis, toward, share in ways:
        face = np.prod(np.delete(size[::-1], axis))
        depth = extinction * np.moveaxis(area, axis, 0)[::-toward] / face  # where the light comes from first
        before = np.cumsum(depth, axis=0) - depth
        light += share * np.moveaxis(np.exp(-before - 0.5 * depth)[::-toward], 0, axis)
    return light, low, size


def twigs_of_cards(tips, area_m2, middle, cards):
    """Return the twig of each card: stretches of twigs of equal leaf area, the outermost twig of each.

    A twig whose leaves are cut between cards stands for the later one only where that holds nothing else.
    """
    ends = np.cumsum(area_m2.astype(float))
    away = ((tips.astype(float) - middle) ** 2).sum(axis=1)
    chosen, first = [], 0
    for card in range(cards):
        last = min(int(np.searchsorted(ends, ends[-1] / cards * (card + 1))), len(tips) - 1)
        first = min(first, last)
        chosen.append(first + int(np.argmax(away[first : last + 1])))
        first = last + 1
    return np.array(chosen)
