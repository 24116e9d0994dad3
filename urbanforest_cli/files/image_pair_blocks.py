"""The images of a folder of pairs: what they are, where they lie, and how large ones are cut into blocks."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.crs import reproject_xy
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.image_pair_layout import PairFiles
from urbanforest_cli.files.images import open_image

BLOCK_PX = 512
UNPLACED_RESOLUTION_M = 0.6
"""Taken for the pixels of images that lie nowhere: what most aerial surveys of whole countries have."""
DEGREES = "OGC:CRS84"


@dataclass(frozen=True)
class ImageOptions:
    """How images are opened and cut: as `files.images.open_image` takes it, and more.

    Parameters
    ----------
    resolution_m
        Of images without a place on the map.
    side_by_side
        Whether each file holds the image in its left half and the truth in its right.
    """

    bands: tuple[int, ...] | None = None
    stretch: tuple[float, float] | None = None
    assume_crs: str | None = None
    resolution_m: float | None = None
    side_by_side: bool = False


@dataclass(frozen=True)
class Image:
    """An image file that was opened once; `grid` is None where it lies nowhere."""

    files: PairFiles
    width_px: int
    height_px: int
    grid: RasterGrid | None
    resolution_m: tuple[float, float]
    has_nir: bool


@dataclass(frozen=True)
class Block:
    """A part of an image, small enough to be learnt from at once."""

    name: str
    image: Image
    row: int
    col: int
    height_px: int
    width_px: int

    @property
    def window(self) -> tuple[int, int, int, int]:
        """Return first row and column, rows and columns."""
        return self.row, self.col, self.height_px, self.width_px


@dataclass(frozen=True)
class Pixels:
    """What a block holds: rgb (3, row, col), valid (row, col), nir (row, col) where it was asked for."""

    rgb: NDArray[np.uint8]
    valid: NDArray[np.bool_]
    nir: NDArray[np.uint8] | None

    @property
    def nbytes(self) -> int:
        """Return what it takes in memory."""
        return self.rgb.nbytes + self.valid.nbytes + (0 if self.nir is None else self.nir.nbytes)


def look_at(files: PairFiles, options: ImageOptions, notices: Notices) -> Image:
    """Open an image for its size, place and bands.

    Raises
    ------
    InputError
        The file cannot be used.
    """
    placed = not options.side_by_side and _has_place(files, options)
    with open_image(
        files.image, bands=options.bands, assume_crs=options.assume_crs, stretch=options.stretch,
        georeferenced=placed, notices=notices,
    ) as reader:  # fmt: skip
        width_px = reader.width_px
        if options.side_by_side:
            if width_px % 2:
                raise InputError("cannot be halved into image and truth", where=files.image,
                                 found=f"{width_px} columns", expected="an even number")  # fmt: skip
            width_px //= 2
        if reader.grid is None:
            side_m = options.resolution_m or UNPLACED_RESOLUTION_M
            resolution_m = (side_m, side_m)
            notices.add("W_RESOLUTION_ASSUMED", f"images without a place on the map, read as of {side_m:g} m a pixel",
                        1, [files.name])  # fmt: skip
        else:
            resolution_m = reader.grid.resolution_m
        return Image(files, width_px, reader.height_px, reader.grid, resolution_m, reader.traits.nir is not None)


def _has_place(files: PairFiles, options: ImageOptions) -> bool:
    with open_image(
        files.image, assume_crs=options.assume_crs, stretch=(0.0, 1.0), georeferenced=False, notices=Notices()
    ) as reader:
        return reader.grid is not None


def blocks_of(image: Image) -> list[Block]:
    """Cut an image into parts of 512 px at most, all about as large; a small one is left whole and keeps its name."""
    rows, cols = _edges(image.height_px), _edges(image.width_px)
    whole = len(rows) == len(cols) == 2
    return [
        Block(
            image.files.name if whole else f"{image.files.name}_r{top}c{left}",
            image, top, left, bottom - top, right - left,
        )
        for top, bottom in pairwise(rows)
        for left, right in pairwise(cols)
    ]  # fmt: skip


def _edges(side_px: int) -> list[int]:
    parts = -(-side_px // BLOCK_PX)
    return [number * side_px // parts for number in range(parts + 1)]


def footprint(block: Block) -> shapely.Polygon | None:
    """Return a block's outline in longitude and latitude; None where it lies nowhere."""
    if block.image.grid is None:
        return None
    grid = block.image.grid.window(*block.window)
    west, south, east, north = grid.bounds
    corners = np.array([(west, south), (east, south), (east, north), (west, north)])
    return shapely.Polygon(reproject_xy(corners, grid.crs, CRS.from_user_input(DEGREES)))


def read_block(block: Block, options: ImageOptions, *, nir: bool) -> Pixels:
    """Read a block's pixels.

    Raises
    ------
    InputError
        The file changed since it was looked at, is damaged, or has no near infrared.
    """
    image = block.image
    with open_image(
        image.files.image, bands=options.bands, assume_crs=options.assume_crs, stretch=options.stretch,
        georeferenced=image.grid is not None, notices=Notices(),
    ) as reader:  # fmt: skip
        rgb, valid = reader.read(*block.window)
        return Pixels(rgb, valid, reader.read_nir(*block.window) if nir else None)
