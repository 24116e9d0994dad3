"""A map at a glance: how much is covered, and image and map shrunk to the size of a picture."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, field
from typing import Any, Protocol

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import UNKNOWN
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.imagery.mapping import Picture
from urbanforest_cli.imagery.preview import panel_size

STRIP_PX = 8 << 20
"""Pixels looked at at once."""


class Map(Protocol):
    """A coverage map that can be read by windows."""

    @property
    def grid(self) -> RasterGrid:
        """Where its pixels lie."""

    @property
    def classes(self) -> tuple[str, ...]:
        """What is mapped."""

    def read(self, row: int, col: int, height_px: int, width_px: int) -> NDArray[np.uint8]:
        """Return (class, row, col) percentages, 255 where unknown."""


@dataclass
class Tally:
    """How much of a map is covered."""

    classes: tuple[str, ...]
    known_px: int = 0
    percent: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        self.percent = np.zeros(len(self.classes), np.int64)

    def add(self, values: NDArray[np.uint8]) -> None:
        """Count (class, row, col) percentages."""
        known = values[0] != UNKNOWN
        self.known_px += int(known.sum())
        self.percent += np.where(known, values, 0).sum(axis=(1, 2), dtype=np.int64)

    def share(self, name: str) -> float:
        """Return the covered fraction of the known ground; 0 where nothing is known."""
        return float(self.percent[self.classes.index(name)]) / (100.0 * self.known_px) if self.known_px else 0.0


def tally_of(coverage: Map) -> Tally:
    """Add up a map."""
    tally = Tally(coverage.classes)
    for rows in _strips(coverage.grid, 1):
        tally.add(coverage.read(rows.start, 0, len(rows), coverage.grid.width_px))
    return tally


def _strips(grid: RasterGrid, multiple: int) -> Iterator[range]:
    """Yield rows a few megapixels at a time, so many that `multiple` divides them."""
    rows = max(STRIP_PX // grid.width_px // multiple, 1) * multiple
    for start in range(0, grid.height_px, rows):
        yield range(start, min(start + rows, grid.height_px))


def shrunk(picture: Picture, corner: tuple[int, int], coverage: Map) -> tuple[NDArray[np.uint8], NDArray[np.uint8]]:
    """Average an image and its map down to a picture's panel, strip by strip.

    Parameters
    ----------
    corner
        Row and column of the image where the map begins.

    Returns
    -------
    rgb, coverage
        (3, row, col) 0-255, and (class, row, col) percentages, 255 where unknown.
    """
    grid = coverage.grid
    panel = panel_size(*ground_m(grid), grid.width_px, grid.height_px)
    by = max(grid.height_px // panel[1], 1), max(grid.width_px // panel[0], 1)
    colours, covers = [], []
    for rows in _strips(grid, by[0]):
        rgb, valid = picture.read(corner[0] + rows.start, corner[1], len(rows), grid.width_px)
        colours.append(_averaged(rgb, np.broadcast_to(valid, rgb.shape), by, 0))
        values = coverage.read(rows.start, 0, len(rows), grid.width_px)
        covers.append(_averaged(values, values != UNKNOWN, by, UNKNOWN))
    return np.concatenate(colours, axis=1), np.concatenate(covers, axis=1)


def ground_m(grid: RasterGrid) -> tuple[float, float]:
    """Return the width and height of the ground under a raster, in metres at its centre."""
    wide, high = grid.resolution_m
    return wide * grid.width_px, high * grid.height_px


def _averaged(
    values: NDArray[np.uint8], known: NDArray[np.bool_], by: tuple[int, int], unknown: int
) -> NDArray[np.uint8]:
    """Average (band, row, col) over blocks, of which the last may be smaller."""
    starts = np.arange(0, values.shape[1], by[0]), np.arange(0, values.shape[2], by[1])

    def added(part: NDArray[Any]) -> NDArray[np.int64]:
        by_row = np.add.reduceat(part, starts[0], axis=1, dtype=np.int64)
        return np.asarray(np.add.reduceat(by_row, starts[1], axis=2), np.int64)

    counts = added(known)
    sums = added(np.where(known, values, 0))
    return np.where(counts > 0, np.rint(sums / np.maximum(counts, 1)), unknown).astype(np.uint8)
