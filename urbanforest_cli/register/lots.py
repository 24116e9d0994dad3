"""A city's lots: ids, zones and clean shapes in metres."""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.crs import is_metric, reproject, utm_crs, working_crs
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.schema import LAYERS
from urbanforest_cli.register.cleaning import (
    Checked,
    drop_strays,
    finite,
    first_look,
    repair,
    shift_west,
    unwrap_longitudes,
)
from urbanforest_cli.register.layers import as_text
from urbanforest_cli.register.resolve import match_zones

OWN_COLUMNS = (*LAYERS["lots"].columns, "fid", "geom")

Shapes = NDArray[Any]


@dataclass
class Lots:
    """A city's lots in metres, and how everything else is brought there."""

    ids: NDArray[np.object_]
    zones: NDArray[np.object_]
    checked: Checked
    crs: CRS
    working: CRS
    unwrapped: bool

    def project(self, frame: gpd.GeoDataFrame) -> Shapes:
        """Return a frame's shapes in the working CRS, None where one has no place there."""
        shapes = np.array(frame.geometry.to_numpy(), dtype=object)
        shapes[~finite(shapes)] = None
        if self.unwrapped and frame.crs.is_geographic:
            shapes = shift_west(shapes)
        shapes = np.array(reproject(shapes, frame.crs, self.working), dtype=object)
        shapes[~finite(shapes)] = None
        return shapes

    def back(self, shapes: Shapes) -> Shapes:
        """Return shapes in the CRS of the file."""
        found = reproject(shapes, self.working, self.crs)
        return shift_west(found) if self.unwrapped else found


def clean_lots(frame: gpd.GeoDataFrame, config: Config, notices: Notices, city: object, *, typed: bool = True) -> Lots:
    """Check ids and zones, clean the shapes and bring them to metres.

    Parameters
    ----------
    frame
        The layer as read, columns by their plain names.
    config
        Names the zones there are.
    notices
        Takes what was repaired; those of the reader are in it already.
    city
        What messages call the file.
    typed
        Whether the file's format has layers of one type, so that one without a polygon was meant for something else.

    Raises
    ------
    InputError
        Ids that are missing or repeated, or no polygon at all.
    CrsError, LimitError
        Coordinates that cannot be used.
    """
    ids = lot_ids(frame, notices, city)
    zones = frame["zone"] if "zone" in frame else [None] * len(frame)
    matched = match_zones(zones, ids, config, notices)
    if not len(frame):
        notices.add("W_EMPTY", "layers of lots without a row", 1, [str(city)])
    checked = first_look(frame.geometry.to_numpy(), ids, notices, note_missing=False)
    missing = notices.count("W_NO_GEOMETRY") + notices.count("W_OUTSIDE") + notices.count("W_DAMAGED")
    if not missing:  # all that the reader could not build have one cause
        rows = checked.reasons == "no_geometry"
        checked.drop(rows, "broken_ring", "a ring is open or has fewer than four points")
    if typed and len(frame) and (checked.reasons == "not_polygon").all():
        raise InputError("no polygons", where=city, found="points or lines", expected="a layer of polygons as lots")
    crs, unwrapped = CRS.from_user_input(frame.crs), False
    drop_strays(checked, crs, ids, notices)
    if crs.is_geographic:
        checked.shapes, unwrapped = unwrap_longitudes(checked.shapes, ids, notices)
    if checked.usable.any():
        working = working_crs(crs, tuple(shapely.total_bounds(checked.shapes)), where=city)
    else:
        working = crs if is_metric(crs) else utm_crs(0.0, 0.0)
    lots = Lots(ids, matched, checked, crs, working, False)
    checked.shapes = lots.project(gpd.GeoDataFrame(geometry=checked.shapes, crs=crs))
    lots.unwrapped = unwrapped
    repair(checked, ids, notices)
    return lots


def lot_ids(frame: gpd.GeoDataFrame, notices: Notices, city: object) -> NDArray[np.object_]:
    """Return the lots' ids as text; rows are numbered where there is no such column."""
    if "lot_id" not in frame:
        notices.add("W_NO_LOT_ID", "layers of lots without a column lot_id, numbered by their rows", 1, [str(city)])
        return as_text(pd.Series(frame.index))
    ids = as_text(frame["lot_id"])
    blank = np.array([lot_id is None or not lot_id.strip() for lot_id in ids], dtype=bool)
    if blank.any():
        raise InputError(
            "lots without an id",
            where=f"{city} column lot_id",
            found=f"{blank.sum()} empty cells, first in row {frame.index[blank][0]}",
            expected="an id in every row, or no column lot_id at all",
        )
    refuse_doubles(ids, city, "lot_id is not unique")
    return ids


def refuse_doubles(ids: NDArray[np.object_], city: object, what: str) -> None:
    """Raise `InputError` listing the first five ids that are there more than once."""
    doubles = pd.Series(ids)[pd.Series(ids).duplicated()].unique()
    if len(doubles):
        shown = ", ".join(repr(str(item)) for item in doubles[:5])
        raise InputError(
            what,
            where=f"{city} column lot_id",
            found=f"{len(doubles)} ids more than once: {shown}" + (", ..." if len(doubles) > 5 else ""),
            expected="an id of its own for every lot",
        )


def _plain_cell(value: Any) -> Any:
    """Return what a GeoPackage can hold: text as it is, anything put together as JSON."""
    if value is None or isinstance(value, str | bytes) or (isinstance(value, float) and value != value):
        return value
    if isinstance(value, np.ndarray):
        value = value.tolist()
    return json.dumps(value, ensure_ascii=False, default=str) if isinstance(value, list | tuple | dict) else str(value)


def user_columns(frame: pd.DataFrame, count: int, lots: Lots) -> dict[str, Any]:
    """Return the city's own columns, one row a unit; those whose names the register needs are ``source_``."""
    columns: dict[str, Any] = {}
    others = frame.drop(columns="lot_id", errors="ignore")
    taken = {name.casefold() for name in OWN_COLUMNS} | {str(name).casefold() for name in others.columns}
    for name in others.columns:
        column = others[name].reset_index(drop=True)
        if name == "zone" and (column.astype(object) == pd.Series(lots.zones)).all():
            continue
        if pd.api.types.is_bool_dtype(column.dtype):
            column = column.astype("boolean")
        elif pd.api.types.is_integer_dtype(column.dtype) and isinstance(column.dtype, np.dtype):
            column = column.astype("UInt64" if column.dtype == np.uint64 else "Int64")
        elif column.dtype == object:
            column = column.map(_plain_cell)
        label = str(name)
        if label.casefold() in {own.casefold() for own in OWN_COLUMNS}:
            label = f"source_{label}"
            while label.casefold() in taken:
                label = f"source_{label}"
            taken.add(label.casefold())
        columns[label] = column.reindex(range(count))
    return columns
