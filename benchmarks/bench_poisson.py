"""Measure the saturated sampler against plain samplers; run `python -m benchmarks.bench_poisson`.

Times are CPU seconds of one thread, and ratios hold within the run. Kernels are compiled before the clock starts.
"""

from __future__ import annotations

import time
from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.stats import qmc

from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.placement.poisson import SaturatedSample, sample_saturated

MEAN_M, VARIANCE_M2 = 3.13, 0.35
TRIES = 300
PAPER_POSITIONS_PER_S = 54_000 / 60  # paper, section Results: "54k plant positions in about 60 s"


def city_lots(count: int, seed: int = 1) -> NDArray[np.object_]:
    """Return lots of eight corners, about 400 m2 in the mean, with a hole where the house stands."""
    rng = np.random.default_rng(seed)
    angle = np.arange(8) * np.pi / 4 + rng.uniform(-0.25, 0.25, (count, 8))
    reach = rng.uniform(8.0, 16.0, (count, 1)) * rng.uniform(0.85, 1.15, (count, 8))
    outer = np.stack([reach * np.cos(angle), reach * np.sin(angle)], axis=-1)
    lots = shapely.polygons(outer)
    return np.asarray(shapely.difference(lots, shapely.buffer(lots, -9.0, quad_segs=8)))


def central_park(seed: int = 2) -> NDArray[np.object_]:
    """Return a rectangle of 341 ha less 40 ponds of irregular outline."""
    rng = np.random.default_rng(seed)
    width, height = 800.0, 4262.5
    angle = np.linspace(0, 2 * np.pi, 60, endpoint=False)
    ponds = []
    for _ in range(40):
        radius = rng.uniform(18, 85) * (1 + 0.25 * np.sin(3 * angle + rng.uniform(0, 6)))
        middle = rng.uniform((0, 0), (width, height))
        ponds.append(shapely.Polygon(middle + radius[:, None] * np.column_stack([np.cos(angle), np.sin(angle)])))
    return np.array([shapely.difference(shapely.box(0, 0, width, height), shapely.union_all(ponds))], dtype=object)


def darts(areas: NDArray[np.object_], seed: int = 3, batch: int = 100) -> int:
    """Throw darts with radii, in batches of numpy, until `TRIES` in a row have missed; return how many stand."""
    rng = np.random.default_rng(seed)
    total = 0
    for area in areas:
        shapely.prepare(area)
        west, south, east, north = area.bounds
        placed = np.empty((0, 3))
        misses = 0
        while misses < TRIES:
            dart = rng.uniform((west, south), (east, north), (batch, 2))
            dart = dart[shapely.contains_xy(area, dart[:, 0], dart[:, 1])]
            radius = rng.normal(MEAN_M, np.sqrt(VARIANCE_M2), len(dart))
            room = np.full(len(dart), np.inf)
            if len(placed):
                room = (np.hypot(dart[:, :1] - placed[:, 0], dart[:, 1:] - placed[:, 1]) - placed[:, 2]).min(axis=1)
            first = np.flatnonzero(room >= radius)[:1]
            misses = 0 if len(first) else misses + len(dart)
            placed = np.vstack([placed, np.column_stack([dart[first], radius[first]])])
        total += len(placed)
    return total


def scipy_discs(side_m: float, seed: int = 4) -> int:
    """Fill a square with scipy's sampler of equal discs."""
    sampler = qmc.PoissonDisk(2, radius=2 * MEAN_M / side_m, ncandidates=TRIES, rng=np.random.default_rng(seed))
    return len(sampler.fill_space())


def saturated(areas: NDArray[np.object_], variance_m2: float = VARIANCE_M2, **options: str) -> SaturatedSample:
    """Run the sampler under test."""
    keys = keys_for(0, "bench", map(str, range(len(areas))))
    return sample_saturated(areas, MEAN_M, variance_m2, keys, **options)  # type: ignore[arg-type]


def timed(work: Callable[[], int], repeats: int = 3) -> tuple[int, float]:
    """Return a count and the fewest CPU seconds that a piece of work took."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        count = work()
        seconds.append(time.process_time() - start)
    return count, min(seconds)


def line(name: str, count: int, seconds: float, against: float) -> float:
    """Print one row; return positions a second."""
    rate = count / seconds
    ratio = f"{rate / against:7.1f}x" if against else ""
    print(f"{name:54s}{count:9,d} positions {seconds:7.3f} s {rate:10,.0f}/s {ratio}")
    return rate


def radii(name: str, sample: SaturatedSample, variance_m2: float) -> None:
    """Print how near the realised radii come to what was asked for."""
    mean, variance = sample.radius_m.mean(), sample.radius_m.var()
    print(
        f"{name:40s} variance {variance_m2:4.2f}: n {len(sample.site):6d}, mean {mean / MEAN_M - 1:+.2%}, "
        f"variance {variance / variance_m2 - 1:+.1%}, unresolved {sample.unresolved_area_m2.sum():.0e} m2"
    )


def main() -> None:
    """Print all measurements."""
    lots, few, park = city_lots(4000), city_lots(60), central_park()
    square = np.array([shapely.box(0, 0, 200, 200)], dtype=object)
    saturated(few)

    print(f"mean {MEAN_M} m, variance {VARIANCE_M2} m2 unless said otherwise; last column: times the line named")
    base = line(f"numpy darts, {TRIES} tries, 60 lots", *timed(lambda: darts(few), 1), 0)
    for variance in (VARIANCE_M2, 2.0, 0.0):
        work = timed(lambda v=variance: len(saturated(lots, v).site))  # type: ignore[misc]
        line(f"saturated, 4,000 lots, variance {variance:g} (numpy darts)", *work, base)
    work = timed(lambda: len(saturated(lots, radius_stop="min", radius_law="redrawn").site), 1)
    line("saturated, 4,000 lots, redrawn to the smallest", *work, base)
    base = line("numpy darts, 300 tries, 200 m square", *timed(lambda: darts(square), 1), 0)
    line("saturated, 200 m square (numpy darts)", *timed(lambda: len(saturated(square).site)), base)
    base = line("scipy PoissonDisk, 300 candidates, 200 m square", *timed(lambda: scipy_discs(200.0), 1), 0)
    line("saturated, variance 0, 200 m square (scipy)", *timed(lambda: len(saturated(square, 0.0).site)), base)
    for variance in (VARIANCE_M2, 2.0, 0.0):
        work = timed(lambda v=variance: len(saturated(park, v).site))  # type: ignore[misc]
        line(f"saturated, 341 ha less 40 ponds, variance {variance:g} (paper)", *work, PAPER_POSITIONS_PER_S)
    print()
    for variance in (0.1, VARIANCE_M2, 1.0, 2.0):
        radii("341 ha less 40 ponds", saturated(park, variance), variance)
        radii("4,000 lots together", saturated(lots, variance), variance)


if __name__ == "__main__":
    main()
