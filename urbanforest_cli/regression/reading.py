"""What a network says of windows of lots, and what can be told without it."""

from __future__ import annotations

from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.lot_windows import LotWindows
from urbanforest_cli.core.parameter_model import ParameterModelInfo
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.evidence import Evidence, evidence_of
from urbanforest_cli.regression.features import FEATURES, features_of, network_windows
from urbanforest_cli.regression.shares import Ranges

WINDOWS_A_RUN = 64
"""The network always runs on this many, filled up with empty ones: what it says of one knows none of the others."""
PLANTS = "crown_count_log"
"""Feature that counts the plants that can be told apart in a window, the logarithm of one more."""


class Network(Protocol):
    """A network that can be asked."""

    def predict(
        self, windows: NDArray[np.uint8], pixel_m: NDArray[np.float32], features: NDArray[np.float32]
    ) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.float64]]:
        """Return values and spreads in units, (n, parameter), and probabilities of strategies, (n, 3)."""


def ranges_of(info: ParameterModelInfo) -> Ranges:
    """Return the ranges that a model was trained on, in the order of REGRESSED."""
    order = [info.parameters.index(name) for name in REGRESSED]
    return Ranges([info.low[i] for i in order], [info.high[i] for i in order])


def read_windows(
    network: Network, info: ParameterModelInfo, windows: LotWindows, lots: int
) -> tuple[Evidence, NDArray[np.float64]]:
    """Return what the windows of some lots say, and the density read off each lot in its unit, 0 of lots without.

    Parameters
    ----------
    lots
        How many there are; `windows.owner` is their row.
    """
    features = features_of(windows)
    asked = np.ascontiguousarray(features[:, [FEATURES.index(name) for name in info.features]])
    values, spreads, strategy = _in_runs(network, network_windows(windows), _pixels(windows), asked)
    order = [info.parameters.index(name) for name in REGRESSED]
    ranges = ranges_of(info)
    logs = features[:, FEATURES.index(PLANTS)].astype(np.float64)
    visible = np.asarray(np.rint(np.exp(logs) - 1), dtype=np.float64)
    evidence = evidence_of(
        windows.owner, lots,
        np.round(ranges.shares(values[:, order]), 4), np.round(ranges.share_spreads(spreads[:, order]), 4),
        np.round(strategy, 4), visible,
    )  # fmt: skip
    count = np.maximum(np.bincount(windows.owner, minlength=lots), 1)
    density = values[:, order[REGRESSED.index("density")]]
    return evidence, np.round(np.bincount(windows.owner, density, minlength=lots) / count, 4)


def _pixels(windows: LotWindows) -> NDArray[np.float32]:
    """Return the pixels of what the network sees, which are twice as wide."""
    return (windows.pixel_m * 2).astype(np.float32)


def _in_runs(
    network: Network, windows: NDArray[np.uint8], pixel_m: NDArray[np.float32], features: NDArray[np.float32]
) -> list[NDArray[np.float64]]:
    parts = []
    for start in range(0, len(windows), WINDOWS_A_RUN):
        rows = slice(start, start + WINDOWS_A_RUN)
        some = len(windows[rows])
        filled = [
            np.concatenate((column[rows], np.repeat(column[:1], WINDOWS_A_RUN - some, axis=0)))
            for column in (windows, pixel_m, features)
        ]
        parts.append([answer[:some] for answer in network.predict(*filled)])
    widths = (len(REGRESSED), len(REGRESSED), 3)
    if not parts:
        return [np.zeros((0, width)) for width in widths]
    return [np.concatenate(column) for column in zip(*parts, strict=True)]


def bare_shares(windows: LotWindows, lots: int) -> NDArray[np.float64]:
    """Return the share of each lot that nothing covers, as its windows show it; 1 where there are none."""
    own = windows.lot.astype(np.float64)
    bare = (own * (100.0 - windows.coverage)).sum(axis=(1, 2)) / 100.0
    ground = np.bincount(windows.owner, own.sum(axis=(1, 2)) * windows.pixel_m**2, minlength=lots)
    open_ = np.bincount(windows.owner, bare * windows.pixel_m**2, minlength=lots)
    return np.asarray(np.where(ground > 0, open_ / np.maximum(ground, 1e-9), 1.0))
