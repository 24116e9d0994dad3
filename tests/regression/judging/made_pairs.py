"""Pairs made in code: discs in square lots whose radius tells mu, whose share tells tau, and noise for the rest."""

from __future__ import annotations

import numpy as np

from urbanforest_cli.regression.designs import DENSITY_LEAST
from urbanforest_cli.regression.judging.predictions import LOW, RANGE, USES
from urbanforest_cli.regression.pair_table import PairTable

PX = 64
FEATURE_NOISE = (0.02, 0.6, 0.1, 0.3, 0.8, 0.8)


def disc_pairs(count: int, seed: int = 0, values=None, strategies=None) -> PairTable:
    """Draw values uniformly and show them: up to nine discs of the mean radius, so many as the density says.

    Features are the true shares with noise, and a constant.
    """
    rng = np.random.default_rng(seed)
    drawn = rng.random((count, 6))
    drawn[:, 2] = DENSITY_LEAST + (1 - DENSITY_LEAST) * drawn[:, 2]
    drawn[:, 5] = rng.integers(0, 6, count) / 5
    noise = rng.normal(0, 1, (count, 6)) * FEATURE_NOISE
    strategy = rng.integers(0, 3, count).astype(np.int8) if strategies is None else strategies
    if values is None:
        values = (LOW + drawn * RANGE).astype(np.float32)
    shares = (values - LOW) / RANGE
    windows = np.zeros((count, 3, PX, PX), np.uint8)
    row, col = np.mgrid[:PX, :PX]
    inside = (row >= 2) & (row < 62) & (col >= 2) & (col < 62)
    edge = np.minimum(np.minimum(row - 1, 62 - row), np.minimum(col - 1, 62 - col)) * 10
    windows[:, 1] = np.where(inside, 100, 0)
    windows[:, 2] = np.where(inside, np.clip(edge, 1, 120), 0)
    visible = np.round(shares[:, 2] * 9).astype(np.int32)
    for pair in range(count):
        for place in rng.permutation(9)[: visible[pair]]:
            y, x = 12 + 20 * (place // 3), 12 + 20 * (place % 3)
            windows[pair, 0][(row - y) ** 2 + (col - x) ** 2 <= float(values[pair, 0]) ** 2] = 100
    return PairTable(
        windows=windows, pixel_m=np.ones(count, np.float32),
        features=np.column_stack([shares + noise, np.ones(count)]).astype(np.float32),
        values=values, used=USES[strategy], strategy=strategy, visible=visible,
        placed=np.full(count, 9, np.int32), lot=(np.arange(count) // 2 + 100_000 * seed).astype(np.int32),
    )  # fmt: skip
