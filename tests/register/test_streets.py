import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, box

from urbanforest_cli.core.config import Rules
from urbanforest_cli.register.streets import Roads, first_come, join_roads, regrouped, share_in_lots, verge_strips


def shapes(*items):
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array


def roads(*lines, width=6.0, ids=None):
    widths = np.full(len(lines), width) if np.isscalar(width) else np.array(width)
    return Roads(shapes(*lines), widths, np.array(ids or [str(i) for i in range(len(lines))], dtype=object))


NO_LOTS = np.empty(0, dtype=object)


def test_a_straight_road_has_a_strip_on_both_sides_beyond_the_curb():
    strip = verge_strips(roads(LineString([(0, 0), (100, 0)])), Rules(), NO_LOTS).shapes[0]
    truth = shapely.union_all([box(0, 3.75, 100, 6.25), box(0, -6.25, 100, -3.75)])
    assert strip.symmetric_difference(truth).area < 2 * 100 * 0.02
    assert strip.distance(LineString([(0, 0), (100, 0)])) >= 3.75


def test_strips_keep_off_the_carriageways_of_other_roads_and_off_each_other():
    crossing = roads(
        LineString([(-80, 0), (80, 0)]), LineString([(3, -80), (10, 80)]), LineString([(-80, 9), (80, 11)])
    )
    strips = verge_strips(crossing, Rules(), NO_LOTS).shapes
    parts, owner = shapely.get_parts(strips, return_index=True)
    present = regrouped(first_come(parts, owner), owner, len(strips))
    for strip in present:
        assert shapely.distance(strip, crossing.shapes).min() >= 3.75 - 1e-9
    assert shapely.area(shapely.union_all(present)) == pytest.approx(shapely.area(present).sum(), abs=1e-6)


def test_a_sidewalk_stays_free_between_a_strip_and_lots_beside_the_road():
    lots = shapes(box(0, 6, 100, 40), box(0, -40, 100, -20))
    strip = verge_strips(roads(LineString([(0, 0), (100, 0)])), Rules(), lots).shapes[0]
    assert strip.distance(lots[0]) >= 1.5
    assert strip.bounds[3] == pytest.approx(4.5, abs=0.02)
    assert strip.bounds[1] == pytest.approx(-6.25, abs=0.02)


def test_a_road_between_lots_that_leave_no_verge_has_no_strip():
    lots = shapes(box(0, 4, 100, 40), box(0, -40, 100, -4))
    strips = verge_strips(roads(LineString([(0, 0), (100, 0)])), Rules(), lots)
    assert strips.shapes[0] is None
    assert strips.corridors[0] is None


def test_where_lots_reach_over_a_road_they_give_way_to_its_strip_and_sidewalk():
    lots = shapes(box(0, 0, 100, 40), box(0, -40, 100, 0))
    strips = verge_strips(roads(LineString([(0, 0), (100, 0)])), Rules(), lots)
    assert strips.shapes[0].area == pytest.approx(2 * 100 * 2.5, rel=0.02)
    assert strips.corridors[0].bounds[3] == pytest.approx(6.25 + 1.5, abs=0.02)


def test_the_share_of_a_road_in_lots_is_measured_along_it():
    lots = shapes(box(0, -10, 25, 10), box(75, -10, 100, 10), None)
    assert share_in_lots(shapes(LineString([(0, 0), (100, 0)])), lots) == pytest.approx([0.5])


def test_pieces_of_one_street_become_one_road_named_after_the_first():
    pieces = roads(
        LineString([(100, 0), (50, 0)]), LineString([(0, 0), (50, 0)]), LineString([(100, 0), (150, 30)]),
        ids=["12", "3", "7"],
    )  # fmt: skip
    joined = join_roads(pieces)
    assert joined.ids.tolist() == ["3"]
    assert joined.shapes[0].geom_type == "LineString"
    assert joined.shapes[0].length == pytest.approx(shapely.length(pieces.shapes).sum())


def test_roads_are_not_joined_across_an_intersection_nor_where_the_width_changes():
    crossing = roads(LineString([(0, 0), (50, 0)]), LineString([(50, 0), (100, 0)]), LineString([(50, 0), (50, 50)]))
    assert len(join_roads(crossing).ids) == 3
    widening = roads(LineString([(0, 0), (50, 0)]), LineString([(50, 0), (100, 0)]), width=[6.0, 9.0])
    assert len(join_roads(widening).ids) == 2


def test_joined_roads_do_not_depend_on_the_order_of_rows():
    lines = [LineString([(50 * i, 0), (50 * i + 50, i % 2)]) for i in range(0, 9, 2)]
    lines += [LineString([(50 * i, (i - 1) % 2), (50 * i + 50, (i + 1) % 2)]) for i in range(1, 8, 2)]
    ids = [str(i) for i in range(len(lines))]
    one = join_roads(roads(*lines, ids=ids))
    other = join_roads(roads(*lines[::-1], ids=ids[::-1]))
    assert one.ids.tolist() == other.ids.tolist()
    assert [a.equals(b) for a, b in zip(one.shapes, other.shapes, strict=True)] == [True] * len(one.ids)


def test_a_paved_area_has_a_strip_around_it():
    square = Roads(shapes(box(0, 0, 20, 20)), np.array([0.0]), np.array(["9"], dtype=object))
    strip = verge_strips(square, Rules(), NO_LOTS).shapes[0]
    assert strip.distance(box(0, 0, 20, 20)) >= 0.75
    assert strip.bounds[2] == pytest.approx(20 + 3.25, abs=0.02)


def test_no_trees_are_set_along_footways():
    from urbanforest_cli.core.config import Rules
    from urbanforest_cli.register.streets import roads_with_trees

    kinds = np.array(["residential", "footway", "", "service"], dtype=object)
    lines = [LineString([(0, 10 * i), (50, 10 * i)]) for i in range(4)]
    roads = Roads(shapes(*lines), np.full(4, 6.0), np.array(list("abcd"), dtype=object), kinds)
    assert roads_with_trees(roads, Rules()).ids.tolist() == ["a", "c"]
    assert len(roads_with_trees(roads, Rules(treeless_road_kinds=())).ids) == 4
