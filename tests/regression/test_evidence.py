from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.core.parameter_model import STRATEGIES_READ
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.evidence import (
    UNIFORM_SPREAD,
    Evidence,
    evidence_of,
    exponents,
    joined,
    precision,
    without_the_unknowable,
)

SIX = len(REGRESSED)
BAND, RADIUS, COUNT = (REGRESSED.index(n) for n in ("boundary_width_m", "cluster_radius_m", "cluster_count_max"))


def moments_of_beta(a, b):
    mean = a / (a + b)
    return mean, np.sqrt(mean * (1 - mean) / (a + b + 1))


def windows(mean=0.5, spread=0.1, strategy=(1, 0, 0), owner=(0,), visible=20.0):
    n = len(owner)
    return {
        "owner": np.array(owner),
        "mean": np.full((n, SIX), mean),
        "spread": np.full((n, SIX), spread),
        "strategy": np.tile(np.array(strategy, float), (n, 1)),
        "visible": np.full(n, visible),
    }


def test_the_exponents_of_a_binomial_count_are_its_successes_and_failures():
    successes, failures = np.array([0.0, 3.0, 10.0]), np.array([5.0, 2.0, 10.0])
    low, high = exponents(*moments_of_beta(successes + 1, failures + 1))
    np.testing.assert_allclose(low, successes, atol=1e-9)
    np.testing.assert_allclose(high, failures, atol=1e-9)


def test_the_training_prior_and_wider_ones_say_nothing():
    low, high = exponents(np.full(3, 0.5), np.array([UNIFORM_SPREAD, 0.35, 0.5]))
    assert (low == 0).all()
    assert (high == 0).all()


def test_exponents_are_never_negative_and_never_surer_than_the_least_spread():
    rng = np.random.default_rng(1)
    low, high = exponents(rng.uniform(0, 1, 5000), rng.uniform(0, 0.4, 5000))
    assert (low >= 0).all()
    assert (high >= 0).all()
    assert (low + high).max() <= 0.25 / 0.02**2
    assert (low + high).max() > 600


@pytest.mark.parametrize("spread", [0.06, 0.1, 0.25])
def test_a_value_close_to_the_end_of_its_range_keeps_its_distance_from_it(spread):
    low, high = exponents(np.array([0.05, 0.95]), np.array([spread, spread]))
    assert low[0] == high[1] == 0
    b = high[0] + 1
    assert low[1] == pytest.approx(high[0])
    assert 2 / ((1 + b) * (2 + b)) == pytest.approx(0.05**2 + spread**2)


def test_exponents_are_steady_in_mean_and_spread():
    mean, spread = np.meshgrid(np.linspace(0, 1, 401), np.linspace(0.05, 0.4, 401))
    for found in exponents(mean, spread):
        assert np.abs(np.diff(found, axis=0)).max() < 4
        assert np.abs(np.diff(found, axis=1)).max() < 4


def test_precision_is_what_evidence_adds_to_the_training_prior():
    mean, spread = np.array([0.5, 0.3, 0.7]), np.array([0.1, 0.05, 0.2])
    np.testing.assert_allclose(precision(*exponents(mean, spread)), 1 / spread**2 - 12)
    assert precision(np.zeros(1), np.zeros(1))[0] == pytest.approx(0)


def test_four_windows_of_a_lot_count_as_two_and_say_nothing_of_the_number_of_clusters():
    one = evidence_of(lots=2, **windows(strategy=(0, 0, 1)))
    four = evidence_of(lots=2, **windows(strategy=(0, 0, 1), owner=(0, 0, 0, 0)))
    rest = [column for column in range(SIX) if column not in (COUNT,)]
    np.testing.assert_allclose(four.low[0, rest], 2 * one.low[0, rest])
    assert four.low[0, COUNT] == four.high[0, COUNT] == 0
    assert one.low[0, COUNT] > 0
    assert (four.low[1] == 0).all()
    assert four.visible.tolist() == [80, 0]


def test_the_band_is_known_as_far_as_the_strategy_is():
    found = [evidence_of(lots=1, **windows(mean=0.8, strategy=(1 - p, p, 0))).low[0, BAND] for p in (0, 0.3, 0.7, 1)]
    assert found[0] == 0
    assert np.all(np.diff(found) > 0)
    assert found[3] == pytest.approx(evidence_of(lots=1, **windows(mean=0.8)).low[0, 0])


@pytest.mark.parametrize(
    ("visible", "density", "bare", "strategy", "silent"),
    [
        (0, 0.5, 0.9, (0, 1, 0), set(REGRESSED) - {"density"}),
        (20, 0.05, 0.9, (0, 1, 0), set(REGRESSED) - {"density"}),
        (1, 0.9, 0.01, (0, 1, 0), set(REGRESSED) - {"density"}),
        (5, 0.9, 0.01, (0, 1, 0), {"cluster_radius_m", "cluster_count_max"}),
        (20, 0.5, 0.9, (1, 0, 0), {"boundary_width_m", "cluster_radius_m", "cluster_count_max"}),
        (20, 0.5, 0.9, (0.1, 0.9, 0), {"cluster_radius_m", "cluster_count_max"}),
        (20, 0.5, 0.9, (0.1, 0, 0.9), {"boundary_width_m"}),
    ],
)
def test_what_cannot_be_known_is_not_said(visible, density, bare, strategy, silent):
    evidence = evidence_of(lots=1, **windows(mean=0.8, strategy=strategy, visible=visible))
    told = without_the_unknowable(
        evidence, seen=np.array([True]), density_read=np.array([density]), bare_share=np.array([bare])
    )
    assert {name for name, spoke in zip(REGRESSED, told.spoke[0], strict=True) if not spoke} == silent


def test_a_lot_that_the_map_does_not_know_says_nothing():
    evidence = evidence_of(lots=1, **windows(strategy=(0, 1, 0)))
    told = without_the_unknowable(
        evidence, seen=np.array([False]), density_read=np.array([1.0]), bare_share=np.array([1.0])
    )
    assert not told.spoke.any()
    assert told.strategy.tolist() == [[1 / len(STRATEGIES_READ)] * 3]
    assert told.visible.tolist() == [0]


def test_joined_keeps_order_and_joins_nothing_to_nothing():
    parts = [evidence_of(lots=1, **windows(visible=float(number))) for number in range(3)]
    assert joined(parts).visible.tolist() == [0, 1, 2]
    assert isinstance(joined([]), Evidence)
    assert joined([]).low.shape == (0, SIX)
