from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.evaluation.counts import count_scores
from urbanforest_cli.evaluation.scores import energy_distance, score_against


def test_energy_distance_of_one_law_is_zero_on_average_and_of_two_is_not():
    rng = np.random.default_rng(0)
    same = [energy_distance(rng.standard_normal((20, 3)), rng.standard_normal((20, 3))) for _ in range(200)]
    assert abs(np.mean(same)) < 3 * np.std(same) / np.sqrt(200)
    assert energy_distance(rng.standard_normal((20, 3)), rng.standard_normal((20, 3)) + 2) > 1


def test_energy_distance_by_hand():
    assert energy_distance(np.array([[0.0], [1]]), np.array([[3.0], [5]])) == 2 * 3.5 - 1 - 2


def test_score_is_one_for_the_real_law_zero_for_the_floor_and_below_for_worse():
    rng = np.random.default_rng(1)
    real, random = rng.standard_normal((200, 4)), rng.standard_normal((200, 4)) + 1

    def score(model):
        return score_against(real, {"model": model, "random": random}, np.random.default_rng(0)).score

    assert abs(score(rng.standard_normal((200, 4))) - 1) < 0.05
    assert score(random) == 0
    assert 0.4 < score(rng.standard_normal((200, 4)) + 0.5) < 0.95
    assert score(rng.standard_normal((200, 4)) + 2) < -0.5


def test_no_score_where_lots_are_few_or_the_real_plants_look_random():
    rng = np.random.default_rng(1)
    rows = rng.standard_normal((30, 2))
    assert score_against(rows[:7], {"model": rows[:7], "random": rows[:7]}, rng) is None
    assert score_against(rows, {"model": rows + 1, "random": rows}, rng).score is None


def test_counts_are_compared_in_lots_with_real_plants():
    found = count_scores(np.array([10, 0, 4]), np.array([5, 7, 4]), np.array([1e4, 1e4, 1e4]))
    assert (found.real, found.model, found.model_in_lots_with_real) == (14, 16, 9)
    assert found.total_error == 9 / 14 - 1
    assert found.lot_error_median == 0.25
    assert (found.real_per_ha, found.model_per_ha) == (7.0, 4.5)
    assert found.rank_correlation == pytest.approx(1)


def test_without_real_plants_there_is_no_error_to_state():
    found = count_scores(np.array([0, 0]), np.array([1, 2]), np.array([1.0, 1.0]))
    assert found.total_error is None
    assert found.lot_error_mean is None
