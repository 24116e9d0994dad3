"""Rasters of the canopy: cloud-optimised GeoTIFFs in the working CRS, with their provenance as a tag."""

from __future__ import annotations

import json
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any, Literal

import numpy as np
import rasterio
from numpy.typing import NDArray
from pyproj import CRS
from rasterio.errors import NotGeoreferencedWarning, RasterioError
from rasterio.shutil import copy
from rasterio.windows import Window

from urbanforest_cli.core.errors import InputError, OutputError
from urbanforest_cli.core.publish import publish

Kind = Literal["height", "cover"]

TAG = "urbanforest"
BLOCK_PX = 512
CACHE_BYTES = 64 << 20
NODATA = {"float32": -9999.0, "uint8": 255.0}
ABOUT: dict[Kind, tuple[str, str, str]] = {
    "height": ("canopy height above the ground, 0 where there is none", "m", "NEAREST"),
    "cover": ("share of the cell under leaves", "percent", "AVERAGE"),
}
"""For each kind of raster what its values are, their unit, and how overviews are made."""


def write_canopy(
    path: Path,
    values: NDArray[np.float32] | NDArray[np.uint8],
    kind: Kind,
    *,
    west_m: float,
    north_m: float,
    cell_m: float,
    crs: CRS,
    provenance: Mapping[str, Any],
) -> None:
    """Publish a raster as a cloud-optimised GeoTIFF.

    Parameters
    ----------
    values
        (rows, cols), the first row northernmost; float32 metres, or uint8 percent.
    kind
        What they are.
    west_m, north_m, cell_m
        Upper left corner and side of a cell, in metres of `crs`.
    crs
        Projected, in metres.

    Raises
    ------
    OutputError
        It could not be written whole.
    """
    meaning, unit, resampling = ABOUT[kind]
    rows, cols = values.shape
    place = rasterio.Affine(cell_m, 0.0, west_m, 0.0, -cell_m, north_m)

    def verify(part: Path) -> None:
        with rasterio.open(part) as file:
            if (file.height, file.width) != values.shape or file.tags().get(TAG) is None:
                raise OutputError("the raster was not written whole", where=path)

    # Written in memory first: a full disk is then told by the system, not by what the TIFF library makes of it.
    # A plain TIFF goes before, since the driver of cloud-optimised ones holds a whole raster unpacked to be written to.
    with (
        rasterio.Env(GDAL_PAM_ENABLED="NO", GDAL_CACHEMAX=CACHE_BYTES),
        rasterio.MemoryFile() as plain,
        rasterio.MemoryFile() as memory,
    ):
        with plain.open(
            driver="GTiff", height=rows, width=cols, count=1, dtype=values.dtype,
            crs=rasterio.crs.CRS.from_wkt(crs.to_wkt()), transform=place, nodata=NODATA[str(values.dtype)],
            compress="DEFLATE", zlevel=1, tiled=True, blockxsize=BLOCK_PX, blockysize=BLOCK_PX, bigtiff="IF_SAFER",
        ) as file:  # fmt: skip
            for start in range(0, rows, BLOCK_PX):
                band = values[start : start + BLOCK_PX]
                file.write(band[None], [1], window=Window(0, start, cols, len(band)))
            file.set_band_description(1, meaning)
            file.set_band_unit(1, unit)
            file.update_tags(**{TAG: json.dumps(dict(provenance), ensure_ascii=True, allow_nan=False)})
        copy(
            plain.name, memory.name, driver="COG", compress="DEFLATE", predictor="YES", blocksize=BLOCK_PX,
            overview_resampling=resampling, bigtiff="IF_SAFER", num_threads=1,
        )  # fmt: skip
        with publish(path, verify=verify) as part:
            part.write_bytes(memory.getbuffer())


def read_provenance(path: Path) -> dict[str, Any] | None:
    """Read what made a raster from what; None where it does not say.

    Raises
    ------
    InputError
        It is not there, or is no raster.
    """
    try:
        with (
            warnings.catch_warnings(action="ignore", category=NotGeoreferencedWarning),
            rasterio.open(path, driver="GTiff") as file,
        ):
            text = file.tags().get(TAG)
        found = json.loads(text) if text else None
    except (RasterioError, ValueError, RecursionError) as error:
        raise InputError(
            "not a raster of urbanforest, or not a whole one", where=path, found=str(error),
            next_step="run `urbanforest export` again",
        ) from error  # fmt: skip
    return found if isinstance(found, dict) else None
