"""Areas of crowns and of a coverage map in each lot, summed tile by tile."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.polygon_raster import rings_of
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.evaluation.agreement.sets import CrownsOfLots
from urbanforest_cli.evaluation.agreement.tally_kernel import mark_discs, marked_shares, tally_lots

Floats = NDArray[np.float64]
Window = tuple[NDArray[np.uint8], tuple[float, float]]
ReadWindow = Callable[[float, float, float, float], Window]
"""From west, south, east, north in metres to percentages (row, col), 255 where unknown, and the upper left corner."""

TILE_CELLS = 1024
KERNELS = (mark_discs, marked_shares, tally_lots)


@dataclass(frozen=True)
class Tally:
    """Areas by lot in square metres, (lots,) each; all but the whole on ground that the map knows.

    Ground that lies in two lots counts in both.

    Parameters
    ----------
    whole_m2, known_m2
        The lot, and the part of it that the map knows.
    covered_m2
        Where the map reaches the threshold.
    percent_m2
        By the map's percentages.
    crown_m2
        Of each set, ground under its crowns.
    half_m2, both_m2
        Cells of which half or more is under crowns, as a map would show them; and those of them that are covered.
    """

    whole_m2: Floats
    known_m2: Floats
    covered_m2: Floats
    percent_m2: Floats
    crown_m2: Mapping[str, Floats]
    half_m2: Mapping[str, Floats]
    both_m2: Mapping[str, Floats]


def tally(
    lots: NDArray[np.object_],
    sets: Mapping[str, CrownsOfLots],
    read: ReadWindow,
    *,
    cell_m: float,
    threshold_percent: float,
    bounds_m: tuple[float, float, float, float],
    tile_cells: int = TILE_CELLS,
    progress: Progress = silent,
) -> Tally:
    """Sum the areas of a map and of crowns over lots.

    Memory is that of one tile. A crown counts where it is, whichever lot it belongs to; crowns that overlap count
    once, to 1/64 of a cell.

    Parameters
    ----------
    lots
        (lots,) valid polygons in metres.
    sets
        Crowns by name.
    read, cell_m
        Reads the map; its windows have cells of `cell_m` on whole multiples of it.
    threshold_percent
        From which a cell counts as covered.
    bounds_m
        Of the map: tiles beside it are not read.
    """
    sums = np.zeros((len(lots), 3 + 3 * len(sets)))
    tree = shapely.STRtree(lots)
    discs = [_Discs.of(one) for one in sets.values()]
    side = tile_cells * cell_m
    tiles = _tiles(lots, bounds_m, side)
    for number, (column, row) in enumerate(tiles):
        progress("comparing crowns with the map", number, len(tiles))
        box = (column * side, row * side, (column + 1) * side, (row + 1) * side)
        there = np.sort(tree.query(shapely.box(*box)))
        if len(there) == 0:
            continue
        percent, (x0, y_top) = read(*box)
        percent, x0, y_top = _cut(percent, x0, y_top, box, cell_m)
        if not percent.size:
            continue
        shares = np.zeros((len(discs), *percent.shape), dtype=np.float32)
        marks = np.zeros(percent.shape, dtype=np.uint64)
        for place, disc in enumerate(discs):
            marks[:] = 0
            mark_discs(marks, *disc.reaching(box), x0, y_top, cell_m)
            marked_shares(marks, shares[place])
        rings = rings_of(lots[there])
        tally_lots(percent, threshold_percent, shares, rings.xy, rings.ring_offsets, rings.signs, rings.shape_offsets,
                   there.astype(np.int64), x0, y_top, cell_m, sums)  # fmt: skip
    progress("comparing crowns with the map", len(tiles), len(tiles))
    areas = sums * cell_m**2
    return Tally(
        whole_m2=shapely.area(lots),
        known_m2=areas[:, 0],
        covered_m2=areas[:, 1],
        percent_m2=areas[:, 2],
        crown_m2={name: areas[:, 3 + 3 * k] for k, name in enumerate(sets)},
        half_m2={name: areas[:, 4 + 3 * k] for k, name in enumerate(sets)},
        both_m2={name: areas[:, 5 + 3 * k] for k, name in enumerate(sets)},
    )


@dataclass(frozen=True)
class _Discs:
    """Crowns that stand, from west to east."""

    x: Floats
    y: Floats
    radius_m: Floats

    @classmethod
    def of(cls, crowns: CrownsOfLots) -> _Discs:
        order = np.argsort(crowns.plants.xy[:, 0], kind="stable")
        order = order[crowns.radius_m[order] > 0]
        x, y = crowns.plants.xy[order].T.copy()
        return cls(x, y, crowns.radius_m[order])

    def reaching(self, box: tuple[float, float, float, float]) -> tuple[Floats, Floats, Floats]:
        """Return x, y and radii of those that reach into a box."""
        west, south, east, north = box
        reach = float(self.radius_m.max(initial=0.0))
        part = slice(*np.searchsorted(self.x, (west - reach, east + reach)))
        x, y, radius = self.x[part], self.y[part], self.radius_m[part]
        near = (y + radius >= south) & (y - radius <= north)
        return x[near], y[near], radius[near]


def _tiles(
    lots: NDArray[np.object_], bounds_m: tuple[float, float, float, float], side_m: float
) -> list[tuple[int, int]]:
    """Return columns and rows of the tiles that lots and the map have in common."""
    if len(lots) == 0:
        return []
    around = shapely.total_bounds(lots)
    low = np.floor(np.maximum(around[:2], bounds_m[:2]) / side_m).astype(int)
    high = np.ceil(np.minimum(around[2:], bounds_m[2:]) / side_m).astype(int)
    return [(column, row) for row in range(low[1], high[1]) for column in range(low[0], high[0])]


def _cut(
    percent: NDArray[np.uint8], x0: float, y_top: float, box: tuple[float, float, float, float], cell_m: float
) -> tuple[NDArray[np.uint8], float, float]:
    """Cut a window to the cells of a tile, so that no cell is summed in two of them."""
    left, top = max(0, round((box[0] - x0) / cell_m)), max(0, round((y_top - box[3]) / cell_m))
    right, bottom = max(0, round((box[2] - x0) / cell_m)), max(0, round((y_top - box[1]) / cell_m))
    return np.ascontiguousarray(percent[top:bottom, left:right]), x0 + left * cell_m, y_top - top * cell_m
