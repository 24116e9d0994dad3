"""What "95 % accuracy" may mean: one set of predictions under every reading of the word.

The paper (section Data and Training) gives the figure and not the measure. Some measures say 95 % of a predictor that
knows nothing, so that each stands beside the mean predictor's.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from urbanforest_cli.regression.judging.predictions import LOW, RANGE, USES, Floats, Mask, Prediction
from urbanforest_cli.regression.judging.scores import ROUNDING, WITHIN, error_sums, r_squared
from urbanforest_cli.regression.pair_table import PairTable

STRATEGY_SHARE = 1 / 3
"""How likely each strategy is to a predictor that tells none."""
Reading = Callable[[Prediction, Floats, Mask], float]


def readings(predictions: Mapping[str, Prediction], truth: Floats, table: PairTable) -> dict[str, dict[str, float]]:
    """Return the value of each reading for each predictor, by the name of both.

    Parameters
    ----------
    predictions
        Of the same pairs.
    truth
        (n, 6) shares of the range.
    table
        The pairs; parameters that their strategy does not use hold the values that were drawn.
    """
    return {
        text: {name: read(prediction, truth, table.used) for name, prediction in predictions.items()}
        for text, read in _READINGS.items()
    }


def _mean_r2(prediction: Prediction, truth: Floats, used: Mask) -> float:
    return float(np.mean(r_squared(error_sums(prediction.values, truth, used, np.zeros(len(truth), np.int64))[0])))


def _one_less_nmae(prediction: Prediction, truth: Floats, used: Mask) -> float:
    return float(np.mean(_by_parameter(1 - np.abs(prediction.values - truth), used)))


def _within(prediction: Prediction, truth: Floats, used: Mask) -> float:
    near = np.abs(prediction.values - truth) <= WITHIN + ROUNDING
    return float(np.mean(_by_parameter(near.astype(np.float64), used)))


def _one_less_mse(prediction: Prediction, truth: Floats, used: Mask) -> float:
    return float(np.mean(_by_parameter(1 - (prediction.values - truth) ** 2, used)))


def _unused_zero(prediction: Prediction, truth: Floats, used: Mask) -> float:
    return float(1 - np.mean(np.abs(_emptied(prediction) - np.where(used, truth, 0.0))))


def _unused_drawn(prediction: Prediction, truth: Floats, used: Mask) -> float:
    return float(1 - np.mean(np.abs(prediction.values - truth)))


def _mse_unused_zero(prediction: Prediction, truth: Floats, used: Mask) -> float:
    return float(1 - np.mean((_emptied(prediction) - np.where(used, truth, 0.0)) ** 2))


def _mse_unused_drawn(prediction: Prediction, truth: Floats, used: Mask) -> float:
    return float(1 - np.mean((prediction.values - truth) ** 2))


def _largest(prediction: Prediction, truth: Floats, used: Mask) -> float:
    values, wanted = prediction.values * RANGE + LOW, truth * RANGE + LOW
    return float(np.mean(values.argmax(axis=1) == wanted.argmax(axis=1)))


def _largest_unused_zero(prediction: Prediction, truth: Floats, used: Mask) -> float:
    # a parameter that is not used stands at 0 in its unit too
    values, wanted = prediction.values * RANGE + LOW, np.where(used, truth * RANGE + LOW, 0.0)
    return float(np.mean((values * _used_share(prediction)).argmax(axis=1) == wanted.argmax(axis=1)))


def _by_parameter(values: Floats, used: Mask) -> Floats:
    return np.asarray(np.where(used, values, 0.0).sum(axis=0) / np.maximum(used.sum(axis=0), 1))


def _emptied(prediction: Prediction) -> Floats:
    """Return values with 0 where the likeliest strategy uses none; shrunk where no strategy is told."""
    return np.asarray(prediction.values * _used_share(prediction))


def _used_share(prediction: Prediction) -> Floats:
    if prediction.strategy is None:
        return np.tile((USES * STRATEGY_SHARE).sum(axis=0), (len(prediction.values), 1))
    return np.asarray(USES[prediction.strategy.argmax(axis=1)], dtype=np.float64)


_READINGS: dict[str, Reading] = {
    "mean R2, parameters in use": _mean_r2,
    "mean 1 - NMAE, in use": _one_less_nmae,
    "within 10 % of the range, in use": _within,
    "1 - NMAE, all pairs, unused set to 0": _unused_zero,
    "1 - NMAE, all pairs, unused as drawn": _unused_drawn,
    "largest of six named, raw units, unused set to 0": _largest_unused_zero,
    "largest of six named, raw units, unused as drawn": _largest,
    "1 - MSE, in use": _one_less_mse,
    "1 - MSE, all pairs, unused set to 0": _mse_unused_zero,
    "1 - MSE, all pairs, unused as drawn": _mse_unused_drawn,
}
