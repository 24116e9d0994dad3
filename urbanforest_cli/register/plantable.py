"""The ground that is left: a lot less the envelopes of all that plants keep away from."""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from functools import partial
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Rules
from urbanforest_cli.register.envelopes import ARC_EXCESS_M, drop_small, outer_buffer, subtract
from urbanforest_cli.register.near import Near, NearThings
from urbanforest_cli.register.rules import (
    Corners,
    Entrances,
    carriageway_reach_m,
    entrance_areas,
    obstacle_distances,
    sight_triangles,
)

LOTS_A_CHUNK = 2048

Shapes = NDArray[Any]


def _none() -> Shapes:
    return np.empty(0, dtype=object)


def _no_numbers() -> NDArray[np.float64]:
    return np.empty(0, dtype=np.float64)


@dataclass(frozen=True)
class Surroundings:
    """All that plants keep away from, in metres; every shape valid.

    Parameters
    ----------
    buildings, driveways, obstacles, roads
        Shapes; buildings are polygons, the others may be lines, obstacles points too.
    entrances
        Doors and windows brought to their walls.
    obstacle_kinds, obstacle_clearance_m
        Kind of each obstacle, and the distance it states itself (NaN: the one of its kind).
    road_widths_m
        Width of the carriageway of each road; 0 for polygons, which are the carriageway.
    corners
        Corners of road intersections.
    """

    buildings: Shapes = field(default_factory=_none)
    driveways: Shapes = field(default_factory=_none)
    entrances: Entrances = field(default_factory=Entrances)
    obstacles: Shapes = field(default_factory=_none)
    obstacle_kinds: NDArray[np.object_] = field(default_factory=_none)
    obstacle_clearance_m: NDArray[np.float64] = field(default_factory=_no_numbers)
    roads: Shapes = field(default_factory=_none)
    road_widths_m: NDArray[np.float64] = field(default_factory=_no_numbers)
    corners: Corners = field(default_factory=Corners)


@dataclass(frozen=True)
class Taken:
    """Ground that another placement unit takes from a lot: pairs of a lot's row and a shape."""

    lots: NDArray[np.int64]
    shapes: Shapes

    def among(self, rows: NDArray[np.integer]) -> Taken:
        """Return the pairs of some lots, with the lots' places in `rows`; a lot may have several places."""
        order = np.argsort(rows, kind="stable")
        first = np.searchsorted(rows[order], self.lots, side="left")
        count = np.searchsorted(rows[order], self.lots, side="right") - first
        nth = np.arange(count.sum()) - np.repeat(np.cumsum(count) - count, count)
        return Taken(order[np.repeat(first, count) + nth], np.repeat(self.shapes, count))


NOTHING_TAKEN = Taken(np.empty(0, np.int64), np.empty(0, object))


@dataclass(frozen=True)
class Ground:
    """What is left of each lot: its area (None where nothing is), and whether pieces were dropped as too small."""

    areas: Shapes
    dropped_parts: NDArray[np.int64]


def plantable_areas(
    lots: Shapes,
    zones: NDArray[np.object_],
    around: Surroundings,
    rules_of: Callable[[str], Rules],
    *,
    taken: Taken = NOTHING_TAKEN,
    off_road: NDArray[np.bool_] | None = None,
    workers: int = 1,
    report: Callable[[int, int], None] | None = None,
) -> Ground:
    """Return where plants may stand in each lot (paper, section Planting Rules).

    A lot's result depends on the lot and on what is near it alone, to the last bit, so that a subset of a city gives
    the same areas as the whole.

    Parameters
    ----------
    lots
        (n,) valid polygons in metres.
    zones
        (n,) the zone of each, which decides the rules.
    around
        All that plants keep away from; nothing farther from the lots than the clearances matters.
    rules_of
        The rules in force in a zone.
    taken
        Ground that belongs to other units: sketches, street strips, overlapping lots.
    off_road
        (n,) lots that leave out all carriageways already, such as strips along them.
    workers
        Threads.
    report
        Called with lots done and lots in all.
    """
    areas = np.full(len(lots), None, dtype=object)
    dropped = np.zeros(len(lots), dtype=np.int64)
    on_road = np.ones(len(lots), dtype=bool) if off_road is None else ~off_road
    groups: dict[str, tuple[Rules, list[str]]] = {}
    for zone in sorted(set(zones)):
        rules = rules_of(zone)
        groups.setdefault(rules.model_dump_json(), (rules, []))[1].append(zone)
    done = 0
    with ThreadPoolExecutor(workers) as pool:
        for rules, members in groups.values():
            mine = np.flatnonzero(np.isin(zones, members))
            keeper = _Keeper(rules, around, shapely.total_bounds(lots[mine]))
            chunks = [mine[start : start + LOTS_A_CHUNK] for start in range(0, len(mine), LOTS_A_CHUNK)]
            leave = partial(_leave_chunk, keeper, lots, taken, on_road)
            for rows, left in zip(chunks, pool.map(leave, chunks) if workers > 1 else map(leave, chunks), strict=True):
                areas[rows], dropped[rows] = left.areas, left.dropped_parts
                done += len(rows)
                if report is not None:
                    report(done, len(lots))
    return Ground(areas, dropped)


def _leave_chunk(
    keeper: _Keeper, lots: Shapes, taken: Taken, on_road: NDArray[np.bool_], rows: NDArray[np.int64]
) -> Ground:
    return keeper.leave(lots[rows], taken.among(rows), on_road[rows])


class _Keeper:
    """One set of rules, and all that they keep plants away from, indexed.

    Walls, driveways, doors and corners are many and small, and an exact kernel takes them off; what it gives back
    undone, and everything else, goes through overlays.
    """

    def __init__(self, rules: Rules, around: Surroundings, bounds: NDArray[np.float64]) -> None:
        self.rules = rules
        lines = shapely.get_dimensions(around.driveways) == 1
        points_given = shapely.get_type_id(around.obstacles) == 0
        far_m = obstacle_distances(around.obstacle_kinds, around.obstacle_clearance_m, rules)
        pointed = [(float(far), points_given & (far_m == far)) for far in np.unique(far_m[points_given & (far_m > 0)])]
        self.near = NearThings(
            [
                Near(around.buildings, rules.building_clearance_m, only_own=not rules.neighbour_buildings),
                Near(around.driveways[~lines], rules.driveway_clearance_m),
                Near(entrance_areas(around.entrances, rules), 0.0),
                Near(sight_triangles(around.corners, rules.sight_triangle_m), 0.0),
            ],
            [Near(around.obstacles[chosen], far) for far, chosen in pointed],
        )
        half = rules.driveway_width_m / 2 + rules.driveway_clearance_m
        self.roads = _buffered(around.roads, carriageway_reach_m(around.roads, around.road_widths_m, rules), bounds)
        self.others = np.concatenate(
            (
                _buffered(around.driveways[lines], np.full(int(lines.sum()), half), bounds),
                _buffered(around.obstacles[~points_given], far_m[~points_given], bounds),
            )
        )
        self.road_tree, self.other_tree = shapely.STRtree(self.roads), shapely.STRtree(self.others)

    def leave(self, lots: Shapes, taken: Taken, on_road: NDArray[np.bool_]) -> Ground:
        """Return what these rules leave of some lots; those not on a road keep off carriageways as they are."""
        ground = Ground(*self.near.leave(lots, self.rules.min_area_m2))
        there = ~shapely.is_missing(ground.areas)
        mine = there[taken.lots]
        cuts = [(taken.lots[mine], taken.shapes[mine])]
        for tree, shapes, rows in (
            (self.road_tree, self.roads, np.flatnonzero(there & on_road)),
            (self.other_tree, self.others, np.flatnonzero(there)),
        ):
            row, thing = tree.query(ground.areas[rows], predicate="intersects")
            order = np.lexsort((thing, row))
            cuts.append((rows[row[order]], shapes[thing[order]]))
        owner, cutters = (np.concatenate([cut[k] for cut in cuts]) for k in (0, 1))
        more, place = np.unique(owner, return_inverse=True)
        left = subtract(ground.areas[more], place, cutters)
        ground.areas[more], dropped = drop_small(left, self.rules.min_area_m2)
        ground.dropped_parts[more] += dropped
        return ground


def _buffered(things: Shapes, distances_m: NDArray[np.float64], bounds: NDArray[np.float64]) -> Shapes:
    """Return the envelopes of all things that come near some bounds, each with a distance of its own."""
    if not len(things):
        return np.empty(0, dtype=object)
    west, south, east, north = shapely.bounds(things).T
    reach = distances_m * 1.01 + ARC_EXCESS_M
    near = (west - reach <= bounds[2]) & (east + reach >= bounds[0])
    near &= (south - reach <= bounds[3]) & (north + reach >= bounds[1])
    things, distances_m = things[near], distances_m[near]
    result: Shapes = np.array(things, dtype=object)
    for distance in np.unique(distances_m):
        same = distances_m == distance
        result[same] = outer_buffer(things[same], float(distance))
    return np.asarray(result[shapely.get_dimensions(result) == 2])
