from __future__ import annotations

import numpy as np
import pytest
import shapely

from urbanforest_cli.evaluation.patterns import Patterns
from urbanforest_cli.evaluation.point_patterns import (
    RADII_M,
    l_envelope,
    lot_l,
    neighbour_quantiles,
    pair_share,
    pooled_l,
)
from urbanforest_cli.evaluation.references import even_points, uniform_points


def test_on_a_lattice_every_neighbour_is_one_spacing_away():
    grid = np.stack(np.meshgrid(np.arange(10), np.arange(10)), axis=-1).reshape(-1, 2) * 4.0
    found = neighbour_quantiles(Patterns.of([grid, grid * 3]), np.array([1600.0, 14400.0]))
    np.testing.assert_allclose(found, 1.0)


def test_l_of_a_lot_counts_pairs_by_hand():
    square = Patterns.of([np.array([[0.0, 0], [3, 0], [0, 3], [3, 3]])])
    found = lot_l(square, np.array([100.0]))[0]
    assert found[1] == 0
    assert found[2] == pytest.approx(np.sqrt(100 * 4 / 6 / np.pi))
    assert found[4] == pytest.approx(np.sqrt(100 / np.pi))


@pytest.mark.parametrize("window", [shapely.box(0, 0, 30, 40), shapely.box(0, 0, 200, 4)])
def test_pooled_l_of_points_at_random_is_r_whatever_the_lots_shape(window):
    rng = np.random.default_rng(0)
    tests = Patterns.of([uniform_points(window, 200, rng) for _ in range(40)])
    points = Patterns.of([uniform_points(window, 60, rng) for _ in range(40)])
    found = pooled_l(points.pair_counts(RADII_M), points.counts, pair_share(tests))
    np.testing.assert_allclose(found[2:], RADII_M[2:], rtol=0.05)


def test_envelope_holds_two_sets_of_one_process_and_not_random_against_even():
    rng = np.random.default_rng(3)
    window = shapely.box(0, 0, 40, 40)

    def draw(sampler):
        return Patterns.of([sampler(window, 30, rng) for _ in range(30)])

    share = pair_share(draw(uniform_points))

    def leaves_band(one, two):
        counts, pairs = one.counts, (one.pair_counts(RADII_M), two.pair_counts(RADII_M))
        low, high = l_envelope(*pairs, counts, share, np.random.default_rng(0))
        curve = pooled_l(pairs[0], counts, share)
        return bool(((curve < low - 1e-9) | (curve > high + 1e-9)).any())

    assert not leaves_band(draw(even_points), draw(even_points))
    assert leaves_band(draw(even_points), draw(uniform_points))
