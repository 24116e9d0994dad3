"""What the answers say: preference by category, with a bootstrap over lots and raters.

An answer is evidence of its rater and of its lot, so both are drawn anew: a resample draws raters with repetition and
lots with repetition, and an answer counts as often as its rater times its lot was drawn (the crossed bootstrap of
Owen 2007, The Annals of Applied Statistics 1(2), which errs on the wide side).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.stats import binomtest

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.evaluation.study.trials import RANDOM, STREAM

RESAMPLES = 4000
LEVEL = 0.95
PAPER_PREFERENCE = 0.42
"""Share of answers for the placed planting that the paper reports (section Perceptual User Study)."""


@dataclass(frozen=True)
class Answers:
    """All answers, one a row.

    Parameters
    ----------
    rater, lot, category
        (n,) what an answer belongs to, as text.
    for_other
        (n,) whether the planting beside the real one was chosen.
    left
        (n,) whether the left picture was chosen.
    """

    rater: NDArray[np.object_]
    lot: NDArray[np.object_]
    category: NDArray[np.object_]
    for_other: NDArray[np.bool_]
    left: NDArray[np.bool_]


@dataclass(frozen=True)
class Preference:
    """How often a category was chosen over the real planting: 0.5 where nobody can tell them apart."""

    category: str
    answers: int
    raters: int
    lots: int
    share: float
    low: float | None
    high: float | None
    chance: float
    """Probability of a share as far from one half if every answer were a coin's."""


@dataclass(frozen=True)
class StudyScore:
    """Preferences of all categories, and what may make them doubtful."""

    preferences: tuple[Preference, ...]
    left_share: float
    inattentive: tuple[str, ...]
    """Raters who chose random positions over real ones at least half the time."""

    def as_record(self) -> dict[str, Any]:
        """Return plain values for JSON."""
        return asdict(self)


def score_answers(answers: Answers, *, seed: int = 0) -> StudyScore:
    """Score answers.

    Returns
    -------
    Categories in the order of their names, the control last. Intervals are None with a single rater and a single lot.
    """
    found = sorted(set(answers.category), key=lambda name: (name == RANDOM, name))
    control = answers.category == RANDOM
    inattentive = [
        str(rater)
        for rater in sorted(set(answers.rater[control]))
        if answers.for_other[control & (answers.rater == rater)].mean() >= 0.5
    ]
    return StudyScore(
        tuple(_preference(answers, name, seed) for name in found),
        float(answers.left.mean()),
        tuple(inattentive),
    )


def _preference(answers: Answers, category: str, seed: int) -> Preference:
    rows = answers.category == category
    chosen = answers.for_other[rows]
    raters, rater = np.unique(answers.rater[rows].astype(str), return_inverse=True)
    lots, lot = np.unique(answers.lot[rows].astype(str), return_inverse=True)
    low, high = crossed_interval(chosen, rater, lot, rng_for(seed, STREAM, f"bootstrap {category}"))
    return Preference(
        category=category,
        answers=len(chosen),
        raters=len(raters),
        lots=len(lots),
        share=float(chosen.mean()),
        low=low,
        high=high,
        chance=float(binomtest(int(chosen.sum()), len(chosen)).pvalue),
    )


def crossed_interval(
    chosen: NDArray[np.bool_], rater: NDArray[np.int64], lot: NDArray[np.int64], rng: np.random.Generator
) -> tuple[float | None, float | None]:
    """Return the middle 95 % of the share over resamples of raters and lots.

    Parameters
    ----------
    chosen, rater, lot
        (n,) answers, and the index of each one's rater and lot.
    """
    raters, lots = int(rater.max()) + 1, int(lot.max()) + 1
    if raters == 1 and lots == 1:
        return None, None
    yes, all_ = np.zeros((raters, lots)), np.zeros((raters, lots))
    np.add.at(yes, (rater, lot), chosen)
    np.add.at(all_, (rater, lot), 1.0)
    of_raters = _draws(raters, rng)
    of_lots = _draws(lots, rng)
    total = np.einsum("br,rl,bl->b", of_raters, all_, of_lots, optimize=True)
    share = np.einsum("br,rl,bl->b", of_raters, yes, of_lots, optimize=True)[total > 0] / total[total > 0]
    low, high = np.quantile(share, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)


def _draws(count: int, rng: np.random.Generator) -> NDArray[np.float64]:
    """Return how often each of `count` is drawn; one alone is drawn once, for it cannot tell of others."""
    return rng.multinomial(count, np.full(count, 1.0 / count), size=RESAMPLES).astype(np.float64)


def joined(parts: Sequence[Answers]) -> Answers:
    """Return all answers as one."""
    return Answers(
        np.concatenate([part.rater for part in parts]),
        np.concatenate([part.lot for part in parts]),
        np.concatenate([part.category for part in parts]),
        np.concatenate([part.for_other for part in parts]),
        np.concatenate([part.left for part in parts]),
    )
