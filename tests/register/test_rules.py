import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Point, Polygon, box

from urbanforest_cli.core.config import Rules
from urbanforest_cli.register.rules import (
    entrance_areas,
    locate_entrances,
    obstacle_distances,
    road_corners,
    sight_triangles,
)


def shapes(*items):
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array


def triangles(*lines, width=6.0, leg=9.0):
    return sight_triangles(road_corners(shapes(*lines), np.full(len(lines), width)), leg)


def test_a_crossing_of_two_roads_has_four_triangles_at_the_crossings_of_their_curbs():
    found = triangles(LineString([(-50, 0), (50, 0)]), LineString([(0, -50), (0, 50)]))
    truth = [Polygon([(3 * x, 3 * y), (12 * x, 3 * y), (3 * x, 12 * y)]) for x in (1, -1) for y in (1, -1)]
    assert len(found) == 4
    assert shapely.union_all(found).symmetric_difference(shapely.union_all(truth)).area < 1e-9


def test_a_junction_of_three_roads_has_two_triangles():
    found = triangles(LineString([(-50, 0), (50, 0)]), LineString([(0, 0), (0, 50)]))
    assert sorted(shapely.area(found)) == pytest.approx([40.5, 40.5])
    assert all(shape.bounds[1] == pytest.approx(3.0) for shape in found)


def test_roads_that_end_at_one_place_meet_as_crossing_roads_do():
    ends = [(-50, 0), (50, 0), (0, -50), (0, 50)]
    found = triangles(*(LineString([(0, 0), end]) for end in ends))
    crossing = triangles(LineString(ends[:2]), LineString(ends[2:]))
    assert shapely.union_all(found).equals_exact(shapely.union_all(crossing), 1e-9)


@pytest.mark.parametrize("degrees", [30, 60, 120, 150])
def test_legs_are_measured_from_where_the_curbs_cross_at_any_angle(degrees):
    angle = np.deg2rad(degrees)
    side = (50 * np.cos(angle), 50 * np.sin(angle))
    corners = road_corners(shapes(LineString([(-50, 0), (50, 0)]), LineString([(0, 0), side])), np.array([6.0, 4.0]))
    for point, one, other in zip(corners.points, corners.one, corners.other, strict=True):
        assert Point(point).distance(LineString([(-500, 0), (500, 0)])) == pytest.approx(3.0)
        assert Point(point).distance(LineString([(0, 0), (10 * side[0], 10 * side[1])])) == pytest.approx(2.0)
        assert np.linalg.norm(one) == pytest.approx(1)
        triangle = sight_triangles(type(corners)(point[None], one[None], other[None]), 9.0)[0]
        assert triangle.area == pytest.approx(9 * 9 * np.sin(angle) / 2)


def test_a_road_cut_into_pieces_has_no_intersection_where_the_pieces_meet():
    assert len(triangles(LineString([(-50, 0), (0, 0)]), LineString([(0, 0), (50, 10)]))) == 0


def test_a_bend_of_one_road_is_no_intersection():
    assert len(triangles(LineString([(-50, 0), (0, 0), (0, 50)]))) == 0


def test_a_ring_road_meets_its_access_road():
    angle = np.linspace(0, 2 * np.pi, 73)
    ring = LineString(np.column_stack((100 * np.cos(angle), 100 * np.sin(angle))))
    assert len(triangles(ring, LineString([(100, 0), (160, 0)]))) == 2


def test_no_roads_have_no_corners():
    assert len(triangles()) == 0


def test_an_entrance_belongs_to_the_nearest_wall_and_opens_away_from_the_house():
    houses = shapes(box(0, 0, 10, 10), box(20, 0, 30, 10))
    places = shapes(Point(10.2, 5), Point(25, 10), LineString([(2, 0), (5, 0)]))
    found, on_wall = locate_entrances(places, np.array([False, True, False]), houses)
    assert on_wall.all()
    assert found.outward == pytest.approx(np.array([(1, 0), (0, 1), (0, -1)]))
    areas = entrance_areas(found, Rules())
    truth = [box(10, 3.5, 19, 6.5), box(24, 10, 26, 17.5), box(2, -9, 5, 0)]
    for area, expected in zip(areas, truth, strict=True):
        assert area.symmetric_difference(expected).area < 1e-9


def test_an_entrance_to_a_courtyard_opens_into_it():
    block = box(0, 0, 30, 30).difference(box(10, 10, 20, 20))
    found, _ = locate_entrances(shapes(Point(10, 15)), np.array([False]), shapes(block))
    assert found.outward[0] == pytest.approx([1, 0])


def test_an_entrance_without_a_house_is_left_out():
    found, on_wall = locate_entrances(shapes(Point(50, 50), Point(0, 5)), np.zeros(2, bool), shapes(box(0, 0, 10, 10)))
    assert on_wall.tolist() == [False, True]
    assert len(found.windows) == 1


def test_an_obstacle_of_an_unknown_kind_has_the_default_distance():
    kinds = np.array(["hydrant", "unheard of", ""], dtype=object)
    assert obstacle_distances(kinds, np.full(3, np.nan), Rules()).tolist() == [3.0, 1.5, 1.5]
    assert obstacle_distances(kinds, np.array([0.0, np.nan, 7.0]), Rules()).tolist() == [0.0, 1.5, 7.0]
