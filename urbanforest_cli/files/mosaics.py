"""Several images as one: where each lies on a common grid, and whose pixel counts where they overlap."""

from __future__ import annotations

from collections import OrderedDict
from collections.abc import Iterator, Sequence
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import rasterio
from numpy.typing import NDArray

from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.coverage import is_coverage
from urbanforest_cli.files.image_bands import ImageTraits
from urbanforest_cli.files.image_checks import PIXELS_MOST, SIDE_MOST_PX
from urbanforest_cli.files.images import ImageReader, open_image

SUFFIXES = (".tif", ".tiff", ".png", ".jpg", ".jpeg", ".jp2", ".j2k")
"""Names of a folder's files that are taken for images."""
OPEN_MOST = 64
"""Images held open at once."""
AS_THEY_ARE = (0.0, 255.0)
SHIFT_TOLD_PX = 0.05
DRIFT_MOST_PX = 0.5
"""How far the pixels of an image may come away from those of the first along its whole length."""
Range = tuple[float, float]
NEXT_STEP = "bring all to one grid first: gdalwarp -t_srs EPSG:... -tr WIDTH HEIGHT -tap IN OUT.tif"


@dataclass(frozen=True)
class Mosaic:
    """Images on a common grid.

    Parameters
    ----------
    grid
        It covers all of them.
    places
        Row and column of each image's first pixel.
    sizes
        Rows and columns of each.
    shift_px
        How far each was moved to fall on the grid's pixels, at most half a pixel along either axis.
    """

    grid: RasterGrid
    places: tuple[tuple[int, int], ...]
    sizes: tuple[tuple[int, int], ...]
    shift_px: tuple[float, ...]

    def touched(self, rows: range, cols: range) -> list[tuple[int, range, range]]:
        """Return which images have pixels in a part, in order, with the rows and columns they share with it."""
        found = []
        for index, ((row, col), (height, width)) in enumerate(zip(self.places, self.sizes, strict=True)):
            shared_rows = range(max(rows.start, row), min(rows.stop, row + height))
            shared_cols = range(max(cols.start, col), min(cols.stop, col + width))
            if shared_rows and shared_cols:
                found.append((index, shared_rows, shared_cols))
        return found


def lay_out(grids: Sequence[RasterGrid], names: Sequence[str]) -> Mosaic:
    """Lay images side by side.

    Parameters
    ----------
    grids
        At least one; the first gives the pixels.
    names
        For messages.

    Raises
    ------
    InputError
        An image is in another CRS, or of another resolution, than the first.
    """
    first, (a, _, c, _, e, f) = grids[0], grids[0].transform
    places, shifts = [], []
    for grid, name in zip(grids, names, strict=True):
        _check_alike(first, names[0], grid, name)
        col, row = (grid.transform[2] - c) / a, (grid.transform[5] - f) / e
        places.append((round(row), round(col)))
        shifts.append(max(abs(row - round(row)), abs(col - round(col))))
    top, left = min(row for row, _ in places), min(col for _, col in places)
    sizes = tuple((grid.height_px, grid.width_px) for grid in grids)
    bottom = max(row + height for (row, _), (height, _) in zip(places, sizes, strict=True))
    right = max(col + width for (_, col), (_, width) in zip(places, sizes, strict=True))
    whole = first.window(top, left, bottom - top, right - left)
    return Mosaic(whole, tuple((row - top, col - left) for row, col in places), sizes, tuple(shifts))


def _check_alike(first: RasterGrid, first_name: str, grid: RasterGrid, name: str) -> None:
    if not first.crs.equals(grid.crs, ignore_axis_order=True):
        raise InputError(
            "images of one mosaic must be in one CRS", where=name, found=grid.crs.name,
            expected=f"{first.crs.name}, as {first_name}", next_step=NEXT_STEP,
        )  # fmt: skip
    for mine, theirs, length in zip(grid.pixel_size, first.pixel_size, (grid.width_px, grid.height_px), strict=True):
        if abs(mine - theirs) * length > DRIFT_MOST_PX * theirs:
            raise InputError(
                "images of one mosaic must have pixels of one size", where=name, found=f"{mine:.9g}",
                expected=f"{theirs:.9g}, as {first_name}", next_step=NEXT_STEP,
            )  # fmt: skip


@dataclass(frozen=True)
class _Reading:
    bands: tuple[int, ...] | None
    assume_crs: str | None
    stretches: tuple[Range | None, ...]
    """Of each image; None where its own pixels decide."""


class MosaicReader:
    """Images read as one; for one thread at a time.

    Where they overlap, the first in order that has a pixel gives it.

    Attributes
    ----------
    grid, paths, traits
        The common grid, the files and how the bands of each are read.
    """

    def __init__(self, paths: Sequence[Path], reading: _Reading, notices: Notices) -> None:
        self.paths = tuple(paths)
        self._reading = reading
        self._open: OrderedDict[int, tuple[ExitStack, ImageReader]] = OrderedDict()
        with ExitStack() as stack:
            stack.callback(self.close)
            readers = [self._look_at(index, notices) for index in range(len(paths))]
            self.traits: tuple[ImageTraits, ...] = tuple(traits for _, traits in readers)
            self.mosaic = lay_out([grid for grid, _ in readers], [path.name for path in paths])
            self.grid = self.mosaic.grid
            _check_size(self.grid)
            stack.pop_all()
        moved = [path.name for path, shift in zip(paths, self.mosaic.shift_px, strict=True) if shift > SHIFT_TOLD_PX]
        notices.add("W_MOSAIC_SHIFT", "images moved by up to half a pixel to the grid of the first", len(moved), moved)

    def read(self, row: int, col: int, height_px: int, width_px: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Read a window inside the grid: (3, row, col) 0-255, and (row, col) where there is a pixel."""
        rows, cols = range(row, row + height_px), range(col, col + width_px)
        rgb, valid = np.zeros((3, height_px, width_px), np.uint8), np.zeros((height_px, width_px), bool)
        for index, shared_rows, shared_cols in self.mosaic.touched(rows, cols):
            at = (
                slice(shared_rows.start - row, shared_rows.stop - row),
                slice(shared_cols.start - col, shared_cols.stop - col),
            )
            if valid[at].all():
                continue
            top, left = self.mosaic.places[index]
            colours, there = self._reader(index).read(
                shared_rows.start - top, shared_cols.start - left, len(shared_rows), len(shared_cols)
            )
            there &= ~valid[at]
            np.copyto(rgb[:, at[0], at[1]], colours, where=there)
            valid[at] |= there
        return rgb, valid

    def has_pixels(self, rows: range, cols: range) -> bool:
        """Tell whether any image lies in a part."""
        return bool(self.mosaic.touched(rows, cols))

    def close(self) -> None:
        """Close all files."""
        while self._open:
            self._open.popitem()[1][0].close()

    def _look_at(self, index: int, notices: Notices) -> tuple[RasterGrid, ImageTraits]:
        reader = self._reader(index, notices)
        if reader.grid is None:
            raise AssertionError("an image opened as georeferenced has a grid")
        return reader.grid, reader.traits

    def _reader(self, index: int, notices: Notices | None = None) -> ImageReader:
        if index not in self._open:
            while len(self._open) >= OPEN_MOST:
                self._open.popitem(last=False)[1][0].close()
            with ExitStack() as stack:
                reading, heard = self._reading, notices if notices is not None else Notices()
                reader = stack.enter_context(
                    open_image(
                        self.paths[index], bands=reading.bands, assume_crs=reading.assume_crs,
                        stretch=reading.stretches[index], notices=heard,
                    )
                )  # fmt: skip
                self._open[index] = stack.pop_all(), reader
        self._open.move_to_end(index)
        return self._open[index][1]


def _check_size(grid: RasterGrid) -> None:
    width, height = grid.width_px, grid.height_px
    if max(width, height) > SIDE_MOST_PX or width * height > PIXELS_MOST:
        raise LimitError(
            "the images lie too far apart for one map", found=f"{width:,} x {height:,} px",
            expected=f"at most {SIDE_MOST_PX:,} px a side and {PIXELS_MOST:,} in all", next_step="map them in parts",
        )  # fmt: skip


@contextmanager
def open_mosaic(
    paths: Sequence[Path],
    *,
    bands: tuple[int, ...] | None = None,
    assume_crs: str | None = None,
    stretch: Range | None = None,
    notices: Notices,
) -> Iterator[MosaicReader]:
    """Open one image or several as one; options are those of `images.open_image`.

    Images whose samples are stretched get the widest range that any of their type asks for. Those of 8 bits are taken
    as they are beside others of more, whatever the stretch.

    Raises
    ------
    InputError
        An image cannot be used, or does not fit the others; also CrsError and LimitError.
    """
    with ExitStack() as stack:
        stack.enter_context(rasterio.Env())  # around those of the single files, which end in no certain order
        first = _Reading(bands, assume_crs, (stretch,) * len(paths))
        reader = stack.enter_context(closing(MosaicReader(paths, first, notices)))
        settled = _settled(reader.traits, stretch, notices)
        if any(
            (traits.low, traits.high) != (wanted or AS_THEY_ARE)
            for traits, wanted in zip(reader.traits, settled, strict=True)
        ):
            reader.close()
            second = _Reading(bands, assume_crs, settled)
            reader = stack.enter_context(closing(MosaicReader(paths, second, Notices())))
        yield reader


def _settled(traits: Sequence[ImageTraits], stretch: Range | None, notices: Notices) -> tuple[Range | None, ...]:
    """Return which samples of each image become black and white; None for those taken as they are."""
    types = sorted({one.dtype for one in traits})
    notices.add("W_MOSAIC_TYPES", "mosaics of images of several types of samples, each type scaled by itself",
                int(len(types) > 1), [", ".join(types)])  # fmt: skip
    if stretch is not None:
        return tuple(None if one.dtype == "uint8" and len(types) > 1 else stretch for one in traits)
    widest: dict[str, Range] = {}
    for dtype in types:
        ranges = {(one.low, one.high) for one in traits if one.dtype == dtype and one.stretched}
        if ranges:
            widest[dtype] = min(low for low, _ in ranges), max(high for _, high in ranges)
        notices.add("W_MOSAIC_STRETCH", "mosaics whose images got one range of samples for all", int(len(ranges) > 1),
                    [f"{dtype} {low:g} to {high:g}" for low, high in [widest.get(dtype, AS_THEY_ARE)]])  # fmt: skip
    return tuple(widest.get(one.dtype) for one in traits)


def images_of(path: Path, *, but: Sequence[Path | None] = (), notices: Notices) -> list[Path]:
    """Return the images a path stands for: itself, or those of a folder by name.

    Of a folder, hidden files, `but`, and maps of coverage with their pictures are left out.

    Raises
    ------
    InputError
        A folder without images, or a map of coverage in place of an image.
    """
    if not path.is_dir():
        if is_coverage(path):
            raise InputError(
                "a map of coverage, no image", where=path, expected="the image that it was made from",
                next_step="name the image",
            )  # fmt: skip
        return [path]
    left_out = {other.resolve() for other in but if other is not None}
    found = sorted(
        file for file in path.iterdir()
        if file.suffix.lower() in SUFFIXES and not file.name.startswith(".") and file.resolve() not in left_out
    )  # fmt: skip
    maps = [file.name for file in found if is_coverage(file)]
    notices.add("W_MAPS_LEFT_OUT", "maps of coverage in a folder of images, left out", len(maps), maps[:5])
    found = [file for file in found if file.name not in set(maps)]
    if not found:
        raise InputError("no images in the folder", where=path, expected="files ending in " + ", ".join(SUFFIXES))
    return found
