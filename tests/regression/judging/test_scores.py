from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.regression.judging.scores import error_sums, interval, r_squared, resampled, score


def sums(predicted, truth, counted=None, lot=None):
    predicted, truth = (np.asarray(values, float)[:, None] for values in (predicted, truth))
    counted = np.ones(predicted.shape, bool) if counted is None else np.asarray(counted)[:, None]
    return error_sums(predicted, truth, counted, np.zeros(len(truth), int) if lot is None else np.asarray(lot))


def test_scores_of_four_pairs_are_those_worked_out_by_hand():
    added = sums([0.1, 0.3, 0.5, 0.9], [0.0, 0.2, 0.8, 1.0])[0, 0]
    found = score(added)
    assert found.one_less_nmae == pytest.approx(1 - (0.1 + 0.1 + 0.3 + 0.1) / 4)
    assert found.bias == pytest.approx((0.1 + 0.1 - 0.3 - 0.1) / 4)
    assert found.within == 0.75  # exactly a tenth of the range off counts as met
    assert r_squared(added) == pytest.approx(1 - (0.01 + 0.01 + 0.09 + 0.01) / (0.25 + 0.09 + 0.09 + 0.25))
    assert found.r2 is None  # of so few pairs
    assert score(5 * added).r2 == pytest.approx(float(r_squared(added)))


def test_the_mean_scores_zero_a_worse_constant_less_and_the_truth_one():
    truth = np.random.default_rng(0).random(500)
    assert score(sums(np.full(500, truth.mean()), truth)[0, 0]).r2 == pytest.approx(0)
    assert score(sums(np.full(500, 0.9), truth)[0, 0]).r2 < -0.5
    assert score(sums(truth, truth)[0, 0]).r2 == 1


def test_pairs_that_do_not_use_a_parameter_count_nowhere():
    with_others = sums([0.1, 0.9, 0.0], [0.0, 1.0, 1.0], [True, True, False])
    assert score(with_others[0, 0]) == score(sums([0.1, 0.9], [0.0, 1.0])[0, 0])


def test_constant_truth_and_no_pairs_have_no_r2():
    assert score(sums([0.1, 0.2] * 20, [0.5, 0.5] * 20)[0, 0]).r2 is None
    none = score(sums([0.1], [0.5], [False])[0, 0])
    assert (none.pairs, none.r2, none.one_less_nmae) == (0, None, None)


def test_lots_are_drawn_whole():
    rng = np.random.default_rng(3)
    truth = rng.random(400)
    said = truth + rng.normal(0, 0.2, 400)
    apart = r_squared(resampled(sums(said, truth, lot=np.arange(400)), np.random.default_rng(0)))[:, 0]
    ten_times = sums(np.repeat(said[:40], 10), np.repeat(truth[:40], 10), lot=np.repeat(np.arange(40), 10))
    together = r_squared(resampled(ten_times, np.random.default_rng(0)))[:, 0]
    assert together.std() > 2 * apart.std()
    low, high = interval(apart)
    assert low < score(sums(said, truth)[0, 0]).r2 < high


def test_no_interval_where_a_draw_has_no_score():
    assert interval(np.array([0.1, np.nan, 0.2])) is None
