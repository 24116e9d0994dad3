"""The whole comparison of a model's plants with real ones, from positions and polygons to numbers."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import shapely
from numpy.typing import NDArray

from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.evaluation.chamfer import chamfer
from urbanforest_cli.evaluation.counts import count_scores
from urbanforest_cli.evaluation.edges import EDGE_SHARES, building_distances, edge_distances
from urbanforest_cli.evaluation.features import pattern_features
from urbanforest_cli.evaluation.patterns import Patterns
from urbanforest_cli.evaluation.point_patterns import (
    RADII_M,
    l_envelope,
    lot_l,
    neighbour_quantiles,
    pair_share,
    pooled_l,
)
from urbanforest_cli.evaluation.references import even_points, lattice_points, uniform_points
from urbanforest_cli.evaluation.results import (
    EVEN,
    LATTICE,
    MODEL,
    RANDOM,
    REAL,
    ChamferRow,
    Curves,
    Evaluation,
    PlantsOfLots,
)
from urbanforest_cli.evaluation.scores import score_against
from urbanforest_cli.evaluation.two_sample import FlipTest, classifier_test, flip_test

Floats = NDArray[np.float64]
Ints = NDArray[np.int64]

TEST_PAIRS = 1e7
TEST_POINTS_MIN, TEST_POINTS_MAX = 64, 1000
LOTS_FOR_TESTS_MIN = 2
LARGEST_LOT_PLANTS = 20_000


def compare_plants(
    lot_ids: NDArray[np.object_],
    lots: NDArray[np.object_],
    *,
    model: PlantsOfLots,
    real: PlantsOfLots,
    buildings: NDArray[np.object_] | None = None,
    replicate: PlantsOfLots | None = None,
    seed: int = 0,
    min_plants: int = 5,
    max_lots: int = 2000,
    progress: Progress = silent,
) -> Evaluation:
    """Compare a model's plants with real ones, lot by lot.

    Counts are compared over all lots. Patterns are compared in lots where both have `min_plants`; there the larger set
    is thinned at random to the count of the smaller, so that arrangement alone is judged. Lots with more than
    `LARGEST_LOT_PLANTS` of both are left out of that and counted.

    Parameters
    ----------
    lot_ids, lots
        (lots,) names, which key the random streams, and polygons in metres.
    model, real, replicate
        Plants; the replicate is the model's under another seed.
    buildings
        Polygons in metres; open ground is the lot without them.
    seed
        Root of the streams.
    min_plants
        At least 4.
    max_lots
        A seeded sample of this many lots is compared where more could be.
    progress
        Told what is being done.
    """
    real_sets, model_sets = real.by_lot(len(lots)), model.by_lot(len(lots))
    real_counts = np.array([len(points) for points in real_sets], dtype=np.int64)
    model_counts = np.array([len(points) for points in model_sets], dtype=np.int64)
    counts = count_scores(real_counts, model_counts, shapely.area(lots))
    smaller = np.minimum(real_counts, model_counts)
    enough = (smaller >= min_plants) & (shapely.area(lots) > 0)
    eligible = np.flatnonzero(enough & (smaller <= LARGEST_LOT_PLANTS))
    too_large = int(enough.sum()) - len(eligible)
    chosen = _sample(eligible, max_lots, lot_ids, seed)
    if len(chosen) < LOTS_FOR_TESTS_MIN:
        return Evaluation(counts, len(chosen), len(eligible), too_large, int(smaller[chosen].sum()))

    ids, polygons, sizes = lot_ids[chosen], lots[chosen], smaller[chosen]
    windows = open_ground(polygons, buildings)
    area = shapely.area(windows)
    sets = _matched_sets(ids, windows, sizes, [real_sets[i] for i in chosen], [model_sets[i] for i in chosen], seed)
    progress("comparing plants", 1, 4)

    measured = _measure(ids, polygons, windows, area, sets, buildings, seed)
    progress("comparing plants", 2, 4)
    weights = np.sqrt(sizes)

    def test(differences: Floats, name: str) -> FlipTest:
        return flip_test(differences, weights, rng_for(seed, "evaluate", name))

    features = measured.features
    classifier, guesses = classifier_test(features[MODEL] - features[REAL], rng_for(seed, "evaluate", "classifier"))
    progress("comparing plants", 3, 4)
    others = {name: rows for name, rows in features.items() if name != REAL}
    result = Evaluation(
        counts=counts,
        lots_compared=len(chosen),
        lots_eligible=len(eligible),
        lots_too_large=too_large,
        plants_compared=int(sizes.sum()),
        kept_of_real=float(sizes.sum() / real_counts[chosen].sum()),
        kept_of_model=float(sizes.sum() / model_counts[chosen].sum()),
        chamfer=_chamfer_rows(ids, area, sets, model_sets, replicate, chosen, seed, len(lots)),
        neighbour=test(measured.neighbour[MODEL] - measured.neighbour[REAL], "neighbour"),
        l_function=test(measured.lot_l[MODEL] - measured.lot_l[REAL], "l"),
        edge=test(_edge_quantiles(sets, measured.edge_m), "edge"),
        building=test(_edge_quantiles(sets, measured.building_m), "building") if measured.building_m else None,
        classifier=classifier,
        score=score_against(features[REAL], others, rng_for(seed, "evaluate", "score")),
        curves=Curves(
            real_counts=real_counts,
            model_counts=model_counts,
            neighbour={name: values.mean(axis=0) for name, values in measured.neighbour.items()},
            pooled_l=measured.pooled_l,
            envelope=measured.envelope,
            edge_m=measured.edge_m,
            building_m=measured.building_m,
            guesses=guesses,
        ),
    )
    progress("comparing plants", 4, 4)
    return result


def open_ground(lots: NDArray[np.object_], buildings: NDArray[np.object_] | None) -> NDArray[np.object_]:
    """Return lots without the buildings in them; the lot itself where they cover all of it."""
    if buildings is None or len(buildings) == 0:
        return lots
    tree = shapely.STRtree(buildings)
    of_lot, of_building = tree.query(lots, predicate="intersects")
    ground = lots.copy()
    for lot in np.unique(of_lot):
        cover = shapely.union_all(buildings[of_building[of_lot == lot]])
        ground[lot] = shapely.difference(lots[lot], cover)
    return np.where(shapely.area(ground) > 0, ground, lots)


def _sample(eligible: Ints, max_lots: int, lot_ids: NDArray[np.object_], seed: int) -> Ints:
    """Return the eligible lots in the order of their ids, at most `max_lots` of them drawn by chance."""
    by_id = eligible[np.argsort(lot_ids[eligible].astype(str), kind="stable")]
    if len(by_id) <= max_lots:
        return by_id
    return by_id[np.sort(rng_for(seed, "evaluate", "lots").permutation(len(by_id))[:max_lots])]


def _thinned(points: Floats, count: int, rng: np.random.Generator) -> Floats:
    return points[np.sort(rng.permutation(len(points))[:count])]


def _matched_sets(
    ids: NDArray[np.object_],
    windows: NDArray[np.object_],
    sizes: Ints,
    real: list[Floats],
    model: list[Floats],
    seed: int,
) -> dict[str, Patterns]:
    """Return the real and the model's plants and three references, all with the same count in each lot."""

    def every(name: str, draw: Callable[[int, np.random.Generator], Floats]) -> Patterns:
        return Patterns.of([draw(i, rng_for(seed, f"evaluate {name}", str(lot))) for i, lot in enumerate(ids)])

    return {
        REAL: every(REAL, lambda i, rng: _thinned(real[i], sizes[i], rng)),
        MODEL: every(MODEL, lambda i, rng: _thinned(model[i], sizes[i], rng)),
        RANDOM: every(RANDOM, lambda i, rng: uniform_points(windows[i], sizes[i], rng)),
        EVEN: every(EVEN, lambda i, rng: even_points(windows[i], sizes[i], rng)),
        LATTICE: every(LATTICE, lambda i, rng: lattice_points(windows[i], sizes[i], rng)),
    }


@dataclass(frozen=True)
class _Measured:
    neighbour: dict[str, Floats]
    lot_l: dict[str, Floats]
    pooled_l: dict[str, Floats]
    envelope: tuple[Floats, Floats]
    edge_m: dict[str, Floats]
    building_m: dict[str, Floats]
    features: dict[str, Floats]


def _measure(
    ids: NDArray[np.object_],
    lots: NDArray[np.object_],
    windows: NDArray[np.object_],
    area: Floats,
    sets: dict[str, Patterns],
    buildings: NDArray[np.object_] | None,
    seed: int,
) -> _Measured:
    count = int(np.clip(np.sqrt(TEST_PAIRS / len(ids)), TEST_POINTS_MIN, TEST_POINTS_MAX))
    gaps = [rng_for(seed, "evaluate gaps", str(lot)) for lot in ids]
    tests = Patterns.of([uniform_points(window, count, rng) for window, rng in zip(windows, gaps, strict=True)])
    share = pair_share(tests)
    sizes = sets[REAL].counts
    pairs = {name: points.pair_counts(RADII_M) for name, points in sets.items()}
    edge = {name: edge_distances(points.xy, points.lot, lots) for name, points in sets.items()}
    building = {}
    if buildings is not None and len(buildings):
        building = {name: building_distances(points.xy, buildings) for name, points in sets.items()}
    return _Measured(
        neighbour={name: neighbour_quantiles(points, area) for name, points in sets.items()},
        lot_l={name: lot_l(points, area) for name, points in sets.items() if name in (REAL, MODEL)},
        pooled_l={name: pooled_l(found, sizes, share) for name, found in pairs.items()},
        envelope=l_envelope(pairs[MODEL], pairs[REAL], sizes, share, rng_for(seed, "evaluate", "envelope")),
        edge_m=edge,
        building_m=building,
        features={
            name: pattern_features(points, windows, area, tests, edge[name], building.get(name))
            for name, points in sets.items()
        },
    )


def _edge_quantiles(sets: dict[str, Patterns], distance_m: dict[str, Floats]) -> Floats:
    model, real = (sets[name].quantiles(distance_m[name], EDGE_SHARES) for name in (MODEL, REAL))
    return model - real


def _chamfer_rows(
    ids: NDArray[np.object_],
    area: Floats,
    sets: dict[str, Patterns],
    model_sets: list[Floats],
    replicate: PlantsOfLots | None,
    chosen: Ints,
    seed: int,
    lots: int,
) -> list[ChamferRow]:
    rows = [
        ChamferRow(
            name=name,
            against=REAL,
            there=float(chamfer(sets[name], sets[REAL], area).mean()),
            back=float(chamfer(sets[REAL], sets[name], area).mean()),
            plants=len(sets[name].xy),
        )
        for name in (MODEL, RANDOM, EVEN, LATTICE)
    ]
    if replicate is None:
        name, against = "half of the model", "its other half"
        twins = [
            _halves(model_sets[i], rng_for(seed, "evaluate halves", str(lot)))
            for i, lot in zip(chosen, ids, strict=True)
        ]
    else:
        name, against = "model, another seed", MODEL
        again = replicate.by_lot(lots)
        twins = [
            _equal(again[i], model_sets[i], rng_for(seed, "evaluate replicate", str(lot)))
            for i, lot in zip(chosen, ids, strict=True)
        ]
    full = np.array([len(one) > 0 for one, _ in twins])
    one, two = (Patterns.of([pair[side] for pair, some in zip(twins, full, strict=True) if some]) for side in (0, 1))
    if full.any():
        there, back = chamfer(one, two, area[full]).mean(), chamfer(two, one, area[full]).mean()
        rows.insert(1, ChamferRow(name, against, float(there), float(back), len(one.xy)))
    return rows


def _halves(points: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    order = rng.permutation(len(points))
    half = len(points) // 2
    return points[order[:half]], points[order[half : 2 * half]]


def _equal(one: Floats, two: Floats, rng: np.random.Generator) -> tuple[Floats, Floats]:
    count = min(len(one), len(two))
    return _thinned(one, count, rng), _thinned(two, count, rng)
