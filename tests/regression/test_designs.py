import numpy as np
import pytest
import shapely

from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.designs import draw_pairs, plain_lots, used_by

KEYS = keys_for(4, "test", map(str, range(3000)))


def test_parameters_fill_the_ranges_of_the_table_evenly():
    drawn = draw_pairs(KEYS)
    for column, name in enumerate(REGRESSED):
        low, high = PARAMETERS[name].low, PARAMETERS[name].high
        low = 0.05 if name == "density" else low
        share = (drawn.values[:, column] - low) / (high - low)
        assert share.min() >= 0
        assert share.max() <= 1
        counts = np.histogram(share, 6, (0, 1))[0]
        assert counts.min() > 400, name
    assert set(drawn.values[:, REGRESSED.index("cluster_count_max")]) == {0, 1, 2, 3, 4, 5}
    assert np.bincount(drawn.strategy).min() > 900
    assert drawn.with_building.mean() == pytest.approx(0.7, abs=0.03)
    assert abs(np.corrcoef(drawn.values.T) - np.eye(6)).max() < 0.06


def test_strategies_use_their_own_parameters():
    used = {letter: row.tolist() for letter, row in zip("RBC", used_by(np.arange(3)), strict=True)}
    common = [True, True, True]
    assert used == {
        "R": [*common, False, False, False],
        "B": [*common, True, False, False],
        "C": [*common, False, True, True],
    }


@pytest.mark.parametrize(("design", "low", "high"), [("S", 10, 60), ("P", 60, 100)])
def test_the_test_designs_have_the_sizes_they_are_said_to_have(design, low, high):
    lots, houses = plain_lots(KEYS, design)
    west, south, east, north = shapely.bounds(lots).T
    sides = np.column_stack((east - west, north - south))
    assert sides.min() >= low - 1e-6
    assert sides.max() <= high + 1e-6
    assert np.quantile(sides, 0.5) == pytest.approx((low + high) / 2, rel=0.05)
    corners = shapely.get_num_coordinates(lots)
    assert (corners > 5).mean() == pytest.approx(0.5, abs=0.05)
    assert shapely.is_valid(lots).all()
    assert shapely.area(shapely.difference(houses, lots)).max() < 1e-5
    assert (shapely.area(houses) > 0).mean() > 0.95
    gaps = west[1:] - east[:-1]
    assert gaps.min() > 150


def test_lots_for_training_are_turned_and_some_adjoin():
    lots, houses = plain_lots(KEYS, "mixed")
    assert shapely.is_valid(lots).all()
    assert shapely.is_valid(houses).all()
    assert shapely.area(shapely.difference(houses, lots)).max() < 1e-5
    assert (shapely.area(houses) > 0).mean() > 0.95
    touching = shapely.distance(lots[0::2], lots[1::2]) < 1e-6
    assert 0.5 < touching.mean() < 0.62  # L-shapes may turn their cut corners to each other
    overlap = shapely.area(shapely.intersection(lots[0::2], lots[1::2]))
    assert overlap.max() < 1e-6
    assert shapely.distance(lots[1:-1:2], lots[2::2]).min() > 30
    area = shapely.area(lots)
    assert (area < 900).mean() > 0.3
    assert (area > 3000).mean() > 0.2


def test_a_lot_hangs_on_its_own_key_alone():
    lots, _ = plain_lots(KEYS, "mixed")
    few, _ = plain_lots(KEYS[:10], "mixed")
    assert shapely.equals_exact(lots[:10], few).all()
