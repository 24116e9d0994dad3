"""Spreads that are too narrow or too wide are brought back to what was drawn, for the sure and for the unsure."""

from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.regression.learning.sureness import interval_shares, scaled_weight, sureness


def drawn(count=4000, seed=0):
    rng = np.random.default_rng(seed)
    mean, weight = rng.uniform(0.1, 0.9, (count, 2)), np.exp(rng.uniform(np.log(3), np.log(60), (count, 2)))
    return mean, weight, rng.beta(mean * weight, (1 - mean) * weight)


def test_intervals_of_the_true_distribution_hold_what_they_say():
    mean, weight, share = drawn()
    assert interval_shares(mean[:, 0], weight[:, 0], share[:, 0]) == pytest.approx([0.5, 0.68, 0.9, 0.95], abs=0.02)


@pytest.mark.parametrize(("factor", "power"), [(0.4, 1.0), (1.0, 1.0), (2.5, 1.0), (1.0, 0.8), (1.5, 1.25)])
def test_what_is_wrong_is_undone_for_the_sure_and_for_the_unsure(factor, power):
    mean, weight, share = drawn()
    used = np.ones(mean.shape, bool)
    used[:, 1] = np.arange(len(used)) < 20
    told = 10.0 * (weight / (10.0 * factor)) ** (1.0 / power)  # what scaled by these two is right
    factors, powers = sureness(mean, told, share, used)
    assert scaled_weight(told[:, 0], factors[0], powers[0]) == pytest.approx(weight[:, 0], rel=0.25)
    assert (factors[1], powers[1]) == (1.0, 1.0)  # too few to tell


def test_few_pairs_are_all_scaled_alike():
    mean, weight, share = drawn(200)
    factors, powers = sureness(mean, 0.5 * weight, share, np.ones(mean.shape, bool))
    assert powers.tolist() == [1.0, 1.0]
    assert factors == pytest.approx([2.0, 2.0], rel=0.35)
