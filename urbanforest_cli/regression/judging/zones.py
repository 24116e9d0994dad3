"""What is won when several lots are known to share their parameters, as those of a zone do."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.evidence import exponents
from urbanforest_cli.regression.judging.calibration import central_coverage, ranks_of
from urbanforest_cli.regression.judging.predictions import (
    COUNTS,
    EVEN,
    LOW,
    RANGE,
    USES,
    Floats,
    Mask,
    Prediction,
)
from urbanforest_cli.regression.judging.scores import error_sums, r_squared

SIZES = (1, 2, 4, 8)


@dataclass(frozen=True, kw_only=True)
class ZonePooling:
    """R2 of each parameter and their mean when so many lots are pooled, and truths in the 68 % intervals if any."""

    lots: int
    r2: dict[str, float]
    mean_r2: float
    covered_68: dict[str, float] | None


def drawn_zones(zones: int, rng: np.random.Generator) -> tuple[Floats, NDArray[np.int8]]:
    """Draw the values (n, 6) and strategies (n,) of zones of as many lots as the largest of `SIZES`, lot after lot."""
    drawn = rng.random((zones, len(REGRESSED)))
    values = EVEN.values(drawn)
    values[:, COUNTS] = np.round(values[:, COUNTS])
    strategy = rng.integers(len(USES), size=zones)
    return np.repeat(values, SIZES[-1], axis=0), np.repeat(strategy, SIZES[-1]).astype(np.int8)


def zone_poolings(
    predictions: Mapping[str, Prediction], truth: Floats, used: Mask, rng: np.random.Generator
) -> dict[str, list[ZonePooling]]:
    """Pool the first lots of each zone, for each of `SIZES`.

    Predictions with spreads are multiplied, with the prior counted once; others are averaged.

    Parameters
    ----------
    predictions
        By predictor, of the pairs made with `drawn_zones`.
    truth, used
        (n, 6) of these pairs, the same within a zone.
    rng
        See `calibration.ranks_of`.
    """
    most = SIZES[-1]
    wanted, counted = truth[::most], used[::most]
    lot = np.zeros(len(wanted), np.int64)
    found: dict[str, list[ZonePooling]] = {}
    for name, prediction in predictions.items():
        values = prediction.values.reshape(-1, most, len(REGRESSED))
        spreads = None if prediction.spreads is None else prediction.spreads.reshape(values.shape)
        found[name] = []
        for size in SIZES:
            mean, spread = pooled(values[:, :size], None if spreads is None else spreads[:, :size])
            r2 = r_squared(error_sums(mean, wanted, counted, lot)[0])
            covered = None
            if spread is not None:
                ranks = ranks_of(mean, spread, wanted, rng)
                covered = {
                    parameter: central_coverage(ranks[counted[:, number], number], (0.68,))[0]
                    for number, parameter in enumerate(REGRESSED)
                }
            found[name].append(ZonePooling(
                lots=size, r2={parameter: float(one) for parameter, one in zip(REGRESSED, r2, strict=True)},
                mean_r2=float(r2.mean()), covered_68=covered,
            ))  # fmt: skip
    return found


def pooled(values: Floats, spreads: Floats | None) -> tuple[Floats, Floats | None]:
    """Pool means (zone, lot, 6) and spreads into one of each a zone, (zone, 6).

    Spreads tell likelihoods, see `regression.evidence`, whose exponents add up; the uniform prior counts once.
    """
    if spreads is None:
        return values.mean(axis=1), None
    told = exponents(EVEN.shares(values * RANGE + LOW), EVEN.share_spreads(spreads * RANGE))
    low, high = (1 + part.sum(axis=1) for part in told)
    mean, spread = low / (low + high), np.sqrt(low * high / (low + high + 1)) / (low + high)
    return (EVEN.values(mean) - LOW) / RANGE, EVEN.value_spreads(spread) / RANGE
