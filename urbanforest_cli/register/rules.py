"""Planting rules that need more than a distance: doors, windows, obstacles by kind, curbs and sight triangles.

Trees should not obstruct views at intersections, block entrances or stand before windows, and keep a distance from
the curb (paper, section Planting Rules).
"""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

import numpy as np
import pandas as pd
import shapely
from numpy.typing import NDArray
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components
from scipy.spatial import cKDTree

from urbanforest_cli.core.config import Rules

WALL_REACH_M = 3.0
"""How far an entrance may lie from the wall it belongs to."""
NODE_REACH_M = 0.5
"""Ends and crossings of road lines nearer than this are one intersection."""
ARM_LEAST_M = 2.0
"""A shorter stub of a line beyond an intersection is no road."""
ARM_REACH_M = 12.0
"""Where the direction of a road is taken, from the intersection."""
SHARPEST_CORNER_DEG = 20.0
BLUNTEST_CORNER_DEG = 160.0
"""Between these angles two roads make a corner; sharper, they merge, blunter, they are one road."""

Shapes = NDArray[Any]
Floats = NDArray[np.float64]


def _pairs() -> Floats:
    return np.empty((0, 2), dtype=np.float64)


@dataclass(frozen=True)
class Entrances:
    """Doors and windows on their walls.

    Parameters
    ----------
    start, end
        (n, 2) where the opening begins and ends along the wall; equal where only a point is known.
    along, outward
        (n, 2) unit vectors: of the wall, and away from the building.
    windows
        (n,) true for a window, false for a door.
    """

    start: Floats = field(default_factory=_pairs)
    end: Floats = field(default_factory=_pairs)
    along: Floats = field(default_factory=_pairs)
    outward: Floats = field(default_factory=_pairs)
    windows: NDArray[np.bool_] = field(default_factory=lambda: np.empty(0, dtype=bool))


def locate_entrances(
    shapes: Shapes, windows: NDArray[np.bool_], buildings: Shapes
) -> tuple[Entrances, NDArray[np.bool_]]:
    """Bring doors and windows to the nearest wall.

    Parameters
    ----------
    shapes
        (n,) points or lines in metres.
    windows
        (n,) whether each is a window.
    buildings
        (m,) valid polygons.

    Returns
    -------
    The entrances that have a wall within 3 m, and which of those given they are.
    """
    on_wall = np.zeros(len(shapes), dtype=bool)
    if not len(shapes) or not len(buildings):
        return Entrances(), on_wall
    tree = shapely.STRtree(shapely.boundary(buildings))
    entrance, building = tree.query_nearest(shapes, max_distance=WALL_REACH_M, all_matches=False)
    on_wall[entrance] = True
    tail, head, first, count = _walls(buildings, building)
    owner = np.repeat(np.arange(len(entrance)), count)
    wall = np.arange(count.sum()) + np.repeat(first - (np.cumsum(count) - count), count)
    middle = _middles(shapes[entrance])
    away = _distance_to_segments(middle[owner], tail[wall], head[wall])
    best = np.lexsort((away, owner))[np.cumsum(count) - count]
    tail, head = tail[wall[best]], head[wall[best]]
    along = (head - tail) / np.linalg.norm(head - tail, axis=1, keepdims=True)
    xy, place = shapely.get_coordinates(shapes[entrance], return_index=True)
    position = ((xy - tail[place]) * along[place]).sum(axis=1)
    low, high = np.full(len(entrance), np.inf), np.full(len(entrance), -np.inf)
    np.minimum.at(low, place, position)
    np.maximum.at(high, place, position)
    found = Entrances(
        start=tail + low[:, None] * along,
        end=tail + high[:, None] * along,
        along=along,
        outward=np.column_stack((along[:, 1], -along[:, 0])),
        windows=np.asarray(windows, dtype=bool)[entrance],
    )
    return found, on_wall


def _middles(shapes: Shapes) -> Floats:
    """Return (n, 2) the middles of lines, and the centres of other shapes."""
    xy = np.empty((len(shapes), 2))
    points, lines = (shapely.get_type_id(shapes) == kind for kind in (0, 1))
    others = ~points & ~lines
    xy[points] = shapely.get_coordinates(shapes[points])
    xy[lines] = shapely.get_coordinates(shapely.line_interpolate_point(shapes[lines], 0.5, normalized=True))
    xy[others] = shapely.get_coordinates(shapely.centroid(shapes[others]))
    return xy


def _walls(
    buildings: Shapes, wanted: NDArray[np.integer]
) -> tuple[Floats, Floats, NDArray[np.int64], NDArray[np.int64]]:
    """Return the walls of buildings as segments with the building on their left.

    Returns
    -------
    Tails and heads of all segments, and for each building wanted its first segment and their number.
    """
    used, place = np.unique(wanted, return_inverse=True)
    parts, part_of = shapely.get_parts(shapely.orient_polygons(buildings[used]), return_index=True)
    rings, ring_of = shapely.get_rings(parts, return_index=True)
    xy, ring = shapely.get_coordinates(rings, return_index=True)
    inside = (ring[1:] == ring[:-1]) & (xy[1:] != xy[:-1]).any(axis=1)
    count = np.bincount(part_of[ring_of[ring[:-1][inside]]], minlength=len(used))
    return xy[:-1][inside], xy[1:][inside], (np.cumsum(count) - count)[place], count[place]


def _distance_to_segments(points: Floats, tails: Floats, heads: Floats) -> Floats:
    """Return the distance of each point to the segment of the same row."""
    along = heads - tails
    share = ((points - tails) * along).sum(axis=1) / (along**2).sum(axis=1)
    nearest = tails + np.clip(share, 0, 1)[:, None] * along
    return np.asarray(np.linalg.norm(points - nearest, axis=1))


def entrance_areas(entrances: Entrances, rules: Rules) -> Shapes:
    """Return the rectangles kept free in front of doors and windows, square to the wall."""
    depth = np.where(entrances.windows, rules.window_depth_m, rules.door_depth_m)
    width = np.where(entrances.windows, rules.window_width_m, rules.door_width_m)
    length = np.linalg.norm(entrances.end - entrances.start, axis=1)
    widen = (np.maximum(width - length, 0) / 2)[:, None] * entrances.along
    start, end = entrances.start - widen, entrances.end + widen
    out = depth[:, None] * entrances.outward
    real = (depth > 0) & (width + length > 0)
    rings = np.stack((start, start + out, end + out, end), axis=1)[real]
    return np.asarray(shapely.polygons(rings), dtype=object) if len(rings) else np.empty(0, dtype=object)


def obstacle_distances(kinds: NDArray[np.object_], own_m: Floats, rules: Rules) -> Floats:
    """Return how far plants stay from each obstacle: its own distance, else its kind's, else the default."""
    by_kind = {kind.casefold(): distance for kind, distance in rules.obstacle_clearance_m.items()}
    default = by_kind["default"]
    codes, known = pd.factorize(kinds)
    ruled = np.array([by_kind.get(str(kind).strip().casefold(), default) for kind in known], dtype=np.float64)[codes]
    return np.where(np.isnan(own_m), ruled, own_m)


def carriageway_reach_m(roads: Shapes, widths_m: Floats, rules: Rules) -> Floats:
    """Return how far plants stay from each road's line, or from its polygon."""
    half = np.where(shapely.get_dimensions(roads) == 1, widths_m / 2, 0.0)
    return half + rules.curb_clearance_m


@dataclass(frozen=True)
class Corners:
    """Corners of road intersections: where two curbs would meet, and the unit vectors of both roads away from it."""

    points: Floats = field(default_factory=_pairs)
    one: Floats = field(default_factory=_pairs)
    other: Floats = field(default_factory=_pairs)


def sight_triangles(corners: Corners, leg_m: float) -> Shapes:
    """Return the triangles between a corner and the points `leg_m` along both curbs."""
    if leg_m <= 0 or not len(corners.points):
        return np.empty(0, dtype=object)
    rings = np.stack(
        (corners.points, corners.points + leg_m * corners.one, corners.points + leg_m * corners.other), axis=1
    )
    return np.asarray(shapely.polygons(rings), dtype=object)


def road_corners(lines: Shapes, widths_m: Floats) -> Corners:
    """Find the corners of all intersections where three or more roads meet.

    Lines meet at their ends and wherever they cross. Roads are taken as straight near an intersection, with parallel
    curbs half their width away; each pair of neighbouring roads has a corner where their curbs cross.

    Parameters
    ----------
    lines
        (n,) LineStrings in metres.
    widths_m
        (n,) widths of the carriageways.
    """
    lines = np.asarray(lines, dtype=object)
    if not len(lines):
        return Corners()
    nodes = _nodes(lines)
    node, direction, half = _arms(nodes, lines, widths_m)
    azimuth = np.arctan2(direction[:, 1], direction[:, 0])
    order = np.lexsort((azimuth, node))
    node, direction, half, azimuth = node[order], direction[order], half[order], azimuth[order]
    degree = np.bincount(node, minlength=len(nodes))
    first = np.cumsum(degree) - degree
    arm = np.arange(len(node))
    last = arm == first[node] + degree[node] - 1
    following = np.where(last, first[node], arm + 1)
    between = (azimuth[following] - azimuth) % (2 * np.pi)
    is_corner = (degree[node] >= 3) & (between > np.deg2rad(SHARPEST_CORNER_DEG)) & (
        between < np.deg2rad(BLUNTEST_CORNER_DEG)
    )  # fmt: skip
    arm, following, between = arm[is_corner], following[is_corner], between[is_corner]
    one, other = direction[arm], direction[following]
    points = nodes[node[arm]] + (half[following, None] * one + half[arm, None] * other) / np.sin(between)[:, None]
    return Corners(points, one, other)


def _nodes(lines: Shapes) -> Floats:
    """Return (k, 2) the places where lines end or cross, those that are one within half a metre joined."""
    ends = np.concatenate((shapely.get_point(lines, 0), shapely.get_point(lines, -1)))
    one, other = shapely.STRtree(lines).query(lines, predicate="intersects")
    once = one < other
    crossings = shapely.intersection(lines[one[once]], lines[other[once]])
    xy = np.concatenate((shapely.get_coordinates(ends), shapely.get_coordinates(crossings)))
    pairs = cKDTree(xy).query_pairs(NODE_REACH_M, output_type="ndarray")
    graph = coo_array((np.ones(len(pairs), bool), (pairs[:, 0], pairs[:, 1])), shape=(len(xy), len(xy)))
    count, member = connected_components(graph, directed=False)
    weight = np.bincount(member, minlength=count)
    return np.column_stack([np.bincount(member, xy[:, k] - xy[0, k], count) / weight + xy[0, k] for k in (0, 1)])


def _arms(nodes: Floats, lines: Shapes, widths_m: Floats) -> tuple[NDArray[np.int64], Floats, Floats]:
    """Return the roads that leave each node: node, unit direction, half width."""
    points = np.asarray(shapely.points(nodes), dtype=object)
    node, line = shapely.STRtree(lines).query(points, predicate="dwithin", distance=2 * NODE_REACH_M)
    shapes, length = lines[line], shapely.length(lines)[line]
    here = shapely.line_locate_point(shapes, points[node])
    closed = shapely.distance(shapely.get_point(shapes, 0), shapely.get_point(shapes, -1)) <= NODE_REACH_M
    found = []
    for sign, room in ((1.0, length - here), (-1.0, here)):
        around = closed & (room <= ARM_LEAST_M)
        room = np.where(around, length, room)
        start = np.where(around, np.where(sign > 0, 0.0, length), here)
        leaves = room > ARM_LEAST_M
        reach = np.minimum(ARM_REACH_M, room[leaves])
        target = shapely.line_interpolate_point(shapes[leaves], start[leaves] + sign * reach)
        direction = shapely.get_coordinates(target) - nodes[node[leaves]]
        found.append((node[leaves], direction, widths_m[line[leaves]] / 2))
    which, direction, half = (np.concatenate([item[k] for item in found]) for k in range(3))
    length = np.linalg.norm(direction, axis=1)
    straight = length > 0
    return which[straight], direction[straight] / length[straight, None], half[straight]
