"""What the numbers of an image mean: which pixels are there, which range is black to white; arrays, no file."""

from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.files.image_bands import ImageTraits

ALPHA_SHARE_LEAST = 0.5
"""A band that calls itself alpha is one when at least this share of pixels is fully clear or fully opaque."""
FILLS_FROM, FILLS_TO = 0.25, 0.6
"""Numbers use a whole range, as finished pictures do, when their 1st and 99th percentile reach these shares of it."""
BYTE_STEPS = (1, 16, 256, 257)
"""What pictures of 8 bits are multiplied with to be ones of 12 or 16."""
FULL_RANGES = (1.0, 255.0, 1023.0, 2047.0, 4095.0, 16383.0, 65535.0)
"""The highest number of a float, and of 8, 10, 11, 12, 14 and 16 bits."""
NATURAL_LOW, NATURAL_HIGH = 32.0, 205.0
"""Where the 1st and 99th percentile of aerial photographs lie.

The means over seven city-years of NAIP, whose own values are 21 to 44 and 190 to 218.
"""
ENORMOUS = 1e30
"""Floats beyond this are marks of missing pixels, whatever the nodata value says."""


def valid_pixels(colours: NDArray[Any], alpha: NDArray[Any] | None, traits: ImageTraits) -> NDArray[np.bool_]:
    """Tell pixels from places without one, by whatever marks them but a mask.

    Parameters
    ----------
    colours
        (3, ...) samples of red, green and blue.
    alpha
        (...) samples of transparency, where that is a band.
    """
    valid = np.ones(colours.shape[1:], dtype=bool)
    if colours.dtype.kind == "f":
        valid &= ~(~(np.abs(colours) < ENORMOUS)).any(axis=0)  # NaN compares as false
    if traits.nodata is not None and not math.isnan(traits.nodata):
        with np.errstate(over="ignore"):
            missing = colours.dtype.type(traits.nodata)
        valid &= (colours != missing).any(axis=0)
    if traits.black_is_missing:
        valid &= (colours != 0).any(axis=0)
    if traits.palette is not None:
        known = (colours[0] >= 0) & (colours[0] < len(traits.palette))
        valid &= known & (traits.palette[np.where(known, colours[0], 0), 3] > 0)
    if alpha is not None:
        valid &= alpha >= traits.alpha_least
    return valid


def painted(indices: NDArray[Any], palette: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return the colours, (3, row, col), of a palette's indices."""
    known = np.clip(indices, 0, len(palette) - 1)
    colours: NDArray[np.uint8] = np.ascontiguousarray(np.moveaxis(palette[known, :3], -1, 0))
    return colours


def scaled(samples: NDArray[Any], traits: ImageTraits) -> NDArray[np.uint8]:
    """Bring samples from `low` to `high` to 0 to 255, rounded; those beyond are cut off, NaN becomes 0."""
    if samples.dtype == np.uint8 and not traits.stretched:
        return samples
    if samples.dtype.kind in "iu" and samples.dtype.itemsize <= 2:
        info = np.iinfo(samples.dtype)
        table = _stretch(np.arange(info.min, info.max + 1, dtype=np.float64), traits)
        rgb: NDArray[np.uint8] = np.roll(table, int(info.min))[samples]  # a negative sample counts from the table's end
        return rgb
    return _stretch(samples.astype(np.float64), traits)


def _stretch(samples: NDArray[np.float64], traits: ImageTraits) -> NDArray[np.uint8]:
    np.nan_to_num(samples, copy=False, nan=traits.low, posinf=traits.high, neginf=traits.low)
    samples -= traits.low
    samples *= 255.0 / (traits.high - traits.low)
    np.clip(samples, 0.0, 255.0, out=samples)
    return np.rint(samples, out=samples).astype(np.uint8)


def check_alpha(traits: ImageTraits, colours: NDArray[Any], alpha: NDArray[Any]) -> ImageTraits:
    """Take a band that calls itself alpha for near infrared where it holds half tones all over.

    Four bands of which the last is near infrared are often written as red, green, blue and alpha, NAIP's among them;
    a mask of transparency is clear or opaque nearly everywhere.

    Parameters
    ----------
    colours, alpha
        (3, n) and (n,) samples from all over the image.
    """
    lit = (colours > 0).any(axis=0)
    looked_at = alpha[lit] if lit.any() else alpha
    top = float(np.nanmax(looked_at)) if len(looked_at) else 0.0
    if not top > 0:
        return traits
    sharp = (looked_at <= 0) | (looked_at >= top * 15 / 16)
    if traits.nir is None and float(sharp.mean()) < ALPHA_SHARE_LEAST:
        return replace(traits, nir=traits.alpha, alpha=None)
    return replace(traits, alpha_least=top / 2)


def find_range(dtype: str, colours: NDArray[Any]) -> tuple[float, float]:
    """Choose the samples that become 0 and 255, the same for all three colours, so that their balance stays.

    Whole numbers from 0 to 255 are taken as they are, in whatever type they are kept, and multiples of them as what
    they are of. Others that fill a range, as a finished picture does, are scaled by that; the rest (raw counts of a
    sensor, reflectances) are stretched so that their 1st and 99th percentile come to lie where those of aerial
    photographs are.

    Parameters
    ----------
    colours
        (n,), the valid samples of the three colours together.
    """
    if dtype == "uint8" or len(colours) == 0:
        return 0.0, 255.0
    low, high = (float(value) for value in np.percentile(colours.astype(np.float64), (1, 99)))
    least, most = float(colours.min()), float(colours.max())
    for step in BYTE_STEPS:
        if least >= 0 and step < most <= 255 * step and not np.fmod(colours, colours.dtype.type(step)).any():
            return 0.0, 255.0 * step
    for full in FULL_RANGES if colours.dtype.kind == "f" else FULL_RANGES[1:]:
        if least >= 0 and most <= full * 1.001 and low <= FILLS_FROM * full and high >= FILLS_TO * full:
            return 0.0, full
    if high <= low:  # nothing to stretch in a flat image
        return (0.0, 255.0) if least >= 0 and most <= 255 else (low - 128.0, low + 127.0)
    unit = (high - low) / (NATURAL_HIGH - NATURAL_LOW)
    return low - NATURAL_LOW * unit, high + (255.0 - NATURAL_HIGH) * unit
