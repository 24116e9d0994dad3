"""Slow twin of the canopy's kernel: every part of every cell asks every twig."""

import numpy as np

SUB = 8


def press(places, reach, rows, cols, cell):
    """Rasterise points of twigs.

    Parameters
    ----------
    places
        (m, 3) metres east and south of the grid's corner, and height.
    reach
        (m,) metres that each covers around it.

    Returns
    -------
    top, count
        (rows, cols) highest twig, 0 where there is none, and how many of 64 parts are covered.
    """
    step = cell / SUB
    x, y = np.meshgrid((np.arange(cols * SUB) + 0.5) * step, (np.arange(rows * SUB) + 0.5) * step)
    top, covered = np.zeros((rows * SUB, cols * SUB)), np.zeros((rows * SUB, cols * SUB), dtype=bool)
    for (east, south, height), far in zip(places, reach, strict=True):
        under = (x - east) ** 2 + (y - south) ** 2 <= far**2
        row, col = int(np.floor(south / step)), int(np.floor(east / step))
        if 0 <= row < rows * SUB and 0 <= col < cols * SUB:
            under[row, col] = True
        top[under] = np.maximum(top[under], height)
        covered |= under

    def cells(values):
        return values.reshape(rows, SUB, cols, SUB).swapaxes(1, 2).reshape(rows, cols, SUB * SUB)

    return cells(top).max(axis=2), cells(covered).sum(axis=2)
