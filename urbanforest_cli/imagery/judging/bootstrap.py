"""How far a score would move had other places been looked at: bootstrap over places (Efron 1979)."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.imagery.judging.scores import iou

Floats = NDArray[np.float64]

RESAMPLES = 2000
LEVEL = 0.95
LEAST_PLACES = 2


def sums_by_place(counts: NDArray[np.int64], places: Sequence[str]) -> NDArray[np.int64]:
    """Add up counts (tile, ...) that belong to one place, for tiles of it are no evidence of their own.

    Returns
    -------
    (place, ...) int64
        Places in the order of their names.
    """
    names, index = np.unique(np.asarray(places, dtype=object).astype(str), return_inverse=True)
    sums = np.zeros((len(names), *counts.shape[1:]), dtype=np.int64)
    np.add.at(sums, index, counts)
    return sums


def resampled_iou(by_place: NDArray[np.int64], rng: np.random.Generator) -> Floats:
    """Draw as many places as there are, with repetition, `RESAMPLES` times, and score each draw.

    Parameters
    ----------
    by_place
        (place, ..., 4) counts by `scores.FIELDS`; all that lies between is drawn together, so that differences
        between predictors are those of the same places.

    Returns
    -------
    (RESAMPLES, ...) float64
    """
    places = len(by_place)
    weights = rng.multinomial(places, np.full(places, 1.0 / places), size=RESAMPLES)
    drawn = weights.astype(np.float64) @ by_place.reshape(places, -1).astype(np.float64)
    return iou(drawn.reshape(RESAMPLES, *by_place.shape[1:]))


def interval(values: Floats) -> tuple[float, float] | None:
    """Return the middle `LEVEL` of resampled values; None where a draw has none."""
    if not np.isfinite(values).all():
        return None
    low, high = np.quantile(values, [(1 - LEVEL) / 2, (1 + LEVEL) / 2])
    return float(low), float(high)
