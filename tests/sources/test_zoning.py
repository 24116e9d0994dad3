"""Which zone covers most of a lot."""

from __future__ import annotations

import numpy as np
from shapely.geometry import box

from urbanforest_cli.sources.zoning import covering, majority


def array(*shapes: object) -> np.ndarray:
    result = np.empty(len(shapes), dtype=object)
    result[:] = shapes
    return result


def test_the_area_that_covers_most_wins() -> None:
    lots = array(box(0, 0, 10, 10), box(10, 0, 20, 10))
    areas = array(box(-5, -5, 3, 15), box(3, -5, 12, 15), box(12, -5, 30, 15))
    assert covering(lots, areas).tolist() == [1, 2]


def test_a_lot_mostly_in_no_area_has_none() -> None:
    assert covering(array(box(0, 0, 10, 10)), array(box(0, 0, 10, 3))).tolist() == [-1]
    assert covering(array(box(0, 0, 10, 10)), array(box(0, 0, 10, 4), box(0, 6, 10, 10))).tolist() == [0]


def test_nothing_covers_without_areas() -> None:
    assert covering(array(box(0, 0, 1, 1)), array()).tolist() == [-1]
    assert covering(array(box(0, 0, 1, 1)), array(box(5, 5, 6, 6))).tolist() == [-1]


def test_a_park_inside_a_quarter_counts_before_the_quarter() -> None:
    quarter, park = box(0, 0, 100, 100), box(20, 20, 40, 40)
    lots = array(box(25, 25, 35, 35), box(60, 60, 70, 70))
    assert covering(lots, array(quarter, park)).tolist() == [1, 0]
    assert covering(lots, array(park, quarter)).tolist() == [0, 1]


def test_a_lot_takes_the_use_of_most_of_its_building_ground() -> None:
    lots = array(box(0, 0, 20, 20), box(20, 0, 40, 20), box(40, 0, 60, 20))
    houses = array(box(1, 1, 3, 3), box(4, 4, 6, 6), box(8, 8, 15, 15), box(22, 2, 24, 4))
    codes = np.array(["residential", "residential", "commercial", None], dtype=object)
    assert majority(lots, houses, codes).tolist() == ["commercial", None, None]
