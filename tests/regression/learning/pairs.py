"""Pairs in memory: one square of vegetation in a square lot, whose side, place and share are what is to be read."""

from __future__ import annotations

import numpy as np

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.regression.features import FEATURES
from urbanforest_cli.regression.learning.samples import HIGH, LOW
from urbanforest_cli.regression.pair_table import PairTable

FEATURE_COUNT = len(FEATURES)


def squares(count=240, seed=0, features=FEATURE_COUNT):
    """Return pairs, four on each lot; the first feature tells the density, the others nothing."""
    rng = rng_for(seed, "squares", "")
    share = rng.random((count, 6), dtype=np.float32)
    low, high = np.array(LOW, np.float32), np.array(HIGH, np.float32)
    values = low + share * (high - low)
    values[:, 5] = np.floor(6 * share[:, 5])
    windows = np.zeros((count, 3, 64, 64), np.uint8)
    windows[:, 1, 8:56, 8:56] = 100
    windows[:, 2, 8:56, 8:56] = 60
    strategy = rng.integers(3, size=count).astype(np.int8)
    for row in range(count):
        half = 2 + round(18 * float(share[row, 0]))
        windows[row, 0, 32 - half : 32 + half, 32 - half : 32 + half] = 100 - 30 * strategy[row]
    used = np.ones((count, 6), bool)
    used[:, 3] = strategy == 1
    used[:, 4:] = (strategy == 2)[:, None]
    told = rng.standard_normal((count, features)).astype(np.float32)
    told[:, 0] = 50.0 + 7.0 * share[:, 2]
    told[:, 1] = 3.0  # the same of all
    return PairTable(
        windows, rng.integers(1, 3, count).astype(np.float32), told, values.astype(np.float32), used, strategy,
        rng.integers(0, 40, count).astype(np.int32), rng.integers(0, 40, count).astype(np.int32),
        (np.arange(count) // 4).astype(np.int32),
    )  # fmt: skip
