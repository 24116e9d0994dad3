"""Cut a coverage map into lots: the vegetation of each, by whose crowns it is.

A region of the map knows no borders: the crown of a tree by the fence covers ground of the neighbour, too, and must
not be planted twice. With d the distance of a covered place to open ground, a lot has the discs of radius d about all
its own covered places, except those that are only the fringe of a larger disc about a place of another lot
(`regions_kernel.settled`). Ground that is nobody's own, or fringe, goes to the lot whose disc reaches farthest over it
(`regions_kernel.claims`). So a lot's region may reach over its border, at most `REACH_M`, and where it does, no other
lot's claims the same crown.

The work is done in blocks of cells counted from the origin of the CRS, with as much around each as matters inside. So
a region depends on the lot and on what is near it alone, and not on how many lots there are or who works on them.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.register.near import flat_of
from urbanforest_cli.register.outline_kernel import outlines
from urbanforest_cli.register.packed import PackedShapes
from urbanforest_cli.register.region_polygons import Outlines, joined_tiles, polygons_of_outlines
from urbanforest_cli.register.regions_kernel import (
    NOBODY,
    UNKNOWN,
    claims,
    cleaned,
    count_cells,
    depths,
    heights,
    paint,
    reaching,
    settled,
)

REACH_M = 6.0
"""Distances to open ground are not told apart beyond this."""
TOLERANCE_M = 0.08
"""Corners of outlines nearer to the line are left out."""
BLOCK_CELLS = 1024
LONG_CELLS = 1536
"""Lots longer than this are cut tile by tile."""
TILE_CELLS = 1024
SEAM_CELLS = 12
"""How far a tile sees beyond its edge, so that outlines are the same on both sides."""
PIECE_SHARE = 0.5
"""Pieces into which borders cut a region are dropped below this share of the smallest region."""
MOST_CLEANED_CELLS = 64
"""How far it is looked around a block whether a region is a small one."""
KERNELS = (cleaned, depths, settled, reaching, claims, heights, outlines, paint, count_cells)

Shapes = NDArray[Any]
Read = Callable[[float, float, float, float], tuple[NDArray[np.uint8], tuple[float, float]]]


@dataclass(frozen=True)
class CoveredMap:
    """A coverage map as cells in metres.

    Parameters
    ----------
    read
        From west, south, east, north to percentages of the cells touched, row 0 in the north, 255 where unknown, and
        the west and north edge of the first. Cells are counted from the origin of the CRS. Called from any thread.
    resolution_m
        Side of a cell.
    threshold_percent
        From which a cell is covered.
    """

    read: Read
    resolution_m: float
    threshold_percent: float


@dataclass(frozen=True)
class Owners:
    """Who has which ground, the lowest first: polygons, each with the row of its unit or -1 for nobody's."""

    shapes: Shapes
    rows: NDArray[np.int32]


@dataclass(frozen=True)
class Regions:
    """What the map shows of each unit.

    Parameters
    ----------
    shapes
        (n,) multi-polygons in metres, with what reaches over the unit's border; None where there is none.
    covered_fraction
        (n,) share of the known ground that is covered; NaN where nothing is known.
    seen_fraction
        (n,) share of the ground that the map knows.
    """

    shapes: PackedShapes
    covered_fraction: NDArray[np.float64]
    seen_fraction: NDArray[np.float64]


@dataclass(frozen=True)
class _Item:
    """A unit or a tile of one, in cells counted from the CRS's origin."""

    row: int
    top: int
    left: int
    rows: int
    cols: int
    tile: bool


def cut_regions(
    units: Shapes,
    owners: Owners,
    covered: CoveredMap,
    *,
    smallest_region_m2: float,
    workers: int = 1,
    report: Callable[[int, int], None] | None = None,
) -> Regions:
    """Cut a map into units.

    Parameters
    ----------
    units
        (n,) valid polygons in metres; None for those that are not asked for.
    owners
        Who has which ground, units asked for or not.
    smallest_region_m2
        Smaller regions of the map are dropped, smaller holes in them filled.
    workers
        Threads.
    report
        Called with units done and units in all.
    """
    cutter = _Cutter(units, owners, covered, smallest_region_m2)
    blocks = list(cutter.blocks())
    counted = np.zeros((len(units), 3), dtype=np.int64)
    shapes = PackedShapes(len(units))
    tiles: dict[int, list[tuple[Any, Any]]] = {}
    done, total = 0, sum(len(block) for block in blocks)
    with ThreadPoolExecutor(workers) as pool:
        for block, (found, counts) in zip(blocks, pool.map(cutter.cut, blocks), strict=True):
            for item, shape, count in zip(block, found, counts, strict=True):
                counted[item.row] += count
                if item.tile:
                    tiles.setdefault(item.row, []).append((shape, cutter.box(item)))
            whole = np.array([not item.tile for item in block])
            shapes.put(np.array([item.row for item in block])[whole], found[whole])
            done += len(block)
            if report is not None:
                report(done, total)
    for row, pieces in tiles.items():
        joined = joined_tiles([piece[0] for piece in pieces], [piece[1] for piece in pieces], cutter.piece_m2)
        shapes.put(np.array([row]), np.array([joined], dtype=object))
    known, green, count = counted.T
    with np.errstate(invalid="ignore", divide="ignore"):
        return Regions(shapes, np.where(known > 0, green / known, np.nan), np.where(count > 0, known / count, 0.0))


class _Cutter:
    """One map and who has the ground, indexed."""

    def __init__(self, units: Shapes, owners: Owners, covered: CoveredMap, smallest_m2: float) -> None:
        self.units = units
        self.owners = owners
        self.map = covered
        self.size = covered.resolution_m
        self.tree = shapely.STRtree(owners.shapes)
        self.cap = REACH_M / self.size
        self.least_cells = math.ceil(smallest_m2 / self.size**2)
        self.piece_m2 = PIECE_SHARE * smallest_m2
        self.reach = math.ceil(self.cap) + 2
        self.halo = 5 * self.reach + min(self.least_cells, MOST_CLEANED_CELLS) + SEAM_CELLS

    def blocks(self) -> Iterator[list[_Item]]:
        """Yield units that are near each other, those of a block of cells together, in order of the blocks."""
        found: dict[tuple[int, int], list[_Item]] = {}
        bounds = shapely.bounds(self.units)
        for row in np.flatnonzero(~shapely.is_missing(self.units)).tolist():
            west, south, east, north = bounds[row]
            top, bottom = math.floor(-north / self.size), math.ceil(-south / self.size)
            left, right = math.floor(west / self.size), math.ceil(east / self.size)
            for item in self._items(row, top, left, bottom, right):
                block = (item.top + item.rows // 2) // BLOCK_CELLS, (item.left + item.cols // 2) // BLOCK_CELLS
                found.setdefault(block, []).append(item)
        for block in sorted(found):
            yield found[block]

    def _items(self, row: int, top: int, left: int, bottom: int, right: int) -> Iterator[_Item]:
        if max(bottom - top, right - left) <= LONG_CELLS:
            yield _Item(row, top, left, bottom - top, right - left, tile=False)
            return
        # crowns reach over the border, into tiles beside those that the unit lies in
        near = shapely.buffer(self.units[row], self.reach * self.size, quad_segs=1)
        shapely.prepare(near)
        span = TILE_CELLS
        for i in range((top - self.reach) // span, (bottom + self.reach) // span + 1):
            for j in range((left - self.reach) // span, (right + self.reach) // span + 1):
                item = _Item(row, i * span, j * span, span, span, tile=True)
                if shapely.intersects(near, self.box(item)):
                    yield item

    def box(self, item: _Item) -> Any:
        """Return the ground of an item."""
        size = self.size
        west, north = item.left * size, -item.top * size
        return shapely.box(west, north - item.rows * size, west + item.cols * size, north)

    def cut(self, items: list[_Item]) -> tuple[Shapes, NDArray[np.int64]]:
        """Return the regions of items that are near each other, and cells of each: known, covered, in all."""
        top = min(item.top for item in items) - self.halo
        left = min(item.left for item in items) - self.halo
        rows = max(item.top + item.rows for item in items) + self.halo - top
        cols = max(item.left + item.cols for item in items) + self.halo - left
        percent = self._read(top, left, rows, cols)
        rings = self._rings([item.row for item in items])
        threshold = self.map.threshold_percent
        counts = np.zeros((len(items), 3), dtype=np.int64)
        some = bool(((percent >= threshold) & (percent != UNKNOWN)).any())
        covered = cleaned(percent, threshold, self.least_cells) if some else np.zeros(percent.shape, dtype=bool)
        for k, item in enumerate(items):
            part = (
                slice(item.top - top, item.top - top + item.rows),
                slice(item.left - left, item.left - left + item.cols),
            )
            inside = np.empty((item.rows, item.cols), dtype=np.uint8)
            counts[k] = count_cells(
                *rings[item.row], self.size, item.top, item.left, percent[part], covered[part], inside
            )
            if not counts[k, 2] and not item.tile:
                counts[k] = _one_cell(self.units[item.row], percent, covered, self.size, top, left)
        if not covered.any():
            return np.full(len(items), None, dtype=object), counts
        depth = depths(covered, self.cap)
        whose = settled(depth, self._painted(top, left, rows, cols), self.cap)
        taker, first, second = claims(depth, whose, reaching(depth, whose, self.cap))
        found = []
        for item in items:
            margin = self.reach if not item.tile else SEAM_CELLS + self.reach
            first_row, first_col = item.top - margin, item.left - margin
            field = np.empty((item.rows + 2 * margin, item.cols + 2 * margin), dtype=np.float32)
            heights(
                percent, threshold, covered, depth, whose, taker, first, second, item.row, first_row - top,
                first_col - left, field,
            )  # fmt: skip
            field[[0, -1]] = np.minimum(field[[0, -1]], -0.5)
            field[:, [0, -1]] = np.minimum(field[:, [0, -1]], -0.5)
            xy, starts, part_of, _ = outlines(field, TOLERANCE_M / self.size)
            found.append(Outlines(xy + np.array([first_col, first_row]), starts, part_of))
        return polygons_of_outlines(found, self.size, self.piece_m2), counts

    def _read(self, top: int, left: int, rows: int, cols: int) -> NDArray[np.uint8]:
        """Return the percentages of cells; boxes end within cells, so that rounding cannot add another."""
        west, north = (left + 0.25) * self.size, -(top + 0.25) * self.size
        east, south = (left + cols - 0.25) * self.size, -(top + rows - 0.25) * self.size
        percent, _ = self.map.read(west, south, east, north)
        return percent

    def _rings(self, rows: list[int]) -> dict[int, tuple[NDArray[np.float64], NDArray[np.int64]]]:
        """Return coordinates and rings of units."""
        rows = sorted(set(rows))
        flat = flat_of(self.units[rows])
        return {
            row: (flat.xy, flat.rings[flat.offsets[k] : flat.offsets[k + 1] + 1]) for k, row in enumerate(rows)
        }  # fmt: skip

    def _painted(self, top: int, left: int, rows: int, cols: int) -> NDArray[np.int32]:
        """Return whose ground each cell is, `NOBODY` where nobody's."""
        owner = np.full((rows, cols), NOBODY, dtype=np.int32)
        window = shapely.box(left * self.size, -(top + rows) * self.size, (left + cols) * self.size, -top * self.size)
        near = np.sort(self.tree.query(window))
        if not len(near):
            return owner
        flat = flat_of(self.owners.shapes[near])
        low = np.column_stack((-flat.boxes[:, 3] / self.size - top, flat.boxes[:, 0] / self.size - left))
        high = np.column_stack((-flat.boxes[:, 1] / self.size - top, flat.boxes[:, 2] / self.size - left))
        first = np.clip(np.floor(low), 0, (rows, cols)).astype(np.int64)
        last = np.clip(np.ceil(high), 0, (rows, cols)).astype(np.int64)
        boxes = np.column_stack((first, last - first))
        paint(flat.xy, flat.rings, flat.offsets, self.owners.rows[near], boxes, self.size, top, left, owner)
        return owner


def _one_cell(
    unit: Any, percent: NDArray[np.uint8], covered: NDArray[np.bool_], size: float, top: int, left: int
) -> tuple[int, int, int]:
    """Return what the cell under a unit says that is too small to hold the centre of one."""
    point = shapely.point_on_surface(unit)
    row, col = math.floor(-point.y / size) - top, math.floor(point.x / size) - left
    known = int(percent[row, col] != UNKNOWN)
    return known, int(covered[row, col]) * known, 1
