"""A library of grown plants for a city too large to grow each plant in its place.

An entry is one of the city's own plants, grown in its own surroundings. Every other plant takes the shape of the entry
of its species whose surroundings are most like its own: mirrored or not, turned about the stem, scaled to the height
that a plant of its age has.

How alike two plants are is told by their distance in features: the openness of eight sectors and overhead, their age
and the height expected at it, the pruning factor, and how far the crown is lifted. A distance of 1 stands for openness
that differs by 1 in every sector, or overhead, or for others that differ by what the weights below say. Sectors are
compared under eight turns and their mirror images; plants that are cut to a box along a row should not be turned so
that rows lie across each other.

A turn is by 45 degrees and, so that no two plants look alike by chance alone, by a little more or less: JITTER_DEG does
not change how well crowns fit their places by any amount that can be measured (a half sector does). Pruned plants are
turned by as much as lays their row along the entry's instead.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.randomness import hash_uniform
from urbanforest_cli.core.traits import OpenGrown
from urbanforest_cli.growth.library_kernel import nearest_entries, settle, spread_out

SECTORS = 8
OVERHEAD_WEIGHT = 1.0
HEIGHT_WEIGHT = 1.0  # for each factor of e in expected height
AGE_WEIGHT = 0.3  # for each factor of e in age, counted from a year before planting
PRUNED_WEIGHT = 2.0  # for each 1 in pruning factor
LIFTED_WEIGHT = 0.7  # for each 1 in the share of height that branches are lifted to
LIFTED_SHARE_MAX = 0.45
ACROSS_WEIGHT = 1.0  # for each 1 in pruning factor below 1, if rows lie across each other
AGE_CLASSES = (2, 5, 9, 14, 20, 27, 35, 45, 58, 75)  # years at which a class starts
PRUNED_CLASSES = (0.7, 0.8, 0.88, 0.95, 1.0)  # pruning factors at which a class starts
NEED_EXPONENT = 0.75  # d / (d + 1) for features that spread in d = 3 dimensions: least summed distance for a budget
SETTLE_ROUNDS, SETTLE_SAMPLE = 2, 64
SCALE_LIMITS = (0.7, 1.4)
TURN_SLACK = 0.02  # turns that fit this much worse than the best are as good
JITTER_DEG = 11.25
HALF_TURN_DEG = 22.5
TURN_DRAW, JITTER_DRAW = 1, 2


@dataclass(frozen=True)
class Library:
    """Which plants are grown for all, and how each of the others takes their shape.

    A plant's shape is its entry's, mirrored (y to -y) if told, then turned counter-clockwise, and scaled: see `placed`.

    Parameters
    ----------
    entry
        (m,) plants that are entries, rows of the city's plants, by species and then as chosen.
    of_plant
        (n,) each plant's entry, a row of `entry`.
    yaw_deg, mirror, scale
        (n,) how to place it; an entry's own plant has 0, False, 1.
    key_distance
        (n,) distance in features after turning; 0 for an entry's own plant.
    """

    entry: NDArray[np.int64]
    of_plant: NDArray[np.int64]
    yaw_deg: NDArray[np.float64]
    mirror: NDArray[np.bool_]
    scale: NDArray[np.float64]
    key_distance: NDArray[np.float64]


@dataclass(frozen=True)
class Features:
    """What plants are compared by.

    Parameters
    ----------
    species
        (n,) rows of the catalogue; plants of different species are never alike.
    sectors, others
        (n, 8), (n, 5) weighted features; the root of the sum of squared differences is the distance.
    age_years, pruning_factor, height_m
        (n,) and the height expected at that age.
    row_azimuth_rad, stiffness
        (n,) direction of the row that a plant is cut along, and the squared distance of rows that lie across each
        other: 0 for a plant that is not cut, or where no rows are known.
    """

    species: NDArray[np.int64]
    sectors: NDArray[np.float64]
    others: NDArray[np.float64]
    age_years: NDArray[np.float64]
    pruning_factor: NDArray[np.float64]
    height_m: NDArray[np.float64]
    row_azimuth_rad: NDArray[np.float64]
    stiffness: NDArray[np.float64]


def plan_library(
    openness: NDArray[np.float64],
    species: NDArray[np.int64],
    age_years: NDArray[np.float64],
    pruning_factor: NDArray[np.float64],
    keys: NDArray[np.uint64],
    *,
    size_max: int,
    open_grown: Sequence[OpenGrown],
    clearance_m: NDArray[np.float64] | None = None,
    row_azimuth_rad: NDArray[np.float64] | None = None,
) -> Library:
    """Choose the entries of a city's library and place them for all its plants.

    Parameters
    ----------
    openness
        (n, 9) as `openness_keys` tells it.
    species
        (n,) rows of `open_grown`.
    age_years, pruning_factor
        (n,) of each plant.
    keys
        (n,) one random stream a plant, no two alike; they break ties and draw turns, so that rows know no order.
    size_max
        Most entries, but at least one for each species that is there.
    clearance_m, row_azimuth_rad
        (n,) height that branches are lifted to, and direction along which plants are pruned; nothing is lifted,
        and turns know no rows, if they are not given.
    """
    features = describe(
        openness, species, age_years, pruning_factor, open_grown,
        clearance_m=clearance_m, row_azimuth_rad=row_azimuth_rad,
    )  # fmt: skip
    return match(features, choose(features, keys, size_max=size_max), keys)


def describe(
    openness: NDArray[np.float64],
    species: NDArray[np.int64],
    age_years: NDArray[np.float64],
    pruning_factor: NDArray[np.float64],
    open_grown: Sequence[OpenGrown],
    *,
    clearance_m: NDArray[np.float64] | None = None,
    row_azimuth_rad: NDArray[np.float64] | None = None,
) -> Features:
    """Weigh what plants are compared by."""
    species = np.asarray(species, dtype=np.int64)
    age = np.asarray(age_years, dtype=np.float64)
    height = np.ones(len(species))
    for row, sizes in enumerate(open_grown):
        mine = species == row
        height[mine] = np.maximum(sizes.height_at(age[mine]), 1e-3)
    lifted = np.zeros(len(species)) if clearance_m is None else np.minimum(clearance_m / height, LIFTED_SHARE_MAX)
    cut = 1.0 - np.minimum(np.asarray(pruning_factor, dtype=np.float64), 1.0)
    others = np.column_stack(
        [
            OVERHEAD_WEIGHT * openness[:, SECTORS],
            HEIGHT_WEIGHT * np.log(height),
            AGE_WEIGHT * np.log1p(age),
            PRUNED_WEIGHT * np.asarray(pruning_factor),
            LIFTED_WEIGHT * lifted,
        ]
    )
    return Features(
        species=species,
        sectors=np.ascontiguousarray(openness[:, :SECTORS]) / np.sqrt(SECTORS),
        others=others,
        age_years=age,
        pruning_factor=np.asarray(pruning_factor, dtype=np.float64),
        height_m=height,
        row_azimuth_rad=np.zeros(len(species)) if row_azimuth_rad is None else np.asarray(row_azimuth_rad),
        stiffness=np.zeros(len(species)) if row_azimuth_rad is None else (ACROSS_WEIGHT * cut) ** 2,
    )


def choose(features: Features, keys: NDArray[np.uint64], *, size_max: int) -> NDArray[np.int64]:
    """Choose entries: in classes of species, age and pruning, as far apart as their number allows.

    Each class starts with the plant nearest its median (of mean and spread of the sectors, and all else); each next
    entry is the plant farthest from those chosen. Then each moves to the middle of the plants it stands for, so that
    it is not the oddest of them. Classes get entries in proportion to their need, the summed distance
    to that first plant to the power NEED_EXPONENT; one each comes first, of each species the largest class before all.

    Returns
    -------
    (m,)
        Rows of plants, by species.
    """
    if len(keys) == 0:
        return np.zeros(0, dtype=np.int64)
    age_class = np.searchsorted(AGE_CLASSES, features.age_years, side="right")
    pruned_class = np.searchsorted(PRUNED_CLASSES, features.pruning_factor, side="right")
    order = np.lexsort((keys, pruned_class, age_class, features.species))
    label = np.column_stack([features.species, age_class, pruned_class])[order]
    begin = np.flatnonzero(np.r_[True, (label[1:] != label[:-1]).any(axis=1)])
    end = np.append(begin[1:], len(order))
    sectors, others = features.sectors[order], features.others[order]
    still = np.column_stack([sectors.mean(axis=1), sectors.std(axis=1)]) * np.sqrt(SECTORS)
    still = np.hstack([still, others])
    seed = np.array([a + _nearest_median(still[a:b]) for a, b in zip(begin, end, strict=True)])
    _, near = spread_out(sectors, others, begin, end, seed, np.ones(len(begin), dtype=np.int64))
    need = np.add.reduceat(near, begin) ** NEED_EXPONENT
    budget = share_out(need, end - begin, label[begin, 0], size_max)
    chosen, _ = spread_out(sectors, others, begin, end, seed, budget)
    settle(sectors, others, begin, end, chosen, SETTLE_ROUNDS, SETTLE_SAMPLE)
    return np.asarray(order[chosen])


def _nearest_median(values: NDArray[np.float64]) -> int:
    """Return the row nearest the median of its columns, the first of those alike near."""
    distance = np.sum((values - np.median(values, axis=0)) ** 2, axis=1)
    return int(np.flatnonzero(distance <= distance.min() + 1e-12)[0])


def share_out(
    need: NDArray[np.float64], count: NDArray[np.int64], species: NDArray[np.int64], size_max: int
) -> NDArray[np.int64]:
    """Share out a number of entries among classes by need: largest remainders, no class more than it has plants.

    One goes to the largest class of each species whatever the number, then one to each class by size.
    """
    budget = np.zeros(len(need), dtype=np.int64)
    by_size = np.lexsort((np.arange(len(need)), -count))
    _, first = np.unique(species[by_size], return_index=True)
    largest = by_size[np.sort(first)]
    rest = by_size[~np.isin(by_size, largest)]
    ranked = np.concatenate([largest, rest])
    budget[ranked[: max(size_max, len(largest))]] = 1
    while (left := size_max - budget.sum()) > 0 and (open_to := np.flatnonzero(budget < count)).size:
        weight = np.maximum(need[open_to], 1e-9)
        wanted = left * weight / weight.sum()
        more = np.minimum(np.floor(wanted + 1e-9).astype(np.int64), (count - budget)[open_to])
        if more.sum() == 0:  # less than one each: the largest shares first
            more[np.lexsort((open_to, -wanted))[:left]] = 1
        budget[open_to] += more
    return budget


def match(features: Features, entry: NDArray[np.int64], keys: NDArray[np.uint64]) -> Library:
    """Find for each plant the nearest entry of its species, and how to place it."""
    order, rows = np.lexsort((keys, features.species)), np.lexsort((keys[entry], features.species[entry]))
    kinds = np.unique(features.species)
    sorted_entry = entry[rows]
    bounds = [
        np.append(np.searchsorted(features.species[plants], kinds), len(plants)) for plants in (order, sorted_entry)
    ]
    found, turn, distance = nearest_entries(
        features.sectors[order], features.others[order],
        features.row_azimuth_rad[order], features.stiffness[order], bounds[0],
        features.sectors[sorted_entry], features.others[sorted_entry],
        features.row_azimuth_rad[sorted_entry], bounds[1],
        hash_uniform(keys[order], np.full(len(keys), TURN_DRAW)), TURN_SLACK,
    )  # fmt: skip
    back = np.argsort(order)
    of_plant, turns, key_distance = rows[found[back]], turn[back], np.asarray(distance[back], dtype=np.float64)
    scale = np.clip(features.height_m / features.height_m[entry][of_plant], *SCALE_LIMITS)
    mirror = np.asarray(turns >= SECTORS)
    yaw_deg = _fine_turn(features, entry[of_plant], 45.0 * (turns % SECTORS), mirror, keys)
    of_plant[entry] = np.arange(len(entry))
    yaw_deg[entry], mirror[entry], scale[entry], key_distance[entry] = 0.0, False, 1.0, 0.0
    return Library(
        entry=entry, of_plant=of_plant, yaw_deg=yaw_deg, mirror=mirror, scale=scale, key_distance=key_distance
    )  # fmt: skip


def _fine_turn(
    features: Features,
    entry: NDArray[np.int64],
    yaw_deg: NDArray[np.float64],
    mirror: NDArray[np.bool_],
    keys: NDArray[np.uint64],
) -> NDArray[np.float64]:
    """Return yaws, 0 to 360, turned by chance, or so that the rows of pruned plants lie along their entries'."""
    jitter = (2.0 * hash_uniform(keys, np.full(len(keys), JITTER_DRAW)) - 1.0) * JITTER_DEG
    row = np.degrees(features.row_azimuth_rad)
    lies = yaw_deg + np.where(mirror, -1.0, 1.0) * row[entry]
    aside = (row - lies + 45.0) % 90.0 - 45.0
    along = (features.stiffness > 0.0) & (np.abs(aside) <= HALF_TURN_DEG)
    return (yaw_deg + np.where(along, aside, jitter)) % 360.0


def placed(xyz_m: NDArray[np.floating], *, yaw_deg: float, mirror: bool, scale: float) -> NDArray[np.float64]:
    """Return positions (n, 3) of an entry's nodes as a plant of its shape has them: mirrored, turned, scaled."""
    x, y, z = np.asarray(xyz_m, dtype=np.float64).T
    y = -y if mirror else y
    cosine, sine = np.cos(np.radians(yaw_deg)), np.sin(np.radians(yaw_deg))
    return scale * np.column_stack([x * cosine - y * sine, x * sine + y * cosine, z])
