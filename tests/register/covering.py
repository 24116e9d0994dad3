"""Coverage maps of discs and boxes for tests: exact percentages of the ground, in any grid."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import shapely
from pyproj import CRS

from urbanforest_cli.core.crs import reproject
from urbanforest_cli.core.polygon_raster import raster_shares
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.coverage import CoverageWriter

UTM = CRS.from_epsg(32633)
WEST, SOUTH = 500_000.0, 5_300_000.0


def disc(x: float, y: float, radius: float) -> Any:
    """A disc about a place counted from the corner of the test city."""
    return shapely.buffer(shapely.Point(WEST + x, SOUTH + y), radius, quad_segs=32)


def shares_of(shapes: list[Any], grid: RasterGrid) -> np.ndarray:
    """Percentages (row, col) of square pixels that shapes cover."""
    a, _, west, _, _, north = grid.transform
    union = shapely.union_all(np.array([*shapes, shapely.Polygon()], dtype=object))
    if union.is_empty:
        return np.zeros((grid.height_px, grid.width_px), dtype=np.uint8)
    share = raster_shares(np.array([union], dtype=object), west, north, a, grid.height_px, grid.width_px)[0]
    return np.rint(100 * share).astype(np.uint8)


def square_grid(bounds: tuple[float, float, float, float], size: float, crs: CRS = UTM) -> RasterGrid:
    """A grid of square pixels over bounds counted from the corner of the test city."""
    west, south, east, north = bounds
    width, height = round((east - west) / size), round((north - south) / size)
    return RasterGrid(width, height, (size, 0.0, WEST + west, 0.0, -size, SOUTH + north), crs)


def write_map(
    path: Path,
    shapes: list[Any],
    *,
    bounds: tuple[float, float, float, float] = (-30.0, -30.0, 210.0, 210.0),
    size: float = 0.6,
    unknown: Any = None,
    values: np.ndarray | None = None,
    provenance: dict[str, Any] | None = None,
) -> Path:
    """Write a map of the canopy; `unknown` is ground that it does not know."""
    grid = square_grid(bounds, size)
    percent = shares_of(shapes, grid) if values is None else values
    if unknown is not None:
        percent = np.where(shares_of([unknown], grid) >= 50, 255, percent).astype(np.uint8)
    return write_percent(path, percent, grid, provenance)


def write_percent(path: Path, percent: np.ndarray, grid: RasterGrid, provenance: dict[str, Any] | None = None) -> Path:
    with CoverageWriter(path, grid, ("canopy",), {"format": "cover", **(provenance or {})}) as out:
        out.write(0, 0, percent[None])
    return path


def sampled_map(path: Path, shapes: list[Any], crs: CRS, size: float, margin: float = 30.0) -> Path:
    """Write a map in another CRS, its pixels sampled at 5 x 5 places each; `size` in that CRS's unit."""
    whole = shapely.box(WEST - margin, SOUTH - margin, WEST + 180 + margin, SOUTH + 180 + margin)
    west, south, east, north = shapely.bounds(reproject(np.array([shapely.segmentize(whole, 10)]), UTM, crs))[0]
    width, height = int((east - west) / size) + 1, int((north - south) / size) + 1
    grid = RasterGrid(width, height, (size, 0.0, west, 0.0, -size, north), crs)
    fine = (np.arange(width * 5) + 0.5) / 5, (np.arange(height * 5) + 0.5) / 5
    x, y = np.meshgrid(west + fine[0] * size, north - fine[1] * size)
    union = shapely.union_all(reproject(np.array(shapes, dtype=object), UTM, crs))
    shapely.prepare(union)
    inside = shapely.contains_xy(union, x, y).reshape(height, 5, width, 5).mean(axis=(1, 3))
    return write_percent(path, np.rint(100 * inside).astype(np.uint8), grid)
