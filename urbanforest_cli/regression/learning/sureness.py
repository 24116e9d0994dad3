"""How wide spreads must be so that intervals hold as many true values as they say."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.special import betainc

INTERVALS = (0.5, 0.68, 0.9, 0.95)
FACTORS = np.geomspace(0.25, 4.0, 57)
POWERS = np.linspace(0.7, 1.5, 17)
MIDDLE_WEIGHT = 10.0
"""Concentration that a power leaves as it is."""
GROUPS = 5
FEWEST, FEWEST_FOR_GROUPS = 50, 500
"""Pairs that a factor is chosen by, at least, and a power; with fewer, spreads stay, or are all widened alike."""

Floats = NDArray[np.float64]


def scaled_weight(weight: Floats, factor: float, power: float) -> Floats:
    """Return concentrations made `factor` times as large, and those above the middle more so by a power above 1."""
    return np.asarray(factor * MIDDLE_WEIGHT * (weight / MIDDLE_WEIGHT) ** power)


def sureness(mean: Floats, weight: Floats, share: Floats, used: NDArray[np.bool_]) -> tuple[Floats, Floats]:
    """Return (parameter,) factors and powers of concentrations with which intervals are closest to what they say.

    They are so for each fifth of the pairs, from the least sure to the surest, and not only for all of them.

    Parameters
    ----------
    mean, weight
        (pair, parameter) of Beta distributions: a = mean * weight, b = (1 - mean) * weight.
    share
        (pair, parameter) true shares, whole numbers spread over their parts.
    used
        (pair, parameter) which of them count.
    """
    factors, powers = np.ones(mean.shape[1]), np.ones(mean.shape[1])
    for number in range(mean.shape[1]):
        rows = used[:, number]
        if rows.sum() >= FEWEST:
            factors[number], powers[number] = _best(mean[rows, number], weight[rows, number], share[rows, number])
    return factors, powers


def interval_shares(mean: Floats, weight: Floats, share: Floats) -> Floats:
    """Return which share of true values the central interval of each of `INTERVALS` holds."""
    return _held(_off_middle(mean, weight, share))


def _best(mean: Floats, weight: Floats, share: Floats) -> tuple[float, float]:
    grouped = len(mean) >= FEWEST_FOR_GROUPS
    bounds = np.quantile(weight, np.arange(1, GROUPS) / GROUPS) if grouped else np.empty(0)
    group = np.digitize(weight, bounds)
    choices = []
    for power in POWERS if grouped else (1.0,):
        for factor in FACTORS:
            off = _off_middle(mean, scaled_weight(weight, factor, power), share)
            miss = sum(_miss(_held(off[group == one])) for one in np.unique(group))
            choices.append((miss, float(factor), float(power)))
    return min(choices)[1:]


def _off_middle(mean: Floats, weight: Floats, share: Floats) -> Floats:
    """Return how far from the middle of its distribution each true value lies, from 0 to 0.5."""
    return np.asarray(np.abs(betainc(mean * weight, (1.0 - mean) * weight, share) - 0.5))


def _held(off: Floats) -> Floats:
    return np.array([np.mean(off <= 0.5 * interval) for interval in INTERVALS])


def _miss(found: Floats) -> float:
    return float(np.sum((found - np.array(INTERVALS)) ** 2))
