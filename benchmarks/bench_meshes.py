"""Measure meshes of wood; run `python -m benchmarks meshes`.

Times are the least of several, the kernels compiled before; CPU seconds of one thread, wall time of two. Ratios against
the readable reference hold within the run, times on this machine alone.
"""

from __future__ import annotations

import os
import time
from collections.abc import Callable

import numpy as np

from tests.reference.wood import wood_by_hand
from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.config import Species as SpeciesSection
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.scenery import Meshes
from urbanforest_cli.core.skeleton import Skeletons, concatenate, select
from urbanforest_cli.core.traits import traits_table
from urbanforest_cli.export.mesh.levels import LEVELS
from urbanforest_cli.export.mesh.wood import build_wood
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth.grove import Grove
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site

AGE_YEARS = 30.0
COPIES = 12  # of each plant, so that the kernels have something to do
APART_M = 40.0
CORNER = np.array([400_000.0, 5_500_000.0])


def plants() -> Skeletons:
    """Return a plant of each shipped species, grown in the open for 30 years."""
    catalogue = load_catalogue(SpeciesSection())
    count, growth = len(catalogue), Growth()
    xy = CORNER + np.column_stack([APART_M * np.arange(count), np.zeros(count)])
    keys = keys_for(0, "bench", [str(number) for number in range(count)])
    ages = np.full(count, AGE_YEARS)
    rows = np.arange(count)
    light = light_from(50.0, growth.sun_share)
    site = Site(Plants(keys, xy, rows, ages, np.ones(count)), [species.open_grown for species in catalogue],
                np.array([], dtype=object), np.zeros(0), light, growth)  # fmt: skip
    grove = Grove(keys, xy, rows, ages, np.ones(count), np.zeros(count), np.zeros(count))
    traits = traits_table([species.growth for species in catalogue])
    return grow_grove(grove, site.around(rows), traits, growth).skeletons


def timed(work: Callable[[], Meshes], clock: Callable[[], float], repeats: int = 7) -> tuple[Meshes, float]:
    """Return the result and the fewest seconds that a piece of work took."""
    seconds = []
    for _ in range(repeats):
        start = clock()
        result = work()
        seconds.append(clock() - start)
    return result, min(seconds)


def main() -> None:
    """Print triangles a second of each level."""
    one_each = plants()
    many = concatenate([one_each] * COPIES)
    first = select(one_each, [0])
    print(f"{len(many)} plants of {AGE_YEARS:g} years, {len(many.parent):,} nodes; load {os.getloadavg()[0]:.1f}")
    print("level    triangles a plant   M/s a CPU second   M/s of two threads   bytes a triangle   times the reference")
    for level in LEVELS.values():
        if level.sides[1] == 0:
            continue
        build_wood(first, first.seasons, level)
        meshes, cpu_s = timed(lambda at=level: build_wood(many, many.seasons, at), time.thread_time)  # type: ignore[misc]
        _, wall_s = timed(lambda at=level: build_wood(many, many.seasons, at, workers=2), time.perf_counter)  # type: ignore[misc]
        start = time.thread_time()
        by_hand = wood_by_hand(first, int(first.seasons[0]), level)
        slow = len(by_hand.triangle) / (time.thread_time() - start)
        count = len(meshes.triangle)
        a_plant = np.median(np.diff(meshes.first_triangle))
        size = sum(getattr(meshes, name).nbytes for name in ("xyz_m", "normal", "uv", "tint", "triangle")) / count
        print(f"{level.name:8s}{a_plant:18,.0f}{count / cpu_s / 1e6:19.1f}{count / wall_s / 1e6:21.1f}{size:19.1f}"
              f"{count / cpu_s / slow:22,.0f}", flush=True)  # fmt: skip


if __name__ == "__main__":
    main()
