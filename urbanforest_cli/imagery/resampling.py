"""From an image's pixels to a model's cells and back, by whole-number ratios in absolute coordinates.

A cell is what the network takes for a pixel. So many pixels are so many cells (3 pixels are 2 cells, say), counted
from one origin for all images of a grid. A value then depends on where on the ground it lies, and on no window.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

WHOLE_TOLERANCE = 0.10
"""How far a whole ratio may be from the true one: a network sees no difference in scale of this size."""
BROKEN_TOLERANCE = 0.05
"""The same for a ratio of two whole numbers."""
SQUARE = 1.05
"""Up to this ratio of its sides a pixel is taken for square, so that both axes are brought to cells alike."""


@dataclass(frozen=True)
class Taps:
    """For each target the sources that make it.

    Parameters
    ----------
    index
        (target, tap) int64: sources, within those given.
    weight
        (target, tap) float32, sum 1 a target.
    """

    index: NDArray[np.int64]
    weight: NDArray[np.float32]


def pixels_per_cell(pixel_m: float, cell_m: float) -> Fraction:
    """Return the simplest ratio near `cell_m / pixel_m`: 1 where the pixels can be taken as they are."""
    if pixel_m > cell_m:
        return 1 / pixels_per_cell(cell_m, pixel_m)
    true = cell_m / pixel_m
    for cells in (1, 2, 3, 4, 5, 6, 7, 8, 9, 10):
        pixels = round(true * cells)
        if abs(pixels / cells / true - 1) <= (WHOLE_TOLERANCE if cells == 1 else BROKEN_TOLERANCE):
            return Fraction(pixels, cells)
    raise AssertionError(f"no ratio near {true}")


def pixels_per_cell_of(resolution_m: tuple[float, float], cell_m: float) -> tuple[Fraction, Fraction]:
    """Return the ratios along rows' and columns' axes, height first, for pixels of some width and height."""
    width_m, height_m = resolution_m
    if max(width_m, height_m) <= SQUARE * min(width_m, height_m):
        width_m = height_m = math.sqrt(width_m * height_m)
    return pixels_per_cell(height_m, cell_m), pixels_per_cell(width_m, cell_m)


def average_taps(ratio: Fraction, targets: range, sources: range, offset: int) -> Taps:
    """Average the sources under each target by the length they share.

    Parameters
    ----------
    ratio
        Sources a target, at least 1.
    targets
        Absolute indices of the targets.
    sources
        Absolute indices of the sources that exist; each target touches one at least.
    offset
        Absolute index of the first source given.
    """
    p, q = ratio.numerator, ratio.denominator
    target = np.arange(targets.start, targets.stop)[:, None]
    source = np.maximum(target * p // q, sources.start) + np.arange(-(-p // q) + 1)[None, :]
    low = np.maximum(np.maximum(source * q, target * p), sources.start * q)
    high = np.minimum(np.minimum((source + 1) * q, (target + 1) * p), sources.stop * q)
    shared = np.maximum(high - low, 0)
    used = shared.any(axis=0)
    shared, source = shared[:, used], source[:, used]
    index = np.clip(source, sources.start, sources.stop - 1) - offset
    return Taps(index, (shared / shared.sum(axis=1, keepdims=True)).astype(np.float32))


def linear_taps(ratio: Fraction, targets: range, sources: range, offset: int) -> Taps:
    """Interpolate between the centres of the two nearest sources; beyond the outermost, that one holds.

    Parameters are those of `average_taps`, with a ratio below 1.
    """
    p, q = ratio.numerator, ratio.denominator
    place = (2 * np.arange(targets.start, targets.stop) + 1) * p - q  # in 1 / 2q sources
    first = place // (2 * q)
    share = ((place - first * 2 * q) / (2 * q)).astype(np.float32)
    index = np.clip(np.stack([first, first + 1], axis=1), sources.start, sources.stop - 1) - offset
    return Taps(index, np.stack([1 - share, share], axis=1))


def taps(ratio: Fraction, targets: range, sources: range, offset: int) -> Taps | None:
    """Return how targets come from sources: None where they are the same."""
    if ratio == 1:
        return None
    return (average_taps if ratio > 1 else linear_taps)(ratio, targets, sources, offset)


def resample(values: NDArray[np.float32], rows: Taps | None, cols: Taps | None) -> NDArray[np.float32]:
    """Bring (..., row, col) to the targets of both axes."""
    return _along_cols(_along_rows(values, rows), cols)


def resample_valid(
    values: NDArray[np.float32], valid: NDArray[np.bool_], rows: Taps | None, cols: Taps | None
) -> tuple[NDArray[np.float32], NDArray[np.bool_]]:
    """Bring (band, row, col) to the targets of both axes, leaving out what is not valid.

    Returns
    -------
    values, valid
        Values are 0 where no valid source has a part in the target.
    """
    if rows is None and cols is None:
        return np.where(valid, values, np.float32(0)), valid
    if valid.all():
        values = resample(values, rows, cols)
        return values, np.ones(values.shape[-2:], bool)
    weight = resample(valid.astype(np.float32), rows, cols)
    summed = resample(np.where(valid, values, np.float32(0)), rows, cols)
    found = weight > 0
    return np.divide(summed, weight, out=np.zeros_like(summed), where=np.broadcast_to(found, summed.shape)), found


def _along_rows(values: NDArray[np.float32], by: Taps | None) -> NDArray[np.float32]:
    if by is None:
        return values
    total = values[..., by.index[:, 0], :] * by.weight[:, 0, None]
    for tap in range(1, by.index.shape[1]):
        total += values[..., by.index[:, tap], :] * by.weight[:, tap, None]
    return total


def _along_cols(values: NDArray[np.float32], by: Taps | None) -> NDArray[np.float32]:
    if by is None:
        return values
    total = values[..., by.index[:, 0]] * by.weight[:, 0]
    for tap in range(1, by.index.shape[1]):
        total += values[..., by.index[:, tap]] * by.weight[:, tap]
    return total
