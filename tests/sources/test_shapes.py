"""Geometries made fit: every repair is counted, nothing is invented."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely.geometry import GeometryCollection, LineString, MultiPolygon, Point, Polygon, box

from urbanforest_cli.core.notices import Notices
from urbanforest_cli.sources.shapes import first_of_equal, points_along, usable


def cleaned(*shapes: object, kinds: tuple[str, ...] = ("polygon",)) -> tuple[np.ndarray, Notices]:
    array = np.empty(len(shapes), dtype=object)
    array[:] = shapes
    notices = Notices()
    names = np.array([str(n) for n in range(len(shapes))], dtype=object)
    return usable(array, kinds, names, "lots", notices), notices


def test_a_bow_tie_becomes_its_two_halves() -> None:
    found, notices = cleaned(Polygon([(0, 0), (10, 10), (10, 0), (0, 10)]))
    assert found[0].area == pytest.approx(50)
    assert notices.count("W_REPAIRED") == 1


def test_a_hole_at_the_edge_stays_a_hole() -> None:
    found, _ = cleaned(Polygon(box(0, 0, 10, 10).exterior, [box(0, 4, 2, 7).exterior]))
    assert found[0].area == pytest.approx(94)


def test_polygons_that_enclose_nothing_are_left_and_counted() -> None:
    found, notices = cleaned(Polygon([(0, 0), (5, 0), (9, 0), (0, 0)]), box(0, 0, 1, 1))
    assert [shape is None for shape in found] == [True, False]
    assert notices.count("W_NO_AREA") == 1


def test_one_coordinate_that_is_no_number_costs_its_row_only() -> None:
    with np.errstate(invalid="ignore"):
        broken = Polygon([(0, 0), (1, 0), (1, float("nan")), (0, 1)])
        infinite = Polygon([(0, 0), (1, 0), (1, float("inf")), (0, 1)])
    found, notices = cleaned(broken, infinite, box(0, 0, 1, 1))
    assert [shape is None for shape in found] == [True, True, False]
    assert notices.count("W_NOT_FINITE") == 2


def test_of_a_collection_the_polygons_are_taken() -> None:
    found, notices = cleaned(
        GeometryCollection([Point(0, 0), box(0, 0, 1, 1), MultiPolygon([box(2, 0, 3, 1)])]),
        GeometryCollection([Point(0, 0)]),
    )
    assert found[0].area == pytest.approx(2)
    assert found[1] is None
    assert notices.count("W_COLLECTION") == 1
    assert notices.count("W_OTHER_KIND") == 1


def test_other_kinds_are_left_and_counted() -> None:
    found, notices = cleaned(Point(0, 0), LineString([(0, 0), (1, 1)]), box(0, 0, 1, 1))
    assert [shape is None for shape in found] == [True, True, False]
    assert notices.count("W_OTHER_KIND") == 2


def test_equal_ground_is_found_whatever_the_start_and_turn_of_its_ring() -> None:
    square = box(0, 0, 4, 4)
    turned = Polygon([(4, 4), (4, 0), (0, 0), (0, 4)])
    smaller = Polygon([(0, 0), (4, 0), (4, 4), (0, 4), (2, 2)])  # the same bounds, other ground
    shapes = np.array([square, smaller, turned, square, None, None], dtype=object)
    assert first_of_equal(shapes).tolist() == [True, True, False, False, True, True]


def test_trees_stand_evenly_from_end_to_end_of_a_row() -> None:
    xy = points_along(LineString([(0, 0), (60, 0), (60, 36)]), 8.0)
    steps = np.hypot(*np.diff(xy, axis=0).T)
    assert len(xy) == 13
    assert np.allclose(xy[[0, -1]], [(0, 0), (60, 36)])
    assert steps.max() <= 8.0 + 1e-9


def test_a_short_row_is_one_tree_and_a_ring_has_no_tree_twice() -> None:
    assert points_along(LineString([(0, 0), (3, 0)]), 8.0).tolist() == [[1.5, 0.0]]
    xy = points_along(shapely.LineString(box(0, 0, 8, 8).exterior), 8.0)
    assert len(xy) == 4 == len(np.unique(xy.round(6), axis=0))
