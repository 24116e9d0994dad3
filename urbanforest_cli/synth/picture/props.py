"""Pools, fences, what lies about in yards and what stands on roofs."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.buildings import Buildings
from urbanforest_cli.synth.lots import Lots
from urbanforest_cli.synth.picture.boxes import PLAIN, WATERY, Boxes, clear_of, lot_directions, turned_left
from urbanforest_cli.synth.picture.draws import Draws
from urbanforest_cli.synth.picture.grounds import BACK, DEPTH, FRONT, HOME, USE, WIDTH, WORKS, YARD, Grounds
from urbanforest_cli.synth.picture.looks import CONCRETE, GROUNDS, POOL
from urbanforest_cli.synth.picture.relief_kernel import FLAT
from urbanforest_cli.synth.picture.roofs import Roofs
from urbanforest_cli.synth.plan import Floats

Integers = NDArray[np.int64]

_OFF_LOT_M = 1.5

_FENCES = np.array([(150, 134, 116, 150), (176, 172, 162, 160), (112, 98, 86, 116)], dtype=np.float64)
_THINGS = np.array(
    [(196, 194, 190, 180), (140, 128, 116, 136), (92, 88, 84, 86), (70, 92, 128, 96), (168, 112, 84, 160),
     (180, 170, 150, 170), (116, 122, 120, 112)], dtype=np.float64,
)  # fmt: skip
_CONTAINERS = np.array(
    [(150, 74, 58, 140), (78, 98, 138, 100), (188, 188, 184, 172), (170, 120, 66, 160), (88, 110, 92, 110)],
    dtype=np.float64,
)
_PANELS = np.array([52.0, 62.0, 88.0, 46.0])


def set_props(lots: Lots, grounds: Grounds, buildings: Buildings, roofs: Roofs, seed: int) -> Boxes:
    """Set all boxes of a city but its cars."""
    return Boxes.joined(
        [
            *_pools(lots, grounds, buildings, seed),
            _fences(lots, grounds, seed),
            _yard_things(lots, grounds, buildings, seed),
            _containers(lots, grounds, buildings, seed),
            _roof_things(buildings, roofs, seed),
            _panels(buildings, roofs, seed),
        ]
    )


def _pools(lots: Lots, grounds: Grounds, buildings: Buildings, seed: int) -> list[Boxes]:
    table = grounds.table
    draw = Draws(seed, "pool", len(table))
    room_m = table[:, DEPTH] - table[:, BACK]
    wanted = (table[:, USE] == HOME) & (room_m > 8.0) & (table[:, WIDTH] > 11) & (draw.uniform("wanted") < 0.17)
    lot = np.flatnonzero(wanted)
    x, y = table[:, WIDTH] * draw.uniform("x", 0.4, 0.6), (table[:, BACK] + table[:, DEPTH]) / 2 + 0.3
    xy = grounds.places(lot, x[lot], y[lot])
    kept = clear_of(xy, buildings.shapes, 2.8) & shapely.contains_xy(lots.shapes[lot], xy[:, 0], xy[:, 1])
    lot, xy = lot[kept], xy[kept]
    length, width = draw.uniform("length", 6.0, 9.0)[lot], draw.uniform("width", 3.2, 4.4)[lot]
    direction, flat = lot_directions(grounds, lot), np.full(len(lot), 0.02)
    some = Draws(seed, "pools", len(lot))
    rim = Boxes.of(xy, direction, length + 2.2, width + 2.2, flat, PLAIN, GROUNDS[CONCRETE] * 1.08, some)
    return [rim, Boxes.of(xy, direction, length, width, 2 * flat, WATERY, GROUNDS[POOL], some)]


def _fences(lots: Lots, grounds: Grounds, seed: int) -> Boxes:
    """Fence homes and works at the back and on one side, where the lot reaches as far as its site."""
    table = grounds.table
    draw = Draws(seed, "fence", len(table))
    fenced = np.isin(table[:, USE], (HOME, WORKS))
    behind = np.flatnonzero(fenced & (draw.uniform("behind") < 0.7))
    beside = np.flatnonzero(fenced & (draw.uniform("beside") < 0.75))
    from_m = np.where(table[:, FRONT] > 0, table[:, FRONT] + 1.0, 6.0)
    run_m = np.maximum(table[:, DEPTH] - from_m, 1.0)
    lot = np.concatenate((behind, beside))
    x = np.concatenate((table[behind, WIDTH] / 2, np.zeros(len(beside))))
    y = np.concatenate((table[behind, DEPTH], (from_m + run_m / 2)[beside]))
    along = lot_directions(grounds, lot)
    direction = np.where((np.arange(len(lot)) >= len(behind))[:, None], turned_left(along), along)
    length = np.concatenate((table[behind, WIDTH], run_m[beside]))
    xy = grounds.places(lot, x, y)
    half = direction * (length / 2)[:, None]
    kept = np.ones(len(lot), dtype=bool)
    for end in (xy - half, xy + half):
        kept &= shapely.dwithin(shapely.points(end), lots.shapes[lot], _OFF_LOT_M)
    colour = _FENCES[draw.pick("sort", len(_FENCES))[lot]]
    thick, high = np.full(len(lot), 0.18), np.full(len(lot), 1.7)
    return Boxes.of(xy, direction, length, thick, high, PLAIN, colour, Draws(seed, "fences", len(lot))).take(kept)


def _yard_things(lots: Lots, grounds: Grounds, buildings: Buildings, seed: int) -> Boxes:
    """Leave tables, sheets, bins and heaps about behind homes and in yards."""
    table = grounds.table
    mean = np.where(table[:, USE] == HOME, 3.0, np.where(table[:, USE] == YARD, 5.0, 0.0))
    each = Draws(seed, "yard", len(table))
    count = each.few("count", mean * 2 * each.uniform("untidy"))
    lot = np.repeat(np.arange(len(table)), count)
    draw = Draws(seed, "thing", len(lot))
    back = np.maximum(table[lot, BACK], 0.0)
    y = back + 0.6 + draw.uniform("y") ** 0.8 * np.maximum(table[lot, DEPTH] - back - 1.4, 0.0)
    xy = grounds.places(lot, draw.uniform("x", 0.05, 0.95) * table[lot, WIDTH], y)
    size = 0.6 + 2.0 * draw.uniform("size") ** 2.2
    colour = _THINGS[draw.pick("colour", len(_THINGS))] * draw.uniform("shade", 0.85, 1.1)[:, None]
    high = draw.uniform("high", 0.1, 1.5)
    things = Boxes.of(
        xy, lot_directions(grounds, lot), size, size * draw.uniform("slim", 0.5, 1.0), high, PLAIN, colour, draw
    )
    inside = shapely.contains_xy(lots.shapes[lot], xy[:, 0], xy[:, 1])
    return things.take(inside & clear_of(xy, buildings.shapes, 1.2))


def _containers(lots: Lots, grounds: Grounds, buildings: Buildings, seed: int) -> Boxes:
    """Store containers and trailers at the back of works."""
    table = grounds.table
    each = Draws(seed, "store", len(table))
    count = np.where(table[:, USE] == WORKS, each.pick("count", 26), 0)
    lot = np.repeat(np.arange(len(table)), count)
    draw = Draws(seed, "container", len(lot))
    column, row = draw.pick("column", 12), draw.pick("row", 3)
    x = 3.0 + 3.0 * column.astype(np.float64)
    xy = grounds.places(lot, x, table[lot, DEPTH] - 8.5 - 14.0 * row)
    colour = _CONTAINERS[draw.pick("colour", len(_CONTAINERS))] * draw.uniform("shade", 0.85, 1.1)[:, None]
    ones = np.ones(len(lot))
    direction = turned_left(lot_directions(grounds, lot))
    stored = Boxes.of(xy, direction, 12.0 * ones, 2.5 * ones, 2.7 * ones, PLAIN, colour, draw)
    half = 6.0 * direction
    inside = clear_of(xy, buildings.shapes, 6.8)
    for end in (xy - half, xy + half):
        inside &= shapely.contains_xy(lots.shapes[lot], end[:, 0], end[:, 1])
    return stored.take(inside)


def _roof_places(buildings: Buildings, building: Integers, draw: Draws) -> tuple[Floats, Floats]:
    """Draw a place on each building's bounds, and measure how far it is from the walls; -1 where it is not inside."""
    shapes = buildings.shapes[building]
    bounds = shapely.bounds(shapes).reshape(-1, 4)
    share = np.column_stack((draw.uniform("x"), draw.uniform("y")))
    xy = bounds[:, :2] + share * (bounds[:, 2:] - bounds[:, :2])
    off_m = np.asarray(shapely.distance(shapely.points(xy), shapely.boundary(shapes)))
    return xy, np.where(shapely.contains_xy(shapes, xy[:, 0], xy[:, 1]), off_m, -1.0)


def _roof_directions(roofs: Roofs, building: Integers) -> Floats:
    """Return the direction of each building's first wall."""
    first = roofs.edges[np.append(0, roofs.edge_ends[:-1])][building]
    return np.column_stack((first[:, 3], -first[:, 2]))


def _roof_things(buildings: Buildings, roofs: Roofs, seed: int) -> Boxes:
    """Set machines and skylights on flat roofs, chimneys and vents on others."""
    each = Draws(seed, "machines", len(roofs.form))
    flat = roofs.form == FLAT
    mean = np.where(flat, roofs.area_m2 / 75.0, np.minimum(roofs.area_m2 / 45.0, 8.0))
    count = np.where(roofs.area_m2 > 40, np.minimum(each.few("count", mean), 60), 0)
    building = np.repeat(np.arange(len(count)), count)
    draw = Draws(seed, "machine", len(building))
    xy, off_m = _roof_places(buildings, building, draw)
    size = np.where(flat[building], 0.5 + 2.3 * draw.uniform("size") ** 1.8, draw.uniform("vent", 0.35, 0.9))
    skylight = draw.uniform("sort") < 0.3
    rise = np.where(skylight, 0.25, draw.uniform("high", 0.4, 1.5))
    high = roofs.eave_m[building] + roofs.pitch[building] * off_m + np.where(flat[building], rise, 0.35)
    grey = np.where(skylight, 192.0, draw.uniform("grey", 96, 214))
    colour = grey[:, None] * np.array([1.0, 1.01, 1.01, 0.95])
    direction = _roof_directions(roofs, building)
    return Boxes.of(
        xy, direction, size, size * draw.uniform("slim", 0.6, 1.0), high, PLAIN, colour, draw
    ).take(off_m > 1.2)  # fmt: skip


def _panels(buildings: Buildings, roofs: Roofs, seed: int) -> Boxes:
    """Lay solar panels on some roofs."""
    each = Draws(seed, "solar", len(roofs.form))
    building = np.flatnonzero((each.uniform("wanted") < 0.14) & (roofs.area_m2 > 60))
    draw = Draws(seed, "panel", len(building))
    xy, off_m = _roof_places(buildings, building, draw)
    high = roofs.eave_m[building] + roofs.pitch[building] * (off_m + 1.1) + 0.12
    direction = _roof_directions(roofs, building)
    return Boxes.of(
        xy, direction, draw.uniform("length", 3.0, 5.2), draw.uniform("width", 2.0, 2.6), high, PLAIN, _PANELS, draw
    ).take(off_m > 2.6)
