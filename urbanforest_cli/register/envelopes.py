"""The ground that is left: a lot less the envelopes of all that plants keep away from.

Distances are true ones. A buffer's arcs are chords, which would let plants come nearer than asked; here the radius is
enlarged so that every chord stays outside the true arc, by at most 8 mm. Notches of a wall shallower than a hundredth
of the distance may be bridged, which makes an envelope wider there, never narrower.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.errors import GEOSException

from urbanforest_cli.core.config import Rules
from urbanforest_cli.register.envelope_kernel import DONE, lots_less_envelopes
from urbanforest_cli.register.rules import (
    Corners,
    Entrances,
    carriageway_reach_m,
    entrance_areas,
    obstacle_distances,
    sight_triangles,
)

ARC_EXCESS_M = 0.008
WIDEST_STEP = 0.75
"""Half of the widest arc step that GEOS takes, in steps of 90 degrees / quad_segs: it rounds their number, so that a
corner that turns by just under 1.5 steps gets one."""
COMPACT_SHARE = 0.2
"""A lot that fills less of its bounds has many things in them that are not near."""
OWN_SHARE = 0.01
"""A building belongs to every lot that holds at least this share of it; a party wall on the line makes no owner."""
SLIVER_M = 0.02
LOTS_A_CHUNK = 2048
POLYGON_KINDS = 4
"""Walls, driveways, entrances and corners come before points in the list of what is near."""
RESCUE_GRID_M = 1e-6

Shapes = NDArray[Any]


def arc_segments(distance_m: float) -> int:
    """Return into how many chords a quarter circle is cut so that the excess stays below 8 mm."""
    if distance_m <= 0:
        return 1
    widest = math.acos(distance_m / (distance_m + ARC_EXCESS_M))
    return max(2, math.ceil(WIDEST_STEP * math.pi / 2 / widest))


def outer_distance(distance_m: float) -> float:
    """Return the radius whose chords stay outside the arc of `distance_m`."""
    return distance_m / math.cos(WIDEST_STEP * math.pi / 2 / arc_segments(distance_m))


def outer_buffer(shapes: Shapes, distance_m: float) -> Shapes:
    """Return areas that hold every point nearer than `distance_m`, and few others.

    Parameters
    ----------
    shapes
        (n,) geometries in metres.
    """
    if distance_m == 0:
        return np.asarray(shapes, dtype=object)
    wide = shapely.buffer(shapes, outer_distance(distance_m), quad_segs=arc_segments(distance_m))
    return np.asarray(wide, dtype=object)


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

    def within(self, rows: NDArray[np.int64]) -> Taken:
        """Return the pairs of some lots, with the lots' places in `rows`, which must be sorted."""
        place = np.searchsorted(rows, self.lots)
        here = (place < len(rows)) & (rows[np.minimum(place, max(len(rows) - 1, 0))] == self.lots) if len(rows) else (
            np.zeros(len(self.lots), dtype=bool)
        )  # fmt: skip
        return Taken(place[here], self.shapes[here])


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
    jobs = []
    for rules, members in groups.values():
        rows = np.flatnonzero(np.isin(zones, members))
        keeper = _Keeper(rules, around, shapely.total_bounds(lots[rows]))
        jobs += [(keeper, rows[start : start + LOTS_A_CHUNK]) for start in range(0, len(rows), LOTS_A_CHUNK)]
    done = 0

    def work(job: tuple[_Keeper, NDArray[np.int64]]) -> tuple[NDArray[np.int64], Shapes, NDArray[np.int64]]:
        keeper, rows = job
        left = keeper.leave(lots[rows], taken.within(rows), on_road[rows])
        return rows, left.areas, left.dropped_parts

    with ThreadPoolExecutor(workers) as pool:
        for rows, left, count in pool.map(work, jobs) if workers > 1 else map(work, jobs):
            areas[rows] = left
            dropped[rows] = count
            done += len(rows)
            if report is not None:
                report(done, len(lots))
    return Ground(areas, dropped)


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
        self.near = [
            _Near(around.buildings, rules.building_clearance_m),
            _Near(around.driveways[~lines], rules.driveway_clearance_m),
            _Near(entrance_areas(around.entrances, rules), 0.0),
            _Near(sight_triangles(around.corners, rules.sight_triangle_m), 0.0),
            *(
                _Near(around.obstacles[points_given & (far_m == far)], float(far))
                for far in np.unique(far_m[points_given & (far_m > 0)])
            ),
        ]
        polygons = [near.things for near in self.near[:POLYGON_KINDS]]
        points = [near.things for near in self.near[POLYGON_KINDS:]]
        self.things = _with_points(_flat(np.concatenate(polygons)), np.concatenate([_none(), *points]))
        self.clearance_m = np.concatenate([np.full(len(near.things), near.distance_m) for near in self.near])
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
        ground = self._less_near(lots)
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

    def _less_near(self, lots: Shapes) -> Ground:
        pairs = []
        first = 0
        for near in self.near:
            row, thing = near.pairs(lots, only_own=True) if self._only_own(near) else near.candidates(lots)
            pairs.append((row, thing + first))
            first += len(near.things)
        row, thing = (np.concatenate([pair[k] for pair in pairs]) for k in (0, 1))
        order = np.lexsort((thing, row))
        some, place = np.unique(row[order], return_inverse=True)
        areas: Shapes = np.array(lots, dtype=object)
        dropped = np.zeros(len(lots), dtype=np.int64)
        parts, owner, done = _exactly(lots[some], self.things, self.clearance_m, place, thing[order])
        areas[some[done]], dropped[some[done]] = _keep_parts(
            parts, np.searchsorted(np.flatnonzero(done), owner), int(done.sum()), self.rules.min_area_m2
        )
        undone = some[~done]
        left = areas[undone]
        for near in self.near:
            again, shapes = near.around(left, only_own=self._only_own(near))
            left = subtract(left, again, shapes)
        areas[undone] = left
        rest = np.setdiff1d(np.arange(len(lots)), some[done])
        areas[rest], dropped[rest] = drop_small(areas[rest], self.rules.min_area_m2)
        return Ground(areas, dropped)

    def _only_own(self, near: _Near) -> bool:
        return near is self.near[0] and not self.rules.neighbour_buildings


@dataclass(frozen=True)
class _Flat:
    """Polygons and points as arrays: positions of rings, inside on the left; where rings and shapes begin; bounds."""

    xy: NDArray[np.float64]
    rings: NDArray[np.int64]
    offsets: NDArray[np.int64]
    boxes: NDArray[np.float64]


def _flat(polygons: Shapes) -> _Flat:
    if not len(polygons):
        return _Flat(np.empty((0, 2)), np.zeros(1, np.int64), np.zeros(1, np.int64), np.empty((0, 4)))
    kind, xy, starts = shapely.to_ragged_array(polygons, include_z=False)
    rings, parts = (np.asarray(values, dtype=np.int64) for values in starts[:2])
    offsets = parts[starts[2]] if kind == shapely.GeometryType.MULTIPOLYGON else parts
    outer = np.zeros(len(rings) - 1, dtype=bool)
    outer[parts[:-1]] = True
    ring = np.repeat(np.arange(len(outer)), np.diff(rings))
    local = xy - xy[rings[:-1]][ring]
    cross = np.append(local[:-1, 0] * local[1:, 1] - local[1:, 0] * local[:-1, 1], 0.0)
    backward = (np.add.reduceat(cross, rings[:-1]) > 0) != outer
    here = np.arange(len(xy))
    xy = xy[np.where(backward[ring], (rings[:-1] + rings[1:] - 1)[ring] - here, here)]
    return _Flat(xy, rings, offsets, shapely.bounds(polygons))


def _with_points(polygons: _Flat, points: Shapes) -> _Flat:
    """Return polygons followed by points, each a ring of one position."""
    count = np.arange(1, len(points) + 1)
    return _Flat(
        np.concatenate((polygons.xy, shapely.get_coordinates(points))),
        np.concatenate((polygons.rings, polygons.rings[-1] + count)),
        np.concatenate((polygons.offsets, polygons.offsets[-1] + count)),
        np.concatenate((polygons.boxes, shapely.bounds(points).reshape(-1, 4))),
    )


def _exactly(
    lots: Shapes,
    things: _Flat,
    clearance_m: NDArray[np.float64],
    row: NDArray[np.integer],
    thing: NDArray[np.integer],
) -> tuple[Shapes, NDArray[np.int64], NDArray[np.bool_]]:
    """Return lots less the envelopes of the things paired with them.

    Returns
    -------
    The pieces that are left, the lot of each, and which of the lots that worked for.
    """
    flat = _flat(lots)
    offsets = np.searchsorted(row, np.arange(len(lots) + 1))
    xy, rings, shell, lot, status = lots_less_envelopes(
        flat.xy, flat.rings, flat.offsets, things.xy, things.rings, things.offsets, things.boxes, clearance_m,
        offsets, np.ascontiguousarray(thing), ARC_EXCESS_M,
    )  # fmt: skip
    done = status == DONE
    if not len(shell):
        return np.empty(0, dtype=object), np.empty(0, dtype=np.int64), done
    shells = np.flatnonzero(shell == np.arange(len(shell)))
    order = np.argsort(shell, kind="stable")
    order = order[np.lexsort((order != shell[order], shell[order]))]
    size = np.diff(rings)[order]
    ends = np.cumsum(size)
    xy = xy[np.arange(len(xy)) + np.repeat(rings[order] - (ends - size), size)]
    firsts = np.append(np.searchsorted(shell[order], shells), len(shell))
    parts = shapely.from_ragged_array(shapely.GeometryType.POLYGON, xy, (np.append(0, ends), firsts))
    owner = lot[shells]
    done[owner[~shapely.is_valid(parts)]] = False
    return parts[done[owner]], owner[done[owner]], done


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


class _Near:
    """Polygons, or points, of one clearance and their index."""

    def __init__(self, things: Shapes, distance_m: float) -> None:
        whole = np.isin(shapely.get_type_id(things), (0, 3)).all()
        self.things = np.asarray(things if whole else shapely.get_parts(things), dtype=object)
        self.distance_m = distance_m
        self.tree = shapely.STRtree(self.things)

    def candidates(self, lots: Shapes) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return lots and things that may be near each other: those whose bounds are, unless the lot is long and thin."""
        bounds = shapely.bounds(lots)
        compact = shapely.area(lots) > COMPACT_SHARE * (bounds[:, 2] - bounds[:, 0]) * (bounds[:, 3] - bounds[:, 1])
        slim, wide = np.flatnonzero(~compact), np.flatnonzero(compact)
        far = self.distance_m
        boxes = shapely.box(*(bounds[wide] + [-far, -far, far, far]).T)
        row, thing = self.tree.query(boxes)
        slim_row, slim_thing = self.pairs(lots[slim])
        return np.concatenate((wide[row], slim[slim_row])), np.concatenate((thing, slim_thing))

    def pairs(self, lots: Shapes, *, only_own: bool = False) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        """Return lots and things that are near each other, sorted by both."""
        if self.distance_m > 0:
            row, thing = self.tree.query(lots, predicate="dwithin", distance=self.distance_m)
        else:
            row, thing = self.tree.query(lots, predicate="intersects")
        if only_own:
            mine = shapely.area(shapely.intersection(self.things[thing], lots[row]))
            own = mine > OWN_SHARE * shapely.area(self.things[thing])
            row, thing = row[own], thing[own]
        order = np.lexsort((thing, row))
        return row[order], thing[order]

    def around(self, lots: Shapes, *, only_own: bool = False) -> tuple[NDArray[np.int64], Shapes]:
        """Return the rows of lots that have some of the things near, and for each one envelope around all of those."""
        row, thing = self.pairs(lots, only_own=only_own)
        rows, place = np.unique(row, return_inverse=True)
        if not len(rows):
            return rows, np.empty(0, dtype=object)
        joined = np.asarray(shapely.geometrycollections(self.things[thing], indices=place), dtype=object)
        if self.distance_m == 0:
            return rows, np.asarray(shapely.union_all(joined[:, None], axis=1), dtype=object)
        return rows, outer_buffer(joined, self.distance_m)


def subtract(lots: Shapes, owner: NDArray[np.integer], cutters: Shapes) -> Shapes:
    """Return lots less areas, any number a lot.

    Parameters
    ----------
    lots
        (n,) polygons.
    owner, cutters
        (m,) the row of the lot that each area is taken from, and the area.
    """
    left = np.array(lots, dtype=object)
    order = np.argsort(owner, kind="stable")
    owner, cutters = owner[order], cutters[order]
    start = np.searchsorted(owner, owner, side="left")
    rank = np.arange(len(owner)) - start
    for level in range(int(rank.max(initial=-1)) + 1):
        here = rank == level
        rows, shapes = owner[here], cutters[here]
        if level:
            meet = shapely.intersects(left[rows], shapes)
            rows, shapes = rows[meet], shapes[meet]
        left[rows] = difference(left[rows], shapes)
    return left


def difference(shapes: Shapes, cutters: Shapes) -> Shapes:
    """Return `shapely.difference`, with pairs that its fast arithmetic cannot resolve done again on a fine grid."""
    try:
        return np.asarray(shapely.difference(shapes, cutters), dtype=object)
    except GEOSException:  # one pair of many; find it
        if len(shapes) == 1:
            sound = shapely.make_valid(cutters, method="structure", keep_collapsed=False)
            return np.asarray(shapely.difference(shapes, sound, grid_size=RESCUE_GRID_M), dtype=object)
        middle = len(shapes) // 2
        return np.concatenate(
            (difference(shapes[:middle], cutters[:middle]), difference(shapes[middle:], cutters[middle:]))
        )


def drop_small(areas: Shapes, least_m2: float, *, half_width_m: float = SLIVER_M) -> tuple[Shapes, NDArray[np.int64]]:
    """Drop pieces below an area, and slivers nowhere wider than twice `half_width_m`, by default 4 cm.

    Returns
    -------
    The areas, None where nothing is left, and how many pieces each lost.
    """
    parts, owner = shapely.get_parts(areas, return_index=True)
    return _keep_parts(parts, owner, len(areas), least_m2, half_width_m)


def _keep_parts(
    parts: Shapes, owner: NDArray[np.integer], count: int, least_m2: float, half_width_m: float = SLIVER_M
) -> tuple[Shapes, NDArray[np.int64]]:
    area, length = shapely.area(parts), shapely.length(parts)
    keep = (shapely.get_dimensions(parts) == 2) & (area >= least_m2) & (area > 0)
    # the inscribed circle's radius is at least area / perimeter, so most need no closer look
    thin = np.flatnonzero(keep & (area < half_width_m * length))
    keep[thin] = ~shapely.is_empty(shapely.buffer(parts[thin], -half_width_m, quad_segs=1))
    dropped = np.bincount(owner[~keep & (area > 0)], minlength=count)
    result = np.full(count, None, dtype=object)
    kept, kept_owner = parts[keep], owner[keep]
    single = np.bincount(kept_owner, minlength=count)[kept_owner] == 1
    result[kept_owner[single]] = kept[single]
    many, place = np.unique(kept_owner[~single], return_inverse=True)
    if len(many):
        result[many] = shapely.multipolygons(kept[~single], indices=place)
    return result, dropped.astype(np.int64)
