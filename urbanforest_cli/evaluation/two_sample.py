"""Are two sets of patterns from one process? Sign flips over lots, and a classifier that has to tell them apart.

A lot holds a real and a model pattern of equal count in the same ground, so under the hypothesis that both come from
one process the difference of any measure is as likely its own negative: flipping signs lot by lot gives exact tests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]

PERMUTATIONS = 999
RIDGE_SHARE = 0.05
WILSON_Z = 1.959964


@dataclass(frozen=True)
class FlipTest:
    """Result of a sign-flip test of several measures at once.

    `p` is that of the largest |t| over the measures; `difference` is the mean over lots and `error` its standard error.
    """

    p: float
    largest_t: float
    difference: list[float]
    error: list[float]
    lots: int
    permutations: int


def flip_test(
    differences: Floats, weights: Floats, rng: np.random.Generator, *, permutations: int = PERMUTATIONS
) -> FlipTest:
    """Test whether paired differences are centred on 0, by flipping the signs of whole lots.

    The statistic is the largest |t| over the measures (max-t, Westfall and Young 1993), so it holds for all of them at
    once.

    Parameters
    ----------
    differences
        (lots, measures), model minus real.
    weights
        (lots,) weight of a lot, for example the root of its count.
    rng
        Draws the signs.
    permutations
        How many flips; the data as they are count as one more.
    """
    weighted = differences * weights[:, None] / weights.mean()
    signs = rng.choice(np.array([-1.0, 1.0]), (permutations, len(weighted)))
    observed = _largest_t(weighted.mean(axis=0)[None], weighted)[0]
    flipped = _largest_t(signs @ weighted / len(weighted), weighted)
    return FlipTest(
        p=float((1 + (flipped >= observed * (1 - 1e-12)).sum()) / (permutations + 1)),
        largest_t=float(observed),
        difference=differences.mean(axis=0).tolist(),
        error=(differences.std(axis=0, ddof=1) / np.sqrt(len(differences))).tolist() if len(differences) > 1 else [],
        lots=len(differences),
        permutations=permutations,
    )


def _largest_t(means: Floats, values: Floats) -> Floats:
    """Return the largest |t| for each row of means; signs do not change the mean square."""
    spread = ((values**2).mean(axis=0) - means**2).clip(0) / max(len(values) - 1, 1)
    t = np.divide(np.abs(means), np.sqrt(spread), out=np.zeros_like(means), where=spread > 1e-24)
    return np.asarray(np.where((spread <= 1e-24) & (np.abs(means) > 1e-9), 1e9, t).max(axis=1))


@dataclass(frozen=True)
class ClassifierTest:
    """How often a classifier tells the model's pattern of a lot from the real one; 0.5 is guessing."""

    accuracy: float
    low: float
    high: float
    p: float
    guessing: float
    lots: int
    features: int


def classifier_test(
    differences: Floats, rng: np.random.Generator, *, permutations: int = PERMUTATIONS
) -> tuple[ClassifierTest, Floats]:
    """Let a ridge classifier choose which of a lot's two patterns is the model's, having seen all other lots.

    Two alternatives, forced choice. Differences of features are the classifier's input, which removes what the lot
    itself contributes. Leaving a lot out needs no refit: its score is (f - h) / (1 - h) with f the fitted value and h
    the leverage. The p-value comes from flipping lots, refitted each time (Lopez-Paz and Oquab 2017 for the idea).

    Parameters
    ----------
    differences
        (lots, features), model minus real.
    rng
        Draws the flips.
    permutations
        How many.

    Returns
    -------
    The test, and the accuracies of the flips.
    """
    scale = np.sqrt((differences**2).mean(axis=0))
    z = differences[:, scale > 1e-12] / scale[scale > 1e-12]
    lots, features = z.shape
    if features == 0:
        return ClassifierTest(0.5, 0.0, 1.0, 1.0, 0.5, lots, 0), np.full(permutations, 0.5)
    inverse = np.linalg.inv(z.T @ z + (1 + RIDGE_SHARE * lots) * np.eye(features))
    leverage = np.einsum("lf,fg,lg->l", z, inverse, z)
    signs = rng.choice(np.array([-1.0, 1.0]), (permutations, lots))
    signs = np.concatenate([np.ones((1, lots)), signs])
    fitted = (signs @ z) @ inverse @ z.T
    score = signs * (fitted - leverage * signs) / (1 - leverage)
    accuracy = (score > 0).mean(axis=1) + 0.5 * (score == 0).mean(axis=1)
    low, high = wilson_interval(float(accuracy[0]), lots)
    p = (1 + (accuracy[1:] >= accuracy[0] - 1e-12).sum()) / (permutations + 1)
    test = ClassifierTest(float(accuracy[0]), low, high, float(p), float(accuracy[1:].mean()), lots, features)
    return test, accuracy[1:]


def wilson_interval(share: float, count: int) -> tuple[float, float]:
    """Return the 95 % interval of a share (Wilson 1927)."""
    z = WILSON_Z
    centre = (share + z * z / (2 * count)) / (1 + z * z / count)
    half = z / (1 + z * z / count) * np.sqrt(share * (1 - share) / count + z * z / (4 * count * count))
    return float(max(centre - half, 0.0)), float(min(centre + half, 1.0))
