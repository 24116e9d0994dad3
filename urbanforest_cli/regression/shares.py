"""Values as shares of the range that a network was trained on, and back."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.schema import REGRESSED

Floats = NDArray[np.float64]


class Ranges:
    """From which value to which each of the REGRESSED parameters goes.

    A count fills the half below and above it, so that all counts of the range being equally likely is the uniform
    distribution from 0 to 1, as it is for other parameters.
    """

    def __init__(self, low: Sequence[float], high: Sequence[float]) -> None:
        counted = np.array([PARAMETERS[name].kind == "count" for name in REGRESSED])
        self._low, self._high = np.asarray(low, dtype=np.float64), np.asarray(high, dtype=np.float64)
        self._start = self._low - 0.5 * counted
        self._width = self._high - self._low + counted
        self._dither = counted / 12

    def shares(self, values: Floats) -> Floats:
        """Return (lot, parameter) values as shares; those outside the range are below 0 or above 1."""
        return np.asarray((values - self._start) / self._width)

    def share_spreads(self, spreads: Floats) -> Floats:
        """Return (lot, parameter) standard deviations of values as those of shares."""
        return np.asarray(np.sqrt(spreads**2 + self._dither) / self._width)

    def values(self, shares: Floats) -> Floats:
        """Return shares as values, none outside the range."""
        return np.asarray(np.clip(self._start + shares * self._width, self._low, self._high))

    def value_spreads(self, share_spreads: Floats) -> Floats:
        """Return standard deviations of shares as those of values."""
        return np.asarray(np.sqrt(np.maximum((share_spreads * self._width) ** 2 - self._dither, 0.0)))
