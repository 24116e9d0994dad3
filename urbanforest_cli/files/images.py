"""Aerial images of any make, read by windows as red, green and blue of 8 bits, north up."""

from __future__ import annotations

import math
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rasterio.windows import Window

from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.image_bands import GRAY, ImageTraits, find_bands
from urbanforest_cli.files.image_checks import open_raster, reader_errors
from urbanforest_cli.files.image_places import raster_grid
from urbanforest_cli.files.image_values import check_alpha, find_range, painted, scaled, valid_pixels

LOOKS = 8
LOOK_PX = 48
"""Looks along each side of an image, and the side of one; an image of so many pixels is looked at whole."""
BLACK_LEAST_PX = 16
"""Side from which on a look that is pure black all over is no shadow: there is no such pixel in 445 tiles of NAIP."""


class ImageReader:
    """An open image; for one thread at a time.

    Attributes
    ----------
    path
        The file.
    grid
        Where it lies, north up; None for an image that may lie nowhere.
    width_px, height_px
        Its size.
    traits
        Which bands are read, and how.
    """

    def __init__(self, dataset: Any, path: Path, grid: RasterGrid | None, traits: ImageTraits, turned: bool) -> None:
        self.path = path
        self.grid = grid
        self.traits = traits
        self.width_px = int(dataset.width)
        self.height_px = int(dataset.height)
        self._dataset = dataset
        self._turned = turned

    def read(self, row: int, col: int, height_px: int, width_px: int) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
        """Read a window as red, green and blue.

        Returns
        -------
        (3, height_px, width_px) uint8
            0 where there is no pixel.
        (height_px, width_px) bool
            Where there is one.

        Raises
        ------
        InputError
            The file is damaged there.
        ValueError
            The window is not inside the image.
        """
        traits = self.traits
        window = self._window(row, col, height_px, width_px)
        samples, alpha = self.colours(window)
        valid = valid_pixels(samples, alpha, traits)
        if traits.masked:
            valid &= self.mask(window)
        rgb = painted(samples[0], traits.palette) if traits.palette is not None else scaled(samples, traits)
        if not valid.all():
            rgb *= valid
        ordered: NDArray[np.uint8] = np.ascontiguousarray(rgb)
        return ordered, valid

    def read_nir(self, row: int, col: int, height_px: int, width_px: int) -> NDArray[np.uint8]:
        """Read a window of near infrared, (height_px, width_px), scaled as the colours are.

        Raises
        ------
        InputError
            There is none, or the file is damaged.
        """
        if self.traits.nir is None:
            raise InputError(
                "no band of near infrared", where=self.path, found=self.traits.sentence(),
                expected="a fourth band, or one called NIR",
            )  # fmt: skip
        samples = self._samples(self._window(row, col, height_px, width_px), [self.traits.nir])
        nir: NDArray[np.uint8] = np.ascontiguousarray(scaled(samples, self.traits)[0])
        return nir

    def read_values(self, row: int, col: int, height_px: int, width_px: int) -> NDArray[Any]:
        """Read a window of all bands, (band, height_px, width_px), as the file has them: masks, indices, percents."""
        window = self._window(row, col, height_px, width_px)
        return self._samples(window, list(range(1, self.traits.band_count + 1)))

    def _window(self, row: int, col: int, height_px: int, width_px: int) -> Window:
        """Return a window in the file's own order of rows."""
        inside = 0 <= row < row + height_px <= self.height_px and 0 <= col < col + width_px <= self.width_px
        if not inside:
            raise ValueError(f"window {(row, col, height_px, width_px)} in {self.height_px} x {self.width_px} px")
        first = self.height_px - row - height_px if self._turned else row
        return Window(col, first, width_px, height_px)

    def colours(self, window: Window) -> tuple[NDArray[Any], NDArray[Any] | None]:
        """Read the samples of the three colours, and of transparency where that is a band, in one go.

        The window is in the file's order of rows.
        """
        bands, alpha = self.traits.bands, self.traits.alpha
        wanted = sorted({*bands, *([alpha] if alpha else [])})
        samples = self._samples(window, wanted)
        picks = [wanted.index(band) for band in bands]
        colours = samples[:3] if picks == [0, 1, 2] else samples[picks]
        return colours, samples[wanted.index(alpha)] if alpha else None

    def _samples(self, window: Window, bands: list[int]) -> NDArray[Any]:
        with reader_errors(self.path, f"its pixels cannot be read near column {window.col_off}, row {window.row_off}"):
            values: NDArray[Any] = self._dataset.read(bands, window=window)
        return values[:, ::-1] if self._turned else values

    def mask(self, window: Window) -> NDArray[np.bool_]:
        """Read what the file's own mask lets through; the window is in the file's order of rows."""
        with reader_errors(self.path, "the mask of the image cannot be read"):
            mask: NDArray[np.bool_] = self._dataset.read_masks(self.traits.red, window=window) > 0
        return mask[::-1] if self._turned else mask


@contextmanager
def open_image(
    path: Path,
    *,
    bands: tuple[int, ...] | None = None,
    assume_crs: str | None = None,
    stretch: tuple[float, float] | None = None,
    georeferenced: bool = True,
    notices: Notices,
) -> Iterator[ImageReader]:
    """Open an image file of the user's, and find out what its bands and numbers mean.

    GeoTIFF (also BigTIFF and cloud-optimised), PNG, JPEG and JPEG 2000 are told by their first bytes. Whatever is not
    plain from the file is decided by pixels looked at on an even grid, and counted in `notices`: whether a band called
    alpha is near infrared, which range of more than 8 bits is black to white, whether pure black means missing.

    Parameters
    ----------
    bands
        Red, green and blue, or one for gray, from 1; by what the file says by default.
    assume_crs
        CRS of a file that states none, or one its numbers cannot be in.
    stretch
        Samples that become 0 and 255; chosen from the pixels by default. Parts of an image that is not of 8 bits come
        out alike only with the same stretch.
    georeferenced
        False where an image may lie nowhere, as a mask beside an image does; black is not taken for missing then.

    Raises
    ------
    InputError
        The file cannot be used; also CrsError and LimitError.
    ConfigError
        Bands that are not there, or a stretch of no width.
    """
    path = Path(path)
    if stretch is not None and not (all(map(math.isfinite, stretch)) and stretch[0] < stretch[1]):
        raise ConfigError("no range to stretch", where="--stretch", found=stretch, expected="a low and a higher number")
    with open_raster(path, notices) as (dataset, structure):
        grid, turned = None, False
        with reader_errors(path):
            if georeferenced:
                grid, turned = raster_grid(dataset, path, assume_crs=assume_crs, notices=notices)
            else:
                grid, turned = _place_if_any(dataset, path, assume_crs)
            traits = find_bands(dataset, path, bands, notices if georeferenced else Notices())
        first = ImageReader(dataset, path, grid, traits, turned)
        black = georeferenced and structure is not None and structure.sparse
        traits = _settled(first, stretch, notices, imagery=georeferenced, holes=black)
        yield ImageReader(dataset, path, grid, traits, turned)


def _place_if_any(dataset: Any, path: Path, assume_crs: str | None) -> tuple[RasterGrid | None, bool]:
    try:
        return raster_grid(dataset, path, assume_crs=assume_crs, notices=Notices())
    except InputError:
        return None, False


class _Look(NamedTuple):
    """Pixels from all over an image: (3, n) colours, (n,) transparency, (n,) not masked out."""

    colours: NDArray[Any]
    alpha: NDArray[Any] | None
    unmasked: NDArray[np.bool_]
    black: bool


def _settled(
    reader: ImageReader, stretch: tuple[float, float] | None, notices: Notices, *, imagery: bool, holes: bool
) -> ImageTraits:
    """Decide by pixels what the file does not say, or says wrongly."""
    traits, name = reader.traits, [reader.path.name]
    open_questions = traits.alpha is not None or (traits.dtype != "uint8" and stretch is None)
    look = _look(reader) if imagery or open_questions else None
    if look is not None and look.alpha is not None:
        traits = check_alpha(traits, look.colours, look.alpha)
        notices.add("W_ALPHA_IS_NIR", "image files whose transparency is half tones all over, taken as near infrared",
                    int(traits.alpha is None), name)  # fmt: skip
    unmarked = traits.nodata is None and traits.alpha is None and not traits.masked and traits.palette is None
    if imagery and look is not None and unmarked and (holes or look.black):
        traits = replace(traits, black_is_missing=True)
        notices.add("W_BLACK", "image files with black areas that are not marked as missing, taken as such", 1, name)
    if look is None:
        low, high = stretch or (0.0, 255.0)
        return replace(traits, low=low, high=high)
    valid = look.unmasked & valid_pixels(look.colours, look.alpha if traits.alpha else None, traits)
    if imagery and not valid.any():
        notices.add("W_ALL_MISSING", "image files without a pixel in all places looked at", 1, name)
    if imagery and not traits.gray and traits.palette is None:
        notices.add("W_GRAY", GRAY, int(_is_gray(look.colours[:, valid])), name)
    low, high = stretch or (
        (0.0, 255.0) if traits.palette is not None else find_range(traits.dtype, look.colours[:, valid].ravel())
    )
    if stretch is None and (low, high) != (0.0, 255.0):
        notices.add("W_STRETCHED", "image files of more than 8 bits whose range, on which the result hangs, was chosen "
                    "from their pixels for want of --stretch", 1,
                    [f"{reader.path.name} {low:g} to {high:g}"])  # fmt: skip
    return replace(traits, low=low, high=high)


def _is_gray(colours: NDArray[Any]) -> bool:
    """Tell whether (3, n) samples of three bands are one picture thrice; nothing is told of a picture of one tone."""
    return colours.shape[1] > 1 and bool(np.ptp(colours[0]) > 0 and (colours == colours[0]).all())


def _look(reader: ImageReader) -> _Look:
    """Read small windows on an even grid, row by row as the file has them."""
    rows, row_px = _look_starts(reader.height_px)
    cols, col_px = _look_starts(reader.width_px)
    colours, alphas, masks, black = [], [], [], False
    for row in rows:
        for col in cols:
            window = Window(col, row, col_px, row_px)
            samples, alpha = reader.colours(window)
            looks = [samples, *_collar(samples, (row == rows[0], row == rows[-1], col == cols[0], col == cols[-1]))]
            black |= min(row_px, col_px) >= BLACK_LEAST_PX and not all(look.any() for look in looks)
            colours.append(samples.reshape(3, -1))
            if alpha is not None:
                alphas.append(alpha.ravel())
            masks.append(reader.mask(window).ravel() if reader.traits.masked else np.ones(row_px * col_px, dtype=bool))
    together = np.concatenate(alphas) if alphas else None
    return _Look(np.concatenate(colours, axis=1), together, np.concatenate(masks), black)


def _collar(samples: NDArray[Any], at: tuple[bool, bool, bool, bool]) -> list[NDArray[Any]]:
    """Return the outermost parts of a look, (band, row, col), at those edges of the image that it lies at."""
    px = BLACK_LEAST_PX
    edges = samples[:, :px], samples[:, -px:], samples[:, :, :px], samples[:, :, -px:]
    return [edge for edge, there in zip(edges, at, strict=True) if there]


def _look_starts(side_px: int) -> tuple[list[int], int]:
    """Return where looks start along a side, first and last at its ends, and how long they are."""
    length = min(side_px, LOOK_PX)
    count = min(LOOKS, -(-side_px // length))
    return [round(i * (side_px - length) / max(1, count - 1)) for i in range(count)], length
