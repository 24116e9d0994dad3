"""What a parameter network is given of windows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.lot_windows import EDGE_MAX_M
from urbanforest_cli.core.parameter_model import CHANNELS

PIXEL_MOST_M = 2.0
"""Side of a pixel that the channel `scale` says 1 of."""


def network_input(windows: NDArray[np.uint8], pixel_m: NDArray[np.float32]) -> NDArray[np.float32]:
    """Return (n, 4, row, col): the channels that a network reads, all from 0 to 1.

    Parameters
    ----------
    windows
        (n, 3, row, col): coverage and plantable ground in percent, distance to the lot's edge in decimetres.
    pixel_m
        (n,): side of a pixel of these windows, at most 2.
    """
    count, _, rows, columns = windows.shape
    given = np.empty((count, len(CHANNELS), rows, columns), np.float32)
    given[:, :2] = windows[:, :2]
    given[:, :2] *= np.float32(0.01)
    given[:, 2] = windows[:, 2]
    given[:, 2] *= np.float32(0.1 / EDGE_MAX_M)
    given[:, 3] = (np.asarray(pixel_m, np.float32) / np.float32(PIXEL_MOST_M))[:, None, None]
    return given
