from __future__ import annotations

import numpy as np
import pytest
import shapely
from scipy.spatial.distance import pdist
from scipy.stats import kstest

from urbanforest_cli.evaluation.references import even_points, lattice_points, uniform_points

WINDOWS = {
    "square": shapely.box(4e5, 5e6, 4e5 + 50, 5e6 + 50),
    "with a hole": shapely.box(0, 0, 50, 50) - shapely.box(5, 5, 40, 40),
    "two parts": shapely.union(shapely.box(0, 0, 10, 10), shapely.box(100, 0, 130, 30)),
    "oblique strip": shapely.buffer(shapely.linestrings([[0, 0], [300, 310]]), 2, cap_style="flat"),
}


@pytest.mark.parametrize("sampler", [uniform_points, even_points, lattice_points])
@pytest.mark.parametrize("window", WINDOWS.values(), ids=WINDOWS.keys())
@pytest.mark.parametrize("count", [1, 7, 120])
def test_a_reference_has_the_count_asked_for_and_lies_in_the_window(sampler, window, count):
    points = sampler(window, count, np.random.default_rng(0))
    assert points.shape == (count, 2)
    assert shapely.intersects_xy(window, points[:, 0], points[:, 1]).all()


def test_uniform_points_fall_in_parts_by_area():
    points = uniform_points(WINDOWS["two parts"], 4000, np.random.default_rng(0))
    assert abs((points[:, 0] < 50).mean() - 0.1) < 0.02
    right = points[points[:, 0] > 50]
    assert kstest((right[:, 0] - 100) / 30, "uniform").pvalue > 0.01


def test_even_points_keep_apart_nearly_as_far_as_random_packing_allows():
    window = WINDOWS["square"]
    points = even_points(window, 100, np.random.default_rng(0))
    assert pdist(points).min() > 0.68 * np.sqrt(shapely.area(window) / 100)


def test_lattice_points_are_one_cell_apart():
    window = WINDOWS["square"]
    points = lattice_points(window, 100, np.random.default_rng(0))
    apart = pdist(points)
    assert apart.min() == pytest.approx(np.sort(apart)[50], rel=1e-6)
