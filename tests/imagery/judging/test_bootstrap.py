from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.imagery.judging.bootstrap import interval, resampled_iou, sums_by_place


def test_tiles_of_one_place_are_one():
    counts = np.arange(12).reshape(3, 4)
    assert sums_by_place(counts, ["b", "a", "b"]).tolist() == [[4, 5, 6, 7], [8, 10, 12, 14]]


def test_repeating_each_place_as_more_tiles_narrows_nothing():
    rng = np.random.default_rng(0)
    counts = np.column_stack(
        [rng.integers(20, 80, 12), rng.integers(0, 40, 12), rng.integers(0, 40, 12), np.ones(12, int)]
    )
    places = [f"p{i:02d}" for i in range(12)]
    once = resampled_iou(sums_by_place(counts, places), rng_for(0, "test", "a"))
    thrice = resampled_iou(sums_by_place(np.repeat(counts, 3, axis=0), np.repeat(places, 3)), rng_for(0, "test", "a"))
    assert np.allclose(once, thrice)


def test_interval_covers_what_theory_says_of_a_mean():
    # With nothing predicted beside the truth and equal truth everywhere, IoU is the mean share found over places.
    rng = np.random.default_rng(1)
    found = rng.integers(300, 900, 60)
    counts = np.column_stack([found, np.zeros(60, int), 1000 - found, np.zeros(60, int)])
    low, high = interval(resampled_iou(counts, rng_for(3, "test", "b")))
    spread = found.std() / 1000 / np.sqrt(60)
    assert (low, high) == pytest.approx(
        (found.mean() / 1000 - 1.96 * spread, found.mean() / 1000 + 1.96 * spread), abs=0.15 * spread
    )


def test_predictors_are_drawn_together():
    counts = np.stack([[[10, 0, 5, 0], [10, 0, 5, 0]], [[2, 3, 9, 0], [2, 3, 9, 0]], [[7, 1, 0, 0], [7, 1, 0, 0]]])
    drawn = resampled_iou(counts, rng_for(0, "test", "c"))
    assert (drawn[:, 0] == drawn[:, 1]).all()
    assert drawn[:, 0].std() > 0.05


def test_draws_without_anything_have_no_interval():
    counts = np.array([[0, 0, 0, 50], [0, 0, 0, 50], [10, 2, 0, 50]])
    assert interval(resampled_iou(counts, rng_for(0, "test", "d"))) is None
