"""Plants grown alone on open ground, and their sizes at several ages from one run."""

from __future__ import annotations

import os
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.skeleton import Skeletons, concatenate, measure, standing
from urbanforest_cli.core.species import Species
from urbanforest_cli.core.traits import OpenGrown, Traits, traits_table
from urbanforest_cli.growth.grove import Grove
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import empty_surroundings

AGES = (10, 20, 30, 50)


@dataclass(frozen=True)
class Sizes:
    """Sizes of plants (rows) at ages (columns).

    Crown diameter is the mean over eight sectors; `crown_middle` the mean height of living twig ends as a share of the
    plant's height: about 0.7 for a vase, 0.6 for a ball on a stem, 0.5 for a cone or a bush.
    """

    ages: tuple[int, ...]
    height_m: NDArray[np.float64]
    dbh_cm: NDArray[np.float64]
    crown_diameter_m: NDArray[np.float64]
    crown_base_m: NDArray[np.float64]
    internode_count: NDArray[np.float64]
    crown_middle: NDArray[np.float64]


def grow_open(
    species_id: str, traits: Traits, open_grown: OpenGrown, *, count: int, age: int, seed: int = 0,
    config: Growth | None = None, latitude_deg: float = 45.0,
) -> Skeletons:  # fmt: skip
    """Grow plants of one species to an age, each alone in a grove of its own."""
    config = config or Growth()
    table = traits_table([traits])
    place, last = np.zeros((1, 2)), np.array([float(age)])
    surroundings = empty_surroundings(
        place,
        open_grown.crown_radius_at(last),
        open_grown.height_at(last),
        light_from(latitude_deg, config.sun_share),
    )

    def grow_one(key: np.uint64) -> Skeletons:
        one = Grove(
            keys=np.array([key]), xy_m=place, species=np.zeros(1, np.int64), age_years=last,
            pruning_factor=np.ones(1), clearance_m=np.zeros(1), row_azimuth_rad=np.zeros(1),
        )  # fmt: skip
        return grow_grove(one, surroundings, table, config).skeletons

    keys = keys_for(seed, "open-grown", [f"{species_id}/{number}" for number in range(count)])
    with ThreadPoolExecutor(os.cpu_count()) as pool:
        return concatenate(list(pool.map(grow_one, keys)))


def sizes_at(skeletons: Skeletons, ages: tuple[int, ...] = AGES) -> Sizes:
    """Measure plants at each age."""
    columns = [measure(skeletons, np.full(len(skeletons), age, np.int64)) for age in ages]
    stacked = {name: np.stack([np.asarray(column[name], float) for column in columns], axis=1) for name in columns[0]}
    return Sizes(
        ages=ages, height_m=stacked["height_m"], dbh_cm=100 * stacked["dbh_m"],
        crown_diameter_m=2 * stacked["crown_radius_m"], crown_base_m=stacked["crown_base_m"],
        internode_count=stacked["internode_count"],
        crown_middle=np.stack([crown_middle(skeletons, age) for age in ages], axis=1),
    )  # fmt: skip


def trunks_at(skeletons: Skeletons, ages: tuple[int, ...] = AGES) -> NDArray[np.float64]:
    """Return trunk diameters in cm of plants (rows) at ages (columns)."""
    ends = [np.full(len(skeletons), age, np.int64) for age in ages]
    return 100 * np.stack([measure(skeletons, end)["dbh_m"] for end in ends], axis=1)


def crown_middle(skeletons: Skeletons, age: int) -> NDArray[np.float64]:
    """Return the mean height of living twig ends over the height of each plant; nan where nothing stands."""
    there = standing(skeletons, np.full(len(skeletons), age, np.int64))
    owner = np.repeat(np.arange(len(skeletons)), np.diff(skeletons.first))
    inner = np.zeros(len(there), bool)
    child = np.flatnonzero(there & (skeletons.parent >= 0))
    inner[skeletons.first[owner[child]] + skeletons.parent[child]] = True
    end = np.flatnonzero(there & ~inner)
    height = skeletons.xyz_m[end, 2].astype(float)
    top = np.zeros(len(skeletons))
    np.maximum.at(top, owner[end], height)
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.bincount(owner[end], height, len(skeletons)) / np.bincount(owner[end], minlength=len(skeletons)) / top


def grow_species(species: Species, *, count: int, seed: int = 0, config: Growth | None = None) -> Sizes:
    """Grow plants of a species to the last of AGES; return their sizes at all of them."""
    return sizes_at(
        grow_open(species.id, species.growth, species.open_grown, count=count, age=AGES[-1], seed=seed, config=config)
    )
