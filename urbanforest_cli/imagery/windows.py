"""How an image is cut into windows such that nobody can tell from the result.

The network's cells are counted from the origin of the map. Tiles begin at multiples of what the network shrinks by,
so its pooling falls on the same ground wherever a window begins; around each core lies a halo as wide as the network
sees. Beyond the image, cells are mirrored. A result is then the same for every way of cutting.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import dataclass
from fractions import Fraction

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.imagery.resampling import Taps, pixels_per_cell_of, taps

SNAP = 0.3719
"""Where between two whole numbers an origin is rounded up: at no likely fraction, so that noise decides nothing."""


@dataclass(frozen=True)
class Span:
    """One window along one axis; pixels and cells are counted absolutely.

    Parameters
    ----------
    write
        Pixels whose result this window gives.
    read
        Pixels it needs.
    cells
        Cells made from them.
    tile
        Cells the network is given, beyond the image too; a multiple of its step.
    """

    write: range
    read: range
    cells: range
    tile: range


@dataclass(frozen=True)
class Axis:
    """Rows or columns of an image, and the cells on them.

    Parameters
    ----------
    first_px, length_px
        Absolute index of the first pixel, and how many there are.
    ratio
        Pixels a cell.
    step
        The network's tiles begin and end at multiples of it, in cells.
    halo
        Cells around what is kept, a multiple of `step`.
    """

    first_px: int
    length_px: int
    ratio: Fraction
    step: int
    halo: int

    @property
    def pixels(self) -> range:
        """All pixels."""
        return range(self.first_px, self.first_px + self.length_px)

    @property
    def cells(self) -> range:
        """All cells that a pixel lies in, if only in part."""
        return range(
            math.floor(self.pixels.start / self.ratio),
            math.ceil(self.pixels.stop / self.ratio),
        )

    def spans(self, core: int, within: range | None = None) -> list[Span]:
        """Cut the axis.

        Parameters
        ----------
        core
            Cells a window keeps; rounded up to whole steps, and cut to what the image needs. All tiles are equally
            long, since a runtime keeps memory for every shape it has met.
        within
            Pixels that are wanted, all by default; what is around them is read as far as it has a say.
        """
        wanted = self.pixels if within is None else within
        cells = range(math.floor(wanted.start / self.ratio), math.ceil(wanted.stop / self.ratio))
        start = cells.start // self.step * self.step
        core = min(_up(core, self.step), _up(cells.stop - start, self.step))
        spans = (self._span(range(low, low + core), wanted) for low in range(start, cells.stop, core))
        return [span for span in spans if span.write]

    def _span(self, core: range, wanted: range) -> Span:
        # A pixel belongs to the core that its centre lies in.
        low = max(math.ceil(core.start * self.ratio - Fraction(1, 2)), wanted.start)
        high = min(math.ceil(core.stop * self.ratio - Fraction(1, 2)), wanted.stop)
        tile = range(core.start - self.halo, core.stop + self.halo)
        inside = mirrored(tile, self.cells)
        used = range(int(inside.min()), int(inside.max()) + 1)
        return Span(range(low, max(high, low)), self.read_for(used), used, tile)

    def read_for(self, cells: range) -> range:
        """Return the pixels that cells are made from."""
        beyond = 1 if self.ratio < 1 else 0  # a cell within a pixel leans on the next one too
        return range(
            max(math.floor(cells.start * self.ratio) - beyond, self.pixels.start),
            min(math.ceil(cells.stop * self.ratio) + beyond, self.pixels.stop),
        )

    def pieces(self, cells: range, length_px: int) -> Iterator[range]:
        """Cut cells so that each piece is made from about so many pixels."""
        step = max(math.floor(length_px / self.ratio), 1)
        for start in range(cells.start, cells.stop, step):
            yield range(start, min(start + step, cells.stop))

    def to_pixels(self, span: Span) -> Taps | None:
        """Return how the pixels of a window come from its tile."""
        return taps(1 / self.ratio, span.write, self.cells, span.tile.start)


@dataclass(frozen=True)
class Plane:
    """An image under the network's cells."""

    rows: Axis
    cols: Axis

    def windows(self, core: int, within: tuple[range, range] | None = None) -> list[tuple[Span, Span]]:
        """Return the windows row by row, of all pixels or of some rows and columns."""
        rows, cols = within or (None, None)
        across = self.cols.spans(core, cols)
        return [(row, col) for row in self.rows.spans(core, rows) for col in across]


def plane_of(
    size_px: tuple[int, int],
    first_px: tuple[int, int],
    resolution_m: tuple[float, float],
    *,
    cell_m: float,
    multiple_px: int,
    halo_px: int,
) -> Plane:
    """Lay the cells of a network over an image.

    Parameters
    ----------
    size_px, first_px
        Rows and columns, and the absolute index of the first row and column.
    resolution_m
        Width and height of a pixel on the ground.
    cell_m, multiple_px, halo_px
        What the network was made for, must be given multiples of, and sees around a block of so many.
    """

    def axis(first: int, length: int, ratio: Fraction) -> Axis:
        # A pixel at the edge of a core leans on cells beyond it, which need their own surroundings.
        beyond = 0 if ratio == 1 else math.ceil(1 / (2 * ratio)) + 1
        return Axis(first, length, ratio, multiple_px, _up(halo_px, multiple_px) + _up(beyond, multiple_px))

    by_row, by_col = pixels_per_cell_of(resolution_m, cell_m)
    return Plane(axis(first_px[0], size_px[0], by_row), axis(first_px[1], size_px[1], by_col))


def first_pixel(grid: RasterGrid) -> tuple[int, int]:
    """Return the absolute row and column of a raster's first pixel, counted from the map's origin southward and east.

    A part cut out of a raster thereby knows which of its pixels are which.
    """
    a, _, c, _, e, f = grid.transform
    return math.floor(f / e + SNAP), math.floor(c / a + SNAP)


def mirrored(wanted: range, there: range) -> NDArray[np.int64]:
    """Return for each wanted index one that is there: mirrored at the outermost, as often as it takes."""
    index = np.arange(wanted.start, wanted.stop) - there.start
    last = len(there) - 1
    if last == 0:
        return np.full(len(wanted), there.start)
    folded = np.abs(index) % (2 * last)
    return np.asarray(np.minimum(folded, 2 * last - folded) + there.start, np.int64)


def _up(value: int, step: int) -> int:
    return max(-(-value // step), 0) * step
