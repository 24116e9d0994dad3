"""Crowns of neighbours: who owns the space between plants, and since when."""

import itertools

import numpy as np
import pytest

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.traits import OpenGrown
from urbanforest_cli.growth.grove import season_count
from urbanforest_cli.growth.neighbour_kernel import POINT_CELL_M
from urbanforest_cli.growth.neighbours import INTERNODES_PER_M3, crown_history, crown_sizes, crown_table, ellipsoids
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site

TREE = OpenGrown(
    age_years=(0, 10, 30, 80),
    height_m=(0.3, 7, 14, 19),
    crown_radius_m=(0.1, 2.5, 5.5, 8),
    crown_base_m=(0, 1.5, 2.5, 3),
)
SHRUB = OpenGrown(
    age_years=(0, 5, 20, 50),
    height_m=(0.2, 1.8, 3.5, 4),
    crown_radius_m=(0.1, 0.9, 1.7, 2),
    crown_base_m=(0, 0, 0.1, 0.2),
)
LIGHT = light_from(50.0, 0.5)
CORNER = np.array([4_310_000.0, 3_210_000.0])


def stand(rng, count, spread):
    return Plants(
        keys=rng.integers(0, 2**63, count, dtype=np.uint64),
        xy_m=CORNER + rng.uniform(0, spread, (count, 2)),
        species=rng.integers(0, 2, count),
        age_years=rng.uniform(0.5, 70, count),
        pruning_factor=rng.choice([1.0, 1.0, 0.5], count),
    )


def site_of(plants, **changes):
    nothing = np.array([], dtype=object)
    return Site(plants, [TREE, SHRUB], nothing, np.array([]), LIGHT, Growth(**changes))


def pair(first, second, apart):
    """Two plants, (species, age) each."""
    return Plants(
        keys=np.array([7, 9], dtype=np.uint64),
        xy_m=CORNER + np.array([[20.0, 20.0], [20.0 + apart, 20.0]]),
        species=np.array([first[0], second[0]]),
        age_years=np.array([first[1], second[1]], dtype=float),
        pruning_factor=np.ones(2),
    )


def depth(site, plant, xyz, age=None):
    """Return how deep points of the world lie in a crown, from the open-grown sizes alone: 0 middle, 1 skin."""
    plants = site.plants
    sizes = (TREE, SHRUB)[plants.species[plant]]
    age = plants.age_years[plant] if age is None else age
    scale = plants.pruning_factor[plant]
    base = sizes.crown_base_at(age)
    tall = scale * (sizes.height_at(age) - base)
    away = np.hypot(*(xyz[:, :2] - plants.xy_m[plant]).T) / (scale * sizes.crown_radius_at(age))
    return np.hypot(away, (xyz[:, 2] - base - tall / 2) / (tall / 2))


def season_since(site, plant, points, last):
    """Return since which season of a grove of `last` seasons points have lain in a crown, going back year by year."""
    age = site.plants.age_years[plant]
    since = np.full(len(points), last)
    inside = np.ones(len(points), dtype=bool)
    for years_ago in range(1, int(season_count(np.array([age]))[0])):
        inside &= depth(site, plant, points, age - years_ago) <= 1
        since[inside] = last - years_ago
    return np.maximum(since, 1)


def in_world(surroundings):
    points = surroundings.neighbour_xyz_m.astype(float)
    return points + np.append(surroundings.origin_m, 0.0)


@pytest.mark.parametrize(("second", "apart"), [((0, 40), 6.0), ((0, 12), 4.0), ((0, 25), 2.5), ((0, 40), 0.5)])
def test_two_sides_of_a_border_share_the_space_by_one_rule(second, apart):
    site = site_of(pair((0, 40), second, apart))
    crown_of_b, crown_of_a = (in_world(site.around(np.array([i]))) for i in (0, 1))
    for points, mine, other in ((crown_of_b, 0, 1), (crown_of_a, 1, 0)):
        assert len(points)
        assert (depth(site, other, points) <= 1 + 1e-5).all()
        assert (depth(site, other, points) <= depth(site, mine, points) + 1e-5).all()
    cells = [set(map(tuple, np.floor(points / POINT_CELL_M).astype(int))) for points in (crown_of_a, crown_of_b)]
    assert not cells[0] & cells[1]
    overlap = list(_cells_in_both(site))
    assert overlap
    assert all((cell in cells[0]) != (cell in cells[1]) for cell in overlap)


def _cells_in_both(site):
    """Cells of the world that lie whole in both crowns: their point, wherever it is, belongs to one of the two."""
    low = np.floor((np.append(site.plants.xy_m.min(axis=0) - 8, 0)) / POINT_CELL_M).astype(int)
    for step in itertools.product(range(26), range(22), range(24)):
        cell = low + step
        corners = (cell + np.array(list(itertools.product((0, 1), repeat=3)))) * POINT_CELL_M
        if all((depth(site, plant, corners) < 1).all() for plant in (0, 1)):
            yield tuple(cell)


def test_equal_plants_part_in_the_middle_and_take_equal_shares():
    site = site_of(pair((0, 40), (0, 40), 6.0))
    right, left = (in_world(site.around(np.array([i]))) for i in (0, 1))
    middle = CORNER[0] + 23.0
    assert right[:, 0].min() > middle > left[:, 0].max()
    assert right[:, 0].min() - left[:, 0].max() < 0.5
    assert len(right) == pytest.approx(len(left), rel=0.1)


def test_every_point_belongs_to_the_neighbour_in_whose_crown_it_lies_deepest():
    rng = np.random.default_rng(5)
    site = site_of(stand(rng, 60, 45.0))
    for grove in (np.array([3]), np.array([10, 11, 12, 13]), np.arange(0, 60, 4)):
        around = site.around(grove)
        points = in_world(around)
        depths = np.array([depth(site, plant, points) for plant in range(60)])
        assert (depths.min(axis=0) <= 1 + 1e-5).all()
        assert (depths[grove].min(axis=0) >= depths.min(axis=0)).all()
        owner = depths.argmin(axis=0)
        assert not np.isin(owner, grove).any()
        last = int(season_count(site.plants.age_years[grove]).max())
        since = np.array([season_since(site, plant, points, last) for plant in range(60)])
        assert (around.neighbour_season == since[owner, np.arange(len(points))]).mean() > 0.95
        away = np.hypot(*(points[:, None, :2] - site.plants.xy_m[grove]).transpose(2, 0, 1))
        assert (away < site.margin[grove] + 1e-3).any(axis=1).all()
        assert len(np.unique(np.floor(points / POINT_CELL_M), axis=0)) == len(points)


def test_a_crown_holds_as_many_internodes_as_its_volume_says():
    site = site_of(pair((0, 40), (1, 30), 12.5))  # the shrub stands by itself, all of it within the tree's reach
    site.margin[0] = 20.0
    around = site.around(np.array([0]))
    radius, _, half = ellipsoids(crown_sizes(site.table, np.array([1]), np.array([30.0]), np.ones(1)))[0]
    volume = 4 / 3 * np.pi * radius**2 * half
    assert around.neighbour_internodes.sum() == pytest.approx(INTERNODES_PER_M3 * volume, rel=0.15)
    assert (around.neighbour_xyz_m.min(axis=0) >= 0).all()
    assert (around.neighbour_xyz_m.max(axis=0) <= around.size_m).all()


@pytest.mark.parametrize(
    ("age", "own_age", "apart"), [(30.0, 12.0, 5.0), (12.4, 55.0, 5.0), (2.5, 6.0, 1.5), (40.0, 40.0, 5.0)]
)
def test_points_come_when_the_growing_crown_reaches_them(age, own_age, apart):
    site = site_of(pair((0, own_age), (0, age), apart))
    around = site.around(np.array([0]))
    season = around.neighbour_season
    assert len(season)
    assert (np.diff(season) >= 0).all()
    last = int(season_count(np.array([own_age]))[0])
    difference = np.abs(season - season_since(site, 1, in_world(around), last))
    assert (difference == 0).mean() > 0.97  # a few lie on a skin, or between two ages of the table
    assert difference.max() <= 2
    assert season.max() <= last


def test_rows_may_come_in_any_order():
    rng = np.random.default_rng(8)
    plants = stand(rng, 80, 50.0)
    grove = np.arange(20, 32)
    expected = site_of(plants).around(grove)
    shuffle = rng.permutation(80)
    mixed = Plants(*(getattr(plants, name)[shuffle] for name in plants.__dataclass_fields__))
    rows = rng.permutation(np.flatnonzero(np.isin(shuffle, grove)))
    found = site_of(mixed).around(rows)
    for one, other in zip(expected, found, strict=True):
        assert np.array_equal(one, other)


def test_no_neighbours_where_the_config_wants_none():
    site = site_of(stand(np.random.default_rng(1), 30, 20.0), neighbours=False)
    assert len(site.around(np.array([0, 1])).neighbour_season) == 0


def test_a_tree_overtops_a_shrub_and_the_shrub_keeps_its_own_place():
    site = site_of(pair((1, 30), (0, 40), 3.0))
    above = in_world(site.around(np.array([0])))
    over_shrub = np.hypot(*(above[:, :2] - site.plants.xy_m[0]).T) < 1.0
    assert above[over_shrub, 2].min() > 2.5
    assert over_shrub.any()


def test_history_ends_with_the_sizes_of_the_age_and_begins_small():
    table = crown_table([TREE, SHRUB], 60)
    age, species = np.array([40.0, 0.4, 17.3]), np.array([0, 1, 0])
    history, first = crown_history(table, species, age, np.ones(3))
    assert np.diff(first).tolist() == [40, 1, 18]
    sizes = crown_sizes(table, species, age, np.ones(3))
    assert history[first[1:] - 1] == pytest.approx(ellipsoids(sizes))
    assert sizes[0] == pytest.approx([TREE.crown_radius_at(40.0), TREE.height_at(40.0), TREE.crown_base_at(40.0)])
    assert (np.diff(history[: first[1], 0]) >= 0).all()


def test_the_crown_of_a_pruned_neighbour_has_its_sides_scaled():
    table = crown_table([TREE], 60)
    ages, one = np.array([30.0]), np.zeros(1, dtype=np.int64)
    whole, half = (ellipsoids(crown_sizes(table, one, ages, np.array([share])))[0] for share in (1.0, 0.5))
    assert (half[0], half[2]) == pytest.approx((0.5 * whole[0], 0.5 * whole[2]))
