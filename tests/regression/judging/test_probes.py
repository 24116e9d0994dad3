from __future__ import annotations

import numpy as np
import pytest

from tests.regression.judging.made_pairs import disc_pairs
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.baselines import fit_closed_form
from urbanforest_cli.regression.judging.predictions import Prediction, shares
from urbanforest_cli.regression.judging.probes import responses, shuffle_scores, shuffled, turned, turning

RADIUS = REGRESSED.index("radius_mean_m")


def by_features(table) -> Prediction:
    return Prediction(np.clip(table.features[:, :6].astype(float), 0, 1))


def leaking(table) -> Prediction:
    """Read the radius off the lot, as a wrong design would."""
    said = np.full((len(table), 6), 0.5)
    said[:, RADIUS] = table.windows[:, 2].max(axis=(1, 2)) / 120
    return Prediction(said)


def test_swapped_coverage_leaves_no_skill_but_a_leak_shows(pairs):
    table = disc_pairs(900, seed=3)
    table.windows[:, 2] = np.minimum(table.windows[:, 2], (shares(table.values)[:, RADIUS] * 120)[:, None, None])
    swapped = shuffled(table, (), np.random.default_rng(0))
    honest = shuffle_scores(fit_closed_form(pairs)(swapped), swapped)
    assert abs(honest["radius_mean_m"].correlation) < 0.12
    assert honest["radius_mean_m"].r2 < 0
    assert shuffle_scores(by_features(swapped), swapped)["radius_mean_m"].correlation < 0.12
    assert shuffle_scores(leaking(swapped), swapped)["radius_mean_m"].correlation > 0.9


def test_swapping_moves_coverage_and_its_features_together_within_a_scale_and_keeps_the_lot():
    table = disc_pairs(200, seed=3)
    table.pixel_m[::3] = 2
    table.windows[:, 1, 0, 0] = table.windows[:, 0, 0, 0] = np.arange(200) % 100
    swapped = shuffled(table, (6, 2), np.random.default_rng(0))
    assert (swapped.values == table.values).all()
    assert (swapped.windows[:, 1:] == table.windows[:, 1:]).all()
    assert (swapped.features[:, [6, 2]] == table.features[:, [6, 2]]).all()
    source = [int(np.flatnonzero(table.features[:, 0] == value)[0]) for value in swapped.features[:, 0]]
    assert sorted(source) == list(range(200))
    assert sum(place == number for number, place in enumerate(source)) < 10
    assert (swapped.windows[:, 0] == table.windows[source, 0]).all()
    assert (table.pixel_m[source] == table.pixel_m).all()


def test_the_eight_ways_to_lie_are_eight_and_do_not_move_what_has_no_direction(pairs):
    odd = pairs.take(np.arange(4))
    odd.windows[:, 0, 3, 11] = 77
    ways = {turned(odd, way).windows.tobytes() for way in range(8)}
    assert len(ways) == 8
    assert turning(fit_closed_form(pairs), pairs.take(np.arange(40)))["radius_mean_m"].most < 1e-6

    def upper_half(table):
        return Prediction(np.tile(table.windows[:, 0, :32].mean(axis=(1, 2))[:, None] / 100, 6))

    assert turning(upper_half, pairs)["radius_mean_m"].most > 0.02


def test_a_predictor_that_follows_rises_in_full_and_one_that_does_not_stays_flat():
    def make(values, strategies):
        return disc_pairs(len(values), 9, values, strategies)

    followed = responses(by_features, make, 60, np.random.default_rng(0))
    assert followed["radius_mean_m"].slope == pytest.approx(1, abs=0.02)
    assert followed["radius_mean_m"].rising == 1
    assert list(followed["density"].predicted) == sorted(followed["density"].predicted)
    flat = responses(lambda table: Prediction(np.full((len(table), 6), 0.5)), make, 60, np.random.default_rng(0))
    assert (flat["density"].slope, flat["density"].rising) == (0, 0)


def test_only_the_parameter_raised_differs_between_steps_and_its_strategy_uses_it():
    asked = []

    def make(values, strategies):
        asked.append((values.copy(), strategies))
        return disc_pairs(len(values), 9, values, strategies)

    responses(by_features, make, 30, np.random.default_rng(0))
    assert len(asked) == 5 * len(REGRESSED)
    for number in range(len(REGRESSED)):
        runs = asked[5 * number : 5 * number + 5]
        assert all((runs[0][1] == strategy).all() for _, strategy in runs)
        moved = np.ptp(np.stack([values for values, _ in runs]), axis=0).max(axis=0) > 0
        assert np.flatnonzero(moved).tolist() == [number]
    assert set(asked[5 * REGRESSED.index("boundary_width_m")][1]) == {1}
    assert set(asked[5 * REGRESSED.index("cluster_count_max")][1]) == {2}
