"""Regions grown from points take the cheapest way."""

import heapq

import numpy as np
import pytest

from urbanforest_cli.imagery.growing import cost_distance_m


def slow_twin(sources, cost, resolution_m, limit_m):
    """Dijkstra's algorithm, cell by cell."""
    found = np.full(cost.shape, limit_m)
    heap = [(0.0, int(row), int(col)) for row, col in np.argwhere(sources)]
    while heap:
        length, row, col = heapq.heappop(heap)
        if length >= found[row, col]:
            continue
        found[row, col] = length
        for down in (-1, 0, 1):
            for right in (-1, 0, 1):
                to = row + down, col + right
                if (down or right) and 0 <= to[0] < cost.shape[0] and 0 <= to[1] < cost.shape[1]:
                    step = np.hypot(down * resolution_m[1], right * resolution_m[0]) * (cost[row, col] + cost[to]) / 2
                    heapq.heappush(heap, (length + step, *to))
    return found


def test_way_over_even_ground_is_its_length_in_metres():
    sources = np.zeros((9, 9), bool)
    sources[4, 4] = True
    found = cost_distance_m(sources, np.ones((9, 9)), (0.5, 2.0), limit_m=100.0)
    assert found[4, 8] == pytest.approx(4 * 0.5)
    assert found[0, 4] == pytest.approx(4 * 2.0)
    assert found[5, 5] == pytest.approx(np.hypot(0.5, 2.0))


@pytest.mark.parametrize("seed", range(4))
def test_ways_agree_with_dijkstra(seed):
    rng = np.random.default_rng(seed)
    cost = 1.0 + 4.0 * rng.random((23, 17))
    sources = rng.random((23, 17)) < 0.02
    expected = slow_twin(sources, cost, (0.6, 0.7), 9.0)
    np.testing.assert_allclose(cost_distance_m(sources, cost, (0.6, 0.7), limit_m=9.0), expected, rtol=1e-4)


def test_without_sources_nothing_is_reached():
    found = cost_distance_m(np.zeros((3, 5), bool), np.ones((3, 5)), (1.0, 1.0), limit_m=7.0)
    assert (found == 7.0).all()
