"""The pixels of one window as the network's cells, and the network's answer as pixels."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.imagery.resampling import resample, resample_valid, taps
from urbanforest_cli.imagery.windows import Plane, Span, mirrored

PIECE_PX = 2048
"""Pixels along a side that are read at once."""


class ReadPixels(Protocol):
    """Reads a part of an image."""

    def __call__(self, rows: range, cols: range) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Return (3, row, col) 0-255 and (row, col) valid, of absolute pixels inside the image."""


@dataclass(frozen=True)
class WindowCells:
    """What was read for a window.

    Parameters
    ----------
    rows, cols
        The window.
    values
        (3, row, col) 0-255 of the cells `rows.cells`, `cols.cells`: uint8 where they are pixels, else float32.
    known
        (row, col) of the same: cells with a valid pixel.
    valid
        (row, col) of the pixels the window gives.
    """

    rows: Span
    cols: Span
    values: NDArray[Any]
    known: NDArray[np.bool_]
    valid: NDArray[np.bool_]


def gather(plane: Plane, rows: Span, cols: Span, read: ReadPixels) -> WindowCells:
    """Read a window and bring it to cells, piece by piece, so that fine pixels need no more memory than coarse ones."""
    if plane.rows.ratio == plane.cols.ratio == 1:
        values, known = read(rows.read, cols.read)
        valid = known[_within(rows.write, rows.read), _within(cols.write, cols.read)]
        return WindowCells(rows, cols, values, known, valid)
    cells = np.empty((3, len(rows.cells), len(cols.cells)), np.float32)
    found = np.empty(cells.shape[1:], bool)
    valid = np.zeros((len(rows.write), len(cols.write)), bool)
    for row_cells in plane.rows.pieces(rows.cells, PIECE_PX):
        row_pixels = plane.rows.read_for(row_cells)
        by_row = taps(plane.rows.ratio, row_cells, plane.rows.pixels, row_pixels.start)
        for col_cells in plane.cols.pieces(cols.cells, PIECE_PX):
            col_pixels = plane.cols.read_for(col_cells)
            by_col = taps(plane.cols.ratio, col_cells, plane.cols.pixels, col_pixels.start)
            rgb, there = read(row_pixels, col_pixels)
            at = _within(row_cells, rows.cells), _within(col_cells, cols.cells)
            cells[:, at[0], at[1]], found[at] = resample_valid(rgb.astype(np.float32), there, by_row, by_col)
            shared = _shared(rows.write, row_pixels), _shared(cols.write, col_pixels)
            valid[_within(shared[0], rows.write), _within(shared[1], cols.write)] = there[
                _within(shared[0], row_pixels), _within(shared[1], col_pixels)
            ]
    return WindowCells(rows, cols, cells, found, valid)


def tile_cells(
    plane: Plane, window: WindowCells, *, multiple_px: int, fill: tuple[float, float, float]
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Return what the network is given.

    Parameters
    ----------
    multiple_px
        What the network shrinks by.
    fill
        Red, green, blue where nothing is known far and wide.

    Returns
    -------
    cells, known
        (3, row, col) float32 of `tile`, beyond the image mirrored, and (row, col).
    """
    rows, cols = window.rows, window.cols
    row = mirrored(rows.tile, plane.rows.cells) - rows.cells.start
    col = mirrored(cols.tile, plane.cols.cells) - cols.cells.start
    cells = window.values[:, row][:, :, col].astype(np.float32, copy=False)
    known = window.known[row][:, col]
    return (cells if known.all() else fill_unknown(cells, known, multiple_px, fill)), known


def fill_unknown(
    cells: NDArray[np.float32], known: NDArray[np.bool_], multiple_px: int, fill: tuple[float, float, float]
) -> NDArray[np.float32]:
    """Give unknown cells the mean of the known ones in the smallest block of 2, 4, 8 ... cells that has any.

    Blocks are those the network itself pools, so a fill depends on no window. Left black, they would be read as dense
    vegetation.
    """
    sums, counts = np.where(known, cells, np.float32(0)), known.astype(np.float32)[None]
    filled, block = sums.copy(), 1
    row, col = np.nonzero(~known)
    while multiple_px % (2 * block) == 0 and row.size:
        block *= 2
        sums, counts = _pooled(sums), _pooled(counts)
        among = counts[0, row // block, col // block]
        helped = among > 0
        at = row[helped], col[helped]
        filled[:, at[0], at[1]] = sums[:, at[0] // block, at[1] // block] / among[helped]
        row, col = row[~helped], col[~helped]
    filled[:, row, col] = np.array(fill, np.float32)[:, None]
    return filled


def paint(
    plane: Plane, window: WindowCells, result: NDArray[np.float32], known: NDArray[np.bool_]
) -> NDArray[np.float32]:
    """Bring an answer, (class, row, col) of the tile's cells, to the pixels of its window; NaN where invalid."""
    rows, cols = window.rows, window.cols
    by_row, by_col = plane.rows.to_pixels(rows), plane.cols.to_pixels(cols)
    if by_row is None:
        core = _within(rows.write, rows.tile)
        result, known = result[:, core], known[core]
    if by_col is None:
        core = _within(cols.write, cols.tile)
        result, known = result[:, :, core], known[:, core]
    if known.all() or (by_row is None and by_col is None):
        result = resample(result, by_row, by_col)
    else:
        result, _ = resample_valid(result, known, by_row, by_col)
    return result if window.valid.all() else np.where(window.valid, result, np.float32(np.nan))


def _pooled(values: NDArray[np.float32]) -> NDArray[np.float32]:
    bands, rows, cols = values.shape
    return np.asarray(values.reshape(bands, rows // 2, 2, cols // 2, 2).sum(axis=(2, 4)), np.float32)


def _shared(first: range, second: range) -> range:
    start = max(first.start, second.start)
    return range(start, max(start, min(first.stop, second.stop)))


def _within(part: range, whole: range) -> slice:
    return slice(part.start - whole.start, part.stop - whole.start)
