import numpy as np
import pandas as pd
import pytest
import shapely
from shapely.geometry import box

from urbanforest_cli.core.errors import InputError
from urbanforest_cli.register.sketches import density_for_cover, lot_under, numbers_of, stack_sketches


def shapes(*items):
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array


def test_coverage_becomes_the_density_whose_crowns_cover_that_share():
    assert density_for_cover(np.array([0.0, 0.265, 0.53, 0.9])) == pytest.approx([0, 0.5, 1, 1])


def test_the_sketch_drawn_last_lies_on_top():
    left = stack_sketches(shapes(box(0, 0, 10, 10), box(5, 0, 15, 10), None), np.array(["10", "9", "1"], dtype=object))
    assert left[0].area == pytest.approx(100)
    assert left[1].area == pytest.approx(50)
    assert left[2] is None


def test_a_sketch_under_another_is_gone():
    left = stack_sketches(shapes(box(2, 2, 5, 5), box(0, 0, 9, 9)), np.array(["1", "2"], dtype=object))
    assert left[0] is None


def test_the_lot_under_a_sketch_is_the_one_at_its_inner_point():
    lots = shapes(box(0, 0, 10, 10), None, box(10, 0, 20, 10))
    assert lot_under(shapes(box(1, 1, 4, 4), box(12, 1, 30, 4), box(50, 50, 60, 60)), lots).tolist() == [0, -1, -1]
    assert lot_under(shapes(box(9, 1, 15, 4)), lots).tolist() == [2]


@pytest.mark.parametrize("value", [1.5, -0.1, "half", True, float("inf")])
def test_a_coverage_outside_0_to_1_is_refused(value):
    column = pd.Series([value], dtype=object)
    with pytest.raises(InputError, match="coverage"):
        numbers_of(column, np.array(["sketch:1"], dtype=object), "city.gpkg")


def test_shapes_keep_their_area_when_nothing_overlaps():
    given = shapes(box(0, 0, 10, 10), box(20, 0, 30, 10))
    assert shapely.area(stack_sketches(given, np.array(["1", "2"], dtype=object))).tolist() == [100, 100]
