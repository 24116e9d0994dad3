"""Preferences from answers: known shares come out, and intervals know of raters and lots."""

import numpy as np
import pytest

from urbanforest_cli.evaluation.study.score import Answers, crossed_interval, score_answers


def answers_of(share, *, raters=20, lots=28, category="placed", rater_spread=0.0, seed=1):
    rng = np.random.default_rng(seed)
    rater, lot = np.meshgrid(np.arange(raters), np.arange(lots), indexing="ij")
    taste = np.clip(share + rater_spread * rng.standard_normal(raters), 0, 1)
    chosen = rng.random(rater.shape) < taste[:, None]
    left = rng.random(rater.shape) < 0.5
    return Answers(
        np.array([f"rater {index}" for index in rater.ravel()], dtype=object),
        np.array([f"lot {index}" for index in lot.ravel()], dtype=object),
        np.full(rater.size, category, dtype=object),
        chosen.ravel(),
        left.ravel(),
    )


def test_the_share_is_counted_not_estimated():
    answers = answers_of(0.42)
    preference = score_answers(answers).preferences[0]
    assert preference.share == answers.for_other.mean()
    assert (preference.answers, preference.raters, preference.lots) == (560, 20, 28)


@pytest.mark.parametrize(("share", "told_apart"), [(0.5, False), (0.3, True)])
def test_half_lies_in_the_interval_where_nobody_can_tell(share, told_apart):
    preference = score_answers(answers_of(share)).preferences[0]
    assert (preference.low <= 0.5 <= preference.high) != told_apart
    assert (preference.chance < 0.01) == told_apart


def test_raters_of_different_taste_widen_the_interval():
    def width(spread):
        found = score_answers(answers_of(0.5, rater_spread=spread)).preferences[0]
        return found.high - found.low

    assert width(0.35) > 1.5 * width(0.0)


def test_the_interval_covers_the_truth_about_as_often_as_it_says():
    hits = 0
    for seed in range(60):
        low, high = crossed_interval(
            *_indices(answers_of(0.4, raters=12, lots=15, rater_spread=0.15, seed=seed)), np.random.default_rng(seed)
        )
        hits += low <= 0.4 <= high
    assert hits >= 54  # the crossed bootstrap errs on the wide side


def _indices(answers):
    rater = np.unique(answers.rater.astype(str), return_inverse=True)[1]
    lot = np.unique(answers.lot.astype(str), return_inverse=True)[1]
    return answers.for_other, rater, lot


def test_one_rater_and_one_lot_allow_no_interval():
    preference = score_answers(answers_of(1.0, raters=1, lots=1)).preferences[0]
    assert preference.low is None
    assert preference.high is None


def test_raters_who_like_chance_are_named():
    blind = answers_of(0.9, raters=1, category="random")
    seeing = answers_of(0.1, raters=1, category="random", seed=3)
    both = Answers(
        np.concatenate([np.full(28, "blind", dtype=object), np.full(28, "seeing", dtype=object)]),
        *(
            np.concatenate([getattr(blind, name), getattr(seeing, name)])
            for name in ("lot", "category", "for_other", "left")
        ),
    )
    assert score_answers(both).inattentive == ("blind",)
