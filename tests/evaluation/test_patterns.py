from __future__ import annotations

import numpy as np
from scipy.spatial.distance import cdist, pdist

from urbanforest_cli.evaluation.patterns import Patterns


def some_patterns(seed: int = 0) -> tuple[Patterns, list]:
    rng = np.random.default_rng(seed)
    sets = [rng.uniform(0, 30, (n, 2)) for n in (5, 12, 7, 40)]
    return Patterns.of(sets), sets


def test_neighbours_are_of_the_same_lot_though_lots_lie_on_one_another():
    patterns, sets = some_patterns()
    expected = np.concatenate([np.sort(cdist(s, s), axis=1)[:, 1:4] for s in sets])
    np.testing.assert_allclose(patterns.neighbour_distances(3), expected)
    np.testing.assert_allclose(np.linalg.norm(patterns.neighbour_vectors(2), axis=1), expected[:, 1])


def test_nearest_to_agrees_with_all_pairs():
    patterns, sets = some_patterns()
    others, other_sets = some_patterns(9)
    expected = np.concatenate([cdist(b, a).min(axis=1) for a, b in zip(sets, other_sets, strict=True)])
    np.testing.assert_allclose(patterns.nearest_to(others), expected)


def test_pair_counts_agree_with_all_pairs_and_include_the_radius_itself():
    patterns, sets = some_patterns()
    radii = np.array([1.0, 5.0, 50.0])
    expected = [[(pdist(s) <= r).sum() for r in radii] for s in sets]
    assert patterns.pair_counts(radii).tolist() == expected
    on_grid = Patterns.of([np.array([[0.0, 0], [5, 0], [0, 5]])])
    assert on_grid.pair_counts(radii).tolist() == [[0, 2, 3]]


def test_many_lots_are_counted_in_parts_that_fit_together():
    sets = [np.array([[0.0, 0], [0, 1]])] * 600
    assert (Patterns.of(sets).pair_counts(np.array([1.0])) == 1).all()


def test_quantiles_agree_with_numpy_lot_by_lot_and_are_nan_without_points():
    rng = np.random.default_rng(1)
    sizes = [3, 0, 8, 1, 0]
    patterns = Patterns.of([np.zeros((n, 2)) for n in sizes])
    values = rng.random(sum(sizes))
    shares = np.array([0.0, 0.3, 0.5, 1.0])
    found = patterns.quantiles(values, shares)
    for row, part in zip(found, np.split(values, patterns.starts[1:-1]), strict=True):
        if len(part):
            np.testing.assert_allclose(row, np.quantile(part, shares))
        else:
            assert np.isnan(row).all()
