from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.designs import DENSITY_LEAST
from urbanforest_cli.regression.judging.calibration import BINS, LEVELS, beta_of, calibrations, central_interval
from urbanforest_cli.regression.judging.predictions import LOW, PRIOR_MEANS, PRIOR_SPREADS, RANGE, Prediction

COUNT = REGRESSED.index("cluster_count_max")
DENSITY = REGRESSED.index("density")
PAIRS = 6000


def posterior(seed: int = 0):
    """Draw truths uniformly, count successes of each in twelve tries: the posterior is a beta distribution."""
    rng = np.random.default_rng(seed)
    truth = rng.random((PAIRS, 6))
    truth[:, COUNT] = rng.integers(0, 6, PAIRS) / 5
    hits = rng.binomial(12, truth)
    first, second = 1 + hits, 13 - hits
    mean = first / (first + second)
    spread = np.sqrt(mean * (1 - mean) / (first + second + 1))
    whole = np.arange(6) / 5
    likely = stats.binom.pmf(hits[:, COUNT, None], 12, whole)
    likely /= likely.sum(axis=1, keepdims=True)
    mean[:, COUNT] = likely @ whole
    mean[:, DENSITY] = DENSITY_LEAST + (1 - DENSITY_LEAST) * mean[:, DENSITY]
    truth[:, DENSITY] = DENSITY_LEAST + (1 - DENSITY_LEAST) * truth[:, DENSITY]
    spread[:, DENSITY] *= 1 - DENSITY_LEAST
    spread[:, COUNT] = np.sqrt(likely @ whole**2 - mean[:, COUNT] ** 2)
    return Prediction(mean, spread), truth


def judged(prediction, truth):
    return calibrations(prediction, truth, np.ones(truth.shape, bool), np.random.default_rng(1))


def test_right_posteriors_are_found_calibrated_whole_numbers_too():
    for name, found in judged(*posterior()).items():
        assert found.worst < (0.03 if name == REGRESSED[COUNT] else 0.02), name
        assert found.ranks == pytest.approx([1 / BINS] * BINS, abs=0.03 if name == REGRESSED[COUNT] else 0.015), name
        assert found.told == pytest.approx(found.found, rel=0.1), name


def test_knowing_nothing_and_saying_so_is_calibrated():
    truth = posterior()[1]
    prediction = Prediction(np.tile(PRIOR_MEANS, (len(truth), 1)), np.tile(PRIOR_SPREADS, (len(truth), 1)))
    assert PRIOR_SPREADS[COUNT] == pytest.approx(np.sqrt(35 / 12) / 5)  # of whole numbers from 0 to 5
    for found in judged(prediction, truth).values():
        assert found.worst < 0.02
        assert found.ranks == pytest.approx([1 / BINS] * BINS, abs=0.015)


def test_too_sure_too_unsure_and_biased_predictions_are_found_out():
    prediction, truth = posterior()
    too_sure = judged(Prediction(prediction.values, prediction.spreads / 2), truth)["density"]
    assert too_sure.covered[LEVELS.index(0.68)] < 0.5
    assert too_sure.ranks[0] + too_sure.ranks[-1] > 0.35
    unsure = judged(Prediction(prediction.values, np.minimum(prediction.spreads * 1.7, 0.28)), truth)["density"]
    assert unsure.covered[LEVELS.index(0.5)] > 0.6
    biased = judged(Prediction(np.clip(prediction.values + 0.1, 0, 1), prediction.spreads), truth)["density"]
    assert biased.ranks[0] > 2 * biased.ranks[-1]


def test_intervals_drawn_are_those_judged():
    prediction, truth = posterior()
    low, high = central_interval(prediction, 0.68)
    values = LOW + truth * RANGE
    for name, held in zip(REGRESSED, ((values >= low) & (values <= high)).mean(axis=0), strict=True):
        if name != REGRESSED[COUNT]:  # ends of whole numbers fall between them
            assert held == pytest.approx(judged(prediction, truth)[name].covered[LEVELS.index(0.68)])


def test_pairs_that_do_not_use_a_parameter_are_left_out():
    prediction, truth = posterior()
    counted = np.zeros(truth.shape, bool)
    counted[:100, 0] = True
    found = calibrations(prediction, truth, counted, np.random.default_rng(0))
    assert list(found) == [REGRESSED[0]]
    assert found[REGRESSED[0]].pairs == 100


def test_beta_has_the_moments_asked_for_and_takes_impossible_ones():
    first, second = beta_of(np.array([0.2, 0.5]), np.array([0.01, 1 / 12]))
    assert stats.beta.mean(first, second) == pytest.approx([0.2, 0.5])
    assert stats.beta.var(first, second) == pytest.approx([0.01, 1 / 12])
    assert (first[1], second[1]) == pytest.approx((1, 1))
    first, second = beta_of(np.array([0.0, 1.2, 0.5]), np.array([0.5, 0.0, 9.0]))
    assert (np.minimum(first, second) > 0).all()
    assert np.isfinite(first + second).all()
