from __future__ import annotations

import numpy as np

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.evidence import UNIFORM_SPREAD
from urbanforest_cli.regression.shares import Ranges

RANGES = Ranges((1, 0.1, 0, 0, 1, 0), (10, 2, 1, 5, 20, 5))
COUNT = REGRESSED.index("cluster_count_max")


def test_values_come_back_and_stay_within_the_range():
    rng = np.random.default_rng(1)
    values = np.array([1, 0.1, 0, 0, 1, 0]) + rng.uniform(0, 1, (50, 6)) * np.array([9, 1.9, 1, 5, 19, 5])
    np.testing.assert_allclose(RANGES.values(RANGES.shares(values)), values)
    assert RANGES.values(np.full((1, 6), 2.0)).tolist() == [[10, 2, 1, 5, 20, 5]]
    spreads = rng.uniform(0, 1, (50, 6))
    np.testing.assert_allclose(RANGES.value_spreads(RANGES.share_spreads(spreads)), spreads)


def test_equally_likely_counts_are_the_uniform_distribution():
    counts = np.arange(6.0)
    rows = np.zeros((6, 6))
    rows[:, COUNT] = counts
    spread = np.full((1, 6), counts.std())
    assert np.isclose(RANGES.shares(rows)[:, COUNT].mean(), 0.5)
    assert np.isclose(RANGES.share_spreads(spread)[0, COUNT], UNIFORM_SPREAD)
