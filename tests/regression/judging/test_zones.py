from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.predictions import (
    DRAWN_LOW,
    EVEN,
    LOW,
    PRIOR_MEANS,
    PRIOR_SPREADS,
    RANGE,
    USES,
    Prediction,
)
from urbanforest_cli.regression.judging.zones import SIZES, drawn_zones, pooled, zone_poolings


def posterior_of(truth, rng, tries=6):
    hits = rng.binomial(tries, truth)
    first, second = 1 + hits, 1 + tries - hits
    mean = first / (first + second)
    spread = np.sqrt(mean * (1 - mean) / (first + second + 1))
    return Prediction((EVEN.values(mean) - LOW) / RANGE, EVEN.value_spreads(spread) / RANGE)


def test_more_lots_tell_more_and_pooled_intervals_still_hold():
    rng = np.random.default_rng(0)
    values, strategies = drawn_zones(1500, rng)
    truth = (values.astype(float) - LOW) / RANGE
    said = posterior_of(EVEN.shares(values), rng)
    averaged = Prediction(said.values)
    found = zone_poolings({"sure": said, "plain": averaged}, truth, USES[strategies], rng)
    assert [one.lots for one in found["sure"]] == list(SIZES)
    r2 = [one.mean_r2 for one in found["sure"]]
    assert np.all(np.diff(r2) > 0.03)
    assert r2[-1] == pytest.approx(1 - (1 / 6 / 50) / (1 / 12), abs=0.02)  # of a posterior of 48 tries
    assert r2[-1] > found["plain"][-1].mean_r2
    assert found["plain"][-1].covered_68 is None
    assert found["sure"][-1].covered_68["density"] == pytest.approx(0.68, abs=0.04)


def test_pooling_one_lot_changes_nothing_and_pooling_the_prior_stays_the_prior():
    said = posterior_of(0.1 + 0.8 * np.random.default_rng(1).random((50, 1, 6)), np.random.default_rng(2))
    mean, spread = pooled(said.values, said.spreads)
    assert mean == pytest.approx(said.values[:, 0])
    assert spread == pytest.approx(said.spreads[:, 0])
    mean, spread = pooled(np.tile(PRIOR_MEANS, (3, 8, 1)), np.tile(PRIOR_SPREADS, (3, 8, 1)))
    assert mean == pytest.approx(np.tile(PRIOR_MEANS, (3, 1)))
    assert spread == pytest.approx(np.tile(PRIOR_SPREADS, (3, 1)))


def test_lots_of_a_zone_share_values_in_range_and_counts_are_whole():
    values, strategies = drawn_zones(200, np.random.default_rng(0))
    by_zone = values.reshape(200, SIZES[-1], 6)
    assert (np.ptp(by_zone, axis=1) == 0).all()
    assert (values >= DRAWN_LOW - 1e-6).all()
    assert (values <= LOW + RANGE).all()
    counts = values[:, REGRESSED.index("cluster_count_max")]
    assert set(counts.tolist()) == {0, 1, 2, 3, 4, 5}
    assert set(strategies.tolist()) == {0, 1, 2}
