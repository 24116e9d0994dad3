"""What stands in the way of plants: hydrants and masts along the roads, pipes behind lots, rails, river and ponds."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.blocks import Blocks
from urbanforest_cli.synth.buildings import Buildings
from urbanforest_cli.synth.lots import PLAIN, Lots
from urbanforest_cli.synth.plan import GARDEN, SUBURB, Floats, Geometries, Plan
from urbanforest_cli.synth.streets import Roads

_HYDRANT_EVERY_M, _MAST_EVERY_M = 130.0, 75.0
_POST_BEYOND_CURB_M = 0.5
_TRACK_GAUGE_M = 4.4
_PIPE_CLEARANCE_M = 2.5
_PIPE_OFF_WALLS_M = 0.5
_PIPE_LEAST_M = 20.0


@dataclass(frozen=True)
class Obstacles:
    """Shapes of any kind; a clearance is NaN where that of the kind will do."""

    shapes: Geometries
    kinds: NDArray[np.object_]
    clearances_m: Floats


def place_obstacles(
    plan: Plan,
    roads: Roads,
    blocks: Blocks,
    lots: Lots,
    ponds: Geometries,
    buildings: Buildings,
    rng: np.random.Generator,
) -> Obstacles:
    """Furnish the city that was kept: posts stand on no carriageway and no driveway, pipes lie under no building."""
    town = shapely.MultiPoint(blocks.corners.reshape(-1, 2)).convex_hull.buffer(40)
    ways = shapely.STRtree(buildings.driveways)
    hydrants, masts = (
        _off_the_road(points_along(roads, every_m, _POST_BEYOND_CURB_M, rng, both_sides=False), roads, ways)
        for every_m in (_HYDRANT_EVERY_M, _MAST_EVERY_M)
    )
    pipes = _pipes(blocks, lots, rng)
    under = shapely.STRtree(buildings.shapes).query(pipes, predicate="dwithin", distance=_PIPE_OFF_WALLS_M)[0]
    pipes = np.delete(pipes, np.unique(under))
    water, rails = [], []
    if plan.river is not None:
        water = [plan.river.intersection(town)]
    if plan.railway is not None:
        rails = [track.intersection(town) for track in tracks(plan.railway)]
    water_array = shapely.get_parts(np.array([*water, *ponds], dtype=object))
    rail_array = shapely.get_parts(np.array(rails, dtype=object))
    groups = (("hydrant", hydrants), ("mast", masts), ("pipe", pipes), ("rail", rail_array), ("water", water_array))
    kinds = np.repeat(np.array([kind for kind, _ in groups], dtype=object), [len(shapes) for _, shapes in groups])
    return Obstacles(
        np.concatenate([shapes for _, shapes in groups]),
        kinds,
        np.where(kinds == "pipe", _PIPE_CLEARANCE_M, np.nan),
    )


def tracks(railway: shapely.LineString) -> list[Any]:
    """Return the middles of a railway's two tracks."""
    return [shapely.offset_curve(railway, side * _TRACK_GAUGE_M / 2) for side in (1, -1)]


def points_along(
    roads: Roads, every_m: float, beyond_curb_m: float, rng: np.random.Generator, *, both_sides: bool
) -> Geometries:
    """Set points beside roads at about equal distances, on either side by turns or on both."""
    length_m = shapely.length(roads.lines)
    start = every_m * rng.random(len(length_m))
    count = np.maximum(np.floor((length_m - start) / every_m) + 1, 0).astype(np.int64)
    road = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(road)) - np.repeat(np.cumsum(count) - count, count)
    at = start[road] + number * every_m + rng.uniform(-0.08, 0.08, len(road)) * every_m
    at = np.clip(at, 0.3, np.maximum(length_m[road] - 0.3, 0.3))
    here = shapely.get_coordinates(shapely.line_interpolate_point(roads.lines[road], at))
    ahead = shapely.get_coordinates(shapely.line_interpolate_point(roads.lines[road], at + 0.2))
    behind = shapely.get_coordinates(shapely.line_interpolate_point(roads.lines[road], at - 0.2))
    direction = (ahead - behind) / np.maximum(np.hypot(*(ahead - behind).T), 1e-9)[:, None]
    normal = np.column_stack((-direction[:, 1], direction[:, 0]))
    offset = (roads.widths_m[road] / 2 + beyond_curb_m)[:, None]
    side = np.where(number % 2 == 0, 1.0, -1.0)[:, None]
    xy = here + side * offset * normal
    if both_sides:
        xy = np.concatenate((xy, here - side * offset * normal))
    return np.asarray(shapely.points(xy))


def _off_the_road(posts: Geometries, roads: Roads, ways: shapely.STRtree) -> Geometries:
    near, road = shapely.STRtree(roads.lines).query(posts, predicate="dwithin", distance=roads.widths_m.max(initial=0))
    half_m = roads.widths_m[road] / 2
    blocked = near[shapely.distance(posts[near], roads.lines[road]) < half_m]
    on_way = ways.query(posts, predicate="dwithin", distance=0.3)[0]
    return np.delete(posts, np.unique(np.concatenate((blocked, on_way))))


def _pipes(blocks: Blocks, lots: Lots, rng: np.random.Generator) -> Geometries:
    """Lay sewers along the backs of some rows of houses, where the border between two rows is an easement."""
    suburban = ~lots.cut & np.isin(lots.use, (SUBURB, GARDEN)) & lots.corner
    ends = np.flatnonzero(suburban & (rng.random(len(blocks.district)) < 0.25)[lots.block])
    pairs = np.column_stack((ends[:-1], ends[1:]))
    same = lots.block[pairs[:, 0]] == lots.block[pairs[:, 1]]
    begins = np.append(True, ~same)[: len(pairs)]  # the first two ends in a block are those of its first row
    pairs = pairs[same & begins & (lots.kind[pairs] == PLAIN).all(axis=1)]
    if not len(pairs):
        return np.empty(0, dtype=object)
    ends_xy = np.stack((lots.site[pairs[:, 0], 3], lots.site[pairs[:, 1], 2]), axis=1)
    pipes = np.asarray(shapely.linestrings(ends_xy))
    return pipes[shapely.length(pipes) > _PIPE_LEAST_M]  # a row of one lot has no second end
