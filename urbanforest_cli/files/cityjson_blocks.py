"""Buildings as CityJSON has them: blocks between a footprint and a height, faces outward."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

STEP_M = 0.001
GROUND, ROOF, WALL = 0, 1, 2
RING_MIN = 3


@dataclass(frozen=True)
class Block:
    """A building.

    Parameters
    ----------
    id, height_m
        Its own id, and the height of its walls.
    steps
        (v, 3) vertices in whole millimetres.
    surfaces
        For each face its rings, the outer one first, as places in `steps`.
    kinds
        (f,) whether a face is ground, roof or wall.
    is_solid
        Whether it is in one piece; several pieces are no solid.
    """

    id: str
    height_m: float
    steps: NDArray[np.int64]
    surfaces: list[list[NDArray[np.int64]]]
    kinds: NDArray[np.int64]
    is_solid: bool


def blocks_of(
    footprints: NDArray[np.object_] | None,
    height_m: NDArray[np.float64] | None,
    ids: NDArray[np.object_] | None,
) -> list[Block]:
    """Return a block for each footprint that encloses anything, once its corners are rounded to millimetres."""
    if footprints is None or height_m is None or ids is None:
        return []
    found = []
    for shape, height, name in zip(footprints, height_m.tolist(), ids.tolist(), strict=True):
        pieces = [rings for piece in shapely.get_parts(shape) if (rings := _rings(piece))]
        if pieces and round(height / STEP_M) > 0:
            found.append(_block(str(name), height, pieces))
    return found


def _rings(polygon: shapely.Polygon) -> list[NDArray[np.int64]]:
    """Return a polygon's rings in steps, without the last corner: the outer one counter-clockwise, holes clockwise."""
    rings = []
    for number, ring in enumerate(shapely.get_rings(polygon)):
        steps = np.rint(shapely.get_coordinates(ring)[:-1] / STEP_M).astype(np.int64)
        steps = steps[(steps != np.roll(steps, 1, axis=0)).any(axis=1)]
        twice_area = _twice_area(steps)
        if len(steps) < RING_MIN or twice_area == 0:
            if number == 0:
                return []
            continue
        rings.append(steps if (twice_area > 0) == (number == 0) else steps[::-1])
    return rings


def _twice_area(steps: NDArray[np.int64]) -> int:
    after = np.roll(steps, -1, axis=0)
    return int((steps[:, 0] * after[:, 1] - after[:, 0] * steps[:, 1]).sum())


def _block(name: str, height_m: float, pieces: list[list[NDArray[np.int64]]]) -> Block:
    top = round(height_m / STEP_M)
    steps: list[NDArray[np.int64]] = []
    surfaces: list[list[NDArray[np.int64]]] = []
    kinds: list[int] = []
    first = 0
    for rings in pieces:
        lower, upper = [], []
        walls: list[list[NDArray[np.int64]]] = []
        for ring in rings:
            count = len(ring)
            low = first + np.arange(count)
            steps += [np.column_stack([ring, np.full(count, z)]) for z in (0, top)]
            high, after = low + count, first + (np.arange(count) + 1) % count
            walls += [[corners] for corners in np.column_stack([low, after, after + count, high])]
            lower.append(low[::-1])
            upper.append(high)
            first += 2 * count
        surfaces += [lower, upper, *walls]
        kinds += [GROUND, ROOF, *[WALL] * len(walls)]
    return Block(name, height_m, np.concatenate(steps), surfaces, np.array(kinds), len(pieces) == 1)
