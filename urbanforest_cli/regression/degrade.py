"""Crowns as a map of a real city shows them: lumpy, merged, missed, rough."""

from __future__ import annotations

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.lot_windows import WINDOW_PX, WindowPlaces
from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.regression.degrade_kernel import paint_windows

CLEAN_SHARE = 0.3
"""Of degraded pairs, those whose map is as good as its resolution."""
LUMPS_MOST, MISSED_MOST, BLUR_M, GRAIN_MOST, THRESHOLD = 0.16, 0.6, (0.2, 1.3), 0.25, (0.3, 0.62)
"""At full strength: amplitude of a rim's harmonics, chance to miss a crown of 1 m, standard deviations of the blur,
how far the threshold wanders, and where it lies; below 1/2 it lets crowns grow together."""
SMALLEST_REGION_M2 = 2.0
CLEAN_BLUR_M = 0.2


def map_faults(keys: NDArray[np.uint64]) -> NDArray[np.float64]:
    """Draw what is wrong with the map of each pair.

    Returns
    -------
    (n, 6) as `degrade_kernel.paint_windows` reads them.
    """
    count = len(keys)

    def drawn(index: int) -> NDArray[np.float64]:
        return hash_uniform(keys ^ np.uint64(0xDE), np.full(count, index))

    strength = np.maximum(drawn(0) - CLEAN_SHARE, 0.0) / (1 - CLEAN_SHARE)
    blur = CLEAN_BLUR_M + strength * drawn(1) * (BLUR_M[1] - CLEAN_BLUR_M)
    threshold = 0.5 + strength * (THRESHOLD[0] + drawn(2) * (THRESHOLD[1] - THRESHOLD[0]) - 0.5)
    return np.column_stack(
        (
            strength * drawn(3) * LUMPS_MOST,
            strength * drawn(4) * MISSED_MOST,
            blur,
            strength * drawn(5) * GRAIN_MOST,
            threshold,
            np.floor(drawn(6) * 2.0**50),
        )
    )


def painted_windows(
    places: WindowPlaces,
    xy: NDArray[np.float64],
    radius_m: NDArray[np.float64],
    crown_keys: NDArray[np.uint64],
    faults: NDArray[np.float64] | None,
) -> NDArray[np.uint8]:
    """Paint crowns into windows.

    Parameters
    ----------
    places
        Where the windows lie.
    xy, radius_m, crown_keys
        (m, 2), (m,) and (m,) crowns, and the keys of their lumps.
    faults
        (n, 6) of `map_faults`, or None for discs as they are.

    Returns
    -------
    (n, 128, 128) percent covered.
    """
    count = len(places.owner)
    coverage = np.zeros((count, WINDOW_PX, WINDOW_PX), np.uint8)
    reach = 1.3 * float(radius_m.max(initial=0.0)) + 2.0
    bounds = places.bounds + np.array([-reach, -reach, reach, reach])
    window, crown = shapely.STRtree(np.asarray(shapely.points(xy))).query(shapely.box(*bounds.T))
    order = np.lexsort((crown, window))
    window, crown = window[order], crown[order]
    offsets = np.searchsorted(window, np.arange(count + 1)).astype(np.int64)
    discs = np.column_stack((xy, radius_m))[crown]
    where = np.column_stack((places.x0, places.y_top, places.pixel_m))
    smallest = 0.0 if faults is None else SMALLEST_REGION_M2
    wrong = np.zeros((count, 6)) if faults is None else np.ascontiguousarray(faults)
    paint_windows(offsets, discs, crown_keys[crown], where, wrong, smallest, coverage)
    return coverage
