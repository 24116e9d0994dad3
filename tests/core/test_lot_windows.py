import numpy as np
import pytest
import shapely

from urbanforest_cli.core.lot_windows import (
    EDGE_MAX_M,
    LotWindows,
    Surroundings,
    WindowPlaces,
    lot_windows,
    window_places,
)

NOTHING = Surroundings(np.empty(0, dtype=object))


def things(*shapes):
    return Surroundings(np.array(shapes, dtype=object))


def lots_of(*shapes):
    return np.array(shapes, dtype=object)


def some_lots(count=40, seed=1):
    rng = np.random.default_rng(seed)
    x, y = rng.uniform(0, 400, (2, count))
    wide, deep = rng.uniform(8, 150, (2, count))
    return shapely.box(x, y, x + wide, y + deep)


def same(one: LotWindows, other: LotWindows):
    for name in LotWindows.__dataclass_fields__:
        np.testing.assert_array_equal(getattr(one, name), getattr(other, name))


def test_a_lot_stands_in_the_middle_of_a_window_whose_areas_are_right():
    lot = shapely.Polygon([(1000, 2000), (1040, 2010), (1030, 2040), (1005, 2030)])
    house = shapely.box(1012, 2012, 1022, 2021)
    crown = shapely.Point(1035, 2030).buffer(6)
    windows = lot_windows(lots_of(lot), things(crown), things(house))
    assert windows.pixel_m.tolist() == [0.5]
    cell = 0.25 / 100
    assert windows.lot.sum() * cell == pytest.approx(lot.area, rel=2e-3)
    assert windows.coverage.sum() * cell == pytest.approx(crown.area, rel=5e-3)
    assert windows.ground.sum() * cell == pytest.approx(lot.area - house.area, rel=3e-3)
    assert windows.lot_area_m2[0] == pytest.approx(lot.area)
    assert windows.ground_area_m2[0] == pytest.approx(lot.area - house.area, rel=3e-3)


def test_row_0_is_in_the_north_and_column_0_in_the_west():
    lot = shapely.box(0, 0, 20, 20)
    windows = lot_windows(lots_of(lot), things(shapely.box(0, 15, 5, 20)), NOTHING)
    covered = np.argwhere(windows.coverage[0] == 100) - 44
    assert covered.min(axis=0).tolist() == [0, 0]
    assert covered.max(axis=0).tolist() == [9, 9]


def test_distances_are_those_to_the_edge_also_of_a_courtyard():
    lot = shapely.difference(shapely.box(0, 0, 60, 60), shapely.box(40, 40, 50, 50))
    windows = lot_windows(lots_of(lot), NOTHING, NOTHING)
    row, col = np.nonzero(windows.lot[0] == 100)
    place = shapely.points(-2 + (col + 0.5) * 0.5, 62 - (row + 0.5) * 0.5)
    true = np.minimum(shapely.distance(place, lot.boundary), EDGE_MAX_M)
    np.testing.assert_allclose(windows.edge_dm[0][row, col] / 10, true, atol=0.051)
    assert (windows.edge_dm[0][windows.lot[0] == 0] == 0).all()


@pytest.mark.parametrize(("side", "pixel", "count"), [(64, 0.5, 1), (64.1, 1.0, 1), (128, 1.0, 1), (128.1, 1.0, 4)])
def test_the_size_of_a_lot_decides_how_it_is_shown(side, pixel, count):
    places = window_places(lots_of(shapely.box(0, 0, side, side)))
    assert places.pixel_m.tolist() == [pixel] * count


def test_pieces_of_a_long_lot_hold_all_of_it_and_share_nothing():
    lot = shapely.Polygon([(0, 0), (300, 120), (310, 140), (20, 60)])
    windows = lot_windows(lots_of(None, lot, shapely.Polygon()), NOTHING, NOTHING)
    assert set(windows.owner) == {1}
    assert windows.lot.sum(dtype=int) / 100 == pytest.approx(lot.area, rel=0.02)
    assert windows.lot_area_m2 == pytest.approx(np.full(len(windows), lot.area))


def test_of_a_very_large_lot_a_choice_of_windows_is_shown():
    places = window_places(lots_of(shapely.box(0, 0, 3000, 2000)))
    assert len(places.owner) == 16
    assert np.ptp(places.x0) > 2000
    assert np.ptp(places.y_top) > 1500


def test_a_sliver_across_many_windows_gets_one_at_least():
    assert len(window_places(lots_of(shapely.box(0, 0, 1000, 0.5))).owner) >= 1


def test_windows_do_not_depend_on_batches_order_or_threads():
    lots = some_lots()
    plants = Surroundings(shapely.buffer(shapely.points(np.random.default_rng(2).uniform(0, 400, (80, 2))), 5))
    houses = Surroundings(shapely.box(*np.add.outer([0, 0, 12, 9], np.arange(0, 400, 37.0))))
    whole = lot_windows(lots, plants, houses)
    same(whole, lot_windows(lots, plants, houses, workers=3))
    part = lot_windows(lots[7:9], plants, houses)
    inside = (whole.owner >= 7) & (whole.owner < 9)
    np.testing.assert_array_equal(part.coverage, whole.coverage[inside])
    np.testing.assert_array_equal(part.ground_area_m2, whole.ground_area_m2[inside])


def test_overlapping_shapes_cover_once():
    box = shapely.box(0, 0, 10, 10)
    once = lot_windows(lots_of(box), things(box), NOTHING)
    twice = lot_windows(lots_of(box), things(box, box), NOTHING)
    same(once, twice)


def test_windows_may_be_taken_apart():
    places = WindowPlaces(np.arange(3), np.zeros(3), np.full(3, 64.0), np.full(3, 0.5))
    assert places.take(np.array([2, 0])).owner.tolist() == [2, 0]
    assert places.bounds[0].tolist() == [0, 0, 64, 64]
    windows = lot_windows(some_lots(5), NOTHING, NOTHING)
    assert len(windows.take(windows.pixel_m == 0.5)) == int((windows.pixel_m == 0.5).sum())
