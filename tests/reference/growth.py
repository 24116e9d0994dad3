"""Growth of a grove as one reads it: plants, internodes and buds as objects, a function a rule. The kernels' judge.

Palubicki et al. 2009 with the species parameters of Stava et al. 2014, as `urbanforest_cli.growth.simulate` has it.
Numbers that the kernels keep in 32 bits are rounded so here, since decisions hang on them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, field
from typing import Any

from tests.reference.growth_space import (
    ALL_BITS,
    Cell,
    Point,
    Room,
    Shade,
    Solids,
    canopy_cell,
    mixed,
    stored,
    stored_point,
    uniform,
)
from urbanforest_cli.core.config import Growth
from urbanforest_cli.growth.grove import Grove, Surroundings, TraitsTable, season_count

APICAL, LATERAL, RESERVE, STEM = "apical", "lateral", "reserve", "stem"
APICAL_NUMBER, RESERVE_NUMBER = 14, 15
NEIGHBOUR_RADIUS_M = 0.6
LEAST_HALF_M = 0.25  # of a pruning volume: a whip is no crown
NURSERY_SEASONS, NURSERY_LIGHT = 3, 0.6  # a young plant lives on what it brought from the nursery
LIMB_SHARE = 0.3  # a branch that bears this share of a plant is its crown


@dataclass(eq=False)
class Plant:
    key: int
    place: Point
    species: int
    traits: Any
    seasons: int
    first_year: float
    pruning_factor: float
    clearance: float
    azimuth: float
    cut_in: int  # season of the cut, 0 for none
    root: Node | None = None
    season: int = 0
    age: float = 0.0
    vitality: float = 0.0
    grown_in: int = 0
    years: float = 0.0  # that this season's growth stands for; 0: it rests
    dark_seasons: int = 0
    outcome: int = 0
    death: int = 0
    shed: int = 0
    pruned: int = 0
    height: float = 0.0
    nodes: list[Node] = field(default_factory=list)  # all, the lost ones too; its own root first

    def chance(self, serial: int, number: int, purpose: int) -> int:
        """Hash this season, a bud and a purpose to 64 bits."""
        key = self.key ^ (self.season * 0xD1342543DE82EF95 & ALL_BITS)
        place = serial * 128 + number * 8 + purpose
        return mixed((key + (place + 1) * 0x9E3779B97F4A7C15) & ALL_BITS)

    def apical_control(self) -> float:
        share = min(self.age / self.traits["apical_control_years"], 1.0)
        young, old = self.traits["apical_control_young"], self.traits["apical_control_old"]
        return young + (old - young) * share

    def along_row(self, node: Node) -> tuple[float, float]:
        x, y = stored(node.place[0] - self.place[0]), stored(node.place[1] - self.place[1])
        cosine, sine = math.cos(self.azimuth), math.sin(self.azimuth)
        return x * cosine + y * sine, y * cosine - x * sine


@dataclass(eq=False)
class Node:
    """The upper end of an internode."""

    plant: Plant
    parent: Node | None
    serial: int
    place: Point
    voxel: Cell
    order: int
    leads: bool  # goes on with its parent's axis
    birth: int
    death: int = 0
    light: float = 0.0  # of all buds at or above
    able: float = 0.0  # of those that have room
    weighted: float = 0.0
    vigour: float = 0.0
    inhibition: float = 0.0
    above: int = 0


@dataclass(eq=False)
class Bud:
    node: Node
    direction: Point
    roll: float
    kind: str
    number: int
    light: float = 0.0
    vigour: float = 0.0
    dead: bool = False
    cramped: bool = False  # no room until a cut makes some


@dataclass
class Box:
    """Where the twig ends of a plant reach, from its root: along its row, across it, up."""

    low: list[float] = field(default_factory=lambda: [0.0, 0.0, math.inf])
    high: list[float] = field(default_factory=lambda: [0.0, 0.0, 0.0])

    def take_in(self, place: tuple[float, ...]) -> None:
        self.low = [min(a, b) for a, b in zip(self.low, place, strict=True)]
        self.high = [max(a, b) for a, b in zip(self.high, place, strict=True)]


def bell(bits: int) -> float:
    """Return a deviate of variance 1: the sum of three uniform ones."""
    low = 0x1FFFFF
    return ((bits & low) + (bits >> 21 & low) + (bits >> 42 & low)) * (2.0 / 2097152.0) - 3.0


def turn_of(bits: int) -> float:
    return 2 * math.pi * (bits >> 40) / 16777216


def square_to(d: Point) -> tuple[Point, Point]:
    """Return two directions square to one and to each other."""
    sign = 1.0 if d[2] >= 0 else -1.0
    a = -1.0 / (sign + d[2])
    b = d[0] * d[1] * a
    return (1.0 + sign * d[0] * d[0] * a, sign * b, -sign * d[0]), (b, sign + d[1] * d[1] * a, -d[1])


def tilted(d: Point, along: float, u: float, v: float) -> Point:
    s, t = square_to(d)
    return tuple(along * d[k] + u * s[k] + v * t[k] for k in range(3))  # type: ignore[return-value]


def shoot_length(plant: Plant, order: int, vigour: float) -> float:
    traits = plant.traits
    control = 1.0 + (traits["shoot_control"] - 1.0) * traits["shoot_control_aging"] ** plant.vitality
    longest = traits["shoot_internodes_max"] / control**order
    return float(min(vigour, longest) * traits["shoot_aging"] ** plant.vitality * plant.years)


class SlowGrove:
    """A grove that grows."""

    def __init__(self, grove: Grove, around: Surroundings, traits: TraitsTable, config: Growth) -> None:
        self.around, self.config = around, config
        self.senses_shade = config.environment in ("both", "shadow")
        self.senses_room = config.environment in ("both", "markers")
        self.solids = Solids(around)
        self.shade = Shade(around, traits, config)
        self.room = Room(around, self.solids, config)
        self.given = [self._plant(grove, row, traits) for row in range(len(grove))]
        self.plants = sorted(self.given, key=lambda plant: plant.key)
        self.living: list[Node] = []  # parents first
        self.buds: list[Bud] = []
        self.neighbours: list[tuple[Point, int]] = []  # leafy points of other groves, with internodes

    def _plant(self, grove: Grove, row: int, traits: TraitsTable) -> Plant:
        age = float(grove.age_years[row])
        seasons = int(season_count(grove.age_years[row : row + 1])[0])
        x, y = grove.xy_m[row] - self.around.origin_m
        cut = max(seasons - self.config.regrow_years, (seasons + 1) // 2)
        species = int(grove.species[row])
        return Plant(
            key=int(grove.keys[row]), place=stored_point((x, y, 0.0)), species=species, traits=traits[species],
            seasons=seasons, first_year=min(max(age - (seasons - 1), 0.25), 1.0),
            pruning_factor=float(grove.pruning_factor[row]), clearance=float(grove.clearance_m[row]),
            azimuth=float(grove.row_azimuth_rad[row]), cut_in=cut if grove.pruning_factor[row] < 1 else 0,
        )  # fmt: skip

    def grow(self) -> list[Plant]:
        """Grow to the last season; return the plants in the order the grove has them."""
        last = max(plant.seasons for plant in self.plants)
        for season in range(1, last + 1):
            self.let_neighbours_in(season)
            self.plant_seeds(season, last)
            if not self.begin(season, last):
                continue
            self.sense()
            self.gather()
            self.shed()
            if self.config.fate == "priority":
                self.share_by_priority()
            else:
                self.share_borchert_honda()
            self.set_shoots(self.choose())
            self.buds = [bud for bud in self.buds if not bud.dead]
            self.cut()
        for plant in self.plants:
            if plant.outcome == 0 and not any(node.plant is plant for node in self.living if node.parent is not None):
                plant.outcome, plant.death = (1, plant.season) if len(plant.nodes) > 1 else (2, 0)
        return self.given

    # what comes from outside

    def let_neighbours_in(self, season: int) -> None:
        for point, when, internodes in zip(
            self.around.neighbour_xyz_m.tolist(), self.around.neighbour_season, self.around.neighbour_internodes,
            strict=True,
        ):  # fmt: skip
            inside = all(0 <= value < size for value, size in zip(point, self.around.size_m, strict=True))
            if when == season and inside:
                self.neighbours.append((tuple(point), int(internodes + 0.5)))
                self.shade.cast(self.shade.voxel(tuple(point)), -1, int(internodes + 0.5))
                self.room.take(tuple(point), NEIGHBOUR_RADIUS_M)

    def plant_seeds(self, season: int, last: int) -> None:
        for plant in self.plants:
            if last - plant.seasons + 1 != season:
                continue
            root = plant.root = Node(plant, None, 0, plant.place, self.shade.voxel(plant.place), 0, False, 0)
            plant.nodes.append(root)
            self.living.append(root)
            if self.solids.holds(plant.place):
                plant.outcome = 2
                continue
            self.room.take(plant.place, self.taking_radius(plant))
            turn = turn_of(plant.chance(0, 0, 5))
            stems = int(plant.traits["stem_count"])
            for stem in range(stems):
                lean = plant.traits["stem_angle_deg"] * (1 + 0.25 * bell(plant.chance(0, stem, 6)))
                lean = math.radians(min(max(lean, 0.0), 80.0))
                away = turn + 2 * math.pi * (stem + 0.3 * bell(plant.chance(0, stem, 7)) / 3) / stems
                flat = math.sin(lean)
                direction = stored_point((flat * math.cos(away), flat * math.sin(away), math.cos(lean)))
                first = stem == 0
                number = APICAL_NUMBER if first else stem
                self.buds.append(Bud(root, direction, stored(away), APICAL if first else STEM, number))

    def begin(self, season: int, last: int) -> bool:
        """Let the season begin: young plants grow each, older ones each second or fourth, counted from the last."""
        for plant in self.plants:
            plant.years = 0.0
            own = season - (last - plant.seasons)
            if own < 1 or plant.outcome != 0:
                continue
            plant.season = own
            plant.age = plant.first_year + own - 1
            young = own <= 25 or 0 < plant.cut_in <= own
            gap = 1 if young else 2 if own <= 50 else 4
            if own != plant.cut_in and (plant.seasons - own) % gap:
                continue
            plant.years = plant.first_year if own == 1 else float(own - plant.grown_in)
            plant.grown_in = own
            cut = 0 < plant.cut_in < own
            plant.vitality = min(plant.age, 12.0 + own - plant.cut_in) if cut else plant.age
        return any(plant.years for plant in self.plants)

    # light

    def sense(self) -> None:
        canopy = self.shade.canopy([(node.place, node.plant.species) for node in self.living], self.neighbours)
        for bud in self.buds:
            plant = bud.node.plant
            if plant.years == 0:
                continue
            light = self.shade.light(bud.node.voxel, plant.species) if self.senses_shade else 1.0
            if self.senses_shade:
                light *= self.solids.sky_seen(bud.node.place) * canopy.get(canopy_cell(bud.node.place), 1.0)
                light = max(light, NURSERY_LIGHT) if plant.season <= NURSERY_SEASONS else light
            bud.light = stored(light)
        if not self.senses_shade:  # then light is whether a bud has room
            for bud, (way, _) in zip(self.buds, self.views(self.buds), strict=True):
                bud.light = 1.0 if any(way) else 0.0

    def gather(self) -> None:
        """Sum light, internodes and inhibition from the twigs to the root."""
        for node in self.living:
            node.light = node.able = node.weighted = node.inhibition = 0.0
            node.above = 1
        for bud in self.buds:
            node = bud.node
            node.light = stored(node.light + bud.light)
            if not bud.cramped:
                share = node.plant.apical_control()
                node.able = stored(node.able + bud.light)
                node.weighted = stored(node.weighted + bud.light * (share if bud.kind == APICAL else 1 - share))
        for node in reversed(self.living):
            parent, plant = node.parent, node.plant
            if parent is None or plant.years == 0:
                continue
            share = plant.apical_control()
            parent.light = stored(parent.light + node.light)
            parent.able = stored(parent.able + node.able)
            parent.weighted = stored(parent.weighted + node.able * (share if node.leads else 1 - share))
            parent.above += node.above
            sent = plant.traits["auxin_inhibition"] * plant.traits["auxin_aging"] ** plant.age if node.above == 1 else 0
            fade = plant.traits["auxin_distance_factor"]
            parent.inhibition = stored(parent.inhibition + (node.inhibition + sent) * fade)

    # resource

    def root_vigour(self, plant: Plant, root: Node) -> float:
        return stored(min(plant.traits["vigour"] * root.able, plant.traits["vigour_max"]))

    def share_borchert_honda(self) -> None:
        """Share vigour at each fork by light, the axis that goes on weighing lambda, branches 1 - lambda."""
        for node in self.living:
            parent, plant = node.parent, node.plant
            if plant.years == 0:
                continue
            if parent is None:
                node.vigour = self.root_vigour(plant, node)
            elif parent.weighted > 0:
                share = plant.apical_control() if node.leads else 1 - plant.apical_control()
                node.vigour = stored(stored(parent.vigour * node.able) * share / parent.weighted)
            else:
                node.vigour = 0.0
        for bud in self.buds:
            node, plant = bud.node, bud.node.plant
            bud.vigour = 0.0
            if plant.years and not bud.cramped and node.weighted > 0:
                share = plant.apical_control() if bud.kind == APICAL else 1 - plant.apical_control()
                bud.vigour = stored(stored(node.vigour * bud.light) * share / node.weighted)

    def share_by_priority(self) -> None:
        """Share the vigour of each axis among its end bud, first, and its branches and buds by their mean light."""
        axis: dict[Node, Node] = {}
        buds_above = dict.fromkeys(self.living, 0)
        items: dict[Node, list[Node | Bud]] = {}
        for bud in self.buds:
            bud.vigour = 0.0
            buds_above[bud.node] += not bud.cramped
        for node in reversed(self.living):
            if node.parent:
                buds_above[node.parent] += buds_above[node]
        for node in self.living:
            axis[node] = axis[node.parent] if node.parent and node.leads else node
            if node.parent and not node.leads:
                items.setdefault(axis[node.parent], []).append(node)
        for bud in self.buds:
            if not bud.cramped:
                items.setdefault(axis[bud.node], []).append(bud)
        for start in self.living:
            if axis[start] is not start or start.plant.years == 0:
                continue
            if start.parent is None:
                start.vigour = self.root_vigour(start.plant, start)

            def mean_light(item: Node | Bud) -> float:
                return item.light if isinstance(item, Bud) else item.able / max(buds_above[item], 1)

            mine = items.get(start, [])
            ranked = sorted(mine, key=lambda item: (getattr(item, "kind", "") != APICAL, -mean_light(item)))
            falls_to = max(0.5 * len(mine), 1.0)
            light = {item: item.light if isinstance(item, Bud) else item.able for item in mine}
            weight = {
                item: light[item] * max(1.0 - (1.0 - 0.006) * rank / falls_to, 0.006)
                for rank, item in enumerate(ranked)
            }
            whole = sum(weight[item] for item in ranked)
            for item in mine:
                item.vigour = stored(start.vigour * weight[item] / whole) if whole > 0 else 0.0

    # shoots

    def choose(self) -> list[Bud]:
        """Return the buds that grow; some die."""
        chosen = []
        for bud in self.buds:
            node, plant, traits = bud.node, bud.node.plant, bud.node.plant.traits
            if bud.cramped or plant.years == 0:
                continue
            draw = uniform(plant.chance(node.serial, bud.number, 0))
            death = traits["apical_bud_death"] if bud.kind == APICAL else traits["lateral_bud_death"]
            if bud.kind != APICAL and bud.light <= 0:
                death = max(death, 0.5)
            if draw < death:
                bud.dead = node.parent is not None
            elif bud.vigour >= 1:
                flushes = bud.light ** traits["lateral_light_exponent"] * stored(math.exp(-node.inhibition))
                if bud.kind != LATERAL or (draw - death) / (1 - death) < flushes:
                    chosen.append(bud)
        return chosen

    def views(self, buds: list[Bud]) -> list[tuple[Point, int]]:
        reach, least = self.config.marker_range_internodes, 2.0 * self.room.edge
        return self.room.perceive(
            [
                (bud.node.place, bud.direction, max(reach * bud.node.plant.traits["internode_length_m"], least))
                for bud in buds
            ]
        )

    def taking_radius(self, plant: Plant) -> float:
        radius = self.config.marker_radius_internodes * plant.traits["internode_length_m"]
        return max(float(radius), 0.7 * self.room.edge)

    def has_place(self, lower: Point, upper: Point) -> bool:
        size = self.around.size_m
        middle = tuple(0.5 * (a + b) for a, b in zip(lower, upper, strict=True))
        within = all(0.3 <= upper[k] <= size[k] - 0.3 for k in (0, 1)) and 0.02 <= upper[2] <= size[2] - 0.3
        return within and not self.solids.holds(upper) and not self.solids.holds(middle)  # type: ignore[arg-type]

    def set_shoots(self, chosen: list[Bud]) -> None:
        views = self.views(chosen) if self.senses_room else [((0.0, 0.0, 0.0), 1)] * len(chosen)
        for bud, (way, markers) in zip(chosen, views, strict=True):
            plant = bud.node.plant
            order = bud.node.order + (bud.kind in (LATERAL, RESERVE))
            length = shoot_length(plant, order, bud.vigour)
            if markers == 0:
                bud.cramped = True
            elif (any(way) or not self.senses_room) and length >= 0.1:
                self.set_shoot(bud, way, order, length)

    def set_shoot(self, bud: Bud, way: Point, order: int, length: float) -> None:
        """Let a bud grow into a shoot and sit at its end."""
        plant, traits, start = bud.node.plant, bud.node.plant.traits, bud.node
        count = max(int(length + 0.5), 1)
        step = length / count * traits["internode_length_m"]
        spread = math.radians(traits["apical_angle_sd_deg"])
        first = spread * bell(plant.chance(start.serial, bud.number, 1))
        second = spread * bell(plant.chance(start.serial, bud.number, 2))
        direction = tilted(bud.direction, 1.0, first, second)
        pull = [0.0, 0.0, 0.0]
        if self.senses_shade and traits["phototropism"] > 0:
            bright = self.shade.brightest(start.voxel, start.place, direction, self.solids)
            pull = [traits["phototropism"] * part for part in bright]
        if self.senses_room:
            pull = [p + traits["room_attraction"] * part for p, part in zip(pull, way, strict=True)]
        pull[2] += traits["gravitropism_trunk"] if order == 0 else traits["gravitropism_branch"]
        roll, place, tip = bud.roll, start.place, start
        for number in range(count):
            turned = [d + p / count for d, p in zip(direction, pull, strict=True)]
            size = math.sqrt(turned[0] * turned[0] + turned[1] * turned[1] + turned[2] * turned[2])
            direction = (turned[0] / size, turned[1] / size, turned[2] / size)
            upper = tuple(a + step * d for a, d in zip(place, direction, strict=True))
            if not self.has_place(place, upper):  # type: ignore[arg-type]
                break
            place = upper  # type: ignore[assignment]
            tip = self.set_internode(tip, place, order, number > 0 or bud.kind == APICAL)
            self.set_lateral_buds(tip, direction, roll)
            roll += math.radians(traits["roll_angle_deg"])
            roll += math.radians(traits["roll_angle_sd_deg"]) * bell(plant.chance(tip.serial, 0, 5))
        if tip is start:
            bud.dead, bud.cramped = start.parent is not None, start.parent is None
            return
        bud.node, bud.direction, bud.roll = tip, stored_point(direction), stored(roll)
        bud.kind, bud.number = APICAL, APICAL_NUMBER

    def set_internode(self, parent: Node, place: Point, order: int, leads: bool) -> Node:
        plant, voxel = parent.plant, self.shade.voxel(stored_point(place))
        node = Node(plant, parent, len(plant.nodes), stored_point(place), voxel, order, leads, plant.season)
        plant.nodes.append(node)
        self.living.append(node)
        plant.height = stored(max(plant.height, place[2]))
        if self.senses_shade:
            self.shade.cast(voxel, plant.species, 1)
        if self.senses_room:
            self.room.take(place, self.taking_radius(plant))
        return node

    def set_lateral_buds(self, node: Node, direction: Point, roll: float) -> None:
        plant, traits = node.plant, node.plant.traits
        whorl = int(traits["lateral_buds"])
        for number in range(whorl):
            angle = traits["branch_angle_deg"]
            angle += traits["branch_angle_sd_deg"] * bell(plant.chance(node.serial, number, 3))
            turn = roll + 2 * math.pi * number / whorl
            out, along = math.sin(math.radians(angle)), math.cos(math.radians(angle))
            way = tilted(direction, along, out * math.cos(turn), out * math.sin(turn))
            own_roll = stored(turn_of(plant.chance(node.serial, number, 4)))
            self.buds.append(Bud(node, stored_point(way), own_roll, LATERAL, number))

    # loss

    def shed(self) -> None:
        """Drop dark branches and those that start too low; let plants die that were dark for three seasons."""
        falls: dict[Node, str] = {}
        for plant in self.plants:
            root = plant.root
            if root is None or plant.outcome != 0 or plant.years == 0:
                continue
            plant.dark_seasons = plant.dark_seasons + 1 if root.light <= 0 else 0
            if plant.dark_seasons >= 3:
                plant.outcome, plant.death = 1, plant.season
                falls[root] = "shed"
        trunk_top = dict.fromkeys(self.plants, 0.0)  # of what lives of it
        for node in self.living:
            if node.order == 0:
                trunk_top[node.plant] = max(trunk_top[node.plant], node.place[2])
        for node in self.living:
            plant, traits, parent = node.plant, node.plant.traits, node.parent
            if parent is None:
                continue
            height = min(plant.height, trunk_top[plant])
            if parent in falls:
                falls[node] = falls[parent]
            elif node.leads or plant.years == 0 or plant.season - node.birth < 2:
                continue
            elif node.light < traits["shed_light"] * node.above:
                falls[node] = "shed"
            elif node.order == 0 or node.above >= LIMB_SHARE * plant.root.above:
                continue
            elif parent.place[2] < min(traits["clear_stem_m"], 0.3 * height):
                falls[node] = "shed"
            elif parent.place[2] < min(plant.clearance, 0.45 * height):
                falls[node] = "pruned"
        self.let_fall(falls)

    def cut(self) -> None:
        """Cut plants to the volume of their own crown, scaled; then markers are free again and reserve buds wake."""
        due = [p for p in self.plants if p.cut_in == p.season and p.season > 0 and p.outcome == 0]
        if not due:
            return
        boxes = {plant: Box() for plant in due}
        for node in self.living:
            if node.plant in boxes and node.parent and node.above <= 1:
                boxes[node.plant].take_in((*node.plant.along_row(node), node.place[2]))
        falls: dict[Node, str] = {}
        for node in self.living:
            if node.plant not in boxes or node.parent is None:
                continue
            if node.parent in falls or self.outside(node, boxes[node.plant]):
                falls[node] = "pruned"
        self.let_fall(falls)
        if self.senses_room:
            self.release_markers()
        self.wake_reserves(due)

    def outside(self, node: Node, box: Box) -> bool:
        plant, z = node.plant, node.place[2]
        if node.order == 0 and z <= box.low[2]:
            return False
        factor, place = plant.pruning_factor, plant.along_row(node)
        top = box.low[2] + factor * (box.high[2] - box.low[2])
        half = [max(factor * (box.high[k] if place[k] > 0 else -box.low[k]), LEAST_HALF_M) for k in (0, 1)]
        along, across = place[0] / half[0], place[1] / half[1]
        if abs(along) > 1 or abs(across) > 1 or z > top or self.config.pruning_shape == "box":
            return abs(along) > 1 or abs(across) > 1 or z > top
        middle = 0.5 * (box.low[2] + top)
        above = (z - middle) / max(top - middle, LEAST_HALF_M)
        return above > 0 and along * along + across * across + above * above > 1

    def let_fall(self, falls: dict[Node, str]) -> None:
        for node, why in falls.items():
            plant = node.plant
            node.death = plant.season
            if node.parent is None:
                continue
            plant.shed += why == "shed"
            plant.pruned += why == "pruned"
            if self.senses_shade:
                self.shade.cast(node.voxel, plant.species, -1)
        self.living = [node for node in self.living if node not in falls]
        self.buds = [bud for bud in self.buds if bud.node not in falls]

    def release_markers(self) -> None:
        """Free the markers near what was lost this season, but those that something living holds."""
        for plant in self.plants:
            for node in plant.nodes:
                if node.death != 0 and node.death == plant.season:
                    self.room.release(node.place, self.taking_radius(plant))
        for node in self.living:
            self.room.take(node.place, self.taking_radius(node.plant))
        for point, _ in self.neighbours:
            self.room.take(point, NEIGHBOUR_RADIUS_M)

    def wake_reserves(self, cut: list[Plant]) -> None:
        """Give each internode of plants just cut a bud where it has none; cramped buds grow again."""
        with_bud = {bud.node for bud in self.buds}
        for bud in self.buds:
            bud.cramped = bud.cramped and bud.node.plant not in cut
        for node in self.living:
            parent, plant = node.parent, node.plant
            if plant not in cut or node in with_bud or parent is None:
                continue
            way = stored_point(tuple(a - b for a, b in zip(node.place, parent.place, strict=True)))  # type: ignore[arg-type]
            length = max(math.hypot(*way), 1e-6)
            turn = 2 * math.pi * uniform(plant.chance(node.serial, RESERVE_NUMBER, 6))
            axis = (way[0] / length, way[1] / length, way[2] / length)
            direction = tilted(axis, 0.643, 0.766 * math.cos(turn), 0.766 * math.sin(turn))
            self.buds.append(Bud(node, stored_point(direction), stored(turn), RESERVE, RESERVE_NUMBER))
