"""The compiled part of `solids.py`: footprints into rasters, and shadows swept over them."""

from __future__ import annotations

import numpy as np
from numba import njit

from urbanforest_cli.growth.grove import SKY_CELL_M


@njit(cache=True, nogil=True, error_model="numpy")
def burn(xy_m, rings, parts, top_m, touched, near, x0, y0, side, pad, out):
    """Burn footprints into a raster of cells of `side` from (x0, y0), the highest wins; tell whether any hit it.

    A cell is built if its middle is inside, and, for parts that say `touched`, if its square widened by `pad` meets
    the outline.
    """
    rows, cols = out.shape
    hit = False
    for part in near:
        top = np.float32(top_m[part])
        first, last = rings[parts[part]], rings[parts[part + 1]]
        y_low, y_high = np.inf, -np.inf
        x_low, x_high = np.inf, -np.inf
        for v in range(first, last):
            x_low, x_high = min(x_low, xy_m[v, 0]), max(x_high, xy_m[v, 0])
            y_low, y_high = min(y_low, xy_m[v, 1]), max(y_high, xy_m[v, 1])
        j0, j1 = max(int(np.floor((y_low - y0) / side)), 0), min(int(np.floor((y_high - y0) / side)) + 1, rows)
        i0, i1 = max(int(np.floor((x_low - x0) / side)), 0), min(int(np.floor((x_high - x0) / side)) + 1, cols)
        inside = np.zeros((max(j1 - j0, 0), max(i1 - i0, 0)), dtype=np.bool_)
        for ring in range(parts[part], parts[part + 1]):
            for v in range(rings[ring], rings[ring + 1] - 1):
                ax, ay = (xy_m[v, 0] - x0) / side, (xy_m[v, 1] - y0) / side
                bx, by = (xy_m[v + 1, 0] - x0) / side, (xy_m[v + 1, 1] - y0) / side
                if ay > by:
                    ax, ay, bx, by = bx, by, ax, ay
                slant = (bx - ax) / (by - ay) if by > ay else 0.0
                for j in range(max(int(np.ceil(ay - 0.5)), j0), min(int(np.ceil(by - 0.5)), j1)):
                    i = int(max(np.ceil(ax + (j + 0.5 - ay) * slant - 0.5), i0))
                    if i < i1:
                        inside[j - j0, i - i0] ^= True
                if touched[part]:
                    e = pad / side
                    for j in range(max(int(np.floor(ay - e)), 0), min(int(np.floor(by + e)), rows - 1) + 1):
                        xa, xb = ax, bx
                        if by > ay:
                            xa = ax + (min(max(j - e, ay), by) - ay) * slant
                            xb = ax + (min(max(j + 1 + e, ay), by) - ay) * slant
                        left, right = np.floor(min(xa, xb) - e), np.floor(max(xa, xb) + e)
                        for i in range(int(max(left, 0)), int(min(right, cols - 1)) + 1):
                            out[j, i] = max(out[j, i], top)
                            hit = True
        for j in range(inside.shape[0]):
            within = False
            for i in range(inside.shape[1]):
                within ^= inside[j, i]
                if within:
                    out[j0 + j, i0 + i] = max(out[j0 + j, i0 + i], top)
                    hit = True
    return hit


@njit(cache=True, nogil=True, error_model="numpy")
def sweep(top, major, minor, slope, share, row0, col0, taken):
    """Add `share` to `taken` at each cell's shadow height, for light from one direction.

    The sweep goes along rows, from the side where the light comes from; in each step it moves by (major, minor) over
    the larger of the two, the shadow of a row's cells falling onto cells of the next.

    Parameters
    ----------
    top
        (rows, cols) heights of what is built, a cell being `SKY_CELL_M` wide.
    major, minor
        Horizontal unit vector toward the light, along rows' index and along columns'; `slope` is its rise over run.
    row0, col0
        Where the frame begins in `top`.
    taken
        (levels + 1, frame rows, frame cols); level n stands for "the lowest n cells are in shadow".
    """
    rows, cols = top.shape
    levels, frame_rows, frame_cols = taken.shape
    fall = SKY_CELL_M * slope / abs(major)
    aside = minor / abs(major)
    before, here = np.zeros(cols, dtype=np.float64), np.zeros(cols, dtype=np.float64)
    for step in range(rows):
        row = rows - 1 - step if major > 0 else step
        shift = int(np.floor(step * aside + 0.5)) - int(np.floor((step - 1) * aside + 0.5))
        source = row + 1 if major > 0 else row - 1
        for col in range(cols):
            height = 0.0
            if step > 0 and 0 <= col + shift < cols:
                height = max(before[col + shift] - fall, top[source, col + shift] - fall, 0.0)
            here[col] = height
        j = row - row0
        if 0 <= j < frame_rows:
            for i in range(frame_cols):
                dark = min(int(np.ceil(here[col0 + i] / SKY_CELL_M - 0.5)), levels - 1)
                if dark > 0:
                    taken[dark, j, i] += share
        before, here = here, before


@njit(cache=True, nogil=True, error_model="numpy")
def shares_left(taken):
    """Return what is left of the light in each cell, 255 for all, given what is taken at each shadow height."""
    levels, rows, cols = taken.shape
    left = np.empty((levels - 1, rows, cols), dtype=np.uint8)
    lost = np.zeros((rows, cols), dtype=np.float32)
    for k in range(levels - 2, -1, -1):
        for j in range(rows):
            for i in range(cols):
                lost[j, i] += taken[k + 1, j, i]
                left[k, j, i] = np.uint8(max(255.0 * (1.0 - lost[j, i]), 0.0) + 0.5)
    return left
