"""Everything that an aerial picture of a city shows, in metres from its centre, and what of it lies in a window."""

from __future__ import annotations

import math
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import shapely

from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.synth.city import SynthCity
from urbanforest_cli.synth.furniture import tracks
from urbanforest_cli.synth.picture.boxes import Boxes
from urbanforest_cli.synth.picture.cars import set_cars
from urbanforest_cli.synth.picture.draws import Draws
from urbanforest_cli.synth.picture.grounds import Grounds, lay_grounds
from urbanforest_cli.synth.picture.lines import Box, Lines, Nearby, Outlines
from urbanforest_cli.synth.picture.plants import Plants, dressed_inventory, garden_shrubs, unsurveyed_plants
from urbanforest_cli.synth.picture.props import set_props
from urbanforest_cli.synth.picture.roofs import Roofs, lay_roofs
from urbanforest_cli.synth.picture.wilds import wild_plants
from urbanforest_cli.synth.plan import Floats
from urbanforest_cli.synth.streets import Roads

CROWN_REACH = 1.75
"""How far a lump of leaves may lie from the middle of a crown, in radii of the crown."""

MARGIN_M = 20.0
"""Land beyond lots and roads that the picture shows."""

_RAIL_HALF_M = 2.6
_SUN_AZIMUTH_DEG, _SUN_HEIGHT_DEG = (120.0, 235.0), (50.0, 62.0)


@dataclass(frozen=True)
class Scene:
    """What an aerial picture shows."""

    grounds: Grounds
    roofs: Roofs
    plants: Plants
    props: Boxes
    lots: Outlines
    buildings: Outlines
    driveways: Outlines
    water: Outlines
    roads: Lines
    road_looks: Floats  # (roads, 4)
    rails: Lines
    sun: Floats  # (3,) toward the sun
    bounds: Box

    @cached_property
    def plants_nearby(self) -> Nearby:
        """Crowns by their places."""
        return Nearby.of(self.plants.table[:, :2], self.plants.table[:, 3] * CROWN_REACH)

    @cached_property
    def props_nearby(self) -> Nearby:
        """Boxes by their places."""
        return Nearby.of(self.props.table[:, :2], self.props.table[:, 4:6].sum(axis=1))

    @cached_property
    def highest_m(self) -> float:
        """A height that nothing exceeds."""
        return max(self.roofs.top_m(), float(self.plants.table[:, 2].max(initial=0.0)) + 1.0)

    @cached_property
    def shadow_reach_m(self) -> tuple[float, float]:
        """How far toward the sun, east and north, something may stand that casts its shadow here."""
        return self.highest_m * self.sun[0] / self.sun[2], self.highest_m * self.sun[1] / self.sun[2]


def set_scene(city: SynthCity, catalogue: Catalogue, seed: int) -> Scene:
    """Choose looks for all of a city; lots, houses and roads have theirs by their number and the seed."""
    lots, buildings, roads = city.lots, city.buildings, city.roads
    grounds = lay_grounds(lots, city.zones, buildings, seed)
    roofs = lay_roofs(buildings, grounds, seed)
    water = city.obstacles.shapes[city.obstacles.kinds == "water"]
    rails = np.empty(0, dtype=object)
    if city.plan.river is not None:
        water = np.append(water, shapely.get_parts(city.plan.river))
    if city.plan.railway is not None:
        rails = shapely.get_parts(np.array(tracks(city.plan.railway), dtype=object))
    everything = shapely.bounds(np.concatenate((lots.shapes, roads.lines)))
    west, south = everything[:, :2].min(axis=0) - MARGIN_M
    east, north = everything[:, 2:].max(axis=0) + MARGIN_M
    bounds = (float(west), float(south), float(east), float(north))
    streets = Lines.of(roads.lines, roads.widths_m / 2)
    plants = [
        dressed_inventory(city.inventory, catalogue, seed, "surveyed"),
        *unsurveyed_plants(city, catalogue, seed),
        garden_shrubs(lots, grounds, buildings, seed),
        wild_plants(bounds, lots, streets, water, rails, seed),
    ]
    boxes = [set_props(lots, grounds, buildings, roofs, seed), set_cars(lots, grounds, buildings, roads, streets, seed)]
    return Scene(
        grounds,
        roofs,
        Plants.joined(plants),
        Boxes.joined(boxes),
        Outlines.of(lots.shapes),
        Outlines.of(buildings.shapes),
        Outlines.of(buildings.driveways),
        Outlines.of(water),
        streets,
        _road_looks(roads, seed),
        Lines.of(rails, np.full(len(rails), _RAIL_HALF_M)),
        _sun(seed),
        bounds,
    )


def _sun(seed: int) -> Floats:
    """Draw the way to the sun of a summer's late morning or early afternoon."""
    draw = Draws(seed, "sun", 1)
    azimuth = math.radians(float(draw.uniform("azimuth", *_SUN_AZIMUTH_DEG)[0]))
    height = math.radians(float(draw.uniform("height", *_SUN_HEIGHT_DEG)[0]))
    return np.array([math.cos(height) * math.sin(azimuth), math.cos(height) * math.cos(azimuth), math.sin(height)])


def _road_looks(roads: Roads, seed: int) -> Floats:
    draw = Draws(seed, "road", len(roads.lines))
    green = np.where(draw.uniform("planted") < 0.66, draw.uniform("green", 0.1, 0.75), -1.0)
    fresh = (draw.uniform("fresh") < 0.2) & np.isin(roads.kinds, ("street", "lane", "quay"))
    usual = np.where(np.isin(roads.kinds, ("street", "lane", "quay")), 1.08, 1.2)
    tone = np.where(fresh, draw.uniform("dark", 0.66, 0.8), usual * draw.uniform("tone", 0.97, 1.03))
    return np.column_stack((roads.widths_m / 2, tone, green, draw.pick("salt", 1 << 20)))
