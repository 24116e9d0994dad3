"""Street lots where a register has none: a strip along both sides of every road, for the trees along it."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Rules
from urbanforest_cli.register.cleaning import id_order
from urbanforest_cli.register.envelopes import difference, drop_small, outer_buffer, subtract
from urbanforest_cli.register.near import Near, NearThings
from urbanforest_cli.register.rules import NODE_REACH_M, carriageway_reach_m

SAMPLE_STEP_M = 5.0
STRIP_LEAST_M = 0.5
"""Pieces of a strip that are nowhere wider hold no tree."""
COVERED_SHARE = 0.5
"""A road of which more than half lies in lots is one that the register does not cut out."""

Shapes = NDArray[Any]


@dataclass(frozen=True)
class Roads:
    """Roads in metres: lines with the width of their carriageway, or polygons of it with width 0."""

    shapes: Shapes
    widths_m: NDArray[np.float64]
    ids: NDArray[np.object_]
    kinds: NDArray[np.object_] | None = None


@dataclass(frozen=True)
class Strips:
    """Street strips: one a road, None where there is no room, and the corridors that lots leave to them."""

    shapes: Shapes
    ids: NDArray[np.object_]
    corridors: Shapes


def join_roads(roads: Roads) -> Roads:
    """Join road lines of one width that go on in each other, so that a street is one lot and not many.

    Lines are joined where exactly two ends meet and nothing crosses. A joined road has the first of its members' ids.
    """
    lines = shapely.get_type_id(roads.shapes) == 1
    shapes, widths, ids = roads.shapes[lines], roads.widths_m[lines], roads.ids[lines]
    root = np.arange(len(shapes))

    def find(member: int) -> int:
        while root[member] != member:
            root[member] = root[root[member]]
            member = int(root[member])
        return member

    for one, other in _continuations(shapes):
        if widths[one] == widths[other]:
            root[find(one)] = find(other)
    groups: dict[int, list[int]] = defaultdict(list)
    for member in range(len(shapes)):
        groups[find(member)].append(member)
    joined, joined_widths, joined_ids = [], [], []
    for members in groups.values():
        members.sort(key=lambda member: id_order(str(ids[member])))
        whole = shapes[members[0]]
        if len(members) > 1:
            whole = _one_way(shapely.line_merge(shapely.multilinestrings(shapes[members])))
        joined.append(whole)
        joined_widths.append(widths[members[0]])
        joined_ids.append(ids[members[0]])
    order = sorted(range(len(joined)), key=lambda row: id_order(str(joined_ids[row])))
    result = np.empty(len(joined), dtype=object)
    result[:] = [joined[row] for row in order]
    return Roads(
        np.concatenate((result, roads.shapes[~lines])),
        np.concatenate(([joined_widths[row] for row in order], roads.widths_m[~lines])).astype(np.float64),
        np.concatenate((np.array([joined_ids[row] for row in order], dtype=object), roads.ids[~lines])),
    )


def _one_way(lines: Any) -> Any:
    """Turn lines so that they run the same way however they came: merging may reverse them for a hair's difference."""
    parts = shapely.get_parts(lines)
    ends = shapely.get_coordinates(shapely.get_point(parts, -1)) - shapely.get_coordinates(shapely.get_point(parts, 0))
    backward = ends @ np.array([1.0, np.sqrt(2.0)]) < 0
    turned = np.where(backward, shapely.reverse(parts), parts)
    return turned[0] if len(turned) == 1 else shapely.multilinestrings(turned)


def _continuations(lines: Shapes) -> list[tuple[int, int]]:
    """Return pairs of lines that share an end with each other and with no third line."""
    if len(lines) < 2:
        return []
    ends = np.concatenate((shapely.get_point(lines, 0), shapely.get_point(lines, -1)))
    line_of = np.tile(np.arange(len(lines)), 2)
    end, line = shapely.STRtree(lines).query(ends, predicate="dwithin", distance=NODE_REACH_M / 100)
    alone = np.bincount(end, minlength=len(ends)) == 2
    end, line = end[alone[end]], line[alone[end]]
    other = line != line_of[end]
    end, line = end[other], line[other]
    gap = np.minimum(
        shapely.distance(ends[end], shapely.get_point(lines[line], 0)),
        shapely.distance(ends[end], shapely.get_point(lines[line], -1)),
    )
    meets = gap <= NODE_REACH_M / 100
    pairs = zip(line_of[end[meets]].tolist(), line[meets].tolist(), strict=True)
    return sorted({(min(a, b), max(a, b)) for a, b in pairs})


def share_in_lots(roads: Shapes, lots: Shapes) -> NDArray[np.float64]:
    """Return which share of each road lies in lots, by points every 5 m along its middle."""
    share = np.zeros(len(roads))
    present = np.asarray(lots)[~shapely.is_missing(lots)]
    if not len(roads) or not len(present):
        return share
    polygons = shapely.get_dimensions(roads) == 2
    middles = np.where(polygons, shapely.boundary(shapely.buffer(roads, -0.5)), roads)
    lengths = shapely.length(middles)
    counts = np.maximum(np.ceil(lengths / SAMPLE_STEP_M).astype(np.int64), 1)
    owner = np.repeat(np.arange(len(roads)), counts)
    nth = np.arange(counts.sum()) - np.repeat(np.cumsum(counts) - counts, counts)
    points = shapely.line_interpolate_point(middles[owner], (nth + 0.5) / counts[owner], normalized=True)
    inside = np.unique(shapely.STRtree(present).query(points, predicate="intersects")[0])
    hit = np.bincount(owner[inside], minlength=len(roads))
    return np.asarray(hit / counts)


def roads_outside(roads: Roads, street_lots: Shapes) -> Roads:
    """Return the roads of which at most half lies in lots that are streets themselves."""
    bare = share_in_lots(roads.shapes, street_lots) <= COVERED_SHARE
    return Roads(roads.shapes[bare], roads.widths_m[bare], roads.ids[bare])


def roads_with_trees(roads: Roads, rules: Rules) -> Roads:
    """Return the roads along which trees are set: those of a kind not named in `treeless_road_kinds`."""
    if roads.kinds is None:
        return roads
    planted = ~np.isin(roads.kinds, np.array(rules.treeless_road_kinds, dtype=object))
    return Roads(roads.shapes[planted], roads.widths_m[planted], roads.ids[planted])


def verge_strips(roads: Roads, rules: Rules, lots: Shapes) -> Strips:
    """Return the strips for trees on both sides of roads.

    A strip begins `curb_clearance_m` beyond the curb and is `verge_width_m` wide. It leaves out every carriageway;
    at a corner strips may overlap (`first_come` settles whose ground that is). Where the register cuts roads out of
    the lots, it stays `sidewalk_width_m` from them; where more than half of a road lies in lots, the lots reach over
    it, and they give way to the strip and the sidewalk beyond it: the road's corridor.

    Parameters
    ----------
    roads
        As `join_roads` returns them.
    lots
        (n,) valid polygons in metres, None for none.
    """
    inner = carriageway_reach_m(roads.shapes, roads.widths_m, rules)
    outer = inner + rules.verge_width_m
    lines = shapely.get_dimensions(roads.shapes) == 1
    strips = np.full(len(roads.shapes), None, dtype=object)
    carriageways = np.full(len(roads.shapes), None, dtype=object)
    corridors = np.full(len(roads.shapes), None, dtype=object)
    for reach in np.unique(inner):
        same = inner == reach
        carriageways[same] = outer_buffer(roads.shapes[same], float(reach))
        for line in (True, False):
            rows = same & (lines == line)
            strips[rows] = shapely.buffer(
                roads.shapes[rows], outer[rows], quad_segs=8, cap_style="flat" if line else "round"
            )
    covered = share_in_lots(roads.shapes, lots) > COVERED_SHARE
    sides, road = shapely.get_parts(difference(strips, carriageways), return_index=True)
    sides = _less_others(sides, road, carriageways)
    present = np.asarray(lots)[~shapely.is_missing(lots)]
    beside = np.flatnonzero(~covered[road])
    sides[beside], _ = NearThings([Near(present, rules.sidewalk_width_m)]).leave(sides[beside], 0.0)
    sides, _ = drop_small(sides, rules.min_area_m2, half_width_m=STRIP_LEAST_M / 2)
    strips = regrouped(sides, road, len(strips))
    covered &= ~shapely.is_missing(strips)
    for reach in np.unique(outer[covered]):
        same = covered & (outer == reach)
        corridors[same] = outer_buffer(roads.shapes[same], float(reach) + rules.sidewalk_width_m)
    return Strips(strips, roads.ids, corridors)


def _less_others(sides: Shapes, road: NDArray[np.integer], carriageways: Shapes) -> Shapes:
    """Return strips without the carriageways of all roads but their own, which they lie beside already."""
    side, other = shapely.STRtree(carriageways).query(sides, predicate="intersects")
    foreign = road[side] != other
    order = np.lexsort((other[foreign], side[foreign]))
    return subtract(sides, side[foreign][order], carriageways[other[foreign][order]])


def regrouped(parts: Shapes, owner: NDArray[np.integer], count: int) -> Shapes:
    """Return for each owner one shape of all its parts, None where it has none; parts come sorted by owner."""
    pieces, part = shapely.get_parts(parts, return_index=True)
    real = shapely.area(pieces) > 0
    pieces, rows = pieces[real], owner[part[real]]
    whole = np.full(count, None, dtype=object)
    used, place = np.unique(rows, return_inverse=True)
    if len(used):
        whole[used] = shapely.multipolygons(pieces, indices=place)
    return whole


def first_come(parts: Shapes, owner: NDArray[np.integer]) -> Shapes:
    """Return the ground of strips without that of strips before them, so that none is planted twice at a corner.

    Parameters
    ----------
    parts, owner
        Pieces of strips, and which strip each is of.
    """
    one, other = shapely.STRtree(parts).query(parts, predicate="intersects")
    earlier = owner[other] < owner[one]
    order = np.lexsort((other[earlier], one[earlier]))
    return subtract(parts, one[earlier][order], parts[other[earlier][order]])
