"""How well probabilities agree with a truth, at every threshold at once, and which threshold is best."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import UNKNOWN

BINS = 100
TRUTH_LEAST_PERCENT = 50
"""A pixel of the truth counts as covered from this share on."""
LOWEST, HIGHEST = 10, 90
"""Thresholds are chosen within these bins, so that a poor validation set does not choose an extreme one."""


@dataclass(frozen=True)
class Agreement:
    """One class's score at its threshold: intersection over union, and the shares of the area."""

    threshold: float
    iou: float
    predicted_share: float
    true_share: float


class Tally:
    """Pixels counted by class, by whether the truth covers them, and by the bin of their probability."""

    def __init__(self, class_count: int) -> None:
        self.counts: NDArray[np.int64] = np.zeros((class_count, 2, BINS), dtype=np.int64)

    def add(self, probability: NDArray[np.float32], truth: NDArray[np.uint8]) -> None:
        """Count (class, row, col) of probabilities and of percent; unknown pixels count nowhere."""
        step = np.minimum((probability * BINS).astype(np.int64), BINS - 1)
        for number, (bins, percent) in enumerate(zip(step, truth, strict=True)):
            known = percent != UNKNOWN
            code = bins[known] + BINS * (percent[known] >= TRUTH_LEAST_PERCENT)
            self.counts[number] += np.bincount(code, minlength=2 * BINS).reshape(2, BINS)

    def agreements(self) -> list[Agreement]:
        """Return each class's score at the threshold where it is best; the one nearest to 0.5 of equals.

        Where the truth has no covered pixel, the intersection over union is 0 and the threshold 0.5.
        """
        return [self._best(counts) for counts in self.counts]

    def at(self, number: int, threshold: float) -> Agreement:
        """Return a class's score at a threshold, rounded to whole bins."""
        return _agreement(self.counts[number], round(threshold * BINS))

    def _best(self, counts: NDArray[np.int64]) -> Agreement:
        choices = [_agreement(counts, bin_) for bin_ in range(LOWEST, HIGHEST + 1)]
        return max(choices, key=lambda choice: (choice.iou, -abs(choice.threshold - 0.5)))


def mean_iou(agreements: list[Agreement]) -> float:
    """Return the mean over classes, by which epochs are compared."""
    return float(np.mean([agreement.iou for agreement in agreements]))


def _agreement(counts: NDArray[np.int64], first: int) -> Agreement:
    covered = counts[1]
    both, predicted = int(covered[first:].sum()), int(counts[:, first:].sum())
    true, total = int(covered.sum()), max(1, int(counts.sum()))
    union = predicted + true - both
    return Agreement(first / BINS, both / union if union else 0.0, predicted / total, true / total)
