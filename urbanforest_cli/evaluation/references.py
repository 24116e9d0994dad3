"""Reference point sets in a lot: at random, evenly spaced, on a lattice. None of them knows the real plants."""

from __future__ import annotations

import numpy as np
import shapely
from numba import njit
from numpy.typing import NDArray

Floats = NDArray[np.float64]

JAMMING_COVERAGE = 0.547
CANDIDATES_A_POINT = 24
SHRINK = 0.96
BATCH_MIN, BATCH_MAX = 64, 1_000_000
SLIVER_SHARE = 1e-9
CELLS_MAX = 4_000_000


def uniform_points(window: shapely.Geometry, count: int, rng: np.random.Generator) -> Floats:
    """Draw points uniformly in a polygon, by rejection from the boxes of its parts; shape (count, 2)."""
    parts = _parts(window)
    areas = shapely.area(parts)
    drawn = rng.multinomial(count, areas / areas.sum())
    points = [_in_part(part, int(n), rng) for part, n in zip(parts, drawn, strict=True) if n]
    found = np.concatenate([np.zeros((0, 2)), *points])
    return found[rng.permutation(len(found))]


def _parts(window: shapely.Geometry) -> NDArray[np.object_]:
    """Return the parts of a polygon, ready for many questions, without slivers that no point would ever hit."""
    parts = shapely.get_parts(window)
    parts = parts[shapely.area(parts) > SLIVER_SHARE * shapely.area(window)]
    shapely.prepare(parts)
    return parts


def _in_part(part: shapely.Geometry, count: int, rng: np.random.Generator) -> Floats:
    west, south, east, north = shapely.bounds(part)
    box = (east - west) * (north - south)
    share = shapely.area(part) / box
    kept: list[Floats] = []
    missing = count
    while missing > 0:
        batch = min(int(missing / share * 1.2) + BATCH_MIN, BATCH_MAX)
        xy = rng.random((batch, 2)) * (east - west, north - south) + (west, south)
        inside = xy[shapely.contains_xy(part, xy[:, 0], xy[:, 1])][:missing]
        kept.append(inside)
        missing -= len(inside)
    return np.concatenate(kept)


def even_points(window: shapely.Geometry, count: int, rng: np.random.Generator) -> Floats:
    """Throw darts that keep apart as far as `count` of them can; shape (count, 2).

    It starts at the distance at which random packing jams at `count` discs, and gives way a little each time no
    candidate fits.
    """
    candidates = uniform_points(window, CANDIDATES_A_POINT * count, rng)
    apart = np.sqrt(4 / np.pi * JAMMING_COVERAGE * shapely.area(window) / count)
    chosen: NDArray[np.int64] = _darts(candidates - candidates.min(axis=0), count, apart, SHRINK)
    return np.asarray(candidates[chosen])


def lattice_points(window: shapely.Geometry, count: int, rng: np.random.Generator) -> Floats:
    """Lay a square lattice of random phase and turn with just about `count` points inside; shape (count, 2)."""
    parts = _parts(window)
    middle = np.array(shapely.bounds(window)).reshape(2, 2).mean(axis=0)
    turn, phase = rng.random() * np.pi / 2, rng.random(2)
    rotation = np.array([[np.cos(turn), -np.sin(turn)], [np.sin(turn), np.cos(turn)]])
    cell = np.sqrt(shapely.area(window) / count)
    while True:
        points = np.concatenate([_lattice_in_part(part, cell, rotation, phase, middle) for part in parts])
        if len(points) >= count:
            return np.asarray(points[np.sort(rng.permutation(len(points))[:count])])
        cell *= SHRINK


def _lattice_in_part(part: shapely.Geometry, cell: float, rotation: Floats, phase: Floats, middle: Floats) -> Floats:
    west, south, east, north = shapely.bounds(part)
    corners = np.array([[west, south], [east, south], [east, north], [west, north]])
    cells = (corners - middle) @ rotation / cell - phase
    low, high = np.floor(cells.min(axis=0)), np.ceil(cells.max(axis=0))
    steps = np.meshgrid(np.arange(low[0], high[0] + 1), np.arange(low[1], high[1] + 1))
    points = (np.stack(steps, axis=-1).reshape(-1, 2) + phase) * cell @ rotation.T + middle
    return np.asarray(points[shapely.contains_xy(part, points[:, 0], points[:, 1])])


@njit(cache=True, nogil=True)
def _darts(candidates: Floats, count: int, apart: float, shrink: float) -> NDArray[np.int64]:
    """Choose `count` candidates in their order, no two nearer than `apart`, which shrinks whenever all are tried.

    Candidates have coordinates from 0; cells no smaller than the first `apart` hold the chosen in
    linked lists.
    """
    width, height = candidates[:, 0].max(), candidates[:, 1].max()
    size = max(apart, np.sqrt(width * height / CELLS_MAX))
    columns = int(width / size) + 3
    rows = int(height / size) + 3
    head = np.full(columns * rows, -1, dtype=np.int64)
    following = np.full(count, -1, dtype=np.int64)
    chosen = np.empty(count, dtype=np.int64)
    taken = np.zeros(len(candidates), dtype=np.bool_)
    found = 0
    while found < count:
        for i in range(len(candidates)):
            if taken[i]:
                continue
            column = int(candidates[i, 0] / size) + 1
            row = int(candidates[i, 1] / size) + 1
            free = True
            for cell_row in range(row - 1, row + 2):
                for cell_column in range(column - 1, column + 2):
                    k = head[cell_row * columns + cell_column]
                    while k >= 0 and free:
                        dx = candidates[i, 0] - candidates[chosen[k], 0]
                        dy = candidates[i, 1] - candidates[chosen[k], 1]
                        free = dx * dx + dy * dy >= apart * apart
                        k = following[k]
            if free:
                taken[i] = True
                chosen[found] = i
                following[found] = head[row * columns + column]
                head[row * columns + column] = found
                found += 1
                if found == count:
                    break
        apart *= shrink
    return chosen


KERNELS = (_darts,)
