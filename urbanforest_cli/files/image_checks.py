"""Opening a raster nobody vouches for: what the file is, and what it would take to read it, before a pixel is read."""

from __future__ import annotations

import math
import os
import stat
import sys
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import rasterio
from rasterio.errors import NotGeoreferencedWarning, RasterioError

from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.files.picture_structure import PNG_SIGNATURE, check_picture, unpacks_whole
from urbanforest_cli.files.tiff_structure import TiffStructure, tiff_structure
from urbanforest_cli.files.vector_formats import refuse_remote

SIDE_MOST_PX = 1_000_000
PIXELS_MOST = 40_000_000_000
"""200,000 x 200,000 px: a city of 100 km at half a metre."""
BANDS_MOST = 16
BLOCK_MOST_BYTES = 64 << 20
WHOLE_MOST_BYTES = 256 << 20
"""Unpacked bytes of an image whose format can only be unpacked whole."""
UNREMARKABLE_BYTES = 1 << 30
UNPACKED_RATIO_MOST = 2_000_000
"""Unpacked bytes per byte on disk, of images beyond a GiB: an empty TIFF of large sparse tiles stays below it."""
CACHE_BYTES = 128 << 20
DTYPES = ("uint8", "uint16", "int16", "uint32", "int32", "float32", "float64")
_SIDECAR_MOST_BYTES = 16 << 20
_TIFF = (b"II*\0", b"MM\0*", b"II+\0", b"MM\0+")
_EXPECTED = "a GeoTIFF, PNG, JPEG or JPEG 2000 file"
_WHOLE = "check that the file is whole; open it in QGIS and save it again as GeoTIFF"
_TILE = "write it in tiles: gdal_translate -co TILED=YES -co COMPRESS=DEFLATE -co BIGTIFF=IF_SAFER IN OUT.tif"


@dataclass(frozen=True)
class _Format:
    driver: str
    heads: tuple[bytes, ...]


_FORMATS = (
    _Format("GTiff", _TIFF),
    _Format("PNG", (PNG_SIGNATURE,)),
    _Format("JPEG", (b"\xff\xd8\xff",)),
    _Format("JP2OpenJPEG", (b"\x00\x00\x00\x0cjP  \r\n\x87\n", b"\xff\x4f\xff\x51")),
)
_REFUSED = {
    "an archive": (b"PK\x03\x04", b"\x1f\x8b", b"7z\xbc\xaf\x27\x1c", b"Rar!", b"BZh", b"\xfd7zXZ\x00"),
    "an SQLite database or GeoPackage": (b"SQLite format 3\0",),
    "a PDF document": (b"%PDF",),
    "an HDF5 or NetCDF 4 file": (b"\x89HDF\r\n\x1a\n",),
    "text, as a virtual dataset or a page that says why a download failed": (b"<", b"\xef\xbb\xbf<", b"{"),
}


@contextmanager
def open_raster(path: Path, notices: Notices) -> Iterator[tuple[Any, TiffStructure | None]]:
    """Open a raster file; yield rasterio's dataset, and the structure where it is a TIFF.

    Files beside it are taken along only where they can name no third one: world files, .prj, .aux.xml, and masks or
    overviews that are TIFF.

    Raises
    ------
    InputError
        Not a local regular file of a known format, damaged, or of samples that are no colours.
    LimitError
        More pixels, bands or bytes at a time than this module's limits.
    """
    driver = raster_driver(path)
    _check_sidecars(path)
    structure = tiff_structure(path) if driver == "GTiff" else None
    check_picture(path, driver)
    whole = path.absolute()  # else a name such as GTIFF_DIR:2:x.tif would be taken for an instruction
    with rasterio.Env(GDAL_CACHEMAX=CACHE_BYTES, GDAL_NUM_THREADS="1"):
        with (
            reader_errors(path),
            _unreadable_remarks(),
            warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning),
        ):
            dataset = rasterio.open(whole, driver=driver, sharing=False)
        try:
            with reader_errors(path):
                _check_limits(dataset, path)
                _check_samples(dataset, path)
                if dataset.subdatasets:
                    notices.add("W_PAGES", "image files of several images, of which the first is read", 1, [path.name])
            yield dataset, structure
        finally:
            dataset.close()


@contextmanager
def reader_errors(path: Path, doing: str = "the image cannot be read") -> Iterator[None]:
    """Turn what GDAL raises into one line."""
    try:
        yield
    except InputError:
        raise
    # rasterio lets also its own base class, of no family, and numbers it cannot convert go by.
    except (RasterioError, OSError, ValueError, TypeError, MemoryError, rasterio._err.CPLE_BaseError) as error:
        cause = error.__cause__ or error
        text = " ".join(str(cause).replace(str(path.absolute()), path.name).split())
        raise InputError(doing, where=path, found=text[:300] or type(error).__name__, next_step=_WHOLE) from error


@contextmanager
def _unreadable_remarks() -> Iterator[None]:
    """Keep quiet where rasterio cannot decode what GDAL remarks on a file whose own texts are not UTF-8.

    It happens where GDAL calls back, so nothing can be raised; Python would print a traceback.
    """
    usual = sys.unraisablehook
    sys.unraisablehook = lambda event: None if isinstance(event.exc_value, UnicodeDecodeError) else usual(event)
    try:
        yield
    finally:
        sys.unraisablehook = usual


def raster_driver(path: Path) -> str:
    """Tell which of GDAL's drivers reads a file, by its first bytes; its name has no say.

    Raises
    ------
    InputError
        Nothing there, not a local regular file, empty, or none of the formats that are read.
    """
    refuse_remote(path)
    head = _head(path)
    for entry in _FORMATS:
        if head.startswith(entry.heads):
            return entry.driver
    found = next((what for what, heads in _REFUSED.items() if head.lstrip().startswith(heads)), None)
    raise InputError(
        "not an image file of a format that is read", where=path, found=found or f"first bytes {head[:8]!r}",
        expected=_EXPECTED, next_step="convert it: gdal_translate -of GTiff IN OUT.tif",
    )  # fmt: skip


def _head(path: Path) -> bytes:
    try:
        mode = os.stat(path).st_mode
        if stat.S_ISDIR(mode):
            raise InputError("a folder, not an image file", where=path, expected=_EXPECTED)
        if not stat.S_ISREG(mode):
            raise InputError("not a regular file", where=path, found="a pipe, socket or device", expected=_EXPECTED)
        with path.open("rb") as stream:
            head = stream.read(32)
    except FileNotFoundError as error:
        raise InputError("no such file", where=path, next_step="check the path") from error
    except (OSError, ValueError) as error:  # a loop of links, a folder one may not enter, a name with a null byte
        reason = getattr(error, "strerror", None) or str(error)
        raise InputError("the file cannot be reached", where=repr(str(path)), found=reason) from error
    if not head:
        raise InputError("the file is empty", where=path, found="0 bytes", expected=_EXPECTED)
    return head


def _check_sidecars(path: Path) -> None:
    """Refuse files beside it that GDAL would open and that could send it elsewhere."""
    for suffix in (".msk", ".ovr", ".aux.xml"):
        beside = path.with_name(path.name + suffix)
        if not os.path.lexists(beside):
            continue
        head = _head(beside)
        fault = None
        if suffix != ".aux.xml":
            fault = None if head.startswith(_TIFF) else "it is not a TIFF file"
        elif beside.stat().st_size > _SIDECAR_MOST_BYTES:
            fault = f"it is longer than {_SIDECAR_MOST_BYTES >> 20} MiB"
        else:
            text = beside.read_bytes().lower()
            if b"overview_file" in text or b"<!doctype" in text or b"<!entity" in text:
                fault = "it points to another file"
        if fault is not None:
            raise InputError("the file beside the image is not read", where=beside, found=fault,
                             next_step="move it away, or write the image anew with gdal_translate")  # fmt: skip


def _check_limits(dataset: Any, path: Path) -> None:
    width, height, bands = dataset.width, dataset.height, dataset.count
    if bands > BANDS_MOST:
        raise LimitError("too many bands", where=path, found=f"{bands:,}", expected=f"at most {BANDS_MOST}",
                         next_step="keep those wanted: gdal_translate -b 1 -b 2 -b 3 IN OUT.tif")  # fmt: skip
    if max(width, height) > SIDE_MOST_PX or width * height > PIXELS_MOST:
        raise LimitError(
            "the image is too large", where=path, found=f"{width:,} x {height:,} px",
            expected=f"at most {SIDE_MOST_PX:,} px a side and {PIXELS_MOST:,} in all", next_step="cut it into parts",
        )  # fmt: skip
    if bands == 0:
        raise InputError("the file holds no image", where=path, found="0 bands")
    sample_bytes = max(_sample_bytes(name) for name in dataset.dtypes)
    unpacked = width * height * bands * sample_bytes
    rows, cols = max(dataset.block_shapes, key=math.prod)
    together = bands if dataset.interleaving is not None and dataset.interleaving.name == "pixel" else 1
    if rows * cols * sample_bytes * together > BLOCK_MOST_BYTES:
        raise LimitError(
            "the image can only be read in parts that are too large", where=path,
            found=f"tiles or strips of {cols:,} x {rows:,} px", expected=f"at most {BLOCK_MOST_BYTES >> 20} MiB each",
            next_step=_TILE,
        )  # fmt: skip
    if unpacked > max(UNREMARKABLE_BYTES, UNPACKED_RATIO_MOST * path.stat().st_size):
        raise LimitError(
            "the file claims far more pixels than it can hold", where=path,
            found=f"{width:,} x {height:,} px in {path.stat().st_size:,} bytes", next_step=_WHOLE,
        )  # fmt: skip
    if unpacked > WHOLE_MOST_BYTES and unpacks_whole(path, dataset.driver):
        raise LimitError(
            "the image can only be unpacked whole", where=path, found=f"{unpacked >> 20:,} MiB",
            expected=f"at most {WHOLE_MOST_BYTES >> 20} MiB", next_step=_TILE,
        )  # fmt: skip


def _sample_bytes(name: str) -> int:
    digits = "".join(character for character in name if character.isdigit())
    return max(1, int(digits or 8) // 8)


def _check_samples(dataset: Any, path: Path) -> None:
    bits = {dataset.tags(band, ns="IMAGE_STRUCTURE").get("NBITS") for band in dataset.indexes}
    float16 = "16" in bits and "float32" in dataset.dtypes
    found = "float16" if float16 else next((name for name in dataset.dtypes if name not in DTYPES), None)
    if found is not None:
        raise InputError(
            "samples of this type are not read", where=path, found=found, expected=", ".join(DTYPES),
            next_step="convert it: gdal_translate -ot Float32 IN OUT.tif",
        )  # fmt: skip
    if len(set(dataset.dtypes)) > 1:
        raise InputError("bands of different types", where=path, found=", ".join(dataset.dtypes),
                         next_step="convert it: gdal_translate -ot Float32 IN OUT.tif")  # fmt: skip
