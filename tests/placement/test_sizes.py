"""Ages and species that make plants as wide, or as high, as they are known to be."""

from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.core.config import Species
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.placement.seeds import Seeds
from urbanforest_cli.placement.sizes import GROWN_ALONE, LOST_TO_CROWD, age_at_height, as_wide_as_seen, crowding


@pytest.fixture(scope="module")
def catalogue():
    return load_catalogue(Species())


def widest(kind):
    ages = np.arange(0, kind.lifespan_years + 0.25, 0.25)
    return float(kind.open_grown.crown_radius_at(ages).max())


def sized(catalogue, radius, species, *, dominant=0, xy=None, rows=None, site=None, key=1):
    count = len(radius)
    site = np.zeros(count, dtype=np.int64) if site is None else np.array(site)
    lots = int(site.max()) + 1
    seeds = Seeds(np.array(species), np.full(count, 3.0), np.ones(count), np.full(lots, dominant))
    xy = np.column_stack((100.0 * np.arange(count), np.zeros(count))) if xy is None else np.array(xy)
    rows = np.arange(count) if rows is None else np.array(rows)
    keys = np.full(lots, key, dtype=np.uint64)
    return as_wide_as_seen(seeds, rows, site, keys, xy, np.array(radius, dtype=np.float64), catalogue)


def test_plants_are_as_old_as_their_crown_is_wide(catalogue):
    for number, kind in enumerate(catalogue):
        radius = np.array([0.3, 0.6, 0.85]) * widest(kind) * GROWN_ALONE
        found = sized(catalogue, radius, [number] * 3)
        assert found.species.tolist() == [number] * 3
        assert kind.open_grown.crown_radius_at(found.age_years) * GROWN_ALONE == pytest.approx(radius, rel=0.12)
        assert (np.diff(found.age_years) > 0).all()
        assert found.age_years.max() <= kind.lifespan_years


def test_a_crown_wider_than_its_species_gets_another_one_that_is_wide_enough(catalogue):
    reach = [widest(kind) for kind in catalogue]
    small, wide = int(np.argmin(reach)), int(np.argmax(reach))
    radius = [0.95 * max(reach) * GROWN_ALONE] * 3
    assert sized(catalogue, radius, [small] * 3, dominant=wide).species.tolist() == [wide] * 3
    other = sized(catalogue, radius, [small] * 3, dominant=small).species
    assert len(set(other.tolist())) == 1
    assert reach[other[0]] > 0.8 * max(reach)
    beyond = sized(catalogue, [10 * max(reach)], [small], dominant=small)
    assert beyond.species.tolist() == [wide]
    assert list(catalogue)[wide].open_grown.crown_radius_at(beyond.age_years)[0] == pytest.approx(max(reach), rel=0.01)


def test_only_plants_whose_crowns_are_known_change(catalogue):
    found = sized(catalogue, [1.0, 2.0, 1.5], [0, 0, 0], rows=[1])
    assert found.age_years[[0, 2]].tolist() == [3.0, 3.0]
    assert found.age_years[1] != 3.0


def test_crowded_plants_have_to_be_older(catalogue):
    tree = next(i for i, kind in enumerate(catalogue) if kind.habit == "tree")
    near = [[0.0, 0.0], [2.6, 0.0], [-2.6, 0.0]]
    alone = sized(catalogue, [2.0] * 3, [tree] * 3).age_years
    close = sized(catalogue, [2.0] * 3, [tree] * 3, xy=near).age_years
    assert (close > alone).all()
    assert close[0] > close[1]
    lots = sized(catalogue, [2.0] * 3, [tree] * 3, xy=near, site=[0, 1, 2]).age_years
    assert np.array_equal(lots, alone)  # only those of the own lot are told of


def test_crowding_counts_neighbours_that_touch():
    xy = np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0], [50.0, 0.0]])
    one = np.zeros(4, dtype=np.int64)
    found = crowding(one, xy, np.full(4, 2.0))
    assert found[0] == pytest.approx(2 * found[1])
    assert found[0] > found[1] > found[3] == 0
    smaller = crowding(one, xy, np.array([2.0, 0.5, 2.0, 2.0]))
    assert smaller[0] < found[0]
    assert 0 < LOST_TO_CROWD * found.max() < GROWN_ALONE
    assert crowding(one[:0], xy[:0], np.zeros(0)).shape == (0,)


def test_ages_are_those_at_which_open_grown_plants_are_as_high(catalogue):
    kinds = list(catalogue)
    tree = next(i for i, kind in enumerate(kinds) if kind.habit == "tree")
    curve = kinds[tree].open_grown.height_at(np.array([10.0, 30.0]))
    heights = np.array([*curve, np.nan, 500.0, 0.01])
    ages = age_at_height(heights, np.full(5, tree), catalogue)
    assert ages[:2] == pytest.approx([10.0, 30.0], abs=0.5)
    assert np.isnan(ages[2])
    assert ages[3] <= kinds[tree].lifespan_years  # higher than it ever gets: as old as it gets, or fully grown
    assert kinds[tree].open_grown.height_at(ages[3:4])[0] > curve[1]
    assert 0 < ages[4] <= 1
    shrub = next(i for i, kind in enumerate(kinds) if kind.habit == "shrub")
    both = age_at_height(np.array([3.0, 3.0]), np.array([tree, shrub]), catalogue)
    assert both[0] != both[1]
