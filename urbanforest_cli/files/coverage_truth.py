"""What a coverage map is held against, on the map's own pixels: another raster, polygons, or points of trees."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from rasterio import Affine
from rasterio import crs as raster_crs
from rasterio.features import rasterize
from rasterio.warp import Resampling, reproject

from urbanforest_cli.core import crs as core_crs
from urbanforest_cli.core.coverage_model import CANOPY, UNKNOWN
from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.coverage import CoverageReader, open_coverage
from urbanforest_cli.files.vectors import read_vector, split_source

Percent = NDArray[np.uint8]
Window = tuple[int, int, int, int]
"""First row and column, rows and columns."""
Reads = Callable[[Window], Percent]
"""Returns (class, rows, cols) percentages of a window of the map, 255 where unknown."""

RASTER_SUFFIXES = (".tif", ".tiff", ".png", ".jp2", ".jpg", ".jpeg")
FINER = 4
"""Rows and columns that a pixel is cut into to measure how much of it polygons cover."""
EDGE_POINTS = 21
SOURCE_LIMIT_PX = 1 << 26


@contextmanager
def open_truth(
    source: str, grid: RasterGrid, classes: tuple[str, ...] | None, assume_crs: str | None, notices: Notices
) -> Iterator[tuple[tuple[str, ...], Reads]]:
    """Open a truth; yield its classes and what reads them on the pixels of a map.

    Parameters
    ----------
    source
        Raster of masks or percentages, unknown where the map reaches beyond it; or ``FILE[:LAYER]`` of polygons,
        beyond which nothing is covered.
    grid
        Of the map.
    classes
        What polygons or a single band show; the canopy where none is given.
    assume_crs
        CRS of a file that states none.

    Raises
    ------
    InputError
        The file cannot be used.
    LimitError
        Reading: the raster has pixels by the million within one of the map.
    """
    if Path(source).suffix.lower() in RASTER_SUFFIXES:
        with open_coverage(Path(source), assume_crs=assume_crs, notices=notices) as reader:
            names = classes if classes is not None and len(reader.classes) == len(classes) == 1 else reader.classes
            yield names, _raster_truth(reader, grid)
        return
    path, layer = split_source(source)
    frame = read_vector(path, layer=layer, columns=(), kinds=("polygon",), assume_crs=assume_crs, notices=notices)
    shapes = frame.geometry.to_numpy()
    shapes = shapes[np.isfinite(shapely.bounds(shapes)).all(axis=1)]
    notices.add("W_TRUTH_EMPTY", "polygons of the truth without a place", len(frame) - len(shapes))
    shapes = core_crs.reproject(shapes, CRS.from_user_input(frame.crs), grid.crs)
    shapes = shapely.get_parts(shapely.get_parts(shapes))  # of collections, those of their parts
    shapes = shapes[shapely.get_type_id(shapes) == shapely.GeometryType.POLYGON]
    tree = shapely.STRtree(shapes)
    yield (classes or (CANOPY,))[:1], lambda window: rasterised(shapes, tree, grid.window(*window))[None]


def _raster_truth(reader: CoverageReader, grid: RasterGrid) -> Reads:
    if same_pixels(reader.grid, grid):
        return lambda window: reader.read(*window)

    def read(window: Window) -> Percent:
        row, col, rows, cols = window
        part = grid.window(*window)
        over = window_over(reader.grid, part)
        if over is None:
            return np.full((len(reader.classes), rows, cols), UNKNOWN, dtype=np.uint8)
        if over[2] * over[3] <= SOURCE_LIMIT_PX:
            return brought_to(reader.read(*over), reader.grid.window(*over), part)
        if rows * cols == 1:
            raise LimitError(
                "the truth is too fine for the map", where=reader.path,
                found=f"{over[2] * over[3]:,} of its pixels in one of the map",
                next_step="make it coarser first: gdalwarp -tr ... -r average IN OUT.tif",
            )  # fmt: skip
        along, half = (1, rows // 2) if rows > cols else (2, cols // 2)
        first = (row, col, half, cols) if along == 1 else (row, col, rows, half)
        second = (row + half, col, rows - half, cols) if along == 1 else (row, col + half, rows, cols - half)
        return np.concatenate([read(first), read(second)], axis=along)

    return read


def read_points(source: str, grid: RasterGrid, assume_crs: str | None, notices: Notices) -> NDArray[np.float64]:
    """Return rows and columns (n, 2) of points on a map, from the outer corner of its first pixel.

    Those beside it are counted and left out.

    Raises
    ------
    InputError
        The file cannot be used, or none of its points lies on the map.
    """
    path, layer = split_source(source)
    frame = read_vector(path, layer=layer, columns=(), kinds=("point",), assume_crs=assume_crs, notices=notices)
    shapes = frame.geometry.to_numpy()
    shapes = shapely.get_parts(shapes[~(shapely.is_missing(shapes) | shapely.is_empty(shapes))])
    xy = shapely.get_coordinates(core_crs.reproject(shapes, CRS.from_user_input(frame.crs), grid.crs))
    west, _, _, north = grid.bounds
    wide, high = grid.pixel_size
    place = np.column_stack(((north - xy[:, 1]) / high, (xy[:, 0] - west) / wide))
    inside = ((place >= 0) & (place < (grid.height_px, grid.width_px))).all(axis=1)
    if not inside.any():
        raise InputError("none of the trees lies on the map", where=source, found=f"{len(xy)} points",
                         next_step="check their CRS (--assume-crs), and that both are of one place")  # fmt: skip
    notices.add("W_TREES_OUTSIDE", "trees that lie beside the map", int((~inside).sum()))
    return place[inside]


def same_pixels(first: RasterGrid, second: RasterGrid) -> bool:
    """Tell whether two grids have the same pixels, to a hundredth of one."""
    if (first.width_px, first.height_px) != (second.width_px, second.height_px) or first.crs != second.crs:
        return False
    tolerance = min(first.pixel_size) / 100
    return all(abs(a - b) <= tolerance for a, b in zip(first.bounds, second.bounds, strict=True))


def window_over(source: RasterGrid, part: RasterGrid) -> Window | None:
    """Return the window of a raster that covers a part of the map and a pixel around; None if they are apart."""
    west, south, east, north = part.bounds
    if source.crs != part.crs:
        change = core_crs.transformer(part.crs.to_wkt(), source.crs.to_wkt())
        west, south, east, north = change.transform_bounds(west, south, east, north, densify_pts=EDGE_POINTS)
    if not all(math.isfinite(edge) for edge in (west, south, east, north)):
        return None
    left, _, _, top = source.bounds
    wide, high = source.pixel_size
    first_col, last_col = max(math.floor((west - left) / wide) - 1, 0), math.ceil((east - left) / wide) + 1
    first_row, last_row = max(math.floor((top - north) / high) - 1, 0), math.ceil((top - south) / high) + 1
    rows, cols = min(last_row, source.height_px) - first_row, min(last_col, source.width_px) - first_col
    if rows <= 0 or cols <= 0:
        return None
    return first_row, first_col, rows, cols


def brought_to(values: Percent, source: RasterGrid, part: RasterGrid) -> Percent:
    """Average percentages (class, rows, cols) of one grid over the pixels of another; 255 where none is known."""
    result = np.full((len(values), part.height_px, part.width_px), UNKNOWN, dtype=np.uint8)
    for layer, target in zip(values, result, strict=True):
        reproject(
            layer, target, src_transform=Affine(*source.transform), src_crs=_crs(source), src_nodata=UNKNOWN,
            dst_transform=Affine(*part.transform), dst_crs=_crs(part), dst_nodata=UNKNOWN,
            resampling=Resampling.average,
        )  # fmt: skip
    return result


def rasterised(polygons: NDArray[np.object_], tree: shapely.STRtree, part: RasterGrid) -> Percent:
    """Return the share of each pixel (rows, cols) that polygons cover, in percent.

    Parameters
    ----------
    polygons
        In the CRS of `part`.
    tree
        Over them.
    """
    near = polygons[np.sort(tree.query(shapely.box(*part.bounds)))]
    if len(near) == 0:
        return np.zeros((part.height_px, part.width_px), dtype=np.uint8)
    a, b, c, d, e, f = part.transform
    fine = rasterize(
        near, out_shape=(part.height_px * FINER, part.width_px * FINER), dtype=np.uint8,
        transform=Affine(a / FINER, b / FINER, c, d / FINER, e / FINER, f),
    )  # fmt: skip
    share = fine.reshape(part.height_px, FINER, part.width_px, FINER).mean(axis=(1, 3))
    return np.asarray(np.rint(100 * share), dtype=np.uint8)


def _crs(grid: RasterGrid) -> raster_crs.CRS:
    return raster_crs.CRS.from_wkt(grid.crs.to_wkt())
