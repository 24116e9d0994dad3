"""A lot and the coverage around it on a small grid in metres: what parameters are read off."""

from __future__ import annotations

from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, fields

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.lot_windows_kernel import fill_windows
from urbanforest_cli.core.polygon_raster import Rings, Shapes, rings_of

WINDOW_PX = 128
PIXELS_M = (0.5, 1.0)
"""A lot that fits a window at 0.5 m gets one such window, a longer one windows at 1 m, side by side."""
PIECES_MAX = 16
"""Most windows of one lot; of a larger one, an even choice."""
EDGE_MAX_M = 12.0
WINDOWS_A_CHUNK = 64
LEAST_SHARE = 0.02
"""Of a window at its full size, of what a lot must fill to be shown in a window among several."""


@dataclass(frozen=True)
class LotWindows:
    """Windows of lots, row 0 in the north.

    Parameters
    ----------
    owner
        (n,) row of the lot that a window shows; a long lot has several.
    pixel_m
        (n,) float32: 0.5 or 1.
    coverage, lot, ground
        (n, 128, 128) uint8: percentage of a pixel under vegetation (also beyond the lot), in the lot, in the lot and
        not under a building.
    edge_dm
        (n, 128, 128) uint8: distance of a pixel's centre to the lot's edge in decimetres, at most 120, 0 outside.
    lot_area_m2, ground_area_m2
        (n,) float64, of the whole lot.
    """

    owner: NDArray[np.int64]
    pixel_m: NDArray[np.float32]
    coverage: NDArray[np.uint8]
    lot: NDArray[np.uint8]
    ground: NDArray[np.uint8]
    edge_dm: NDArray[np.uint8]
    lot_area_m2: NDArray[np.float64]
    ground_area_m2: NDArray[np.float64]

    def __len__(self) -> int:
        """Return the number of windows."""
        return len(self.owner)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_] | slice) -> LotWindows:
        """Return some of the windows."""
        return LotWindows(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})


@dataclass(frozen=True)
class WindowPlaces:
    """Where windows lie.

    Parameters
    ----------
    owner
        (n,) row of the lot that a window shows, non-decreasing.
    x0, y_top
        (n,) upper left corner in metres.
    pixel_m
        (n,) 0.5 or 1.
    """

    owner: NDArray[np.int64]
    x0: NDArray[np.float64]
    y_top: NDArray[np.float64]
    pixel_m: NDArray[np.float64]

    @property
    def bounds(self) -> NDArray[np.float64]:
        """Return west, south, east, north of each window, (n, 4)."""
        side = WINDOW_PX * self.pixel_m
        return np.column_stack((self.x0, self.y_top - side, self.x0 + side, self.y_top))

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_] | slice) -> WindowPlaces:
        """Return some of the windows."""
        return WindowPlaces(self.owner[rows], self.x0[rows], self.y_top[rows], self.pixel_m[rows])


class Surroundings:
    """Shapes that windows may show, indexed; built once for a city or for a part of it.

    Parameters
    ----------
    shapes
        (m,) valid polygons in metres, missing and empty ones among them; they may touch and overlap.
    """

    def __init__(self, shapes: Shapes) -> None:
        self.rings: Rings = rings_of(shapes)
        self._tree = shapely.STRtree(shapes)

    def near(self, bounds: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return (n + 1,) offsets and the rows, in ascending order, of the shapes near each of (n, 4) bounds."""
        window, shape = self._tree.query(shapely.box(*bounds.T))
        order = np.lexsort((shape, window))
        offsets = np.searchsorted(window[order], np.arange(len(bounds) + 1))
        return offsets.astype(np.int64), shape[order].astype(np.int64)


def window_places(lots: Shapes) -> WindowPlaces:
    """Choose the windows of lots.

    A lot that fits 64 m gets one window at 0.5 m about its middle, one that fits 128 m one at 1 m, and a longer one
    windows of 128 m side by side where it fills some of them, evenly chosen where there would be too many.

    Parameters
    ----------
    lots
        (n,) polygons in metres; missing and empty ones get no window.
    """
    west, south, east, north = shapely.bounds(lots).T
    there = np.isfinite(west)
    longest = np.where(there, np.maximum(east - west, north - south), 0.0)
    sides = [WINDOW_PX * pixel for pixel in PIXELS_M]
    rows = np.flatnonzero(there & (longest <= sides[1]))
    pixel = np.where(longest[rows] <= sides[0], *PIXELS_M)
    half = WINDOW_PX * pixel / 2
    parts = [WindowPlaces(rows, (west + east)[rows] / 2 - half, (south + north)[rows] / 2 + half, pixel)]
    for row in np.flatnonzero(longest > sides[1]):
        x0, y_top = _pieces(lots[row], (west[row], south[row], east[row], north[row]), sides[1])
        parts.append(WindowPlaces(np.full(len(x0), row), x0, y_top, np.full(len(x0), PIXELS_M[1])))
    joined = WindowPlaces(*(np.concatenate([getattr(part, f.name) for part in parts]) for f in fields(WindowPlaces)))
    return joined.take(np.argsort(joined.owner, kind="stable"))


def _pieces(
    lot: shapely.Geometry, bounds: tuple[float, float, float, float], side: float
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return upper left corners of the windows of a long lot."""
    west, south, east, north = bounds
    cols, rows = (int(np.ceil(extent / side)) for extent in (east - west, north - south))
    x = (west + east) / 2 + (np.arange(cols) - cols / 2) * side
    y = (south + north) / 2 - (np.arange(rows) - rows / 2) * side
    shapely.prepare(lot)
    x0, y_top = (values.ravel() for values in np.meshgrid(x, y))
    cells = shapely.box(x0, y_top - side, x0 + side, y_top)
    meets = np.flatnonzero(shapely.intersects(lot, cells))
    filled = shapely.area(shapely.intersection(cells[meets], lot)) / side**2
    kept = meets[(filled >= LEAST_SHARE) | (filled == filled.max())]
    kept = kept[np.unique(np.linspace(0, len(kept) - 1, min(len(kept), PIECES_MAX)).round().astype(int))]
    return x0[kept], y_top[kept]


def lot_windows(
    lots: Shapes,
    vegetation: Surroundings,
    buildings: Surroundings,
    *,
    places: WindowPlaces | None = None,
    workers: int = 1,
) -> LotWindows:
    """Cut out the windows of lots.

    A window depends on its lot and what is near it alone. A window takes 80 KB: let a city go by in batches of
    thousands.

    Parameters
    ----------
    lots
        (n,) valid polygons in metres; missing and empty ones get no window.
    vegetation, buildings
        Ground under vegetation and footprints, in the same metres, also beyond the lots.
    places
        Windows to cut, if not `window_places`.
    workers
        Threads.
    """
    places = window_places(lots) if places is None else places
    count = len(places.owner)
    lot_rings = rings_of(lots)
    coverage, lot, ground, edge_dm = (np.zeros((count, WINDOW_PX, WINDOW_PX), np.uint8) for _ in range(4))

    def fill(start: int) -> None:
        part = slice(start, start + WINDOWS_A_CHUNK)
        some = places.take(part)
        where = np.column_stack((some.x0, some.y_top, some.pixel_m))
        fill_windows(
            some.owner, where, _plain(lot_rings), vegetation.near(some.bounds), _plain(vegetation.rings),
            buildings.near(some.bounds), _plain(buildings.rings), EDGE_MAX_M,
            coverage[part], lot[part], ground[part], edge_dm[part],
        )  # fmt: skip

    with ThreadPoolExecutor(workers) as pool:
        list(pool.map(fill, range(0, count, WINDOWS_A_CHUNK)))
    lot_area = np.nan_to_num(shapely.area(lots))
    ground_area = lot_area * _shares_free(places.owner, lot, ground, len(lots))
    return LotWindows(
        places.owner, places.pixel_m.astype(np.float32), coverage, lot, ground, edge_dm,
        lot_area[places.owner], ground_area[places.owner],
    )  # fmt: skip


def _plain(rings: Rings) -> tuple[NDArray[np.float64], NDArray[np.int64], NDArray[np.float64], NDArray[np.int64]]:
    return rings.xy, rings.ring_offsets, rings.signs, rings.shape_offsets


def _shares_free(
    owner: NDArray[np.int64], lot: NDArray[np.uint8], ground: NDArray[np.uint8], count: int
) -> NDArray[np.float64]:
    """Return the share of each lot that no building covers, of what its windows show."""
    whole, free = (
        np.bincount(owner, values.sum(axis=(1, 2), dtype=np.int64), minlength=count) for values in (lot, ground)
    )
    return np.asarray(free / np.maximum(whole, 1))
