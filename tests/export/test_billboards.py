import io

import numpy as np
import pytest
from PIL import Image

from tests.export.test_mesh_leaves import tree
from urbanforest_cli.core.skeleton import Skeletons, concatenate, no_skeletons, select
from urbanforest_cli.export.mesh.billboards import ATLAS_PX, bake_billboards
from urbanforest_cli.export.mesh.textures import ALPHA_CUTOFF
from urbanforest_cli.export.plant_looks import LOOKS
from urbanforest_cli.export.plant_scene import Standing, build_leaves, build_wood


def arm(number=1, east=2.0, north=1.0):
    """Return a trunk of 4 m with one level branch, whose end lies so far to the east and north."""
    steps = 8
    up = [(0.0, 0.0, 0.5 * k) for k in range(steps + 1)]
    along = [(east * k / steps, north * k / steps, 4.0) for k in range(1, steps + 1)]
    count = len(up) + len(along)
    return Skeletons(
        skeleton_id=np.array([number]),
        first=np.array([0, count]),
        seasons=np.array([20], np.int32),
        tip_radius_m=np.array([0.05]),
        pipe_exponent=np.array([2.2]),
        parent=np.arange(-1, count - 1, dtype=np.int32),
        xyz_m=np.array(up + along, np.float32),
        order=np.r_[np.zeros(len(up)), np.ones(len(along))].astype(np.uint8),
        birth_season=np.r_[0, np.arange(1, 9), np.arange(9, 17)].astype(np.uint8),
        death_season=np.zeros(count, np.uint8),
    )


MAPLE, PRIVET = LOOKS["acer_platanoides"], LOOKS["ligustrum_vulgare"]


def pictures(boards):
    return [np.asarray(Image.open(io.BytesIO(png)).convert("RGBA"), np.float64) / 255 for png in boards.atlases]


def seen(boards, plant, card):
    """Return (h, w, 4) what a card shows and (4, 3) its corners."""
    picture = pictures(boards)[boards.atlas_of[plant]]
    mesh = boards.meshes.mesh(plant)
    corners = slice(4 * card, 4 * card + 4)
    edges = mesh.uv[corners] * (picture.shape[1], picture.shape[0])
    (left, top), (right, bottom) = edges.min(axis=0), edges.max(axis=0)
    return picture[round(top) : round(bottom), round(left) : round(right)], mesh.xyz_m[corners]


def test_three_cards_show_a_plant_from_its_sides_and_from_above():
    plant = arm()
    boards = bake_billboards(plant, plant.seasons, [MAPLE], season="summer")
    assert len(boards.meshes.mesh(0).triangle) == 6
    for card, (right, up) in enumerate(((0, 2), (1, 2), (0, 1))):
        shown, corners = seen(boards, 0, card)
        flat = 3 - right - up
        assert np.ptp(corners[:, flat]) == 0
        # The picture fills the card, and the plant's outline lies at the card's edges.
        assert shown.shape[1] / shown.shape[0] == pytest.approx(
            np.ptp(corners[:, right]) / np.ptp(corners[:, up]), rel=0.06
        )
        there = shown[..., 3] > ALPHA_CUTOFF
        assert there.any(axis=0)[[1, -3]].any()
        assert there.any(axis=0)[:4].any()
        assert there.any(axis=0)[-4:].any()
    assert boards.meshes.mesh(0).xyz_m[8:, 2].mean() > 2  # the level one lies in the crown


def test_a_branch_is_drawn_on_the_side_where_it_grows():
    plant = arm(east=3.0, north=0.0)
    boards = bake_billboards(plant, plant.seasons, [MAPLE], season="winter")
    shown, corners = seen(boards, 0, 0)
    rows, columns = np.nonzero(shown[..., 3] > ALPHA_CUTOFF)
    # uv runs from the lower left corner: the first corner of a card is its western, lower one.
    assert corners[0, 0] < corners[1, 0]
    mesh = boards.meshes.mesh(0)
    assert mesh.uv[0, 0] < mesh.uv[1, 0]
    assert mesh.uv[0, 1] > mesh.uv[3, 1]
    upper = rows < 0.2 * shown.shape[0]
    east = corners[0, 0] + (columns + 0.5) / shown.shape[1] * np.ptp(corners[:, 0])
    assert east[upper].max() > 2.8
    assert east[rows > 0.6 * shown.shape[0]].max() < 0.5
    from_above, level = seen(boards, 0, 2)
    columns = np.nonzero(from_above[..., 3] > ALPHA_CUTOFF)[1]
    assert level[0, 0] + columns.max() / from_above.shape[1] * np.ptp(level[:, 0]) > 2.8


def test_the_eastern_view_has_north_to_its_right():
    plant = arm(east=0.0, north=3.0)
    boards = bake_billboards(plant, plant.seasons, [MAPLE], season="winter")
    shown, corners = seen(boards, 0, 1)
    assert corners[0, 1] < corners[1, 1]
    rows, columns = np.nonzero(shown[..., 3] > ALPHA_CUTOFF)
    north = corners[0, 1] + (columns + 0.5) / shown.shape[1] * np.ptp(corners[:, 1])
    assert north[rows < 0.2 * shown.shape[0]].max() > 2.8
    assert boards.meshes.mesh(0).normal[4, 0] == 1


def test_cards_are_as_large_as_the_grown_plant_with_its_leaves():
    plant = arm()
    boards = bake_billboards(plant, plant.seasons, [MAPLE], season="summer")
    _, twigs = build_wood(Standing(plant, np.zeros((1, 2)), [MAPLE]))
    leaves = build_leaves(twigs, [MAPLE])
    corners = boards.meshes.mesh(0).xyz_m
    np.testing.assert_allclose(corners[:, 2].max(), leaves.centre[:, 2].max(), atol=0.35)
    np.testing.assert_allclose(corners[:, 0].max(), leaves.centre[:, 0].max(), atol=0.35)
    assert corners[:, 2].min() == 0


def test_leaves_are_green_in_summer_and_gone_in_winter():
    plant = arm()
    shares = {}
    for season in ("summer", "autumn", "winter"):
        shown, _ = seen(bake_billboards(plant, plant.seasons, [MAPLE], season=season), 0, 0)
        colour = shown[shown[..., 3] > 0.9][:, :3]
        shares[season] = np.mean((colour[:, 1] > 1.05 * colour[:, 0]) & (colour[:, 1] > 1.05 * colour[:, 2]))
    assert shares["summer"] > 0.5
    assert shares["autumn"] < 0.1
    assert shares["winter"] < 0.02


def test_many_plants_share_atlases_without_touching_each_other():
    kinds = [arm(number, east=1.0 + 0.2 * number) for number in range(1, 8)]
    plants, looks = concatenate(kinds), [MAPLE, PRIVET] * 3 + [MAPLE]
    boards = bake_billboards(plants, plants.seasons, looks, px=256)
    assert [len(own) for own in np.split(np.sort(boards.atlas_of), [5])] == [5, 2]
    assert set(boards.atlas_of[::2]) == {0}  # plants of one look lie together
    taken = [np.zeros(picture.shape[:2], int) for picture in pictures(boards)]
    for plant in range(7):
        for card in range(3):
            own = boards.meshes.mesh(plant).uv[4 * card : 4 * card + 4] * taken[boards.atlas_of[plant]].shape[::-1]
            (left, top), (right, bottom) = np.floor(own.min(axis=0)).astype(int), np.ceil(own.max(axis=0)).astype(int)
            taken[boards.atlas_of[plant]][top:bottom, left:right] += 1
    for count, picture in zip(taken, pictures(boards), strict=True):
        assert max(picture.shape[:2]) <= ATLAS_PX
        assert count.max() == 1
        assert picture[..., 3][count == 0].max() < 0.5
    again = bake_billboards(plants, plants.seasons, looks, px=256)
    assert again.atlases == boards.atlases
    alone = bake_billboards(select(plants, [3]), plants.seasons[[3]], [looks[3]], px=256)
    np.testing.assert_array_equal(alone.meshes.mesh(0).xyz_m, boards.meshes.mesh(3).xyz_m)


def test_crowns_far_away_do_not_dissolve():
    plant = tree(3, 15)
    for look in (MAPLE, LOOKS["gleditsia_triacanthos"], PRIVET):
        boards = bake_billboards(plant, plant.seasons, [look], season="summer")
        alpha = pictures(boards)[0][..., 3]
        seen = (alpha > ALPHA_CUTOFF).sum()
        for size in (2, 4, 8, 16):
            rows, columns = (edge // size for edge in alpha.shape)
            coarse = alpha.reshape(rows, size, columns, size).mean(axis=(1, 3))
            assert (coarse > ALPHA_CUTOFF).sum() * size**2 >= 0.8 * seen


def test_no_plants_have_no_atlas():
    boards = bake_billboards(no_skeletons(), np.zeros(0, np.int32), [])
    assert boards.atlases == []
    assert len(boards.meshes) == 0
