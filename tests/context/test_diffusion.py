from __future__ import annotations

import numpy as np
import pytest

from tests.reference.diffusion import diffuse_all_pairs, uses
from urbanforest_cli.context.diffusion import ANGLE_PERIOD_DEG, diffuse, group_bits, round_by_chance, uses_parameter
from urbanforest_cli.core.params import PARAMETERS, STRATEGIES
from urbanforest_cli.core.randomness import keys_for

COUNTS = [p.name for p in PARAMETERS.values() if p.kind == "count"]
POOL = (*STRATEGIES, "from_a_plug_in")


def city(n: int, *, side: float = 600.0, seed: int = 0, offset: float = 5e6):
    rng = np.random.default_rng(seed)
    centres = rng.uniform(0, side, (n, 2)) + np.array([offset / 10, offset])
    values = {p.name: rng.uniform(p.low, p.high, n) for p in PARAMETERS.values()}
    values["context_radius_m"] = rng.choice([0.0, 20.0, 77.0, 300.0], n)
    for name in COUNTS:
        values[name] = np.floor(values[name])
    lot_ids = np.array([f"lot {i}" for i in range(n)], dtype=object)
    strategies = np.array(POOL, dtype=object)[rng.integers(0, len(POOL), n)]
    return centres, values, lot_ids, strategies


def row_city(values: list[float], name: str, *, spacing: float = 10.0, reach: float = 60.0, strategy: str = "random"):
    n = len(values)
    centres = np.column_stack((np.arange(n) * spacing, np.zeros(n)))
    table = {p.name: np.full(n, p.default) for p in PARAMETERS.values()}
    table["context_radius_m"][:] = reach
    table[name] = np.array(values, dtype=float)
    return centres, table, np.arange(n).astype(str).astype(object), np.full(n, strategy, dtype=object)


def shared(given):
    centres, values, ids, strategies = given
    return diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1)


def angles_apart(a, b):
    half = ANGLE_PERIOD_DEG / 2
    return np.abs((np.asarray(a) - b + half) % ANGLE_PERIOD_DEG - half)


@pytest.mark.parametrize("passes", [1, 3])
@pytest.mark.parametrize("sigma_fraction", [1 / 3, 0.05, 2.0])
def test_kernel_agrees_with_all_pairs_twin(passes, sigma_fraction):
    centres, values, ids, strategies = city(120)
    found = diffuse(
        centres, values, lot_ids=ids, strategies=strategies, seed=1, passes=passes, sigma_fraction=sigma_fraction
    )
    truth, heard = diffuse_all_pairs(
        [tuple(c) for c in centres], {k: list(v) for k, v in values.items()}, list(strategies),
        passes=passes, sigma_fraction=sigma_fraction,
    )  # fmt: skip
    assert found.lot_count.tolist() == heard
    for name in PARAMETERS:
        if name in COUNTS:
            assert (np.abs(found.values[name] - truth[name]) < 1).all()
        elif PARAMETERS[name].kind == "angle":
            assert angles_apart(found.values[name], truth[name]).max() < 1e-10
        else:
            np.testing.assert_allclose(found.values[name], truth[name], rtol=1e-12, err_msg=name)


@pytest.mark.parametrize("scope_of", ["zone", "strategy"])
def test_lots_share_only_within_their_scope(scope_of):
    centres, values, ids, strategies = city(120)
    zones = np.array(["residential", "other", "street"], dtype=object)[np.arange(120) % 3]
    scopes = zones if scope_of == "zone" else strategies
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1, scopes=scopes)
    truth, heard = diffuse_all_pairs(
        [tuple(c) for c in centres], {k: list(v) for k, v in values.items()}, list(strategies),
        passes=1, sigma_fraction=1 / 3, scopes=list(scopes),
    )  # fmt: skip
    assert found.lot_count.tolist() == heard
    np.testing.assert_allclose(found.values["density"], truth["density"], rtol=1e-12)
    np.testing.assert_allclose(found.values["spacing_m"], truth["spacing_m"], rtol=1e-12)


def test_row_order_does_not_change_a_single_bit():
    centres, values, ids, strategies = city(300)
    centres[100:110] = centres[0]
    shuffled = np.random.default_rng(5).permutation(300)
    one = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1, passes=2)
    two = diffuse(
        centres[shuffled], {k: v[shuffled] for k, v in values.items()}, lot_ids=ids[shuffled],
        strategies=strategies[shuffled], seed=1, passes=2,
    )  # fmt: skip
    for name in PARAMETERS:
        assert (one.values[name][shuffled] == two.values[name]).all(), name


def test_lots_out_of_reach_do_not_change_a_single_bit():
    centres, values, ids, strategies = city(300)
    far = centres[:, 0] > centres[:, 0].min() + 310
    near = centres[:, 0] <= centres[:, 0].min() + 9
    assert near.any()
    other = {k: np.where(far, np.random.default_rng(8).permutation(v), v) for k, v in values.items()}
    one = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1)
    two = diffuse(centres, other, lot_ids=ids, strategies=strategies, seed=1)
    gone = diffuse(
        centres[~far], {k: v[~far] for k, v in values.items()}, lot_ids=ids[~far], strategies=strategies[~far], seed=1
    )
    for name in PARAMETERS:
        assert (one.values[name][near] == two.values[name][near]).all(), name
        assert (one.values[name][near] == gone.values[name][near[~far]]).all(), name


def test_constant_city_stays_to_the_last_bit_and_so_does_a_constant_context():
    centres, values, ids, strategies = city(200)
    for name in values:
        if name != "context_radius_m":
            values[name][:] = 0.3 if name not in COUNTS else 3
    values["density"][centres[:, 0] > centres[:, 0].min() + 400] = 0.9
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1, passes=1)
    for name in values:
        if name not in {"context_radius_m", "density"}:
            assert (found.values[name] == values[name]).all(), name
    inside = centres[:, 0] <= centres[:, 0].min() + 99
    assert (found.values["density"][inside] == 0.3).all()
    assert (found.values["density"] != values["density"]).any()


def test_isolated_lot_zero_radius_and_lot_without_place_keep_their_values_to_the_last_bit():
    centres, values, ids, strategies = city(60)
    centres[0] += 1e4
    centres[1] = np.nan
    values["context_radius_m"][0] = 300.0
    values["cluster_count_max"][0] = 2.5
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1, passes=2)
    kept = values["context_radius_m"] == 0
    kept[:2] = True
    for name in PARAMETERS:
        assert (found.values[name][kept] == values[name][kept]).all(), name
    assert (found.lot_count[kept] == 1).all()


def test_own_value_weighs_one_and_a_neighbour_by_the_gaussian_of_a_third_of_the_radius():
    found = shared(row_city([1.0, 0.0], "density", spacing=20.0, reach=60.0))
    w = np.exp(-0.5)
    np.testing.assert_allclose(found.values["density"], [1 / (1 + w), w / (1 + w)], rtol=1e-14)


def test_reach_is_the_receiving_lots_and_includes_its_edge():
    centres, values, ids, strategies = row_city([1.0, 0.0], "density", spacing=60.0)
    values["context_radius_m"] = np.array([60.0, 59.9])
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1)
    assert found.lot_count.tolist() == [2, 1]
    assert found.values["density"][0] < 1
    assert found.values["density"][1] == 0


def test_second_pass_reaches_as_far_as_the_given_radius_though_the_radius_itself_is_shared():
    centres, values, ids, strategies = row_city([1.0, 0.0, 0.0], "density", spacing=50.0)
    values["context_radius_m"] = np.array([60.0, 60.0, 0.0])
    once = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1)
    twice = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1, passes=2)
    assert once.values["context_radius_m"][0] == 60
    assert once.values["context_radius_m"][1] < 60
    assert twice.lot_count.tolist() == once.lot_count.tolist() == [2, 3, 1]


def test_mean_goes_over_lots_that_use_the_parameter_and_others_keep_theirs():
    centres, values, ids, strategies = row_city([2.0, 100.0, 4.0], "boundary_width_m", strategy="boundary")
    strategies[1] = "random"
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1).values["boundary_width_m"]
    assert found[1] == 100
    assert 2 < found[0] < 3 < found[2] < 4


def test_a_plug_ins_strategy_uses_every_parameter():
    strategies = np.array([*STRATEGIES, "plug_in"], dtype=object)
    for name in PARAMETERS:
        expected = [uses(strategy, name) for strategy in strategies]
        assert uses_parameter(group_bits(strategies), name).tolist() == expected


def test_orientations_are_averaged_with_a_period_of_ninety_degrees():
    def mean(degrees, reach=1e4):
        given = row_city(degrees, "grid_orientation_deg", reach=reach, strategy="regular")
        return shared(given).values["grid_orientation_deg"]

    assert angles_apart(mean([10.0, 100.0, 190.0]), 10).max() < 1e-9
    assert angles_apart(mean([2.0, 88.0]), 0).max() < 1e-3
    np.testing.assert_allclose(mean([20.0, 40.0]), 30, atol=1e-3)
    assert ((mean([0.0, 89.0, 179.0, 360.0]) >= 0) & (mean([0.0, 89.0, 179.0, 360.0]) <= 360)).all()


def test_orientations_that_cancel_leave_each_lot_its_own():
    centres, values, ids, strategies = row_city([0.0, 45.0], "grid_orientation_deg", spacing=0.0, strategy="regular")
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1)
    assert found.values["grid_orientation_deg"].tolist() == [0.0, 45.0]


def test_counts_are_whole_and_keep_their_expected_value():
    n = 4000
    counts = np.tile([1.0, 4.0], n // 2)
    centres, values, ids, strategies = row_city(list(counts), "species_count", spacing=1.0, reach=1e5)
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=3).values["species_count"]
    assert set(found) == {2.0, 3.0}
    assert abs(found.mean() - 2.5) < 4 * 0.5 / np.sqrt(n)
    keys = keys_for(1, "diffuse", ["a", "b", "c"])
    assert round_by_chance(np.array([1.0, 2.0, 3.0]), keys, 0).tolist() == [1, 2, 3]


def test_rounding_depends_on_seed_and_lot_only():
    centres, values, ids, strategies = city(200)
    one, two, other = (diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=s) for s in (1, 1, 2))
    assert (one.values["species_count"] == two.values["species_count"]).all()
    assert (one.values["species_count"] != other.values["species_count"]).any()
    assert (one.values["density"] == other.values["density"]).all()


def test_values_stay_between_the_least_and_the_largest_given():
    centres, values, ids, strategies = city(300, side=200)
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1, passes=5)
    for name in PARAMETERS:
        if PARAMETERS[name].kind != "angle":
            assert found.values[name].min() >= values[name].min()
            assert found.values[name].max() <= values[name].max()


def test_many_passes_smooth_toward_one_value():
    centres, values, ids, strategies = city(100, side=200)
    values["context_radius_m"][:] = 300.0
    spread = [
        np.ptp(diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1, passes=k).values["density"])
        for k in (0, 1, 5, 40)
    ]
    assert spread[0] > spread[1] > spread[2] > spread[3]
    assert spread[3] < 1e-4


def test_a_stray_lot_at_the_end_of_the_world_costs_nothing():
    centres, values, ids, strategies = city(50)
    centres[7] = (-9e7, 9e7)
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1)
    assert found.lot_count[7] == 1


def test_no_passes_and_no_lots_give_back_what_came():
    centres, values, ids, strategies = city(20)
    found = diffuse(centres, values, lot_ids=ids, strategies=strategies, seed=1, passes=0)
    assert all((found.values[name] == values[name]).all() for name in PARAMETERS)
    none = diffuse(
        centres[:0], {k: v[:0] for k, v in values.items()}, lot_ids=ids[:0], strategies=strategies[:0], seed=1
    )
    assert len(none.lot_count) == 0
