"""Placement units: lots, street strips and sketches, and who has which ground."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import geopandas as gpd
import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Config
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.progress import Progress
from urbanforest_cli.register.cleaning import Checked, overlaps, twins
from urbanforest_cli.register.envelopes import drop_small
from urbanforest_cli.register.layers import SKETCH_COLUMNS, as_text, plain_columns, polygons_in_metres
from urbanforest_cli.register.lots import Lots
from urbanforest_cli.register.packed import PackedShapes, packed
from urbanforest_cli.register.plantable import Surroundings, Taken, plantable_areas
from urbanforest_cli.register.resolve import match_zones, resolve_parameters
from urbanforest_cli.register.sketches import density_for_cover, lot_under, numbers_of, stack_sketches
from urbanforest_cli.register.streets import (
    Roads,
    Strips,
    first_come,
    join_roads,
    regrouped,
    roads_outside,
    roads_with_trees,
    verge_strips,
)

STAGE = "stencil"

Shapes = NDArray[Any]


@dataclass
class Units:
    """Placement units of one origin: lots, street strips or sketches."""

    ids: NDArray[np.object_]
    zones: NDArray[np.object_]
    origin: str | NDArray[np.object_]
    shapes: Shapes
    parameters: pd.DataFrame

    @property
    def origins(self) -> NDArray[np.object_]:
        """Return the origin of each."""
        return np.full(len(self.ids), self.origin, dtype=object) if isinstance(self.origin, str) else self.origin


@dataclass(frozen=True)
class Plantable:
    """What the planting rules leave of each unit, none where nothing is, its size, and how many small pieces went."""

    areas: PackedShapes
    area_m2: NDArray[np.float64]
    dropped_parts: NDArray[np.int64]

    def without(self, rows: NDArray[np.bool_]) -> Plantable:
        """Return the same without the shapes of some units, whose sizes stay."""
        if not rows.any():
            return self
        kept = np.flatnonzero(~rows & ~self.areas.missing)
        areas = PackedShapes(len(rows))
        areas.put(kept, self.areas.get(kept))
        return Plantable(areas, self.area_m2, self.dropped_parts)


@dataclass
class Streets:
    """Street strips as units, and as they were made."""

    units: Units
    strips: Strips


def joined(units: Sequence[Units]) -> Units:
    """Return all units as one."""
    used = [part for part in units if len(part.ids)] or [units[0]]
    return Units(
        np.concatenate([part.ids for part in used]),
        np.concatenate([part.zones for part in used]),
        np.concatenate([part.origins for part in used]),
        np.concatenate([part.shapes for part in used]),
        pd.concat([part.parameters for part in used], ignore_index=True) if len(used) > 1 else used[0].parameters,
    )


def street_units(
    roads: Roads, lots: Lots, config: Config, seed: int, notices: Notices, known: Sequence[str]
) -> Streets:
    """Derive street strips along the roads that no lot of the zone street holds."""
    rules = config.zone_rules("street")
    strips = Strips(np.empty(0, object), np.empty(0, object), np.empty(0, object))
    if rules.derive_street_lots and len(roads.shapes):
        streets = lots.checked.shapes[lots.zones == "street"]
        strips = verge_strips(
            roads_outside(join_roads(roads_with_trees(roads, rules)), streets), rules, lots.checked.shapes
        )
    there = ~shapely.is_missing(strips.shapes)
    ids = np.array([f"road:{road}" for road in strips.ids[there]], dtype=object)
    zones = np.full(len(ids), "street", dtype=object)
    parameters = resolve_parameters(
        pd.DataFrame(index=range(len(ids))), ids, zones, config, seed=seed, notices=notices, known_strategies=known
    )
    return Streets(Units(ids, zones, "road", strips.shapes[there], parameters), strips)


def sketch_units(
    layers: dict[str, gpd.GeoDataFrame],
    lot_units: Units,
    lots: Lots,
    config: Config,
    seed: int,
    notices: Notices,
    known: Sequence[str],
    city: object,
) -> Units:
    """Make a placement unit of every sketch: its own values, else those of the lot under it, else its zone's."""
    frame = layers.get("sketches", gpd.GeoDataFrame(geometry=[], crs=lots.crs))
    where = f"{city} layer 'sketches'"
    frame = gpd.GeoDataFrame(plain_columns(frame, SKETCH_COLUMNS, where), crs=frame.crs)
    shapes = polygons_in_metres(frame, "sketches", lots.project, notices)
    numbers = as_text(frame["sketch_id"] if "sketch_id" in frame else pd.Series(frame.index, dtype=object))
    shapes = stack_sketches(shapes, numbers)
    there = ~shapely.is_missing(shapes)
    frame, shapes = frame[there].reset_index(drop=True), shapes[there]
    ids = np.array([f"sketch:{number}" for number in numbers[there]], dtype=object)
    under = lot_under(shapes, lots.checked.shapes)
    base = lot_units.parameters.reindex(under).reset_index(drop=True)
    stated = frame["zone"] if "zone" in frame else pd.Series([None] * len(frame), dtype=object)
    below = [lots.zones[row] if row >= 0 else "other" for row in under]
    zones = match_zones(stated.where(stated.notna(), below), ids, config, notices)
    own = frame[[name for name in ("strategy", *PARAMETERS) if name in frame]].copy()
    if "coverage" in frame:
        own = _with_coverage(own, numbers_of(frame["coverage"], ids, where))
    parameters = resolve_parameters(
        own, ids, zones, config, seed=seed, notices=notices, known_strategies=known, base=base, source="sketch",
        where=where,
    )  # fmt: skip
    parameters["source"] = "sketch"
    return Units(ids, zones, "sketch", shapes, parameters)


def _with_coverage(own: pd.DataFrame, coverage: NDArray[np.float64]) -> pd.DataFrame:
    """Return own values with those that a coverage stands for, where the sketch does not state them itself."""
    given = ~np.isnan(coverage)
    strategy = own["strategy"].astype(object) if "strategy" in own else pd.Series([None] * len(own), dtype=object)
    density = own["density"] if "density" in own else pd.Series(np.full(len(own), np.nan))
    fill = given & density.isna().to_numpy()
    return own.assign(
        strategy=strategy.mask(given & strategy.isna().to_numpy(), "random"),
        density=density.mask(fill, density_for_cover(coverage)) if fill.any() else density,
    )


def ground_taken(whole: Units, lots: Lots, strips: Strips, sketches: Units, config: Config, notices: Notices) -> Taken:
    """Find the ground that units leave to others: lots to smaller lots, to sketches and to road corridors."""
    count = len(lots.ids)
    shapes = lots.checked.shapes
    same = twins(shapes, lots.ids)
    doubles = same >= 0
    for row in np.flatnonzero(doubles):
        lots.checked.reasons[row] = "duplicate"
        lots.checked.details[row] = f"the same ground as lot {lots.ids[same[row]]}"
    message = "lots on the same ground as another, planted once"
    notices.add("W_DUPLICATE", message, int(doubles.sum()), lots.ids[doubles])
    singles = shapes.copy()
    singles[doubles] = None
    giving, keeping = overlaps(singles, lots.ids, least_m2=config.rules.min_area_m2)
    notices.add(
        "W_OVERLAP",
        "pairs of lots that overlap; the smaller keeps the ground",
        len(giving),
        [f"{lots.ids[a]} and {lots.ids[b]}" for a, b in zip(giving[:5], keeping[:5], strict=True)],
    )
    pairs = [(giving, shapes[keeping])]
    for givers, takers in (
        (np.arange(count), strips.corridors),
        (np.flatnonzero(whole.origins != "sketch"), sketches.shapes),
    ):
        giver, taker = shapely.STRtree(takers).query(whole.shapes[givers], predicate="intersects")
        order = np.lexsort((taker, giver))
        pairs.append((givers[giver[order]], takers[taker[order]]))
    return Taken(np.concatenate([pair[0] for pair in pairs]), np.concatenate([pair[1] for pair in pairs]))


def ground_of(
    whole: Units,
    checked: Checked,
    around: Surroundings,
    taken: Taken,
    config: Config,
    workers: int,
    progress: Progress,
) -> Plantable:
    """Return what is left of every unit; strips along roads have left the carriageways out already."""
    wanted = usable_units(whole, checked)
    count = len(whole.ids)
    strips = whole.origins == "road"
    lots, roads = np.flatnonzero(wanted & ~strips), np.flatnonzero(wanted & strips)
    sides, side_of = shapely.get_parts(whole.shapes[roads], return_index=True)
    rows = np.concatenate((lots, roads[side_of]))
    found = plantable_areas(
        np.concatenate((whole.shapes[lots], sides)),
        whole.zones[rows],
        around,
        config.zone_rules,
        taken=taken.among(rows),
        off_road=strips[rows],
        workers=workers,
        report=partial(progress, "cutting envelopes out of lots"),
    )
    rules = config.zone_rules("street")
    pieces, dropped_late = drop_small(first_come(found.areas[len(lots) :], side_of), rules.min_area_m2)
    areas = np.full(count, None, dtype=object)
    areas[lots] = found.areas[: len(lots)]
    areas[roads] = regrouped(pieces, side_of, len(roads))
    dropped = np.bincount(rows, found.dropped_parts, minlength=count).astype(np.int64)
    dropped += np.bincount(roads[side_of], dropped_late, minlength=count).astype(np.int64)
    left = packed(areas)
    return Plantable(left, left.area_m2, dropped)


def usable_units(whole: Units, checked: Checked) -> NDArray[np.bool_]:
    """Tell which units have a shape and no fault."""
    usable = ~shapely.is_missing(whole.shapes)
    usable[: len(checked.reasons)] &= checked.reasons == ""
    return usable


def skipped_units(
    whole: Units,
    checked: Checked,
    ground: Plantable,
    taken: Taken,
    mapped: tuple[NDArray[np.bool_], NDArray[np.object_], NDArray[np.object_]],
    kept: NDArray[np.object_],
) -> pd.DataFrame:
    """Return the layer ``skipped``: every unit without ground, and why.

    Parameters
    ----------
    mapped
        (n,) units decided by a coverage map; for those without ground the reason and the detail.
    kept
        Ids of units that hold known plants: these are kept whatever the ground.
    """
    reasons = np.full(len(whole.ids), "", dtype=object)
    details = np.full(len(whole.ids), "", dtype=object)
    reasons[: len(checked.reasons)] = checked.reasons
    details[: len(checked.details)] = checked.details
    decided, why, more = mapped
    of_map = decided & (reasons == "")
    reasons[of_map], details[of_map] = why[of_map], more[of_map]
    bare = ground.areas.missing & (reasons == "") & ~decided
    gave = np.isin(np.arange(len(whole.ids)), taken.lots)
    for rows, reason, detail in (
        (bare & (ground.dropped_parts > 0), "too_small", "only pieces smaller or thinner than those planted are left"),
        (bare & (ground.dropped_parts == 0) & gave, "no_room", "envelopes, sketches, streets or other lots cover it"),
        (bare & (ground.dropped_parts == 0) & ~gave, "no_room", "envelopes of what is built cover the whole lot"),
    ):
        reasons[rows], details[rows] = reason, detail
    rows = (reasons != "") & ~(usable_units(whole, checked) & np.isin(whole.ids, kept))
    return pd.DataFrame(
        {"lot_id": whole.ids[rows], "stage": STAGE, "reason": reasons[rows], "detail": details[rows]}, dtype=object
    )
