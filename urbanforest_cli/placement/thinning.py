"""Density: which of the saturated positions are planted (paper, parameter tau)."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.randomness import hash_uniform


def index_within(site: NDArray[np.int64]) -> NDArray[np.int64]:
    """Number the positions of each lot from 0, given non-decreasing lot indices."""
    if len(site) == 0:
        return np.zeros(0, dtype=np.int64)
    starts = np.flatnonzero(np.r_[True, site[1:] != site[:-1]])
    counts = np.diff(np.r_[starts, len(site)])
    return np.arange(len(site)) - np.repeat(starts, counts)


def kept_by_hash(site: NDArray[np.int64], keys: NDArray[np.uint64], density: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Keep each position whose own uniform lies under the lot's density.

    A position's uniform hangs on its lot and number alone, so that the plants of a lower density are among those
    of a higher one; density 1 keeps all, 0 none.

    Parameters
    ----------
    site
        (n,) lot of each position, non-decreasing.
    keys, density
        (lots,) stream keys and densities.
    """
    return hash_uniform(keys[site], index_within(site)) < density[site]


def kept_by_count(site: NDArray[np.int64], keys: NDArray[np.uint64], density: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Keep the share of a lot's positions exactly, the fraction left over decided by chance.

    Of n positions the floor(tau n + u) with the smallest uniforms stay, u being one uniform a lot: the expected
    share is tau whatever n is, and the sets are nested in tau here too.
    """
    index = index_within(site)
    uniform = hash_uniform(keys[site], index)
    order = np.lexsort((uniform, site))
    rank = np.empty(len(site), dtype=np.int64)
    rank[order] = index
    counts = np.bincount(site, minlength=len(density))
    chance = hash_uniform(keys, np.full(len(keys), -1, dtype=np.int64).astype(np.uint64))
    return rank < np.floor(density * counts + chance)[site]
