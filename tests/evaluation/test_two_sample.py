from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.evaluation.two_sample import RIDGE_SHARE, classifier_test, flip_test, wilson_interval


def test_flips_reject_at_their_level_when_nothing_differs():
    rng = np.random.default_rng(0)
    p = []
    for _ in range(300):
        scale = rng.exponential(1, (25, 1))
        differences = scale * rng.standard_normal((25, 1)) + 0.2 * scale * rng.standard_normal((25, 4))
        p.append(flip_test(differences, np.ones(25), rng, permutations=99).p)
    assert 0.02 < np.mean(np.array(p) <= 0.05) < 0.085
    assert 0.45 < np.mean(p) < 0.57


def test_flips_find_a_shift_in_one_measure_of_many():
    rng = np.random.default_rng(0)
    differences = rng.standard_normal((40, 20))
    differences[:, 7] += 1.0
    found = flip_test(differences, np.ones(40), rng)
    assert found.p == pytest.approx(1 / 1000)
    assert found.difference[7] == pytest.approx(differences[:, 7].mean())
    assert found.error[7] == pytest.approx(differences[:, 7].std(ddof=1) / np.sqrt(40))


def test_measures_that_never_differ_reject_nothing():
    assert flip_test(np.zeros((10, 3)), np.ones(10), np.random.default_rng(0)).p == 1.0


def test_a_difference_that_is_the_same_in_every_lot_is_as_sure_as_flips_can_be():
    assert flip_test(np.ones((12, 1)), np.ones(12), np.random.default_rng(0), permutations=99).p <= 0.02


def test_leaving_a_lot_out_without_refitting_equals_refitting():
    rng = np.random.default_rng(2)
    differences = rng.standard_normal((15, 4)) + np.array([0.6, 0, 0, 0])
    z = differences / np.sqrt((differences**2).mean(axis=0))
    right = []
    for lot in range(15):
        others = np.delete(z, lot, axis=0)
        beta = np.linalg.solve(others.T @ others + (1 + RIDGE_SHARE * 15) * np.eye(4), others.sum(axis=0))
        right.append(z[lot] @ beta > 0)
    test, _ = classifier_test(differences, rng)
    assert test.accuracy == pytest.approx(np.mean(right))


def test_classifier_guesses_when_nothing_differs_and_knows_when_something_does():
    rng = np.random.default_rng(1)
    same = [classifier_test(rng.standard_normal((28, 14)), rng, permutations=99)[0] for _ in range(100)]
    assert np.mean([t.p <= 0.05 for t in same]) < 0.12
    assert abs(np.mean([t.accuracy for t in same]) - 0.5) < 0.03
    told, guesses = classifier_test(rng.standard_normal((28, 14)) + 1.0, rng)
    assert told.accuracy > 0.9
    assert told.p == pytest.approx(1 / 1000)
    assert told.low < told.accuracy <= told.high
    assert abs(guesses.mean() - 0.5) < 0.02


def test_features_that_never_differ_leave_guessing():
    test, _ = classifier_test(np.zeros((6, 3)), np.random.default_rng(0))
    assert (test.accuracy, test.p, test.features) == (0.5, 1.0, 0)


def test_interval_of_a_share_is_wilsons():
    low, high = wilson_interval(0.5, 100)
    assert low == pytest.approx(0.4038, abs=1e-4)
    assert high == pytest.approx(0.5962, abs=1e-4)
    assert wilson_interval(1.0, 10)[1] == pytest.approx(1)
