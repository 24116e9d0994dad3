"""Where a raster file lies: its own georeference, checked, as a grid with the north up."""

from __future__ import annotations

import math
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import CRS
from pyproj.exceptions import ProjError

from urbanforest_cli.core.crs import COORDINATE_LIMIT_M, is_metric, transformer
from urbanforest_cli.core.errors import CrsError, InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.files.vector_crs import crs_of

SHEAR_TOLERATED_PX = 0.01
"""How far a corner may lie from where an unrotated image would have it."""
STRETCH_MOST = 10.0
"""Pixels in degrees are twice as high as wide at 60 degrees north, and ten times where nobody lives."""
SIDE_LEAST_M = 1e-4
EARTH_RADIUS_M = 6_378_137.0
RADIUS_TOLERATED = 0.01
_RESTATE = "state the true CRS with --assume-crs EPSG:..."
_WARP = "bring it to a north-up grid: gdalwarp -t_srs EPSG:... IN OUT.tif"
_ASSUME = "give it with --assume-crs EPSG:..."


def raster_grid(dataset: Any, path: Path, *, assume_crs: str | None, notices: Notices) -> tuple[RasterGrid, bool]:
    """Return where an open raster lies, and whether its rows run from south to north in the file.

    The grid always has the north up; whoever reads turns the rows of a file that has not.

    Parameters
    ----------
    dataset
        As rasterio opens it.
    assume_crs
        CRS of a file that states none, or one its numbers cannot be in.

    Raises
    ------
    InputError
        No place on the map, one by control points only, or a rotated one.
    CrsError
        No CRS, one that is not on Earth, or numbers that cannot be in it.
    """
    a, b, c, _, e, f = _transform(dataset, path)
    south_up = e > 0
    if south_up:
        c, f, e = c + b * dataset.height, f + e * dataset.height, -e
        notices.add("W_SOUTH_UP", "image files whose first row is the southernmost, turned", 1, [path.name])
    width, height = int(dataset.width), int(dataset.height)
    bounds = (c, f + e * height, c + a * width, f)
    if not all(math.isfinite(value) for value in bounds):
        raise InputError("the place on the map is not a number", where=path, found=bounds, next_step=_WARP)
    crs = _crs(dataset, path, bounds, assume_crs, notices)
    grid = RasterGrid(width, height, (a, 0.0, c, 0.0, e, f), crs)
    _check_place(grid, path)
    if not crs.is_geographic and not is_metric(crs):
        notices.add("W_CRS_UNIT", "image files in feet or another unit, brought to metres", 1, [path.name])
    return grid, south_up


def _transform(dataset: Any, path: Path) -> tuple[float, float, float, float, float, float]:
    a, b, c, d, e, f = (float(value) for value in tuple(dataset.transform)[:6])
    if dataset.transform.is_identity or a == 0 or e == 0:
        points = len(dataset.gcps[0])
        by = f"{points} ground control points" if points else "a camera model (RPC)" if dataset.rpcs else "no place"
        if points or dataset.rpcs:
            raise InputError("the image is not on a grid of the map", where=path, found=by,
                             expected="a geotransform", next_step=_WARP)  # fmt: skip
        if a == 0 or e == 0:
            raise InputError("the image is rotated or has no size", where=path, found=(a, b, c, d, e, f),
                             expected="columns to the east, rows to the south", next_step=_WARP)  # fmt: skip
        raise CrsError(
            "the image has no place on the map", where=path, found="no geotransform",
            expected="a GeoTIFF, or a world file beside it (.tfw, .pgw, .jgw)",
            next_step="georeference it, for instance with QGIS",
        )  # fmt: skip
    if abs(b) * dataset.height > SHEAR_TOLERATED_PX * abs(a) or abs(d) * dataset.width > SHEAR_TOLERATED_PX * abs(e):
        raise InputError("the image is rotated", where=path, found=f"geotransform {(a, b, c, d, e, f)}",
                         expected="columns to the east, rows to the south", next_step=_WARP)  # fmt: skip
    if a < 0:
        raise InputError("the image is mirrored", where=path, found="columns to the west", next_step=_WARP)
    return a, b, c, d, e, f


def _crs(
    dataset: Any,
    path: Path,
    bounds: tuple[float, float, float, float],
    assume_crs: str | None,
    notices: Notices,
) -> CRS:
    stated = crs_of(dataset.crs.to_wkt(), str(path)) if dataset.crs else None
    assumed = crs_of(assume_crs, "--assume-crs") if assume_crs is not None else None
    if assumed is not None and (stated is None or not _may_hold(stated, bounds)):
        stated = assumed
        notices.add("W_CRS_ASSUMED", "files read in the CRS assumed for them", 1, [path.name])
    elif assumed is not None and stated is not None and not assumed.equals(stated, ignore_axis_order=True):
        notices.add("W_CRS_KEPT", "files that state a CRS and were read in that, not in the one of --assume-crs", 1,
                    [f"{path.name} in {stated.name}"])  # fmt: skip
    if stated is None:
        raise CrsError("no coordinate reference system", where=path, expected="a CRS in the file, or a .prj beside it",
                       next_step=_ASSUME)  # fmt: skip
    return stated


def _may_hold(crs: CRS, bounds: tuple[float, float, float, float]) -> bool:
    if crs.is_geographic:
        west, south, east, north = bounds
        return -360 <= west <= east <= 360 and -90.000001 <= south <= north <= 90.000001
    return max(abs(value) for value in bounds) <= COORDINATE_LIMIT_M


def _check_place(grid: RasterGrid, path: Path) -> None:
    """Refuse places that are not on Earth, and pixels of no size or far from square."""
    crs, (west, south, east, north) = grid.crs, grid.bounds
    ellipsoid = crs.ellipsoid
    alien = ellipsoid is not None and abs(ellipsoid.semi_major_metre / EARTH_RADIUS_M - 1) > RADIUS_TOLERATED
    if crs.is_geocentric or alien or not (crs.is_geographic or crs.is_projected):
        raise CrsError("this CRS is no map of the Earth", where=path, found=crs.name,
                       expected="degrees, or a projection of the Earth", next_step=_ASSUME)  # fmt: skip
    numbers = f"x {west:.6g} to {east:.6g}, y {south:.6g} to {north:.6g} in {crs.name}"
    if not _may_hold(crs, grid.bounds):
        what = "coordinates are not degrees" if crs.is_geographic else "coordinates are too large"
        raise CrsError(what, where=path, found=numbers, next_step=_RESTATE)
    try:
        xs, ys = np.array([west, west, east, east]), np.array([south, north, south, north])
        corners = np.array(transformer(crs.to_wkt(), "EPSG:4326").transform(xs, ys))
        wide_m, high_m = grid.resolution_m if np.isfinite(corners).all() else (math.nan, math.nan)
    except ProjError as error:
        raise CrsError("the image's CRS cannot be brought to longitude and latitude", where=path, found=crs.name,
                       next_step=_ASSUME) from error  # fmt: skip
    if not (math.isfinite(wide_m) and math.isfinite(high_m)):
        raise CrsError("the image reaches beyond the area of its CRS", where=path, found=numbers, next_step=_RESTATE)
    if min(wide_m, high_m) < SIDE_LEAST_M or not 1 / STRETCH_MOST <= wide_m / high_m <= STRETCH_MOST:
        raise LimitError("pixels of an odd shape", where=path, found=f"{wide_m:.3g} x {high_m:.3g} m",
                         expected=f"more than {SIDE_LEAST_M:g} m, at most {STRETCH_MOST:g} : 1",
                         next_step=_WARP)  # fmt: skip
