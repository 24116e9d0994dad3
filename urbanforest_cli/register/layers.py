"""The layers of a city beside its lots, brought to metres and to clean arrays."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Rules
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.register.cleaning import first_look, flat_copy, polygons_of, repair
from urbanforest_cli.register.plantable import Surroundings
from urbanforest_cli.register.rules import Entrances, locate_entrances, road_corners
from urbanforest_cli.register.streets import Roads

WIDEST_ROAD_M = 200.0
TALLEST_BUILDING_M = 1000.0
ROAD_ID_COLUMNS = ("road_id", "osm_id", "id")

Shapes = NDArray[Any]
Project = Callable[[gpd.GeoDataFrame], Shapes]
"""Gives a frame's shapes in metres; None for those that are missing or not finite."""


def plain_columns(frame: pd.DataFrame, known: tuple[str, ...], where: object) -> pd.DataFrame:
    """Return a frame whose known columns bear their names in small letters.

    Raises
    ------
    InputError
        Two columns differ by case alone.
    """
    seen: dict[str, str] = {}
    for column in map(str, frame.columns):
        other = seen.setdefault(column.strip().casefold(), column)
        if other != column:
            raise InputError(
                "two columns differ by case alone",
                where=where,
                found=f"{other!r} and {column!r}",
                next_step="rename or drop one of them",
            )
    names = {seen[name]: name for name in known if name in seen and seen[name] != name}
    return frame.rename(columns=names)


LOT_COLUMNS = ("lot_id", "zone", "strategy", *PARAMETERS)
SKETCH_COLUMNS = ("sketch_id", "coverage", *LOT_COLUMNS)


def polygons_in_metres(frame: gpd.GeoDataFrame, what: str, project: Project, notices: Notices) -> Shapes:
    """Return a layer's polygons, valid, in metres; what is none is left out and counted."""
    names = [f"row {row}" for row in frame.index]
    checked = first_look(frame.geometry.to_numpy(), names, notices, what=what, note_missing=False)
    checked.shapes = project(gpd.GeoDataFrame(geometry=checked.shapes, crs=frame.crs))
    repair(checked, names, notices, what=what)
    return checked.shapes


def shapes_in_metres(frame: gpd.GeoDataFrame, what: str, project: Project, notices: Notices) -> Shapes:
    """Return a layer's shapes of any kind in metres, None for what cannot be used, which is counted."""
    shapes = flat_copy(frame.geometry.to_numpy())
    shapes[shapely.is_empty(shapes)] = None
    moved = project(gpd.GeoDataFrame(geometry=shapes, crs=frame.crs))
    lost = ~shapely.is_missing(shapes) & shapely.is_missing(moved)
    notices.add("W_NOT_FINITE", f"{what} with a coordinate that is no number", int(lost.sum()))
    mixed = np.flatnonzero(shapely.get_type_id(moved) == 7)
    for row in mixed:
        moved[row] = polygons_of(moved[row])
    broken = np.flatnonzero(~shapely.is_missing(moved) & ~shapely.is_valid(moved))
    moved[broken] = shapely.make_valid(moved[broken], method="structure", keep_collapsed=False)
    notices.add("W_REPAIRED_AROUND", f"{what} with broken geometry, repaired", len(broken))
    moved[shapely.is_empty(moved)] = None
    return np.asarray(moved, dtype=object)


def lines_of(shapes: Shapes) -> tuple[Shapes, NDArray[np.int64]]:
    """Take multi-lines apart; return single lines and polygons, and the row each came from."""
    parts, row = shapely.get_parts(shapes, return_index=True)
    fits = np.isin(shapely.get_type_id(parts), (1, 3))
    return parts[fits], row[fits]


def roads_of(frame: gpd.GeoDataFrame, project: Project, rules: Rules, notices: Notices) -> Roads:
    """Return a city's roads with their widths; one that states none has the width of the rules."""
    frame = plain_columns(frame, ("width_m", "kind", *ROAD_ID_COLUMNS), "layer 'roads'")
    shapes, row = lines_of(shapes_in_metres(frame, "roads", project, notices))
    widths = numbers(frame, "width_m")[row]
    lines = shapely.get_dimensions(shapes) == 1
    unknown = ~((widths > 0) & (widths <= WIDEST_ROAD_M))
    notices.add(
        "W_ROAD_WIDTH", f"roads without a usable width, taken as {rules.road_width_m:g} m", int((unknown & lines).sum())
    )
    widths = np.where(unknown, rules.road_width_m, widths)
    kinds = np.char.lower(text(frame, "kind").astype(str)).astype(object)
    return Roads(shapes, np.where(lines, widths, 0.0), _road_ids(frame)[row], kinds[row])


def road_surfaces(roads: Roads) -> Shapes:
    """Return the ground that roads take: lines widened to their width, polygons as they are."""
    wide = roads.widths_m > 0
    surfaces = roads.shapes.copy()
    surfaces[wide] = shapely.buffer(roads.shapes[wide], roads.widths_m[wide] / 2, quad_segs=4)
    return surfaces


def _road_ids(frame: gpd.GeoDataFrame) -> NDArray[np.object_]:
    for name in ROAD_ID_COLUMNS:
        if name in frame and frame[name].notna().all() and frame[name].is_unique:
            return as_text(frame[name])
    return as_text(pd.Series(frame.index))


def as_text(column: pd.Series[Any]) -> NDArray[np.object_]:
    """Return ids as text: whole numbers without a point, missing ones as None."""
    values = column.to_numpy(dtype=object)
    missing = column.isna().to_numpy()
    return np.array(
        [None if gone else _plain(value) for value, gone in zip(values, missing, strict=True)], dtype=object
    )


def _plain(value: object) -> str:
    if isinstance(value, float | np.floating) and float(value).is_integer():
        return str(int(value))
    return str(value)


def numbers(frame: pd.DataFrame, name: str) -> NDArray[np.float64]:
    """Return a column as numbers, NaN where it is missing or holds something else."""
    if name not in frame:
        return np.full(len(frame), np.nan)
    values = pd.to_numeric(frame[name], errors="coerce").to_numpy(dtype=np.float64, na_value=np.nan)
    return np.where(np.isfinite(values), values, np.nan)


@dataclass(frozen=True)
class Buildings:
    """A city's buildings that can be used: ids as text, valid polygons in metres, heights (NaN where unknown)."""

    ids: NDArray[np.object_] = field(default_factory=lambda: np.empty(0, dtype=object))
    shapes: Shapes = field(default_factory=lambda: np.empty(0, dtype=object))
    height_m: NDArray[np.float64] = field(default_factory=lambda: np.empty(0))


def buildings_of(frame: gpd.GeoDataFrame | None, project: Project, notices: Notices) -> Buildings:
    """Return a city's buildings, cleaned; those that are no polygons are left out and counted."""
    if frame is None:
        return Buildings()
    shapes = polygons_in_metres(frame, "buildings", project, notices)
    there = ~shapely.is_missing(shapes)
    names = {str(name).strip().casefold(): name for name in reversed(frame.columns)}
    heights = np.full(len(frame), np.nan)
    if "height_m" in names:
        stated = frame[names["height_m"]]
        heights = numbers(frame, names["height_m"])
        wrong = stated.notna().to_numpy() & ~((heights > 0) & (heights <= TALLEST_BUILDING_M))
        heights[wrong] = np.nan
        notices.add(
            "W_BUILDING_HEIGHT",
            f"buildings whose height is no number from 0 to {TALLEST_BUILDING_M:g} m, taken as unknown",
            int(wrong.sum()),
            [f"row {row}: {stated[row]!r}" for row in frame.index[wrong][:5]],
        )
    ids = as_text(pd.Series(frame.index))
    if "building_id" in names:
        own = as_text(frame[names["building_id"]])
        ids = np.where(own == None, ids, own)  # noqa: E711
    return Buildings(ids[there], shapes[there], heights[there])


def surroundings_of(
    layers: Mapping[str, gpd.GeoDataFrame],
    buildings: Shapes,
    roads: Roads,
    project: Project,
    rules: Rules,
    notices: Notices,
) -> Surroundings:
    """Return all that plants keep away from.

    Parameters
    ----------
    layers
        Those of ``driveways``, ``entrances`` and ``obstacles`` that the city has.
    buildings
        Shapes as `buildings_of` returns them.
    roads
        As `roads_of` returns them.
    """
    nothing = np.empty(0, dtype=object)
    driveways = obstacles = nothing
    kinds, clearance = nothing, np.empty(0)
    if "driveways" in layers:
        driveways, _ = lines_of(shapes_in_metres(layers["driveways"], "driveways", project, notices))
    if "obstacles" in layers:
        frame = plain_columns(layers["obstacles"], ("kind", "clearance_m"), "layer 'obstacles'")
        shapes = shapes_in_metres(frame, "obstacles", project, notices)
        there = ~shapely.is_missing(shapes)
        obstacles, kinds = shapes[there], text(frame, "kind")[there]
        clearance = numbers(frame, "clearance_m")[there]
        wrong = clearance < 0
        notices.add("W_CLEARANCE", "obstacles with a clearance below zero, taken by their kind", int(wrong.sum()))
        clearance = np.where(wrong, np.nan, clearance)
    lines = shapely.get_type_id(roads.shapes) == 1
    entrances = _entrances(layers.get("entrances"), project, buildings, notices)
    return Surroundings(
        buildings=buildings,
        driveways=driveways,
        entrances=entrances,
        obstacles=obstacles,
        obstacle_kinds=kinds,
        obstacle_clearance_m=clearance,
        roads=roads.shapes,
        road_widths_m=roads.widths_m,
        corners=road_corners(roads.shapes[lines], roads.widths_m[lines]),
    )


def text(frame: pd.DataFrame, name: str) -> NDArray[np.object_]:
    """Return a column as text, blank where it is missing."""
    if name not in frame:
        return np.full(len(frame), "", dtype=object)
    codes, known = pd.factorize(frame[name])
    return np.array([*(str(value).strip() for value in known), ""], dtype=object)[codes]


def _entrances(frame: gpd.GeoDataFrame | None, project: Project, buildings: Shapes, notices: Notices) -> Entrances:
    if frame is None:
        return Entrances()
    frame = plain_columns(frame, ("kind",), "layer 'entrances'")
    shapes = shapes_in_metres(frame, "entrances", project, notices)
    there = ~shapely.is_missing(shapes)
    shapes, kinds = shapes[there], text(frame, "kind")[there]
    codes, known = pd.factorize(kinds)
    names = np.array([kind.casefold() for kind in known], dtype=object)
    windows, unknown = (names == "window")[codes], ~np.isin(names, ("window", "door"))[codes]
    notices.add("W_ENTRANCE_KIND", "entrances that are neither door nor window, taken as doors", int(unknown.sum()))
    entrances, on_wall = locate_entrances(shapes, windows, buildings)
    notices.add("W_ENTRANCE_ALONE", "entrances without a wall within 3 m, left out", int((~on_wall).sum()))
    return entrances
