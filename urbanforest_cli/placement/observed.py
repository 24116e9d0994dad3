"""Known plants that are kept as they are, in the lots they stand in."""

from __future__ import annotations

from dataclasses import dataclass, replace
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.placement.sites import Positions, Sites

NUMBERS_FROM = 1 << 40
"""Where the numbers of known plants begin, far beyond those of placed ones: their streams never meet."""


@dataclass(frozen=True)
class Observed:
    """Known plants, sorted by lot.

    Parameters
    ----------
    ids
        (n,) text.
    lot
        (n,) index of each one's lot, non-decreasing.
    xy, radius_m
        (n, 2) and (n,) in metres; the lot's mean radius where no crown is known.
    height_m
        (n,) NaN where unknown.
    species
        (n,) index into the catalogue, -1 where unknown or not in it.
    """

    ids: NDArray[np.object_]
    lot: NDArray[np.int64]
    xy: NDArray[np.float64]
    radius_m: NDArray[np.float64]
    height_m: NDArray[np.float64]
    species: NDArray[np.int64]

    def __len__(self) -> int:
        return len(self.lot)

    @classmethod
    def none(cls) -> Observed:
        """Return no plants."""
        return cls(
            np.empty(0, dtype=object), np.zeros(0, dtype=np.int64), np.zeros((0, 2)), np.zeros(0), np.zeros(0),
            np.zeros(0, dtype=np.int64),
        )  # fmt: skip

    def numbers(self) -> NDArray[np.int64]:
        """Return each plant's number in its lot's streams: a hash of its id, so that it keeps it among others."""
        digests = [blake2b(str(name).encode("utf-8", "surrogatepass"), digest_size=4).digest() for name in self.ids]
        return NUMBERS_FROM + np.array([int.from_bytes(item, "little") for item in digests], dtype=np.int64)

    def discs_of(self, lots: NDArray[np.int64]) -> tuple[NDArray[np.float64], NDArray[np.float64], NDArray[np.int64]]:
        """Return positions and radii of the plants of some lots, and (n + 1,) where each lot's begin."""
        first, last = np.searchsorted(self.lot, lots), np.searchsorted(self.lot, lots, side="right")
        rows = np.concatenate(
            [np.zeros(0, dtype=np.int64), *(np.arange(a, b) for a, b in zip(first, last, strict=True))]
        )
        offsets = np.concatenate([[0], np.cumsum(last - first)]).astype(np.int64)
        return self.xy[rows], self.radius_m[rows], offsets

    def of_lots(self, lots: NDArray[np.int64]) -> Observed:
        """Return the plants of some lots."""
        rows = np.isin(self.lot, lots)
        return Observed(
            self.ids[rows], self.lot[rows], self.xy[rows], self.radius_m[rows], self.height_m[rows], self.species[rows]
        )

    def beside(self, sites: Sites, lots: NDArray[np.int64]) -> Sites:
        """Return a batch of lots, the known plants of which stand already."""
        xy, radius_m, offsets = self.discs_of(lots)
        return replace(sites, fixed_xy=xy, fixed_radius_m=radius_m, fixed_offsets=offsets)


def apart_from_fixed(found: Positions, sites: Sites) -> Positions:
    """Leave out positions whose envelopes meet a disc that stands in their lot already."""
    if sites.fixed_offsets is None or sites.fixed_xy is None or sites.fixed_radius_m is None:
        return found
    keep = np.ones(len(found.site), dtype=bool)
    for row, (i, xy, radius) in enumerate(zip(found.site, found.xy, found.radius_m, strict=True)):
        span = slice(sites.fixed_offsets[i], sites.fixed_offsets[i + 1])
        apart = np.hypot(*(sites.fixed_xy[span] - xy).T)
        keep[row] = bool(np.all(apart >= sites.fixed_radius_m[span] + radius))
    return Positions(found.site[keep], found.xy[keep], found.radius_m[keep], found.refused)
