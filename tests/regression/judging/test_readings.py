from __future__ import annotations

import numpy as np
import pytest

from tests.regression.judging.made_pairs import disc_pairs
from urbanforest_cli.regression.judging.baselines import fit_mean
from urbanforest_cli.regression.judging.predictions import Prediction, shares
from urbanforest_cli.regression.judging.readings import readings


@pytest.fixture(scope="module")
def found():
    table = disc_pairs(6000, seed=4)
    truth = shares(table.values)
    strategy = np.eye(3)[table.strategy]
    return readings({"truth": Prediction(truth, None, strategy), "mean": fit_mean(table)(table)}, truth, table)


def test_the_truth_is_right_in_every_sense(found):
    for text, values in found.items():
        assert values["truth"] == pytest.approx(1), text


def test_the_mean_has_the_known_value_in_each_sense(found):
    known = {
        "mean R2, parameters in use": (0, 0.001),
        "mean 1 - NMAE, in use": (0.742, 0.01),  # 3/4, and 0.7 of whole numbers
        "within 10 % of the range, in use": (0.17, 0.03),  # 1/5, and none of whole numbers
        "1 - NMAE, all pairs, unused set to 0": (0.756, 0.01),
        "1 - NMAE, all pairs, unused as drawn": (0.742, 0.01),
        "1 - MSE, in use": (1 - (5 / 12 + 0.1167) / 6, 0.004),
    }
    for text, (value, off) in known.items():
        assert found[text]["mean"] == pytest.approx(value, abs=off), text
    assert 0.5 < found["largest of six named, raw units, unused as drawn"]["mean"] < 0.9


def test_strategies_decide_what_counts_as_zero():
    table = disc_pairs(600, seed=4)
    truth = shares(table.values)
    right, wrong = (Prediction(truth, None, np.eye(3)[(table.strategy + shift) % 3]) for shift in (0, 1))
    values = readings({"right": right, "wrong": wrong}, truth, table)
    assert values["1 - NMAE, all pairs, unused set to 0"]["wrong"] < 0.85
    assert values["1 - NMAE, all pairs, unused as drawn"]["wrong"] == pytest.approx(1)
