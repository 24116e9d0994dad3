"""The surroundings of groves: frames that hold them, the same from every thread, and what changes them."""

from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import numpy as np
import pytest
import shapely
from shapely import affinity

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.traits import OpenGrown
from urbanforest_cli.growth.grove import COLUMN_M, FRAME_STEP_M, SKY_CELL_M
from urbanforest_cli.growth.groves import cut_into_groves
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site, empty_surroundings

TREE = OpenGrown(
    age_years=(0, 10, 30, 80),
    height_m=(0.3, 7, 14, 19),
    crown_radius_m=(0.1, 2.5, 5.5, 8),
    crown_base_m=(0, 1.5, 2.5, 3),
)
LIGHT = light_from(50.0, 0.5)
SIDE = 200.0
CORNER = np.array([310_007.0, 5_210_003.0])


@pytest.fixture(scope="module")
def city():
    """Plants in lots of 40 m, some buildings."""
    rng = np.random.default_rng(12)
    xy = CORNER + rng.uniform(0, SIDE, (300, 2))
    plants = Plants(
        keys=rng.integers(0, 2**63, 300, dtype=np.uint64), xy_m=xy, species=np.zeros(300, dtype=np.int64),
        age_years=rng.uniform(0.2, 60, 300), pruning_factor=np.ones(300),
    )  # fmt: skip
    houses = []
    for _ in range(40):
        house = affinity.rotate(shapely.box(-5, -4, 5, 4), rng.uniform(0, 90))
        houses.append(affinity.translate(house, *(CORNER + rng.uniform(0, SIDE, 2))))
    lot = (np.floor((xy - CORNER) / 40) @ [100, 1]).astype(np.int64)
    return plants, lot, np.array(houses, dtype=object), rng.uniform(4, 12, 40)


def site_of(city, plants=None, houses=None, heights=None):
    return Site(
        city[0] if plants is None else plants, [TREE], city[2] if houses is None else houses,
        city[3] if heights is None else heights, LIGHT, Growth(),
    )  # fmt: skip


def groves_of(city):
    grove = cut_into_groves(city[1], city[0].xy_m, city[0].keys, Growth())
    return [np.flatnonzero(grove == number) for number in range(grove.max() + 1)]


def same(one, other):
    return all(np.array_equal(a, b) for a, b in zip(one, other, strict=True))


def test_frames_hold_plants_with_their_margins_and_all_that_is_in_them(city):
    site = site_of(city)
    for grove in groves_of(city):
        around = site.around(grove)
        local = city[0].xy_m[grove] - around.origin_m
        radius = TREE.crown_radius_at(city[0].age_years[grove])[:, None]
        assert (around.origin_m % FRAME_STEP_M == 0).all()
        assert (around.size_m % 1 == 0).all()
        assert (local - 1.35 * radius - 2 >= -1e-6).all()
        assert (local + 1.35 * radius + 2 <= around.size_m[:2] + 1e-6).all()
        assert around.size_m[2] >= 1.25 * TREE.height_at(city[0].age_years[grove]).max() + 3
        assert ((around.neighbour_xyz_m >= 0) & (around.neighbour_xyz_m <= around.size_m)).all()
        for field, cell in ((around.solid_top_m, COLUMN_M), (around.sky[0], SKY_CELL_M)):
            assert field.shape == (1, 1) or (np.array(field.shape) * cell == around.size_m[1::-1]).all()
        assert (np.diff(around.neighbour_season) >= 0).all()


def test_no_leaves_of_neighbours_are_inside_walls(city):
    site = site_of(city)
    met = 0
    for grove in groves_of(city):
        around = site.around(grove)
        points = around.neighbour_xyz_m + np.append(around.origin_m, 0)
        for house, height in zip(city[2], city[3], strict=True):
            low = points[(points[:, 2] < height - 1e-3) & (np.hypot(*(points[:, :2] - house.centroid.coords[0]).T) < 9)]
            met += len(low)
            assert not shapely.contains_xy(house, low[:, :2]).any()
    assert met


def test_threads_see_what_one_sees_alone(city):
    site, groves = site_of(city), groves_of(city)
    alone = [site.around(grove) for grove in groves]
    fresh = site_of(city)
    with ThreadPoolExecutor(4) as pool:
        together = list(pool.map(fresh.around, groves))
    assert all(same(one, other) for one, other in zip(alone, together, strict=True))


def test_rows_of_plants_and_buildings_may_come_in_any_order(city):
    plants, _, houses, heights = city
    rng = np.random.default_rng(0)
    mixed, stones = rng.permutation(len(plants)), rng.permutation(len(houses))
    shuffled = Plants(*(getattr(plants, name)[mixed] for name in plants.__dataclass_fields__))
    site, other = site_of(city), site_of(city, shuffled, houses[stones], heights[stones])
    for grove in groves_of(city)[::3]:
        rows = np.flatnonzero(np.isin(mixed, grove))
        assert same(site.around(grove), other.around(rows))
        assert site.reach_print(grove) == other.reach_print(rows)


def test_a_print_changes_exactly_where_the_surroundings_may(city):
    plants, _, houses, heights = city
    site, groves = site_of(city), groves_of(city)
    prints = [site.reach_print(grove) for grove in groves]
    assert len(set(prints)) == len(prints)

    def changed(other):
        moved = [other.reach_print(grove) != old for grove, old in zip(groves, prints, strict=True)]
        for grove, flag in zip(groves, moved, strict=True):
            assert flag or same(site.around(grove), other.around(grove))
        return np.array(moved)

    assert not changed(site_of(city)).any()
    older = plants.age_years.copy()
    older[17] += 3
    by_age = changed(site_of(city, replace(plants, age_years=older)))
    by_house = changed(site_of(city, houses=houses[1:], heights=heights[1:]))
    for flags, place in ((by_age, plants.xy_m[17]), (by_house, np.array(houses[0].centroid.coords[0]))):
        assert 0 < flags.sum() < len(groves)
        far = np.array([np.hypot(*(plants.xy_m[grove] - place).T).min() for grove in groves])
        assert not flags[far > 100].any()
    whose = next(number for number, grove in enumerate(groves) if 17 in grove)
    assert by_age[whose]
    raised = heights.copy()
    raised[3] += 2
    assert changed(site_of(city, heights=raised)).any()


def test_other_light_is_another_print(city):
    site = site_of(city)
    elsewhere = Site(city[0], [TREE], city[2], city[3], light_from(20.0, 0.5), Growth())
    grove = groves_of(city)[0]
    assert site.reach_print(grove) != elsewhere.reach_print(grove)


def test_a_plant_of_a_grove_alone_has_the_others_as_neighbours(city):
    site = site_of(city)
    crowded = max(groves_of(city), key=len)
    alone, joint = site.around(crowded[:1]), site.around(crowded)
    assert set(crowded[1:]) & set(site.neighbours_of(crowded[:1]))
    assert not set(crowded) & set(site.neighbours_of(crowded))
    assert alone.size_m[0] <= joint.size_m[0]
    assert len(alone.neighbour_season)


def test_nothing_around_is_said_in_the_shortest_way():
    xy = np.array([[100.0, 100.0], [112.0, 97.0]])
    around = empty_surroundings(xy, np.array([5.0, 2.0]), np.array([14.0, 4.0]), LIGHT)
    assert around.solid_top_m.tolist() == [[0.0]]
    assert around.sky.tolist() == [[[255]]]
    assert around.neighbour_xyz_m.shape == (0, 3)
    assert len(around.neighbour_season) == len(around.neighbour_internodes) == 0
    assert around.origin_m.tolist() == [80.0, 80.0]
    assert around.size_m.tolist() == [37.0, 29.0, 21.0]
    plants = Plants(np.array([1, 2], np.uint64), xy, np.zeros(2, np.int64), np.array([30.0, 8.0]), np.ones(2))
    lonely = Site(plants, [TREE], np.array([], dtype=object), np.array([]), LIGHT, Growth())
    sizes = TREE.crown_radius_at(plants.age_years), TREE.height_at(plants.age_years)
    assert same(lonely.around(np.arange(2)), empty_surroundings(xy, *sizes, LIGHT))


def test_a_city_without_plants_is_a_site_too():
    none = np.empty(0)
    plants = Plants(none.astype(np.uint64), np.empty((0, 2)), none.astype(np.int64), none, none)
    assert Site(plants, [TREE], np.array([], dtype=object), none, LIGHT, Growth()).margin.shape == (0,)
