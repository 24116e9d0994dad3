from __future__ import annotations

import numpy as np
import shapely

from urbanforest_cli.evaluation.edges import FARTHEST_BUILDING_M, building_distances, edge_distances


def test_distances_to_the_lots_own_outline_and_its_holes():
    lots = np.array([shapely.box(0, 0, 20, 20) - shapely.box(8, 8, 12, 12), shapely.box(100, 0, 110, 10)], dtype=object)
    xy = np.array([[1.0, 10], [7.5, 10], [105, 4]])
    assert edge_distances(xy, np.array([0, 0, 1]), lots).tolist() == [1.0, 0.5, 4.0]


def test_distances_to_buildings_end_at_the_farthest_and_are_zero_inside():
    house = np.array([shapely.box(0, 0, 10, 10)], dtype=object)
    xy = np.array([[13.0, 5], [5, 5], [500, 5]])
    assert building_distances(xy, house).tolist() == [3.0, 0.0, FARTHEST_BUILDING_M]
    assert building_distances(xy, house[:0]).tolist() == [FARTHEST_BUILDING_M] * 3
