"""How far predicted parameters are from the true ones, and how far these scores would move with other lots."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.regression.judging.predictions import Floats, Mask

FIELDS = ("pairs", "error", "absolute", "squared", "within", "truth", "truth_squared")
WITHIN = 0.1
"""Share of the range that a value may be off to count as met."""
ROUNDING = 1e-9
RESAMPLES = 1000
LEVEL = 0.95
LEAST_LOTS = 8
LEAST_PAIRS = 20
"""Of fewer pairs no R2 is told: their own spread is too uncertain to divide by."""


@dataclass(frozen=True, kw_only=True)
class Score:
    """Agreement of one parameter, on the pairs whose strategy uses it; None where there is nothing to divide by.

    `one_less_nmae` is 1 less the mean absolute error, `bias` the mean error, both in shares of the range; `within` is
    the share of pairs at most `WITHIN` of the range off. The interval is of `r2`, over draws of other lots.
    """

    pairs: int
    r2: float | None
    r2_low: float | None = None
    r2_high: float | None = None
    one_less_nmae: float | None
    within: float | None
    bias: float | None


def error_sums(predicted: Floats, truth: Floats, counted: Mask, lot: NDArray[np.integer]) -> Floats:
    """Add up errors of each lot.

    Parameters
    ----------
    predicted, truth
        (n, parameter) shares of the range.
    counted
        (n, parameter) pairs that count.
    lot
        (n,) the lot that a pair belongs to.

    Returns
    -------
    (lot, parameter, field) float64
        Sums by `FIELDS`, lots in the order of their numbers.
    """
    error = predicted - truth
    fields = np.stack(
        [np.ones_like(error), error, np.abs(error), error**2, np.abs(error) <= WITHIN + ROUNDING, truth, truth**2],
        axis=-1,
    )
    numbers, index = np.unique(lot, return_inverse=True)
    sums = np.zeros((len(numbers), *fields.shape[1:]))
    np.add.at(sums, index, np.where(counted[..., None], fields, 0.0))
    return sums


def r_squared(sums: Floats) -> Floats:
    """Return 1 less squared errors over squared deviations of the truth, of sums (..., field); NaN if constant."""
    pairs, squared, truth, truth_squared = (sums[..., FIELDS.index(name)] for name in
                                            ("pairs", "squared", "truth", "truth_squared"))  # fmt: skip
    deviations = truth_squared - np.divide(truth**2, pairs, out=np.zeros_like(truth), where=pairs > 0)
    spread_out = deviations > ROUNDING * np.maximum(pairs, 1)
    return 1.0 - np.divide(squared, deviations, out=np.full_like(truth, np.nan), where=spread_out)


def score(sums: Floats, interval: tuple[float, float] | None = None) -> Score:
    """Return what follows from sums (field,), with an interval of R2 that was found elsewhere."""
    pairs, error, absolute, _, within, _, _ = (float(value) for value in sums)
    r2 = float(r_squared(sums))
    return Score(
        pairs=int(pairs),
        r2=r2 if np.isfinite(r2) and pairs >= LEAST_PAIRS else None,
        r2_low=interval[0] if interval else None,
        r2_high=interval[1] if interval else None,
        one_less_nmae=1 - absolute / pairs if pairs else None,
        within=within / pairs if pairs else None,
        bias=error / pairs if pairs else None,
    )


def resampled(by_lot: Floats, rng: np.random.Generator) -> Floats:
    """Draw as many lots as there are, with repetition, `RESAMPLES` times, and add each draw up (Efron 1979).

    Parameters
    ----------
    by_lot
        (lot, ..., field) sums; all that lies between is drawn together, so that differences between predictors are
        those of the same lots.

    Returns
    -------
    (RESAMPLES, ..., field) float64
    """
    lots = len(by_lot)
    weights = rng.multinomial(lots, np.full(lots, 1.0 / lots), size=RESAMPLES).astype(np.float64)
    return np.asarray((weights @ by_lot.reshape(lots, -1)).reshape(RESAMPLES, *by_lot.shape[1:]))


def interval(values: Floats) -> tuple[float, float] | None:
    """Return the middle `LEVEL` of resampled values; None where a draw has none."""
    if not np.isfinite(values).all():
        return None
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)
