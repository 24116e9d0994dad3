"""Rows of many sources brought together into one city: one CRS, lots of their own, a zone for each."""

from __future__ import annotations

from collections import Counter
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from pyproj import CRS

from urbanforest_cli.core.config import Rules
from urbanforest_cli.core.crs import reproject, working_crs
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress
from urbanforest_cli.core.zones import FALLBACK_ZONE
from urbanforest_cli.sources.derived_lots import derive_lots
from urbanforest_cli.sources.shapes import first_of_equal
from urbanforest_cli.sources.zoning import covering, majority


def extent_of(frame: gpd.GeoDataFrame) -> tuple[float, float, float, float]:
    """Return west, south, east and north of the finite shapes; zeros where there are none."""
    bounds = shapely.bounds(frame.geometry.to_numpy())
    bounds = bounds[np.isfinite(bounds).all(axis=1)]
    if len(bounds) == 0:
        return (0.0, 0.0, 0.0, 0.0)
    west, south = bounds[:, :2].min(axis=0)
    east, north = bounds[:, 2:].max(axis=0)
    return float(west), float(south), float(east), float(north)


def join_rows(frames: list[gpd.GeoDataFrame]) -> gpd.GeoDataFrame:
    """Put rows of one layer under one another, in the CRS of the first; columns some lack are empty there."""
    crs = frames[0].crs
    frames = [frames[0]] + [in_crs(frame, crs) for frame in frames[1:]]
    if len(frames) == 1:
        return frames[0]
    filled = [frame for frame in frames if len(frame)] or frames[:1]
    columns = list(dict.fromkeys(name for frame in filled for name in frame.columns))
    columns_joined = {
        name: np.concatenate([
            frame[name].to_numpy(dtype=object) if name in frame else np.full(len(frame), None) for frame in filled
        ])
        for name in columns
        if name != "geometry"
    }  # fmt: skip
    shapes = np.concatenate([frame.geometry.to_numpy() for frame in filled])
    return gpd.GeoDataFrame(pd.DataFrame(columns_joined).infer_objects(), geometry=shapes, crs=crs)


def in_crs(frame: gpd.GeoDataFrame, crs: CRS) -> gpd.GeoDataFrame:
    """Bring a layer to a CRS."""
    if frame.crs == crs:
        return frame
    shapes = reproject(frame.geometry.to_numpy(), CRS.from_user_input(frame.crs), CRS.from_user_input(crs))
    return gpd.GeoDataFrame(frame.drop(columns="geometry"), geometry=shapes, crs=crs)


def city_crs(layers: dict[str, gpd.GeoDataFrame], *, where: str) -> CRS:
    """Return the CRS of the lots, or of what lots are to be made from.

    Raises
    ------
    InputError
        There is nothing of the kind.
    """
    for role in ("lots", "buildings", "roads"):
        if role in layers:
            return CRS.from_user_input(layers[role].crs)
    raise InputError(
        "neither lots, nor streets and buildings to make them from",
        where=where,
        next_step="name a layer with --lots, or --roads and --buildings; or try another --profile",
    )


def distinct_lots(lots: gpd.GeoDataFrame, notices: Notices) -> gpd.GeoDataFrame:
    """Keep one lot of those that are the same ground, and give each an identifier of its own."""
    firsts = first_of_equal(lots.geometry.to_numpy())
    dropped = lots["lot_id"].to_numpy()[~firsts]
    notices.add("W_SAME_GROUND", "lots on exactly the ground of another, left out", len(dropped), dropped[:5])
    lots = lots[firsts].reset_index(drop=True)
    names = lots["lot_id"].astype(str).to_numpy(dtype=object)
    repeated = pd.Series(names).duplicated().to_numpy()
    notices.add(
        "W_ID_REPEATED", "lots with the identifier of another, numbered", int(repeated.sum()), names[repeated][:5]
    )
    used = set(names)
    last: dict[str, int] = {}
    for row in np.flatnonzero(repeated):
        name = names[row]
        number = last.get(name, 1) + 1
        while f"{name}.{number}" in used:
            number += 1
        last[name] = number
        names[row] = f"{name}.{number}"
        used.add(names[row])
    return lots.assign(lot_id=names)


def lots_from_streets(layers: dict[str, gpd.GeoDataFrame], notices: Notices, progress: Progress) -> gpd.GeoDataFrame:
    """Make lots where there are none."""
    known = [layers[role] for role in ("roads", "buildings") if role in layers]
    crs = CRS.from_user_input(known[0].crs)
    boxes = np.array([extent_of(frame) for frame in known if len(frame)] or [(0.0, 0.0, 0.0, 0.0)])
    west, south = boxes[:, :2].min(axis=0)
    east, north = boxes[:, 2:].max(axis=0)
    metric = working_crs(crs, (float(west), float(south), float(east), float(north)))
    nothing = np.empty(0, dtype=object)
    roads = in_crs(layers["roads"], metric) if "roads" in layers else None
    shapes = nothing if roads is None else roads.geometry.to_numpy()
    widths = np.empty(0) if roads is None else roads["width_m"].to_numpy(dtype=float, na_value=np.nan)
    lines = np.isin(shapely.get_type_id(shapes), (1, 2, 5)) if len(shapes) else np.zeros(0, dtype=bool)
    buildings = in_crs(layers["buildings"], metric).geometry.to_numpy() if "buildings" in layers else nothing
    unknown = lines & np.isnan(widths)
    default = Rules().road_width_m
    notices.add("W_ROAD_WIDTH", f"roads without a width, taken as {default:g} m wide", int(unknown.sum()))
    widths = np.where(unknown, default, widths)
    found = derive_lots(
        shapes[lines], widths[lines], shapes[~lines], buildings,
        report=lambda done, total: progress("sharing out blocks", done, total),
    )  # fmt: skip
    notices.add("W_LOTS_DERIVED", "lots made from streets and buildings, as the sources hold none", len(found.shapes))
    notices.add("W_SLIVER", "slivers of ground below 10 m2, left out", found.sliver_count)
    blank = np.full(len(found.shapes), None, dtype=object)
    frame = gpd.GeoDataFrame(
        {"lot_id": found.names, "zone": blank, "zone_code": blank.copy()}, geometry=found.shapes, crs=metric
    )
    return in_crs(frame, crs)


def give_zones(
    layers: dict[str, gpd.GeoDataFrame], default_zone: str, notices: Notices
) -> tuple[gpd.GeoDataFrame, list[dict[str, object]]]:
    """Give every lot a zone: its own code, else the zoning that covers it, else what stands on it, else the default.

    Returns
    -------
    The lots, and a record for each code: the zone it became, its number of lots, and whether the profile knows it.
    """
    lots = layers["lots"]
    shapes = lots.geometry.to_numpy()
    zones, codes = lots["zone"].to_numpy(dtype=object).copy(), lots["zone_code"].to_numpy(dtype=object).copy()
    areas = layers.get("zoning")
    if areas is not None and len(areas):
        open_rows = np.flatnonzero(_is_none(zones))
        hit = covering(shapes[open_rows], areas.geometry.to_numpy())
        rows, hit = open_rows[hit >= 0], hit[hit >= 0]
        zones[rows], codes[rows] = areas["zone"].to_numpy()[hit], areas["zone_code"].to_numpy()[hit]
    buildings = layers.get("buildings")
    if buildings is not None and "zone" in buildings and len(buildings):
        open_rows = np.flatnonzero(_is_none(zones) & _is_none(codes))
        found = majority(shapes[open_rows], buildings.geometry.to_numpy(), buildings["zone"].to_numpy(dtype=object))
        rows = open_rows[~_is_none(found)]
        zones[rows], codes[rows] = found[~_is_none(found)], "buildings"
    unknown = _is_none(zones)
    coded = unknown & ~_is_none(codes)
    without = unknown & _is_none(codes)
    zones[coded], zones[without] = FALLBACK_ZONE, default_zone
    ids = lots["lot_id"].to_numpy()
    notices.add(
        "W_ZONE_UNKNOWN",
        f"lots with a zone code that means nothing here, taken as {FALLBACK_ZONE!r}",
        int(coded.sum()),
        sorted({str(code) for code in codes[coded]})[:5],
    )
    notices.add(
        "W_ZONE_MISSING", f"lots without a zone, taken as {default_zone!r}", int(without.sum()), ids[without][:5]
    )
    return lots.assign(zone=zones, zone_code=codes), _code_table(codes, zones, ~unknown)


def _code_table(codes: NDArray[Any], zones: NDArray[Any], known: NDArray[np.bool_]) -> list[dict[str, object]]:
    """Count the lots of each code, most first."""
    counted = Counter(
        (None if code is None or code != code else str(code), str(zone), bool(sure))
        for code, zone, sure in zip(codes, zones, known, strict=True)
    )
    rows = sorted(counted.items(), key=lambda item: (-item[1], item[0][1], str(item[0][0])))
    return [{"code": code, "zone": zone, "lots": lots, "known": sure} for (code, zone, sure), lots in rows]


def _is_none(values: NDArray[Any]) -> NDArray[np.bool_]:
    return np.array([value is None or value != value for value in values], dtype=bool)
