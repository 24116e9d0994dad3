"""What a strategy takes and gives: a batch of lots, and positions in them."""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class Sites:
    """A batch of lots that share one strategy, in a working CRS in metres.

    Parameters
    ----------
    lot_ids
        (n,) text.
    keys
        (n,) uint64, keys of the lots' random streams.
    lots
        (n,) polygons or multipolygons, the lots themselves.
    areas
        (n,) polygons or multipolygons, the ground left in them for plants.
    values
        (n,) float64 by parameter name, one value a lot.
    fixed_xy, fixed_radius_m, fixed_offsets
        (m, 2) and (m,) discs that stand already and (n + 1,) where each lot's begin; None where nothing does.
    """

    lot_ids: NDArray[np.object_]
    keys: NDArray[np.uint64]
    lots: NDArray[np.object_]
    areas: NDArray[np.object_]
    values: dict[str, NDArray[np.float64]]
    fixed_xy: NDArray[np.float64] | None = None
    fixed_radius_m: NDArray[np.float64] | None = None
    fixed_offsets: NDArray[np.int64] | None = None

    def __len__(self) -> int:
        return len(self.lot_ids)


@dataclass(frozen=True)
class Positions:
    """Where plants may stand, before any thinning by density.

    Parameters
    ----------
    site
        (n,) int64 index into the batch, non-decreasing; within a lot positions stand in sampling order.
    xy
        (n, 2) float64 easting and northing in metres.
    radius_m
        (n,) float64 radius of each plant's envelope.
    refused
        Indices of the lots that would hold more plants than the config allows, and got none.
    """

    site: NDArray[np.int64]
    xy: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    refused: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, dtype=np.int64))

    def __len__(self) -> int:
        return len(self.site)

    @classmethod
    def empty(cls) -> Positions:
        """Return no positions."""
        return cls(np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0))
