"""Which pairs a network learns from, and what it is to say of them."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.randomness import hash_uniform, keys_for
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.designs import DENSITY_LEAST
from urbanforest_cli.regression.learning.settings import RegressionSettings
from urbanforest_cli.regression.pair_table import PairTable

STREAM = "train-regression"
LOW = tuple(DENSITY_LEAST if name == "density" else float(PARAMETERS[name].low) for name in REGRESSED)
HIGH = tuple(float(PARAMETERS[name].high) for name in REGRESSED)
"""Ranges that pairs are drawn from, in the order of `REGRESSED`."""
LEVELS = np.array(
    [HIGH[number] - LOW[number] if PARAMETERS[name].kind == "count" else 0.0 for number, name in enumerate(REGRESSED)],
    np.float32,
)
"""Whole steps within the range of a parameter that is a count, 0 for others."""
EDGE_SHARE = 1e-3
"""Shares are kept so far from 0 and 1, where a density may have no bound."""


@dataclass(frozen=True)
class Parted:
    """Pairs of three sets of lots: to learn from, to compare epochs and set spreads right by, and to be judged by."""

    training: PairTable
    calibration: PairTable
    validation: PairTable


def parted(pairs: PairTable, settings: RegressionSettings) -> Parted:
    """Part pairs by their lots; which set a lot is of follows from the seed and its number alone."""
    lots = np.unique(pairs.lot)
    chance = hash_uniform(keys_for(settings.seed, f"{STREAM} parts", map(str, lots.tolist())), np.zeros(len(lots), int))
    place = np.empty(len(lots), np.int64)
    place[np.argsort(chance, kind="stable")] = np.arange(len(lots))
    judged = round(settings.validation_fraction * len(lots))
    kept = judged + round(settings.calibration_fraction * (len(lots) - judged))
    place = place[np.searchsorted(lots, pairs.lot)]
    return Parted(
        training=pairs.take(place >= kept),
        calibration=pairs.take((place >= judged) & (place < kept)),
        validation=pairs.take(place < judged),
    )


def shares(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (pair, parameter) values as shares of their ranges."""
    low = np.array(LOW, np.float32)
    return np.asarray((values - low) / (np.array(HIGH, np.float32) - low), np.float32)


def spread_shares(shares_: NDArray[np.float32], within: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return shares with each whole number moved into its own part of the range, by `within` from 0 to 1.

    A number of 0 to 5 becomes one of six equal parts, so that all of them being equally likely is the uniform
    distribution; other parameters stay.
    """
    moved = (LEVELS * shares_ + within) / (LEVELS + 1.0)
    return np.asarray(np.clip(np.where(LEVELS > 0, moved, shares_), EDGE_SHARE, 1.0 - EDGE_SHARE), np.float32)
