"""What predictors say of pairs, in shares of each parameter's range."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.parameter_model import STRATEGIES_READ
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.designs import DENSITY_LEAST
from urbanforest_cli.regression.pair_table import PairTable
from urbanforest_cli.regression.shares import Ranges

Floats = NDArray[np.float64]
Mask = NDArray[np.bool_]

LOW: Floats = np.array([PARAMETERS[name].low for name in REGRESSED])
RANGE: Floats = np.array([PARAMETERS[name].high - PARAMETERS[name].low for name in REGRESSED])
COUNTS: Mask = np.array([PARAMETERS[name].kind == "count" for name in REGRESSED])
"""Parameters whose values are whole numbers."""
USES: Mask = np.array([[strategy in PARAMETERS[name].strategies for name in REGRESSED] for strategy in STRATEGIES_READ])
"""(strategy, parameter) whether the one uses the other."""
DRAWN_LOW: Floats = np.where(np.array(REGRESSED) == "density", DENSITY_LEAST, LOW)
"""Where values of pairs begin; they go to the end of the range."""
EVEN = Ranges([*DRAWN_LOW], [*(LOW + RANGE)])
"""Shares in which all values drawn are equally likely; a whole number fills a cell."""
PRIOR_MEANS: Floats = (EVEN.values(np.full((1, len(REGRESSED)), 0.5))[0] - LOW) / RANGE
PRIOR_SPREADS: Floats = EVEN.value_spreads(np.full((1, len(REGRESSED)), 12**-0.5))[0] / RANGE
"""Means and standard deviations of the values drawn, in shares of the range."""


@dataclass(frozen=True)
class Prediction:
    """What one predictor says of n pairs.

    Parameters
    ----------
    values
        (n, 6) means, 0 and 1 the ends of the ranges, in the order of `core.schema.REGRESSED`.
    spreads
        (n, 6) standard deviations in the same unit, or None of a predictor that tells none.
    strategy
        (n, 3) probabilities in the order of `core.parameter_model.STRATEGIES_READ`, or None.
    """

    values: Floats
    spreads: Floats | None = None
    strategy: Floats | None = None

    def take(self, rows: NDArray[np.int64]) -> Prediction:
        """Return what is said of some of the pairs."""
        return Prediction(
            self.values[rows],
            None if self.spreads is None else self.spreads[rows],
            None if self.strategy is None else self.strategy[rows],
        )


Predictor = Callable[[PairTable], Prediction]


def shares(values: NDArray[np.floating]) -> Floats:
    """Return values (n, 6) in their units as shares of their ranges."""
    return np.asarray((values.astype(np.float64) - LOW) / RANGE)
