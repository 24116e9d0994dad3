"""A model led over an image window by window: pixels are read in one thread, probabilities found in several."""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Generator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import UNKNOWN, CoverageModelInfo
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.imagery.inference import CoverageSession, core_cells, model_plane, predict_window
from urbanforest_cli.imagery.window_cells import WindowCells, gather
from urbanforest_cli.imagery.windows import Plane, first_pixel

WINDOW_MOST_PX = 4096
"""Pixels along a side that one window may give: of fine images it keeps fewer cells."""
FINE_CORE_CELLS = 128
"""What a window of a fine image keeps at least."""
FINEST, COARSEST = 64, 8
"""Pixels a cell, and cells a pixel, that are still resampled."""
COARSE = 1.5
"""Cells a pixel from which on a map is worth a warning."""


class Picture(Protocol):
    """An image that can be read by windows."""

    grid: RasterGrid

    def read(self, row: int, col: int, height_px: int, width_px: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return (3, row, col) 0-255 and (row, col) valid."""

    def has_pixels(self, rows: range, cols: range) -> bool:
        """Tell whether anything but nothing can be there."""


def map_windows(
    picture: Picture,
    wanted: tuple[range, range],
    session: CoverageSession,
    *,
    window_px: int | None,
    workers: int,
    progress: Progress,
    notices: Notices,
    where: object = None,
) -> Generator[tuple[int, int, NDArray[np.uint8]], None, None]:
    """Map a part of an image.

    Parameters
    ----------
    wanted
        Rows and columns of the image.
    window_px
        Pixels along a side of a window; chosen by itself by default.
    workers
        Threads that infer.
    where
        What messages call the image.

    Yields
    ------
    row, col, values
        Of each window with a valid pixel, in a fixed order: row and column in `wanted`, and (class, row, col)
        percentages, 255 where not valid.

    Raises
    ------
    InputError
        The image is too coarse or too fine for the model, or it is damaged.
    """
    info, grid, first = session.info, picture.grid, first_pixel(picture.grid)
    plane = model_plane(info, (grid.height_px, grid.width_px), first, grid.resolution_m)
    _check_resolution(plane, grid, info, notices, where)
    within = _moved(wanted[0], first[0]), _moved(wanted[1], first[1])
    windows = plane.windows(_core_cells(plane, window_px, info), within)

    def read(rows: range, cols: range) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        return picture.read(rows.start - first[0], cols.start - first[1], len(rows), len(cols))

    def percent_of(window: WindowCells) -> NDArray[np.uint8]:
        return percentages(predict_window(session, plane, window))

    waiting: deque[tuple[int, WindowCells, Future[NDArray[np.uint8]]]] = deque()

    def oldest() -> tuple[int, int, NDArray[np.uint8]]:
        number, window, future = waiting.popleft()
        values = future.result()
        progress("coverage", number, len(windows))
        return window.rows.write.start - within[0].start, window.cols.write.start - within[1].start, values

    progress("coverage", 0, len(windows))
    with ThreadPoolExecutor(workers) as pool:
        try:
            for number, (rows, cols) in enumerate(windows):
                if not picture.has_pixels(_moved(rows.write, -first[0]), _moved(cols.write, -first[1])):
                    continue
                window = gather(plane, rows, cols, read)
                if not window.valid.any():
                    continue
                waiting.append((number, window, pool.submit(percent_of, window)))
                while len(waiting) > workers + 1 or (waiting and waiting[0][2].done()):
                    yield oldest()
            while waiting:
                yield oldest()
        finally:
            pool.shutdown(wait=True, cancel_futures=True)
    progress("coverage", len(windows), len(windows))


def percentages(probability: NDArray[np.float32]) -> NDArray[np.uint8]:
    """Round probabilities to whole percentages, 255 where they are NaN."""
    known = ~np.isnan(probability)
    return np.where(known, np.rint(np.where(known, probability, 0) * 100), UNKNOWN).astype(np.uint8)


def _core_cells(plane: Plane, window_px: int | None, info: CoverageModelInfo) -> int:
    """Return the cells along a side that a window keeps."""
    finest = max(plane.rows.ratio, plane.cols.ratio)
    if window_px is not None:
        return max(math.floor(window_px / finest), info.multiple_px)
    return max(min(core_cells(info), math.floor(WINDOW_MOST_PX / finest)), FINE_CORE_CELLS)


def _check_resolution(plane: Plane, grid: RasterGrid, info: CoverageModelInfo, notices: Notices, where: object) -> None:
    ratios = (plane.cols.ratio, plane.rows.ratio)
    found = f"pixels of {grid.resolution_m[0]:.3g} x {grid.resolution_m[1]:.3g} m"
    if min(ratios) * COARSEST < 1:
        raise InputError(
            "the image is too coarse to tell trees in", where=where, found=found,
            expected=f"at most {COARSEST * info.resolution_m:g} m; the model was trained at {info.resolution_m:g} m",
            next_step="use an image of higher resolution",
        )  # fmt: skip
    if max(ratios) > FINEST:
        raise InputError(
            "the image is too fine", where=where, found=found,
            expected=f"at least {info.resolution_m / FINEST:.2g} m",
            next_step="average it first: gdal_translate -r average -outsize 50% 50% IN OUT.tif",
        )  # fmt: skip
    if min(ratios) * COARSE <= 1:
        notices.add("W_COARSE", f"images coarser than the {info.resolution_m:g} m the model was trained at", 1, [found])


def _moved(part: range, by: int) -> range:
    return range(part.start + by, part.stop + by)
