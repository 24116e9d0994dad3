"""The compiled loop over windows that writes all features of each."""

from __future__ import annotations

from typing import Any

import numpy as np
from numba import njit

from urbanforest_cli.core.distance_kernel import distances_to
from urbanforest_cli.regression.crown_features_kernel import crown_features
from urbanforest_cli.regression.crowns_kernel import COLUMNS, find_crowns
from urbanforest_cli.regression.features_kernel import HAND_COUNT, hand_features

kernel: Any = njit(cache=True, nogil=True)

CROWNS_MOST = 4096
DEPTH_MOST_M = 15.0


@kernel
def write_features(coverage, lot, ground, edge_dm, pixel_m, lot_area_m2, ground_area_m2, out):
    """Write the features of windows, (n, feature) float32, those of `hand_features` before those of crowns."""
    count, height, width = coverage.shape
    mask, labels = np.empty((height, width), np.bool_), np.empty((height, width), np.int32)
    stack, distance = np.empty(height * width, np.int64), np.empty((height, width), np.float32)
    bare, depth = np.empty((height, width), np.bool_), np.empty((height, width), np.float32)
    other = np.empty((height, width), np.float32)
    crowns = np.empty((CROWNS_MOST, COLUMNS))
    for window in range(count):
        for row in range(height):
            for col in range(width):
                bare[row, col] = coverage[window, row, col] < 50
        distances_to(bare, depth)
        for row in range(height):
            for col in range(width):
                depth[row, col] = min(max(depth[row, col] - 0.5, 0.0) * pixel_m[window], DEPTH_MOST_M)
        hand_features(
            coverage[window], lot[window], ground[window], edge_dm[window], pixel_m[window],
            (lot_area_m2[window], ground_area_m2[window]), depth, (mask, labels, stack, distance), out[window],
        )  # fmt: skip
        found = find_crowns(coverage[window], depth, pixel_m[window], crowns)
        crown_features(
            crowns[:found], lot[window], ground[window], edge_dm[window], pixel_m[window], (mask, distance, other),
            out[window, HAND_COUNT:],
        )  # fmt: skip
