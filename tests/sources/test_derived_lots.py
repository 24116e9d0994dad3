"""Lots from streets and buildings: all of a block, nothing of the street, to each building what lies nearest."""

from __future__ import annotations

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, Point, Polygon, box

from urbanforest_cli.sources.derived_lots import REACH_M, DerivedLots, derive_lots, share_out

WIDTH = 8.0


def array(*shapes: object) -> np.ndarray:
    result = np.empty(len(shapes), dtype=object)
    result[:] = shapes
    return result


def lots_of(lines: np.ndarray, buildings: np.ndarray, **more: object) -> DerivedLots:
    widths = more.get("widths", np.full(len(lines), WIDTH))
    areas = more.get("areas", array())
    return derive_lots(lines, widths, areas, buildings, report=lambda done, total: None)


def square_streets(size: float = 60.0) -> np.ndarray:
    return array(LineString(box(0, 0, size, size).exterior))


def test_two_houses_share_their_block_at_the_middle() -> None:
    houses = array(box(10, 20, 20, 40), box(40, 20, 50, 40))
    found = lots_of(square_streets(), houses)
    assert found.built.tolist() == [True, True]
    west, east = sorted(found.shapes, key=lambda lot: lot.bounds[0])
    assert west.area == pytest.approx(east.area, rel=0.02)
    assert west.bounds == pytest.approx((4, 4, 30, 56), abs=0.6)
    assert west.covers(houses[0])


def test_lots_fill_their_block_and_do_not_overlap() -> None:
    rng = np.random.default_rng(3)
    houses = array(*[box(x, y, x + 6, y + 9) for x, y in rng.uniform(8, 90, (6, 2))])
    houses = array(*shapely.get_parts(shapely.union_all(houses)))
    block = box(4, 4, 100, 100)
    pieces = array(*[piece for piece, _ in share_out(block, houses)])
    assert shapely.union_all(pieces).area == pytest.approx(block.area, abs=0.01)
    assert shapely.area(pieces).sum() == pytest.approx(block.area, abs=0.01)
    assert shapely.is_valid(pieces).all()


def test_every_place_belongs_to_the_building_with_the_nearest_wall() -> None:
    houses = array(
        box(10, 10, 22, 16), Polygon([(40, 12), (50, 12), (50, 50), (44, 50), (44, 20), (40, 20)]), box(12, 40, 20, 50)
    )
    pieces = share_out(box(4, 4, 56, 56), houses)
    cells = array(*[piece for piece, built in pieces if built])
    xy = np.random.default_rng(0).uniform(4, 56, (2000, 2))
    points = shapely.points(xy)
    distances = np.array([shapely.distance(points, house) for house in houses])
    first, second = np.sort(distances, axis=0)[:2]
    clear = second - first > 1.0  # walls are sampled, so that borders are not exact
    owners = np.array([shapely.contains(cell, points) for cell in cells])
    assert clear.sum() > 1000
    assert (owners[:, clear].sum(axis=0) == 1).all()
    assert (owners[:, clear].argmax(axis=0) == distances[:, clear].argmin(axis=0)).all()


def test_a_courtyard_house_leaves_the_house_inside_its_own_lot() -> None:
    around = Polygon(box(10, 10, 50, 50).exterior, [box(16, 16, 44, 44).exterior])
    inner = box(28, 28, 32, 32)
    pieces = [piece for piece, _ in share_out(box(0, 0, 60, 60), array(around, inner))]
    assert sum(piece.area for piece in pieces) == pytest.approx(3600, rel=1e-4)
    assert shapely.intersection(*pieces).area == pytest.approx(0, abs=0.01)
    assert pieces[1].covers(inner)


def test_a_block_without_buildings_is_one_lot() -> None:
    found = lots_of(square_streets(), array())
    assert found.built.tolist() == [False]
    assert found.shapes[0].area == pytest.approx(52 * 52, rel=1e-3)


def test_ground_far_from_any_building_is_a_lot_of_its_own() -> None:
    found = lots_of(square_streets(400.0), array(box(20, 20, 30, 30)))
    with_house = found.shapes[found.built][0]
    assert found.built.sum() == 1
    assert with_house.within(box(20, 20, 30, 30).buffer(REACH_M + 0.01))
    assert (~found.built).sum() == 1


def test_a_building_outside_all_blocks_has_a_yard_about_it() -> None:
    found = lots_of(square_streets(), array(box(200, 0, 210, 10)))
    lone = found.shapes[found.built][0]
    assert lone.bounds == pytest.approx((185, -15, 225, 25), abs=0.1)


def test_paths_do_not_part_a_block() -> None:
    lines = array(*square_streets(), LineString([(0, 30), (60, 30)]))
    found = lots_of(lines, array(), widths=np.array([WIDTH, 2.0]))
    assert len(found.shapes) == 1
    assert len(lots_of(lines, array()).shapes) == 2


def test_roads_drawn_as_areas_are_taken_out() -> None:
    road = box(-20, 25, 80, 35)
    houses = array(box(20, 5, 30, 15), box(20, 45, 30, 55))
    found = lots_of(array(), houses, areas=array(road))
    assert found.built.all()
    assert shapely.area(shapely.intersection(found.shapes, road)).max() < 1e-6


def test_houses_that_share_a_wall_share_the_ground_behind_it() -> None:
    row = array(*[box(10 + 8 * i, 25, 18 + 8 * i, 35) for i in range(5)])
    pieces = share_out(box(4, 4, 56, 56), row)
    assert [built for _, built in pieces] == [True] * 5
    middle = pieces[2][0]
    assert middle.bounds[0] == pytest.approx(26, abs=0.3)
    assert middle.bounds[2] == pytest.approx(34, abs=0.3)


def test_the_place_of_the_city_changes_nothing() -> None:
    houses = array(box(10, 20, 20, 40), box(40, 20, 50, 40), Point(30, 12).buffer(3))
    near = lots_of(square_streets(), houses)
    move = lambda xy: xy + (500_000.0, 4_649_776.0)  # noqa: E731, RUF005
    far = lots_of(shapely.transform(square_streets(), move), shapely.transform(houses, move))
    assert near.names.tolist() == far.names.tolist()
    assert shapely.area(near.shapes) == pytest.approx(shapely.area(far.shapes), abs=0.1)
