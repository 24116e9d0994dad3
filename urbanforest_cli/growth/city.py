"""A city's plants as growth takes them: cut into groves, each with the hash of all that decides its skeletons."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from hashlib import blake2b

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli import __version__
from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.species import Catalogue
from urbanforest_cli.growth.grove import LONGEST_SEASONS, Grove
from urbanforest_cli.growth.groves import cut_into_groves, number_in_lot, row_azimuth
from urbanforest_cli.growth.sunlight import Light
from urbanforest_cli.growth.surroundings import Plants, Site

DECIDED_ELSEWHERE = {
    "detail", "unique_plants_max", "library_size_max", "library_sample", "grove_plants_max", "grove_length_max_m",
    "crown_clearance_m",
}  # fmt: skip
"""Settings that choose which plants grow and where they are cut apart: what follows from them is in the hashes."""
ID_BITS = 52  # whole numbers that every reader keeps, JavaScript's too


@dataclass(frozen=True)
class City:
    """The plants of a city in the order of their ids, and what stands around them; metres of the working CRS.

    Parameters
    ----------
    row
        (n,) each plant's row in the register.
    standing
        (n,) false for plants inside a building, which neither grow nor shade.
    age_years
        (n,) ages as growth takes them: those beyond its longest life are that long.
    clearance_m
        (n,) height below which branches are lifted.
    """

    plant_id: NDArray[np.object_]
    row: NDArray[np.int64]
    lot_id: NDArray[np.object_]
    keys: NDArray[np.uint64]
    xy_m: NDArray[np.float64]
    species: NDArray[np.int64]
    age_years: NDArray[np.float64]
    pruning_factor: NDArray[np.float64]
    clearance_m: NDArray[np.float64]
    azimuth_rad: NDArray[np.float64]
    standing: NDArray[np.bool_]

    def __len__(self) -> int:
        return len(self.plant_id)

    @classmethod
    def of(
        cls,
        *,
        seed: int,
        plant_id: NDArray[np.object_],
        lot_id: NDArray[np.object_],
        xy_m: NDArray[np.float64],
        species: NDArray[np.int64],
        age_years: NDArray[np.float64],
        pruning_factor: NDArray[np.float64],
        clearance_m: NDArray[np.float64],
        buildings: NDArray[np.object_],
    ) -> City:
        """Sort plants by their ids, find their rows and those that stand inside a building."""
        order = np.argsort(plant_id.astype(str), kind="stable")
        plant_id, lot_id, xy_m = plant_id[order], lot_id[order], xy_m[order]
        pruning_factor = pruning_factor[order]
        _, lot = np.unique(lot_id.astype(str), return_inverse=True)
        pruned = pruning_factor < 1
        azimuth = (
            np.where(pruned, row_azimuth(xy_m, lot.astype(np.int64)), 0.0) if pruned.any() else np.zeros(len(xy_m))
        )
        return cls(
            plant_id=plant_id,
            row=order,
            lot_id=lot_id,
            keys=keys_for(seed, "grow", plant_id),
            xy_m=xy_m,
            species=species[order],
            age_years=np.minimum(age_years[order], LONGEST_SEASONS),
            pruning_factor=pruning_factor,
            clearance_m=clearance_m[order],
            azimuth_rad=azimuth,
            standing=~inside_buildings(xy_m, buildings),
        )

    def grove_of(self, rows: NDArray[np.int64]) -> Grove:
        """Return plants as a grove."""
        return Grove(
            keys=self.keys[rows],
            xy_m=self.xy_m[rows],
            species=self.species[rows],
            age_years=self.age_years[rows],
            pruning_factor=self.pruning_factor[rows],
            clearance_m=self.clearance_m[rows],
            row_azimuth_rad=self.azimuth_rad[rows],
        )


def skeleton_numbers(names: Sequence[str]) -> NDArray[np.int64]:
    """Return a number for each name, that of its hash, so that it stays the same from run to run.

    Of two that meet in one number, the later by name takes the next that is free.
    """
    ids = (keys_for(0, "skeleton", names) >> np.uint64(64 - ID_BITS)).astype(np.int64)
    if len(np.unique(ids)) < len(ids):
        taken: set[int] = set()
        for place in sorted(range(len(names)), key=lambda place: names[place]):
            number = int(ids[place])
            while number in taken:
                number = (number + 1) % (1 << ID_BITS)
            taken.add(number)
            ids[place] = number
    return ids


def inside_buildings(xy_m: NDArray[np.float64], buildings: NDArray[np.object_]) -> NDArray[np.bool_]:
    """Tell which positions lie inside a building, its walls not included."""
    inside = np.zeros(len(xy_m), dtype=bool)
    if len(buildings) and len(xy_m):
        points, _ = shapely.STRtree(buildings).query(shapely.points(xy_m), predicate="within")
        inside[points] = True
    return inside


class Ground:
    """The standing plants of a city on their site; plants are named by their rows in the city.

    `rows` are those of the standing plants, in the order the site has them.

    Parameters
    ----------
    buildings, height_m
        (b,) polygons, (b,) heights, NaN where unknown.
    """

    def __init__(
        self,
        city: City,
        catalogue: Catalogue,
        buildings: NDArray[np.object_],
        height_m: NDArray[np.float64],
        light: Light,
        growth: Growth,
    ) -> None:
        self.city, self.growth = city, growth
        self.rows = rows = np.flatnonzero(city.standing)
        self._place = np.full(len(city), -1, dtype=np.int64)
        self._place[rows] = np.arange(len(rows))
        plants = Plants(
            keys=city.keys[rows],
            xy_m=city.xy_m[rows],
            species=city.species[rows],
            age_years=city.age_years[rows],
            pruning_factor=city.pruning_factor[rows],
        )
        self.site = Site(plants, [kind.open_grown for kind in catalogue], buildings, height_m, light, growth)
        settings = growth.model_dump(mode="json", exclude=DECIDED_ELSEWHERE)
        self._settings = json.dumps([__version__, settings], sort_keys=True).encode()
        self._kinds = [json.dumps([kind.id, asdict(kind.growth)], sort_keys=True).encode() for kind in catalogue]

    def places(self, rows: NDArray[np.int64]) -> NDArray[np.int64]:
        """Return the rows of the site that these plants have."""
        return self._place[rows]

    def grow_key(self, rows: NDArray[np.int64]) -> str:
        """Return the hash of all that decides what becomes of plants that grow together."""
        city, places = self.city, self._place[rows]
        digest = blake2b(self._settings, digest_size=16)
        digest.update(self.site.reach_print(places))
        for row in rows.tolist():
            digest.update(f"\x1f{city.plant_id[row]}\x1e".encode("utf-8", "surrogatepass"))
            digest.update(self._kinds[city.species[row]])
        digest.update(city.clearance_m[rows].tobytes())
        digest.update(city.azimuth_rad[rows].tobytes())
        return digest.hexdigest()


@dataclass(frozen=True)
class Job:
    """Plants to grow together: rows of the city, and the hash of all that decides what becomes of them.

    `library` marks a plant that grows alone, its skeleton to stand for many; `kept` a grove that stays as it is stored,
    though by now it would grow otherwise.
    """

    grove_id: str
    lot_id: str
    rows: NDArray[np.int64]
    grow_key: str
    library: bool = False
    kept: bool = False


@dataclass(frozen=True)
class LotGrove:
    """Plants of a lot that grow together: rows of the city."""

    grove_id: str
    lot_id: str
    rows: NDArray[np.int64]


def lot_groves(ground: Ground) -> list[LotGrove]:
    """Return the groves of a city, in the order of lots and of their numbers within them."""
    city = ground.city
    rows = np.flatnonzero(city.standing)
    names, lot = np.unique(city.lot_id[rows].astype(str), return_inverse=True)
    lot = lot.astype(np.int64)
    grove = cut_into_groves(lot, city.xy_m[rows], city.keys[rows], ground.growth)
    number = number_in_lot(lot, grove)
    order = np.argsort(grove, kind="stable")
    ends = np.flatnonzero(np.diff(grove[order], append=-1)) + 1
    starts = np.append(0, ends[:-1])
    groves = []
    for start, end in zip(starts.tolist(), ends.tolist(), strict=False):
        members = order[start:end]
        name = str(names[lot[members[0]]])
        groves.append(LotGrove(f"{name}/{number[members[0]]}", name, rows[members]))
    return groves


def lot_jobs(ground: Ground, groves: Sequence[LotGrove]) -> list[Job]:
    """Return what there is to grow in groves."""
    return [Job(grove.grove_id, grove.lot_id, grove.rows, ground.grow_key(grove.rows)) for grove in groves]


def plant_jobs(ground: Ground, rows: Sequence[int] | NDArray[np.int64]) -> list[Job]:
    """Return plants each as a grove of its own, all others around it: the library of a city."""
    city = ground.city
    jobs = []
    for row in np.sort(np.asarray(rows, dtype=np.int64)):
        own = np.array([row])
        jobs.append(
            Job(f"library/{city.plant_id[row]}", str(city.lot_id[row]), own, ground.grow_key(own), library=True)
        )
    return jobs


def job_numbers(city: City, jobs: Sequence[Job]) -> list[NDArray[np.int64]]:
    """Return the numbers of the skeletons of each job."""
    names = [
        f"library/{plant}" if job.library else str(plant) for job in jobs for plant in city.plant_id[job.rows].tolist()
    ]
    numbers = skeleton_numbers(names)
    ends = np.cumsum([len(job.rows) for job in jobs])
    return np.split(numbers, ends[:-1]) if len(jobs) else []


def part_digest(jobs: Sequence[Job], skeleton_ids: Sequence[NDArray[np.int64]]) -> str:
    """Return the digest of all that decides a part's content."""
    digest = blake2b(digest_size=12)
    for job, ids in zip(jobs, skeleton_ids, strict=True):
        digest.update(f"{job.grove_id}\x1f{job.lot_id}\x1f{job.grow_key}\x1e".encode("utf-8", "surrogatepass"))
        digest.update(ids.tobytes())
    return digest.hexdigest()
