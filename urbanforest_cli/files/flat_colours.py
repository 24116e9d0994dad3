"""Colours for formats without textures, or without linear light."""

from __future__ import annotations

import io

import numpy as np
from numpy.typing import NDArray
from PIL import Image


def srgb(light: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return linear light as sRGB, both from 0 to 1."""
    inside = np.clip(light, 0.0, 1.0)
    return np.where(inside <= 0.0031308, 12.92 * inside, 1.055 * inside ** (1 / 2.4) - 0.055)


def mean_light(png: bytes) -> NDArray[np.float64]:
    """Return the mean colour of what a picture shows, in linear light."""
    with Image.open(io.BytesIO(png)) as picture:
        rgba = np.asarray(picture.convert("RGBA"), dtype=np.float64).reshape(-1, 4) / 255.0
    rgb, alpha = rgba[:, :3], rgba[:, 3]
    light = np.where(rgb <= 0.04045, rgb / 12.92, ((rgb + 0.055) / 1.055) ** 2.4)
    return np.asarray(np.average(light, axis=0, weights=alpha) if alpha.sum() > 0 else light.mean(axis=0))
