"""Scores by hand."""

from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.regression.learning.scores import errors_by_parameter, nearness_by_parameter, r2_by_parameter


def test_scores_are_of_the_pairs_that_use_a_parameter():
    share = np.tile(np.array([0.0, 0.2, 0.4, 1.0])[:, None], 6)
    mean = share.copy()
    mean[:, 1] = 0.2
    mean[3] = 7.0
    used = np.ones(share.shape, bool)
    used[3] = False
    used[:, 5] = False
    r2 = list(r2_by_parameter(mean, share, used).values())
    assert r2 == pytest.approx([1.0, 0.0, 1.0, 1.0, 1.0, 0.0])
    errors = errors_by_parameter(mean, share, used)
    assert errors == pytest.approx([0, np.sqrt(0.08 / 3), 0, 0, 0, 12**-0.5])
    assert list(nearness_by_parameter(mean, share, used).values()) == pytest.approx([1, 1 - 0.4 / 3, 1, 1, 1, 0])
