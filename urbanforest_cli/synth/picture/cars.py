"""Cars: along curbs, on the road, before garages and in the stalls of paved lots."""

from __future__ import annotations

import numpy as np
import shapely

from urbanforest_cli.synth.buildings import Buildings
from urbanforest_cli.synth.lots import Lots
from urbanforest_cli.synth.picture.boxes import CAR, Boxes, clear_of, lot_directions, turned_left
from urbanforest_cli.synth.picture.draws import Draws
from urbanforest_cli.synth.picture.grounds import BACK_GROUND, DEPTH, FRONT_GROUND, SHOP, USE, WIDTH, Grounds
from urbanforest_cli.synth.picture.lines import Lines
from urbanforest_cli.synth.picture.looks import (
    AISLE_M,
    ASPHALT,
    CONCRETE,
    PAINTS,
    STALL_DEEP_M,
    STALL_M,
)
from urbanforest_cli.synth.plan import Floats
from urbanforest_cli.synth.streets import Roads

_CAR_M = (4.6, 1.85, 1.45)
_KERB_SHARE = {"street": 0.24, "collector": 0.17, "lane": 0.1, "quay": 0.22, "avenue": 0.08, "boulevard": 0.14}
_KERB_EVERY_M, _KERB_OFF_M = 6.6, 1.15
_DRIVING_EVERY_M, _DRIVING_SHARE, _LANE_SHARE = 46.0, 0.55, 0.54
_OFF_CROSSINGS_M = 9.0
_OFF_WALLS_M = 2.9


def set_cars(lots: Lots, grounds: Grounds, buildings: Buildings, roads: Roads, streets: Lines, seed: int) -> Boxes:
    """Set all cars of a city."""
    return Boxes.joined(
        [
            _on_roads(roads, streets, seed, parked=True),
            _on_roads(roads, streets, seed, parked=False),
            _in_driveways(buildings, seed),
            _in_stalls(lots, grounds, buildings, seed),
        ]
    )


def _cars(xy: Floats, direction: Floats, draw: Draws) -> Boxes:
    longer = draw.uniform("length", 0.92, 1.15)
    colour = PAINTS[draw.pick("paint", len(PAINTS))] * draw.uniform("shade", 0.92, 1.06)[:, None]
    turned = np.where(draw.uniform("turn")[:, None] < 0.5, direction, -direction)
    wide = np.full(len(xy), _CAR_M[1])
    return Boxes.of(xy, turned, _CAR_M[0] * longer, wide, _CAR_M[2] * longer, CAR, colour, draw)


def _on_roads(roads: Roads, streets: Lines, seed: int, *, parked: bool) -> Boxes:
    """Park cars along curbs off the crossings, or let cars drive in the middle of a half."""
    task = "parked" if parked else "driving"
    length_m = np.zeros(len(roads.lines))
    steps = np.hypot(*(streets.segments[:, 2:4] - streets.segments[:, :2]).T)
    np.add.at(length_m, streets.segments[:, 6].astype(np.int64), steps)
    shares = np.array([_KERB_SHARE.get(str(kind), 0.0) for kind in roads.kinds])
    share = shares if parked else np.where(shares > 0, _DRIVING_SHARE, 0.0)
    every_m = (_KERB_EVERY_M if parked else _DRIVING_EVERY_M) / 2
    count = np.where(share > 0, length_m / every_m, 0).astype(np.int64)
    road = np.repeat(np.arange(len(count)), count)
    number = np.arange(len(road)) - np.repeat(np.cumsum(count) - count, count)
    draw = Draws(seed, task, len(road))
    at_m = (number + draw.uniform("at", 0.45, 0.55)) * every_m
    half_m = roads.widths_m[road] / 2
    off_m = half_m - _KERB_OFF_M if parked else _LANE_SHARE * half_m
    xy, way = streets.places(road, at_m, np.where(number % 2 == 0, off_m, -off_m))
    kept = draw.uniform("there") < share[road]
    xy, way, road = xy[kept], way[kept], road[kept]
    if parked:
        near, segment = streets.tree.query(shapely.points(xy), predicate="dwithin", distance=_OFF_CROSSINGS_M)
        free = np.ones(len(xy), dtype=bool)
        free[near[streets.segments[segment, 6] != road[near]]] = False
        xy, way = xy[free], way[free]
    return _cars(xy, way, Draws(seed, f"{task} car", len(xy)))


def _in_driveways(buildings: Buildings, seed: int) -> Boxes:
    draw = Draws(seed, "drive", len(buildings.driveways))
    index = np.flatnonzero(draw.uniform("wanted") < 0.5)
    ways = buildings.driveways[index]
    corners = shapely.get_coordinates(shapely.minimum_rotated_rectangle(ways)).reshape(-1, 5, 2)
    first, second = corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 1]
    longer = np.where((np.hypot(*first.T) > np.hypot(*second.T))[:, None], first, second)
    xy = shapely.get_coordinates(shapely.centroid(ways)) + draw.uniform("shift", -0.25, 0.25)[index][:, None] * longer
    way = longer / np.maximum(np.hypot(*longer.T), 1e-9)[:, None]
    return _cars(xy, way, Draws(seed, "drive car", len(index)))


def _in_stalls(lots: Lots, grounds: Grounds, buildings: Buildings, seed: int) -> Boxes:
    """Fill stalls of paved lots; the stalls are those the ground is marked with."""
    table = grounds.table
    paved = (table[:, FRONT_GROUND] == ASPHALT) | ((table[:, USE] == SHOP) & (table[:, BACK_GROUND] == CONCRETE))
    across = np.maximum(table[:, WIDTH] / STALL_M, 0).astype(np.int64)
    deep = np.maximum(table[:, DEPTH] / (STALL_DEEP_M + AISLE_M / 2), 0).astype(np.int64)
    count = np.where(paved, across * deep, 0)
    lot = np.repeat(np.arange(len(table)), count)
    number = np.arange(len(lot)) - np.repeat(np.cumsum(count) - count, count)
    column, row = number % across[lot], number // across[lot]
    x = (column + 0.5) * STALL_M
    y = (row // 2) * (2 * STALL_DEEP_M + AISLE_M) + (row % 2 + 0.5) * STALL_DEEP_M
    full = Draws(seed, "stalls", len(table)).uniform("full", 0.1, 0.7)[lot]
    kept = (Draws(seed, "stall", len(lot)).uniform("taken") < full) & (y < table[lot, DEPTH] - 2)
    lot, xy = lot[kept], grounds.places(lot[kept], x[kept], y[kept])
    free = shapely.contains_xy(lots.shapes[lot], xy[:, 0], xy[:, 1]) & clear_of(xy, buildings.shapes, _OFF_WALLS_M)
    lot, xy = lot[free], xy[free]
    return _cars(xy, turned_left(lot_directions(grounds, lot)), Draws(seed, "stall car", len(lot)))
