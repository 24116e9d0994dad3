from __future__ import annotations

import json

import numpy as np
import pytest

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.baselines import fit_mean
from urbanforest_cli.regression.judging.predictions import Prediction, shares
from urbanforest_cli.regression.judging.results import VISIBLE, judge


def noisy(table, size, spreads=True, seed=0) -> Prediction:
    rng = np.random.default_rng(seed)
    said = np.clip(shares(table.values) + rng.normal(0, size, table.values.shape), 0, 1)
    return Prediction(said, np.full(said.shape, size) if spreads else None, np.eye(3)[table.strategy])


@pytest.fixture(scope="module")
def found(pairs):
    predictions = {"good": noisy(pairs, 0.1), "poor": noisy(pairs, 0.25, False, 1), "mean": fit_mean(pairs)(pairs)}
    return judge(pairs, predictions, seed=0)


def test_better_predictors_score_better_and_the_interval_of_their_difference_says_so(found):
    assert found.judged == "good"
    assert found.total["good"].mean_r2 > found.total["poor"].mean_r2 > found.total["mean"].mean_r2
    assert found.total["mean"].mean_r2 == pytest.approx(0, abs=1e-9)
    for one in found.differences:
        if one.parameter == "mean":
            assert one.low < one.r2 < one.high
            assert one.low > 0, one.against
            apart = found.total["good"].mean_r2 - found.total[one.against].mean_r2
            assert one.r2 == pytest.approx(apart)
    assert len(found.differences) == 2 * (len(REGRESSED) + 1)


def test_only_told_spreads_and_strategies_are_judged(found):
    assert set(found.calibration) == {"good", "mean"}
    assert found.calibration["mean"]["radius_mean_m"].worst < 0.05
    assert found.total["good"].strategy_accuracy == 1
    assert found.total["mean"].strategy_accuracy is None


def test_ranges_of_visible_plants_part_the_pairs(found, pairs):
    assert sum(found.pairs_by_visible.values()) == found.pairs == len(pairs)
    assert list(found.pairs_by_visible) == list(VISIBLE)
    assert found.pairs_by_visible["2-7"] == ((pairs.visible >= 2) & (pairs.visible <= 7)).sum()
    assert "64+" not in found.by_visible
    total = sum(one["good"].scores["density"].pairs for one in found.by_visible.values())
    assert total == found.total["good"].scores["density"].pairs


def test_few_lots_have_scores_but_no_intervals(pairs):
    few = pairs.take(np.arange(8))
    found = judge(few, {"good": noisy(few, 0.1)}, seed=0)
    assert found.total["good"].scores["radius_mean_m"].r2_low is None
    assert found.differences == []


def test_order_of_pairs_does_not_matter_and_a_record_is_plain_json(found, pairs):
    predictions = {"good": noisy(pairs, 0.1), "poor": noisy(pairs, 0.25, False, 1), "mean": fit_mean(pairs)(pairs)}
    order = np.random.default_rng(0).permutation(len(pairs))
    moved = judge(pairs.take(order), {name: one.take(order) for name, one in predictions.items()}, seed=0)
    for name in predictions:
        for parameter in REGRESSED:
            ours, theirs = (one.total[name].scores[parameter] for one in (found, moved))
            assert ours.r2_low == pytest.approx(theirs.r2_low)
            assert ours.within == pytest.approx(theirs.within)
    record = json.loads(json.dumps(found.as_record(), allow_nan=False))
    assert record["total"]["good"]["scores"]["density"]["r2"] > 0.5
