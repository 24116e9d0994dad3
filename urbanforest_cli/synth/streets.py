"""Streets of the blocks that are kept: whole lines where a street goes on, none in empty land."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.blocks import Blocks, SideStreets
from urbanforest_cli.synth.plan import RAIL_CORRIDOR_M, SIDEWALK_M, Floats, Geometries, Plan

_BORDER_M = 14.0
"""A side street that runs this close to a main road would double it."""
_ALONG_COSINE = 0.75


@dataclass(frozen=True)
class Roads:
    """Middles of roads, with kind and width between the curbs."""

    lines: Geometries
    kinds: NDArray[np.object_]
    widths_m: Floats


@dataclass(frozen=True)
class _Segments:
    """Straight pieces of lines, in order along each line."""

    line: NDArray[np.int64]
    starts: Floats  # (segments, 2)
    ends: Floats

    @classmethod
    def of(cls, lines: Geometries) -> _Segments:
        xy, line = shapely.get_coordinates(lines, return_index=True)
        same = line[1:] == line[:-1]
        return cls(line[:-1][same], xy[:-1][same], xy[1:][same])

    def middles(self) -> Geometries:
        return np.asarray(shapely.points((self.starts + self.ends) / 2))

    def merged(self, kept: NDArray[np.bool_]) -> tuple[Geometries, NDArray[np.int64]]:
        """Return the kept segments as lines again, broken where one is missing, and the line each comes from."""
        number = np.flatnonzero(kept)
        if not len(number):
            return np.empty(0, dtype=object), np.empty(0, dtype=np.int64)
        begins = np.ones(len(number), dtype=bool)
        begins[1:] = (np.diff(number) != 1) | (self.line[number[1:]] != self.line[number[:-1]])
        run = np.cumsum(begins) - 1
        xy = np.concatenate((self.starts[number[begins]], self.ends[number]))
        index = np.concatenate((np.arange(run[-1] + 1), run))
        order = np.argsort(index, kind="stable")
        return np.asarray(shapely.linestrings(xy[order], indices=index[order])), self.line[number[begins]]


def finish_streets(plan: Plan, streets: SideStreets, blocks: Blocks) -> Roads:
    """Cut all roads to the blocks that are kept.

    Side streets end at their district's main roads, on the river's banks and before the railway; main roads bridge
    the river and cross the railway.
    """
    tree = shapely.STRtree(np.asarray(shapely.polygons(blocks.corners)))
    main = _main_roads(plan, tree)
    side = _side_streets(plan, streets, tree)
    return Roads(
        np.concatenate((main.lines, side.lines)),
        np.concatenate((main.kinds, side.kinds)),
        np.concatenate((main.widths_m, side.widths_m)),
    )


def _near(tree: shapely.STRtree, points: Geometries, reach_m: Floats) -> NDArray[np.bool_]:
    near = np.zeros(len(points), dtype=bool)
    near[tree.query(points, predicate="dwithin", distance=reach_m)[0]] = True
    return near


def _main_roads(plan: Plan, tree: shapely.STRtree) -> Roads:
    roads = plan.main_roads
    segments = _Segments.of(roads.lines)
    middles = segments.middles()
    reach_m = roads.widths_m[segments.line] / 2 + SIDEWALK_M + 6.0
    main = np.isin(roads.kinds[segments.line], ("boulevard", "avenue", "collector"))
    drop = np.zeros(len(middles), dtype=bool)
    if plan.river_course is not None:
        bank_m = plan.river_half_width_m + 12.0
        drop |= main & _runs_along(segments, middles, plan.river_course, bank_m)
        over = (roads.kinds[segments.line] != "quay") & (shapely.distance(middles, plan.river_course) < bank_m)
        reach_m = np.where(over, reach_m + 2 * bank_m, reach_m)
    if plan.railway is not None:
        narrow = main & (roads.kinds[segments.line] != "boulevard")
        drop |= narrow & _runs_along(segments, middles, plan.railway, RAIL_CORRIDOR_M)
    kept = ~drop & _near(tree, middles, reach_m)
    lines, of = segments.merged(kept)
    return Roads(lines, roads.kinds[of], roads.widths_m[of])


def _runs_along(
    segments: _Segments, middles: Geometries, course: shapely.LineString, within_m: float
) -> NDArray[np.bool_]:
    near = shapely.distance(middles, course) < within_m
    at = shapely.line_locate_point(course, middles[near])
    ahead = shapely.get_coordinates(shapely.line_interpolate_point(course, at + 1.0))
    behind = shapely.get_coordinates(shapely.line_interpolate_point(course, np.maximum(at - 1.0, 0.0)))
    direction = segments.ends[near] - segments.starts[near]
    cosine = np.abs(np.sum(direction * (ahead - behind), axis=1))
    cosine /= np.maximum(np.hypot(*direction.T) * np.hypot(*(ahead - behind).T), 1e-9)
    along = np.zeros(len(middles), dtype=bool)
    along[near] = cosine > _ALONG_COSINE
    return along


def _side_streets(plan: Plan, streets: SideStreets, tree: shapely.STRtree) -> Roads:
    boundaries = shapely.boundary(plan.cells)
    shapely.prepare(plan.street_regions)
    regions = plan.street_regions[streets.district]
    inside = shapely.contains_properly(regions, streets.lines)
    lines = streets.lines.copy()
    lines[~inside] = shapely.intersection(lines[~inside], regions[~inside])
    pieces, of = shapely.get_parts(lines, return_index=True)
    straight = shapely.get_type_id(pieces) == 1
    pieces, of = pieces[straight], of[straight]
    segments = _Segments.of(pieces)
    reach_m = streets.widths_m[of[segments.line]] / 2 + SIDEWALK_M + 5.0
    kept = _near(tree, segments.middles(), reach_m)
    border = boundaries[streets.district[of[segments.line]]]
    index = np.flatnonzero(kept)
    starts_m, ends_m = (
        shapely.distance(shapely.points(ends[index]), border[index]) for ends in (segments.starts, segments.ends)
    )
    length_m = np.hypot(*(segments.ends[index] - segments.starts[index]).T)
    along = np.abs(starts_m - ends_m) < 0.5 * length_m
    kept[index] = (np.maximum(starts_m, ends_m) > _BORDER_M) | ~along
    merged, piece = segments.merged(kept)
    return Roads(merged, streets.kinds[of[piece]], streets.widths_m[of[piece]])
