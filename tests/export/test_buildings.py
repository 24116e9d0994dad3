from collections import Counter

import numpy as np
import pytest
import shapely
from pyproj import CRS
from shapely import MultiPolygon, Polygon, box

from urbanforest_cli.core.scenery import Origin
from urbanforest_cli.core.skeleton import no_skeletons
from urbanforest_cli.export.scene.buildings import FOOT_M, build_buildings
from urbanforest_cli.export.scene.city import City, Plants
from urbanforest_cli.export.scene.pieces import CELL_M, Piece
from urbanforest_cli.export.scene.roofs import PARAPET_RISE_M, PITCH

EAST, NORTH = 400_000.0, 5_500_000.0
HOUSE = box(0, 0, 10, 6)
COURT = Polygon(box(0, 0, 40, 30).exterior, [box(15, 10, 25, 20).exterior])


def no_plants() -> Plants:
    kinds = {"plant_id": object, "lot_id": object, "species": np.int64, "skeleton_id": np.int64, "mirror": bool}
    kinds |= {"is_library": bool}
    return Plants(
        **{
            name: np.empty((0, 2) if name == "xy_m" else 0, dtype=kinds.get(name, np.float64))
            for name in Plants.__dataclass_fields__
        }
    )


def a_city(buildings: list, height_m: list[float], *, ground_m: float = 0.0) -> City:
    """Buildings about the origin of a city that has nothing else."""
    shapes = np.empty(len(buildings), dtype=object)
    shapes[:] = buildings
    empty = np.empty(0, dtype=object)
    return City(
        name="Nowhere", origin=Origin(CRS("EPSG:32633"), EAST, NORTH, ground_m), register_crs=CRS("EPSG:32633"),
        plants=no_plants(), species=(), skeletons_of=lambda ids: no_skeletons(), years_ago=0,
        buildings=shapely.transform(shapes, lambda xyz: xyz + [EAST, NORTH, 0.0][: xyz.shape[1]], include_z=None),
        building_height_m=np.array(height_m, dtype=np.float64),
        building_id=np.array([str(i) for i in range(len(buildings))], dtype=object),
        lots=empty, lot_colour=empty, roads=empty,
    )  # fmt: skip


def triangles_of(pieces: list[Piece] | tuple[Piece, ...], word: str = "") -> np.ndarray:
    """Corners (t, 3, 3) about the scene's origin."""
    found = [
        p.mesh.xyz_m.astype(np.float64)[p.mesh.triangle] + np.array(p.centre_m)
        for p in pieces
        if p.name.startswith(word)
    ]
    return np.concatenate([np.empty((0, 3, 3)), *found])


def volume(corners: np.ndarray) -> float:
    """The volume within, the open bottom closed by a plane at the height of its rim."""
    corners = corners - [0, 0, corners[:, :, 2].min()]
    return float(np.einsum("ij,ij->i", corners[:, 0], np.cross(corners[:, 1], corners[:, 2])).sum() / 6)


def open_edges(corners: np.ndarray) -> Counter:
    points = [[tuple((np.round(corner, 3) + 0.0).tolist()) for corner in triangle] for triangle in corners]
    edges = Counter((t[k], t[(k + 1) % 3]) for t in points for k in range(3))
    return edges - Counter((b, a) for a, b in edges.elements())


def roof_kind(pieces: tuple[Piece, ...], height_m: float) -> str:
    """Which roof a building has, as its faces show."""
    roof = triangles_of(pieces, "roofs")
    across = np.cross(roof[:, 1] - roof[:, 0], roof[:, 2] - roof[:, 0])
    upward = across[:, 2] / np.linalg.norm(across, axis=1)
    slopes = ((upward > 0.01) & (upward < 0.99)).any()
    rise = triangles_of(pieces, "walls")[:, :, 2].max() - height_m
    if slopes:
        return "gable" if rise > 0.01 else "hip"
    return {0.0: "flat", PARAPET_RISE_M: "parapet"}[round(rise, 4) + 0.0]


@pytest.mark.parametrize(
    ("shape", "height", "kind", "over"),
    [
        (HOUSE, 6.0, "gable", 10 * 6 * 3 * PITCH / 2),
        (box(0, 0, 16, 12), 6.0, "hip", (12 * 16 / 2 - 12**2 / 6) * 6 * PITCH),
        (box(0, 0, 5, 3), 2.5, "flat", 0.0),
        (box(0, 0, 40, 30), 9.0, "parapet", (1200 - 39.3 * 29.3) * PARAPET_RISE_M),
        (COURT, 9.0, "parapet", (1200 - 39.3 * 29.3 + 10.7**2 - 100) * PARAPET_RISE_M),
        (Polygon([(0, 0), (12, 0), (12, 5), (5, 5), (5, 12), (0, 12)]), 5.0, "gable", None),
    ],
)
def test_buildings_are_closed_solids_of_the_right_volume(shape, height, kind, over) -> None:
    built = build_buildings(a_city([shape], [height]))
    assert built.left_out == 0
    assert roof_kind(built.pieces, height) == kind
    corners = triangles_of(built.pieces)
    rim = open_edges(corners)
    assert sum(rim.values()) == shapely.get_num_coordinates(shape) - len(shapely.get_rings(shape))
    assert all(a[2] == b[2] == -FOOT_M for a, b in rim)
    if over is not None:
        assert volume(corners) == pytest.approx(shape.area * (height + FOOT_M) + over, rel=1e-5)


def test_normals_look_out_and_triangles_turn_with_them() -> None:
    built = build_buildings(a_city([COURT, shapely.transform(HOUSE, lambda xy: xy + 80)], [9.0, 6.0]))
    for piece in built.pieces:
        mesh = piece.mesh
        corners = mesh.xyz_m.astype(np.float64)[mesh.triangle]
        across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        across /= np.linalg.norm(across, axis=1, keepdims=True)
        for k in range(3):
            np.testing.assert_allclose(across, mesh.normal[mesh.triangle[:, k]], atol=1e-4)
    walls = next(p for p in built.pieces if p.name.startswith("walls"))
    middle = (walls.mesh.xyz_m[walls.mesh.triangle].mean(axis=1) + np.array(walls.centre_m))[:, :2]
    before = middle + 0.1 * walls.mesh.normal[walls.mesh.triangle[:, 0], :2]
    inside = shapely.contains_xy(shapely.union_all([COURT, shapely.transform(HOUSE, lambda xy: xy + 80)]), before)
    assert not inside.any()


def test_footprints_are_kept_exactly_with_holes_and_parts() -> None:
    parts = MultiPolygon([COURT, box(60, 0, 70, 6), box(80, 0, 85, 3)])
    built = build_buildings(a_city([parts], [9.0]))
    roof = triangles_of(built.pieces, "roofs")
    flat = np.abs(np.cross(roof[:, 1] - roof[:, 0], roof[:, 2] - roof[:, 0])[:, 2]) / 2
    assert flat.sum() == pytest.approx(parts.area, rel=1e-6)
    seen = shapely.union_all(shapely.polygons(roof[flat > 0][:, :, :2]), grid_size=1e-3)
    assert seen.symmetric_difference(parts).area < 1e-3 * parts.area
    assert built.left_out == 0


@pytest.mark.parametrize(
    "ring",
    [
        [(0, 0), (0, 6), (10, 6), (10, 0)],  # clockwise
        [(0, 0), (0, 0), (10, 0), (10, 0), (10, 6), (0, 6), (0, 6)],  # repeated
        [(5, 0), (10, 0), (10, 3), (10, 6), (4, 6), (0, 6), (0, 1), (0, 0)],  # on straight walls
        [(0, 0, 3), (10, 0, 4), (10, 6, 5), (0, 6, 5)],  # with heights
    ],
)
def test_rings_may_be_clockwise_repeat_corners_have_needless_ones_and_heights(ring) -> None:
    plain = build_buildings(a_city([HOUSE], [6.0]))
    other = build_buildings(a_city([Polygon(ring)], [6.0]))
    assert len(other.pieces) == len(plain.pieces)
    for a, b in zip(plain.pieces, other.pieces, strict=True):
        assert len(a.mesh.triangle) == len(b.mesh.triangle)
    assert volume(triangles_of(other.pieces)) == pytest.approx(volume(triangles_of(plain.pieces)), rel=1e-6)
    assert all(a[2] == -FOOT_M for a, _ in open_edges(triangles_of(other.pieces)))


def test_what_has_no_area_or_height_is_left_out_and_counted() -> None:
    line = Polygon([(0, 0), (5, 5), (10, 10)])
    shapes = [HOUSE, line, Polygon(), box(0, 0, 1e-4, 1e-4), HOUSE, HOUSE, HOUSE, None]
    built = build_buildings(a_city(shapes, [6.0, 6.0, 6.0, 6.0, 0.0, np.nan, -2.0, 6.0]))
    assert built.left_out == 7
    assert np.array_equal(triangles_of(built.pieces), triangles_of(build_buildings(a_city([HOUSE], [6.0])).pieces))
    nothing = build_buildings(a_city([], []))
    assert nothing.pieces == ()
    assert nothing.left_out == 0


def test_slivers_and_footprints_that_cross_themselves_are_built_too() -> None:
    sliver, bow = box(0, 0, 20, 0.02), Polygon([(30, 0), (36, 6), (36, 0), (30, 6)])
    built = build_buildings(a_city([sliver, bow], [5.0, 5.0]))
    assert built.left_out == 0
    corners = triangles_of(built.pieces)
    assert np.isfinite(corners).all()
    assert volume(corners) == pytest.approx((0.4 + 18) * (5 + FOOT_M), rel=0.35)
    walls = triangles_of(built.pieces, "walls")
    assert walls[:, :, 2].min() == pytest.approx(-FOOT_M)
    assert all(a[2] == pytest.approx(-FOOT_M) for a, _ in open_edges(corners[corners[:, :, 0].max(axis=1) < 25]))


def test_numbers_are_small_near_each_cell_and_pieces_know_no_order() -> None:
    rng = np.random.default_rng(2)
    shapes = [box(x, y, x + 9, y + 7) for x, y in rng.uniform(-9000, 9000, (60, 2))]
    heights = rng.uniform(3, 20, 60)
    built = build_buildings(a_city(shapes, heights.tolist(), ground_m=0.0))
    assert len({p.name for p in built.pieces}) == len(built.pieces)
    for piece in built.pieces:
        assert np.abs(piece.mesh.xyz_m).max() < CELL_M
        assert len(piece.mesh.triangle)
    order = rng.permutation(60)
    other = build_buildings(a_city([shapes[i] for i in order], heights[order].tolist()))
    assert [p.name for p in other.pieces] == [p.name for p in built.pieces]
    for a, b in zip(built.pieces, other.pieces, strict=True):
        assert np.allclose(np.sort(a.mesh.xyz_m, axis=0), np.sort(b.mesh.xyz_m, axis=0), atol=1e-5)


def test_the_ground_lies_where_the_origin_says() -> None:
    built = build_buildings(a_city([box(0, 0, 4, 3)], [3.0], ground_m=120.0))
    z = triangles_of(built.pieces)[:, :, 2]
    assert (z.min(), z.max()) == (pytest.approx(-120 - FOOT_M), pytest.approx(-117))


def test_corners_are_shared_and_no_triangle_is_empty() -> None:
    built = build_buildings(a_city([COURT], [9.0]))
    walls = next(p.mesh for p in built.pieces if p.name.startswith("walls"))
    assert len(walls.xyz_m) == 4 * 8
    assert len(walls.triangle) == 2 * 8
    for piece in built.pieces:
        corners = piece.mesh.xyz_m.astype(np.float64)[piece.mesh.triangle]
        assert (
            np.linalg.norm(np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]), axis=1) > 0
        ).all()
        assert (piece.mesh.tint == 255).all()
        assert piece.mesh.xyz_m.dtype == np.float32
        assert piece.mesh.triangle.dtype == np.uint32


def test_walls_texture_is_upright_and_starts_on_the_ground() -> None:
    built = build_buildings(a_city([HOUSE], [6.0]))
    mesh = next(p.mesh for p in built.pieces if p.name.startswith("walls"))
    np.testing.assert_allclose(mesh.uv[:, 1], -mesh.xyz_m[:, 2], atol=1e-6)
    assert sorted(set(np.round(mesh.uv[:, 0], 4).tolist())) == [0, 3, 6, 9]
