from __future__ import annotations

import numpy as np
import pytest
import shapely

from urbanforest_cli.evaluation.agreement.sets import CrownsOfLots, random_crowns, shuffled_crowns
from urbanforest_cli.evaluation.results import PlantsOfLots


@pytest.fixture
def town():
    """Thirty lots from 100 to 3,000 m2, each with plants whose radius tells which lot they come from."""
    rng = np.random.default_rng(3)
    lots = np.array([shapely.Point(200 * i, 0).buffer(np.sqrt((i + 1) * 100 / np.pi)) for i in range(30)], dtype=object)
    ids = np.array([f"lot {i}" for i in range(30)], dtype=object)
    lot = np.repeat(np.arange(30), 4)
    centre = shapely.get_coordinates(shapely.centroid(lots))[lot]
    xy = centre + rng.uniform(-3, 3, (120, 2))
    order = rng.permutation(120)
    return ids, lots, CrownsOfLots(PlantsOfLots(xy[order], lot[order]), 1.0 + lot[order] / 100)


def by_id(crowns, ids):
    rows = [(str(ids[lot]), *map(float, xy), float(r)) for lot, xy, r in
            zip(crowns.plants.lot, crowns.plants.xy, crowns.radius_m, strict=True)]  # fmt: skip
    return sorted(rows)


def test_every_lot_gets_the_plants_of_another_of_similar_size(town):
    ids, lots, crowns = town
    found = shuffled_crowns(crowns, lots, ids, 0)
    source = np.rint((found.radius_m - 1) * 100).astype(int)
    assert sorted(found.radius_m) == sorted(crowns.radius_m)
    assert (source != found.plants.lot).all()
    assert np.abs(source - found.plants.lot).max() < 10
    assert shapely.contains_xy(lots[found.plants.lot], found.plants.xy[:, 0], found.plants.xy[:, 1]).all()


def test_sets_know_no_order_of_lots_and_plants(town):
    ids, lots, crowns = town
    turn = np.random.default_rng(4).permutation(30)
    back = np.argsort(turn)
    same = CrownsOfLots(PlantsOfLots(crowns.plants.xy, back[crowns.plants.lot]), crowns.radius_m)
    for draw in (shuffled_crowns, random_crowns):
        one, two = draw(crowns, lots, ids, 0), draw(same, lots[turn], ids[turn], 0)
        assert by_id(one, ids) == by_id(two, ids[turn])
        assert by_id(draw(crowns, lots, ids, 1), ids) != by_id(one, ids)


def test_random_crowns_keep_their_lot_and_stay_off_what_is_not_ground(town):
    ids, lots, crowns = town
    ground = np.array([lot.difference(shapely.Point(lot.centroid).buffer(3)) for lot in lots], dtype=object)
    found = random_crowns(crowns, ground, ids, 0)
    assert (np.bincount(found.plants.lot) == 4).all()
    np.testing.assert_allclose(found.radius_m, 1.0 + found.plants.lot / 100)
    assert shapely.contains_xy(ground[found.plants.lot], found.plants.xy[:, 0], found.plants.xy[:, 1]).all()


@pytest.mark.parametrize("count", [1, 2, 9, 11, 19, 25])
def test_no_lot_keeps_its_plants_while_there_is_another(town, count):
    ids, lots, crowns = town
    few = crowns.plants.lot < count
    part = CrownsOfLots(PlantsOfLots(crowns.plants.xy[few], crowns.plants.lot[few]), crowns.radius_m[few])
    found = shuffled_crowns(part, lots[:count], ids[:count], 0)
    source = np.rint((found.radius_m - 1) * 100).astype(int)
    assert sorted(np.unique(source)) == list(range(count))
    assert (source == found.plants.lot).all() == (count == 1)


def test_nothing_stays_nothing(town):
    ids, lots, _ = town
    assert len(shuffled_crowns(CrownsOfLots.none(), lots, ids, 0).radius_m) == 0
    assert len(random_crowns(CrownsOfLots.none(), lots, ids, 0).radius_m) == 0
