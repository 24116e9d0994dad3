import math

import numpy as np
import pytest

from urbanforest_cli.core.tiles import from_z_order, z_order
from urbanforest_cli.export.scene.tiling import (
    FINEST_WITHIN_M,
    PIXELS_OF_A_METRE_AT_ONE_METRE,
    TOLERANCE_PX,
    plan_tiles,
)

DETAILS = ("point", "billboard", "low", "medium")


def ids(count):
    return np.array([f"L{n:06d}-1" for n in range(count)], dtype=object)


def scattered(count, side_m, seed=3):
    rng = np.random.default_rng(seed)
    return np.column_stack([rng.uniform(-side_m / 2, side_m / 2, (count, 2)), np.zeros(count)])


@pytest.fixture(scope="module")
def city():
    xyz = scattered(8000, 1500.0)
    return xyz, plan_tiles(xyz, ids(len(xyz)), details=DETAILS, reach_m=7.0, shown_max=500)


def side_m(plan, level):
    return 2 * plan.half_m / 2**level


def error_m(plan, level):
    return plan.root_error_m / 2**level


def slow_z_order(x, y):
    return sum((x >> bit & 1) << 2 * bit | (y >> bit & 1) << (2 * bit + 1) for bit in range(31))


def test_z_order_weaves_bits_and_comes_back():
    rng = np.random.default_rng(1)
    x, y = rng.integers(0, 1 << 31, (2, 200))
    code = z_order(x, y)
    assert code.tolist() == [slow_z_order(int(a), int(b)) for a, b in zip(x, y, strict=True)]
    assert [part.tolist() for part in from_z_order(code)] == [x.tolist(), y.tolist()]


def test_leaves_hold_every_plant_once_at_the_finest_detail(city):
    xyz, plan = city
    held = np.concatenate([plan.rows(tile) for tile in np.flatnonzero(plan.is_leaf)])
    assert sorted(held.tolist()) == list(range(len(xyz)))
    assert set(plan.detail[plan.is_leaf].tolist()) == {len(DETAILS) - 1}
    assert (plan.size_factor[plan.is_leaf] == 1.0).all()


def test_plants_stand_in_the_squares_of_their_tiles(city):
    xyz, plan = city
    for tile in range(len(plan)):
        side = side_m(plan, plan.level[tile])
        west = plan.centre_m[0] - plan.half_m + side * plan.x[tile]
        south = plan.centre_m[1] - plan.half_m + side * plan.y[tile]
        place = xyz[plan.rows(tile), :2] - [west, south]
        assert (place >= -1e-9).all()
        assert (place <= side + 1e-9).all()


def test_a_tile_has_a_parent_that_is_coarser_and_what_it_holds_is_in_its_children(city):
    _, plan = city
    places = np.column_stack([plan.level, plan.x, plan.y]).tolist()
    held = {(level, x, y): set(plan.rows(tile).tolist()) for tile, (level, x, y) in enumerate(places)}
    number = {place: t for t, place in enumerate(held)}
    for (level, x, y), rows in held.items():
        tile = number[level, x, y]
        if level:
            above = number[level - 1, x // 2, y // 2]
            assert not plan.is_leaf[above]
            assert plan.detail[above] <= plan.detail[tile]
            assert plan.detail[above] < plan.detail[tile] or plan.detail[tile] == 0
        if not plan.is_leaf[tile]:
            below = [held.get((level + 1, 2 * x + i, 2 * y + j), set()) for i in (0, 1) for j in (0, 1)]
            assert rows <= set().union(*below)


def test_a_full_tile_shows_a_share_that_covers_as_much_ground(city):
    xyz, plan = city
    assert len(plan.rows(0)) == 500
    assert plan.size_factor[0] == pytest.approx(math.sqrt(len(xyz) / 500))
    first = plan.level == 1
    shown = np.diff(plan.first)[first]
    whole = [np.count_nonzero((np.sign(xyz[:, 0] - plan.centre_m[0]) > 0) * 1 == x) for x in (0, 1)]
    assert shown.tolist() == [500] * 4
    assert (shown * plan.size_factor[first] ** 2).sum() == pytest.approx(sum(whole))


def test_the_share_is_spread_over_the_square_and_is_the_same_in_any_order(city):
    xyz, plan = city
    shown = xyz[plan.rows(0), :2]
    quarter = [np.count_nonzero((shown[:, 0] > 0) == east) for east in (False, True)]
    assert min(quarter) > 200  # of 500: a fair draw is below this once in 10^5
    turned = np.random.default_rng(8).permutation(len(xyz))
    again = plan_tiles(xyz[turned], ids(len(xyz))[turned], details=DETAILS, reach_m=7.0, shown_max=500)
    assert sorted(turned[again.rows(0)].tolist()) == plan.rows(0).tolist()


def test_a_plant_keeps_its_rank_when_longer_names_join():
    xyz = scattered(400, 300.0)
    names = ids(400)
    few = plan_tiles(xyz, names, details=DETAILS, reach_m=1.0, shown_max=100).rows(0)
    names[few[0]] = names[few[0]] + "-a-much-longer-name"
    with_long = plan_tiles(xyz, names, details=DETAILS, reach_m=1.0, shown_max=100).rows(0)
    assert len(set(few.tolist()) & set(with_long.tolist())) >= 99


def test_finest_detail_serves_to_150_m_then_each_next_to_twice_that(city):
    _, plan = city
    for steps, detail in enumerate(("medium", "low", "billboard", "point")):
        level = plan.levels - 1 - steps
        seen_from = error_m(plan, level - 1) * PIXELS_OF_A_METRE_AT_ONE_METRE / TOLERANCE_PX
        assert seen_from == pytest.approx(FINEST_WITHIN_M * 2**steps)
        assert DETAILS[plan.detail[plan.level == level].min()] == detail


def test_the_pixels_of_a_metre_are_those_of_the_default_view_of_cesiumjs():
    upward_rad = 2 * math.atan(math.tan(math.radians(60) / 2) * 1080 / 1920)
    assert math.degrees(upward_rad) == pytest.approx(36.0, abs=0.1)
    assert pytest.approx(1080 / (2 * math.tan(upward_rad / 2))) == PIXELS_OF_A_METRE_AT_ONE_METRE


def test_crowns_at_the_edge_and_enlarged_ones_lie_within_the_root(city):
    xyz, plan = city
    reach = 7.0 * plan.size_factor[0]
    assert (np.abs(xyz[:, :2] - plan.centre_m) + reach <= plan.half_m * (1 + 1e-9)).all()


def test_no_plant_makes_no_tile():
    plan = plan_tiles(np.zeros((0, 3)), ids(0), details=DETAILS, reach_m=0.0)
    assert len(plan) == 0
    assert plan.row.tolist() == []


def test_one_plant_is_coarse_from_afar_and_fine_from_near():
    plan = plan_tiles(np.array([[5.0, 6.0, 0.0]]), ids(1), details=DETAILS, reach_m=3.0)
    assert plan.is_leaf.tolist() == [False, False, True]
    assert [DETAILS[number] for number in plan.detail] == ["point", "billboard", "medium"]
    assert plan.row.tolist() == [0, 0, 0]


def test_plants_all_at_one_place_share_one_leaf():
    plan = plan_tiles(np.zeros((3000, 3)), ids(3000), details=DETAILS, reach_m=3.0, shown_max=100)
    assert np.count_nonzero(plan.is_leaf) == 1
    assert np.diff(plan.first).tolist() == [100, 100, 100, 3000]


def test_a_sparse_forest_has_larger_leaves_but_the_same_distances():
    plan = plan_tiles(scattered(2000, 3000.0), ids(2000), details=DETAILS, reach_m=3.0)
    assert side_m(plan, plan.levels - 1) > 300
    assert max(np.diff(plan.first)[plan.is_leaf]) <= 64
    seen_from = error_m(plan, plan.levels - 2) * PIXELS_OF_A_METRE_AT_ONE_METRE / TOLERANCE_PX
    assert seen_from == pytest.approx(FINEST_WITHIN_M)


def test_one_detail_alone_is_enough():
    plan = plan_tiles(scattered(50, 100.0), ids(50), details=("low",), reach_m=3.0)
    assert plan.is_leaf.tolist() == [True]
    assert plan.root_error_m > 0


def test_a_few_plants_spare_their_square_the_last_halving():
    away = np.array([400.0, 400.0, 0.0])
    xyz = np.concatenate([scattered(300, 100.0) + away, scattered(10, 100.0) - away])
    plan = plan_tiles(xyz, ids(310), details=DETAILS, reach_m=1.0, plants_per_tile=64)
    deepest = plan.level[plan.is_leaf]
    assert set(deepest.tolist()) == {plan.levels - 2, plan.levels - 1}
    assert all(np.diff(plan.first)[(plan.level == plan.levels - 2) & plan.is_leaf] <= 64)
