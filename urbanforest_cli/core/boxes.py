"""Boxes of west, south, east and north."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

Bounds = tuple[float, float, float, float]
"""West, south, east, north."""


def in_box(xy: NDArray[np.float64], bbox: Bounds) -> NDArray[np.bool_]:
    """Tell of (n, 2) positions whether they lie in a box, or on its edge."""
    west, south, east, north = bbox
    return np.asarray((xy[:, 0] >= west) & (xy[:, 0] <= east) & (xy[:, 1] >= south) & (xy[:, 1] <= north))
