import numpy as np
import pytest
import shapely
from shapely import Polygon, affinity, box

from urbanforest_cli.export.scene.pieces import doubled_area
from urbanforest_cli.export.scene.roofs import (
    BAY_M,
    PARAPET_RISE_M,
    PITCH,
    RISE_MAX_M,
    flat_roofs,
    may_be_pitched,
    pitched_roofs,
    stretched,
)
from urbanforest_cli.export.scene.roofs_kernel import pitch_roofs

NO_GABLES, ALL_GABLES = 0.0, 100.0
SHAPES = {
    "rectangle": box(0, 0, 10, 6),
    "square": box(0, 0, 8, 8),
    "triangle": Polygon([(0, 0), (9, 1), (3, 7)]),
    "crooked": Polygon([(0, 0), (10, 0.3), (9.6, 6.4), (0.4, 6)]),
    "hexagon": Polygon([(5 * np.cos(a), 5 * np.sin(a)) for a in np.arange(6) * np.pi / 3]),
    "L with equal arms": Polygon([(0, 0), (12, 0), (12, 5), (5, 5), (5, 12), (0, 12)]),
    "L with unequal arms": Polygon([(0, 0), (12, 0), (12, 4), (6, 4), (6, 11), (0, 11)]),
    "T": Polygon([(0, 0), (12, 0), (12, 4), (8, 4), (8, 10), (4, 10), (4, 4), (0, 4)]),
    "U": Polygon([(0, 0), (12, 0), (12, 10), (8, 10), (8, 4), (4, 4), (4, 10), (0, 10)]),
    "Z": Polygon([(0, 0), (8, 0), (8, 4), (14, 4), (14, 9), (5, 9), (5, 5), (0, 5)]),
    "cross": shapely.union(box(4, 0, 8, 12), box(0, 4, 12, 8)),
    "a needle's eye": Polygon([(0, 0), (12, 0), (12, 6), (6.01, 6), (6, 0.5), (5.99, 6), (0, 6)]),
    "an almost straight corner": Polygon([(0, 0), (5, 1e-5), (10, 0), (10, 6), (0, 6)]),
}  # fmt: skip


def outlines(polygons: list[Polygon]) -> tuple[np.ndarray, np.ndarray]:
    rings = [shapely.get_coordinates(shapely.orient_polygons(p).exterior)[:-1] for p in polygons]
    return np.vstack(rings), np.append(0, np.cumsum([len(ring) for ring in rings]))


def random_polygons(count: int) -> list[Polygon]:
    """Unions of rectangles on a grid, straight and turned, stars, and convex ones: up to twelve corners."""
    rng = np.random.default_rng(7)
    found: list[Polygon] = []
    while len(found) < count:
        if len(found) % 2:
            size = rng.integers(2, 4)
            west, south = rng.integers(0, 12, (2, size))
            wide, deep = rng.integers(3, 10, (2, size))
            shape = shapely.union_all(shapely.box(west, south, west + wide, south + deep))
            shape = affinity.rotate(shape, 0 if len(found) % 4 == 1 else 33.3)
        else:
            angle = np.sort(rng.random(rng.integers(3, 13))) * 2 * np.pi
            reach = rng.uniform(2, 8, len(angle))
            shape = Polygon(np.column_stack([reach * np.cos(angle), reach * np.sin(angle)]))
            shape = shape.convex_hull if len(found) % 4 == 0 else shape
        if shape.geom_type == "Polygon" and shape.is_valid and not shape.interiors and shape.area > 3:
            shape = shapely.simplify(shape, 1e-4)
            if len(shape.exterior.coords) <= 13:
                found.append(shape)
    return found


def check_roof(polygon: Polygon, corners: np.ndarray, edge: np.ndarray, outline: np.ndarray) -> None:
    """Faces cover the polygon exactly and once, and each lies on the plane of its edge."""
    flat = shapely.polygons(corners[:, :, :2])
    signed = doubled_area(corners[:, :, :2]) / 2
    assert (signed > 0).all()
    assert signed.sum() == pytest.approx(polygon.area, rel=1e-6)
    assert shapely.union_all(flat).symmetric_difference(polygon).area < 1e-6 * polygon.area
    assert shapely.covers(polygon.buffer(1e-6), flat).all()
    start, end = outline[edge], outline[(edge + 1) % len(outline)]
    along = (end - start) / np.linalg.norm(end - start, axis=1, keepdims=True)
    inward = np.column_stack([-along[:, 1], along[:, 0]])
    away = ((corners[:, :, :2] - start[:, None]) * inward[:, None]).sum(axis=2)
    np.testing.assert_allclose(away, corners[:, :, 2], atol=2e-5)


def open_edges(corners: np.ndarray) -> list[tuple[tuple[float, ...], tuple[float, ...]]]:
    """Edges of triangles that no other triangle runs along the other way."""
    points = [[tuple(np.round(corner, 6) + 0.0) for corner in triangle] for triangle in corners]
    edges = [(t[k], t[(k + 1) % 3]) for t in points for k in range(3)]
    assert len(edges) == len(set(edges))
    there = set(edges)
    return [(a, b) for a, b in edges if (b, a) not in there]


@pytest.mark.parametrize("gable_width", [NO_GABLES, ALL_GABLES])
@pytest.mark.parametrize("name", SHAPES)
def test_roofs_cover_their_footprint_exactly_and_faces_are_flat(name, gable_width) -> None:
    xy, first = outlines([SHAPES[name]])
    corners, edge, _, done = pitch_roofs(xy, first, gable_width)
    assert done.all()
    check_roof(SHAPES[name], corners, edge, xy)


@pytest.mark.parametrize("gable_width", [NO_GABLES, ALL_GABLES])
def test_random_footprints_get_roofs_without_gaps(gable_width) -> None:
    polygons = random_polygons(240)
    xy, first = outlines(polygons)
    corners, edge, peak, done = pitch_roofs(xy, first, gable_width)
    assert done.mean() > 0.99
    assert (peak[:, 2] > 0).any() == (gable_width > 0)
    of = np.searchsorted(first, edge, side="right") - 1
    for p in np.flatnonzero(done):
        mine = of == p
        ring = xy[first[p] : first[p + 1]]
        check_roof(polygons[p], corners[mine], edge[mine] - first[p], ring)
        rim = open_edges(corners[mine])
        assert len(rim) == len(ring) + (peak[first[p] : first[p + 1], 2] > 0).sum()  # two slopes on a gable's wall
        assert shapely.distance(polygons[p].boundary, shapely.points([a[:2] for a, _ in rim])).max() < 1e-5


def test_a_hip_roof_by_hand() -> None:
    """Ten by six metres: the ridge is four metres long, three metres in from all walls."""
    xy, first = outlines([box(0, 0, 10, 6)])
    corners, _, peak, _ = pitch_roofs(xy, first, NO_GABLES)
    nodes = np.unique(np.round(corners.reshape(-1, 3), 9), axis=0)
    assert nodes[nodes[:, 2] > 0].tolist() == [[3, 3, 3], [7, 3, 3]]
    assert len(corners) == 6
    assert (peak == 0).all()


def test_a_gable_roof_by_hand() -> None:
    """The ridge runs from wall to wall over the middle of the short ones."""
    pitched = pitched_roofs(*outlines([box(0, 0, 10, 6)]))
    corners = pitched.triangles.corners
    nodes = np.unique(np.round(corners.reshape(-1, 3), 9), axis=0)
    np.testing.assert_allclose(nodes[nodes[:, 2] > 0], [[0, 3, 3 * PITCH], [10, 3, 3 * PITCH]])
    under = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])[:, 2] / 2 * corners[:, :, 2].mean(1)
    assert under.sum() == pytest.approx(10 * 6 * 3 * PITCH / 2)
    assert sorted(map(tuple, np.round(pitched.peak[pitched.peak[:, 2] > 0], 9).tolist())) == [
        (0.0, 3.0, round(3 * PITCH, 9)), (10.0, 3.0, round(3 * PITCH, 9)),
    ]  # fmt: skip


def test_wide_ends_are_hips_and_wide_roofs_less_steep() -> None:
    pitched = pitched_roofs(*outlines([box(0, 0, 24, 20)]))
    assert (pitched.peak[:, 2] == 0).all()
    assert pitched.triangles.corners[:, :, 2].max() == pytest.approx(RISE_MAX_M)


def test_normals_are_those_of_the_faces_and_look_up() -> None:
    pitched = pitched_roofs(*outlines(list(SHAPES.values())))
    corners, normal = pitched.triangles.corners, pitched.triangles.normal
    across = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    size = np.linalg.norm(across, axis=1)
    whole = size > 1e-3
    np.testing.assert_allclose(across[whole] / size[whole, None], normal[whole], atol=1e-3)
    np.testing.assert_allclose(np.linalg.norm(normal, axis=1), 1.0)
    assert (normal[:, 2] > 0.5).all()


def test_texture_lies_on_roofs_without_stretching() -> None:
    triangles = pitched_roofs(*outlines([SHAPES["L with unequal arms"], SHAPES["crooked"]])).triangles
    for a, b in ((0, 1), (1, 2), (2, 0)):
        there = np.linalg.norm(triangles.corners[:, a] - triangles.corners[:, b], axis=1)
        on_texture = np.linalg.norm(triangles.uv[:, a] - triangles.uv[:, b], axis=1)
        np.testing.assert_allclose(on_texture, there, atol=1e-5)


def test_footprints_that_cross_themselves_get_no_roof_and_leave_no_triangles() -> None:
    bow = np.array([(0.0, 0.0), (6.0, 6.0), (6.0, 0.0), (0.0, 7.0)])
    good, _ = outlines([box(0, 0, 10, 6)])
    corners, edge, peak, done = pitch_roofs(np.vstack([bow, good]), np.array([0, 4, 8]), ALL_GABLES)
    assert done.tolist() == [False, True]
    assert (edge >= 4).all()
    assert len(corners) == 4
    assert (peak[:4] == 0).all()


def test_which_roof_hangs_on_size_height_and_corners() -> None:
    cases = {
        (100, 7, 4, False): True,
        (100, 7, 12, False): True,
        (100, 7, 13, False): False,
        (100, 7, 8, True): False,
        (400, 7, 4, False): False,
        (200, 13, 4, False): False,
        (20, 2.5, 4, False): False,  # a shed
        (20, 5, 4, False): True,
        (16, 8, 4, False): False,  # a tower
        (9, 3, 4, False): False,
    }
    area, height, corners, hole = (np.array(column) for column in zip(*cases, strict=True))
    assert may_be_pitched(area, height, corners, hole).tolist() == list(cases.values())


def test_a_parapet_stands_round_the_deck_of_a_large_building_and_its_court() -> None:
    court = shapely.difference(box(0, 0, 40, 30), box(15, 10, 25, 20))
    shapes = np.array([shapely.orient_polygons(court), box(100, 0, 106, 6), box(200, 0, 203, 60)], dtype=object)
    triangles, of, has = flat_roofs(shapes, np.array([9.0, 9.0, 9.0]))
    assert has.tolist() == [True, False, True]
    corners = triangles.corners
    level = triangles.normal[:, 2] == 1
    across = doubled_area(corners[:, :, :2]) / 2
    for row, shape in enumerate(shapes):
        assert across[level & (of == row)].sum() == pytest.approx(shape.area, rel=1e-9)
    assert (across[level] > 0).all()
    assert np.unique(corners[of == 0][:, :, 2]).tolist() == [9.0, 9.0 + PARAPET_RISE_M]
    assert (corners[of == 1][:, :, 2] == 9).all()
    rim = open_edges(corners[of == 0])
    assert len(rim) == 8
    assert all(a[2] == b[2] == pytest.approx(9 + PARAPET_RISE_M) for a, b in rim)


def test_walls_show_whole_bays() -> None:
    assert stretched(np.array([0.4, 2.0, 6.8, 7.6])).tolist() == [0.2, BAY_M, 2 * BAY_M, 3 * BAY_M]


def test_no_footprints_make_no_roofs() -> None:
    pitched = pitched_roofs(np.empty((0, 2)), np.zeros(1, np.int64))
    assert len(pitched.triangles) == 0
    triangles, of, has = flat_roofs(np.empty(0, dtype=object), np.empty(0))
    assert len(triangles) == len(of) == len(has) == 0
