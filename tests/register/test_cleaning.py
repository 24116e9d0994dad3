import time

import numpy as np
import pytest
import shapely
from pyproj import CRS
from shapely.geometry import GeometryCollection, LineString, MultiPolygon, Point, Polygon, box

from urbanforest_cli.core.errors import LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.register.cleaning import (
    VERTEX_CAP,
    Checked,
    drop_strays,
    first_look,
    id_order,
    overlaps,
    repair,
    twins,
    unwrap_longitudes,
)

SQUARE = [(0, 0), (10, 0), (10, 10), (0, 10)]


def shapes(*items):
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array


def cleaned(*items):
    notices = Notices()
    names = [chr(ord("a") + i) for i in range(len(items))]
    checked = first_look(shapes(*items), names, notices)
    repair(checked, names, notices)
    return checked, notices


def only(item):
    checked, notices = cleaned(item)
    return checked.shapes[0], checked.reasons[0], notices


def test_a_collapsed_ring_is_skipped_for_its_area():
    for flat in (Polygon([(0, 0), (10, 0), (0, 0)]), Polygon([(0, 0), (5, 5), (10, 10)])):
        shape, reason, notices = only(flat)
        assert shape is None
        assert reason == "no_area"
        assert notices.count("W_NO_AREA") == 1


def test_a_bow_tie_becomes_its_two_halves():
    shape, _, notices = only(Polygon([(0, 0), (10, 10), (10, 0), (0, 10)]))
    assert len(shape.geoms) == 2
    assert shape.area == pytest.approx(50)
    assert notices.count("W_REPAIRED") == 1


def test_a_figure_of_eight_at_a_vertex_keeps_both_loops():
    shape, _, notices = only(Polygon([(0, 0), (5, 5), (10, 0), (10, 10), (5, 5), (0, 10)]))
    assert shape.area == pytest.approx(50)
    assert notices.count("W_REPAIRED") == 1


def test_a_hole_that_touches_its_shell_at_a_point_is_accepted():
    shape, _, notices = only(Polygon(SQUARE, [[(0, 5), (3, 3), (3, 7)]]))
    assert shape.area == pytest.approx(100 - 6)
    assert len(notices) == 0


def test_a_hole_that_shares_an_edge_with_its_shell_stays_out():
    shape, _, notices = only(Polygon(SQUARE, [[(0, 3), (2, 3), (2, 6), (0, 6)]]))
    assert shape.area == pytest.approx(94)
    assert notices.count("W_REPAIRED") == 1


def test_a_hole_outside_its_shell_is_dropped():
    shape, _, notices = only(Polygon(SQUARE, [[(20, 20), (21, 20), (21, 21), (20, 21)]]))
    assert shape.area == pytest.approx(100)
    assert notices.count("W_REPAIRED") == 1


def test_overlapping_holes_are_subtracted_once():
    holes = [[(1, 1), (5, 1), (5, 5), (1, 5)], [(3, 3), (7, 3), (7, 7), (3, 7)]]
    shape, _, notices = only(Polygon(SQUARE, holes))
    assert shape.area == pytest.approx(72)
    assert notices.count("W_REPAIRED") == 1


def test_a_hole_that_covers_its_shell_leaves_nothing():
    shape, reason, _ = only(Polygon(SQUARE, [SQUARE]))
    assert shape is None
    assert reason == "no_area"


def test_a_spike_is_cut_off():
    shape, _, notices = only(Polygon([(0, 0), (10, 0), (10, 5), (30, 5), (10, 5), (10, 10), (0, 10)]))
    assert shape.area == pytest.approx(100)
    assert shape.bounds == (0, 0, 10, 10)
    assert notices.count("W_REPAIRED") == 1


def test_repeated_points_are_accepted():
    shape, _, notices = only(Polygon([(0, 0), (10, 0), (10, 0), (10, 10), (10, 10), (0, 10)]))
    assert shape.area == pytest.approx(100)
    assert len(notices) == 0


@pytest.mark.parametrize("height", [7.0, np.nan, np.inf])
def test_heights_are_dropped_whatever_they_are(height):
    shape, _, notices = only(Polygon([(x, y, height) for x, y in SQUARE]))
    assert shape.area == pytest.approx(100)
    assert not shape.has_z
    assert len(notices) == 0


@pytest.mark.parametrize("bad", [np.nan, np.inf, -np.inf])
def test_a_coordinate_that_is_no_number_is_found_before_the_geometry_engine_sees_it(bad):
    broken = shapely.transform(box(0, 0, 10, 10), lambda xy: np.where((xy == 10).all(axis=1)[:, None], bad, xy))
    checked, notices = cleaned(broken, Polygon(SQUARE))
    assert checked.reasons.tolist() == ["not_finite", ""]
    assert notices.count("W_NOT_FINITE") == 1


def test_rows_without_a_geometry_or_with_an_empty_one_are_skipped():
    checked, notices = cleaned(None, Polygon(), MultiPolygon(), Polygon(SQUARE))
    assert checked.reasons.tolist() == ["no_geometry"] * 3 + [""]
    assert notices.count("W_NO_GEOMETRY") == 3


def test_a_multipolygon_of_disjoint_parts_is_accepted():
    shape, _, notices = only(MultiPolygon([box(0, 0, 10, 10), box(20, 0, 30, 10)]))
    assert shape.area == pytest.approx(200)
    assert len(notices) == 0


def test_overlapping_parts_of_a_multipolygon_are_united():
    shape, _, notices = only(MultiPolygon([box(0, 0, 10, 10), box(5, 5, 15, 15)]))
    assert shape.area == pytest.approx(175)
    assert notices.count("W_REPAIRED") == 1


def test_of_a_collection_the_polygons_are_kept():
    nested = GeometryCollection([Point(1, 1), GeometryCollection([box(0, 0, 10, 10)]), LineString([(0, 0), (9, 9)])])
    checked, notices = cleaned(nested, GeometryCollection([Point(0, 0)]))
    assert checked.shapes[0].area == pytest.approx(100)
    assert checked.reasons[1] == "not_polygon"
    assert notices.count("W_COLLECTION") == 2


def test_points_and_lines_among_polygons_are_skipped():
    checked, notices = cleaned(Point(0, 0), LineString([(0, 0), (1, 1)]), Polygon(SQUARE))
    assert checked.reasons.tolist() == ["not_polygon", "not_polygon", ""]
    assert notices.count("W_NOT_POLYGON") == 2


def noisy_ring(vertices, radius=500.0, noise=0.05):
    rng = np.random.default_rng(0)
    angle = np.linspace(0, 2 * np.pi, vertices, endpoint=False)
    distance = radius + rng.uniform(-noise, noise, vertices)
    return Polygon(np.column_stack((distance * np.cos(angle), distance * np.sin(angle))))


def test_a_lot_of_a_hundred_thousand_vertices_is_simplified_within_the_cap():
    started = time.process_time()
    ring = noisy_ring(100_000)
    shape, _, notices = only(ring)
    assert shapely.get_num_coordinates(shape) <= VERTEX_CAP
    assert shape.is_valid
    assert shape.area == pytest.approx(ring.area, rel=1e-3)
    assert notices.count("W_SIMPLIFIED") == 1
    assert time.process_time() - started < 60


def test_a_lot_of_more_than_two_million_vertices_is_refused_at_once():
    with pytest.raises(LimitError, match="too many vertices"):
        only(noisy_ring(2_000_001))


def test_a_lot_of_ten_thousand_holes_keeps_them():
    x, y = (values.ravel() for values in np.meshgrid(np.arange(100.0), np.arange(100.0)))
    holes = np.stack([np.column_stack((x + dx, y + dy)) for dx, dy in [(0.2, 0.2), (0.8, 0.2), (0.5, 0.8)]], axis=1)
    lot = shapely.polygons(shapely.linearrings([(0, 0), (100, 0), (100, 100), (0, 100)]), shapely.linearrings(holes))
    shape, _, _ = only(lot)
    assert len(shape.interiors) == 10_000
    assert shape.area == pytest.approx(lot.area)


def test_a_lot_longer_than_five_hundred_kilometres_is_refused():
    with pytest.raises(LimitError, match="1,000 km"):
        only(box(0, 0, 1e6, 10))


def test_a_lot_of_a_tenth_of_a_millimetre_is_a_lot():
    shape, reason, _ = only(box(0, 0, 1e-4, 1e-4))
    assert reason == ""
    assert shape.area == pytest.approx(1e-8)


def test_a_lot_across_the_antimeridian_is_never_359_degrees_wide():
    notices = Notices()
    crossing = Polygon([(179.999, 10), (-179.999, 10), (-179.999, 10.001), (179.999, 10.001)])
    moved, shifted = unwrap_longitudes(
        shapes(crossing, box(179.99, 10, 179.998, 10.001), None), ["a", "b", "c"], notices
    )
    assert shifted
    assert moved[0].bounds == pytest.approx((179.999, 10, 180.001, 10.001))
    assert notices.count("W_ANTIMERIDIAN") == 1


def test_lots_on_both_sides_of_the_antimeridian_are_one_city():
    pair = shapes(box(179.99, 10, 179.998, 10.001), box(-179.998, 10, -179.99, 10.001))
    moved, shifted = unwrap_longitudes(pair, ["a", "b"], Notices())
    assert shifted
    assert np.ptp(shapely.total_bounds(moved)[[0, 2]]) < 0.03


def test_an_ordinary_city_is_not_shifted():
    city = shapes(box(-0.01, 51, -0.005, 51.001), box(0.005, 51, 0.01, 51.001))
    moved, shifted = unwrap_longitudes(city, ["a", "b"], Notices())
    assert not shifted
    assert moved is city


def test_a_lot_far_from_all_others_is_taken_out_and_named():
    notices = Notices()
    city = [box(2.5 + i / 1000, 48.9, 2.5005 + i / 1000, 48.901) for i in range(5)]
    count = len(city) + 1
    checked = Checked(shapes(*city, box(0, 0, 0.001, 0.001)), np.full(count, "", object), np.full(count, "", object))
    drop_strays(checked, CRS.from_epsg(4326), list("abcdef"), notices)
    assert checked.reasons.tolist() == [""] * 5 + ["misplaced"]
    assert next(iter(notices)).examples == ["f"]


def test_identical_lots_are_the_first_of_them_by_id():
    one, other = box(0, 0, 10, 10), Polygon([(10, 10), (0, 10), (0, 0), (10, 0)])
    ids = np.array(["10", "9", "1", "b", "c"], dtype=object)
    assert twins(shapes(one, other, box(0, 0, 9, 10), one, None), ids).tolist() == [1, -1, -1, 1, -1]


def test_lots_that_fit_together_do_not_overlap():
    tiles = shapes(*(box(10 * i, 10 * j, 10 * i + 10, 10 * j + 10) for i in range(5) for j in range(5)))
    giving, keeping = overlaps(tiles, np.arange(25).astype(str).astype(object), least_m2=1.0)
    assert len(giving) == len(keeping) == 0


def test_of_two_overlapping_lots_the_smaller_keeps_the_ground():
    lots = shapes(box(0, 0, 100, 100), box(20, 20, 30, 30), box(95, 0, 150, 100), box(150, 0, 160, 100))
    giving, keeping = overlaps(lots, np.array(["a", "b", "c", "d"], dtype=object), least_m2=1.0)
    assert sorted(zip(giving.tolist(), keeping.tolist(), strict=True)) == [(0, 1), (0, 2)]


def test_of_overlapping_lots_of_one_size_the_first_id_keeps_the_ground():
    lots = shapes(box(0, 0, 10, 10), box(5, 0, 15, 10))
    giving, keeping = overlaps(lots, np.array(["10", "9"], dtype=object), least_m2=1.0)
    assert (giving.tolist(), keeping.tolist()) == ([0], [1])


def test_neighbours_that_overlap_by_a_hand_are_left_alone():
    giving, _ = overlaps(
        shapes(box(0, 0, 10, 10), box(9.99, 0, 20, 10)), np.array(["a", "b"], dtype=object), least_m2=1.0
    )
    assert len(giving) == 0


def test_ids_are_ordered_as_numbers_where_they_are_numbers():
    assert sorted(["10", "9", "b", "1a", "0"], key=id_order) == ["0", "9", "10", "1a", "b"]


def test_a_lot_inside_another_is_an_overlap():
    from urbanforest_cli.register.cleaning import overlaps

    lots = np.array([shapely.box(0, 0, 100, 100), shapely.box(40, 40, 60, 60), shapely.box(100, 0, 200, 100)])
    gives_way, keeps = overlaps(lots, np.array(["a", "b", "c"], dtype=object), least_m2=1.0)
    assert (gives_way.tolist(), keeps.tolist()) == ([0], [1])
