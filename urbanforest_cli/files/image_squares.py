"""The part of an aerial image under a square of ground, as a picture of a size that is asked for."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from pyproj import CRS
from scipy.ndimage import map_coordinates

from urbanforest_cli.core.boxes import Bounds
from urbanforest_cli.core.crs import transformer
from urbanforest_cli.files.mosaics import MosaicReader

FINEST = 4
"""Places along each side of a pixel, at most, where the image is finer than the picture."""
BLOCK_ROWS = 16


def image_square(
    mosaic: MosaicReader, frame: Bounds, side_px: int, working: CRS
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Bring the part of an image under a square to a picture, north up: bilinear, or the mean where it is finer.

    Returns
    -------
    (side_px, side_px, 3) uint8, and (side_px, side_px) bool where the image has pixels.
    """
    grid = mosaic.grid
    west, _, east, north = frame
    pixel_m = (east - west) / side_px
    finer = int(np.clip(math.ceil(pixel_m / min(grid.resolution_m) - 0.25), 1, FINEST))
    step = pixel_m / finer
    change = transformer(working.to_wkt(), grid.crs.to_wkt())
    a, _, x0, _, e, y0 = grid.transform
    colours = np.zeros((side_px, side_px, 3), dtype=np.uint8)
    known = np.zeros((side_px, side_px), dtype=bool)
    across = west + (np.arange(side_px * finer) + 0.5) * step
    for first in range(0, side_px, BLOCK_ROWS):
        count = min(BLOCK_ROWS, side_px - first)
        down = north - (first * finer + np.arange(count * finer) + 0.5) * step
        x, y = np.meshgrid(across, down)
        if grid.crs != working:
            x, y = change.transform(x, y)
        row, col = (y - y0) / e - 0.5, (x - x0) / a - 0.5
        low_row, low_col = max(0, math.floor(row.min()) - 1), max(0, math.floor(col.min()) - 1)
        high_row = min(grid.height_px, math.ceil(row.max()) + 2)
        high_col = min(grid.width_px, math.ceil(col.max()) + 2)
        if low_row >= high_row or low_col >= high_col:
            continue
        rgb, valid = mosaic.read(low_row, low_col, high_row - low_row, high_col - low_col)
        place = np.array([row - low_row, col - low_col])
        there = map_coordinates(valid.astype(np.float32), place, order=1, cval=0.0) > 0.99
        blocks = (count, finer, side_px, finer)
        for band in range(3):
            values = map_coordinates(rgb[band].astype(np.float32), place, order=1, mode="nearest")
            colours[first : first + count, :, band] = np.rint(values.reshape(blocks).mean(axis=(1, 3)))
        known[first : first + count] = there.reshape(blocks).all(axis=(1, 3))
    return colours, known
