"""Pairs brought to the model's resolution, and to sizes that a network takes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from fractions import Fraction
from typing import overload

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import UNKNOWN
from urbanforest_cli.imagery.pairs import ImagePair, PairSet
from urbanforest_cli.imagery.resampling import Taps, pixels_per_cell_of, resample_valid, taps

CHANNEL_MEAN = CHANNEL_SCALE = 127.5
"""Images from 0 to 255 are shown from -1 to 1, as to Pix2Pix."""
BYTES_KEPT = 4 << 30
LARGER_AT_MOST = 1.5

Bytes = NDArray[np.uint8]


@dataclass(frozen=True)
class Tile:
    """An image and its truth at the model's resolution.

    Parameters
    ----------
    name
        Of the pair it comes from.
    rgb
        (3, row, col); where the image holds nothing, what the network sees as 0.
    truth
        (class, row, col) percent, 255 where it is not known.
    """

    name: str
    rgb: Bytes
    truth: Bytes


@dataclass(frozen=True)
class TileLook:
    """What is known of a tile without its pixels.

    Parameters
    ----------
    group
        Of the pair.
    size
        Rows and columns.
    mean, deviation
        Of red, green and blue, of values from 0 to 1.
    known
        Whether the truth is known anywhere.
    """

    group: str
    size: tuple[int, int]
    mean: tuple[float, ...]
    deviation: tuple[float, ...]
    known: bool


class Tiles(Sequence[Tile]):
    """Some pairs as tiles: made when asked for, kept while they fit into some gigabytes.

    Parameters
    ----------
    pairs, indices
        All pairs, and which of them.
    resolution_m
        Of pixels that are shown as they are.
    enlarged
        How much larger images are shown than at that resolution.
    """

    def __init__(self, pairs: PairSet, indices: Sequence[int], resolution_m: float, enlarged: Fraction) -> None:
        self._pairs, self._indices = pairs, list(indices)
        self._resolution_m, self._enlarged = resolution_m, enlarged
        self._kept: dict[int, Tile] = {}
        self._bytes = 0

    def __len__(self) -> int:
        return len(self._indices)

    @overload
    def __getitem__(self, place: int) -> Tile: ...
    @overload
    def __getitem__(self, place: slice) -> Tiles: ...
    def __getitem__(self, place: int | slice) -> Tile | Tiles:
        """Return a tile, or some pairs of these."""
        if isinstance(place, slice):
            return self.subset(range(len(self))[place])
        index = self._indices[place]
        tile = self._kept.get(index)
        if tile is None:
            tile = tile_of(self._pairs[index], self._resolution_m, self._enlarged)
            if self._bytes + tile.rgb.nbytes + tile.truth.nbytes <= BYTES_KEPT:
                self._bytes += tile.rgb.nbytes + tile.truth.nbytes
                self._kept[index] = tile
        return tile

    def subset(self, places: Sequence[int]) -> Tiles:
        """Return some of these, by their places among them; what is kept is shared."""
        part = Tiles(self._pairs, [self._indices[place] for place in places], self._resolution_m, self._enlarged)
        part._kept = {index: self._kept[index] for index in part._indices if index in self._kept}
        part._bytes = sum(tile.rgb.nbytes + tile.truth.nbytes for tile in part._kept.values())
        return part

    def look(self, place: int) -> TileLook:
        """Look at a tile's pixels and say what they are like."""
        tile = self[place]
        values = tile.rgb.reshape(3, -1)
        mean, deviation = values.mean(axis=1) / 255.0, values.std(axis=1) / 255.0
        rows, cols = tile.rgb.shape[1:]
        return TileLook(
            self._pairs.groups[self._indices[place]], (rows, cols), tuple(mean.tolist()), tuple(deviation.tolist()),
            bool((tile.truth != UNKNOWN).any()),
        )  # fmt: skip


def tile_of(pair: ImagePair, resolution_m: float, enlarged: Fraction) -> Tile:
    """Bring a pair to a resolution, as `cover` does with images, and then enlarge it."""
    rows, cols = pair.valid.shape
    down, across = pixels_per_cell_of(pair.resolution_m, resolution_m)
    by_rows, by_cols = _taps(down / enlarged, rows), _taps(across / enlarged, cols)
    fill = np.uint8(CHANNEL_MEAN)
    known = (pair.truth != UNKNOWN) & pair.valid
    if by_rows is None and by_cols is None:
        return Tile(pair.name, np.where(pair.valid, pair.rgb, fill), np.where(known, pair.truth, np.uint8(UNKNOWN)))
    values, valid = resample_valid(pair.rgb.astype(np.float32), pair.valid, by_rows, by_cols)
    truth = []
    for band, there in zip(pair.truth, known, strict=True):
        percent, found = resample_valid(band[None].astype(np.float32), there, by_rows, by_cols)
        truth.append(np.where(found & valid, np.rint(percent[0]), UNKNOWN).astype(np.uint8))
    return Tile(pair.name, np.where(valid, np.rint(values), fill).astype(np.uint8), np.stack(truth))


def _taps(ratio: Fraction, size: int) -> Taps | None:
    return taps(ratio, range(math.ceil(size / ratio)), range(size), 0)


def crops_in(size: tuple[int, int], side: int) -> int:
    """Return how many crops have a tile's area, rounded; at least one."""
    return max(1, round(size[0] * size[1] / side**2))


def normalised(rgb: Bytes) -> NDArray[np.float32]:
    """Return an image as the network is fed in use: (value - mean) / scale."""
    return (rgb.astype(np.float32) - np.float32(CHANNEL_MEAN)) / np.float32(CHANNEL_SCALE)


def fitted(tile: Tile, multiple_px: int) -> Tile:
    """Return a tile whose sides are multiples: its middle, or where that would lose much, enlarged as for a crop."""
    sizes = tile.rgb.shape[1:]
    larger = [-(-size // multiple_px) * multiple_px for size in sizes]
    if larger == list(sizes):
        return tile
    if larger[0] * larger[1] <= LARGER_AT_MOST * sizes[0] * sizes[1] or min(sizes) < multiple_px:
        return _enlarged(tile, larger[0], larger[1])
    rows, cols = (size // multiple_px * multiple_px for size in sizes)
    top, left = (sizes[0] - rows) // 2, (sizes[1] - cols) // 2
    window = (slice(None), slice(top, top + rows), slice(left, left + cols))
    return Tile(tile.name, tile.rgb[window], tile.truth[window])


def at_least(tile: Tile, side: int) -> Tile:
    """Return a tile that a crop fits into: on all sides the image mirrored, the truth unknown there."""
    rows, cols = (max(size, side) for size in tile.rgb.shape[1:])
    return tile if (rows, cols) == tile.rgb.shape[1:] else _enlarged(tile, rows, cols)


def _enlarged(tile: Tile, rows: int, cols: int) -> Tile:
    high, wide = rows - tile.rgb.shape[1], cols - tile.rgb.shape[2]
    around = [(0, 0), (high // 2, high - high // 2), (wide // 2, wide - wide // 2)]
    return Tile(
        tile.name,
        np.pad(tile.rgb, around, mode="symmetric"),
        np.pad(tile.truth, around, constant_values=UNKNOWN),
    )
