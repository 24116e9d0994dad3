"""Coverage maps: percentages by class in cloud-optimised GeoTIFFs, written and read window by window."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from types import TracebackType
from typing import Any, Self

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.errors import RasterioError
from rasterio.shutil import copy
from rasterio.windows import Window

from urbanforest_cli.core.coverage_model import CANOPY, CLASSES, UNKNOWN
from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.publish import output_error, publish
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.image_checks import open_raster, reader_errors
from urbanforest_cli.files.image_places import raster_grid

TAG = "urbanforest"
FORMAT = "cover"
"""What maps and their pictures call themselves in the tag."""
UNIT = "percent"
BLOCK_PX = 512
CACHE_BYTES = 64 << 20
MASK = 255
WINDOW_PX = 4 << 20
"""Pixels read at once when a whole file is looked through."""


class CoverageWriter:
    """Write a map by windows; it appears under its name when all of it is on disk and was read back.

    What no window covers is unknown. Used as a context manager; an error inside leaves nothing behind.

    Parameters
    ----------
    path
        Of the GeoTIFF.
    grid
        Its pixels' place.
    classes
        Name of each band.
    provenance
        Goes into the tag ``urbanforest``, as JSON.

    Raises
    ------
    OutputError
        On leaving: it could not be written whole.
    """

    def __init__(self, path: Path, grid: RasterGrid, classes: Sequence[str], provenance: Mapping[str, Any]) -> None:
        self.path = path
        self.grid = grid
        self.classes = tuple(classes)
        self._provenance = json.dumps(dict(provenance), ensure_ascii=True, allow_nan=False)
        bands = len(self.classes)
        # What every row and column adds up to, to be held against the file at the end.
        self._rows = np.full((bands, grid.height_px), UNKNOWN * grid.width_px, np.int64)
        self._cols = np.full((bands, grid.width_px), UNKNOWN * grid.height_px, np.int64)

    def __enter__(self) -> Self:
        self._publishing = self._published()
        return self._publishing.__enter__()

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> bool | None:
        return self._publishing.__exit__(kind, error, trace)

    @contextmanager
    def _published(self) -> Iterator[Self]:
        bands = len(self.classes)
        with publish(self.path, verify=self._verify) as part, rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES):
            # A plain TIFF goes before: cloud-optimised ones cannot be written by windows.
            plain = part.with_name(part.name + ".plain")
            with _writing(self.path):
                self._file = rasterio.open(
                    plain, "w", driver="GTiff", height=self.grid.height_px, width=self.grid.width_px, count=bands,
                    dtype="uint8", nodata=float(UNKNOWN), crs=rasterio.crs.CRS.from_wkt(self.grid.crs.to_wkt()),
                    transform=rasterio.Affine(*self.grid.transform), compress="DEFLATE", zlevel=1, interleave="pixel",
                    tiled=True, blockxsize=BLOCK_PX, blockysize=BLOCK_PX, bigtiff="YES", sparse_ok=True,
                )  # fmt: skip
            try:
                yield self
                with _writing(self.path):
                    self._finish(plain, part)
            finally:
                with _writing(self.path):
                    self._file.close()

    def write(self, row: int, col: int, values: NDArray[np.uint8]) -> None:
        """Set (class, row, col) percentages, 255 where unknown; no pixel may be set twice.

        Raises
        ------
        OutputError
            The disk is full.
        """
        _, height, width = values.shape
        with _writing(self.path):
            self._file.write(values, window=Window(col, row, width, height))
        change = values.astype(np.int64) - UNKNOWN
        self._rows[:, row : row + height] += change.sum(axis=2)
        self._cols[:, col : col + width] += change.sum(axis=1)

    def _finish(self, plain: Path, part: Path) -> None:
        for band, name in enumerate(self.classes, 1):
            self._file.set_band_description(band, name)
            self._file.set_band_unit(band, UNIT)
        self._file.update_tags(**{TAG: self._provenance})
        self._file.close()
        with rasterio.Env(GDAL_PAM_ENABLED="NO", GDAL_CACHEMAX=CACHE_BYTES):
            copy(
                str(plain), str(part), driver="COG", compress="DEFLATE", blocksize=BLOCK_PX, bigtiff="IF_SAFER",
                overview_resampling="AVERAGE", num_threads=1, sparse_ok=True,
            )  # fmt: skip
        plain.unlink()

    def _verify(self, part: Path) -> None:
        """Hold every row and column against what was written, for the TIFF library may lose bytes without a word."""
        rows, cols = np.zeros_like(self._rows), np.zeros_like(self._cols)
        with _writing(self.path), rasterio.open(part, driver="GTiff") as file:
            whole = (file.height, file.width, file.count) == (self.grid.height_px, self.grid.width_px, len(rows))
            whole &= file.tags().get(TAG) == self._provenance
            for window in windows(file.height, file.width) if whole else ():
                values = file.read(window=window)
                (top, bottom), (left, right) = window.toranges()
                rows[:, top:bottom] += values.sum(axis=2, dtype=np.int64)
                cols[:, left:right] += values.sum(axis=1, dtype=np.int64)
        if not whole or (rows != self._rows).any() or (cols != self._cols).any():
            raise OutputError("the map was not written whole; what stood there before is untouched", where=self.path,
                              next_step="make room or name another folder with -o, then run again")  # fmt: skip


@dataclass(frozen=True)
class CoverageReader:
    """An open map.

    Parameters
    ----------
    path, grid
        The file, and where its pixels lie.
    classes
        What is mapped.
    provenance
        What the file says of its making; None where it says nothing.
    """

    path: Path
    grid: RasterGrid
    classes: tuple[str, ...]
    provenance: dict[str, Any] | None
    _file: Any
    _bands: tuple[int, ...]
    _percent: float
    """What a value is multiplied with to be a percentage."""
    _south_up: bool
    _tagged: bool
    """Whether the value that the file calls missing is."""

    def read(self, row: int, col: int, height_px: int, width_px: int) -> NDArray[np.uint8]:
        """Return (class, row, col) percentages of a window inside the map, 255 where unknown.

        Raises
        ------
        InputError
            The file is damaged.
        """
        first = self.grid.height_px - row - height_px if self._south_up else row
        values, known = _read(self._file, self._bands, Window(col, first, width_px, height_px), self.path, self._tagged)
        percent = np.where(known, np.rint(np.where(known, values, 0) * self._percent), UNKNOWN).astype(np.uint8)
        return percent[:, ::-1] if self._south_up else percent


@contextmanager
def open_coverage(path: Path, *, assume_crs: str | None = None, notices: Notices) -> Iterator[CoverageReader]:
    """Open a map of this program or of another.

    Bands are known by their descriptions; a single band is taken for the canopy. Values are percentages from 0 to
    100, shares from 0 to 1, or a mask of 0 and 255, as all of the file says.

    Raises
    ------
    InputError
        No raster, one without a place on the map, or one whose bands or values cannot be understood.
    """
    with open_raster(path, notices) as (file, _):
        grid, south_up = raster_grid(file, path, assume_crs=assume_crs, notices=notices)
        bands = _bands_by_class(file, path, notices)
        with reader_errors(path):
            text = file.tags().get(TAG)
        tagged = bool(text) or _means_missing(file, tuple(bands.values()), path, notices)
        percent = 1.0 if text else _factor(file, tuple(bands.values()), path, notices, tagged)
        yield CoverageReader(
            path, grid, tuple(bands), _record(text), file, tuple(bands.values()), percent, south_up, tagged
        )  # fmt: skip


def is_coverage(path: Path) -> bool:
    """Tell whether a file is a map of coverage, by what its bands are called, or a picture of one of this program."""
    try:
        with open_raster(path, Notices()) as (file, _), reader_errors(path):
            names = {(name or "").strip().lower() for name in file.descriptions}
            made_by = _record(file.tags().get(TAG)) or {}
    except InputError:
        return False  # nothing is known of it; whoever reads it says why
    return bool(names & set(CLASSES)) or made_by.get("format") == FORMAT


def _record(text: str | None) -> dict[str, Any] | None:
    try:
        found = json.loads(text) if text else None
    except (ValueError, RecursionError):
        return None
    return found if isinstance(found, dict) else None


def _bands_by_class(file: Any, path: Path, notices: Notices) -> dict[str, int]:
    names = [(name or "").strip().lower() for name in file.descriptions]
    found = {name: names.index(name) + 1 for name in CLASSES if name in names}
    if found:
        return found
    colours = [colour.name for colour in file.colorinterp]
    plain = [band for band, colour in enumerate(colours, 1) if colour != "alpha"]
    if len(plain) != 1:
        raise InputError(
            "which band is the canopy?", where=path, found=f"{file.count} bands, described as {names}",
            expected=f"one band, or bands described as {' and '.join(CLASSES)}",
            next_step="keep the one wanted: gdal_translate -b 1 IN OUT.tif",
        )  # fmt: skip
    notices.add("W_COVERAGE_BAND", "maps whose only band was taken for the canopy", 1, [path.name])
    return {CANOPY: plain[0]}


def _means_missing(file: Any, bands: tuple[int, ...], path: Path, notices: Notices) -> bool:
    """Tell whether what a foreign map calls missing is: 0 is bare ground, and 255 covered in a mask of 0 and 255."""
    nodata = file.nodatavals[bands[0] - 1]
    if nodata not in (0, MASK) or (nodata == MASK and file.units[bands[0] - 1] == UNIT):
        return True
    if nodata == MASK:
        found: set[float] = set()
        for window in windows(file.height, file.width):
            found |= set(np.unique(_read(file, bands, window, path, tagged=False)[0]).tolist())
            if not found <= {0, MASK}:
                return True
        if found != {0, MASK}:
            return True
    notices.add("W_COVERAGE_NODATA", "maps whose missing value is a value of coverage, read as coverage", 1,
                [f"{path.name} {nodata:g}"])  # fmt: skip
    return False


def _factor(file: Any, bands: tuple[int, ...], path: Path, notices: Notices, tagged: bool) -> float:
    """Look through a map that does not say what its values are; return what makes them percentages."""
    low, high, between, broken, some = np.inf, -np.inf, False, False, False
    for window in windows(file.height, file.width):
        values, known = _read(file, bands, window, path, tagged)
        values = values[known]
        if values.size:
            low, high, some = min(low, values.min()), max(high, values.max()), True
            between |= bool(((values > 0) & (values < MASK)).any())
            broken |= bool(((values > 0) & (values < 1)).any())
    if not some:
        return 1.0
    if low < 0 or high > MASK or (high > 100 and (between or high < MASK)):
        raise InputError(
            "the values are no coverage", where=path, found=f"{low:g} to {high:g}",
            expected="percentages 0 to 100, shares 0 to 1, or a mask of 0 and 255",
        )  # fmt: skip
    if high > 100:
        notices.add("W_COVERAGE_MASK", "masks of 0 and 255, read as 0 and 100 %", 1, [path.name])
        return 100.0 / MASK
    if 0 < high <= 1:
        what = "maps of shares from 0 to 1, read as 0 to 100 %" if broken else "masks of 0 and 1, read as 0 and 100 %"
        notices.add("W_COVERAGE_SHARE", what, 1, [path.name])
        return 100.0
    return 1.0


def _read(
    file: Any, bands: tuple[int, ...], window: Window, path: Path, tagged: bool
) -> tuple[NDArray[Any], NDArray[np.bool_]]:
    with reader_errors(path):
        values = file.read(list(bands), window=window)
        known = np.ones(values.shape, bool)
        if tagged or not any(flag.name == "nodata" for flag in file.mask_flag_enums[bands[0] - 1]):
            known = file.read_masks(list(bands), window=window) != 0
    return values, known & np.isfinite(values) if values.dtype.kind == "f" else known


def windows(height_px: int, width_px: int) -> Iterator[Window]:
    """Yield windows of whole blocks, a few megapixels each, that make up a raster: row by row, however wide it is."""
    cols = min(-(-width_px // BLOCK_PX), WINDOW_PX // BLOCK_PX**2) * BLOCK_PX
    rows = max(WINDOW_PX // cols // BLOCK_PX, 1) * BLOCK_PX
    for row in range(0, height_px, rows):
        for col in range(0, width_px, cols):
            yield Window(col, row, min(cols, width_px - col), min(rows, height_px - row))


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn what GDAL raises into an error that says what stands on disk."""
    try:
        yield
    except (RasterioError, rasterio._err.CPLE_BaseError) as error:
        raise output_error(path, OSError(str(error.__cause__ or error))) from error
