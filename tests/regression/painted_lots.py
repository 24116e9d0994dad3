"""Windows of lots with crowns of known places, for the tests of features."""

from dataclasses import replace

import numpy as np
import shapely

from urbanforest_cli.core.lot_windows import Surroundings, lot_windows, window_places
from urbanforest_cli.regression.degrade import painted_windows

NOTHING = Surroundings(np.empty(0, dtype=object))


def window_of(lot, xy, radius, *, houses=(), faults=None):
    """Return the one window of a lot, with crowns as discs."""
    lots = np.array([lot], dtype=object)
    built = Surroundings(np.array(houses, dtype=object)) if len(houses) else NOTHING
    xy, radius = np.asarray(xy, float).reshape(-1, 2), np.asarray(radius, float)
    keys = np.arange(1, len(radius) + 1).astype(np.uint64) * np.uint64(0x9E3779B97F4A7C15)
    coverage = painted_windows(window_places(lots), xy, radius, keys, faults)
    return replace(lot_windows(lots, NOTHING, built), coverage=coverage)


def apart(count, side, radius, seed=0, gap=0.3):
    """Return places in a square at which discs do not overlap."""
    rng = np.random.default_rng(seed)
    placed = np.empty((0, 3))
    for r in radius[:count]:
        for _ in range(2000):
            x, y = rng.uniform(1.0, side - 1.0, 2)
            if (np.hypot(placed[:, 0] - x, placed[:, 1] - y) >= placed[:, 2] + r + gap).all():
                placed = np.vstack((placed, [x, y, r]))
                break
    return placed[:, :2], placed[:, 2]


SQUARE = shapely.box(0, 0, 40, 40)
