"""How a forest is cut into tiles: a quadtree of squares, and which plants each holds at which detail."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.scenery import Fixed, Model, Origin, Scenery

CODE_LEVELS_MAX = 31


@dataclass(frozen=True)
class TilePlan:
    """Tiles of a quadtree, by level and then along the Z-order curve: (t,) each.

    Parameters
    ----------
    centre_m, half_m
        The root's square in the frame the plants were given in: middle (x, y), half its side.
    levels
        Levels of the tree, the root's included.
    details
        Names of the details, coarse to fine.
    level, x, y
        Place in the tree: 0 is the root; x counts eastward, y northward.
    is_leaf
        Leaves hold every plant once at the finest detail.
    detail
        Place in `details`.
    size_factor
        On the size of the plants held, where they stand for more than themselves.
    first, row
        (t + 1,) offsets into rows of plants.
    root_error_m
        Geometric error of the root; it halves with each level.
    """

    centre_m: tuple[float, float]
    half_m: float
    levels: int
    details: tuple[str, ...]
    level: NDArray[np.int32]
    x: NDArray[np.int32]
    y: NDArray[np.int32]
    is_leaf: NDArray[np.bool_]
    detail: NDArray[np.int8]
    size_factor: NDArray[np.float64]
    first: NDArray[np.int64]
    row: NDArray[np.int64]
    root_error_m: float

    def __len__(self) -> int:
        return len(self.level)

    def rows(self, tile: int) -> NDArray[np.int64]:
        """Return the rows of a tile's plants, ascending."""
        return self.row[self.first[tile] : self.first[tile + 1]]


@dataclass(frozen=True)
class FixedCell:
    """Ground and buildings of one square cell, in the frame of the tiles.

    Parameters
    ----------
    x, y
        Of the cell, eastward and northward from the south-western one.
    ground, buildings
        At most one piece a material each.
    """

    x: int
    y: int
    ground: tuple[Fixed, ...]
    buildings: tuple[Fixed, ...]


@dataclass(frozen=True)
class TiledScene:
    """A scene as 3D Tiles take it: everything about the origin in a frame that stands on the ellipsoid there.

    Parameters
    ----------
    origin, ground_height_m
        Where the frame stands; height of the scene's ground above the ellipsoid of WGS 84.
    plan
        Of the plants.
    sceneries
        One a detail of the plan, with the same rows of plants; positions and turns are those of the frame, nothing is
        mirrored, and models are left to `models_of`.
    cells
        What is fixed, its materials those of the finest detail.
    models_of
        Gives models of a detail by number, ascending.
    """

    origin: Origin
    ground_height_m: float
    plan: TilePlan
    sceneries: Mapping[str, Scenery]
    cells: Sequence[FixedCell]
    models_of: Callable[[str, NDArray[np.int64]], Sequence[Model]]


def z_order(x: NDArray[np.int64], y: NDArray[np.int64]) -> NDArray[np.int64]:
    """Return places along the Z-order curve: bits of x and y in turn, x in the lowest."""
    return _spread(x) | (_spread(y) << 1)


def from_z_order(code: NDArray[np.int64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Return x and y of places along the Z-order curve."""
    return _gather(code), _gather(code >> 1)


_SPREADS = ((16, 0x0000FFFF0000FFFF), (8, 0x00FF00FF00FF00FF), (4, 0x0F0F0F0F0F0F0F0F), (2, 0x3333333333333333))
_EVEN_BITS = 0x5555555555555555


def _spread(value: NDArray[np.int64]) -> NDArray[np.int64]:
    spread = np.asarray(value, dtype=np.int64)
    for shift, mask in (*_SPREADS, (1, _EVEN_BITS)):
        spread = (spread | (spread << shift)) & mask
    return spread


def _gather(code: NDArray[np.int64]) -> NDArray[np.int64]:
    gathered = np.asarray(code, dtype=np.int64) & _EVEN_BITS
    masks = [mask for _, mask in reversed(_SPREADS)] + [0x00000000FFFFFFFF]
    for shift, mask in zip((1, 2, 4, 8, 16), masks, strict=True):
        gathered = (gathered | (gathered >> shift)) & mask
    return gathered
