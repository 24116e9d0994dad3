"""How many plants: the model's own count against the real one, apart from where they stand."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.stats import spearmanr

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

SQUARE_METRES_A_HECTARE = 1e4


@dataclass(frozen=True)
class CountScores:
    """Counts and densities. Everything with a real count beside it is over lots with a real plant.

    A lot without real plants may be bare or may not have been looked at, so those are kept apart.
    """

    lots: int
    lots_with_real: int
    lots_with_model: int
    real: int
    model: int
    model_in_lots_with_real: int
    total_error: float | None
    lot_error_median: float | None
    lot_error_mean: float | None
    rank_correlation: float | None
    real_per_ha: float | None
    model_per_ha: float | None


def count_scores(real: Ints, model: Ints, area_m2: Floats) -> CountScores:
    """Compare counts by lot.

    `total_error` is model / real - 1, `lot_error` is |model - real| / real of a lot.

    Parameters
    ----------
    real, model
        (lots,) plants of each lot, all of them.
    area_m2
        (lots,) areas.
    """
    seen = real > 0
    found: dict[str, float | None] = dict.fromkeys(
        ("total_error", "lot_error_median", "lot_error_mean", "rank_correlation", "real_per_ha", "model_per_ha")
    )
    if seen.any():
        error = np.abs(model[seen] - real[seen]) / real[seen]
        hectares = float(area_m2[seen].sum() / SQUARE_METRES_A_HECTARE)
        found |= {
            "total_error": float(model[seen].sum() / real[seen].sum() - 1),
            "lot_error_median": float(np.median(error)),
            "lot_error_mean": float(error.mean()),
            "real_per_ha": float(real[seen].sum() / hectares) if hectares else None,
            "model_per_ha": float(model[seen].sum() / hectares) if hectares else None,
        }
        if len(np.unique(real[seen])) > 1 and len(np.unique(model[seen])) > 1:
            found["rank_correlation"] = float(spearmanr(real[seen], model[seen]).statistic)
    return CountScores(
        lots=len(real),
        lots_with_real=int(seen.sum()),
        lots_with_model=int((model > 0).sum()),
        real=int(real.sum()),
        model=int(model.sum()),
        model_in_lots_with_real=int(model[seen].sum()),
        **found,
    )
