"""The vegetation index of images with a near-infrared band, its threshold and the label made of both."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import UNKNOWN

INDEX_BINS = 512
SOFTNESS = 0.03
"""Difference in NDVI over which the vegetation label goes from 50 to 73 percent."""


def ndvi(nir: NDArray[np.uint8], red: NDArray[np.uint8]) -> NDArray[np.float32]:
    """Return the vegetation index (nir - red) / (nir + red), -1 to 1; 0 where both bands are 0."""
    near, low = nir.astype(np.float32), red.astype(np.float32)
    total = near + low
    return np.asarray(np.divide(near - low, total, out=np.zeros_like(total), where=total > 0))


def ndvi_histogram(index: NDArray[np.float32], valid: NDArray[np.bool_]) -> NDArray[np.int64]:
    """Count valid pixels in 512 equal bins from -1 to 1; histograms of several images add up."""
    cells = np.minimum(((index[valid] + 1.0) * (INDEX_BINS / 2)).astype(np.int64), INDEX_BINS - 1)
    return np.bincount(cells, minlength=INDEX_BINS).astype(np.int64)


def otsu_threshold(histogram: NDArray[np.int64]) -> float:
    """Return the NDVI that parts a histogram of `ndvi_histogram` with the largest variance between its sides.

    Otsu 1979, equation 18. Where several part it equally well (an empty valley), their middle; where all values are
    alike, that value; 0 where nothing was counted.
    """
    edges = np.arange(1, INDEX_BINS + 1) * 2.0 / INDEX_BINS - 1.0
    below = np.cumsum(histogram).astype(np.float64)
    above = below[-1] - below
    moment = np.cumsum(histogram * (edges - 1.0 / INDEX_BINS))
    parted = (below > 0) & (above > 0)
    if not parted.any():
        return float(moment[-1] / below[-1]) if below[-1] else 0.0
    gap = moment / np.maximum(below, 1.0) - (moment[-1] - moment) / np.maximum(above, 1.0)
    between = np.where(parted, below * above * gap**2, -1.0)
    return float(edges[between >= between.max() * (1.0 - 1e-12)].mean())


def vegetation_label(
    index: NDArray[np.float32], threshold: float, valid: NDArray[np.bool_] | None = None
) -> NDArray[np.uint8]:
    """Return how sure a pixel is vegetation, the logistic of (NDVI - threshold) / 0.03 in percent; 255 if not valid."""
    percent = np.rint(100.0 * greenness(index, threshold)).astype(np.uint8)
    return percent if valid is None else np.where(valid, percent, np.uint8(UNKNOWN))


def greenness(index: NDArray[np.float32], threshold: float) -> NDArray[np.float32]:
    """Return the same as a fraction."""
    return logistic((index - np.float32(threshold)) / np.float32(SOFTNESS))


def logistic(values: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return 1 / (1 + exp(-values)), safe from overflow."""
    return np.asarray(1.0 / (1.0 + np.exp(-np.clip(values, -30.0, 30.0))), np.float32)
