"""Polygons of traced outlines, and the ground in them where stems may stand."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Coverage, Rules
from urbanforest_cli.register.plantable import Ground, Surroundings, Taken, plantable_areas

STEMS_LEAST_M2 = 0.05
"""Smallest piece of ground that a stem stands on."""
LOTS_A_CHUNK = 2048

Shapes = NDArray[Any]


@dataclass(frozen=True)
class Outlines:
    """Rings of one lot: (n, 2) column and row, cell centres being whole numbers counted from the CRS's origin.

    Parameters
    ----------
    rings
        Where each ring begins, and the last ends.
    part
        Number of the part of the lot's region that each ring bounds, from 0.
    """

    xy: NDArray[np.float64]
    rings: NDArray[np.int64]
    part: NDArray[np.int64]


def polygons_of_outlines(outlines: list[Outlines], size_m: float, least_m2: float) -> Shapes:
    """Return the region of each lot as a valid multi-polygon in metres, None where no part reaches `least_m2`.

    Parameters
    ----------
    outlines
        One a lot.
    size_m
        Side of a cell.
    """
    result = np.full(len(outlines), None, dtype=object)
    if not sum(len(item.part) for item in outlines):
        return result
    counts = [int(item.part.max(initial=-1)) + 1 for item in outlines]
    first = np.concatenate(([0], np.cumsum(counts)))
    xy = np.concatenate([item.xy for item in outlines])
    xy = np.column_stack(((xy[:, 0] + 0.5) * size_m, -(xy[:, 1] + 0.5) * size_m))
    lengths = np.concatenate([np.diff(item.rings) for item in outlines])
    part = np.concatenate([item.part + start for item, start in zip(outlines, first[:-1], strict=True)])
    parts, where = _polygons(xy, lengths, part)
    parts, where = _sound(parts, where)
    big = shapely.area(parts) >= least_m2
    parts, where = parts[big], where[big]
    lot = np.searchsorted(first, where, side="right") - 1
    rows, place = np.unique(lot, return_inverse=True)
    if len(rows):
        joined: Shapes = np.asarray(shapely.multipolygons(parts, indices=place), dtype=object)
        crossed = np.flatnonzero(~shapely.is_valid(joined))
        for row in crossed:  # two parts that touch at a corner may cross once rounded
            joined[row] = _multi(shapely.union_all(shapely.get_parts(joined[row])))
        result[rows] = joined
    return result


def _polygons(
    xy: NDArray[np.float64], lengths: NDArray[np.int64], part: NDArray[np.int64]
) -> tuple[Shapes, NDArray[np.int64]]:
    """Return polygons of open rings, and the part that each is: the ring around the most is the shell."""
    starts = np.concatenate(([0], np.cumsum(lengths)))
    local = xy - xy[starts[:-1]].repeat(lengths, axis=0)
    after = np.arange(1, len(xy) + 1)
    after[starts[1:] - 1] = starts[:-1]
    cross = local[:, 0] * local[after, 1] - local[after, 0] * local[:, 1]
    area = np.add.reduceat(cross, starts[:-1])
    order = np.lexsort((-area, part))
    lengths, part, begins = lengths[order], part[order], starts[:-1][order]
    closed = lengths + 1
    ends = np.cumsum(closed)
    within = np.arange(ends[-1]) - np.repeat(ends - closed, closed)
    index = np.repeat(begins, closed) + within % np.repeat(lengths, closed)
    shells = np.flatnonzero(np.diff(part, prepend=-1))
    offsets = (np.concatenate(([0], ends)), np.concatenate((shells, [len(part)])))
    shapes = shapely.from_ragged_array(shapely.GeometryType.POLYGON, xy[index], offsets)
    return np.asarray(shapes, dtype=object), part[shells]


def _sound(parts: Shapes, where: NDArray[np.int64]) -> tuple[Shapes, NDArray[np.int64]]:
    """Mend polygons whose rounded outline crosses itself."""
    broken = ~shapely.is_valid(parts)
    if not broken.any():
        return parts, where
    mended = shapely.make_valid(parts[broken], method="structure", keep_collapsed=False)
    pieces, row = shapely.get_parts(mended, return_index=True)
    areal = shapely.get_dimensions(pieces) == 2
    parts = np.concatenate((parts[~broken], pieces[areal]))
    where = np.concatenate((where[~broken], where[broken][row[areal]]))
    order = np.argsort(where, kind="stable")
    return parts[order], where[order]


def joined_tiles(tiles: list[Any], boxes: list[Any], least_m2: float) -> Any:
    """Join a lot's regions as cut tile by tile, each within its own box, to one; None where nothing is left."""
    pieces = [
        shapely.intersection(tile, box) for tile, box in zip(tiles, boxes, strict=True) if tile is not None
    ]  # fmt: skip
    whole = shapely.union_all(np.array(pieces, dtype=object)) if pieces else None
    return None if whole is None else _multi(whole, least_m2)


def _multi(shape: Any, least_m2: float = 0.0) -> Any:
    parts = shapely.get_parts(shape)
    parts = parts[(shapely.get_dimensions(parts) == 2) & (shapely.area(parts) >= max(least_m2, 1e-9))]
    return shapely.multipolygons(parts) if len(parts) else None


def inside(regions: Shapes, lots: Shapes, workers: int) -> Shapes:
    """Return the part of each lot's region that lies in the lot, None where there is none."""
    result = np.full(len(regions), None, dtype=object)
    rows = np.flatnonzero(~shapely.is_missing(regions))
    chunks = [rows[start : start + LOTS_A_CHUNK] for start in range(0, len(rows), LOTS_A_CHUNK)]

    def cut(chunk: NDArray[np.int64]) -> Shapes:
        return np.asarray(shapely.intersection(regions[chunk], lots[chunk]), dtype=object)

    with ThreadPoolExecutor(workers) as pool:
        for chunk, found in zip(chunks, pool.map(cut, chunks), strict=True):
            result[chunk] = found
    flat = np.flatnonzero(shapely.get_type_id(result) == shapely.GeometryType.GEOMETRYCOLLECTION)
    for row in flat:  # where a region touches the border along a line
        result[row] = _multi(result[row])
    result[shapely.get_dimensions(result) != 2] = None
    result[shapely.is_empty(result)] = None
    return result


def stem_ground(
    insides: Shapes,
    buildings: Shapes,
    road_surfaces: Shapes,
    taken: Taken,
    config: Coverage,
    *,
    workers: int = 1,
    report: Callable[[int, int], None] | None = None,
) -> Shapes:
    """Return where stems may stand in regions: off walls, carriageways and the ground of other units.

    The distances of the planting rules do not apply: the trees are there already.

    Parameters
    ----------
    insides
        (n,) regions within their lots, None for none.
    taken
        Ground of others, by the rows of `insides`.
    """
    rules = Rules(building_clearance_m=config.wall_clearance_m, min_area_m2=STEMS_LEAST_M2)
    count = len(road_surfaces)
    around = Surroundings(
        buildings=buildings,
        obstacles=road_surfaces,
        obstacle_kinds=np.full(count, "road", dtype=object),
        obstacle_clearance_m=np.full(count, config.road_clearance_m),
    )
    areas = np.full(len(insides), None, dtype=object)
    rows = np.flatnonzero(~shapely.is_missing(insides))
    zones = np.full(len(rows), "", dtype=object)
    found: Ground = plantable_areas(
        insides[rows], zones, around, lambda _: rules, taken=taken.among(rows), workers=workers, report=report
    )
    areas[rows] = found.areas
    return areas
