"""Classical measures of a coverage window: how much, how wide its blobs, how far apart, how deep in the lot."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_closing, distance_transform_edt, generate_binary_structure, label, maximum_filter
from scipy.spatial import cKDTree

from urbanforest_cli.regression.judging.predictions import Floats

MEASURES = (
    "area_fraction", "blob_radius_m", "blob_radius_variance_m2", "depth_radius_m", "depth_radius_variance_m2",
    "nearest_m", "edge_depth_m", "reach_m", "groups",
)  # fmt: skip
"""Covered share of the plantable ground; radii of discs of the blobs' areas; radii of the largest discs that fit where
blobs are widest; distance between such places; distance to the lot's edge that 95 % of the cover stays below; root mean
squared distance of covered ground from its middle; blobs left when gaps of 4 m are closed."""
COVERED_PERCENT = 50
GAP_M = 4.0
DECIMETRES = 10.0
EIGHT = generate_binary_structure(2, 2)


def blob_measures(windows: NDArray[np.uint8], pixel_m: NDArray[np.float32]) -> Floats:
    """Measure the coverage inside each lot.

    Parameters
    ----------
    windows
        (n, 3, rows, cols) as of `PairTable`.
    pixel_m
        (n,) side of a pixel.

    Returns
    -------
    (n, measure) float64
        In the order of `MEASURES`; 0 for what a window without coverage does not have.
    """
    rows = [_measure(window, float(pixel)) for window, pixel in zip(windows, pixel_m, strict=True)]
    return np.array(rows, dtype=np.float64).reshape(len(windows), len(MEASURES))


def _measure(window: NDArray[np.uint8], pixel_m: float) -> tuple[float, ...]:
    coverage, ground, edge = window
    inside = edge > 0
    percent = np.where(inside, coverage, 0)
    mask = percent >= COVERED_PERCENT
    if not mask.any():
        return (0.0,) * len(MEASURES)
    fraction = percent.sum(dtype=np.int64) / max(int(ground.sum(dtype=np.int64)), 1)
    blob, count = label(mask, EIGHT)
    area = np.bincount(blob[mask], weights=percent[mask] / 100.0, minlength=count + 1)[1:] * pixel_m**2
    radius = np.sqrt(area / np.pi)
    depth = distance_transform_edt(np.pad(mask, 1))[1:-1, 1:-1] * pixel_m
    peak = mask & (depth == maximum_filter(depth, size=3))
    place, peaks = label(peak, EIGHT)
    first = np.unique(place[peak], return_index=True)[1]
    row, col = (index[first] * pixel_m for index in np.nonzero(peak))
    widest = depth[peak][first]
    nearest = 0.0
    if peaks > 1:
        nearest = float(
            np.median(cKDTree(np.column_stack([row, col])).query(np.column_stack([row, col]), k=2)[0][:, 1])
        )
    all_row, all_col = (index * pixel_m for index in np.nonzero(mask))
    reach = float(np.sqrt(all_row.var() + all_col.var()))
    steps = max(round(GAP_M / 2 / pixel_m), 1)
    groups = label(binary_closing(np.pad(mask, steps + 1), EIGHT, iterations=steps), EIGHT)[1]
    return (
        fraction, float(radius.mean()), float(radius.var()), float(widest.mean()), float(widest.var()), nearest,
        float(np.quantile(edge[mask], 0.95)) / DECIMETRES, reach, float(groups),
    )  # fmt: skip
