import math

import numpy as np
import pytest
import shapely
from shapely.geometry import LineString, MultiPolygon, Point, Polygon, box

from urbanforest_cli.core.config import Rules
from urbanforest_cli.register.envelopes import ARC_EXCESS_M, drop_small
from urbanforest_cli.register.near import Near, NearThings, exactly
from urbanforest_cli.register.plantable import Surroundings, Taken, plantable_areas
from urbanforest_cli.register.rules import locate_entrances


def shapes(*items):
    array = np.empty(len(items), dtype=object)
    array[:] = items
    return array


def ground(lots, rules=None, zones=None, taken=None, workers=1, **around):
    rules = rules or Rules()
    zones = np.array(zones or ["residential"] * len(lots), dtype=object)
    extra = {} if taken is None else {"taken": taken}
    return plantable_areas(shapes(*lots), zones, Surroundings(**around), lambda _: rules, workers=workers, **extra)


def edge_points(area, step=0.05):
    return shapely.points(shapely.get_coordinates(shapely.segmentize(shapely.boundary(area), step)))


def house(x=25.0, y=25.0, width=10.0, depth=10.0):
    return box(x, y, x + width, y + depth)


def test_a_house_takes_a_square_with_round_corners():
    area = ground([box(0, 0, 60, 60)], buildings=shapes(house())).areas[0].area
    truth = 3600 - (100 + 4 * 10 * 6 + math.pi * 36)
    assert truth - (4 * 10 + 2 * math.pi * 6) * ARC_EXCESS_M < area < truth


def test_nothing_of_the_ground_is_nearer_to_a_wall_than_the_clearance():
    corner = Polygon([(25, 25), (40, 26), (39, 30), (31, 29.5), (30.5, 41), (24, 40)])
    area = ground([box(0, 0, 60, 60)], buildings=shapes(corner, house(50, 50))).areas[0]
    gaps = shapely.distance(edge_points(area), shapely.union_all([corner, house(50, 50)]))
    assert gaps.min() > 6.0 - 1e-9


def test_the_house_of_a_neighbour_counts_too():
    lots = [box(0, 0, 30, 30), box(30, 0, 60, 30)]
    next_door = shapes(box(32, 10, 42, 20))
    with_neighbours = ground(lots, buildings=next_door).areas[0].area
    alone = ground(lots, rules=Rules(neighbour_buildings=False), buildings=next_door).areas
    assert with_neighbours < 900 - 4 * 10
    assert alone[0].area == pytest.approx(900)
    assert alone[1].area < 900 - 10 * 10


def test_a_party_wall_does_not_make_a_house_ones_own():
    lots = [box(0, 0, 30, 30), box(30, 0, 60, 30)]
    left = ground(lots, rules=Rules(neighbour_buildings=False), buildings=shapes(box(30, 5, 40, 20))).areas[0]
    assert left.area == pytest.approx(900)


def test_a_driveway_keeps_its_distance_as_polygon_and_as_line():
    lot = box(0, 0, 40, 40)
    polygon = ground([lot], driveways=shapes(box(18.5, -5, 21.5, 50))).areas[0]
    line = ground([lot], driveways=shapes(LineString([(20, -5), (20, 50)]))).areas[0]
    assert polygon.area == pytest.approx(40 * (40 - 6), abs=2 * 40 * ARC_EXCESS_M)
    assert line.area == pytest.approx(40 * (40 - 6), abs=2 * 40 * ARC_EXCESS_M)
    assert isinstance(polygon, MultiPolygon)


def test_roads_keep_plants_off_the_carriageway_and_the_curb():
    lot = box(0, 0, 40, 40)
    area = ground([lot], roads=shapes(LineString([(-50, 0), (90, 0)])), road_widths_m=np.array([7.0])).areas[0]
    assert area.area == pytest.approx(40 * (40 - 3.5 - 0.75), abs=40 * ARC_EXCESS_M)
    assert shapely.bounds(area)[1] >= 3.5 + 0.75
    paved = ground([lot], roads=shapes(box(-50, -3, 90, 3)), road_widths_m=np.array([0.0])).areas[0]
    assert paved.area == pytest.approx(40 * (40 - 3 - 0.75), abs=40 * ARC_EXCESS_M)


def test_obstacles_keep_the_distance_of_their_kind_unless_they_state_their_own():
    lot = box(0, 0, 40, 40)
    kinds = np.array(["Hydrant ", "bench", "mast"], dtype=object)
    places = shapes(Point(10, 10), Point(20, 20), Point(30, 30))
    area = ground(
        [lot], obstacles=places, obstacle_kinds=kinds, obstacle_clearance_m=np.array([np.nan, np.nan, 5.0])
    ).areas[0]
    for place, distance in zip(places, (3.0, 1.5, 5.0), strict=True):
        assert shapely.distance(place, area) == pytest.approx(distance, abs=ARC_EXCESS_M)
        assert shapely.distance(place, area) >= distance - 1e-9


def test_the_ground_in_front_of_a_door_stays_free_to_its_depth_and_width():
    building = shapes(house(25, 25))
    entrances, on_wall = locate_entrances(shapes(Point(30, 24.9)), np.array([False]), building)
    assert on_wall.all()
    area = ground([box(0, 0, 60, 60)], buildings=building, entrances=entrances).areas[0]
    assert not area.intersects(box(28.51, 16.01, 31.49, 25))
    assert area.contains(box(28.51, 15, 31.49, 15.99))
    assert area.contains(box(27, 16.01, 28.49, 18.9))
    assert area.contains(box(31.51, 16.01, 33, 18.9))


def test_zones_have_rules_of_their_own():
    near, far = Rules(building_clearance_m=2.0), Rules()
    lots = shapes(box(0, 0, 30, 30), box(0, 40, 30, 70))
    around = Surroundings(buildings=shapes(house(10, 10), house(10, 50)))
    zones = np.array(["street", "residential"], dtype=object)
    areas = plantable_areas(lots, zones, around, {"street": near, "residential": far}.__getitem__).areas
    assert areas[0].area == pytest.approx(900 - 100 - 80 - 4 * math.pi, abs=1)
    assert areas[1].area == pytest.approx(900 - 100 - 240 - 36 * math.pi, abs=1)


def test_a_clearance_of_nothing_takes_the_house_alone():
    rules = Rules(building_clearance_m=0.0, driveway_clearance_m=0.0)
    area = ground([box(0, 0, 60, 60)], rules=rules, buildings=shapes(house(), house(30, 30))).areas[0]
    assert area.area == pytest.approx(3600 - 175)


def test_a_lot_in_the_envelope_of_a_house_has_no_ground_left():
    result = ground([box(20, 20, 40, 40)], buildings=shapes(box(0, 0, 60, 60)))
    assert result.areas[0] is None
    assert result.dropped_parts[0] == 0


def test_a_lot_that_is_its_house_has_no_ground_left():
    assert ground([house()], buildings=shapes(house())).areas[0] is None


def test_pieces_too_small_to_plant_are_dropped_and_counted():
    wide = shapes(LineString([(0, 0.5), (40, 0.5)]))
    result = ground([box(0, 0, 40, 10)], driveways=wide)
    assert result.dropped_parts[0] == 0
    result = ground([box(0, 0, 3, 10)], driveways=shapes(LineString([(-5, 3.3), (10, 3.3)])))
    assert result.dropped_parts[0] == 1
    assert result.areas[0].bounds[1] > 6


def test_ground_that_another_unit_takes_is_left_out():
    taken = Taken(np.array([1]), shapes(box(30, 0, 45, 60)))
    areas = ground([box(0, 0, 30, 30), box(30, 0, 60, 30)], taken=taken).areas
    assert areas[0].area == pytest.approx(900)
    assert areas[1].area == pytest.approx(450)


def test_a_subset_of_lots_has_the_areas_of_the_whole_to_the_last_bit():
    rng = np.random.default_rng(5)
    lots = [box(30 * i, 30 * j, 30 * i + 30, 30 * j + 30) for i in range(12) for j in range(12)]
    corner = rng.uniform(2, 12, (144, 4))
    houses = [
        box(lot.bounds[0] + a, lot.bounds[1] + b, lot.bounds[2] - c, lot.bounds[3] - d)
        for lot, (a, b, c, d) in zip(lots, corner, strict=True)
    ]
    roads, widths = shapes(LineString([(0, 61), (360, 64)]), LineString([(61, 0), (64, 360)])), np.array([5.0, 6.0])
    around = {"buildings": shapes(*houses), "roads": roads, "road_widths_m": widths}
    whole = ground(lots, **around).areas
    some = rng.permutation(144)[:20]
    part = ground([lots[row] for row in some], **around).areas
    threads = ground(lots, workers=4, **around).areas
    assert shapely.to_wkb(part).tolist() == shapely.to_wkb(whole[some]).tolist()
    assert shapely.to_wkb(threads).tolist() == shapely.to_wkb(whole).tolist()


def suburb(seed, side=5, spread=9.0, turned=True):
    """Lots with a house each and a driveway each; wide spreads make houses overlap lots and each other."""
    rng = np.random.default_rng(seed)
    lots, houses, drives = [], [], []
    for i in range(side):
        for j in range(side):
            x, y = 24 * i + 5e5, 24 * j + 5e6
            lots.append(box(x, y, x + 24, y + 24))
            dx, dy = rng.uniform(-spread, spread, 2)
            a, b = rng.uniform(3, 12, 2)
            outline = (
                [(0, 0), (a, 0), (a, b / 2), (a / 2, b / 2), (a / 2, b), (0, b)] if i % 2 else box(0, 0, a, b).exterior
            )
            house = shapely.affinity.translate(Polygon(outline), x + 9 + dx, y + 9 + dy)
            houses.append(shapely.affinity.rotate(house, rng.uniform(0, 90)) if turned else house)
            drives.append(box(x + 1, y, x + 4, y + rng.uniform(6, 14)))
    return shapes(*lots), shapes(*houses), shapes(*drives)


@pytest.mark.parametrize(
    ("seed", "spread", "turned"), [(1, 2.0, True), (2, 9.0, True), (3, 20.0, True), (4, 9.0, False)]
)
def test_areas_agree_with_the_plain_way_of_one_union_and_one_difference_a_lot(seed, spread, turned):
    lots, houses, drives = suburb(seed, spread=spread, turned=turned)
    result = ground(list(lots), buildings=houses, driveways=drives).areas
    envelope = shapely.union_all(
        [*shapely.buffer(houses, 6.0, quad_segs=256), *shapely.buffer(drives, 1.5, quad_segs=256)]
    )
    for lot, area in zip(lots, result, strict=True):
        truth = drop_small(shapes(lot.difference(envelope)), 1.0)[0][0]
        if area is None or truth is None:
            assert (area or truth or Polygon()).area < 1.1
            continue
        assert area.is_valid
        assert area.difference(truth).area < 1e-2
        assert truth.difference(area).area < truth.length * ARC_EXCESS_M + 1e-2


def test_the_exact_kernel_does_nearly_all_lots_by_itself():
    lots, houses, drives = suburb(7, side=12)
    things = NearThings([Near(houses, 6.0), Near(drives, 1.5)])
    row, thing = shapely.STRtree(np.concatenate((houses, drives))).query(lots, predicate="dwithin", distance=6.0)
    order = np.lexsort((thing, row))
    _, _, done = exactly(lots, things.things, things.clearance_m, row[order], thing[order])
    assert done.mean() > 0.97


def test_row_houses_with_party_walls_have_one_smooth_envelope():
    houses = shapes(*(box(8 * i, 20, 8 * i + 8, 30) for i in range(5)))
    lots = [box(8 * i, 0, 8 * i + 8, 50) for i in range(5)]
    result = ground(lots, buildings=houses).areas
    assert [area.area for area in result] == pytest.approx([8 * 50 - 8 * 22] * 5, abs=0.2)
    assert shapely.distance(result, shapely.union_all(houses)) == pytest.approx(6.0)


def test_two_houses_in_one_place_take_what_one_takes():
    once = ground([box(0, 0, 60, 60)], buildings=shapes(house())).areas[0]
    twice = ground([box(0, 0, 60, 60)], buildings=shapes(house(), house())).areas[0]
    assert once.symmetric_difference(twice).area < 1.0
    assert twice.distance(house()) >= 6 - 1e-9
