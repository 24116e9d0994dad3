"""The compiled part of `skeleton.py`: orders, pipes, measures and faults of plants in flat arrays.

Nodes of skeleton s are rows ``first[s]`` to ``first[s + 1]``; `parent` counts within the skeleton and lies below the
node's own number, so that a loop upward sees parents first and a loop downward children first.
"""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit
from numpy.typing import NDArray

BREAST_HEIGHT_M = 1.3
CROWN_SHARE = 0.03  # of the standing internodes: a smaller branch does not begin the crown
SECTORS = 8
HEIGHT, CROWN_RADIUS, CROWN_BASE, DBH, INTERNODES = 0, 1, 2, 3, 4

ROOT_PARENT, PARENT, POSITION, ROOT_POSITION, BIRTH, SEASON, DEATH, CARRIED, ORDER = range(9)
FAULTS = (
    "roots with a parent or a birth after planting",
    "parents that are not below their node",
    "positions that are no numbers or too far from the root",
    "roots away from (0, 0, 0)",
    "internodes born before what carries them",
    "births or deaths after the last season",
    "deaths before birth",
    "internodes that outlive what carries them",
    "branching orders lower than their parent's",
)

Ints = NDArray[Any]
Reals = NDArray[Any]


@njit(cache=True, nogil=True, error_model="numpy")
def count_faults(
    first: Ints, seasons: Ints, parent: Ints, xyz: Reals, order: Ints, birth: Ints, death: Ints, reach: float
) -> NDArray[np.int64]:
    """Count what is wrong by kind: (9, 2) how often, and the row where it was first seen."""
    faults = np.zeros((9, 2), np.int64)
    for s in range(len(first) - 1):
        root = first[s]
        for i in range(root, first[s + 1]):
            x, y, z = xyz[i, 0], xyz[i, 1], xyz[i, 2]
            if not (abs(x) <= reach and abs(y) <= reach and abs(z) <= reach):
                _note(faults, POSITION, i)
            if birth[i] > seasons[s] or death[i] > seasons[s]:
                _note(faults, SEASON, i)
            if death[i] != 0 and death[i] < birth[i]:
                _note(faults, DEATH, i)
            if i == root:
                if parent[i] != -1 or birth[i] != 0:
                    _note(faults, ROOT_PARENT, i)
                if x != 0.0 or y != 0.0 or z != 0.0:
                    _note(faults, ROOT_POSITION, i)
                continue
            if parent[i] < 0 or parent[i] >= i - root:
                _note(faults, PARENT, i)
                continue
            p = root + parent[i]
            if birth[i] < birth[p]:
                _note(faults, BIRTH, i)
            if death[p] != 0 and (death[i] == 0 or death[i] > death[p]):
                _note(faults, CARRIED, i)
            if order[i] < order[p]:
                _note(faults, ORDER, i)
    return faults


@njit(cache=True, nogil=True, error_model="numpy")
def _note(faults: NDArray[np.int64], kind: int, row: int) -> None:
    if faults[kind, 0] == 0:
        faults[kind, 1] = row
    faults[kind, 0] += 1


@njit(cache=True, nogil=True, error_model="numpy")
def depth_first(first: Ints, parent: Ints, order: Ints, birth: Ints) -> NDArray[np.int64]:
    """Return rows in depth-first order; of children the lowest order, then the oldest, then the first comes first."""
    n = len(parent)
    child = np.full(n, -1, np.int64)
    sibling = np.full(n, -1, np.int64)
    rows = np.empty(n, np.int64)
    for s in range(len(first) - 1):
        root, end = first[s], first[s + 1]
        for i in range(end - 1, root, -1):
            rank = order[i] * 256 + birth[i]
            p = root + parent[i]
            before, after = np.int64(-1), child[p]
            while after >= 0 and order[after] * 256 + birth[after] < rank:
                before, after = after, sibling[after]
            sibling[i] = after
            if before < 0:
                child[p] = i
            else:
                sibling[before] = i
        i = root
        for k in range(root, end):
            rows[k] = i
            if child[i] >= 0:
                i = child[i]
            else:
                while i != root and sibling[i] < 0:
                    i = root + parent[i]
                if i != root:
                    i = sibling[i]
    return rows


@njit(cache=True, nogil=True, error_model="numpy")
def count_pipes(first: Ints, parent: Ints, birth: Ints, season_end: Ints) -> NDArray[np.int32]:
    """Count the twig ends at or above each node among what is born by a season; 0 for what is not."""
    pipes = np.zeros(len(parent), np.int32)
    for s in range(len(first) - 1):
        root = first[s]
        for i in range(first[s + 1] - 1, root - 1, -1):
            if birth[i] <= season_end[s]:
                pipes[i] = max(1, pipes[i])
                if i > root:
                    pipes[root + parent[i]] += pipes[i]
    return pipes


@njit(cache=True, nogil=True, error_model="numpy")
def measure_all(
    first: Ints,
    parent: Ints,
    xyz: Reals,
    order: Ints,
    birth: Ints,
    death: Ints,
    tip_radius: Reals,
    exponent: Reals,
    season_end: Ints,
) -> NDArray[np.float64]:
    """Measure plants as they stood at the end of a season: (s, 5) height, crown radius, crown base, dbh, internodes."""
    pipes = count_pipes(first, parent, birth, season_end)
    above = np.zeros(len(parent), np.int32)  # standing internodes at or above
    sizes = np.zeros((len(first) - 1, 5))
    reach = np.empty(SECTORS)
    for s in range(len(first) - 1):
        root, end, season = first[s], first[s + 1], season_end[s]
        for i in range(end - 1, root, -1):
            if birth[i] <= season and (death[i] == 0 or death[i] > season):
                above[i] += 1
                above[root + parent[i]] += above[i]
        reach[:] = 0.0
        height, largest = 0.0, 0
        for i in range(root + 1, end):
            if above[i] == 0:
                continue
            x, y = np.float64(xyz[i, 0]), np.float64(xyz[i, 1])
            height = max(height, np.float64(xyz[i, 2]))
            sector = (4 if x < 0 else 0) + (2 if y < 0 else 0) + (1 if abs(x) > abs(y) else 0)
            reach[sector] = max(reach[sector], x * x + y * y)
            if order[i] > 0 and order[root + parent[i]] == 0:
                largest = max(largest, above[i])
        sizes[s, HEIGHT] = height
        sizes[s, CROWN_RADIUS] = np.sqrt(reach).mean()
        sizes[s, CROWN_BASE] = _crown_base(root, end, parent, xyz, order, above, largest)
        sizes[s, DBH] = 2.0 * _breast_radius(root, end, parent, xyz, order, above, pipes, tip_radius[s], exponent[s])
        sizes[s, INTERNODES] = above[root]
    return sizes


@njit(cache=True, nogil=True, error_model="numpy")
def _crown_base(root: int, end: int, parent: Ints, xyz: Reals, order: Ints, above: Ints, largest: int) -> float:
    """Return the height at which the lowest branch that matters leaves the trunk or a stem; 0 without branches."""
    enough = min(CROWN_SHARE * above[root], 0.5 * largest)
    base = np.inf
    for i in range(root + 1, end):
        p = root + parent[i]
        if above[i] > 0 and above[i] >= enough and order[i] > 0 and order[p] == 0:
            base = min(base, np.float64(xyz[p, 2]))
    return base if base < np.inf else 0.0


@njit(cache=True, nogil=True, error_model="numpy")
def _breast_radius(
    root: int,
    end: int,
    parent: Ints,
    xyz: Reals,
    order: Ints,
    above: Ints,
    pipes: Ints,
    tip_radius: float,
    exponent: float,
) -> float:
    """Return the radius of a circle with the section that all stems have together at breast height.

    Each stem counts where it first passes that height. Where no stem does, for its tip was lost, the thickest branch.
    """
    passed = np.zeros(end - root, np.uint8)
    squares, thickest = 0.0, 0
    for i in range(root + 1, end):
        p = root + parent[i]
        passed[i - root] = passed[p - root]
        if above[i] > 0 and xyz[p, 2] < BREAST_HEIGHT_M <= xyz[i, 2] and not passed[p - root]:
            passed[i - root] = 1
            thickest = max(thickest, pipes[i])
            if order[i] == 0:
                squares += (tip_radius * np.float64(pipes[i]) ** (1.0 / exponent)) ** 2
    if squares > 0:
        return np.sqrt(squares)  # type: ignore[no-any-return]
    return tip_radius * np.float64(thickest) ** (1.0 / exponent) if thickest > 0 else 0.0
