"""Which CRS a file's numbers are in: the one it states, or the one assumed for it where it states none that fits."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS
from pyproj.exceptions import CRSError as ProjCrsError

from urbanforest_cli.core.crs import COORDINATE_LIMIT_M
from urbanforest_cli.core.errors import CrsError, InputError, LimitError
from urbanforest_cli.core.notices import Notices

OUTSIDE_TOLERATED = 0.1
DEGREES_EXTENT_LEAST = 1.0


def row_names(where: str, fids: NDArray[np.int64]) -> list[str]:
    """Name the first rows of many, as examples for a notice."""
    return [f"{Path(where).name} row {fid}" for fid in fids[:5]]


def crs_of(stated: object, where: str) -> CRS | None:
    """Turn what a file or a person states into a CRS of two axes; None where that is no place on Earth."""
    if not stated:
        return None
    try:
        crs = CRS.from_user_input(stated)
        if crs.name.lower().startswith(("undefined cartesian", "undefined srs", "unknown engineering")):
            return None
        return crs.to_2d()
    except ProjCrsError as error:
        raise CrsError(
            "the coordinate reference system is not known", where=where, found=str(stated)[:80],
            next_step="give it with --assume-crs EPSG:...",
        ) from error  # fmt: skip


def settle_crs(frame: pd.DataFrame, stated: CRS | None, assumed: str | CRS | None, where: str, notices: Notices) -> CRS:
    """Choose between the CRS a file states and the one assumed, and check that the numbers can be in it.

    Geometries that lie outside it are set to None in `frame` and counted, as long as they are few.

    Raises
    ------
    CrsError, LimitError
        No CRS, or one that too many of the numbers contradict.
    """
    shapes = frame["geometry"].to_numpy()
    bounds = shapely.bounds(shapes)
    finite = np.isfinite(bounds).all(axis=1)
    if stated is not None and stated.name.lower().startswith("undefined geographic"):
        notices.add(
            "W_CRS_UNDEFINED", "layers in degrees of an undefined datum, taken as WGS 84", 1, [Path(where).name]
        )
        stated = CRS.from_epsg(4326)
    crs = stated
    if assumed is not None and (stated is None or _share_outside(bounds[finite], stated) > OUTSIDE_TOLERATED):
        crs = assumed if isinstance(assumed, CRS) else crs_of(assumed, "--assume-crs")
        notices.add("W_CRS_ASSUMED", "files read in the CRS assumed for them", 1, [Path(where).name])
        _refuse_hidden_degrees(crs, bounds[finite], where)
    if crs is None:
        raise CrsError(
            "no coordinate reference system",
            where=where,
            expected="a CRS in the file (shapefile: a .prj beside it)",
            next_step="give it with --assume-crs EPSG:...",
        )
    outside = np.zeros(len(shapes), dtype=bool)
    outside[finite] = _outside(bounds[finite], crs)
    if outside.sum() > OUTSIDE_TOLERATED * max(1, int(finite.sum())):
        raise _outside_error(crs, bounds[outside], where)
    frame.loc[outside, "geometry"] = None
    notices.add("W_OUTSIDE", "geometries outside their CRS, not read", int(outside.sum()),
                row_names(where, frame.index.to_numpy()[outside]))  # fmt: skip
    return crs


def _outside(bounds: NDArray[np.float64], crs: CRS) -> NDArray[np.bool_]:
    west, south, east, north = bounds.T
    if crs.is_geographic and not crs.is_derived:
        return np.asarray((west < -360) | (east > 360) | (south < -90.000001) | (north > 90.000001))
    return np.asarray(np.abs(bounds).max(axis=1, initial=0.0) > COORDINATE_LIMIT_M)


def _share_outside(bounds: NDArray[np.float64], crs: CRS) -> float:
    return float(_outside(bounds, crs).mean()) if len(bounds) else 0.0


def _outside_error(crs: CRS, bounds: NDArray[np.float64], where: str) -> InputError:
    west, south = bounds[:, :2].min(axis=0)
    east, north = bounds[:, 2:].max(axis=0)
    found = f"x {west:.6g} to {east:.6g}, y {south:.6g} to {north:.6g} in {crs.name}"
    if crs.is_geographic:
        return CrsError(
            "coordinates are not degrees", where=where, found=found,
            expected="longitudes within 180 and latitudes within 90 degrees",
            next_step="state the true CRS with --assume-crs EPSG:...",
        )  # fmt: skip
    return LimitError(
        "coordinates are too large", where=where, found=found, expected=f"at most {COORDINATE_LIMIT_M:g} either way",
        next_step="state the true CRS with --assume-crs EPSG:...",
    )  # fmt: skip


def _refuse_hidden_degrees(crs: CRS | None, bounds: NDArray[np.float64], where: str) -> None:
    """Refuse a whole layer that would be smaller than a metre but reads well as degrees."""
    if crs is None or not crs.is_projected or len(bounds) == 0:
        return
    west, south = bounds[:, :2].min(axis=0)
    east, north = bounds[:, 2:].max(axis=0)
    small = max(east - west, north - south) < DEGREES_EXTENT_LEAST
    if small and east > west and max(-west, east) <= 180 and max(-south, north) <= 90:
        raise CrsError(
            "the numbers look like degrees, not metres",
            where=where,
            found=f"x {west:.6g} to {east:.6g}, y {south:.6g} to {north:.6g} in {crs.name}",
            expected="a layer of more than a metre",
            next_step="state the true CRS, perhaps --assume-crs EPSG:4326",
        )
