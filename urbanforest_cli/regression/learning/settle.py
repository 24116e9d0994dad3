"""What is done with a network once its weights are learnt: its spreads set right, and its figures taken."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.parameter_input import network_input
from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.learning.samples import HIGH, LEVELS, LOW, STREAM, Parted, shares, spread_shares
from urbanforest_cli.regression.learning.scores import errors_by_parameter, nearness_by_parameter, r2_by_parameter
from urbanforest_cli.regression.learning.sheets import Said
from urbanforest_cli.regression.learning.sureness import INTERVALS, interval_shares, scaled_weight, sureness
from urbanforest_cli.regression.pair_table import PairTable

if TYPE_CHECKING:
    from urbanforest_cli.regression.learning.training import Trainer

DIGITS = 5


def figures(trainer: Trainer, pairs: PairTable) -> dict[str, Any]:
    """Return R2 and 1 less the mean absolute error by parameter, and the share of strategies told."""
    stated = trainer.state_of(pairs)
    mean = np.clip(stated.mean * _stretch() - _shift() if stated.weight.any() else stated.mean, 0.0, 1.0)
    share = shares(pairs.values).astype(np.float64)
    found: dict[str, Any] = {
        "r2": r2_by_parameter(mean, share, pairs.used),
        "nearness": nearness_by_parameter(mean, share, pairs.used),
    }
    if stated.logits.any():
        found["strategies_right"] = float(np.mean(stated.logits.argmax(axis=1) == pairs.strategy))
    return found


def settle(trainer: Trainer, parts: Parted) -> dict[str, Any]:
    """Set a network's spreads right by the calibration pairs, and score it on the validation pairs.

    The paper's network gets its root mean squared errors as spreads; another one's concentrations are scaled so that
    central intervals hold what they say.
    """
    from urbanforest_cli.regression.learning.network import InformedNetwork

    stated = trainer.state_of(parts.calibration)
    scores: dict[str, Any] = {"validation": _rounded(figures(trainer, parts.validation)), "sureness": {}}
    if not isinstance(trainer.network, InformedNetwork):
        errors = errors_by_parameter(
            stated.mean, shares(parts.calibration.values).astype(np.float64), parts.calibration.used
        )
        trainer.network.set_spread(errors)
        return scores
    factors, powers = sureness(stated.mean, stated.weight, _truth(parts.calibration), parts.calibration.used)
    trainer.network.set_sureness(factors, powers)
    judged, truth = trainer.state_of(parts.validation), _truth(parts.validation)
    scores["validation"]["intervals"] = {}
    for number, name in enumerate(REGRESSED):
        rows = parts.validation.used[:, number]
        weight = scaled_weight(judged.weight[rows, number], factors[number], powers[number])
        held = interval_shares(judged.mean[rows, number], weight, truth[rows, number])
        scores["validation"]["intervals"][name] = _rounded(dict(zip(map(str, INTERVALS), held.tolist(), strict=True)))
        scores["sureness"][name] = _rounded([float(factors[number]), float(powers[number])])
    return scores


def said_of(trainer: Trainer, pairs: PairTable) -> Said:
    """Return what the network states of pairs, in units."""
    from urbanforest_cli.regression.learning.network import readings

    trainer.network.eval()
    window = network_input(pairs.windows, pairs.pixel_m)
    value, spread, strategy = readings(trainer.network, window, pairs.features)
    low, width = np.array(LOW), np.array(HIGH) - np.array(LOW)
    return Said(value * width + low, spread * width, strategy.astype(np.float64))


def _truth(pairs: PairTable) -> NDArray[np.float64]:
    """Return true shares with whole numbers spread over their parts, always alike."""
    within = rng_for(0, f"{STREAM} parts of whole numbers", "").random((len(pairs), 1), dtype=np.float32)
    return spread_shares(shares(pairs.values), within).astype(np.float64)


def _stretch() -> NDArray[np.float64]:
    parts = np.maximum(LEVELS, 1.0)
    return np.asarray(np.where(LEVELS > 0, (parts + 1.0) / parts, 1.0), np.float64)


def _shift() -> NDArray[np.float64]:
    return np.asarray(np.where(LEVELS > 0, 0.5 / np.maximum(LEVELS, 1.0), 0.0), np.float64)


def _rounded(value: Any) -> Any:
    if isinstance(value, dict):
        return {name: _rounded(one) for name, one in value.items()}
    if isinstance(value, list):
        return [_rounded(one) for one in value]
    return round(value, DIGITS)
