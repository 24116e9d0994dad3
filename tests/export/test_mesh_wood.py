from dataclasses import replace
from functools import cache
from itertools import pairwise

import numpy as np
import pytest
import trimesh
from scipy.sparse import coo_matrix
from scipy.sparse.csgraph import connected_components

from tests.growth.scenes import HAZEL, MAPLE, OAK, scene
from tests.reference.wood import is_drawn, plant_of, tubes_of, wood_by_hand
from urbanforest_cli.core.skeleton import Skeletons, concatenate, select
from urbanforest_cli.export.mesh import wood
from urbanforest_cli.export.mesh.levels import BARK_TEXTURE_M, LEVELS, Level
from urbanforest_cli.export.mesh.wood import build_wood, inner_radius, outer_radius

DRAWN = ("full", "high", "medium", "low")
FULL = LEVELS["full"]
FIELDS = ("first_vertex", "first_triangle", "xyz_m", "normal", "uv", "tint", "triangle")
FOOT_M = -0.1
SLACK_M = 1e-5


@cache
def grown():
    """Return a maple, an oak and a hazel that grew apart."""
    place = scene([(0, 0), (25, 0), (50, 0), (75, 0)], species=[MAPLE, OAK, HAZEL, MAPLE], age=[11, 16, 9, 4])
    return place.grow().skeletons


def skeleton(nodes, *, tip_radius=0.01, exponent=2.0, number=1):
    """Return a skeleton of (parent, place, order) of each node after the root."""
    nodes = [(-1, (0.0, 0.0, 0.0), 0), *nodes]
    count = len(nodes)
    birth = [0]
    for parent, _, _ in nodes[1:]:
        birth.append(birth[parent] + 1)
    one = Skeletons(
        skeleton_id=np.array([number]),
        first=np.array([0, count]),
        seasons=np.array([max(birth)], np.int32),
        tip_radius_m=np.array([tip_radius]),
        pipe_exponent=np.array([exponent]),
        parent=np.array([node[0] for node in nodes], np.int32),
        xyz_m=np.array([node[1] for node in nodes], np.float32),
        order=np.array([node[2] for node in nodes], np.uint8),
        birth_season=np.array(birth, np.uint8),
        death_season=np.zeros(count, np.uint8),
    )
    one.check()
    return one


def row_of(places, **more):
    """Return a skeleton of one unbranched axis."""
    return skeleton([(i, place, 0) for i, place in enumerate(places)], **more)


def wood_of(one, level=FULL):
    return build_wood(one, one.seasons, level).mesh(0)


def faces(mesh):
    """Return (t, 3) normals of triangles, their length twice the area."""
    a, b, c = (mesh.xyz_m[mesh.triangle[:, k]].astype(np.float64) for k in range(3))
    return np.cross(b - a, c - a)


def welded(mesh):
    """Return places, and triangles whose corners at the same place are one."""
    places, corner = np.unique(mesh.xyz_m, axis=0, return_inverse=True)
    return places.astype(np.float64), corner.reshape(-1)[mesh.triangle.astype(np.int64)]


def tubes_in(places, triangle):
    """Return (v,) which tube each place belongs to."""
    ends = np.concatenate([triangle[:, :2], triangle[:, 1:]])
    return connected_components(coo_matrix((np.ones(len(ends)), ends.T), (len(places),) * 2), directed=False)[1]


def open_edges(triangle):
    """Return (e, 2) edges that no other triangle runs along the other way; all others are run along once each way."""
    edges = np.concatenate([triangle[:, [0, 1]], triangle[:, [1, 2]], triangle[:, [2, 0]]])
    number = int(triangle.max()) + 1
    forth, back = edges @ (number, 1), edges @ (1, number)
    assert len(np.unique(forth)) == len(forth)
    return edges[~np.isin(forth, back)]


def winding_number(points, corners):
    """Return how often triangles (t, 3, 3) wind around points: 1 inside what is closed, 0 outside."""
    total = np.zeros(len(points))
    for i, point in enumerate(points):
        a, b, c = np.moveaxis(corners - point, 1, 0)
        la, lb, lc = (np.linalg.norm(side, axis=1) for side in (a, b, c))
        volume = np.einsum("ij,ij->i", a, np.cross(b, c))
        dots = [np.einsum("ij,ij->i", x, y) * z for x, y, z in ((a, b, lc), (b, c, la), (c, a, lb))]
        total[i] = 2 * np.arctan2(volume, la * lb * lc + sum(dots)).sum() / (4 * np.pi)
    return total


def to_segments(points, start, end):
    """Return (p, s) distances of points from segments, and how far along they are nearest."""
    way = end - start
    t = np.einsum("psk,sk->ps", points[:, None] - start, way) / np.einsum("sk,sk->s", way, way)
    t = np.clip(t, 0, 1)
    return np.linalg.norm(points[:, None] - start - t[..., None] * way, axis=2), t


def segments_of(tubes):
    """Return starts and ends of all tubes' axes, and the radii at both."""
    pairs = [pair for tube in tubes for pair in pairwise(tube.rings)]
    return (np.array([[a.place, b.place] for a, b in pairs]).transpose(1, 0, 2),
            np.array([[a.radius, b.radius] for a, b in pairs]).T)  # fmt: skip


@pytest.mark.parametrize("name", DRAWN)
def test_kernels_agree_with_the_readable_reference_on_grown_plants(name):
    skeletons, level = grown(), LEVELS[name]
    meshes = build_wood(skeletons, skeletons.seasons, level)
    for number in range(len(skeletons)):
        slow = wood_by_hand(select(skeletons, [number]), int(skeletons.seasons[number]), level)
        fast = meshes.mesh(number)
        assert len(fast.triangle) > 0
        np.testing.assert_array_equal(fast.triangle, slow.triangle)
        np.testing.assert_array_equal(fast.tint, slow.tint)
        for field, error in (("xyz_m", 2e-6), ("normal", 1e-6), ("uv", 2e-6)):
            np.testing.assert_allclose(getattr(fast, field), getattr(slow, field), rtol=0, atol=error)


def test_an_earlier_season_agrees_with_the_reference_too():
    skeletons = grown()
    season = skeletons.seasons - 3
    meshes = build_wood(skeletons, season, FULL)
    for number in range(len(skeletons)):
        slow = wood_by_hand(select(skeletons, [number]), int(season[number]), FULL)
        np.testing.assert_array_equal(meshes.mesh(number).triangle, slow.triangle)
        np.testing.assert_allclose(meshes.mesh(number).xyz_m, slow.xyz_m, rtol=0, atol=2e-6)


def test_any_number_of_threads_and_parts_gives_the_same_bytes(monkeypatch):
    skeletons = concatenate([replace(grown(), skeleton_id=grown().skeleton_id + 10 * k) for k in range(5)])
    whole = build_wood(skeletons, skeletons.seasons, FULL)
    monkeypatch.setattr(wood, "NODES_A_PART", 300)
    for workers in (1, 2, 5):
        cut = build_wood(skeletons, skeletons.seasons, FULL, workers=workers)
        for field in FIELDS:
            assert getattr(cut, field).tobytes() == getattr(whole, field).tobytes(), field


def test_a_plant_looks_the_same_alone_and_among_others():
    skeletons = grown()
    together = build_wood(skeletons, skeletons.seasons, LEVELS["medium"])
    for number in range(len(skeletons)):
        alone = wood_of(select(skeletons, [number]), LEVELS["medium"])
        for field in ("xyz_m", "normal", "uv", "tint", "triangle"):
            np.testing.assert_array_equal(getattr(together.mesh(number), field), getattr(alone, field))


@pytest.mark.parametrize("name", DRAWN)
def test_no_triangle_is_inverted_or_without_area(name):
    skeletons = grown()
    meshes = build_wood(skeletons, skeletons.seasons, LEVELS[name])
    for number in range(len(skeletons)):
        mesh = meshes.mesh(number)
        normal = faces(mesh)
        area = np.linalg.norm(normal, axis=1) / 2
        assert area.min() > 1e-8
        corners = mesh.normal[mesh.triangle].astype(np.float64)
        assert np.einsum("tk,tck->tc", normal / area[:, None] / 2, corners).min() > 0.3
        np.testing.assert_allclose(np.linalg.norm(mesh.normal, axis=1), 1, atol=1e-6)


@pytest.mark.parametrize("name", DRAWN)
def test_each_tube_is_watertight_once_its_base_is_closed(name):
    skeletons = grown()
    for number in range(len(skeletons)):
        places, triangle = welded(wood_of(select(skeletons, [number]), LEVELS[name]))
        tube = tubes_in(places, triangle)[triangle[:, 0]]
        for which in np.unique(tube):
            mine = triangle[tube == which]
            base = open_edges(mine)
            if len(base):
                after = dict(base.tolist())
                loop = [int(base[0, 0])]
                while (following := after[loop[-1]]) != loop[0]:
                    loop.append(following)
                assert len(loop) == len(base)  # one ring, not several
                mine = np.concatenate([mine, [(loop[0], b, a) for a, b in pairwise(loop[1:])]])
            solid = trimesh.Trimesh(places, mine, process=False)
            assert solid.is_watertight
            assert solid.is_winding_consistent
            assert solid.volume > 0


@pytest.mark.parametrize("name", DRAWN)
def test_open_edges_lie_below_the_ground_or_inside_other_wood(name):
    skeletons, hidden = grown(), 0
    for number in (0, 2, 3):
        places, triangle = welded(wood_of(select(skeletons, [number]), LEVELS[name]))
        tube = tubes_in(places, triangle)
        rim = np.unique(open_edges(triangle))
        assert np.isin(tube, tube[rim]).any()
        above = rim[places[rim, 2] > FOOT_M + SLACK_M]
        for which in np.unique(tube[above])[:: 8 if name == "full" else 1]:
            others = places[triangle[tube[triangle[:, 0]] != which]]
            points = places[above[tube[above] == which]]
            assert winding_number(points, others).min() > 0.7
            hidden += len(points)
    assert hidden > 10


@pytest.mark.parametrize("name", DRAWN)
def test_corners_stand_at_their_radius_from_the_axis(name):
    level = LEVELS[name]
    widest = float(outer_radius(np.array([level.sides[0]]))[0])
    for number in (0, 2):
        one = select(grown(), [number])
        (start, end), radius = segments_of(tubes_of(plant_of(one, int(one.seasons[0])), level))
        points = wood_of(one, level).xyz_m[::3].astype(np.float64)
        away, t = to_segments(points, start, end)
        over = (away - widest * (radius[0] + t * (radius[1] - radius[0]))).min(axis=1)
        assert over.max() < 0.1 * level.wood_error_m


@pytest.mark.parametrize("name", DRAWN)
def test_what_is_left_out_lies_within_the_levels_error_of_what_is_drawn(name):
    level, left_out = LEVELS[name], 0
    for number in (0, 1, 2):
        plant = plant_of(select(grown(), [number]), int(grown().seasons[number]))
        tubes = tubes_of(plant, level)
        (start, end), _ = segments_of(tubes)
        nodes = [i for i in range(1, len(plant.parent)) if plant.stands[i] and is_drawn(plant, i, level)]
        away, _ = to_segments(np.array([plant.place(i) for i in nodes]), start, end)
        assert away.min(axis=1).max() <= level.wood_error_m + SLACK_M
        left_out += len(nodes) - sum(len(tube.rings) - 1 for tube in tubes)
    if name == "low":
        assert left_out > 0


def test_coarser_levels_have_fewer_triangles():
    skeletons = grown()
    counts = np.array(
        [np.diff(build_wood(skeletons, skeletons.seasons, LEVELS[name]).first_triangle) for name in DRAWN]
    )
    assert (np.diff(counts, axis=0) < 0).all()
    assert (counts[-1] > 0).all()


def test_nodes_are_drawn_half_way_to_the_middle_of_their_neighbours():
    mesh = wood_of(row_of([(0.2, 0, 1), (0.2, 0, 2), (0, 0, 3), (0, 0, 4)]), replace(FULL, sides=(6, 6)))
    rings = mesh.xyz_m[:-6].reshape(-1, 7, 3)[:, :-1].mean(axis=1)
    for place in ((0.15, 0, 1), (0.15, 0, 2), (0.05, 0, 3)):
        assert np.linalg.norm(rings - place, axis=1).min() < 1e-6


def test_a_straight_stem_has_the_volume_of_its_cones():
    level = replace(FULL, sides=(20, 20), wood_error_m=1e-4)
    one = row_of([(0, 0, z) for z in (1, 2, 3)], tip_radius=0.1)
    places, triangle = welded(wood_of(one, level))
    loop = np.unique(open_edges(triangle))
    assert (places[loop, 2] == np.float32(FOOT_M)).all()
    above = [z for z in np.unique(places[:, 2]) if z > 0.65]  # clear of the flare, whose height is 6 radii
    heights = [places[:, 2] == z for z in above]
    turn = float(outer_radius(np.array([20]))[0])
    radii = [np.linalg.norm(places[h, :2], axis=1).max() / turn for h in heights]
    assert radii == pytest.approx([0.1, 0.1, 0.0], abs=1e-7)
    polygon = 10 * np.sin(np.pi / 10) * turn**2
    cap = np.concatenate([triangle, [(loop[0], a, b) for a, b in zip(*_around(triangle, loop), strict=True)]])
    expected = polygon * _cones(_profile(places, turn))
    assert abs(trimesh.Trimesh(places, cap, process=False).volume) == pytest.approx(expected, rel=1e-5)
    assert polygon == pytest.approx(np.pi, rel=0.01)


def _around(triangle, loop):
    after = dict(open_edges(triangle).tolist())
    order = [after[int(loop[0])]]
    while after[order[-1]] != loop[0]:
        order.append(after[order[-1]])
    return order[1:], order[:-1]


def _profile(places, turn):
    for z in np.unique(places[:, 2]):
        yield z, np.linalg.norm(places[places[:, 2] == z, :2], axis=1).max() / turn


def _cones(profile):
    return sum((b - a) * (r * r + r * s + s * s) / 3 for (a, r), (b, s) in pairwise(profile))


def test_a_trunk_widens_at_the_ground_and_goes_on_below_it():
    mesh = wood_of(row_of([(0, 0, 0.3 * k) for k in range(1, 8)], tip_radius=0.15))
    reach = np.linalg.norm(mesh.xyz_m[:, :2], axis=1)
    at = {z: reach[np.abs(mesh.xyz_m[:, 2] - z) < 1e-5].max() for z in (FOOT_M, 0.0, 0.3, 1.5)}
    assert mesh.xyz_m[:, 2].min() == np.float32(FOOT_M)
    assert at[FOOT_M] == at[0.0] > 1.3 * at[0.3] > 1.3 * at[1.5]
    assert at[1.5] == pytest.approx(0.15, rel=0.02)
    assert mesh.tint[mesh.xyz_m[:, 2] < 0].max() < 220
    assert mesh.tint[mesh.xyz_m[:, 2] > 1].min() == 255


def test_all_stems_of_a_shrub_begin_below_the_ground():
    stems = [(0, (0.3 * np.cos(a), 0.3 * np.sin(a), 0.4), 0) for a in range(5)]
    tips = [(a + 1, (0.5 * np.cos(a), 0.5 * np.sin(a), 0.9), 0) for a in range(5)]
    side = [(a + 1, (0.4 * np.cos(a), 0.4 * np.sin(a), 0.5 + 0.1 * k), 1) for a in range(5) for k in range(a)]
    places, triangle = welded(wood_of(skeleton(stems + tips + side), replace(FULL, wood_radius_min_m=0.011)))
    rim = np.unique(open_edges(triangle))
    assert len(np.unique(tubes_in(places, triangle))) == 4  # that without side shoots is too thin
    assert (places[rim, 2] == np.float32(FOOT_M)).all()


def test_the_axis_is_one_tube_and_a_branch_another():
    trunk = [(k, (0, 0, 0.4 * (k + 1)), 0) for k in range(6)]
    branch = [(3, (0.3, 0, 1.5), 1), (7, (0.6, 0, 1.7), 1)]
    places, triangle = welded(wood_of(skeleton(trunk + branch)))
    tube = tubes_in(places, triangle)
    assert len(np.unique(tube)) == 2
    top, tip, foot = (int(np.argmin(np.linalg.norm(places - place, axis=1)))
                      for place in ((0, 0, 2.4), (0.6, 0, 1.7), (0, 0, -0.1)))  # fmt: skip
    assert tube[top] == tube[foot] != tube[tip]


def test_a_branch_goes_on_in_the_tube_of_an_axis_that_ended():
    trunk = [(k, (0, 0, 0.4 * (k + 1)), 0) for k in range(3)]
    leader = [(3, (0.2, 0, 1.5), 1), (4, (0.4, 0, 1.9), 1)]
    places, triangle = welded(wood_of(skeleton(trunk + leader)))
    assert len(np.unique(tubes_in(places, triangle))) == 1


def test_what_was_cut_off_ends_in_a_dome_and_what_it_bears_begins_closed():
    twigs = [(k, (0, 0, 0.3 * (k + 1)), 0) for k in range(4)]
    lost = [(4, (0.01 * k, 0, 1.4), 0) for k in range(40)]
    side = [(4, (0.2, 0, 1.3), 1), (45, (0.4, 0, 1.4), 1)]
    one = skeleton(twigs + lost + side)
    death = one.death_season.copy()
    death[5:45] = 5
    one = replace(one, death_season=death, seasons=np.array([6], np.int32))
    places, triangle = welded(wood_of(one))
    tube = tubes_in(places, triangle)
    stump = tube == tube[np.argmin(places[:, 2])]
    radius = 0.01 * np.sqrt(41)
    assert len(np.unique(tube)) == 2
    assert places[stump, 2].max() == pytest.approx(1.2 + 0.45 * radius, abs=1e-5)
    assert np.isin(np.unique(open_edges(triangle)), np.flatnonzero(stump)).all()


def test_thin_wood_is_left_out_and_what_bears_it_ends_in_a_point():
    level = Level("test", 0.012, 0.0005, (4, 8), "none", 0)
    trunk = [(k, (0, 0, 0.4 * (k + 1)), 0) for k in range(4)]
    forks = [(4, (0.3, 0, 1.9), 1), (4, (-0.3, 0, 1.9), 1), (4, (0, 0, 2.0), 0)]
    twigs = [(1, (0.3, 0.01 * k, 0.4), 1) for k in range(30)]
    mesh = wood_of(skeleton(trunk + forks + twigs), level)
    assert mesh.xyz_m[:, 2].max() == np.float32(1.6)
    assert (np.linalg.norm(mesh.xyz_m[mesh.xyz_m[:, 2] > 1.59, :2], axis=1) == 0).all()


def test_a_young_plant_keeps_its_axis_at_every_level():
    one = row_of([(0, 0, 0.2), (0, 0, 0.4)], tip_radius=0.004)
    assert all(wood_of(one, LEVELS[name]).xyz_m[:, 2].max() == np.float32(0.4) for name in DRAWN)


def test_bark_runs_in_whole_turns_around_and_in_metres_along():
    for radius, turns in ((0.02, 1), (0.25, 2), (0.5, 3)):
        mesh = wood_of(row_of([(0, 0, z) for z in (3, 6, 9)], tip_radius=radius), replace(FULL, sides=(8, 8)))
        ring = mesh.uv[:9]
        assert ring[:, 0] == pytest.approx(turns * np.arange(9) / 8)
        np.testing.assert_array_equal(mesh.xyz_m[0], mesh.xyz_m[8])  # the seam
        np.testing.assert_array_equal(mesh.normal[0], mesh.normal[8])
        assert mesh.uv[:, 1] == pytest.approx((mesh.xyz_m[:, 2] - FOOT_M) / BARK_TEXTURE_M, abs=1e-5)
        spread = mesh.uv[mesh.triangle, 0].max(axis=1) - mesh.uv[mesh.triangle, 0].min(axis=1)
        assert spread.max() <= turns / 8 + 1e-6


def test_a_branch_leaves_in_a_bow_and_thicker_than_it_goes_on():
    level = replace(FULL, sides=(8, 8))
    trunk = [(k, (0, 0, 0.5 * (k + 1)), 0) for k in range(6)]
    crown = [(6, (0.01 * k, 0, 3.4), 1) for k in range(60)]
    branch = [(3, (0.6, 0, 1.5), 1), (67, (1.2, 0, 1.5), 1), (68, (1.8, 0, 1.5), 1)]
    mesh = wood_of(skeleton(trunk + crown + branch), level)
    rings = mesh.xyz_m[-8 - 9 * 3 : -8].reshape(3, 9, 3)[:, :-1]
    middles = rings.mean(axis=1)
    girths = np.linalg.norm(rings - middles[:, None], axis=2).mean(axis=1)
    assert middles[0] == pytest.approx([0, 0, 1.5 - 0.6 * 0.075], abs=0.01)  # down in the trunk
    assert middles[1, 2] == pytest.approx(1.5, abs=1e-5)
    assert girths[0] > 1.4 * girths[1] > 1.5 * girths[2]


def test_rings_do_not_turn_about_an_axis_that_bends_in_a_plane():
    angle = np.linspace(0, 2.0, 12)[1:]
    mesh = wood_of(row_of(list(zip(2 - 2 * np.cos(angle), 0 * angle, 2 * np.sin(angle), strict=True))),
                   replace(FULL, sides=(6, 6)))  # fmt: skip
    rings = mesh.xyz_m[:-6].reshape(-1, 7, 3)
    beside = (rings[:, :, 1] - rings[:, :-1, 1].mean(axis=1)[:, None]) / np.ptp(rings[:, :, 1], axis=1)[:, None]
    np.testing.assert_allclose(beside, np.broadcast_to(beside[0], beside.shape), atol=1e-4)


def test_sides_follow_the_girth_and_rings_of_unlike_sides_are_joined():
    level = Level("test", 0.0, 0.004, (3, 16), "none", 0)
    trunk = [(k, (0, 0, 0.5 * (k + 1)), 0) for k in range(6)]
    twigs = [(k, (0.3 * np.cos(9 * j), 0.3 * np.sin(9 * j), 0.5 * k + 0.2), 1) for k in range(1, 6) for j in range(30)]
    mesh = wood_of(skeleton(trunk + twigs), level)
    places, triangle = welded(mesh)
    tube = tubes_in(places, triangle)
    trunk_places = places[tube == tube[np.argmin(places[:, 2])]]
    sides = np.array([(np.abs(trunk_places[:, 2] - z) < 1e-6).sum() for z in np.unique(trunk_places[:, 2])[:-1]])
    assert sides[0] > sides[-1]
    assert (np.diff(sides) <= 0).all()
    for n in np.unique(sides):
        radius = level.wood_error_m / (1 - inner_radius(np.array([n]))[0])
        assert 2 * level.wood_error_m < radius
    assert len(open_edges(triangle[tube[triangle[:, 0]] == tube[np.argmin(places[:, 2])]])) == sides[0]


@pytest.mark.parametrize("name", ["billboard", "point"])
def test_levels_that_are_drawn_by_other_means_have_no_wood(name):
    skeletons = grown()
    meshes = build_wood(skeletons, skeletons.seasons, LEVELS[name])
    assert len(meshes) == len(skeletons)
    assert len(meshes.triangle) == len(meshes.xyz_m) == 0


def test_what_does_not_stand_has_an_empty_mesh_between_others():
    one = row_of([(0, 0, 0.5), (0, 0, 1.0)])
    bare = skeleton([], number=2)
    dead = replace(one, skeleton_id=np.array([3]), death_season=np.full(3, 2, np.uint8))
    skeletons = concatenate([bare, one, dead, replace(one, skeleton_id=np.array([4]))])
    meshes = build_wood(skeletons, np.array([0, 2, 2, 0]), FULL)
    assert (np.diff(meshes.first_triangle) > 0).tolist() == [False, True, False, False]
    assert build_wood(select(skeletons, []), np.zeros(0, np.int32), FULL).first_vertex.tolist() == [0]


def scribble(seed):
    """Return a skeleton at random, its internodes of any length and direction, many in one place."""
    rng = np.random.default_rng(seed)
    count = 150
    nodes = [(-1, np.zeros(3), 0)]
    for i in range(1, count):
        p = int(rng.integers(max(0, i - 4), i))
        step = rng.choice([0.0, 1e-4, 0.05, 0.3]) * rng.normal(size=3) + rng.choice([0.0, 0.2]) * np.array([0, 0, 1.0])
        nodes.append((p, np.round(nodes[p][1] + step, 4), nodes[p][2] + int(rng.random() < 0.4)))
    nodes = [(p, tuple(map(float, place)), min(order, 250)) for p, place, order in nodes[1:]]
    return skeleton(nodes, tip_radius=float(rng.choice([0.003, 0.01, 0.05])))


@pytest.mark.parametrize("name", DRAWN)
def test_scribbles_agree_with_the_reference_and_are_finite(name):
    for seed in range(12):
        one = scribble(seed)
        mesh, slow = wood_of(one, LEVELS[name]), wood_by_hand(one, int(one.seasons[0]), LEVELS[name])
        np.testing.assert_array_equal(mesh.triangle, slow.triangle)
        np.testing.assert_allclose(mesh.xyz_m, slow.xyz_m, rtol=0, atol=1e-5)
        np.testing.assert_allclose(mesh.uv, slow.uv, rtol=0, atol=1e-5)
        np.testing.assert_allclose(np.linalg.norm(mesh.normal, axis=1), 1, atol=1e-5)


ODD = {
    "one internode": row_of([(0, 0, 0.3)]),
    "an internode of no length": row_of([(0, 0, 0.5), (0, 0, 0.5), (0, 0, 1.0), (0, 0, 1.0)]),
    "a root that did not grow": row_of([(0, 0, 0), (0, 0, 0)]),
    "all but at the root": row_of([(0, 0, 1e-6), (0, 1e-6, 0)]),
    "straight down": skeleton([(0, (0, 0, 1), 0), (1, (0, 0, 0.5), 1), (2, (0, 0, 0.2), 1), (1, (0, 0, 2), 0)]),
    "an axis that folds back": row_of([(0, 0, 1), (0, 0, 2), (0, 0, 1.2), (0, 0, 0.4)]),
    "a branch of no length": skeleton([(0, (0, 0, 1), 0), (1, (0, 0, 1), 1), (2, (0, 0.4, 1.1), 1), (1, (0, 0, 2), 0)]),
    "thick and short": row_of([(0, 0, 0.05), (0.02, 0, 0.1), (0, 0.02, 0.15)], tip_radius=0.4),
    "thick and crooked": row_of([(0, 0, 0.3), (0.3, 0, 0.4), (0.3, 0.3, 0.5), (0, 0.3, 0.8)], tip_radius=0.25),
    "lying": row_of([(0.5, 0, 0), (1.0, 0, 0), (1.5, 0.1, 0)]),
    "twins": skeleton([(0, (0, 0, 1), 0), (1, (0.1, 0, 2), 0), (1, (0.1, 0, 2), 0), (2, (0.1, 0, 3), 0)]),
}


@pytest.mark.parametrize("name", DRAWN)
@pytest.mark.parametrize("what", ODD)
def test_odd_skeletons_give_sound_tubes(what, name):
    one = ODD[what]
    mesh = wood_of(one, LEVELS[name])
    slow = wood_by_hand(one, int(one.seasons[0]), LEVELS[name])
    np.testing.assert_array_equal(mesh.triangle, slow.triangle)
    for field in ("xyz_m", "normal", "uv"):
        assert np.isfinite(getattr(mesh, field)).all()
    if len(mesh.triangle) == 0:
        assert np.linalg.norm(one.xyz_m, axis=1).max() < 1e-3
        return
    normal = faces(mesh)
    area = np.linalg.norm(normal, axis=1) / 2
    assert area.min() > 1e-10
    mean = mesh.normal[mesh.triangle].mean(axis=1)
    assert np.einsum("tk,tk->t", normal, mean).min() > 0
    places, triangle = welded(mesh)
    rim = np.unique(open_edges(triangle))
    assert (places[rim, 2] < 0).sum() > 0
