"""Boxes: what has a middle, a direction, two sides and a height."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.synth.picture.draws import Draws
from urbanforest_cli.synth.picture.grounds import ALONG_X, ALONG_Y, Grounds
from urbanforest_cli.synth.plan import Floats, Geometries

CAR, PLAIN, WATERY = 0, 1, 2
"""How a box is painted."""


@dataclass(frozen=True)
class Boxes:
    """Boxes; a later one lies over an earlier one of the same height."""

    table: Floats  # (boxes, 9) middle x, y, unit direction x, y, half length, half width, top, how painted, salt
    colour: Floats  # (boxes, 4)

    @classmethod
    def of(
        cls, xy: Floats, direction: Floats, length_m: Floats, width_m: Floats, top_m: Floats, paint: int,
        colour: Floats, draw: Draws,
    ) -> Boxes:  # fmt: skip
        """Make boxes of their measures."""
        count = len(xy)
        painted, salt = np.full(count, float(paint)), draw.pick("salt", 1 << 20)
        table = np.column_stack((xy, direction, length_m / 2, width_m / 2, top_m, painted, salt))
        return cls(table, np.broadcast_to(colour, (count, 4)).astype(np.float64))

    @classmethod
    def joined(cls, parts: list[Boxes]) -> Boxes:
        """Return the boxes of several lists."""
        return cls(np.concatenate([part.table for part in parts]), np.concatenate([part.colour for part in parts]))

    def take(self, index: NDArray[np.int64] | NDArray[np.bool_]) -> Boxes:
        """Return some of the boxes."""
        return Boxes(self.table[index], self.colour[index])


def lot_directions(grounds: Grounds, lot: NDArray[np.int64]) -> Floats:
    """Return (n, 2) unit directions of the streets before lots."""
    return np.asarray(grounds.table[lot][:, [ALONG_X, ALONG_Y]])


def turned_left(direction: Floats) -> Floats:
    """Return directions turned by a right angle."""
    return np.column_stack((-direction[:, 1], direction[:, 0]))


def clear_of(xy: Floats, shapes: Geometries, distance_m: float) -> NDArray[np.bool_]:
    """Tell which places have no shape nearer than the distance."""
    clear = np.ones(len(xy), dtype=bool)
    if len(shapes) and len(xy):
        clear[shapely.STRtree(shapes).query(shapely.points(xy), predicate="dwithin", distance=distance_m)[0]] = False
    return clear
