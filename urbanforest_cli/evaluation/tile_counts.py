"""How many plants in each tile of the ground: the model's count against the real one."""

from __future__ import annotations

from dataclasses import asdict, dataclass

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.stats import spearmanr

Floats = NDArray[np.float64]


@dataclass(frozen=True)
class TileCounts:
    """Counts by tile, and what they say over the tiles with a real plant.

    A plant on the border of two tiles counts in both. A tile without real plants may not have been looked at; its
    placed plants are in `model` alone.

    Parameters
    ----------
    ratio
        Placed over real plants.
    correlation, rank_correlation
        Pearson's and Spearman's, of both counts.
    error_mean
        Mean of |placed - real|, in plants.
    """

    tiles: int
    tiles_with_real: int
    real: list[int]
    model: list[int]
    ratio: float | None = None
    correlation: float | None = None
    rank_correlation: float | None = None
    error_mean: float | None = None

    def as_record(self) -> dict[str, object]:
        """Return plain values for JSON."""
        return asdict(self)


def tile_counts(tiles: NDArray[np.object_], real: Floats, model: Floats) -> TileCounts:
    """Count plants in tiles.

    Parameters
    ----------
    tiles
        Polygons in metres.
    real, model
        (n, 2) positions in metres.
    """
    tree = shapely.STRtree(tiles)
    of_real, of_model = (
        np.bincount(tree.query(shapely.points(xy), predicate="intersects")[1], minlength=len(tiles))
        for xy in (real, model)
    )
    seen = of_real > 0
    found: dict[str, float | None] = {}
    if seen.any():
        x, y = of_real[seen].astype(float), of_model[seen].astype(float)
        found = {"ratio": float(y.sum() / x.sum()), "error_mean": float(np.abs(y - x).mean())}
        if len(np.unique(x)) > 1 and len(np.unique(y)) > 1:
            found["correlation"] = float(np.corrcoef(x, y)[0, 1])
            found["rank_correlation"] = float(spearmanr(x, y).statistic)
    return TileCounts(len(tiles), int(seen.sum()), of_real.tolist(), of_model.tolist(), **found)
