"""How near means come to the truth, parameter by parameter, on the pairs whose strategy uses it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.schema import REGRESSED

Floats = NDArray[np.float64]
Used = NDArray[np.bool_]


def r2_by_parameter(mean: Floats, share: Floats, used: Used) -> dict[str, float]:
    """Return 1 less the squared error over the variance, of (pair, parameter) shares of the range; 0 without pairs."""
    found = {}
    for number, name in enumerate(REGRESSED):
        rows = used[:, number]
        variance = float(np.var(share[rows, number])) if rows.any() else 0.0
        error = float(np.mean((mean[rows, number] - share[rows, number]) ** 2)) if rows.any() else 0.0
        found[name] = 1.0 - error / variance if variance > 0 else 0.0
    return found


def errors_by_parameter(mean: Floats, share: Floats, used: Used) -> Floats:
    """Return (parameter,) root mean squared errors in shares of the range; that of knowing nothing without pairs."""
    squared = np.where(used, (mean - share) ** 2, 0.0).sum(axis=0)
    count = used.sum(axis=0)
    return np.asarray(np.sqrt(np.where(count > 0, squared / np.maximum(count, 1), 1.0 / 12.0)))


def nearness_by_parameter(mean: Floats, share: Floats, used: Used) -> dict[str, float]:
    """Return 1 less the mean absolute error in shares of the range."""
    return {
        name: 1.0 - float(np.mean(np.abs(mean[rows, number] - share[rows, number]))) if rows.any() else 0.0
        for number, name in enumerate(REGRESSED)
        for rows in [used[:, number]]
    }
