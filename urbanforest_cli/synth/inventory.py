"""A tree inventory of the town, made by rules of its own and not by this program's placement.

Trees along roads stand at about equal distances with gaps; gardens have single trees that avoid each other and the
house; greens have groups with stragglers. It is something to judge a placement against, not a truth.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.synth.furniture import points_along
from urbanforest_cli.synth.lots import Lots
from urbanforest_cli.synth.plan import Floats, Geometries
from urbanforest_cli.synth.streets import Roads

SURVEYED_LOTS = 2000
"""Lots nearest the centre whose trees are known; the inventory of a larger city covers its middle."""

_VERGE_M = 1.9
_CLEAR_OF_WALLS_M, _CLEAR_OF_WAYS_M, _CLEAR_OF_CROSSING_M = 3.0, 1.5, 9.0
_APART_M = 3.2
_GROUND_A_TREE_M2 = {"residential": 75.0, "commercial": 190.0, "industrial": 380.0, "street": 90.0, "other": 95.0}
_TRIES = 3
_STREET_SPACING_M = {"boulevard": 8.5, "avenue": 10.0, "collector": 12.0, "quay": 11.0, "street": 14.0, "lane": 22.0}
_STREET_TREES = ("platanus_acerifolia", "acer_platanoides", "tilia_cordata", "gleditsia_triacanthos")


@dataclass(frozen=True)
class Inventory:
    """Plants as a surveyor writes them down."""

    points: Geometries
    species: NDArray[np.object_]
    heights_m: Floats
    crown_diameters_m: Floats


def take_inventory(
    lots: Lots,
    zones: NDArray[np.object_],
    buildings: Geometries,
    driveways: Geometries,
    roads: Roads,
    catalogue: Catalogue,
    rng: np.random.Generator,
) -> Inventory:
    """Plant the surveyed part of the city and write down what stands there."""
    surveyed = surveyed_lots(lots)
    walls, ways = shapely.STRtree(buildings), shapely.STRtree(driveways)
    garden_xy = _garden_trees(lots.shapes[surveyed], zones[surveyed], rng)
    garden_xy = garden_xy[_clear(garden_xy, walls, _CLEAR_OF_WALLS_M) & _clear(garden_xy, ways, _CLEAR_OF_WAYS_M)]
    garden_xy = garden_xy[apart(garden_xy, _APART_M)]
    street_xy, street_species = _street_trees(roads, shapely.STRtree(lots.shapes[surveyed]), ways, rng)
    ids = np.array(catalogue.ids, dtype=object)
    garden_species = ids[_garden_species(len(garden_xy), len(ids), rng)]
    species = np.concatenate((street_species, garden_species))
    mature = {kind.id: kind for kind in catalogue}
    height = np.array([mature[name].mature_height_m for name in species], dtype=np.float64)
    crown = np.array([mature[name].mature_crown_diameter_m for name in species], dtype=np.float64)
    grown = 1.0 - np.exp(-rng.gamma(3.0, 10.0, len(species)) / 28.0)
    return Inventory(
        np.asarray(shapely.points(np.concatenate((street_xy, garden_xy)))),
        species,
        np.asarray(np.round(np.maximum(height * grown * rng.lognormal(0, 0.1, len(species)), 1.0), 1)),
        np.asarray(np.round(np.maximum(crown * grown**1.1 * rng.lognormal(0, 0.14, len(species)), 0.6), 1)),
    )


def surveyed_lots(lots: Lots) -> NDArray[np.int64]:
    """Return the numbers of the lots nearest the centre, ascending."""
    middles = shapely.get_coordinates(shapely.point_on_surface(lots.shapes))
    return np.sort(np.argsort(np.hypot(*middles.T), kind="stable")[:SURVEYED_LOTS])


def _clear(xy: Floats, tree: shapely.STRtree, distance_m: float) -> NDArray[np.bool_]:
    clear = np.ones(len(xy), dtype=bool)
    clear[tree.query(shapely.points(xy), predicate="dwithin", distance=distance_m)[0]] = False
    return clear


def apart(xy: Floats, distance_m: float) -> NDArray[np.bool_]:
    """Keep a point if no kept one before it is nearer than the distance."""
    points = np.asarray(shapely.points(xy))
    first, second = shapely.STRtree(points).query(points, predicate="dwithin", distance=distance_m)
    earlier = second < first
    kept = np.ones(len(xy), dtype=bool)
    for late, early in sorted(zip(first[earlier].tolist(), second[earlier].tolist(), strict=True)):
        if kept[early]:
            kept[late] = False
    return kept


def _garden_trees(shapes: Geometries, zones: NDArray[np.object_], rng: np.random.Generator) -> Floats:
    """Draw places for trees in lots: scattered, but in groups where nobody gardens."""
    ground = np.array([_GROUND_A_TREE_M2[str(zone)] for zone in zones])
    liking = rng.gamma(1.6, 1 / 1.6, len(shapes))  # some owners like trees, some do not
    count = rng.poisson(shapely.area(shapes) / ground * liking)
    lot = np.repeat(np.arange(len(shapes)), count * _TRIES)
    bounds = shapely.bounds(shapes)[lot]
    xy = bounds[:, :2] + rng.random((len(lot), 2)) * (bounds[:, 2:] - bounds[:, :2])
    grouped = np.isin(zones[lot], ("other", "industrial")) & (rng.random(len(lot)) < 0.7)
    centre = (np.arange(len(lot)) // (5 * _TRIES)) * (5 * _TRIES)
    centre = np.where(lot[centre] == lot, centre, np.arange(len(lot)))
    xy = np.where(grouped[:, None], xy[centre] + rng.normal(0, 6.0, xy.shape), xy)
    inside = np.flatnonzero(shapely.contains_xy(shapely.buffer(shapes, -0.8)[lot], xy[:, 0], xy[:, 1]))
    rank = np.arange(len(inside)) - np.searchsorted(lot[inside], lot[inside])
    return np.asarray(xy[inside[rank < count[lot[inside]]]])


def _street_trees(
    roads: Roads, surveyed: shapely.STRtree, ways: shapely.STRtree, rng: np.random.Generator
) -> tuple[Floats, NDArray[np.object_]]:
    """Line the roads, one species a road, with gaps at crossings, driveways and where a tree has died."""
    near = np.zeros(len(roads.lines), dtype=bool)
    near[surveyed.query(roads.lines, predicate="dwithin", distance=20.0)[0]] = True
    lined = np.isin(roads.kinds, list(_STREET_SPACING_M)) & (rng.random(len(near)) < 0.75)
    index = np.flatnonzero(near & lined)
    places, names = [np.empty((0, 2))], [np.empty(0, dtype=object)]
    network = shapely.STRtree(roads.lines)
    for road in index:
        single = Roads(roads.lines[[road]], roads.kinds[[road]], roads.widths_m[[road]])
        spacing_m = _STREET_SPACING_M[str(roads.kinds[road])]
        points = points_along(single, spacing_m, _VERGE_M, rng, both_sides=roads.kinds[road] in ("boulevard", "avenue"))
        met = network.query(points, predicate="dwithin", distance=_CLEAR_OF_CROSSING_M)
        crossing = np.zeros(len(points), dtype=bool)
        crossing[met[0][met[1] != road]] = True
        xy = shapely.get_coordinates(points)
        xy = xy[~crossing & (rng.random(len(points)) < 0.85)]
        xy = xy[_clear(xy, ways, _CLEAR_OF_WAYS_M) & ~_clear(xy, surveyed, 14.0)]
        species = np.full(len(xy), _STREET_TREES[int(rng.integers(len(_STREET_TREES)))], dtype=object)
        replaced = rng.random(len(xy)) < 0.08
        species[replaced] = _STREET_TREES[int(rng.integers(len(_STREET_TREES)))]
        places.append(xy)
        names.append(species)
    return np.concatenate(places), np.concatenate(names)


def _garden_species(count: int, kinds: int, rng: np.random.Generator) -> NDArray[np.int64]:
    """Draw species by Zipf's law, in an order drawn once for the city."""
    weight = 1.0 / np.arange(1, kinds + 1)
    return np.asarray(rng.permutation(kinds)[rng.choice(kinds, count, p=weight / weight.sum())])
