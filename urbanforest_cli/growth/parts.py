"""What stands in one file of skeletons: its groves, their row groups, and what is remembered of their plants."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from urbanforest_cli.core.skeleton import Skeletons, concatenate, quantise
from urbanforest_cli.growth import simulate
from urbanforest_cli.growth.accounts import Accounts, joined
from urbanforest_cli.growth.batches import cut_into_parts
from urbanforest_cli.growth.city import Ground, Job, part_digest
from urbanforest_cli.growth.grove import TraitsTable

NODES_A_ROW_GROUP = 40_000

Grown = tuple[Skeletons, Accounts]


@dataclass(frozen=True)
class PartPlan:
    """A part that is wanted: the digest of all that decides it, what is to grow, and the skeletons' numbers."""

    digest: str
    jobs: list[Job]
    numbers: list[NDArray[np.int64]]

    @property
    def plant_count(self) -> int:
        """The number of plants in it."""
        return sum(len(job.rows) for job in self.jobs)

    def questions(self) -> list[tuple[Job, NDArray[np.int64]]]:
        """Return each job with the numbers of its skeletons."""
        return list(zip(self.jobs, self.numbers, strict=True))


@dataclass(frozen=True)
class PartContent:
    """A part's row groups, its groves as rows of the layer, and the accounts of its plants."""

    groups: list[Skeletons]
    groves: list[dict[str, Any]]
    accounts: Accounts


def plan_parts(jobs: Sequence[Job], numbers: Sequence[NDArray[np.int64]]) -> list[PartPlan]:
    """Deal out jobs to parts, those of lots before those of the library."""
    plans = []
    for library in (False, True):
        chosen = [place for place, job in enumerate(jobs) if job.library == library]
        sizes = [len(jobs[place].rows) for place in chosen]
        for cut in cut_into_parts([jobs[place].lot_id for place in chosen], sizes):
            own = [jobs[chosen[place]] for place in cut]
            ids = [numbers[chosen[place]] for place in cut]
            plans.append(PartPlan(part_digest(own, ids), own, ids))
    return plans


def grow_job(ground: Ground, traits: TraitsTable, job: Job, numbers: NDArray[np.int64]) -> Grown:
    """Grow the plants of a job; skeletons come as a file gives them back, sizes are those of these skeletons."""
    surroundings = ground.site.around(ground.places(job.rows))
    grown = simulate.grow_grove(ground.city.grove_of(job.rows), surroundings, traits, ground.growth)
    skeletons = quantise(replace(grown.skeletons, skeleton_id=numbers))
    return skeletons, Accounts.of(grown, skeletons)


def collect(plan: PartPlan, grown: Iterator[Grown]) -> PartContent:
    """Await the groves of a part and lay them out in row groups."""
    groups: list[Skeletons] = []
    held: list[Skeletons] = []
    groves, accounts = [], []
    nodes = 0
    for place, job in enumerate(plan.jobs):
        skeletons, account = next(grown)
        groves.append(
            {
                "grove_id": job.grove_id,
                "lot_id": job.lot_id,
                "kind": "library" if job.library else "lot",
                "plant_count": len(job.rows),
                "row_group": len(groups),
                "grow_key": job.grow_key,
            }
        )
        accounts.append(account)
        held.append(skeletons)
        nodes += len(skeletons.parent)
        if nodes >= NODES_A_ROW_GROUP or place == len(plan.jobs) - 1:
            groups.append(concatenate(held))
            held, nodes = [], 0
    return PartContent(groups, groves, joined(accounts))
