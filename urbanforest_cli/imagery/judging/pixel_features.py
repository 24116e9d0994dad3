"""Colour and texture of each pixel of an aerial image, as baselines see it."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import uniform_filter

Floats = NDArray[np.float32]

WINDOWS_M = (1.8, 4.2, 9.0)
"""Sides of the squares that texture is taken in: within a crown, a crown, a crown and its surroundings."""
NAMES = (
    "red", "green", "blue", "excess green", "green against red", "green against blue", "brightness, 4.2 m",
    "brightness less that of 9 m", "roughness, 1.8 m", "roughness, 4.2 m", "roughness, 9 m", "excess green, 4.2 m",
    "excess green, 9 m",
)  # fmt: skip


def excess_green(rgb: NDArray[np.uint8]) -> Floats:
    """Return 2g - r - b of the chromaticities, -1 to 2, 0 for black (Woebbecke et al. 1995).

    Parameters
    ----------
    rgb
        (3, rows, cols).
    """
    red, green, blue = rgb.astype(np.float32)
    whole = red + green + blue
    return np.asarray(np.divide(2 * green - red - blue, whole, out=np.zeros_like(whole), where=whole > 0))


def pixel_features(rgb: NDArray[np.uint8], resolution_m: tuple[float, float]) -> Floats:
    """Return the values of `NAMES` for each pixel.

    Parameters
    ----------
    rgb
        (3, rows, cols).
    resolution_m
        Width and height of a pixel.

    Returns
    -------
    (rows, cols, 13) float32
        Beyond its edges the image is mirrored.
    """
    red, green, blue = rgb.astype(np.float32) / 255
    brightness = (red + green + blue) / 3
    index = excess_green(rgb)
    sizes = [_window_px(side_m, resolution_m) for side_m in WINDOWS_M]
    within_crown, crown, around = sizes
    values = (
        red,
        green,
        blue,
        index,
        _against(green, red),
        _against(green, blue),
        uniform_filter(brightness, crown),
        brightness - uniform_filter(brightness, around),
        _roughness(brightness, within_crown),
        _roughness(brightness, crown),
        _roughness(brightness, around),
        uniform_filter(index, crown),
        uniform_filter(index, around),
    )
    return np.stack(values, axis=-1, dtype=np.float32)


def _window_px(side_m: float, resolution_m: tuple[float, float]) -> tuple[int, int]:
    """Return rows and columns of a window, both odd and at least 3."""
    wide, high = resolution_m
    rows, cols = (max(3, 2 * round((side_m / size - 1) / 2) + 1) for size in (high, wide))
    return rows, cols


def _against(value: Floats, other: Floats) -> Floats:
    whole = value + other
    return np.asarray(np.divide(value - other, whole, out=np.zeros_like(whole), where=whole > 0))


def _roughness(value: Floats, size: tuple[int, int]) -> Floats:
    """Return the standard deviation within a window."""
    wide = value.astype(np.float64)
    variance = uniform_filter(wide * wide, size) - uniform_filter(wide, size) ** 2
    return np.asarray(np.sqrt(np.maximum(variance, 0.0)), dtype=np.float32)
