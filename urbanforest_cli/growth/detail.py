"""Which plants of a city grow in their own place, and which take the shape of another that grew for many."""

from __future__ import annotations

from collections.abc import Container, Sequence
from dataclasses import dataclass, field, replace
from typing import Literal

import geopandas as gpd
import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.errors import InputError
from urbanforest_cli.core.traits import OpenGrown
from urbanforest_cli.growth.accounts import Accounts
from urbanforest_cli.growth.city import Ground, Job, LotGrove, lot_groves, lot_jobs, plant_jobs, skeleton_numbers
from urbanforest_cli.growth.grove import GROWN, NO_ROOM
from urbanforest_cli.growth.library import SECTORS, Library, describe, match, plan_library
from urbanforest_cli.growth.openness import openness_of
from urbanforest_cli.growth.shape_error import sample_plants
from urbanforest_cli.growth.trees import Stand

PLANTS_A_SAMPLE = 8
"""Plants grown, at most, for each plant of the sample that the library's error is measured on: groves grow whole."""
COMPARED_A_SAMPLE = 3
"""Plants of those groves compared, at most, for each plant of the sample."""


def detail_in_force(growth: Growth, plant_count: int) -> Literal["unique", "library"]:
    """Return what ``auto`` means for a city of this many plants."""
    if growth.detail != "auto":
        return growth.detail
    return "unique" if plant_count <= growth.unique_plants_max else "library"


@dataclass(frozen=True)
class Choice:
    """What is to grow: groves of lots for themselves, then the library's entries; and how the library is used.

    `openness` are the keys of all standing plants, for the library; `sampled` are rows of the city that its error is
    measured on. `whole` tells that these are all groves of the city as they would grow now.
    """

    jobs: list[Job]
    library: Library | None = None
    openness: NDArray[np.float64] | None = None
    sampled: NDArray[np.int64] = field(default_factory=lambda: np.empty(0, dtype=np.int64))
    whole: bool = True


@dataclass(frozen=True)
class GroveInForce:
    """A grove as a register has it: the numbers of its skeletons, and the hash of all that decided them then."""

    grove_id: str
    lot_id: str
    skeleton_ids: tuple[int, ...]
    grow_key: str


@dataclass(frozen=True)
class Comparison:
    """Plants that grew in their own place, and what each would have from the library.

    Parameters
    ----------
    own_id, entry_id
        (k,) numbers of the skeletons.
    yaw_deg, mirror, scale
        (k,) how the library's is placed.
    one_dead
        Further plants of the sample of which only one stands: the plant in its own place, or what the library has.
    """

    own_id: NDArray[np.int64]
    entry_id: NDArray[np.int64]
    yaw_deg: NDArray[np.float64]
    mirror: NDArray[np.bool_]
    scale: NDArray[np.float64]
    one_dead: int

    def __len__(self) -> int:
        return len(self.own_id)


def lots_in_focus(
    lot_ids: frozenset[str],
    plants: gpd.GeoDataFrame,
    asked: Sequence[str] | None,
    bbox: tuple[float, float, float, float] | None,
) -> frozenset[str] | None:
    """Return the lots named and those with a plant in a box in the CRS of the plants, None where neither is given.

    Raises
    ------
    InputError
        A lot is not there, the box has no inside, or no plant is in focus.
    """
    if asked is None and bbox is None:
        return None
    focus = {lot.strip() for lot in asked or () if lot.strip()}
    if missing := sorted(focus - lot_ids):
        raise InputError(
            "lots that are not in the register",
            where="--only",
            found=", ".join(missing[:10]),
            expected=f"lot ids such as {', '.join(sorted(lot_ids)[:3])}",
        )
    if bbox is not None:
        west, south, east, north = bbox
        if not (west < east and south < north):
            raise InputError(
                "a box without an inside",
                where="--bbox",
                found=" ".join(f"{value:g}" for value in bbox),
                expected="west, south, east, north in the CRS of the register",
            )
        x, y = shapely.get_coordinates(plants.geometry.to_numpy()).T
        within = (x >= west) & (x <= east) & (y >= south) & (y <= north)
        focus |= set(plants["lot_id"][within])
    if not focus & set(plants["lot_id"]):
        raise _no_plant(plants, focus, bbox)
    return frozenset(focus)


def _no_plant(plants: gpd.GeoDataFrame, focus: set[str], bbox: tuple[float, float, float, float] | None) -> InputError:
    """Return the error of a focus without plants."""
    if not len(plants):
        expected = "a register with plants"
    elif bbox is not None:
        expected = "a box that meets " + " ".join(f"{value:.10g}" for value in plants.total_bounds)
    else:
        expected = f"lots with plants such as {', '.join(sorted(set(plants['lot_id']))[:3])}"
    found = ", ".join(sorted(focus)[:10]) if bbox is None else " ".join(f"{value:.10g}" for value in bbox)
    return InputError(
        "no plant is in focus", where="--only" if bbox is None else "--bbox", found=found or "no lot", expected=expected
    )


def choose_all(ground: Ground) -> Choice:
    """Let every plant grow in its own place."""
    return Choice(lot_jobs(ground, lot_groves(ground)))


def choose_focus(
    ground: Ground, focus: frozenset[str], in_force: Sequence[GroveInForce], stored: Container[str]
) -> Choice:
    """Let the plants of lots in focus grow, each in its own place; those of others stay as they are.

    Parameters
    ----------
    in_force
        What has grown of these very plants, with whatever settings, in the order of the groves of each lot.
    stored
        Keys of groves that need not grow again: they are taken for lots of which nothing is in force.
    """
    city = ground.city
    now = lot_jobs(ground, lot_groves(ground))
    by_key = {job.grow_key: job for job in now}
    row_of = {number: row for row, number in enumerate(skeleton_numbers(city.plant_id.tolist()).tolist())}
    by_lot: dict[str, list[Job]] = {}
    for job in now:
        if job.lot_id in focus:
            by_lot.setdefault(job.lot_id, []).append(job)
    for grove in in_force:
        rows = np.array([row_of.get(number, -1) for number in grove.skeleton_ids], dtype=np.int64)
        if grove.lot_id not in focus and (rows >= 0).all() and (city.lot_id[rows] == grove.lot_id).all():
            kept = Job(grove.grove_id, grove.lot_id, rows, grove.grow_key, kept=True)
            by_lot.setdefault(grove.lot_id, []).append(by_key.get(grove.grow_key, kept))
    bare = [job for job in now if job.lot_id not in by_lot and job.grow_key in stored]
    for job in bare:
        by_lot.setdefault(job.lot_id, []).append(job)
    jobs = [job for lot in sorted(by_lot) for job in by_lot[lot]]
    whole = [(job.grove_id, job.grow_key) for job in jobs] == [(job.grove_id, job.grow_key) for job in now]
    return Choice(jobs, whole=whole)


def choose_library(ground: Ground, focus: frozenset[str], open_grown: Sequence[OpenGrown]) -> Choice:
    """Let the lots in focus and a sample grow in their own place; all others take from a library."""
    growth, plants = ground.growth, ground.site.plants
    groves = lot_groves(ground)
    sampled = _sampled(ground, groves)
    chosen = [
        grove for number, grove in enumerate(groves) if grove.lot_id in focus or number in sampled
    ]  # fmt: skip
    openness = openness_of(ground.site) if len(plants) else np.empty((0, SECTORS + 1))
    library = plan_library(
        openness, plants.species, plants.age_years, plants.pruning_factor, plants.keys,
        size_max=growth.library_size_max, open_grown=open_grown, **_rows_and_clearance(ground),
    )  # fmt: skip
    jobs = lot_jobs(ground, chosen) + plant_jobs(ground, ground.rows[library.entry])
    rows = np.concatenate([np.empty(0, dtype=np.int64), *(groves[number].rows for number in sampled)])
    return Choice(jobs, library, openness, rows)


def _rows_and_clearance(ground: Ground) -> dict[str, NDArray[np.float64]]:
    """Return how high the branches of the standing plants are lifted, and the direction of the row each is in."""
    return {
        "clearance_m": ground.city.clearance_m[ground.rows],
        "row_azimuth_rad": ground.city.azimuth_rad[ground.rows],
    }


def _sampled(ground: Ground, groves: Sequence[LotGrove]) -> list[int]:
    """Return the numbers of groves to grow so that the library can be held against them."""
    count = ground.growth.library_sample
    grove_of = np.full(len(ground.city), -1, dtype=np.int64)
    for number, grove in enumerate(groves):
        grove_of[grove.rows] = number
    found: list[int] = []
    left = PLANTS_A_SAMPLE * count
    for place in sample_plants(ground.site.plants.keys, count).tolist():
        number = int(grove_of[ground.rows[place]])
        if number not in found and (not found or len(groves[number].rows) <= left):
            found.append(number)
            left -= len(groves[number].rows)
    return found


def stand_of(
    ground: Ground, choice: Choice, numbers: Sequence[NDArray[np.int64]], accounts: Accounts, sizes: Sequence[OpenGrown]
) -> tuple[Stand, Comparison | None]:
    """Return which skeleton stands for each plant, in the register's order, and what the library is held against.

    Parameters
    ----------
    numbers
        Numbers of the skeletons of each job.
    accounts
        What became of them.
    sizes
        Open-grown sizes of each species.
    """
    city = ground.city
    stand = Stand.bare(len(city))
    stand.reason[city.row] = np.where(city.standing, "out_of_focus", "no_room")
    if choice.library is not None:
        found = {int(job.rows[0]): int(ids[0]) for job, ids in zip(choice.jobs, numbers, strict=True) if job.library}
        entry_id = np.array([found[row] for row in ground.rows[choice.library.entry].tolist()], dtype=np.int64)
        roomless = np.isin(entry_id, accounts.skeleton_id[accounts.outcome == NO_ROOM])
        library = _without(ground, choice, roomless, sizes) if roomless.any() else choice.library
        row = city.row[ground.rows]
        stand.put_library(row, entry_id[library.of_plant], library)
        stand.put_own(row[choice.library.entry[roomless]], entry_id[roomless])
    compared = city.row[choice.sampled]
    others = stand.taken(compared)
    for job, ids in zip(choice.jobs, numbers, strict=True):
        if not job.library:
            stand.put_own(city.row[job.rows], ids)
    if choice.library is None:
        return stand, None
    return stand, _comparison(ground, choice, stand.skeleton_id[compared], others, accounts)


def _without(ground: Ground, choice: Choice, left_out: NDArray[np.bool_], sizes: Sequence[OpenGrown]) -> Library:
    """Match all plants again with some entries left out; a species keeps its entries if it has no other."""
    assert choice.library is not None, "a library was planned"
    assert choice.openness is not None, "a library was planned"
    plants, entry = ground.site.plants, choice.library.entry
    kept = ~left_out | ~np.isin(plants.species[entry], plants.species[entry[~left_out]])
    features = describe(
        choice.openness, plants.species, plants.age_years, plants.pruning_factor, sizes, **_rows_and_clearance(ground)
    )
    again = match(features, entry[kept], plants.keys)
    return replace(again, of_plant=np.flatnonzero(kept)[again.of_plant], entry=entry)


def _comparison(
    ground: Ground, choice: Choice, own_id: NDArray[np.int64], others: Stand, accounts: Accounts
) -> Comparison:
    """Return the pairs that both stand, a plant in its own place and what the library has for it; count the unlike."""
    alive = accounts.skeleton_id[accounts.outcome == GROWN]
    own_stands, other_stands = np.isin(own_id, alive), np.isin(others.skeleton_id, alive)
    either = np.flatnonzero(own_stands | other_stands)
    keys = ground.city.keys[choice.sampled[either]]
    drawn = either[np.sort(sample_plants(keys, COMPARED_A_SAMPLE * ground.growth.library_sample))]
    chosen = drawn[own_stands[drawn] & other_stands[drawn]]
    return Comparison(
        own_id=own_id[chosen],
        entry_id=others.skeleton_id[chosen],
        yaw_deg=others.yaw_deg[chosen],
        mirror=others.mirror[chosen].astype(bool),
        scale=others.scale[chosen],
        one_dead=len(drawn) - len(chosen),
    )
