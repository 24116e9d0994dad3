"""The procedural city: what must be true of any of them."""

from __future__ import annotations

import numpy as np
import pytest
import shapely

from urbanforest_cli.core.config import Species
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.synth.lots import ACROSS_PATH, ENCLAVE, FLAG, STEPPED
from urbanforest_cli.synth.stage import SynthCity, build_city

OVERLAP_M2 = 1e-5
"""What rounding of coordinates may cost where two neighbours' corners lie on each other's border."""


@pytest.fixture(scope="module")
def catalogue() -> Catalogue:
    return load_catalogue(Species())


@pytest.fixture(scope="module")
def town(catalogue: Catalogue) -> SynthCity:
    return build_city(1500, 5, catalogue)


def overlaps_m2(one: np.ndarray, other: np.ndarray) -> np.ndarray:
    first, second = shapely.STRtree(other).query(one, predicate="intersects")
    if one is other:
        first, second = first[first < second], second[first < second]
    return shapely.area(shapely.intersection(one[first], other[second]))


@pytest.mark.parametrize("count", [10, 11, 37, 119, 120, 350, 1500])
@pytest.mark.parametrize("seed", [0, 1])
def test_a_city_has_exactly_the_lots_asked_for(catalogue: Catalogue, count: int, seed: int) -> None:
    city = build_city(count, seed, catalogue)
    assert len(city.lots) == len(city.zones) == count
    assert not shapely.is_empty(city.lots.shapes).any()


def test_lots_do_not_overlap(town: SynthCity) -> None:
    assert overlaps_m2(town.lots.shapes, town.lots.shapes).max() < OVERLAP_M2


def test_all_shapes_are_valid(town: SynthCity) -> None:
    for shapes in (
        town.lots.shapes, town.buildings.shapes, town.buildings.driveways, town.sketches.shapes, town.roads.lines,
        town.obstacles.shapes,
    ):  # fmt: skip
        assert shapely.is_valid(shapes).all()
        assert not shapely.is_empty(shapes).any()


def test_every_building_stands_inside_its_own_lot_and_apart_from_others(town: SynthCity) -> None:
    buildings = town.buildings
    assert shapely.contains_properly(town.lots.shapes[buildings.lot], buildings.shapes).all()
    assert len(overlaps_m2(buildings.shapes, buildings.shapes)) == 0
    assert (buildings.heights_m > 2).all()


def test_carriageways_keep_off_the_lots(town: SynthCity) -> None:
    ways = shapely.buffer(town.roads.lines, town.roads.widths_m / 2, cap_style="flat")
    assert overlaps_m2(ways, town.lots.shapes).max(initial=0) < 10.0


def test_the_river_keeps_off_lots_and_buildings(town: SynthCity) -> None:
    water = town.obstacles.shapes[town.obstacles.kinds == "water"]
    assert len(water) >= 1
    assert overlaps_m2(water, town.lots.shapes).max(initial=0) < OVERLAP_M2


def test_doors_and_windows_are_in_walls(town: SynthCity) -> None:
    entrances = town.buildings.entrances
    walls = shapely.STRtree(shapely.boundary(town.buildings.shapes))
    found = walls.query(entrances, predicate="dwithin", distance=1e-6)[0]
    assert len(np.unique(found)) == len(entrances)
    assert set(town.buildings.entrance_kinds) == {"door", "window"}


def test_driveways_lead_from_the_street_to_a_building_and_not_into_it(town: SynthCity) -> None:
    driveways, buildings = town.buildings.driveways, town.buildings.shapes
    near = shapely.STRtree(buildings).query(driveways, predicate="dwithin", distance=0.15)[0]
    assert len(np.unique(near)) == len(driveways)
    assert overlaps_m2(driveways, buildings).max(initial=0) < OVERLAP_M2
    curb = shapely.STRtree(town.roads.lines).query(driveways, predicate="dwithin", distance=16.0)[0]
    assert len(np.unique(curb)) > 0.97 * len(driveways)


def test_posts_stand_on_no_carriageway_and_pipes_under_no_building(town: SynthCity) -> None:
    obstacles, roads = town.obstacles, town.roads
    posts = obstacles.shapes[np.isin(obstacles.kinds, ("hydrant", "mast"))]
    ways = shapely.STRtree(shapely.buffer(roads.lines, roads.widths_m / 2 - 0.01, cap_style="flat"))
    assert len(ways.query(posts, predicate="intersects")[0]) == 0
    pipes = obstacles.shapes[obstacles.kinds == "pipe"]
    assert len(shapely.STRtree(town.buildings.shapes).query(pipes, predicate="intersects")[0]) == 0
    assert np.isfinite(obstacles.clearances_m[obstacles.kinds == "pipe"]).all()


def test_all_zones_are_there_with_squares_and_roads_are_the_street_zone_without(catalogue: Catalogue) -> None:
    for count in (10, 200, 1500):
        assert set(build_city(count, 2, catalogue, squares=True).zones) == {
            "residential", "commercial", "industrial", "street", "other"
        }  # fmt: skip
        plain = build_city(count, 2, catalogue)
        assert set(plain.zones) == {"residential", "commercial", "industrial", "other"}
        assert len(plain.roads.lines) > 0


def test_homes_are_most_lots_and_works_and_shops_are_larger(town: SynthCity) -> None:
    area = shapely.area(town.lots.shapes)
    median = {zone: float(np.median(area[town.zones == zone])) for zone in set(town.zones)}
    assert 380 < median["residential"] < 500
    assert median["commercial"] > 1.2 * median["residential"]
    assert median["industrial"] > 3 * median["residential"]
    assert (town.zones == "residential").mean() > 0.6


def test_lots_have_all_sorts_of_shapes(town: SynthCity) -> None:
    lots = town.lots
    for kind in (FLAG, STEPPED, ENCLAVE, ACROSS_PATH):
        assert (lots.kind == kind).any(), kind
    parts = shapely.get_num_geometries(lots.shapes)
    assert 0 < (parts > 1).mean() < 0.02
    rings = shapely.get_num_interior_rings(shapely.get_geometry(lots.shapes, 0))
    assert (rings > 0).any()
    concave = shapely.area(lots.shapes) < 0.97 * shapely.area(shapely.convex_hull(lots.shapes))
    assert concave.mean() > 0.02


def test_buildings_have_all_sorts_of_ground_plans(town: SynthCity) -> None:
    corners = shapely.get_num_coordinates(shapely.get_exterior_ring(town.buildings.shapes)) - 1
    assert set(corners.tolist()) == {4, 6, 8}
    assert (shapely.get_num_interior_rings(town.buildings.shapes) == 1).any()


def test_streets_run_in_many_directions(town: SynthCity) -> None:
    xy = shapely.get_coordinates(shapely.get_point(town.roads.lines, 1)) - shapely.get_coordinates(
        shapely.get_point(town.roads.lines, 0)
    )
    direction = np.degrees(np.arctan2(xy[:, 1], xy[:, 0])) % 90
    counts, _ = np.histogram(direction, bins=9, range=(0, 90))
    assert (counts > 0.02 * len(direction)).sum() >= 6
    assert {"boulevard", "avenue", "collector", "street", "quay", "bridge"} <= set(town.roads.kinds)


def test_sketches_lie_in_greens_and_do_not_overlap(town: SynthCity) -> None:
    sketches = town.sketches
    assert "equidistant" in sketches.strategies
    assert np.isfinite(sketches.coverage).sum() >= 1
    green = shapely.union_all(town.lots.shapes[town.zones == "other"])
    assert shapely.covered_by(sketches.shapes, green).all()
    assert overlaps_m2(sketches.shapes, sketches.shapes).max(initial=0) == 0


def test_observed_plants_are_real_species_and_keep_off_walls(town: SynthCity, catalogue: Catalogue) -> None:
    trees = town.inventory
    assert len(trees.points) > 1000
    assert set(trees.species) <= set(catalogue.ids)
    assert len(set(trees.species)) == 10
    near = shapely.STRtree(town.buildings.shapes).query(trees.points, predicate="intersects")[0]
    assert len(near) == 0
    tallest = max(kind.mature_height_m for kind in catalogue)
    assert ((trees.heights_m >= 1.0) & (trees.heights_m < 1.6 * tallest)).all()


def same(one: SynthCity, other: SynthCity) -> bool:
    pairs = (
        (one.lots.shapes, other.lots.shapes), (one.buildings.shapes, other.buildings.shapes),
        (one.roads.lines, other.roads.lines), (one.inventory.points, other.inventory.points),
        (one.buildings.driveways, other.buildings.driveways), (one.obstacles.shapes, other.obstacles.shapes),
    )  # fmt: skip
    return all(np.array_equal(shapely.to_wkb(a), shapely.to_wkb(b)) for a, b in pairs) and np.array_equal(
        one.zones, other.zones
    )


def test_a_seed_always_makes_the_same_city(catalogue: Catalogue) -> None:
    assert same(build_city(300, 4, catalogue), build_city(300, 4, catalogue))


def test_another_seed_makes_another_city(catalogue: Catalogue) -> None:
    one, other = build_city(300, 4, catalogue), build_city(300, 5, catalogue)
    assert not same(one, other)
    assert shapely.area(one.lots.shapes).sum() != shapely.area(other.lots.shapes).sum()
