"""Plants seen from the air: those of the inventory, and shrubs and hedges that no surveyor counts."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.synth.buildings import Buildings
from urbanforest_cli.synth.city import SynthCity
from urbanforest_cli.synth.inventory import SURVEYED_LOTS, Inventory, surveyed_lots, take_inventory
from urbanforest_cli.synth.lots import Lots
from urbanforest_cli.synth.picture.boxes import clear_of
from urbanforest_cli.synth.picture.draws import STAGE, Draws
from urbanforest_cli.synth.picture.grounds import (
    BACK,
    DEPTH,
    FRONT,
    GREENS,
    HOME,
    LEFT,
    RIGHT,
    SCHOOL,
    SHOP,
    USE,
    WIDTH,
    Grounds,
)
from urbanforest_cli.synth.picture.looks import LEAVES
from urbanforest_cli.synth.plan import Floats
from urbanforest_cli.synth.streets import Roads

_SHRUBS = {HOME: 6.0, SHOP: 3.0, GREENS: 10.0, SCHOOL: 8.0}
_HEDGE_STEP_M = 0.75
_OFF_WALLS_M, _OFF_WAYS_M = 0.25, 0.4
_APART_M = 3.2
_AROUND_M = 30.0


@dataclass(frozen=True)
class Plants:
    """Crowns."""

    table: Floats  # (plants, 6) x, y, height, crown radius, crown base, salt
    colour: Floats  # (plants, 4)

    @classmethod
    def joined(cls, parts: list[Plants]) -> Plants:
        """Return the plants of several lists."""
        return cls(np.concatenate([part.table for part in parts]), np.concatenate([part.colour for part in parts]))

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Plants:
        """Return some of the plants."""
        return Plants(self.table[index], self.colour[index])


def dressed_inventory(inventory: Inventory, catalogue: Catalogue, seed: int, sort: str) -> Plants:
    """Give the plants of an inventory their looks."""
    draw = Draws(seed, sort, len(inventory.points))
    shrub = np.array([catalogue[str(name)].habit == "shrub" for name in inventory.species], dtype=bool)
    kind = np.array([catalogue.index_of(str(name)) for name in inventory.species], dtype=np.int64)
    base = inventory.heights_m * np.where(shrub, 0.05, draw.uniform("base", 0.2, 0.36))
    radius = np.asarray(inventory.crown_diameters_m) / 2
    return dressed(shapely.get_coordinates(inventory.points), inventory.heights_m, radius, base, kind, draw)


def unsurveyed_plants(city: SynthCity, catalogue: Catalogue, seed: int) -> list[Plants]:
    """Plant the lots beyond the surveyed ones as those were, some thousand at a time."""
    lots, buildings, roads = city.lots, city.buildings, city.roads
    beyond = np.setdiff1d(np.arange(len(lots)), surveyed_lots(lots))
    trees = [shapely.STRtree(shapes) for shapes in (buildings.shapes, buildings.driveways, roads.lines)]
    parts, taken = [], shapely.get_coordinates(city.inventory.points)
    for number, start in enumerate(range(0, len(beyond), SURVEYED_LOTS)):
        some = beyond[start : start + SURVEYED_LOTS]
        box = shapely.box(*shapely.total_bounds(lots.shapes[some])).buffer(_AROUND_M)
        walls, ways, near = (np.sort(tree.query(box)) for tree in trees)
        found = take_inventory(
            lots.take(some), city.zones[some], buildings.shapes[walls], buildings.driveways[ways],
            Roads(roads.lines[near], roads.kinds[near], roads.widths_m[near]), catalogue,
            rng_for(seed, STAGE, f"unsurveyed {number}"),
        )  # fmt: skip
        part = dressed_inventory(found, catalogue, seed, f"unsurveyed {number}")
        xy = part.table[:, :2]
        beside = taken[shapely.contains_xy(box, taken[:, 0], taken[:, 1])]  # rows along streets shared with others
        free = clear_of(xy, np.asarray(shapely.points(beside)), _APART_M)
        parts.append(part.take(free))
        taken = np.concatenate((taken, xy[free]))
    return parts


def garden_shrubs(lots: Lots, grounds: Grounds, buildings: Buildings, seed: int) -> Plants:
    """Set shrubs before houses and along borders, and hedges on some borders."""
    plants = Plants.joined([_border_shrubs(lots, grounds, seed), _hedges(lots, grounds, seed)])
    xy = plants.table[:, :2]
    return plants.take(clear_of(xy, buildings.shapes, _OFF_WALLS_M) & clear_of(xy, buildings.driveways, _OFF_WAYS_M))


def _border_shrubs(lots: Lots, grounds: Grounds, seed: int) -> Plants:
    table = grounds.table
    each = Draws(seed, "shrubs", len(table))
    mean = np.array([_SHRUBS.get(use, 0.0) for use in range(7)])[table[:, USE].astype(int)]
    roomy = np.clip(shapely.area(lots.shapes) / 420.0, 0.4, 6.0)
    count = each.few("count", mean * roomy * 1.5 * each.uniform("liking") ** 1.3)
    lot = np.repeat(np.arange(len(table)), count)
    draw = Draws(seed, "shrub", len(lot))
    side, share = draw.uniform("side"), draw.uniform("share")
    row = table[lot]
    house = row[:, RIGHT] > row[:, LEFT]
    x, y = share * row[:, WIDTH], row[:, DEPTH] - 0.9
    left = side < 0.2
    x, y = np.where(left, 0.8, x), np.where(left, share * row[:, DEPTH], y)
    right = (side >= 0.2) & (side < 0.4)
    x, y = np.where(right, row[:, WIDTH] - 0.8, x), np.where(right, share * row[:, DEPTH], y)
    bed = (side >= 0.55) & house
    x = np.where(bed, row[:, LEFT] + share * (row[:, RIGHT] - row[:, LEFT]), x)
    y = np.where(bed, np.where(side < 0.85, row[:, FRONT] - 0.9, row[:, BACK] + 0.9), y)
    wide = (row[:, USE] == GREENS) & (side > 0.4)
    x = np.where(wide, share * row[:, WIDTH], x)
    y = np.where(wide, draw.uniform("deep") * row[:, DEPTH], y)
    xy = grounds.places(lot, x + draw.uniform("jx", -0.5, 0.5), y + draw.uniform("jy", -0.5, 0.5))
    inside = shapely.contains_xy(lots.shapes[lot], xy[:, 0], xy[:, 1])
    radius = 0.5 + 1.5 * draw.uniform("radius") ** 2
    height = radius * draw.uniform("height", 0.9, 1.8)
    return dressed(xy, height, radius, 0.05 * height, draw.pick("kind", len(LEAVES)), draw).take(inside)


def _hedges(lots: Lots, grounds: Grounds, seed: int) -> Plants:
    """Set hedges, each a row of shrubs of one kind, along a border of some homes."""
    table = grounds.table
    each = Draws(seed, "hedges", len(table))
    chosen = np.flatnonzero((table[:, USE] == HOME) & (each.uniform("wanted") < 0.24))
    where, kind = each.pick("where", 3), each.pick("kind", len(LEAVES))
    high, thick = each.uniform("high", 1.0, 2.6), each.uniform("thick", 0.45, 0.85)
    run_m = np.where(where == 0, table[:, WIDTH], table[:, DEPTH] * 0.7) - 1.2
    count = np.maximum(run_m[chosen] / _HEDGE_STEP_M, 0).astype(np.int64)
    lot = np.repeat(chosen, count)
    number = np.arange(len(lot)) - np.repeat(np.cumsum(count) - count, count)
    at = 0.6 + number * _HEDGE_STEP_M
    row = table[lot]
    behind = where[lot] == 0
    x = np.where(behind, at, np.where(where[lot] == 1, 0.7, row[:, WIDTH] - 0.7))
    y = np.where(behind, row[:, DEPTH] - 0.8, row[:, DEPTH] * 0.3 + at)
    draw = Draws(seed, "hedge", len(lot))
    radius = thick[lot] * draw.uniform("radius", 0.9, 1.2)
    height = high[lot] * draw.uniform("height", 0.92, 1.08)
    xy = grounds.places(lot, x, y)
    inside = shapely.contains_xy(lots.shapes[lot], xy[:, 0], xy[:, 1])
    return dressed(xy, height, radius, 0.5 * height, kind[lot], draw).take(inside)


def dressed(xy: Floats, height: Floats, radius: Floats, base: Floats, kind: NDArray[np.int64], draw: Draws) -> Plants:
    """Return plants at places, of sizes in metres, in the colours of their kinds."""
    salt = draw.pick("salt", 1 << 30)
    colour = LEAVES[kind % len(LEAVES)] * draw.uniform("shade", 0.82, 1.14)[:, None]
    colour = colour * np.column_stack(
        (draw.uniform("red", 0.88, 1.05), draw.uniform("green", 0.95, 1.06), draw.uniform("blue", 0.92, 1.08),
         draw.uniform("infrared", 0.9, 1.1))
    )  # fmt: skip
    return Plants(np.column_stack((xy, height, radius, base, salt)), colour)
