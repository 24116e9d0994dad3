"""How well a predicted coverage agrees with the truth: confusion of pixels, what follows from it, and trees held."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import maximum_filter

from urbanforest_cli.core.coverage_model import UNKNOWN

Mask = NDArray[np.bool_]
Ints = NDArray[np.int64]
Floats = NDArray[np.float64]

TRUTH_LEAST_PERCENT = 50
"""A pixel of the truth counts as covered from this share on."""
NEAR_PX = 1
"""A tree is near a covered pixel that lies at most so many rows and columns away."""
FIELDS = ("both", "predicted_only", "truth_only", "neither")
TREE_FIELDS = ("trees", "on", "near")


def hard_truth(truth: NDArray[np.uint8]) -> tuple[Mask, Mask]:
    """Return where a truth in percent is covered, and where it is known, each of the truth's shape."""
    return (truth >= TRUTH_LEAST_PERCENT) & (truth != UNKNOWN), truth != UNKNOWN


def confusion(predicted: Mask, truth: Mask, known: Mask) -> Ints:
    """Count the known pixels by `FIELDS`.

    Parameters
    ----------
    predicted, truth, known
        (rows, cols); pixels that are not known count nowhere.

    Returns
    -------
    (4,) int64
    """
    code = 2 * predicted[known].astype(np.uint8) + truth[known]
    neither, truth_only, predicted_only, both = np.bincount(code, minlength=4)
    return np.array([both, predicted_only, truth_only, neither], dtype=np.int64)


def tree_hits(covered: Mask, known: Mask, trees_px: Floats) -> Ints:
    """Count annotated trees by `TREE_FIELDS`: all on known pixels, those on covered ones, those near covered ones.

    Parameters
    ----------
    covered, known
        (rows, cols).
    trees_px
        (n, 2) row and column of each tree, in pixels from the outer corner of the first pixel, whose middle is at
        0.5; trees outside the image or where nothing is known are left out.
    """
    rows, cols = covered.shape
    cells = np.floor(trees_px[np.isfinite(trees_px).all(axis=1)]).astype(np.int64)
    inside = (cells >= 0).all(axis=1) & (cells[:, 0] < rows) & (cells[:, 1] < cols)
    row, col = cells[inside].T
    seen = known[row, col]
    row, col = row[seen], col[seen]
    covered = covered & known
    near = maximum_filter(covered, size=2 * NEAR_PX + 1, mode="constant")
    return np.array([len(row), covered[row, col].sum(), near[row, col].sum()], dtype=np.int64)


def iou(counts: NDArray[np.integer] | Floats) -> Floats:
    """Return intersection over union of counts (..., 4), not a number where neither truth nor prediction cover."""
    both, predicted_only, truth_only, _ = np.moveaxis(np.asarray(counts, dtype=np.float64), -1, 0)
    union = both + predicted_only + truth_only
    return np.asarray(np.divide(both, union, out=np.full_like(union, np.nan), where=union > 0))


@dataclass(frozen=True, kw_only=True)
class Score:
    """Agreement over some pixels; None where there is nothing to divide by.

    `bias` is the predicted minus the true share of the area. `trees_on` is the share of the annotated trees whose
    point lies on a covered pixel, `trees_near` of those with a covered pixel within `NEAR_PX` of theirs. The interval
    is of `iou`, see `bootstrap`.
    """

    pixels: int
    iou: float | None
    iou_low: float | None = None
    iou_high: float | None = None
    f1: float | None
    accuracy: float | None
    precision: float | None
    recall: float | None
    truth_share: float | None
    predicted_share: float | None
    bias: float | None
    trees: int = 0
    trees_on: float | None = None
    trees_near: float | None = None


def score(
    counts: NDArray[np.integer], hits: NDArray[np.integer] | None = None, interval: tuple[float, float] | None = None
) -> Score:
    """Return what follows from counts by `FIELDS` and `TREE_FIELDS`, with an interval that was found elsewhere."""
    both, predicted_only, truth_only, neither = (int(value) for value in counts)
    pixels = both + predicted_only + truth_only + neither
    predicted, truth = both + predicted_only, both + truth_only
    trees, on, near = (int(value) for value in hits) if hits is not None else (0, 0, 0)
    return Score(
        pixels=pixels,
        iou=_share(both, both + predicted_only + truth_only),
        iou_low=interval[0] if interval else None,
        iou_high=interval[1] if interval else None,
        f1=_share(2 * both, predicted + truth),
        accuracy=_share(both + neither, pixels),
        precision=_share(both, predicted),
        recall=_share(both, truth),
        truth_share=_share(truth, pixels),
        predicted_share=_share(predicted, pixels),
        bias=_share(predicted - truth, pixels),
        trees=trees,
        trees_on=_share(on, trees),
        trees_near=_share(near, trees),
    )


def _share(part: int, whole: int) -> float | None:
    return part / whole if whole else None
