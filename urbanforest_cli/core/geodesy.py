"""A flat scene laid on the round Earth: grid metres about an origin to the frame that stands on the ellipsoid there.

Grid north is not true north, a metre of the grid is not quite a metre, and 5 km from the origin the ground lies 2 m
below the plane that touches it there. So every position goes through the Earth's own axes (EPSG:4978), in float64.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.crs import transformer
from urbanforest_cli.core.scenery import Origin

FloatArray = NDArray[np.float64]

LONGITUDE_LATITUDE_HEIGHT = "EPSG:4979"
EARTH_CENTRED = "EPSG:4978"
TURN_STEP_M = 10.0


def root_transform(origin: Origin, *, ground_height_m: float = 0.0) -> FloatArray:
    """Return (4, 4) what brings east, north and up about the origin to the Earth's own axes, in metres.

    Parameters
    ----------
    origin
        Its `height_m` is above the ground of the scene.
    ground_height_m
        Height of that ground above the ellipsoid of WGS 84.
    """
    longitude, latitude, height = _geodetic(origin, np.zeros((1, 3)), ground_height_m)[0]
    away, up = np.radians(longitude), np.radians(latitude)
    matrix = np.eye(4)
    matrix[:3, 0] = -np.sin(away), np.cos(away), 0.0
    matrix[:3, 1] = -np.sin(up) * np.cos(away), -np.sin(up) * np.sin(away), np.cos(up)
    matrix[:3, 2] = np.cos(up) * np.cos(away), np.cos(up) * np.sin(away), np.sin(up)
    matrix[:3, 3] = _earth_centred(np.array([[longitude, latitude, height]]))[0]
    return matrix


def to_enu(origin: Origin, xyz_m: FloatArray, *, ground_height_m: float = 0.0) -> FloatArray:
    """Return (n, 3) east, north and up about the origin of grid positions (n, 3) about the same origin.

    z of the input is a height along the plumb line, so a flat scene comes back curved as the Earth is.
    """
    matrix = root_transform(origin, ground_height_m=ground_height_m)
    centred = _earth_centred(_geodetic(origin, xyz_m, ground_height_m)) - matrix[:3, 3]
    return np.asarray(centred @ matrix[:3, :3])


def from_earth_centred(origin: Origin, xyz_m: FloatArray, *, ground_height_m: float = 0.0) -> FloatArray:
    """Return (n, 3) easting, northing in the origin's CRS and height above the scene's ground, of places on Earth."""
    if not len(xyz_m):
        return np.zeros((0, 3))
    back = transformer(EARTH_CENTRED, LONGITUDE_LATITUDE_HEIGHT)
    longitude, latitude, height = back.transform(xyz_m[:, 0], xyz_m[:, 1], xyz_m[:, 2])
    x, y = transformer("EPSG:4326", origin.crs.to_wkt()).transform(longitude, latitude)
    return np.column_stack([x, y, height - ground_height_m])


def frame_turn_rad(origin: Origin, xyz_m: FloatArray) -> FloatArray:
    """Return (n,) how far the grid's axes are turned, counter-clockwise, in the frame of `to_enu`."""
    ahead = xyz_m + np.array([TURN_STEP_M, 0.0, 0.0])
    along = to_enu(origin, ahead) - to_enu(origin, xyz_m)
    return np.asarray(np.arctan2(along[:, 1], along[:, 0]))


def _geodetic(origin: Origin, xyz_m: FloatArray, ground_height_m: float) -> FloatArray:
    """Return (n, 3) longitude, latitude in degrees and height above the ellipsoid."""
    if not len(xyz_m):
        return np.zeros((0, 3))
    longitude, latitude = transformer(origin.crs.to_wkt(), "EPSG:4326").transform(
        xyz_m[:, 0] + origin.easting_m, xyz_m[:, 1] + origin.northing_m
    )
    return np.column_stack([longitude, latitude, xyz_m[:, 2] + origin.height_m + ground_height_m])


def _earth_centred(geodetic: FloatArray) -> FloatArray:
    if not len(geodetic):
        return np.zeros((0, 3))
    ahead = transformer(LONGITUDE_LATITUDE_HEIGHT, EARTH_CENTRED)
    return np.column_stack(ahead.transform(geodetic[:, 0], geodetic[:, 1], geodetic[:, 2]))
