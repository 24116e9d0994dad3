"""Species and ages of plants whose crowns are known: they shall grow as wide as the map shows."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.placement.seeds import Seeds

AGES_TRIED = np.arange(1.0, 200.25, 0.25)
WIDE_ENOUGH = 0.9
"""A species will do for a crown of which it reaches this share."""
GROWN_ALONE, LOST_TO_CROWD, CROWD_MAX = 0.92, 0.075, 2.0
"""Share of its open-grown radius that a crown reaches in its place, and what it loses for each neighbour of its size
that stands close: fitted to the growth of the sample city's plants (2,030, radii 0.5 to 9 m)."""
CROWD_NEAR = 1.3
"""A neighbour counts from where the gap between both crowns is this much less than the plant's own radius."""
_SALT = np.uint64(0x517E5)


def as_wide_as_seen(
    seeds: Seeds,
    rows: NDArray[np.int64],
    site: NDArray[np.int64],
    keys: NDArray[np.uint64],
    xy: NDArray[np.float64],
    radius_m: NDArray[np.float64],
    catalogue: Catalogue,
) -> Seeds:
    """Give plants the age at which their species, where they stand, has a crown of their radius.

    That is when an open-grown one is a little wider: more, where neighbours of the lot stand close. A crown wider than
    its species ever grows gets the lot's dominant species if that is wide enough, else another of the city's that is,
    in an order of the lot's own; where none is, the widest. Ages are bounded by the species' lifespan, not
    by the zone's oldest age: the map shows what is there.

    Parameters
    ----------
    rows
        Plants whose crowns are known.
    site, keys
        (plants,) lot of each, and (lots,) keys of the lots' streams.
    xy, radius_m
        (plants, 2) positions and (plants,) radii of crowns, in metres.
    """
    ages, radii = _growth(catalogue)
    reach_m = radii.max(axis=1)
    open_m = radius_m / (GROWN_ALONE - LOST_TO_CROWD * np.minimum(crowding(site, xy, radius_m), CROWD_MAX))
    species, age_years = seeds.species.copy(), seeds.age_years.copy()
    wanted_m = np.minimum(WIDE_ENOUGH * open_m[rows], reach_m.max())
    lot = site[rows]
    dominant = seeds.dominant[lot]
    chance = hash_uniform(keys[lot, None] ^ _SALT, np.arange(len(reach_m))[None, :])
    wide = reach_m[None, :] >= wanted_m[:, None]
    other = np.argmax(np.where(wide, chance, -1.0), axis=1)
    other = np.where(reach_m[dominant] >= wanted_m, dominant, other)
    species[rows] = np.where(reach_m[species[rows]] >= wanted_m, species[rows], other)
    for number in np.unique(species[rows]):
        mine = rows[species[rows] == number]
        at = np.searchsorted(radii[number], open_m[mine])
        last = int(np.searchsorted(radii[number], reach_m[number]))
        age_years[mine] = ages[np.minimum(at, last)]
    return replace(seeds, species=species, age_years=age_years)


def crowding(site: NDArray[np.int64], xy: NDArray[np.float64], radius_m: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return how crowded each plant stands among those of its lot: about the neighbours of its size that touch it.

    A neighbour counts from 0 to 1 by how near it is, measured in the plant's own radius, and less if it is smaller.
    """
    crowd = np.zeros(len(site))
    if not len(site):
        return crowd
    far_m = (CROWD_NEAR + 1.0) * float(radius_m.max())
    apart = np.column_stack((xy - xy.mean(axis=0), 2.0 * far_m * site))  # lots never meet
    pairs = cKDTree(apart).query_pairs(far_m, output_type="ndarray")
    gap_m = np.hypot(*(xy[pairs[:, 0]] - xy[pairs[:, 1]]).T)
    for own, other in ((pairs[:, 0], pairs[:, 1]), (pairs[:, 1], pairs[:, 0])):
        near = np.clip((radius_m[other] + CROWD_NEAR * radius_m[own] - gap_m) / (2.0 * radius_m[own]), 0.0, 1.0)
        np.add.at(crowd, own, near * np.minimum(radius_m[other] / radius_m[own], 1.0))
    return crowd


def age_at_height(
    height_m: NDArray[np.float64], species: NDArray[np.int64], catalogue: Catalogue
) -> NDArray[np.float64]:
    """Return the age at which an open-grown plant of its species is as high; NaN where no height is known."""
    found = np.full(len(height_m), np.nan)
    for number, kind in enumerate(catalogue):
        rows = np.flatnonzero((species == number) & np.isfinite(height_m))
        if len(rows):
            tried = AGES_TRIED[: max(1, int(np.searchsorted(AGES_TRIED, kind.lifespan_years, side="right")))]
            heights = np.maximum.accumulate(kind.open_grown.height_at(tried))
            found[rows] = tried[np.minimum(np.searchsorted(heights, height_m[rows]), len(tried) - 1)]
    return found


def _growth(catalogue: Catalogue) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return ages, and (species, age) the widest crown up to each; constant beyond a species' lifespan."""
    lived = [np.minimum(AGES_TRIED, kind.lifespan_years) for kind in catalogue]
    radii = [kind.open_grown.crown_radius_at(ages) for kind, ages in zip(catalogue, lived, strict=True)]
    return AGES_TRIED, np.maximum.accumulate(np.array(radii), axis=1)
