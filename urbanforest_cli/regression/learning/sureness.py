"""How wide spreads must be so that intervals hold as many true values as they say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

INTERVALS = (0.5, 0.68, 0.9, 0.95)
FACTORS = np.geomspace(0.2, 5.0, 121)
FEWEST = 50
"""Pairs that a factor is chosen by, at least; with fewer, spreads stay."""

Floats = NDArray[np.float64]


def sureness_factors(mean: Floats, weight: Floats, share: Floats, used: NDArray[np.bool_]) -> Floats:
    """Return (parameter,) factors of concentrations with which central intervals are closest to what they say.

    Parameters
    ----------
    mean, weight
        (pair, parameter) of Beta distributions: a = mean * weight, b = (1 - mean) * weight.
    share
        (pair, parameter) true shares, whole numbers spread over their parts.
    used
        (pair, parameter) which of them count.
    """
    factors = np.ones(mean.shape[1])
    for number in range(mean.shape[1]):
        rows = used[:, number]
        if rows.sum() >= FEWEST:
            misses = [
                _miss(interval_shares(mean[rows, number], factor * weight[rows, number], share[rows, number]))
                for factor in FACTORS
            ]
            factors[number] = FACTORS[int(np.argmin(misses))]
    return factors


def interval_shares(mean: Floats, weight: Floats, share: Floats) -> Floats:
    """Return which share of true values the central interval of each of `INTERVALS` holds."""
    rank = betainc(mean * weight, (1.0 - mean) * weight, share)
    return np.array([np.mean(np.abs(rank - 0.5) <= 0.5 * interval) for interval in INTERVALS])


def _miss(found: Floats) -> float:
    return float(np.sum((found - np.array(INTERVALS)) ** 2))
