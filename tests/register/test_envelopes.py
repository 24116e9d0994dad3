import numpy as np
import pytest
import shapely
from shapely.geometry import Polygon, box

from urbanforest_cli.register.envelopes import ARC_EXCESS_M, difference, drop_small, outer_buffer, subtract


def shapes(*items):
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array


def edge_points(area, step=0.05):
    return shapely.points(shapely.get_coordinates(shapely.segmentize(shapely.boundary(area), step)))


@pytest.mark.parametrize("corners", [3, 5, 17, 64, 65, 90, 128, 400])
def test_an_envelope_holds_the_true_one_whatever_the_angles_of_its_corners(corners):
    angle = np.linspace(0, 2 * np.pi, corners, endpoint=False)
    tower = Polygon(np.column_stack((20 * np.cos(angle), 20 * np.sin(angle))) + np.array([5e5, 5.3e6]))
    envelope = outer_buffer(shapes(tower), 6.0)[0]
    gaps = shapely.distance(edge_points(envelope), tower)
    assert gaps.min() > 6.0 - 1e-8
    assert gaps.max() < 6.0 + 2.5 * ARC_EXCESS_M


def test_slivers_are_dropped_and_narrow_ground_is_kept():
    areas, dropped = drop_small(shapes(box(0, 0, 100, 0.03), box(0, 0, 100, 0.06)), 1.0)
    assert areas[0] is None
    assert areas[1] is not None
    assert dropped.tolist() == [1, 0]


def test_areas_are_taken_off_one_after_the_other():
    left = subtract(
        shapes(box(0, 0, 10, 10), box(20, 0, 30, 10)),
        np.array([0, 1, 0]),
        shapes(box(0, 0, 5, 10), box(0, 0, 1, 1), box(4, 0, 6, 10)),
    )
    assert shapely.area(left).tolist() == [40, 100]


def test_a_broken_cutter_spoils_no_other_pair():
    bow_tie = Polygon([(0, 0), (10, 10), (10, 0), (0, 10)])
    left = difference(shapes(box(0, 0, 10, 10), box(0, 0, 10, 10)), shapes(bow_tie, box(0, 0, 10, 5)))
    assert left[1].area == pytest.approx(50)
