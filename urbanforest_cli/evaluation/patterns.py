"""Point sets of many lots side by side: flat positions, and where each lot's begin.

All sets that are compared have the same lots and the same count in each, so that what differs is arrangement alone and
the labels "real" and "model" of a lot may be swapped under the hypothesis that both come from one process.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

LOTS_APART = 1e7


@dataclass(frozen=True)
class Patterns:
    """Points of many lots.

    Attributes
    ----------
    xy
        (n, 2) positions, in metres or in any unit of a lot's own.
    starts
        (lots + 1,) index of each lot's first point, and n.
    """

    xy: Floats
    starts: Ints

    @classmethod
    def of(cls, point_sets: list[Floats]) -> Patterns:
        """Lay point sets side by side."""
        starts = np.concatenate(([0], np.cumsum([len(points) for points in point_sets]))).astype(np.int64)
        return cls(np.concatenate([np.zeros((0, 2)), *point_sets]), starts)

    @cached_property
    def counts(self) -> Ints:
        """Points of each lot."""
        return np.diff(self.starts)

    @cached_property
    def lot(self) -> Ints:
        """Lot of each point."""
        return np.repeat(np.arange(len(self.counts)), self.counts)

    @cached_property
    def _lifted(self) -> Floats:
        """Return positions with the lots stacked so far apart that no neighbour is another lot's."""
        return np.column_stack((self.xy, self.lot * LOTS_APART))

    @cached_property
    def _tree(self) -> cKDTree:
        return cKDTree(self._lifted)

    def scaled(self, factors: Floats) -> Patterns:
        """Multiply each lot's positions by its own factor."""
        return Patterns(self.xy * factors[self.lot, None], self.starts)

    def neighbour_vectors(self, rank: int) -> Floats:
        """Return the vector from each point to its first, second ... neighbour in the lot.

        Shape (n, 2); each lot must have more points than `rank`.
        """
        _, index = self._tree.query(self._lifted, k=[rank + 1])
        return np.asarray(self.xy[index[:, 0]] - self.xy)

    def neighbour_distances(self, rank: int) -> Floats:
        """Return the distances to the first neighbours in the lot; shape (n, rank)."""
        distance, _ = self._tree.query(self._lifted, k=np.arange(2, rank + 2))
        return np.asarray(distance)

    def nearest_to(self, other: Patterns) -> Floats:
        """Return for each point of `other` the distance to the nearest point of the same lot here."""
        distance, _ = self._tree.query(other._lifted)
        return np.asarray(distance)

    def pair_counts(self, radii: Floats) -> Ints:
        """Count each lot's pairs within each of some ascending radii; shape (lots, radii)."""
        counts = np.zeros((len(self.counts), len(radii) + 1), dtype=np.int64)
        for first in range(0, len(self.counts), 256):
            part = self._some(first, first + 256)
            pairs = part._tree.query_pairs(radii[-1], output_type="ndarray")
            apart = np.linalg.norm(part.xy[pairs[:, 0]] - part.xy[pairs[:, 1]], axis=1)
            np.add.at(counts, (first + part.lot[pairs[:, 0]], np.searchsorted(radii, apart)), 1)
        return counts[:, :-1].cumsum(axis=1)

    def _some(self, first: int, last: int) -> Patterns:
        starts = self.starts[first : last + 1]
        return Patterns(self.xy[starts[0] : starts[-1]], starts - starts[0])

    def quantiles(self, values: Floats, shares: Floats) -> Floats:
        """Return quantiles of each lot's values, interpolated; shape (lots, shares), NaN for a lot without points."""
        ordered = values[np.lexsort((values, self.lot))]
        position = (self.counts[:, None] - 1).clip(0) * shares
        below = self.starts[:-1, None] + np.floor(position).astype(np.int64)
        above = np.minimum(below + 1, (self.starts[1:, None] - 1).clip(0))
        part = position - np.floor(position)
        if len(ordered) == 0:
            return np.full(position.shape, np.nan)
        below = below.clip(0, len(ordered) - 1)
        found = ordered[below] * (1 - part) + ordered[above] * part
        return np.where(self.counts[:, None] > 0, found, np.nan)

    def means(self, values: Floats) -> Floats:
        """Return the mean of each lot's values, 0 for a lot without points."""
        total = np.bincount(self.lot, weights=values, minlength=len(self.counts))
        return np.asarray(total / self.counts.clip(1))
