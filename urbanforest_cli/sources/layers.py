"""Rows of a source as rows of a city layer: the geometry made fit, the columns under the city's names."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.sources.columns import counts, find_column, first_values, metres, require_column
from urbanforest_cli.sources.profile import DEFAULT_KINDS, LayerRule, code_text, matches, zone_by_codes
from urbanforest_cli.sources.shapes import points_along, usable

# Columns of the user's that a lot or a sketch keeps.
_OWN = {"lot_id", "zone", "zone_code", "geometry", "fid", "geom", "ogc_fid"}
_SETTINGS = {"strategy", "coverage", *PARAMETERS}


@dataclass
class Origin:
    """Where rows come from, and what a person calls the columns they named by option."""

    where: str
    options: dict[str, str] = field(default_factory=dict)


def objects(values: list[Any]) -> NDArray[Any]:
    """Return a list as an array of objects, which keeps None and whole numbers as they are."""
    array = np.empty(len(values), dtype=object)
    array[:] = values
    return array


def selected(frame: gpd.GeoDataFrame, rule: LayerRule) -> gpd.GeoDataFrame:
    """Return the rows a rule takes: each of ``where`` fits, none of ``unless`` does."""
    taken = np.ones(len(frame), dtype=bool)
    for column, patterns in rule.where.items():
        taken &= _fits(frame, column, patterns)
    for column, patterns in rule.unless.items():
        taken &= ~_fits(frame, column, patterns)
    return frame[taken]


def _fits(frame: gpd.GeoDataFrame, column: str, patterns: tuple[str, ...]) -> NDArray[np.bool_]:
    values = find_column(frame, column.split("|"))
    if values is None:
        return np.zeros(len(frame), dtype=bool)
    return np.array([matches(code_text(value), patterns) for value in values], dtype=bool)


def city_rows(
    role: str, frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices
) -> gpd.GeoDataFrame:
    """Make rows of one layer of the city from the selected rows of a source.

    Raises
    ------
    InputError
        A column that a person named is not there.
    """
    kinds = rule.kinds or DEFAULT_KINDS[role]
    names = np.array([f"{origin.where} row {fid}" for fid in frame.index], dtype=object)
    what = role.replace("_", " ")
    shapes = usable(frame.geometry.to_numpy(), kinds, names, what, notices)
    columns = _MAKERS[role](frame, rule, origin, notices)
    result = gpd.GeoDataFrame(columns, geometry=shapes, crs=frame.crs)
    kept = ~shapely.is_missing(shapes)
    if role == "zoning":
        kept &= result["zone" if rule.ignore_unknown else "zone_code"].notna().to_numpy()
    return result[kept].reset_index(drop=True)


def _lot_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> dict[str, Any]:
    columns: dict[str, Any] = {
        "lot_id": _identities(frame, rule, origin, notices),
        **_zone_columns(frame, rule, origin),
    }
    used = {name.casefold() for names in (rule.id, *(z.column for z in rule.zones)) for name in names}
    return columns | _own_columns(frame, used)


def _identities(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> NDArray[Any]:
    values = _named(frame, rule.id, "id", origin) if "id" in origin.options else first_values(frame, rule.id)
    if values is None:
        return np.array([str(fid) for fid in frame.index], dtype=object)
    texts = objects([code_text(value) for value in values])
    blank = np.array([text is None for text in texts], dtype=bool)
    texts[blank] = [f"row {fid}" for fid in frame.index[blank]]
    notices.add("W_NO_ID", "lots without an identifier, named by their row", int(blank.sum()), texts[blank][:5])
    return texts


def _zone_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin) -> dict[str, Any]:
    """Return ``zone``, None where no code is known, and ``zone_code``."""
    columns = [_named(frame, table.column, "zone", origin) for table in rule.zones]
    texts = [[None] * len(frame) if c is None else [code_text(value) for value in c] for c in columns]
    known: dict[tuple[str | None, ...], tuple[str | None, str | None]] = {}
    found = []
    for codes in zip(*texts, strict=True) if texts else [()] * len(frame):
        if codes not in known:
            known[codes] = zone_by_codes(rule, list(codes))
        found.append(known[codes])
    return {
        "zone": objects([zone for zone, _ in found]),
        "zone_code": objects([code for _, code in found]),
    }


def _own_columns(frame: gpd.GeoDataFrame, used: set[str], only: set[str] | None = None) -> dict[str, Any]:
    """Return a source's own plain columns that are not used up; nested values have no place in a GeoPackage."""
    kept: dict[str, Any] = {}
    seen = set(used) | _OWN
    for name in frame.columns:
        folded = str(name).casefold()
        if folded in seen or (only is not None and folded not in only):
            continue
        seen.add(folded)
        values = frame[name]
        nested = (
            values.map(lambda value: isinstance(value, list | dict | np.ndarray)).any()
            if values.dtype == object
            else False
        )
        if not nested:
            kept[str(name)] = values.to_numpy() if values.dtype == object else values.array
    return kept


def _building_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> dict[str, Any]:
    heights = np.full(len(frame), np.nan)
    stated = _named(frame, rule.height, "height", origin)
    if stated is not None:
        heights, bad = metres(stated, rule.height_factor)
        _count_bad("W_HEIGHT_TEXT", "building heights that are no height, taken as unknown", stated, bad, notices)
    levels = find_column(frame, rule.levels)
    if levels is not None:
        heights = np.where(np.isnan(heights), counts(levels) * rule.level_height_m, heights)
    columns: dict[str, Any] = {"height_m": heights}
    identity = first_values(frame, rule.id)
    if identity is not None:
        columns["building_id"] = objects([code_text(value) for value in identity])
    return columns | (_zone_columns(frame, rule, origin) if rule.zones else {})


def _road_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> dict[str, Any]:
    widths = np.full(len(frame), np.nan)
    stated = _named(frame, rule.width, "width", origin)
    if stated is not None:
        widths, bad = metres(stated)
        _count_bad("W_WIDTH_TEXT", "road widths that are no width, taken as unknown", stated, bad, notices)
    lanes = find_column(frame, rule.lanes)
    if lanes is not None:
        widths = np.where(np.isnan(widths), counts(lanes) * rule.lane_width_m, widths)
    kinds = _kinds(frame, rule)
    by_kind = np.array([rule.widths.get(kind or "", np.nan) for kind in kinds], dtype=np.float64)
    return {"width_m": np.where(np.isnan(widths), by_kind, widths), "kind": kinds}


def _obstacle_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> dict[str, Any]:
    columns: dict[str, Any] = {"kind": _kinds(frame, rule)}
    clearance = find_column(frame, rule.clearance)
    if clearance is not None:
        columns["clearance_m"] = metres(clearance)[0]
    return columns


def _kind_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> dict[str, Any]:
    return {"kind": _kinds(frame, rule)}


def _no_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> dict[str, Any]:
    return {}


def _zoning_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> dict[str, Any]:
    return _zone_columns(frame, rule, origin)


def _sketch_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> dict[str, Any]:
    return _own_columns(frame, set(), _SETTINGS)


def _plant_columns(frame: gpd.GeoDataFrame, rule: LayerRule, origin: Origin, notices: Notices) -> dict[str, Any]:
    columns: dict[str, Any] = {}
    species = first_values(frame, rule.species)
    if species is not None:
        columns["species"] = objects([code_text(value) for value in species])
    height = find_column(frame, rule.height)
    if height is not None:
        columns["height_m"] = metres(height, rule.height_factor)[0]
    crown = find_column(frame, rule.width)
    if crown is not None:
        columns["crown_diameter_m"] = metres(crown)[0]
    return columns


_MAKERS = {
    "lots": _lot_columns,
    "zoning": _zoning_columns,
    "buildings": _building_columns,
    "roads": _road_columns,
    "driveways": _no_columns,
    "entrances": _kind_columns,
    "obstacles": _obstacle_columns,
    "sketches": _sketch_columns,
    "observed_plants": _plant_columns,
}


def _kinds(frame: gpd.GeoDataFrame, rule: LayerRule) -> NDArray[Any]:
    values = find_column(frame, rule.kind)
    texts = [None] * len(frame) if values is None else [code_text(value) for value in values]
    kinds = [rule.kind_value if rule.kind_value is not None else rule.kinds_of.get(t or "", t) for t in texts]
    return objects(kinds)


def _named(frame: gpd.GeoDataFrame, names: tuple[str, ...], use: str, origin: Origin) -> pd.Series[Any] | None:
    """Find a column; one that a person named must be there."""
    if use in origin.options and names:
        return require_column(frame, names, where=origin.where, option=origin.options[use])
    return find_column(frame, names)


def _count_bad(code: str, message: str, column: pd.Series[Any], bad: NDArray[np.bool_], notices: Notices) -> None:
    notices.add(code, message, int(bad.sum()), [repr(value) for value in column[bad].unique()[:5]])


def single_trees(frame: gpd.GeoDataFrame, rule: LayerRule, notices: Notices) -> gpd.GeoDataFrame:
    """Make one point a row: groups of points are taken apart, rows of trees given as lines are set with trees.

    The frame must be in metres.
    """
    frame = frame.explode(index_parts=False, ignore_index=True)
    shapes = frame.geometry.to_numpy()
    lines = shapely.get_type_id(shapes) == shapely.GeometryType.LINESTRING
    if not lines.any():
        return frame
    trees = [points_along(line, rule.spacing_m) for line in shapes[lines]]
    repeats = np.repeat(np.flatnonzero(lines), [len(xy) for xy in trees])
    rows = frame.iloc[repeats].set_geometry(shapely.points(np.concatenate(trees)), crs=frame.crs)
    text = f"trees set along tree rows given as lines, every {rule.spacing_m:g} m"
    notices.add("W_TREE_ROW", text, len(rows))
    points = frame[~lines]
    return gpd.GeoDataFrame(pd.concat([points, rows], ignore_index=True), geometry="geometry", crs=frame.crs)
