"""A whole city in memory: plan, blocks, lots, houses, streets and what stands in them."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.synth.blocks import make_blocks
from urbanforest_cli.synth.buildings import Buildings, make_buildings
from urbanforest_cli.synth.furniture import Obstacles, place_obstacles
from urbanforest_cli.synth.inventory import Inventory, take_inventory
from urbanforest_cli.synth.lots import Lots, dig_ponds, make_lots, nearest_lots
from urbanforest_cli.synth.plan import Plan, make_plan
from urbanforest_cli.synth.sketches import Sketches, draw_sketches
from urbanforest_cli.synth.streets import Roads, finish_streets
from urbanforest_cli.synth.zoning import zone_lots

STAGE = "synth"

_GROUND_A_LOT_M2 = 1150.0
_MARGIN_M = 70.0
_BLOCKS_FULL_LENGTH_FROM = 150


@dataclass(frozen=True)
class SynthCity:
    """All of a city in metres from its centre, and the plan it was cut from."""

    lots: Lots
    zones: NDArray[np.object_]
    buildings: Buildings
    roads: Roads
    obstacles: Obstacles
    sketches: Sketches
    inventory: Inventory
    plan: Plan


def build_city(
    lot_count: int, seed: int, catalogue: Catalogue, *, squares: bool = False, progress: Progress = silent
) -> SynthCity:
    """Build a city of exactly `lot_count` lots around the origin.

    A plan somewhat too large is laid out and the blocks nearest the centre are kept; should it be too small after
    all, a larger one is.
    """
    steps = 5
    block_scale = float(np.clip(lot_count / _BLOCKS_FULL_LENGTH_FROM, 0.45, 1.0))
    radius_m = math.sqrt(lot_count * _GROUND_A_LOT_M2 / math.pi)
    while True:
        progress("building the city", 0, steps)
        plan = make_plan(lot_count, radius_m, rng_for(seed, STAGE, "plan"))
        blocks, side_streets = make_blocks(plan, block_scale, rng_for(seed, STAGE, "blocks"))
        lots = make_lots(blocks, plan, rng_for(seed, STAGE, "lots"))
        if len(lots) >= lot_count:
            break
        radius_m = radius_m * math.sqrt(1.2 * lot_count / max(len(lots), 1)) + _MARGIN_M
    lots, blocks = nearest_lots(lots, blocks, lot_count)
    progress("building the city", 1, steps)
    zones = zone_lots(lots, plan.main_roads, rng_for(seed, STAGE, "zones"), squares=squares)
    lots, ponds = dig_ponds(lots, rng_for(seed, STAGE, "ponds"))
    progress("building the city", 2, steps)
    buildings = make_buildings(lots, zones, radius_m, rng_for(seed, STAGE, "buildings"))
    progress("building the city", 3, steps)
    roads = finish_streets(plan, side_streets, blocks)
    obstacles = place_obstacles(plan, roads, blocks, lots, ponds, buildings, rng_for(seed, STAGE, "obstacles"))
    progress("building the city", 4, steps)
    sketches = draw_sketches(lots, zones)
    inventory = take_inventory(
        lots, zones, buildings.shapes, buildings.driveways, roads, catalogue, rng_for(seed, STAGE, "inventory")
    )
    progress("building the city", steps, steps)
    return SynthCity(lots, zones, buildings, roads, obstacles, sketches, inventory, plan)
