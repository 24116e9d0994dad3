from dataclasses import replace

import numpy as np
import pytest

from tests.reference.leaves import light_of_cells, twigs_of_cards
from urbanforest_cli.core.skeleton import Skeletons, concatenate, no_skeletons, quantise, select
from urbanforest_cli.export.mesh import leaf_kernel, twig_kernel
from urbanforest_cli.export.mesh.leaf_shapes import CLUMP_CELLS, FLOWER_CELLS, LEAF_CELLS, SPRAY_CELLS
from urbanforest_cli.export.mesh.leaves import COVER, build_leaves, find_twigs, texture_rgb, tint_factors
from urbanforest_cli.export.mesh.levels import Level
from urbanforest_cli.export.plant_light_kernel import scatter_leaves
from urbanforest_cli.export.plant_looks import LOOKS, SEASONS, in_season
from urbanforest_cli.export.plant_scene import Look, Standing, build_wood, linear
from urbanforest_cli.export.plant_scene import build_leaves as leaves_of_pictures

LOOK = Look(leaf=(0.25, 0.4, 0.15), leaf_young=(0.4, 0.55, 0.2), bark=(0.4, 0.36, 0.32), leaf_area_index=4.0)
MODES = {
    "full": ("leaf", 60_000),
    "high": ("spray", 6_000),
    "medium": ("spray", 1_400),
    "low": ("clump", 160),
}
LEVELS = {name: Level(name, 0.0, 0.002, (3, 8), mode, cards) for name, (mode, cards) in MODES.items()}
CELLS = {"leaf": (*LEAF_CELLS, *FLOWER_CELLS), "spray": SPRAY_CELLS, "clump": CLUMP_CELLS}


def tree(number=1, seasons=18):
    """Return a skeleton that forks at every third node of its branches, as files hold it."""
    parent, xyz, order, birth = [-1], [np.zeros(3)], [0], [0]
    tips = [(0, np.array([0.0, 0.0, 1.0]), 0)]
    for season in range(1, seasons + 1):
        grown = []
        for node, ahead, level in tips:
            length = 0.45 if level == 0 else 0.3
            parent.append(node)
            xyz.append(xyz[node] + length * ahead)
            order.append(level)
            birth.append(season)
            new = len(parent) - 1
            grown.append((new, ahead, level))
            if season % 3 == 0:
                for sign in (1, -1):
                    turn = 2.4 * (new + 0.7 * number) + sign
                    across = np.array([np.cos(turn), np.sin(turn), 0.3])
                    out = 0.8 * ahead + 0.7 * across
                    grown.append((new, out / np.linalg.norm(out), level + 1))
        tips = grown
    count = len(parent)
    return quantise(
        Skeletons(
            skeleton_id=np.array([number]),
            first=np.array([0, count]),
            seasons=np.array([seasons], np.int32),
            tip_radius_m=np.array([0.002]),
            pipe_exponent=np.array([2.2]),
            parent=np.array(parent, np.int32),
            xyz_m=np.array(xyz, np.float32),
            order=np.array(order, np.uint8),
            birth_season=np.array(birth, np.uint8),
            death_season=np.zeros(count, np.uint8),
        )
    )


@pytest.fixture(scope="module")
def oak():
    return tree(7)


@pytest.fixture(scope="module")
def built(oak):
    return {name: build_leaves(oak, oak.seasons, [LOOK], level) for name, level in LEVELS.items()}


def sides_of(meshes):
    corners = meshes.xyz_m.reshape(-1, 4, 3)
    return corners[:, 1] - corners[:, 0], corners[:, 3] - corners[:, 0]


def leaf_area(meshes, mode):
    along, across = sides_of(meshes)
    return COVER[mode] * np.sum(np.linalg.norm(along, axis=1) * np.linalg.norm(across, axis=1))


def one_plant(tips, area_m2):
    tips = np.asarray(tips, np.float32)
    count = len(tips)
    return twig_kernel.Twigs(
        np.array([0, count]),
        tips,
        tips,
        np.asarray(area_m2, np.float32),
        np.arange(count, dtype=np.int32),
        tips.mean(axis=0, dtype=np.float64)[None],
    )


def test_leaves_sit_on_the_twigs_of_pictures_and_have_their_area(oak):
    ends = np.array([oak.seasons[0], 11])
    both = concatenate([oak, tree(9)])
    twigs = find_twigs(both, ends, np.full(2, LOOK.leaf_area_index))
    _, seen = build_wood(Standing(both, np.zeros((2, 2)), [LOOK, LOOK], ends))
    assert len(seen.tip) > 1000
    np.testing.assert_array_equal(np.diff(twigs.first), np.bincount(seen.plant))
    np.testing.assert_allclose(twigs.tip, seen.tip, atol=1e-5)
    np.testing.assert_allclose(twigs.base, seen.base, atol=1e-5)
    np.testing.assert_array_equal(twigs.node, seen.key & np.uint64(0xFFFFFF))
    drawn = leaves_of_pictures(seen, [LOOK, LOOK])
    of_pictures = np.bincount(seen.plant[drawn.twig], drawn.area_m2)
    of_meshes = np.add.reduceat(twigs.area_m2, twigs.first[:-1])
    np.testing.assert_allclose(of_meshes, of_pictures, rtol=0.02)


def test_single_leaves_lie_as_pictures_scatter_them(oak, built):
    twigs = find_twigs(oak, oak.seasons, np.array([LOOK.leaf_area_index]))
    count = len(built["full"].xyz_m) // 4
    twig, number = leaf_kernel.share_out(twigs, np.array([count]))
    along, across = sides_of(built["full"])
    centre = built["full"].xyz_m.reshape(-1, 4, 3).mean(axis=1)
    out = twigs.tip - twigs.middle[0]
    out /= np.linalg.norm(out, axis=1, keepdims=True)
    key = (np.uint64(oak.skeleton_id[0]) << np.uint64(24)) + twigs.node.astype(np.uint64)
    most = int(number.max()) + 1
    every = np.full(len(twigs.tip), most)

    def scattered(blade):
        return scatter_leaves(twigs.base, twigs.tip, out, every, key, blade, np.full(len(every), LOOK.spray_m),
                              np.full(len(every), LOOK.droop))  # fmt: skip

    row = twig * most + number
    tone = scattered(np.ones((len(every), 2)))[4][row]
    length = np.linalg.norm(along, axis=1) / (0.8 + 0.4 * tone)
    width = np.linalg.norm(across, axis=1) / (0.8 + 0.4 * tone)
    np.testing.assert_allclose(length, length[0], rtol=1e-4)
    np.testing.assert_allclose(length / width, LOOK.blade_m[0] / LOOK.blade_m[1], rtol=1e-4)
    _, places, ahead, beside, _ = scattered(np.tile([length[0], width[0]], (len(every), 1)))
    above = centre[:, 2] > 0.5
    np.testing.assert_allclose(centre[above], places[row][above], atol=1e-4)
    np.testing.assert_allclose(along / 2, ahead[row], atol=1e-4)
    np.testing.assert_allclose(np.abs(np.einsum("ij,ij->i", across / 2, beside[row])),
                               np.einsum("ij,ij->i", beside[row], beside[row]), rtol=1e-3)  # fmt: skip


@pytest.mark.parametrize("level", MODES)
def test_a_mesh_does_not_hang_on_its_neighbours(level):
    looks = [LOOK, LOOKS["quercus_rubra"], LOOKS["ligustrum_vulgare"]]
    three = concatenate([tree(3, 12), tree(4, 6), tree(5, 9)])
    together = build_leaves(three, three.seasons, looks, LEVELS[level])
    order = [2, 0, 1]
    turned = build_leaves(select(three, order), three.seasons[order], [looks[place] for place in order], LEVELS[level])
    for place, there in enumerate([1, 2, 0]):
        alone = build_leaves(select(three, [place]), three.seasons[[place]], [looks[place]], LEVELS[level]).mesh(0)
        assert len(alone.triangle) > 0
        for mesh in (together.mesh(place), turned.mesh(there)):
            for name in ("xyz_m", "normal", "uv", "tint", "triangle"):
                assert getattr(mesh, name).tobytes() == getattr(alone, name).tobytes(), name


def test_levels_keep_the_leaf_area_and_the_outline(oak, built):
    full = built["full"]
    area, height = leaf_area(full, "leaf"), full.xyz_m[:, 2].max()
    middle = 0.5 * (full.xyz_m.min(axis=0) + full.xyz_m.max(axis=0))
    radius = np.linalg.norm(full.xyz_m - middle, axis=1).max()
    for name in ("high", "medium", "low"):
        mesh = built[name]
        assert leaf_area(mesh, MODES[name][0]) == pytest.approx(area, rel=0.05)
        assert mesh.xyz_m[:, 2].max() == pytest.approx(height, rel=0.1)
        assert np.linalg.norm(mesh.xyz_m - middle, axis=1).max() == pytest.approx(radius, rel=0.1)
        # The crown is as wide to all sides, not only in one place.
        wide = [np.quantile(np.hypot(*(m.xyz_m[:, :2] - middle[:2]).T), 0.9) for m in (mesh, full)]
        assert wide[0] == pytest.approx(wide[1], rel=0.2 if name == "low" else 0.1)


def test_no_plant_has_more_cards_than_its_level_allows(oak, built):
    for name, (_, most) in MODES.items():
        assert 0 < len(built[name].triangle) <= 2 * most
    assert len(built["full"].triangle) > 2 * len(built["high"].triangle)
    few = build_leaves(oak, oak.seasons, [LOOK], replace(LEVELS["medium"], cards_max=25))
    assert len(few.triangle) == 50
    assert leaf_area(few, "spray") == pytest.approx(leaf_area(built["full"], "leaf"), rel=0.15)


def test_cards_are_whole_and_look_out_of_the_crown(oak, built):
    twigs = find_twigs(oak, oak.seasons, np.array([LOOK.leaf_area_index]))
    for name, mesh in built.items():
        count = len(mesh.xyz_m) // 4
        np.testing.assert_array_equal(mesh.triangle.reshape(-1, 6) - 4 * np.arange(count)[:, None],
                                      np.tile([0, 1, 2, 0, 2, 3], (count, 1)))  # fmt: skip
        np.testing.assert_array_equal(mesh.first_triangle * 2, mesh.first_vertex)
        corners = mesh.xyz_m[mesh.triangle]
        front = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        front /= np.linalg.norm(front, axis=1, keepdims=True)
        np.testing.assert_allclose(np.linalg.norm(mesh.normal, axis=1), 1, atol=1e-4)
        assert np.einsum("ij,ikj->ik", front, mesh.normal[mesh.triangle]).min() > 0.2
        twig, _ = leaf_kernel.share_out(twigs, np.array([count]))
        out = np.repeat(twigs.tip[twig] - twigs.middle[0], 2, axis=0)
        assert np.einsum("ij,ij->i", front, out).min() > -1e-3, name
        assert mesh.xyz_m[:, 2].min() > -1e-5


@pytest.mark.parametrize("level", MODES)
def test_each_card_shows_one_cell_of_the_atlas(built, level):
    uv = built[level].uv.reshape(-1, 4, 2).astype(np.float64)
    shown = {tuple(np.round(card, 5)) for card in np.concatenate([uv.min(axis=1), uv.max(axis=1)], axis=1)}
    assert shown == {tuple(np.round(cell, 5)) for cell in CELLS[MODES[level][0]]}
    # Feet of leaves are at the lower edge of their picture, toward the twig.
    assert (uv[:, 0, 1] > uv[:, 1, 1]).all()


def test_flowers_are_there_in_spring_alone():
    cherry, plant = LOOKS["prunus_serrulata"], tree(2, 9)
    heads = {}
    for season in SEASONS:
        mesh = build_leaves(plant, plant.seasons, [cherry], LEVELS["full"], season=season)
        top = mesh.uv.reshape(-1, 4, 2)[:, 1, 1]
        heads[season] = np.mean(np.isclose(top, FLOWER_CELLS[0][1])) if len(top) else None
        grey = (mesh.tint.reshape(-1, 4, 3)[:, 0] == mesh.tint.reshape(-1, 4, 3)[:, 0, :1]).all(axis=1)
        assert not len(top) or grey.all() == (season == "spring")  # no tint between old and young on flowers
    assert heads["spring"] == pytest.approx(cherry.blossom_fraction, abs=0.05)
    assert heads["winter"] is None
    assert heads["summer"] == pytest.approx(0.5, abs=0.05)  # those cells show more leaves then


def test_nothing_bears_leaves_where_nothing_stands():
    plant = tree(2, 6)
    dead = replace(plant, death_season=np.where(np.arange(len(plant.parent)) > 0, 6, 0).astype(np.uint8))
    both = concatenate([dead, replace(plant, skeleton_id=np.array([3]))])
    for season, level, faces in (("summer", "high", True), ("winter", "high", False), ("summer", "none", False)):
        chosen = Level("none", 0, 0, (0, 0), "none", 0) if level == "none" else LEVELS[level]
        mesh = build_leaves(both, both.seasons, [LOOK, LOOK], chosen, season=season)
        assert len(mesh) == 2
        assert len(mesh.mesh(0).triangle) == 0
        assert (len(mesh.mesh(1).triangle) > 0) == faces
    assert len(build_leaves(no_skeletons(), np.zeros(0, np.int32), [], LEVELS["full"])) == 0


def test_a_leaf_has_the_colour_of_pictures_and_is_darker_inside_the_crown(oak, built):
    base = texture_rgb(LOOK)
    old, young = tint_factors(LOOK)
    np.testing.assert_allclose(base * old, linear(LOOK.leaf))
    np.testing.assert_allclose(base * young, linear(LOOK.leaf_young))
    assert max(old.max(), young.max()) <= 1
    mesh = built["high"]
    centre = mesh.xyz_m.reshape(-1, 4, 3).mean(axis=1)
    away = np.linalg.norm(centre - centre.mean(axis=0), axis=1)
    bright = mesh.tint[::4, 1].astype(float)
    inner, outer = away < np.quantile(away, 0.3), away > np.quantile(away, 0.7)
    assert bright[inner].mean() < 0.85 * bright[outer].mean()
    assert mesh.tint.min() > 0


def test_light_in_a_crown_is_what_the_plain_reference_lets_through():
    rng = np.random.default_rng(3)
    tips = rng.normal(size=(400, 3)) * (2, 1, 3) + (0, 0, 9)
    tips, area = tips.astype(np.float32), rng.uniform(0.05, 1.0, 400).astype(np.float32)
    twigs = one_plant(tips, area)
    cells = int(twig_kernel.cells_a_side(twigs, 0))
    light, low, size = light_of_cells(tips.astype(float), area, cells)
    points = (low + (rng.integers(0, cells, (200, 3)) + 0.5) * size).astype(np.float32)
    i, j, k = ((points - low) / size).astype(int).T
    np.testing.assert_allclose(twig_kernel.light_at(twigs, points), light[k, j, i], rtol=1e-4)
    assert light.min() < 0.5 < light.max() <= 1


@pytest.mark.parametrize("cards", [1, 7, 60, 400])
def test_a_card_sits_on_the_outermost_twig_of_its_stretch(cards):
    rng = np.random.default_rng(5)
    twigs = one_plant(rng.normal(size=(90, 3)), rng.uniform(0.02, 0.1, 90))
    twig, number = leaf_kernel.share_out(twigs, np.array([cards]))
    np.testing.assert_array_equal(twig, twigs_of_cards(twigs.tip, twigs.area_m2, twigs.middle[0], cards))
    assert len(np.unique(np.column_stack((twig, number)), axis=0)) == cards


def test_seasons_change_the_colours():
    for look in (*LOOKS.values(), LOOK):
        summer, autumn = in_season(look, "summer"), in_season(look, "autumn")
        assert summer.blossom is None
        green = summer.leaf[1] / max(summer.leaf[0], summer.leaf[2])
        assert green > 1.05
        assert autumn.leaf[1] / max(autumn.leaf[0], autumn.leaf[2]) < green - 0.05
        assert in_season(look, "spring").blossom == look.blossom
