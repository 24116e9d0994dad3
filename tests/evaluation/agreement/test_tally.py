from __future__ import annotations

import numpy as np
import pytest
import shapely

from urbanforest_cli.evaluation.agreement.sets import CrownsOfLots
from urbanforest_cli.evaluation.agreement.tally import tally
from urbanforest_cli.evaluation.agreement.tally_kernel import mark_discs, marked_shares
from urbanforest_cli.evaluation.results import PlantsOfLots

CELL_M = 0.5


def crowns(xy, radius_m, lot=None):
    xy = np.asarray(xy, dtype=float).reshape(-1, 2)
    lot = np.zeros(len(xy), dtype=np.int64) if lot is None else np.asarray(lot)
    return CrownsOfLots(PlantsOfLots(xy, lot), np.broadcast_to(np.asarray(radius_m, dtype=float), len(xy)).copy())


def map_of(function, *, cell_m=CELL_M, slack=0):
    """Return a reader of percentages by cell middle, whose windows may reach `slack` cells over what is asked."""

    def read(west, south, east, north):
        left, right = round(west / cell_m) - slack, round(east / cell_m) + slack
        bottom, top = round(south / cell_m) - slack, round(north / cell_m) + slack
        x, y = np.meshgrid((np.arange(left, right) + 0.5) * cell_m, (np.arange(top, bottom, -1) - 0.5) * cell_m)
        return function(x, y).astype(np.uint8), (left * cell_m, top * cell_m)

    return read


def covered_west_of(x_m):
    return map_of(lambda x, y: np.where(x < x_m, 100, 0))


def tallied(lots, sets, read, **more):
    lots = np.array(lots, dtype=object)
    more = {"cell_m": CELL_M, "threshold_percent": 50.0, "bounds_m": (-500.0, -500.0, 500.0, 500.0)} | more
    return tally(lots, sets, read, **more)


@pytest.mark.parametrize("radius", [0.3, 1.0, 4.7, 20.0])
def test_a_disc_has_its_area_wherever_it_lies(radius):
    rng = np.random.default_rng(0)
    for x, y in rng.random((5, 2)):
        marks, shares = np.zeros((100, 100), np.uint64), np.zeros((100, 100), np.float32)
        mark_discs(marks, np.array([25 + x]), np.array([25 + y]), np.array([radius]), 0.0, 50.0, 0.5)
        marked_shares(marks, shares)
        assert shares.sum() * 0.25 == pytest.approx(np.pi * radius**2, rel=0.02 if radius > 0.5 else 0.1)


def test_areas_are_those_of_the_polygons_themselves():
    rng = np.random.default_rng(1)
    xy, radius = rng.uniform(0, 60, (40, 2)), rng.uniform(1, 5, 40)
    triangle = shapely.Polygon([(3.3, 4.1), (55.2, 20.7), (12.4, 51.9)])
    holed = shapely.box(35, 30, 58, 58).difference(shapely.box(41.2, 40.3, 49.7, 52.6))
    union = shapely.union_all(shapely.buffer(shapely.points(xy), radius, quad_segs=32))
    found = tallied([triangle, holed], {"one": crowns(xy, radius)}, covered_west_of(40.0))
    for row, lot in enumerate((triangle, holed)):
        west = shapely.box(-100, -100, 40, 100)
        assert found.whole_m2[row] == pytest.approx(lot.area)
        assert found.known_m2[row] == pytest.approx(lot.area, rel=1e-5)
        assert found.covered_m2[row] == pytest.approx(lot.intersection(west).area, rel=1e-5, abs=1e-6)
        under = lot.intersection(union)
        assert found.crown_m2["one"][row] == pytest.approx(under.area, rel=0.01)
        assert found.half_m2["one"][row] == pytest.approx(under.area, rel=0.03)
        assert found.both_m2["one"][row] == pytest.approx(under.intersection(west).area, rel=0.03, abs=0.5)


@pytest.mark.parametrize("slack", [0, 3])
def test_tiles_and_wider_windows_change_nothing(slack):
    rng = np.random.default_rng(2)
    lots = [shapely.box(x, y, x + 33.3, y + 21.7) for x in range(-70, 70, 35) for y in range(-50, 50, 25)]
    sets = {"one": crowns(rng.uniform(-70, 70, (80, 2)), rng.uniform(0.5, 6, 80))}
    wavy = map_of(lambda x, y: 50 + 49 * np.sin(x / 7) * np.cos(y / 5), slack=slack)
    whole = tallied(lots, sets, wavy)
    tiled = tallied(lots, sets, wavy, tile_cells=37)
    for name in ("known_m2", "covered_m2", "percent_m2"):
        np.testing.assert_allclose(getattr(tiled, name), getattr(whole, name), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose(tiled.crown_m2["one"], whole.crown_m2["one"], rtol=1e-5, atol=1e-3)
    np.testing.assert_allclose(tiled.both_m2["one"], whole.both_m2["one"], rtol=1e-5, atol=1e-3)


def test_crowns_that_overlap_count_once_and_dead_ones_not_at_all():
    lot = [shapely.box(0, 0, 20, 20)]
    twice = tallied(lot, {"one": crowns([(10, 10), (10, 10), (5, 5)], [4.0, 4.0, 0.0])}, covered_west_of(100.0))
    assert twice.crown_m2["one"][0] == pytest.approx(np.pi * 16, rel=0.01)


def test_what_the_map_does_not_know_counts_nowhere():
    lot = [shapely.box(0, 0, 20, 20)]
    half = map_of(lambda x, y: np.where(x < 10, 255, 80))
    found = tallied(lot, {"one": crowns([(5, 10), (15, 10)], 3.0)}, half)
    assert found.known_m2[0] == pytest.approx(200)
    assert found.covered_m2[0] == pytest.approx(200)
    assert found.percent_m2[0] == pytest.approx(160)
    assert found.crown_m2["one"][0] == pytest.approx(np.pi * 9, rel=0.01)
    assert found.both_m2["one"][0] == pytest.approx(np.pi * 9, rel=0.03)


def test_a_crown_counts_where_it_is_not_where_it_belongs():
    lots = [shapely.box(0, 0, 10, 10), shapely.box(10, 0, 20, 10)]
    found = tallied(lots, {"one": crowns([(10, 5)], 4.0, lot=[0])}, covered_west_of(0.0))
    np.testing.assert_allclose(found.crown_m2["one"], np.pi * 8, rtol=0.01)


def test_tiles_beside_the_map_are_not_read():
    lots = [shapely.box(0, 0, 10, 10), shapely.box(300, 0, 310, 10)]

    def read(west, south, east, north):
        assert west < 100
        return covered_west_of(5.0)(west, south, east, north)

    found = tallied(lots, {}, read, bounds_m=(-20.0, -20.0, 60.0, 60.0), tile_cells=64)
    assert found.known_m2.tolist() == pytest.approx([100, 0])
