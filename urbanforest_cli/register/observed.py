"""Known plants that are kept as they are: where they stand, what is known of them, and the lot they belong to."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.notices import Notices
from urbanforest_cli.register.layers import as_text, shapes_in_metres

LAYER = "observed_plants"
ID_COLUMNS = ("observed_id", "plant_id", "tree_id", "osm_id", "id")
DIAMETER_COLUMNS = ("crown_diameter_m", "crown_diameter", "diameter_crown", "canopy_diameter_m")
RADIUS_COLUMNS = ("crown_radius_m", "crown_radius")
HEIGHT_COLUMNS = ("height_m", "height", "tree_height_m")
SPECIES_COLUMNS = ("species", "species_id", "scientific_name", "genus")
WIDEST_CROWN_M = 60.0
TALLEST_M = 130.0
"""The limits of species files."""
SAME_PLACE_M = 0.01
ORIGINS = ("sketch", "register", "road")
"""A plant in several units belongs to the first of these, and of one origin to the smallest."""

Shapes = NDArray[Any]


def observed_plants_of(
    frame: gpd.GeoDataFrame,
    unit_ids: NDArray[np.object_],
    unit_shapes: Shapes,
    unit_origins: NDArray[np.object_],
    *,
    project: Callable[[gpd.GeoDataFrame], Shapes],
    working: CRS,
    notices: Notices,
) -> gpd.GeoDataFrame:
    """Return the layer ``observed``: plants of a city's layer ``observed_plants`` that stand in a lot.

    Columns are known by their names, whatever their case and underscores: a crown's diameter or radius, a height, a
    species. What states no size keeps none. Plants outside all lots, and those at the very place of another, are left
    out and counted.

    Parameters
    ----------
    frame
        The layer as read, in any CRS.
    unit_ids, unit_shapes, unit_origins
        Of the lots, strips and sketches, polygons in metres; None for those that are not used.
    project
        Brings a frame's shapes to metres.
    working
        The CRS in metres.
    """
    shapes = shapes_in_metres(frame, "observed plants", project, notices)
    points, row = shapely.get_parts(shapes, return_index=True)
    is_point = shapely.get_type_id(points) == 0
    missing = len(frame) - len(np.unique(row[is_point]))
    notices.add("W_OBSERVED_EMPTY", "observed plants without a position, left out", missing)
    points, row = points[is_point], row[is_point]
    unit = unit_of(points, unit_shapes, unit_origins)
    notices.add("W_OBSERVED_OUTSIDE", "observed plants in no lot, left out", int((unit < 0).sum()))
    points, row, unit = points[unit >= 0], row[unit >= 0], unit[unit >= 0]
    first = first_at_place(shapely.get_coordinates(points))
    notices.add("W_OBSERVED_TWINS", "observed plants at the very place of another, left out", int((~first).sum()))
    points, row, unit = points[first], row[first], unit[first]

    columns = {_plain(name): name for name in reversed(frame.columns)}
    diameter = _sizes(frame, _found(columns, DIAMETER_COLUMNS), WIDEST_CROWN_M, notices)
    radius = _sizes(frame, _found(columns, RADIUS_COLUMNS), WIDEST_CROWN_M / 2, notices)
    height = _sizes(frame, _found(columns, HEIGHT_COLUMNS), TALLEST_M, notices)
    radius = np.where(np.isnan(radius), diameter / 2, radius)
    notices.add("W_OBSERVED_CROWN", "observed plants whose crown's size is not known, their lot's mean taken",
                int(np.isnan(radius[row]).sum()))  # fmt: skip
    return gpd.GeoDataFrame(
        {
            "observed_id": _ids(frame, columns, row),
            "lot_id": unit_ids[unit],
            "crown_radius_m": radius[row],
            "height_m": height[row],
            "species": _species(frame, _found(columns, SPECIES_COLUMNS))[row],
        },
        geometry=points,
        crs=working,
    )


def unit_of(points: Shapes, shapes: Shapes, origins: NDArray[np.object_]) -> NDArray[np.int64]:
    """Return the row of the unit that each point belongs to, -1 for none."""
    rank = np.array([ORIGINS.index(str(origin)) if origin in ORIGINS else len(ORIGINS) for origin in origins], np.int64)
    order = np.lexsort((np.arange(len(shapes)), np.nan_to_num(shapely.area(shapes)), rank))
    found = np.full(len(points), len(order), dtype=np.int64)
    if len(order):
        point, place = shapely.STRtree(shapes[order]).query(points, predicate="intersects")
        np.minimum.at(found, point, place)
    return np.where(found < len(order), np.append(order, -1)[found], -1)


def first_at_place(xy: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Tell which of (n, 2) positions in metres are the first at theirs, to a centimetre."""
    first = np.zeros(len(xy), dtype=bool)
    first[np.unique(np.rint(xy / SAME_PLACE_M).astype(np.int64), axis=0, return_index=True)[1]] = True
    return first


def _plain(name: object) -> str:
    return re.sub(r"[\s_:.-]", "", str(name)).casefold()


def _found(columns: dict[str, Any], names: tuple[str, ...]) -> Any:
    """Return the first column that bears one of some names, None where none does."""
    return next((columns[_plain(name)] for name in names if _plain(name) in columns), None)


def _sizes(frame: pd.DataFrame, column: Any, most_m: float, notices: Notices) -> NDArray[np.float64]:
    """Return a column in metres, NaN where it is missing or no size of a plant, which is counted."""
    if column is None:
        return np.full(len(frame), np.nan)
    stated = frame[column]
    values = pd.to_numeric(stated, errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    fits = (values > 0) & (values <= most_m)
    wrong = stated.notna().to_numpy() & ~fits
    notices.add(
        "W_OBSERVED_SIZE", "sizes of observed plants that no plant has, taken as unknown", int(wrong.sum()),
        [f"{column} {value!r}" for value in stated[wrong][:5]],
    )  # fmt: skip
    return np.where(fits, values, np.nan)


def _species(frame: pd.DataFrame, column: Any) -> NDArray[np.object_]:
    """Return species as identifiers are written, None where none is stated."""
    if column is None:
        return np.full(len(frame), None, dtype=object)
    codes, known = pd.factorize(frame[column])
    names = [re.sub(r"[\s-]+", "_", str(name).strip()).casefold() or None for name in known]
    return np.array([*names, None], dtype=object)[codes]


def _ids(frame: gpd.GeoDataFrame, columns: dict[str, Any], row: NDArray[np.int64]) -> NDArray[np.object_]:
    """Return an id a plant: its own where all have one of their own, else its row; parts of one row are numbered."""
    found = _found(columns, ID_COLUMNS)
    whole = found is not None and frame[found].notna().all() and frame[found].is_unique
    ids = as_text(frame[found] if whole else pd.Series(frame.index))
    if len(set(ids)) < len(ids):  # 1 and "1"
        ids = as_text(pd.Series(frame.index))
    part = np.arange(len(row)) - np.searchsorted(row, row)
    return np.array([f"{ids[i]}.{n}" if n else ids[i] for i, n in zip(row, part, strict=True)], dtype=object)
