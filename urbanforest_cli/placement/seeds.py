"""Seeds: which species a position becomes and how old it is (paper, section Plant Seeds, T = <p, alpha, phi, gamma>).

Of a lot's positions a share `tree_fraction` (rho) becomes trees; of its plants a share `species_diversity` (theta) is
*not* of the lot's dominant species; `species_count` (lambda) species are used; `age_max_years` (alpha) bounds ages.

Where rho and theta cannot both hold, rho is kept:

- The dominant species is drawn among those whose habit is common enough to give it its share 1 - theta, and where
  there is none, among those of the commoner habit; then all plants of that habit are of the dominant species.
- A lot that mixes trees and shrubs (0 < rho < 1) and has two species or more has both habits; with two species, rho
  alone decides their shares. With one species the whole lot is trees with probability rho, else shrubs.
- Where a habit has no species but the dominant one, all plants of that habit are of it.
- Species that these shares leave nothing to (of a habit that rho rules out, or the dominant one at theta = 1) count
  in lambda, but are not planted.

Every number drawn is a hash of (lot key, species) or (lot key, index of the position), so a plant keeps its species
and age when others are thinned away, when other lots come or go, and whatever their order.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from hashlib import blake2b

import numpy as np
from numpy.typing import NDArray
from scipy.special import ndtr, ndtri

from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.core.species import Catalogue

RADIUS_AGE_CORRELATION = 0.6

ROUNDING_TOLERATED = 1e-6
"""How far averaging may carry a value from a whole number or a bound without meaning anything by it."""

_LATER = 100.0  # above every draw and rank


@dataclass(frozen=True)
class Seeds:
    """The species, age and pruning of each plant, and the dominant species of each lot."""

    species: NDArray[np.int64]  # (plants,) index into the catalogue
    age_years: NDArray[np.float64]  # (plants,) in (0, alpha], and no more than the species' lifespan
    pruning_factor: NDArray[np.float64]  # (plants,)
    dominant: NDArray[np.int64]  # (lots,) index into the catalogue


@dataclass(frozen=True)
class _Palettes:
    """Species of each lot: the dominant one, and the others by habit; and the share of trees that they allow."""

    tree_fraction: NDArray[np.float64]  # (lots,)
    dominant: NDArray[np.int64]  # (lots,)
    others: tuple[NDArray[np.int64], NDArray[np.int64]]  # shrubs, trees: (lots, species), the first `count` hold
    counts: tuple[NDArray[np.int64], NDArray[np.int64]]  # shrubs, trees: (lots,)


def draw_seeds(
    site: NDArray[np.integer],
    index_in_lot: NDArray[np.integer],
    keys: NDArray[np.uint64],
    values: Mapping[str, NDArray[np.float64]],
    radius_m: NDArray[np.float64],
    catalogue: Catalogue,
    *,
    dominant: str | None = None,
) -> Seeds:
    """Draw species and ages of plants.

    Parameters
    ----------
    site
        (plants,) index of each plant's lot.
    index_in_lot
        (plants,) number of the position within its lot, before any thinning.
    keys
        (lots,) keys of the stage's random streams.
    values
        (lots,) values by parameter name: tree_fraction, species_diversity, species_count, age_max_years,
        pruning_factor, radius_mean_m and radius_variance_m2. A count between integers is rounded up with the
        probability of its fraction, once a lot.
    radius_m
        (plants,) envelope radius of each plant.
    catalogue
        Species of the city.
    dominant
        Id of a species that dominates wherever the tree fraction lets it.

    Raises
    ------
    ValueError
        A species count below 1 or above the catalogue's, or a dominant species that it does not hold.
    """
    palettes = _draw_palettes(keys, values, catalogue, dominant)
    species = _draw_species(site, index_in_lot, keys, palettes, values["species_diversity"], catalogue)
    lifespan_years = np.array([kind.lifespan_years for kind in catalogue])
    highest_years = np.minimum(values["age_max_years"][site], lifespan_years[species])
    age_years = _draw_age_shares(site, index_in_lot, keys, values, radius_m) * highest_years
    return Seeds(species, age_years, values["pruning_factor"][site], palettes.dominant)


def _uniform(keys: NDArray[np.uint64], index: NDArray[np.integer], purpose: str) -> NDArray[np.float64]:
    salt = np.uint64(int.from_bytes(blake2b(purpose.encode(), digest_size=8).digest(), "little"))
    return hash_uniform(keys ^ salt, index)


def _lot_uniform(keys: NDArray[np.uint64], purpose: str) -> NDArray[np.float64]:
    return _uniform(keys, np.zeros(len(keys), dtype=np.int64), purpose)


def _whole_counts(species_count: NDArray[np.float64], keys: NDArray[np.uint64], available: int) -> NDArray[np.int64]:
    whole = np.rint(species_count)
    species_count = np.where(np.abs(species_count - whole) <= ROUNDING_TOLERATED, whole, species_count)
    outside = ~((species_count >= 1) & (np.ceil(species_count) <= available))
    if outside.any():
        raise ValueError(
            f"species_count {species_count[outside][0]:g} is outside 1 to {available}, the species of the catalogue"
        )
    floor = np.floor(species_count)
    up = _lot_uniform(keys, "species_count") < species_count - floor
    return np.asarray(floor.astype(np.int64) + up)


def _effective_tree_fraction(
    rho: NDArray[np.float64], counts: NDArray[np.int64], keys: NDArray[np.uint64], catalogue: Catalogue
) -> NDArray[np.float64]:
    """Return the share of trees that the lot's number of species and the catalogue allow."""
    if not len(catalogue.trees()):
        return np.zeros(len(rho))
    if not len(catalogue.shrubs()):
        return np.ones(len(rho))
    whole = np.rint(rho)
    rho = np.where(np.abs(rho - whole) <= ROUNDING_TOLERATED, whole, rho)
    all_trees = _lot_uniform(keys, "habit") < rho
    return np.where(counts == 1, all_trees.astype(np.float64), rho)


def _draw_palettes(
    keys: NDArray[np.uint64],
    values: Mapping[str, NDArray[np.float64]],
    catalogue: Catalogue,
    forced: str | None,
) -> _Palettes:
    """Draw each lot's species: the dominant one, what both habits need, then the rest in the order of their draws."""
    if forced is not None and forced not in catalogue:
        raise ValueError(f"dominant species {forced!r} is not in the catalogue")
    counts = _whole_counts(values["species_count"], keys, len(catalogue))
    tree_fraction = _effective_tree_fraction(values["tree_fraction"], counts, keys, catalogue)
    diversity = values["species_diversity"]
    lots = np.arange(len(keys))
    is_tree = np.array([kind.habit == "tree" for kind in catalogue])  # (species,)
    draws = np.column_stack([_lot_uniform(keys, f"species/{species_id}") for species_id in catalogue.ids])
    shares = np.where(is_tree, tree_fraction[:, None], 1.0 - tree_fraction[:, None])  # (lots, species) of the habit
    best = shares.max(axis=1, keepdims=True)
    eligible = shares >= np.minimum(1.0 - diversity[:, None] - ROUNDING_TOLERATED, best)
    eligible &= shares > 0
    dominant = np.argmin(np.where(eligible, draws, _LATER), axis=1)
    if forced is not None:
        chosen = catalogue.index_of(forced)
        dominant = np.where(shares[:, chosen] > 0, chosen, dominant)

    same_habit = is_tree == is_tree[dominant][:, None]
    left = shares - np.where(same_habit, 1.0 - diversity[:, None], 0.0)  # what the dominant one leaves of a habit
    wanted = left > ROUNDING_TOLERATED
    order_key = np.where(wanted, draws + 3.0, draws + _LATER)
    order_key[lots, dominant] = 0.0
    for group, rank in ((~same_habit, 1.0), (same_habit, 2.0)):
        candidates = np.where(group & wanted & (order_key > 0), order_key, np.inf)
        first = np.argmin(candidates, axis=1)
        there = np.isfinite(candidates[lots, first])
        order_key[lots[there], first[there]] = rank
    order = np.argsort(order_key, axis=1, kind="stable")
    used = np.arange(order.shape[1]) < counts[:, None]
    used[:, 0] = False  # the dominant one

    def members(habit_is_tree: bool) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
        member = used & (is_tree[order] == habit_is_tree)
        front = np.argsort(~member, axis=1, kind="stable")
        return np.take_along_axis(order, front, axis=1), member.sum(axis=1)

    shrubs, trees = members(False), members(True)
    return _Palettes(tree_fraction, np.asarray(dominant), (shrubs[0], trees[0]), (shrubs[1], trees[1]))


def _draw_species(
    site: NDArray[np.integer],
    index_in_lot: NDArray[np.integer],
    keys: NDArray[np.uint64],
    palettes: _Palettes,
    diversity: NDArray[np.float64],
    catalogue: Catalogue,
) -> NDArray[np.int64]:
    is_tree = np.array([kind.habit == "tree" for kind in catalogue])
    tree_fraction = palettes.tree_fraction
    plant_keys = keys[site]
    tree = _uniform(plant_keys, index_in_lot, "tree") < tree_fraction[site]
    dominant_tree = is_tree[palettes.dominant]
    share = np.where(dominant_tree, tree_fraction, 1.0 - tree_fraction)
    with np.errstate(divide="ignore", invalid="ignore"):
        within_habit = np.where(share > 0, np.minimum((1.0 - diversity) / share, 1.0), 0.0)
    of_dominant = (tree == dominant_tree[site]) & (
        _uniform(plant_keys, index_in_lot, "dominant") < within_habit[site]
    )  # fmt: skip

    count = np.where(tree, palettes.counts[1][site], palettes.counts[0][site])
    pick = (_uniform(plant_keys, index_in_lot, "other") * count).astype(np.int64)
    other = np.where(tree, palettes.others[1][site, pick], palettes.others[0][site, pick])
    return np.asarray(np.where(of_dominant | (count == 0), palettes.dominant[site], other))


def _draw_age_shares(
    site: NDArray[np.integer],
    index_in_lot: NDArray[np.integer],
    keys: NDArray[np.uint64],
    values: Mapping[str, NDArray[np.float64]],
    radius_m: NDArray[np.float64],
) -> NDArray[np.float64]:
    """Draw each plant's age as a share of the highest, in (0, 1]: uniform, and older where the envelope is larger.

    A plant's deviate is mixed with that of its radius (a Gaussian copula, Nelsen 2006, section 2.3), so that the
    ages of a lot stay uniform whatever its radii.
    """
    own = ndtri(np.clip(_uniform(keys[site], index_in_lot, "age"), 2.0**-54, None))
    sd_m = np.sqrt(values["radius_variance_m2"])[site]
    with np.errstate(divide="ignore", invalid="ignore"):
        of_radius = np.where(sd_m > 0, (radius_m - values["radius_mean_m"][site]) / sd_m, 0.0)
    weight = np.where(sd_m > 0, RADIUS_AGE_CORRELATION, 0.0)
    mixed = weight * np.clip(of_radius, -3.0, 3.0) + np.sqrt(1.0 - weight**2) * own
    return np.asarray(np.maximum(ndtr(mixed), np.finfo(np.float64).tiny))
