"""Whether predictors are as sure as they ought to be: intervals, ranks of the truth, and errors beside spreads.

A mean and a spread stand for the beta distribution on the range that has them, since a normal one would reach beyond
the range: of a parameter that a map tells nothing of it is the uniform prior itself.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc, betaincinv

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.predictions import COUNTS, EVEN, LOW, RANGE, Floats, Mask, Prediction

LEVELS = (0.5, 0.68, 0.9, 0.95)
BINS = 10
GROUPS = 5
LEAST_CONCENTRATION = 0.05
"""Of the beta distribution: a spread so wide that only the ends of the range are left is narrowed to this."""


@dataclass(frozen=True, kw_only=True)
class Calibration:
    """How a parameter's stated spreads agree with what was found.

    Parameters
    ----------
    pairs
        How many used the parameter.
    covered
        Share of truths in the central interval of each of `LEVELS`.
    worst
        Largest distance of `covered` from its level.
    ranks
        Share of truths in each tenth of their predicted distributions; a tenth each where spreads are right.
    told, found
        Root mean squared spread and error in each fifth of the pairs, from the surest to the least sure.
    """

    pairs: int
    covered: tuple[float, ...]
    worst: float
    ranks: tuple[float, ...]
    told: tuple[float, ...]
    found: tuple[float, ...]


def calibrations(
    prediction: Prediction, truth: Floats, counted: Mask, rng: np.random.Generator
) -> dict[str, Calibration]:
    """Judge the spreads of each parameter on the pairs that count.

    Parameters
    ----------
    prediction
        With spreads.
    truth, counted
        (n, 6) shares of the range, and pairs that count.
    rng
        Spreads whole numbers over their cells, see `ranks_of`.
    """
    assert prediction.spreads is not None, "only stated spreads can be judged"
    ranks = ranks_of(prediction.values, prediction.spreads, truth, rng)
    found = {}
    for number, name in enumerate(REGRESSED):
        rows = np.flatnonzero(counted[:, number])
        if len(rows):
            error = prediction.values[rows, number] - truth[rows, number]
            found[name] = _calibration(ranks[rows, number], prediction.spreads[rows, number], error)
    return found


def _calibration(ranks: Floats, spreads: Floats, error: Floats) -> Calibration:
    covered = central_coverage(ranks)
    histogram = np.bincount(np.minimum((ranks * BINS).astype(np.int64), BINS - 1), minlength=BINS)
    parts = [part for part in np.array_split(np.argsort(spreads, kind="stable"), GROUPS) if len(part)]
    return Calibration(
        pairs=len(ranks),
        covered=covered,
        worst=max(abs(share - level) for share, level in zip(covered, LEVELS, strict=True)),
        ranks=tuple((histogram / len(ranks)).tolist()),
        told=tuple(float(np.sqrt(np.mean(spreads[part] ** 2))) for part in parts),
        found=tuple(float(np.sqrt(np.mean(error[part] ** 2))) for part in parts),
    )


def central_coverage(ranks: Floats, levels: tuple[float, ...] = LEVELS) -> tuple[float, ...]:
    """Return the share of ranks (n,) within the central interval of each level."""
    return tuple(float(np.mean(np.abs(ranks - 0.5) <= level / 2)) for level in levels)


def ranks_of(values: Floats, spreads: Floats, truth: Floats, rng: np.random.Generator) -> Floats:
    """Return the share of each predicted distribution that lies below the truth (probability integral transform).

    Whole numbers are spread evenly over cells of one unit, in the prediction as in the truth, so that ranks of a right
    prediction are uniform for them too (Czado, Gneiting and Held 2009).

    Parameters
    ----------
    values, spreads, truth
        (n, 6) shares of the range.

    Returns
    -------
    (n, 6) float64
    """
    place = truth * RANGE + LOW
    place[:, COUNTS] = np.round(place[:, COUNTS]) + rng.random((len(truth), int(COUNTS.sum()))) - 0.5
    return np.asarray(betainc(*_distributions(values, spreads), np.clip(EVEN.shares(place), 0.0, 1.0)))


def central_interval(prediction: Prediction, level: float) -> tuple[Floats, Floats]:
    """Return the ends of central intervals (n, 6) in the parameters' units."""
    assert prediction.spreads is not None, "only stated spreads have intervals"
    exponents = _distributions(prediction.values, prediction.spreads)
    low, high = (EVEN.values(betaincinv(*exponents, 0.5 + side * level / 2)) for side in (-1, 1))
    return low, high


def _distributions(values: Floats, spreads: Floats) -> tuple[Floats, Floats]:
    return beta_of(EVEN.shares(values * RANGE + LOW), EVEN.share_spreads(spreads * RANGE) ** 2)


def beta_of(mean: NDArray[np.float64], variance: NDArray[np.float64]) -> tuple[Floats, Floats]:
    """Return the two exponents of the beta distributions of such means and variances."""
    mean = np.clip(mean, 1e-3, 1 - 1e-3)
    concentration = np.maximum(mean * (1 - mean) / np.maximum(variance, 1e-8) - 1, LEAST_CONCENTRATION)
    return mean * concentration, (1 - mean) * concentration
