import numpy as np
import pytest
import shapely
from pyproj import CRS
from shapely import LineString, MultiPolygon, Polygon, box

from urbanforest_cli.core.scenery import Origin
from urbanforest_cli.core.skeleton import no_skeletons
from urbanforest_cli.export.scene.city import City, Plants
from urbanforest_cli.export.scene.ground import (
    GROUND,
    MARGIN_M,
    PLATE,
    PLATE_CELL_M,
    PLATE_M,
    ROAD,
    ROAD_M,
    build_ground,
    ground_tint,
)
from urbanforest_cli.export.scene.pieces import (
    CELL_M,
    Piece,
    Triangles,
    cut_to_triangles,
    doubled_area,
    joined,
    sound_polygons,
)

EAST, NORTH = 400_000.0, 5_500_000.0
GREEN, ROSE = "#e3efd6", "#f5dfe0"
WITH_A_POND = Polygon(box(0, 0, 40, 30).exterior, [box(15, 10, 25, 20).exterior])


def no_plants() -> Plants:
    kinds = {"plant_id": object, "lot_id": object, "species": np.int64, "skeleton_id": np.int64, "mirror": bool}
    kinds |= {"is_library": bool}
    return Plants(
        **{
            name: np.empty((0, 2) if name == "xy_m" else 0, dtype=kinds.get(name, np.float64))
            for name in Plants.__dataclass_fields__
        }
    )


def shapes_at(shapes: list) -> np.ndarray:
    found = np.empty(len(shapes), dtype=object)
    found[:] = shapes
    return np.asarray(shapely.transform(found, lambda xy: xy + np.array([EAST, NORTH])), dtype=object)


def a_city(lots: list, colours: list[str], roads: list, *, ground_m: float = 0.0) -> City:
    empty = np.empty(0, dtype=object)
    return City(
        name="Nowhere", origin=Origin(CRS("EPSG:32633"), EAST, NORTH, ground_m), register_crs=CRS("EPSG:32633"),
        plants=no_plants(), species=(), skeletons_of=lambda ids: no_skeletons(), years_ago=0, buildings=empty,
        building_height_m=np.empty(0), building_id=empty, lots=shapes_at(lots),
        lot_colour=np.array(colours, dtype=object), roads=shapes_at(roads),
    )  # fmt: skip


def corners_of(pieces: list[Piece]) -> np.ndarray:
    found = [p.mesh.xyz_m.astype(np.float64)[p.mesh.triangle] + np.array(p.centre_m) for p in pieces]
    return np.concatenate([np.empty((0, 3, 3)), *found])


def area_of(pieces: list[Piece]) -> float:
    return float(doubled_area(corners_of(pieces)[:, :, :2]).sum() / 2)


def covered(pieces: list[Piece]) -> shapely.Geometry:
    return shapely.union_all(shapely.polygons(corners_of(pieces)[:, :, :2]), grid_size=1e-4)


def named(pieces: list[Piece], word: str) -> list[Piece]:
    return [piece for piece in pieces if piece.name.startswith(word)]


def test_lots_keep_their_area_holes_and_parts() -> None:
    lots = [WITH_A_POND, MultiPolygon([box(50, 0, 60, 10), box(60, 20, 70, 30)]), box(-5, -5, 0, 0)]
    found = named(build_ground(a_city(lots, [GREEN] * 3, [])), "lots")
    assert area_of(found) == pytest.approx(1100 + 200 + 25, rel=1e-6)
    assert covered(found).symmetric_difference(shapely.union_all(lots)).area < 0.01


def test_where_a_lot_and_a_road_overlap_the_road_is_kept() -> None:
    lots = [box(0, 0, 100, 40), box(0, 40, 100, 90)]
    roads = [LineString([(-20, 40), (120, 40)]).buffer(4), LineString([(50, -20), (50, 120)]).buffer(3)]
    pieces = build_ground(a_city(lots, [GREEN, ROSE], roads))
    road = shapely.union_all(roads)
    assert area_of(named(pieces, "roads")) == pytest.approx(road.area, rel=1e-5)
    left = shapely.union_all(lots).difference(road)
    assert area_of(named(pieces, "lots")) == pytest.approx(left.area, rel=1e-5)
    assert covered(named(pieces, "lots")).symmetric_difference(left).area < 0.05


def test_surfaces_are_flat_look_up_and_lie_apart() -> None:
    pieces = build_ground(a_city([box(0, 0, 100, 40)], [GREEN], [box(0, 10, 100, 16)], ground_m=30.0))
    heights = {"lots": -30.0, "roads": -30.0 + ROAD_M, "plate": -30.0 - PLATE_M}
    for word, height in heights.items():
        corners = corners_of(named(pieces, word))
        np.testing.assert_allclose(corners[:, :, 2], height, atol=1e-6)
        assert (doubled_area(corners[:, :, :2]) > 0).all()
    for piece in pieces:
        assert (piece.mesh.normal == [0, 0, 1]).all()
    assert {p.name.split()[0]: p.material for p in pieces} == {"lots": GROUND, "roads": ROAD, "plate": PLATE}


def test_each_lot_has_the_quiet_colour_of_its_own_zone() -> None:
    lots = [box(0, 0, 10, 10), box(20, 0, 30, 10), box(40, 0, 50, 10)]
    (piece,) = named(build_ground(a_city(lots, [GREEN, ROSE, GREEN], [])), "lots")
    east = piece.mesh.xyz_m[:, 0] + piece.centre_m[0]
    for lot, colour in zip(lots, (GREEN, ROSE, GREEN), strict=True):
        mine = (east >= lot.bounds[0] - 0.1) & (east <= lot.bounds[2] + 0.1)
        assert mine.sum() == 4
        assert (piece.mesh.tint[mine] == ground_tint(colour)).all()
    green, rose = np.array(ground_tint(GREEN), int), np.array(ground_tint(ROSE), int)
    assert green[1] > green[0] > green[2]
    assert np.abs(green - rose).max() >= 10


def test_a_large_city_is_cut_into_cells_with_small_numbers() -> None:
    lots = [box(-9000, -7000, 9000, -6000), box(100, 100, 300, 200)]
    roads = [box(-9000, -5900, 9000, -5890)]
    pieces = build_ground(a_city(lots, [GREEN, ROSE], roads))
    assert len({p.name for p in pieces}) == len(pieces)
    for piece in pieces:
        half = PLATE_CELL_M / 2 if piece.material == PLATE else CELL_M / 2
        assert np.abs(piece.mesh.xyz_m).max() <= half + 1e-3
    assert area_of(named(pieces, "lots")) == pytest.approx(18000 * 1000 + 20000, rel=1e-6)
    assert area_of(named(pieces, "roads")) == pytest.approx(18000 * 10, rel=1e-5)


def test_the_plate_lies_under_all_with_a_margin() -> None:
    pieces = build_ground(a_city([box(0, 0, 100, 40)], [GREEN], [box(-300, 0, -200, 10)]))
    plate = corners_of(named(pieces, "plate"))
    assert plate[:, :, :2].min(axis=(0, 1)).tolist() == [-300 - MARGIN_M, -MARGIN_M]
    assert plate[:, :, :2].max(axis=(0, 1)).tolist() == [100 + MARGIN_M, 40 + MARGIN_M]
    assert area_of(named(pieces, "plate")) == pytest.approx((400 + 2 * MARGIN_M) * (40 + 2 * MARGIN_M))


def test_a_city_without_anything_has_no_ground_and_one_without_roads_has_lots() -> None:
    assert build_ground(a_city([], [], [])) == []
    pieces = build_ground(a_city([box(0, 0, 9, 9)], [ROSE], []))
    assert {p.name.split()[0] for p in pieces} == {"lots", "plate"}
    assert {p.name.split()[0] for p in build_ground(a_city([], [], [box(0, 0, 9, 9)]))} == {"roads", "plate"}


def test_texture_runs_on_from_lot_to_lot_in_metres() -> None:
    (piece,) = named(build_ground(a_city([box(0, 0, 9, 9), box(9, 0, 20, 9)], [ROSE, GREEN], [])), "lots")
    np.testing.assert_allclose(piece.mesh.uv, piece.mesh.xyz_m[:, :2] * [1, -1], atol=1e-5)


@pytest.mark.parametrize(
    ("ring", "area"),
    [
        ([(0, 0), (0, 6), (10, 6), (10, 0)], 60.0),  # clockwise
        ([(0, 0), (0, 0), (10, 0), (10, 0), (10, 6), (0, 6)], 60.0),  # repeated corners
        ([(0, 0), (5, 0), (10, 0), (10, 6), (5, 6), (0, 6)], 60.0),  # on a line
        ([(0, 0, 7), (10, 0, 8), (10, 6, 9), (0, 6, 9)], 60.0),  # heights
        ([(0, 0), (6, 6), (6, 0), (0, 6)], 18.0),  # crosses itself
        ([(0, 0), (9, 0), (9, 1e-3), (0, 1e-3)], 0.009),  # a sliver
    ],
)
def test_triangles_cover_any_ring_and_turn_to_the_left(ring, area) -> None:
    polygons, owner = sound_polygons(np.array([None, Polygon(ring), Polygon()], dtype=object))
    assert (owner == 1).all()
    xy, _ = cut_to_triangles(polygons)
    assert (doubled_area(xy) >= 0).all()
    assert doubled_area(xy).sum() / 2 == pytest.approx(area)


def test_equal_corners_are_stored_once_and_empty_triangles_left_out() -> None:
    corners = np.array(
        [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]], [[0, 0, 0], [1, 1, 0], [1, 1 + 1e-9, 0]]]
    )
    normal, tint = np.tile([0.0, 0.0, 1.0], (3, 1)), np.full((3, 3), 7, np.uint8)
    mesh = joined(Triangles(corners, normal, corners[:, :, :2], tint), (100.0, 0.0, 0.0))
    assert mesh.xyz_m.tolist() == [[-100, 0, 0], [-99, 0, 0], [-99, 1, 0], [-100, 1, 0]]
    assert mesh.triangle.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert (mesh.tint == 7).all()
    tint[1] = 8
    assert len(joined(Triangles(corners, normal, corners[:, :, :2], tint), (0.0, 0.0, 0.0)).xyz_m) == 6
