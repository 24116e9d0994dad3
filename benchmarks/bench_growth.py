"""Measure growth; run `python -m benchmarks.bench_growth`.

Times are CPU seconds of this process, the least of several; the kernels are compiled before the clock starts. Ratios
hold within the run, times on this machine alone.
"""

from __future__ import annotations

import os
import resource
import time
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import shapely
from numpy.typing import NDArray

from tests.reference.growth import SlowGrove
from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.config import Species as SpeciesSection
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.skeleton import measure
from urbanforest_cli.core.traits import traits_table
from urbanforest_cli.files.species import load_catalogue
from urbanforest_cli.growth.grove import Grove, GrownGrove, Surroundings, TraitsTable
from urbanforest_cli.growth.simulate import grow_grove
from urbanforest_cli.growth.sunlight import light_from
from urbanforest_cli.growth.surroundings import Plants, Site

TREES = ("platanus_acerifolia", "quercus_rubra", "tilia_cordata", "acer_platanoides", "gleditsia_triacanthos")
SHRUB = "corylus_avellana"
MATURE_INTERNODES = 5500
CORNER = np.array([400_000.0, 5_500_000.0])

Scene = tuple[Grove, Surroundings]


class City:
    """Plants of the shipped species and houses, and the scenes made of them."""

    def __init__(self, growth: Growth) -> None:
        catalogue = load_catalogue(SpeciesSection())
        self.growth = growth
        self.traits: TraitsTable = traits_table([species.growth for species in catalogue])
        self.open_grown = [species.open_grown for species in catalogue]
        self.row = {species.id: row for row, species in enumerate(catalogue)}

    def scene(
        self, xy_m: NDArray[np.float64], names: list[str], age_years: NDArray[np.float64], houses: list[shapely.Polygon]
    ) -> Scene:
        """Return one grove and what stands around it."""
        count = len(xy_m)
        species = np.array([self.row[name] for name in names], dtype=np.int64)
        keys = keys_for(0, "bench", [str(number) for number in range(count)])
        plants = Plants(keys, xy_m, species, age_years, np.ones(count))
        light = light_from(50.0, self.growth.sun_share)
        built = np.array(houses, dtype=object)
        site = Site(plants, self.open_grown, built, np.full(len(built), 9.0), light, self.growth)
        grove = Grove(keys, xy_m, species, age_years, np.ones(count), np.zeros(count), np.zeros(count))
        return grove, site.around(np.arange(count))

    def alone(self, name: str, age_years: float) -> Scene:
        """Return one plant in the open."""
        return self.scene(CORNER[None, :].copy(), [name], np.array([age_years]), [])

    def lot(self) -> Scene:
        """Return 30 plants of a lot of 48 x 40 m with two houses."""
        rng = np.random.default_rng(3)
        x, y = np.meshgrid(np.arange(4.0, 48.0, 8.0), np.arange(4.0, 40.0, 8.0))
        xy = CORNER + np.column_stack([x.ravel(), y.ravel()]) + rng.uniform(-1.5, 1.5, (30, 2))
        sides = np.array([[17.5, 14.5, 26.0, 22.0], [34.0, 30.5, 44.0, 33.5]]) + np.tile(CORNER, 2)
        houses = list(shapely.box(*sides.T))
        clear = ~shapely.contains_xy(shapely.buffer(shapely.union_all(houses), 0.5), *xy.T)
        xy = np.where(clear[:, None], xy, CORNER + np.column_stack([x.ravel(), y.ravel()]) + (-3.9, 0.0))
        names = [SHRUB if number % 6 == 5 else TREES[number % 5] for number in range(30)]
        return self.scene(xy, names, rng.uniform(15, 40, 30), houses)

    def grow(self, scene: Scene) -> GrownGrove:
        """Grow a scene."""
        return grow_grove(*scene, self.traits, self.growth)


def least(act: Callable[[], object], repeats: int = 7) -> float:
    """Return the least CPU seconds of this process that an act takes."""
    times = []
    for _ in range(repeats):
        start = time.process_time()
        act()
        times.append(time.process_time() - start)
    return min(times)


def mature(city: City) -> tuple[str, float]:
    """Return species and age, 30 to 40 years, of the tree with most nearly MATURE_INTERNODES standing internodes."""
    off = {}
    for name in TREES:
        for age in (30.0, 35.0, 40.0):
            off[name, age] = abs(int(city.grow(city.alone(name, age)).retained[0]) - MATURE_INTERNODES)
    near = [tree for tree, internodes in off.items() if internodes <= 500]
    return max(near, key=lambda tree: tree[1]) if near else min(off, key=lambda tree: off[tree])


def main() -> None:
    print("one tree, CPU")
    for environment in ("shadow", "both", "markers"):
        city = City(Growth(environment=environment))  # type: ignore[arg-type]
        name, age = mature(city)
        scene = city.alone(name, age)
        grown, seconds = city.grow(scene), least(lambda: city.grow(scene))  # noqa: B023
        retained, generated = int(grown.retained.sum()), int(grown.generated.sum())
        print(
            f"  {environment:8} {name}, {age:.0f} years: {1000 * seconds:6.1f} ms, {retained} internodes of "
            f"{generated} grown; {retained / seconds / 1000:.0f}k standing, {generated / seconds / 1000:.0f}k grown a s"
        )

    city = City(Growth())
    lot = city.lot()
    for environment in ("shadow", "both"):
        other = City(Growth(environment=environment))  # type: ignore[arg-type]
        grown, seconds = other.grow(lot), least(lambda: other.grow(lot), 5)  # noqa: B023
        print(
            f"30 plants and two houses, {environment}: {seconds:.2f} s CPU, {1000 * seconds / 30:.1f} ms a plant, "
            f"{grown.retained.sum()} internodes of {grown.generated.sum()}"
        )
        node_bytes, grid_bytes = grown.live_bytes, grown.grid_bytes
        print(
            f"  memory: {node_bytes / grown.retained.sum():.0f} bytes a standing internode, "
            f"{node_bytes / grown.generated.sum():.0f} a grown one, grids {grid_bytes / 1e6:.1f} MB"
        )

    groves = [city.alone(TREES[number % 5], 30.0) for number in range(40)]

    def with_threads(count: int) -> tuple[float, float]:
        before, start = time.process_time(), time.perf_counter()
        with ThreadPoolExecutor(count) as pool:
            list(pool.map(city.grow, groves))
        return time.perf_counter() - start, time.process_time() - before

    rounds = [(with_threads(1), with_threads(2)) for _ in range(5)]
    wall = [min(pair[k][0] for pair in rounds) for k in (0, 1)]
    cpu = [min(pair[k][1] for pair in rounds) for k in (0, 1)]
    print(
        f"40 groves, two threads against one: x{wall[0] / wall[1]:.2f} in wall time, x{cpu[1] / cpu[0]:.2f} CPU; "
        f"{len(groves) / wall[1]:.0f} trees a second ({os.cpu_count()} cores, {os.getloadavg()[0]:.1f} busy in the "
        "last minute: the first number says little where others work too)"
    )

    small = city.alone(TREES[0], 14.0)
    slow = SlowGrove(*small, city.traits, city.growth)
    start = time.process_time()
    plants = slow.grow()
    readable = time.process_time() - start
    fast, grown = least(lambda: city.grow(small)), city.grow(small)
    assert grown.generated[0] == len(plants[0].nodes) - 1, "the kernels grow what the reference grows"
    print(
        f"kernels against the readable reference, {grown.generated[0]} internodes of one tree: "
        f"{grown.generated[0] / fast / 1000:.0f}k to {grown.generated[0] / readable / 1000:.1f}k internodes a s, "
        f"x{readable / fast:.0f}"
    )
    heights = measure(city.grow(lot).skeletons)["height_m"]
    assert np.isfinite(heights).all(), "every plant can be measured"
    print(f"peak memory of this process {resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024:.0f} MB")


if __name__ == "__main__":
    main()
