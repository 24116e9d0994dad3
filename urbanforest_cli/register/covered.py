"""Which placement units a coverage map fills, with what, and which it leaves bare."""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Coverage
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress
from urbanforest_cli.register.packed import PackedShapes, give_back
from urbanforest_cli.register.plantable import Taken
from urbanforest_cli.register.region_polygons import inside, stem_ground
from urbanforest_cli.register.regions import CoveredMap, Owners, cut_regions
from urbanforest_cli.register.streets import Strips
from urbanforest_cli.register.units import Units

NAMED = 5
"""Lots that a notice names."""
UNITS_A_CHUNK = 16384
"""Units whose regions are there as geometries at a time."""

Shapes = NDArray[Any]


@dataclass(frozen=True)
class Filled:
    """What a map and painted sketches make of placement units.

    Parameters
    ----------
    decided
        (n,) units whose ground the map or a painted sketch decides, and no planting rule.
    regions
        (n,) vegetation of each, with what reaches over its border; none for those that get no plants.
    stems
        (n,) where its stems may stand; none for those that get no plants.
    inside_m2
        (n,) area of the region inside the unit.
    coverage
        (n,) share of the region that crowns shall cover.
    covered_fraction, seen_fraction
        (n,) share of the known ground under vegetation, and of the ground that is known; NaN without a map.
    reasons, details
        (n,) why a decided unit gets no plants, "" for those that do and for all others.
    """

    decided: NDArray[np.bool_]
    regions: PackedShapes
    stems: PackedShapes
    inside_m2: NDArray[np.float64]
    coverage: NDArray[np.float64]
    covered_fraction: NDArray[np.float64]
    seen_fraction: NDArray[np.float64]
    reasons: NDArray[np.object_]
    details: NDArray[np.object_]


def only(shapes: Shapes, rows: NDArray[np.bool_]) -> Shapes:
    """Return shapes of some rows, None in the others."""
    chosen: Shapes = np.array(shapes, dtype=object)
    chosen[~rows] = None
    return chosen


def nothing_filled(count: int) -> Filled:
    """Return what no map makes of units."""
    return Filled(
        decided=np.zeros(count, dtype=bool),
        regions=PackedShapes(count),
        stems=PackedShapes(count),
        inside_m2=np.zeros(count),
        coverage=np.ones(count),
        covered_fraction=np.full(count, np.nan),
        seen_fraction=np.full(count, np.nan),
        reasons=np.full(count, "", dtype=object),
        details=np.full(count, "", dtype=object),
    )


def owners_of(units: Units, strips: Strips) -> Owners:
    """Return who has which ground: lots below, the smaller on the larger; corridors of streets, their strips; sketches.

    Corridors and sketches are nobody's as far as the map goes: what it shows there belongs to no lot.
    """
    origins, there = units.origins, ~shapely.is_missing(units.shapes)
    area = np.nan_to_num(shapely.area(units.shapes))
    lots = np.flatnonzero((origins == "register") & there)
    lots = lots[np.lexsort((units.ids[lots].astype(str), -area[lots]))]
    roads = np.flatnonzero((origins == "road") & there)[::-1]  # the first comes on top
    drawn = np.flatnonzero((origins == "sketch") & there)
    corridors = strips.corridors[~shapely.is_missing(strips.corridors)]
    shapes = np.concatenate((units.shapes[lots], corridors, units.shapes[roads], units.shapes[drawn]))
    rows = np.concatenate((lots, np.full(len(corridors), -1), roads, np.full(len(drawn), -1))).astype(np.int32)
    return Owners(shapes, rows)


def fill_from_map(
    units: Units,
    usable: NDArray[np.bool_],
    owners: Owners,
    covered: CoveredMap,
    taken: Taken,
    buildings: Shapes,
    road_surfaces: Shapes,
    config: Coverage,
    notices: Notices,
    workers: int,
    progress: Progress,
) -> Filled:
    """Cut a map into units: the region of each, where its stems may stand, and who gets no plants.

    Parameters
    ----------
    usable
        (n,) units with ground of their own: lots without a fault, strips, but no sketches.
    taken
        Ground that units leave to others.
    """
    shapes = only(units.shapes, usable)
    found = cut_regions(
        shapes, owners, covered, smallest_region_m2=config.smallest_region_m2, workers=workers,
        report=partial(progress, "cutting the map into lots"),
    )  # fmt: skip
    give_back()
    seen = usable & (found.seen_fraction >= config.seen_least)
    without = found.shapes.missing
    filled = replace(nothing_filled(len(shapes)), regions=found.shapes)
    green_rows = np.flatnonzero(seen & ~without)
    for start in range(0, len(green_rows), UNITS_A_CHUNK):
        chunk = green_rows[start : start + UNITS_A_CHUNK]
        insides = inside(found.shapes.get(chunk), shapes[chunk], workers)
        stems = stem_ground(insides, buildings, road_surfaces, taken.among(chunk), config, workers=workers)
        there = ~shapely.is_missing(stems)
        filled.stems.put(chunk, stems)
        filled.inside_m2[chunk[there]] = shapely.area(insides[there])
        progress("cutting walls out of regions", start + len(chunk), len(green_rows))
    rooted = ~filled.stems.missing
    filled.regions.drop(np.flatnonzero(~rooted))
    filled.decided[:] = seen
    filled.covered_fraction[usable] = found.covered_fraction[usable]
    filled.seen_fraction[usable] = found.seen_fraction[usable]
    green = np.nan_to_num(found.covered_fraction) > 0
    for rows, reason, detail in (
        (without & ~green, "bare", "the map shows no vegetation on it"),
        (without & green, "bare", "what the map shows on it belongs to neighbours or to a sketch"),
        (~without, "no_room", "its vegetation lies over what is built or belongs to others"),
    ):
        mine = seen & ~rooted & rows
        filled.reasons[mine], filled.details[mine] = reason, detail
    unseen = usable & ~seen
    if config.unseen == "nothing":
        filled.decided[:] |= unseen
        filled.reasons[unseen], filled.details[unseen] = "unseen", "the map knows too little of it"
    becomes = "planted by the rules of their zone" if config.unseen == "rules" else "left without plants"
    message = f"lots of which the map knows less than {config.seen_least:.0%}, {becomes}"
    notices.add("W_LOTS_UNSEEN", message, int(unseen.sum()), units.ids[unseen][:NAMED])
    return filled


def fill_from_paint(
    filled: Filled,
    units: Units,
    shares: dict[str, float],
    buildings: Shapes,
    road_surfaces: Shapes,
    config: Coverage,
    workers: int,
) -> None:
    """Add what painted sketches say: each is a region itself, and its shade how much of it crowns shall cover.

    Parameters
    ----------
    filled
        Changed in place.
    shares
        Share of each painted sketch, by the id of its unit.
    """
    painted = np.array([unit in shares for unit in units.ids], dtype=bool) & ~shapely.is_missing(units.shapes)
    rows = np.flatnonzero(painted)
    if not len(rows):
        return
    regions = units.shapes[rows]
    untaken = Taken(np.empty(0, np.int64), np.empty(0, object))
    stems = stem_ground(regions, buildings, road_surfaces, untaken, config, workers=workers)
    rooted = ~shapely.is_missing(stems)
    filled.decided[rows] = True
    filled.regions.put(rows[rooted], regions[rooted])
    filled.stems.put(rows, stems)
    filled.inside_m2[rows[rooted]] = shapely.area(regions[rooted])
    filled.coverage[rows] = [shares[unit] for unit in units.ids[rows]]
    filled.reasons[rows[~rooted]] = "no_room"
    filled.details[rows[~rooted]] = "all that was painted lies over what is built"
