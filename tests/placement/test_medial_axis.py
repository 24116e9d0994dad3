import numpy as np
import pytest
import shapely
from shapely import affinity

from tests.reference.medial_axis import voronoi_axis
from urbanforest_cli.placement.medial_axis import medial_axes

STRIP = shapely.box(0, 0, 200, 12)
L_SHAPE = shapely.Polygon([(0, 0), (40, 0), (40, 12), (12, 12), (12, 40), (0, 40)])
T_SHAPE = shapely.Polygon([(0, 0), (60, 0), (60, 10), (35, 10), (35, 50), (25, 50), (25, 10), (0, 10)])
ANNULUS = shapely.Point(0, 0).buffer(20, quad_segs=32).difference(shapely.Point(0, 0).buffer(10, quad_segs=32))


def axes(*polygons, **options):
    return medial_axes(np.array(polygons, dtype=object), **options)


def chain(found, number):
    return found.xy[found.chain_offsets[number] : found.chain_offsets[number + 1]]


def as_lines(found):
    chains = [chain(found, c) for c in range(len(found.chain_part))]
    return shapely.multilinestrings([shapely.linestrings(c) for c in chains if len(c) > 1])


def blob(seed, hole):
    rng = np.random.default_rng(seed)
    t = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    r = 20 + sum(rng.uniform(1, 4) * np.sin(k * t + rng.uniform(0, 6)) for k in (2, 3, 5))
    outer = shapely.Polygon(np.column_stack([r * np.cos(t), r * np.sin(t)]))
    return outer.difference(shapely.Point(rng.uniform(-4, 4, 2)).buffer(rng.uniform(1, 4))) if hole else outer


def trembling(polygons, size_m=1e-7):
    """Move corners as reprojection does, those at one place alike."""
    return shapely.transform(polygons, lambda xy: xy + size_m * np.sin(1e5 * xy + 3e4 * xy[:, ::-1]))


@pytest.mark.parametrize("step_m", [2.0, 1.0, 0.5, 0.25])
def test_whole_axis_of_a_rectangle_has_the_length_known_by_hand(step_m):
    found = axes(shapely.box(0, 0, 40, 20), step_m=step_m, corner_factor=0, branch_factor=0)
    assert found.lengths_m() == pytest.approx([20 + 40 * np.sqrt(2)], abs=1e-4)


@pytest.mark.parametrize("turn_deg", [0, 17, 45, 88.3])
def test_axis_of_a_strip_ends_where_its_last_circle_touches_the_end(turn_deg):
    found = axes(affinity.rotate(STRIP, turn_deg, origin=(0, 0)))
    back = affinity.rotate(as_lines(found), -turn_deg, origin=(0, 0))
    assert found.lengths_m() == pytest.approx([188.0], abs=1e-4)
    assert back.bounds == pytest.approx((6, 6, 194, 6), abs=1e-4)


@pytest.mark.parametrize("width_m", [0.1, 0.5, 1.0, 2.5, 7.3])
def test_narrow_strips_have_their_middle_line(width_m):
    found = axes(affinity.rotate(shapely.box(0, 0, 60, width_m), 31, origin=(0, 0)))
    assert found.lengths_m() == pytest.approx([60 - width_m], abs=1e-3)
    assert found.radius_m == pytest.approx(width_m / 2, abs=1e-6)


def test_radius_is_the_distance_to_the_edge():
    polygons = np.array([blob(seed, seed % 2) for seed in range(6)], dtype=object)
    found = medial_axes(polygons)
    owner = np.repeat(found.chain_site, np.diff(found.chain_offsets))
    apart = shapely.distance(shapely.points(found.xy), shapely.boundary(polygons)[owner])
    assert found.radius_m == pytest.approx(apart, abs=0.03)
    assert np.median(np.abs(found.radius_m - apart)) < 1e-6


@pytest.mark.parametrize("seed", range(8))
def test_axis_lies_on_the_voronoi_edges_of_dense_samples(seed):
    polygon = blob(seed, seed % 2)
    reference = shapely.multilinestrings(list(shapely.linestrings(voronoi_axis(polygon, 0.1))))
    apart = shapely.distance(shapely.points(axes(polygon).xy), reference)
    dense = shapely.get_coordinates(shapely.segmentize(as_lines(axes(polygon)), 0.2))
    assert shapely.distance(shapely.points(dense), reference).max() < 0.1
    assert apart.max() < 0.03
    assert np.median(apart) < 1e-3


def test_slow_twin_grows_toward_the_kernel_s_length():
    lot = shapely.Polygon([(0, 0), (30, 2), (33, 17), (14, 24), (-3, 15)])
    whole = axes(lot, corner_factor=0, branch_factor=0).lengths_m()[0]
    short = [whole - np.hypot(*np.diff(voronoi_axis(lot, step), axis=1)[:, 0].T).sum() for step in (1.0, 0.5, 0.25)]
    assert all(0 < s < 4.5 * step for s, step in zip(short, (1.0, 0.5, 0.25), strict=True))
    assert short[2] < 0.4 * short[0]


def test_l_shape_is_one_chain_and_t_shape_two():
    found = axes(L_SHAPE, T_SHAPE)
    assert found.chain_site.tolist() == [0, 1, 1]
    longest, rest = chain(found, 1), chain(found, 2)
    # the stem and one half of the bar are 65 m, the other half 25 m
    assert longest[[0, -1]] == pytest.approx(np.array([[5, 5], [30, 45]]), abs=1e-3)
    assert rest[-1] == pytest.approx([55, 5], abs=1e-3)
    assert shapely.distance(shapely.linestrings(longest), shapely.points(rest[0])) < 1e-6


def test_squares_discs_and_pentagons_have_their_centre_alone():
    pentagon = shapely.Point(50, 50).buffer(9, quad_segs=2)
    found = axes(shapely.box(0, 0, 20, 20), shapely.Point(7, 3).buffer(10), pentagon)
    assert found.lengths_m() == pytest.approx([0, 0, 0], abs=1e-3)
    assert found.xy[found.chain_offsets[:-1]] == pytest.approx(np.array([[10, 10], [7, 3], [50, 50]]), abs=1e-3)


def test_axis_of_a_ring_is_a_closed_chain_cut_at_one_place_whatever_vertex_comes_first():
    rings = [np.roll(np.asarray(r.coords)[:-1], 37, axis=0) for r in (ANNULUS.exterior, *ANNULUS.interiors)]
    rolled = shapely.Polygon(rings[0], rings[1:])
    found = axes(ANNULUS, rolled, shapely.reverse(ANNULUS))
    assert found.chain_closed.tolist() == [True] * 3
    assert found.lengths_m() == pytest.approx([2 * np.pi * 15] * 3, rel=2e-3)
    for number in range(3):
        assert chain(found, number)[0] == pytest.approx(chain(found, number)[-1])
        assert chain(found, number)[0] == pytest.approx(chain(found, 0)[0], abs=1e-3)


def test_streets_round_four_blocks_make_loops_and_lose_only_seams():
    blocks = [shapely.box(x, y, x + 40, y + 40) for x in (5, 55) for y in (5, 55)]
    found = axes(shapely.box(-5, -5, 105, 105).difference(shapely.union_all(blocks)))
    assert 6 * 100 - 4 * 10 < found.lengths_m()[0] < 6 * 100
    assert not found.chain_closed.any()


def test_parts_are_axes_of_their_own_and_their_order_does_not_matter():
    parts = [shapely.box(0, 0, 50, 4), shapely.box(0, 11, 50, 15), shapely.box(100, 0, 130, 6)]
    found = axes(shapely.MultiPolygon(parts), shapely.MultiPolygon(parts[::-1]))
    assert found.lengths_m() == pytest.approx([46 + 46 + 24] * 2, abs=1e-3)
    half = len(found.xy) // 2
    assert np.array_equal(found.xy[:half], found.xy[half:])
    assert found.chain_part.tolist() == [0, 1, 2, 3, 4, 5]


def test_a_polygon_s_axis_is_the_same_alone_and_in_any_batch():
    polygons = [blob(seed, seed % 2) for seed in range(5)]
    together = axes(*polygons)
    for number, polygon in enumerate(polygons):
        alone = axes(polygon)
        nodes = np.repeat(together.chain_site, np.diff(together.chain_offsets)) == number
        assert np.array_equal(together.xy[nodes], alone.xy)


@pytest.mark.parametrize("offset", [(0.0, 0.0), (500_000.3, 5_300_000.7)])
def test_noise_of_a_reprojection_moves_no_node_by_a_millimetre(offset):
    shapes = [STRIP, L_SHAPE, T_SHAPE, ANNULUS, *(blob(s, s % 2) for s in range(20))]
    polygons = shapely.transform(np.array(shapes, dtype=object), lambda xy: xy + offset)
    before, after = medial_axes(polygons), medial_axes(trembling(polygons))
    assert after.lengths_m() == pytest.approx(before.lengths_m(), abs=1e-3)
    assert shapely.hausdorff_distance(as_lines(before), as_lines(after)) < 1e-3


def test_collinear_and_doubled_corners_change_nothing():
    dense = shapely.segmentize(STRIP, 7.3)
    doubled = shapely.Polygon(np.repeat(np.asarray(STRIP.exterior.coords), 2, axis=0))
    found = axes(STRIP, dense, doubled)
    assert found.lengths_m() == pytest.approx([188.0] * 3, abs=1e-4)


@pytest.mark.parametrize(
    "geometry",
    [
        None,
        shapely.Polygon(),
        shapely.MultiPolygon(),
        shapely.Point(1, 1),
        shapely.LineString([(0, 0), (5, 5)]),
        shapely.Polygon([(0, 0), (10, 0), (5, 0)]),
        shapely.Polygon([(0, 0), (1e-9, 0), (0, 1e-9)]),
        shapely.box(0, 0, 100, 0.005),
    ],
    ids=["missing", "empty", "empty_multi", "point", "line", "flat", "tiny", "sliver"],
)
def test_what_has_no_width_has_no_axis(geometry):
    found = axes(STRIP, geometry, STRIP)
    assert found.chain_site.tolist() == [0, 2]
    assert not found.failed.any()


def test_crossed_rings_have_an_axis_too_and_harm_no_neighbour():
    turn = 4 * np.pi * np.arange(5) / 5
    star = shapely.Polygon(30 * np.column_stack([np.cos(turn), np.sin(turn)]))
    found = axes(STRIP, star, STRIP)
    assert not found.failed.any()
    assert found.lengths_m() == pytest.approx([188, 5 * 30, 188], abs=1)
    assert (np.diff(found.chain_part) >= 0).all()
    assert np.array_equal(chain(found, 0), chain(found, len(found.chain_part) - 1))


@pytest.mark.parametrize("first", range(6))
def test_spikes_without_width_are_not_there(first):
    outline = [(0, 0), (200, 0), (200, 6), (260, 40), (200, 6), (200, 12), (0, 12)]
    found = axes(shapely.Polygon(outline[first:] + outline[:first]))
    assert found.lengths_m() == pytest.approx([188], abs=1e-3)


def test_needles_and_pinched_corners_do_not_stop_the_axis():
    needle = shapely.union(STRIP, shapely.Polygon([(200, 6), (260, 6.0), (200, 6.004)]))
    pinched = shapely.Polygon([(0, 0), (80, 0), (80, 30), (40, 0.002), (0, 30)])
    found = axes(needle, pinched)
    assert not found.failed.any()
    assert found.lengths_m()[0] > 187
    assert found.lengths_m()[1] > 30


def test_polygons_out_of_geometry_collections_count():
    collection = shapely.GeometryCollection([shapely.MultiPolygon([STRIP]), shapely.Point(3, 3)])
    assert axes(collection).lengths_m() == pytest.approx([188], abs=1e-3)
