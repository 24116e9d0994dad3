"""Spreads that are too narrow or too wide are brought back to what was drawn."""

from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.regression.learning.sureness import interval_shares, sureness_factors


def drawn(count=4000, seed=0):
    rng = np.random.default_rng(seed)
    mean, weight = rng.uniform(0.1, 0.9, (count, 2)), rng.uniform(3, 60, (count, 2))
    return mean, weight, rng.beta(mean * weight, (1 - mean) * weight)


def test_intervals_of_the_true_distribution_hold_what_they_say():
    mean, weight, share = drawn()
    assert interval_shares(mean[:, 0], weight[:, 0], share[:, 0]) == pytest.approx([0.5, 0.68, 0.9, 0.95], abs=0.02)


@pytest.mark.parametrize("wrong", [0.3, 1.0, 3.0])
def test_the_factor_undoes_what_is_wrong(wrong):
    mean, weight, share = drawn()
    used = np.ones(mean.shape, bool)
    used[:, 1] = np.arange(len(used)) < 20
    factors = sureness_factors(mean, weight * wrong, share, used)
    assert factors[0] == pytest.approx(1.0 / wrong, rel=0.12)
    assert factors[1] == 1.0  # too few to tell
