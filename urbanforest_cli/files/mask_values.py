"""What the numbers and colours of masks mean, in percent covered."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.colours import to_rgb
from urbanforest_cli.core.coverage_model import CANOPY, UNKNOWN, VEGETATION

PERCENT_LEAST = 50
"""Highest value from which on a set of masks of whole numbers shows percents, and no numbers of classes."""
COLOUR_NEAR = 60.0
"""Distance of red, green and blue within which a colour is taken for one of the palette, as JPEG leaves it."""

Scale = NDArray[np.uint8]
"""Percent by value, 256 of them; empty for fractions from 0 to 1."""
FRACTIONS: Scale = np.empty(0, np.uint8)


@dataclass
class MaskValues:
    """The values that a set of masks holds, gathered mask by mask, since one alone may be all 0.

    Parameters
    ----------
    levels
        (256,) which whole numbers occur.
    broken
        Whether there are numbers that are not whole.
    lowest, highest
        Of all numbers.
    """

    levels: NDArray[np.bool_] = field(default_factory=lambda: np.zeros(256, np.bool_))
    broken: bool = False
    lowest: float = 0.0
    highest: float = 0.0

    def add(self, values: NDArray[Any]) -> None:
        """Take the values of a mask along; those that are no number count as unknown."""
        if values.dtype.kind == "f":
            values = values[np.isfinite(values)]
            self.broken |= bool((values != np.rint(values)).any())
        if values.size:
            self.lowest = min(self.lowest, float(values.min()))
            self.highest = max(self.highest, float(values.max()))
            self.levels[np.unique(np.clip(np.rint(values), 0, 255)).astype(np.int64)] = True

    def scale(self) -> Scale:
        """Decide what the values mean.

        0 and 1; 0 and 255; 0 to 100 percent; 0 to 1 in fractions; shades from 0 to 255, as smooth edges and JPEG make
        them. 255 beside 0 to 100, or beside 0 and 1, is unknown.

        Raises
        ------
        ValueError
            They mean nothing known, or nothing is covered in any mask; says what they are.
        """
        seen = f"values from {self.lowest:g} to {self.highest:g}"
        if self.lowest < 0 or self.highest > 255:
            raise ValueError(seen)
        if self.broken and self.highest <= 1.0:
            return FRACTIONS
        above = np.flatnonzero(self.levels[1:]) + 1
        below = above[above != UNKNOWN]
        if len(above) == 0:
            raise ValueError("0 alone")
        table = np.zeros(256, np.uint8)
        if len(below) == 0:
            table[255] = 100
        elif below.max() == 1:
            table[1], table[UNKNOWN] = 100, UNKNOWN
        elif PERCENT_LEAST <= below.max() <= 100:
            table[:101], table[UNKNOWN] = np.arange(101), UNKNOWN
        elif below.max() > 100:
            table = np.rint(np.arange(256) / 2.55).astype(np.uint8)
        else:
            raise ValueError(f"{seen}, as numbers of classes are")
        return table


def percent_of(values: NDArray[Any], scale: Scale) -> NDArray[np.uint8]:
    """Return values of a mask as percent, 255 where unknown."""
    known = np.isfinite(values) if values.dtype.kind == "f" else np.ones(values.shape, np.bool_)
    held = np.where(known, values, 0)
    if len(scale) == 0:
        percent = np.rint(100.0 * np.clip(held, 0.0, 1.0)).astype(np.uint8)
    else:
        percent = scale[np.clip(np.rint(held), 0, 255).astype(np.int64)]
    return np.where(known, percent, np.uint8(UNKNOWN))


def percent_of_colours(rgb: NDArray[np.uint8], palette: Mapping[str, str], classes: Sequence[str]) -> NDArray[np.uint8]:
    """Return 100 where a mask's colour is that of a class, else 0; canopy is vegetation too.

    Parameters
    ----------
    rgb
        (3, row, col).
    palette
        ``#rrggbb`` by class; where two are near, the nearest counts.
    classes
        Bands of the answer, (class, row, col).
    """
    names = list(palette)
    colours = np.array([to_rgb(palette[name]) for name in names]) * 255.0
    away = np.linalg.norm(rgb.astype(np.float32)[None] - colours[:, :, None, None], axis=1)
    nearest = np.where(away.min(axis=0) <= COLOUR_NEAR, away.argmin(axis=0), -1)
    found = {name: nearest == number for number, name in enumerate(names)}
    if CANOPY in found:
        found[VEGETATION] = found.get(VEGETATION, np.False_) | found[CANOPY]
    return np.stack([np.where(found[name], np.uint8(100), np.uint8(0)) for name in classes])
