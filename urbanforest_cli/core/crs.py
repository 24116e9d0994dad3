"""Coordinates: from whatever the user has to metres, and back."""

from __future__ import annotations

import math
from functools import lru_cache
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from pyproj import CRS, Proj, Transformer
from pyproj.aoi import AreaOfInterest
from pyproj.database import query_utm_crs_info

from urbanforest_cli.core.errors import CrsError

DISTORTION_TOLERATED = 0.005
COORDINATE_LIMIT_M = 1e8

GeometryArray = NDArray[Any]


def is_metric(crs: CRS) -> bool:
    """Tell whether both axes of a projected CRS are in metres."""
    return bool(crs.is_projected) and all(math.isclose(axis.unit_conversion_factor, 1.0) for axis in crs.axis_info[:2])


def length_distortion(crs: CRS, longitude: float, latitude: float) -> float:
    """Return the largest relative error of a length at a place, 0 for a true scale."""
    factors = Proj(crs).get_factors(longitude, latitude)
    scales = (factors.tissot_semimajor, factors.tissot_semiminor)
    return max(abs(scale - 1.0) for scale in scales)


def working_crs(crs: CRS | None, bounds: tuple[float, float, float, float], *, where: object = None) -> CRS:
    """Choose the CRS in metres that the work is done in.

    A projected CRS in metres that keeps lengths to 0.5 % at the data's centre is used as it is; anything else
    is brought to the UTM zone of that centre.

    Parameters
    ----------
    crs
        CRS of the data.
    bounds
        West, south, east, north in that CRS.

    Raises
    ------
    CrsError
        No CRS, one that is not on Earth or has no path to longitude and latitude, or coordinates outside it.
    """
    if crs is None:
        raise CrsError(
            "no coordinate reference system",
            where=where,
            found="a file without a CRS",
            expected="a CRS, as EPSG code or WKT",
            next_step="give it with --assume-crs EPSG:...",
        )
    west, south, east, north = bounds
    if crs.is_geographic and not (-360 <= west <= east <= 360 and -90 <= south <= north <= 90):
        raise CrsError(
            "coordinates are not degrees",
            where=where,
            found=f"x {west:.6g} to {east:.6g}, y {south:.6g} to {north:.6g} in {crs.name}",
            expected="longitudes within 180 and latitudes within 90 degrees",
            next_step="state the true CRS with --assume-crs EPSG:...",
        )
    longitude, latitude = _centre(crs, bounds, where)
    if is_metric(crs) and length_distortion(crs, longitude, latitude) <= DISTORTION_TOLERATED:
        return crs
    return utm_crs(longitude, latitude)


def utm_crs(longitude: float, latitude: float) -> CRS:
    """Return the WGS 84 UTM zone of a place."""
    area = AreaOfInterest(longitude, latitude, longitude, latitude)
    found = query_utm_crs_info(datum_name="WGS 84", area_of_interest=area)
    if not found:
        raise CrsError(f"no UTM zone at longitude {longitude:.4f}, latitude {latitude:.4f}")
    return CRS.from_authority(found[0].auth_name, found[0].code)


def _centre(crs: CRS, bounds: tuple[float, float, float, float], where: object) -> tuple[float, float]:
    west, south, east, north = bounds
    try:
        longitude, latitude = transformer(crs.to_wkt(), "EPSG:4326").transform((west + east) / 2, (south + north) / 2)
    except Exception as error:  # pyproj raises several classes, one meaning: there is no path to the Earth
        raise CrsError(
            "this CRS cannot be brought to longitude and latitude",
            where=where,
            found=crs.name,
            expected="a CRS on Earth with a known relation to WGS 84",
            next_step="state the true CRS with --assume-crs EPSG:...",
        ) from error
    if not (math.isfinite(longitude) and math.isfinite(latitude) and abs(latitude) <= 90):
        raise CrsError(
            "coordinates lie outside the area of their CRS",
            where=where,
            found=f"x {west:.6g} to {east:.6g}, y {south:.6g} to {north:.6g} in {crs.name}",
            next_step="state the true CRS with --assume-crs EPSG:...",
        )
    return (longitude + 180) % 360 - 180, latitude


@lru_cache(maxsize=64)
def transformer(source: str, target: str) -> Transformer:
    """Return a cached transformer, always x before y."""
    return Transformer.from_crs(CRS.from_user_input(source), CRS.from_user_input(target), always_xy=True)


def reproject(geometries: GeometryArray, source: CRS, target: CRS) -> GeometryArray:
    """Bring an array of 2D geometries from one CRS to another; the same array where both are equal."""
    if source == target:
        return geometries
    change = transformer(source.to_wkt(), target.to_wkt())

    def move(xy: NDArray[np.float64]) -> NDArray[np.float64]:
        x, y = change.transform(xy[:, 0], xy[:, 1])
        return np.column_stack((x, y))

    return shapely.transform(geometries, move)


def reproject_xy(xy: NDArray[np.float64], source: CRS, target: CRS) -> NDArray[np.float64]:
    """Bring (n, 2) positions from one CRS to another."""
    if source == target or len(xy) == 0:
        return xy
    x, y = transformer(source.to_wkt(), target.to_wkt()).transform(xy[:, 0], xy[:, 1])
    return np.column_stack((x, y))
