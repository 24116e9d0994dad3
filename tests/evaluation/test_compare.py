from __future__ import annotations

import json
from dataclasses import replace

import numpy as np
import pytest
import shapely

from urbanforest_cli.evaluation.compare import compare_plants, open_ground
from urbanforest_cli.evaluation.references import uniform_points
from urbanforest_cli.evaluation.results import PlantsOfLots

LOTS = 28
RADIUS_M = 3.13
SHARE_KEPT = 0.6


def lots_of_many_shapes(count: int = LOTS) -> tuple[np.ndarray, np.ndarray]:
    widths = np.linspace(25, 80, count)
    polygons = np.array([shapely.box(100 * i, 0, 100 * i + w, 2000 / w) for i, w in enumerate(widths)], dtype=object)
    return np.array([f"lot {i}" for i in range(count)], dtype=object), polygons


def saturated(window, radius_m: float, rng) -> np.ndarray:
    """Darts that keep 2 r apart, until hundreds of tries in a row miss, then thinned."""
    kept = np.zeros((0, 2))
    for dart in uniform_points(window, 1500, rng):
        if len(kept) == 0 or ((kept - dart) ** 2).sum(axis=1).min() >= 4 * radius_m**2:
            kept = np.vstack([kept, dart])
    return kept[rng.random(len(kept)) < SHARE_KEPT]


def plants(polygons, draw) -> PlantsOfLots:
    sets = [draw(polygon) for polygon in polygons]
    return PlantsOfLots(np.concatenate(sets), np.repeat(np.arange(len(sets)), [len(s) for s in sets]))


def compared(model_radius_m: float | None, *, seed: int = 0, **options):
    """Compare saturated sets of RADIUS_M with sets of another radius, or with points at random."""
    ids, polygons = lots_of_many_shapes()
    rng = np.random.default_rng(seed)
    real = plants(polygons, lambda window: saturated(window, RADIUS_M, rng))
    if model_radius_m is None:
        model = plants(polygons, lambda window: uniform_points(window, 34, rng))
    else:
        model = plants(polygons, lambda window: saturated(window, model_radius_m, rng))
    return compare_plants(ids, polygons, model=model, real=real, seed=seed, **options)


def test_points_at_random_are_told_from_saturated_ones_by_every_measure_of_spacing():
    found = compared(None)
    assert found.neighbour.p == pytest.approx(0.001)
    assert found.l_function.p == pytest.approx(0.001)
    assert found.classifier.accuracy > 0.9
    assert found.score.score < 0.25


def test_a_radius_ten_percent_larger_is_caught_where_chamfer_is_blind():
    found = compared(1.1 * RADIUS_M, seed=1)
    assert found.neighbour.p <= 0.01
    assert found.l_function.p <= 0.01
    chamfers = {row.name: row.mean for row in found.chamfer}
    assert abs(chamfers["model"] / compared(RADIUS_M, seed=1).chamfer[0].mean - 1) < 0.1
    assert chamfers["lattice"] < chamfers["random"]


def test_the_true_model_scores_near_one():
    found = compared(RADIUS_M, seed=2)
    assert found.score.score > 0.9
    assert found.classifier.p > 0.01


@pytest.mark.slow
def test_the_true_model_is_rejected_about_five_times_in_a_hundred():
    found = [compared(RADIUS_M, seed=seed) for seed in range(100, 220)]
    for measure in ("neighbour", "l_function", "edge", "classifier"):
        rejected = np.mean([getattr(one, measure).p <= 0.05 for one in found])
        assert rejected <= 0.05 + 3 * np.sqrt(0.05 * 0.95 / len(found)), measure
    assert abs(np.mean([one.classifier.accuracy for one in found]) - 0.5) < 0.04


def test_neither_order_of_plants_nor_of_lots_changes_the_result():
    ids, polygons = lots_of_many_shapes(12)
    rng = np.random.default_rng(0)
    real, model = (plants(polygons, lambda window: saturated(window, RADIUS_M, rng)) for _ in range(2))
    order = rng.permutation(12)
    back = np.argsort(order)
    one = compare_plants(ids, polygons, model=model, real=real)
    two = compare_plants(
        ids[order], polygons[order],
        model=replace(model, lot=back[model.lot]), real=replace(real, lot=back[real.lot]),
    )  # fmt: skip
    assert one.as_record() == two.as_record()
    three = compare_plants(ids, polygons, model=model, real=real, seed=1)
    assert three.as_record() != one.as_record()


def test_a_replicate_takes_the_place_of_halves():
    ids, polygons = lots_of_many_shapes(8)
    rng = np.random.default_rng(0)
    real, model, again = (plants(polygons, lambda window: saturated(window, RADIUS_M, rng)) for _ in range(3))
    halves = compare_plants(ids, polygons, model=model, real=real)
    twins = compare_plants(ids, polygons, model=model, real=real, replicate=again)
    assert [row.name for row in halves.chamfer] == ["model", "half of the model", "random", "even", "lattice"]
    assert twins.chamfer[1].name == "model, another seed"
    assert twins.chamfer[1].mean == pytest.approx(twins.chamfer[0].mean, rel=0.25)
    itself = compare_plants(ids, polygons, model=model, real=real, replicate=model)
    assert itself.chamfer[1].plants > itself.plants_compared


def test_more_lots_than_wanted_are_sampled_and_few_lots_give_counts_alone():
    assert compared(RADIUS_M, max_lots=10).lots_compared == 10
    few = compared(RADIUS_M, min_plants=1000)
    assert (few.lots_compared, few.classifier, few.curves) == (0, None, None)
    assert few.counts.real > 0
    json.dumps(few.as_record(), allow_nan=False)


def test_buildings_are_no_ground_to_stand_on():
    lots = np.array([shapely.box(0, 0, 10, 10), shapely.box(20, 0, 30, 10), shapely.box(40, 0, 50, 10)], dtype=object)
    buildings = np.array([shapely.box(5, 0, 25, 10), shapely.box(39, -1, 51, 11)], dtype=object)
    assert shapely.area(open_ground(lots, buildings)).tolist() == [50, 50, 100]
    assert open_ground(lots, None) is lots
