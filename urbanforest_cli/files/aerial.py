"""Aerial pictures: cloud-optimised GeoTIFFs of red, green, blue and perhaps near infrared, written by windows."""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from numpy.typing import NDArray
from rasterio.enums import ColorInterp, Resampling
from rasterio.errors import RasterioError
from rasterio.shutil import copy
from rasterio.windows import Window

from urbanforest_cli.core.errors import OutputError
from urbanforest_cli.core.publish import output_error, publish
from urbanforest_cli.core.raster_grid import RasterGrid

TAG = "urbanforest"
BLOCK_PX = 512
CACHE_BYTES = 64 << 20
BANDS = (
    ("red", ColorInterp.red),
    ("green", ColorInterp.green),
    ("blue", ColorInterp.blue),
    ("near infrared", ColorInterp.undefined),
)
LOSSY = {"compress": "JPEG", "jpeg_quality": 78}
LOSSLESS = {"compress": "DEFLATE", "predictor": 2, "zlevel": 9}
LOSSY_MEAN_MAX = 3.0
"""Counts by which the mean of a window may differ after JPEG."""


class AerialWriter:
    """Write a picture by windows; made by `writing_aerial`."""

    def __init__(self, path: Path, file: Any) -> None:
        self._path = path
        self._file = file
        self.means: list[tuple[Window, NDArray[np.float64]]] = []

    def write(self, row: int, col: int, values: NDArray[np.uint8]) -> None:
        """Set (band, row, col) counts of a window.

        Raises
        ------
        OutputError
            The disk is full.
        """
        window = Window(col, row, values.shape[2], values.shape[1])
        with _writing(self._path):
            self._file.write(values, window=window)
        self.means.append((window, values.mean(axis=(1, 2))))


@contextmanager
def writing_aerial(path: Path, grid: RasterGrid, *, nir: bool, provenance: Mapping[str, Any]) -> Iterator[AerialWriter]:
    """Publish a picture: JPEG inside where it has three bands, lossless where near infrared is a fourth.

    An error inside leaves nothing behind. Every pixel must be written.

    Raises
    ------
    OutputError
        On leaving: it could not be written whole.
    """
    bands = BANDS if nir else BANDS[:3]
    made = json.dumps(dict(provenance), ensure_ascii=True, allow_nan=False)
    means: list[tuple[Window, NDArray[np.float64]]] = []

    def verify(part: Path) -> None:
        allowed = 0.0 if nir else LOSSY_MEAN_MAX
        with _writing(path), rasterio.open(part, driver="GTiff") as file:
            whole = (file.height, file.width, file.count) == (grid.height_px, grid.width_px, len(bands))
            whole &= file.tags().get(TAG) == made
            for window, mean in means if whole else ():
                found = file.read(window=window).mean(axis=(1, 2))
                whole &= bool((np.abs(found - mean) <= allowed).all())
        if not whole:
            raise OutputError("the picture was not written whole; what stood there before is untouched", where=path,
                              next_step="make room or name another folder, then run again")  # fmt: skip

    with (
        publish(path, verify=verify) as part,
        rasterio.Env(GDAL_PAM_ENABLED="NO", GDAL_CACHEMAX=CACHE_BYTES),
    ):
        # A plain TIFF goes before: cloud-optimised ones cannot be written by windows.
        plain = part.with_name("plain.tif")
        with _writing(path):
            file = rasterio.open(
                plain, "w", driver="GTiff", height=grid.height_px, width=grid.width_px, count=len(bands),
                dtype="uint8", crs=rasterio.crs.CRS.from_wkt(grid.crs.to_wkt()), photometric="RGB",
                transform=rasterio.Affine(*grid.transform), compress="DEFLATE", zlevel=1, interleave="pixel",
                tiled=True, blockxsize=BLOCK_PX, blockysize=BLOCK_PX, bigtiff="IF_SAFER", alpha="NO",
            )  # fmt: skip
        try:
            writer = AerialWriter(path, file)
            yield writer
            means += writer.means
            with _writing(path):
                file.colorinterp = [meaning for _, meaning in bands]
                for band, (name, _) in enumerate(bands, 1):
                    file.set_band_description(band, name)
                file.update_tags(**{TAG: made})
                file.close()
                with rasterio.open(plain, "r+") as file:
                    file.build_overviews(_overviews(grid), Resampling.average)
                # Not by the driver of cloud-optimised files, whose JPEG halves the resolution of colours.
                copy(
                    str(plain), str(part), driver="GTiff", copy_src_overviews="YES", tiled="YES", blockxsize=BLOCK_PX,
                    blockysize=BLOCK_PX, interleave="pixel", photometric="RGB", alpha="NO", bigtiff="IF_SAFER",
                    num_threads=1, **(LOSSLESS if nir else LOSSY),
                )  # fmt: skip
            plain.unlink()
        finally:
            with _writing(path):
                file.close()


def _overviews(grid: RasterGrid) -> list[int]:
    """Return by how much overviews are smaller, until one fits a block."""
    factors: list[int] = []
    longest = max(grid.width_px, grid.height_px)
    while longest > BLOCK_PX << len(factors):
        factors.append(2 << len(factors))
    return factors


@contextmanager
def _writing(path: Path) -> Iterator[None]:
    """Turn what GDAL raises into an error that says what stands on disk."""
    try:
        yield
    except (RasterioError, rasterio._err.CPLE_BaseError) as error:
        raise output_error(path, OSError(str(error.__cause__ or error))) from error
