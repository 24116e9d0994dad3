from __future__ import annotations

import numpy as np
import pytest
import shapely

from urbanforest_cli.evaluation.chamfer import chamfer, rms_in_spacings
from urbanforest_cli.evaluation.patterns import Patterns
from urbanforest_cli.evaluation.references import lattice_points, uniform_points


def test_distance_by_hand_in_both_directions():
    one = Patterns.of([np.array([[0.0, 0], [0, 3]]), np.array([[5.0, 5]])])
    two = Patterns.of([np.array([[0.0, 1], [0, 1]]), np.array([[5.0, 7]])])
    area = np.array([10.0, 2.0])
    assert chamfer(one, two, area).tolist() == [(1 + 4) / 10, 4 / 2]
    assert chamfer(two, one, area).tolist() == [2 / 10, 4 / 2]
    assert (chamfer(one, one, area) == 0).all()
    assert rms_in_spacings(one, two, area)[1] == pytest.approx(np.sqrt(2))


@pytest.mark.parametrize("count", [100, 1000])
def test_random_targets_give_one_over_pi_and_a_square_lattice_one_sixth_whatever_the_count(count):
    rng = np.random.default_rng(0)
    window, repeats = shapely.box(0, 0, 100, 100), 20000 // count
    area = np.full(repeats, 1e4)

    def sets(sampler, n):
        return Patterns.of([sampler(window, n, rng) for _ in range(repeats)])

    probes = sets(uniform_points, count)
    edge_excess = 1 + 4 / np.sqrt(count)
    to_random = chamfer(probes, sets(uniform_points, count), area).mean()
    to_lattice = chamfer(probes, sets(lattice_points, count), area).mean()
    assert 0.97 / np.pi < to_random < edge_excess / np.pi
    assert 0.97 / 6 < to_lattice < edge_excess / 6
