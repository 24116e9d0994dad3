"""Pairs of coverage and parameters as arrays."""

from __future__ import annotations

from dataclasses import dataclass, fields

import numpy as np
from numpy.typing import NDArray


@dataclass(frozen=True)
class PairTable:
    """Pairs, one a row.

    Parameters
    ----------
    windows
        (n, 3, 64, 64) uint8: coverage and plantable ground in percent, distance to the lot's edge in decimetres,
        at most 120.
    pixel_m
        (n,) float32: side of a pixel of these windows, 1 or 2 m.
    features
        (n, feature) float32, in the order of `regression.features.FEATURES`; never NaN.
    values
        (n, 6) float32: true parameters in the order of `core.schema.REGRESSED`, in their units.
    used
        (n, 6) bool: whether the pair's strategy uses the parameter.
    strategy
        (n,) int8: index into `core.parameter_model.STRATEGIES_READ`.
    visible
        (n,) int32: plants standing in the lot.
    placed
        (n,) int32: plants before any thinning.
    lot
        (n,) int32: the lot a pair was made on; a split goes by it.
    """

    windows: NDArray[np.uint8]
    pixel_m: NDArray[np.float32]
    features: NDArray[np.float32]
    values: NDArray[np.float32]
    used: NDArray[np.bool_]
    strategy: NDArray[np.int8]
    visible: NDArray[np.int32]
    placed: NDArray[np.int32]
    lot: NDArray[np.int32]

    def __len__(self) -> int:
        """Return the number of pairs."""
        return len(self.lot)

    def take(self, rows: NDArray[np.int64] | NDArray[np.bool_]) -> PairTable:
        """Return some of the pairs."""
        return PairTable(**{item.name: getattr(self, item.name)[rows] for item in fields(self)})


def joined(tables: list[PairTable]) -> PairTable:
    """Return all pairs as one table."""
    return PairTable(
        **{item.name: np.concatenate([getattr(table, item.name) for table in tables]) for item in fields(PairTable)}
    )
