"""Small rasters of any make for tests."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

import numpy as np
import rasterio
from rasterio.enums import ColorInterp

UTM = "EPSG:32611"
PLACE = (0.6, 0.0, 500_000.0, 0.0, -0.6, 3_700_000.0)


def colours(height_px: int = 40, width_px: int = 60, bands: int = 3) -> np.ndarray:
    """Samples of 8 bits that differ from pixel to pixel and band to band, none 0 or 255."""
    return np.random.default_rng(7).integers(1, 255, (bands, height_px, width_px), dtype=np.uint8)


def write_raster(
    path: Path,
    values: np.ndarray,
    *,
    crs: str | None = UTM,
    place: tuple[float, ...] | None = PLACE,
    driver: str = "GTiff",
    meanings: str | None = None,
    names: tuple[str, ...] | None = None,
    palette: dict[int, tuple[int, int, int, int]] | None = None,
    mask: np.ndarray | None = None,
    **options: Any,
) -> Path:
    """Write (band, row, col) samples; `meanings` are those of the bands, by first letter (x: none)."""
    count, height_px, width_px = values.shape
    if place is not None:
        options["transform"] = rasterio.Affine(*place)
    letters = {entry.name[0]: entry for entry in ColorInterp if entry.name in ("red", "green", "blue", "alpha", "nir")}
    with warnings.catch_warnings(), rasterio.Env(GDAL_TIFF_INTERNAL_MASK=True):
        warnings.simplefilter("ignore")
        with rasterio.open(
            path, "w", driver=driver, width=width_px, height=height_px, count=count, dtype=values.dtype, crs=crs,
            **options,
        ) as file:  # fmt: skip
            if meanings is not None:
                file.colorinterp = [letters.get(letter, ColorInterp.undefined) for letter in meanings]
            if names is not None:
                file.descriptions = names
            if palette is not None:
                file.write_colormap(1, palette)
            file.write(values)
            if mask is not None:
                file.write_mask(mask)
    return path
