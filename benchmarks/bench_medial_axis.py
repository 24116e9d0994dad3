"""Measure medial axes, rows and lattices against what others offer; run `python -m benchmarks.bench_medial_axis`.

Times are CPU seconds of one thread, and ratios hold within the run. Kernels are compiled before the clock starts.
"""

from __future__ import annotations

import time
import warnings
from collections.abc import Callable

import numpy as np
import shapely
from numpy.typing import NDArray
from scipy.spatial import Voronoi

from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.placement.equidistant import equidistant_positions
from urbanforest_cli.placement.lattice import lattice_positions
from urbanforest_cli.placement.medial_axis import medial_axes

STEP_M = 1.0


def city_lots(count: int, seed: int = 1) -> NDArray[np.object_]:
    """Return lots of eight corners, 435 m2 in the median and about 97 samples a metre apart."""
    rng = np.random.default_rng(seed)
    angle = (np.arange(8) + rng.uniform(-0.3, 0.3, (count, 8))) * np.pi / 4
    reach = 12.9 * rng.uniform(0.8, 1.2, (count, 8))
    stretch = rng.uniform(1.3, 1.75, (count, 1))
    outline = np.stack([reach * stretch * np.cos(angle), reach / stretch * np.sin(angle)], axis=-1)
    return np.asarray(shapely.polygons(outline + rng.uniform(0, 10_000, (count, 1, 2))))


def blobs(count: int, seed: int = 2) -> NDArray[np.object_]:
    """Return irregular outlines of 96 corners with a hole, about 300 samples a metre apart."""
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2 * np.pi, 96, endpoint=False)
    shapes = []
    for _ in range(count):
        waves = sum(rng.uniform(1, 3.5) * np.sin(k * t + rng.uniform(0, 6)) for k in (2, 3, 5))
        outer = shapely.Polygon((30 + waves)[:, None] * np.column_stack([np.cos(t), np.sin(t)]))
        shapes.append(outer - shapely.Point(rng.uniform(-8, 8, 2)).buffer(rng.uniform(3, 9)))
    return np.array(shapes, dtype=object)


def street_grid(blocks: int) -> NDArray[np.object_]:
    """Return the streets between square blocks of 90 m as one polygon with as many holes."""
    x, y = (5.0 + 100 * axis.ravel() for axis in np.meshgrid(np.arange(blocks), np.arange(blocks)))
    whole = shapely.box(-5, -5, 100 * blocks + 5, 100 * blocks + 5)
    holes = [ring.coords for ring in shapely.get_exterior_ring(shapely.box(x, y, x + 90, y + 90))]
    return np.array([shapely.Polygon(whole.exterior, holes)], dtype=object)


def voronoi_by_scipy(polygons: NDArray[np.object_]) -> float:
    """Return the length of all Voronoi edges that lie inside, unpruned, samples `STEP_M` apart."""
    total = 0.0
    for polygon in polygons:
        shapely.prepare(polygon)
        samples = np.unique(shapely.get_coordinates(shapely.segmentize(polygon, STEP_M)), axis=0)
        voronoi = Voronoi(samples - samples[0])
        vertices = voronoi.vertices + samples[0]
        inside = shapely.contains_xy(polygon, vertices[:, 0], vertices[:, 1])
        ends = np.asarray(voronoi.ridge_vertices)
        ends = ends[(ends >= 0).all(axis=1)]
        ends = ends[inside[ends].all(axis=1)]
        total += float(np.hypot(*(vertices[ends[:, 0]] - vertices[ends[:, 1]]).T).sum())
    return total


def centreline(polygons: NDArray[np.object_], **options: float) -> float:
    import pygeoops

    return float(np.sum(shapely.length(pygeoops.centerline(polygons, **options))))


def timed(work: Callable[[], float], repeats: int = 3) -> tuple[float, float]:
    """Return the result and the fewest CPU seconds that a piece of work took."""
    seconds = []
    for _ in range(repeats):
        start = time.process_time()
        result = work()
        seconds.append(time.process_time() - start)
    return result, min(seconds)


def compare(name: str, polygons: NDArray[np.object_], few: int) -> None:
    """Print polygons a second of each tool, rivals on the first few polygons and against the kernel at their step."""
    some = polygons[:few]
    print(name)
    own = {}
    for label, step_m in (("own kernel, its own step", None), (f"own kernel, {STEP_M:g} m", STEP_M)):
        length, seconds = timed(lambda s=step_m: medial_axes(polygons, step_m=s).lengths_m().sum())  # type: ignore[misc]
        own[step_m] = len(polygons) / seconds
        print(f"  {label:36s}{own[step_m]:10,.0f}/s          mean length {length / len(polygons):6.2f} m")
    rivals: list[tuple[str, float | None, Callable[[], float]]] = [
        ("pygeoops, its own densify", None, lambda: centreline(some)),
        (f"pygeoops, densify {STEP_M:g} m", STEP_M, lambda: centreline(some, densify_distance=STEP_M)),
        (f"scipy Voronoi, {STEP_M:g} m, unpruned", STEP_M, lambda: voronoi_by_scipy(some)),
    ]
    for label, step_m, work in rivals:
        length, seconds = timed(work, 2)
        rate = few / seconds
        print(f"  {label:36s}{rate:10,.0f}/s {own[step_m] / rate:7.1f}x mean length {length / few:6.2f} m")


def main() -> None:
    """Print all measurements."""
    warnings.simplefilter("ignore")  # pygeoops warns of each polygon it finds no line in
    lots, round_ones = city_lots(5000), blobs(300)
    medial_axes(lots[:5])
    centreline(lots[:5])
    samples = shapely.get_num_coordinates(shapely.segmentize(lots, STEP_M)) - 1
    print(f"lots: {np.median(shapely.area(lots)):.0f} m2, {samples.mean():.0f} samples; last figures: times the rival")
    compare("5,000 lots of 8 corners", lots, 300)
    compare("300 outlines with a hole", round_ones, 60)
    for blocks in (10, 40):
        streets = street_grid(blocks)
        axes, seconds = timed(lambda s=streets: medial_axes(s).lengths_m()[0], 1)  # type: ignore[misc]
        edge = shapely.length(streets[0])
        print(f"streets of {blocks * blocks} blocks, {edge / 1000:.0f} km of edge: {seconds:.3f} s, axis {axes:,.0f} m")
    spacing = np.full(len(lots), 4.0)
    axes_of_lots = medial_axes(lots)
    equidistant_positions(axes_of_lots, spacing)
    count, seconds = timed(lambda: len(equidistant_positions(axes_of_lots, spacing)[0]))
    print(f"rows on the axes of 5,000 lots: {count:,.0f} positions, {seconds * 1000:.1f} ms")
    many = city_lots(100_000)
    keys = keys_for(0, "place", (str(i) for i in range(len(many))))
    columns = [np.full(len(many), value) for value in (9.0, 0.0, 0.3)]
    lattice_positions(lots[:5], lots[:5], *(column[:5] for column in columns), keys[:5])
    count, seconds = timed(lambda: len(lattice_positions(many, many, *columns, keys).site), 1)
    print(f"lattices in 100,000 lots: {count:,.0f} positions, {seconds:.2f} s")


if __name__ == "__main__":
    main()
