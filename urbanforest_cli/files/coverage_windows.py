"""A coverage map of any resolution, shift and CRS, read by windows of square cells in metres."""

from __future__ import annotations

import math
import threading
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Self

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.coverage_model import UNKNOWN
from urbanforest_cli.core.crs import transformer
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.coverage import CoverageReader, open_coverage
from urbanforest_cli.files.coverage_kernel import brought_to_cells

FINEST_M, COARSEST_M = 0.25, 1.0
"""Cells of a map whose own pixels are smaller, or larger."""
NODE_CELLS = 32
"""Every so many cells a corner is brought to the map's CRS; between them it is straight to a hundredth of a pixel."""
SOURCE_LIMIT_PX = 1 << 26
EDGE_POINTS = 21
THRESHOLD_PERCENT = 50.0


class MetricCoverage:
    """An open map, in a working CRS in metres. Used as a context manager.

    Cells are whole multiples of their size, counted from the origin of the working CRS, and a cell's value depends
    on the cell alone: the same whatever window it is read with.

    Parameters
    ----------
    path
        Of the map: of this program or of another.
    working
        CRS in metres.
    band
        Class that is read.
    threshold_percent
        From which a cell counts as covered; what the map says itself if None, else 50.
    resolution_m
        Side of a cell; that of the map's own pixels if None, from 0.25 to 1 m.
    assume_crs
        CRS of a map that states none.

    Attributes
    ----------
    resolution_m, threshold_percent
        Those in force.
    bounds_m
        West, south, east, north of the map.

    Raises
    ------
    InputError
        On entering: no map, one without a place, or without the band. On reading: it is damaged.
    """

    resolution_m: float
    threshold_percent: float
    bounds_m: tuple[float, float, float, float]

    def __init__(
        self,
        path: Path,
        *,
        working: CRS,
        band: str,
        threshold_percent: float | None = None,
        resolution_m: float | None = None,
        assume_crs: str | None = None,
        notices: Notices,
    ) -> None:
        self.path = path
        self.working = working
        self._band = band
        self._asked = threshold_percent, resolution_m
        self._assume_crs = assume_crs
        self._notices = notices
        self._lock = threading.Lock()  # a raster file is read by one thread at a time

    def __enter__(self) -> Self:
        with ExitStack() as stack:
            reader = stack.enter_context(open_coverage(self.path, assume_crs=self._assume_crs, notices=self._notices))
            self._layer = _layer_of(reader, self._band)
            self._reader = reader
            self._same_crs = reader.grid.crs == self.working
            self._to_map = transformer(self.working.to_wkt(), reader.grid.crs.to_wkt())
            threshold, resolution = self._asked
            stated = (reader.provenance or {}).get("threshold_percent")
            if threshold is None:
                threshold = float(stated) if isinstance(stated, int | float) and 0 < stated <= 100 else None
            self.threshold_percent = THRESHOLD_PERCENT if threshold is None else threshold
            self.resolution_m = _own_resolution_m(reader, self._same_crs) if resolution is None else resolution
            self.bounds_m = self._bounds()
            self._stack = stack.pop_all()
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stack.close()

    def read(
        self, west: float, south: float, east: float, north: float
    ) -> tuple[NDArray[np.uint8], tuple[float, float]]:
        """Return the cells that a box touches.

        Returns
        -------
        (h, w) uint8 percentages, row 0 in the north, 255 where unknown, and the west and the north edge of the first.

        Raises
        ------
        InputError
            The file is damaged.
        """
        size = self.resolution_m
        col, row = math.floor(west / size), math.floor(-north / size)
        width, height = max(math.ceil(east / size) - col, 1), max(math.ceil(-south / size) - row, 1)
        cells = np.full((height, width), UNKNOWN, dtype=np.uint8)
        self._fill(cells, row, col)
        return cells, (col * size, -row * size)

    def _fill(self, cells: NDArray[np.uint8], row: int, col: int) -> None:
        """Fill cells whose first is at a row and column counted from the CRS's origin."""
        height, width = cells.shape
        first_row, first_col = row // NODE_CELLS, col // NODE_CELLS
        last_row, last_col = (row + height) // NODE_CELLS + 1, (col + width) // NODE_CELLS + 1
        nodes = self._nodes(first_row, last_row, first_col, last_col)
        window = self._window(nodes)
        if window is None:
            return
        top, left, rows, cols = window
        if rows * cols > SOURCE_LIMIT_PX and height * width > 1:
            if height >= width:
                self._fill(cells[: height // 2], row, col)
                self._fill(cells[height // 2 :], row + height // 2, col)
            else:
                self._fill(cells[:, : width // 2], row, col)
                self._fill(cells[:, width // 2 :], row, col + width // 2)
            return
        with self._lock:
            pixels = self._reader.read(top, left, rows, cols)[self._layer]
        offsets = row - first_row * NODE_CELLS, col - first_col * NODE_CELLS
        brought_to_cells(np.ascontiguousarray(pixels), top, left, nodes, NODE_CELLS, *offsets, cells)

    def _nodes(self, first_row: int, last_row: int, first_col: int, last_col: int) -> NDArray[np.float64]:
        """Return (n, m, 2) rows and columns of the map under the corners of blocks of cells."""
        step = NODE_CELLS * self.resolution_m
        x, y = np.meshgrid(np.arange(first_col, last_col + 1) * step, np.arange(first_row, last_row + 1) * -step)
        if not self._same_crs:
            x, y = self._to_map.transform(x, y)
        a, _, west, _, e, north = self._reader.grid.transform
        return np.stack(((y - north) / e, (x - west) / a), axis=-1)

    def _window(self, nodes: NDArray[np.float64]) -> tuple[int, int, int, int] | None:
        """Return first row and column, rows and columns of the map's pixels under some nodes; None for none."""
        grid = self._reader.grid
        places = nodes[np.isfinite(nodes).all(axis=-1)]
        if not len(places):
            return None
        steps = np.concatenate([np.abs(np.diff(nodes, axis=axis)).ravel() for axis in (0, 1)])
        reach = steps[np.isfinite(steps)].max(initial=0.0) / NODE_CELLS + 2.0
        low, high = np.floor(places.min(axis=0) - reach), np.ceil(places.max(axis=0) + reach)
        first = np.clip(low, 0, None)
        last = np.minimum(high, (grid.height_px, grid.width_px))
        if (last <= first).any():
            return None
        return int(first[0]), int(first[1]), int(last[0] - first[0]), int(last[1] - first[1])

    def _bounds(self) -> tuple[float, float, float, float]:
        grid = self._reader.grid
        if self._same_crs:
            return grid.bounds
        back = transformer(grid.crs.to_wkt(), self.working.to_wkt())
        west, south, east, north = back.transform_bounds(*grid.bounds, densify_pts=EDGE_POINTS)
        return west, south, east, north


def _layer_of(reader: CoverageReader, band: str) -> int:
    if band not in reader.classes:
        raise InputError(
            f"the map has no band {band!r}", where=reader.path, found=", ".join(reader.classes),
            next_step=f"set coverage.band to {reader.classes[0]!r}",
        )  # fmt: skip
    return reader.classes.index(band)


def _own_resolution_m(reader: CoverageReader, same_crs: bool) -> float:
    wide, high = reader.grid.pixel_size if same_crs else reader.grid.resolution_m
    own = math.sqrt(wide * high)
    return float(np.clip(own if same_crs else round(own, 3), FINEST_M, COARSEST_M))
