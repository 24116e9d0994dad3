from dataclasses import replace

import numpy as np
import pytest
import shapely

from urbanforest_cli.core import config as settings
from urbanforest_cli.core.colours import to_rgb
from urbanforest_cli.core.skeleton import Skeletons
from urbanforest_cli.export.plant_camera import side_view, view_from, view_onto
from urbanforest_cli.export.plant_looks import LOOKS, look_of
from urbanforest_cli.export.plant_pictures import Backdrop, Scene, render, shade_of
from urbanforest_cli.export.plant_scene import (
    Look,
    Standing,
    Wood,
    build_leaves,
    build_twiglets,
    build_wood,
    joined_wood,
)
from urbanforest_cli.export.plant_sheets import Label, Panel, draw_sheet
from urbanforest_cli.export.plant_town import Faces, build_person, build_slabs, build_walls
from urbanforest_cli.export.view.draw import LEAF_EXTINCTION
from urbanforest_cli.export.view.light_kernel import leaf_depth
from urbanforest_cli.export.view.models import build_models, place_models
from urbanforest_cli.files.species import load_catalogue

LOOK = Look(leaf=(0.25, 0.4, 0.15), leaf_young=(0.4, 0.55, 0.2), bark=(0.4, 0.36, 0.32))
PLAIN = Backdrop((1.0, 1.0, 1.0), (1.0, 1.0, 1.0), None)
STEEP = np.array([0.1, 0.0, 0.995])


def tree(number=1, seasons=9):
    """Return a skeleton whose trunk and branches grow a node a season, each third node with two branches."""
    parent, xyz, order, birth = [-1], [(0.0, 0.0, 0.0)], [0], [0]
    tips = [(0, np.array([0.0, 0.0, 1.0]), 0)]
    for season in range(1, seasons + 1):
        grown = []
        for node, ahead, level in tips:
            parent.append(node)
            xyz.append(tuple(np.array(xyz[node]) + 0.5 * ahead))
            order.append(level)
            birth.append(season)
            new = len(parent) - 1
            grown.append((new, ahead, level))
            if season % 3 == 0:
                turn = 2.4 * new + number
                across = np.array([np.cos(turn), np.sin(turn), 0.0])
                grown += [(new, (ahead + sign * across) / np.sqrt(2), level + 1) for sign in (1, -1)]
        tips = grown
    count = len(parent)
    return Skeletons(
        skeleton_id=np.array([number]),
        first=np.array([0, count]),
        seasons=np.array([seasons], np.int32),
        tip_radius_m=np.array([0.01]),
        pipe_exponent=np.array([2.2]),
        parent=np.array(parent, np.int32),
        xyz_m=np.array(xyz, np.float32),
        order=np.array(order, np.uint8),
        birth_season=np.array(birth, np.uint8),
        death_season=np.zeros(count, np.uint8),
    )


def planted(skeleton=None, x=0.0, y=0.0, look=LOOK, **more):
    return Standing(tree() if skeleton is None else skeleton, np.array([[x, y]]), [look], **more)


def stem(x, y, z0, z1, radius, rgb=(0.2, 0.2, 0.2)):
    ends = np.array([[x, y, z0]]), np.array([[x, y, z1]])
    return Wood(*ends, np.array([radius]), np.array([radius]), np.array([rgb]))


def drawn(things, camera, **more):
    return render(Scene([], things=things, backdrop=PLAIN), camera, **more).astype(int)


def inked(image):
    return (image < 250).any(axis=2)


def test_a_stem_is_as_high_and_as_thick_as_it_is():
    image = drawn([stem(5.0, 0.0, 0.0, 6.0, 0.2)], side_view(0.0, 10.0, 20.0, above_m=8.0, pitch_deg=0.0))
    rows, columns = np.nonzero(inked(image))
    assert abs(rows.min() - (8.0 - 6.0 - 0.2) * 20) <= 1  # its upper end is round
    assert abs(rows.max() + 1 - 8.0 * 20) <= 1  # and it is cut off flat at the ground
    assert abs(columns.max() + 1 - columns.min() - 2 * 0.2 * 20) <= 1
    assert abs((columns.max() + 1 + columns.min()) / 2 - 5.0 * 20) <= 0.5


def test_a_stem_is_lighter_on_the_left_where_the_light_comes_from():
    image = drawn([stem(5.0, 0.0, 0.5, 6.0, 1.0)], side_view(0.0, 10.0, 20.0, above_m=8.0, pitch_deg=0.0))
    assert image[80, 84:92].mean() > 1.3 * image[80, 110:118].mean()


def test_what_is_near_hides_what_is_far_whatever_the_order():
    far, near = stem(5.0, 3.0, 0.5, 6.0, 0.5, (0.5, 0.0, 0.0)), stem(5.0, -3.0, 0.5, 6.0, 0.5, (0.0, 0.0, 0.5))
    camera = side_view(0.0, 10.0, 20.0, above_m=8.0, pitch_deg=0.0)
    for things in ([far, near], [near, far]):
        red, _, blue = drawn(things, camera)[80, 100]
        assert blue > 2 * red


def test_what_is_thinner_than_a_pixel_fades_instead_of_growing_thick():
    camera = side_view(0.0, 10.0, 20.0, above_m=8.0, pitch_deg=0.0)
    thick, thin = (
        255.0 - drawn([stem(5.0, 0.0, 0.5, 7.0, radius, (0.0, 0.0, 0.0))], camera, supersampling=1)[40:140].mean()
        for radius in (0.025, 0.005)  # half a pixel, a tenth of one
    )
    assert thin == pytest.approx(thick / 5, rel=0.25)


def test_winter_shows_no_leaves_and_summer_does():
    camera = side_view(-4.0, 8.0, 40.0, above_m=6.0)
    summer, winter = (render(Scene([planted()], leafy=leafy, backdrop=PLAIN), camera).astype(int)
                      for leafy in (True, False))  # fmt: skip
    green_in_summer, green_in_winter = ((im[..., 1] - im[..., 0] > 10).sum() for im in (summer, winter))
    assert green_in_winter == 0
    assert green_in_summer > 2000


def test_the_same_scene_gives_the_same_picture():
    camera = side_view(-4.0, 8.0, 30.0, above_m=6.0)
    first, second = (render(Scene([planted()]), camera) for _ in range(2))
    assert (first == second).all()


def test_an_earlier_season_shows_the_plant_as_it_was():
    grown, young = (build_wood(planted(season_end=np.array([season])))[0] for season in (9, 3))
    assert young.end[:, 2].max() == pytest.approx(1.5)
    assert grown.end[:, 2].max() == pytest.approx(4.5)
    assert young.start_radius.max() < grown.start_radius.max()


def test_lost_wood_is_not_drawn():
    skeleton = tree()
    dead = skeleton.death_season.copy()
    dead[skeleton.order > 0] = 9
    wood, twigs = build_wood(planted(replace(skeleton, death_season=dead)))
    assert len(wood.end) == 9
    assert np.abs(wood.end[:, :2]).max() == 0
    assert len(build_wood(planted(replace(skeleton, death_season=dead), season_end=np.array([8])))[0].end) > 9
    assert len(twigs.tip) > 0


def test_a_plant_that_is_dead_or_only_planted_leaves_the_picture_empty():
    skeleton = tree()
    dead = replace(skeleton, death_season=np.full(len(skeleton.parent), 5, np.uint8))
    camera = side_view(-4.0, 8.0, 20.0, above_m=6.0)
    empty = render(Scene([], backdrop=PLAIN), camera)
    for plant in (planted(dead), planted(season_end=np.array([0]))):
        for leafy in (True, False):
            assert (render(Scene([plant], leafy=leafy, backdrop=PLAIN), camera) == empty).all()


def test_bare_twigs_bear_fine_twiglets():
    _, twigs = build_wood(planted())
    twiglets = build_twiglets(twigs, [LOOK])
    assert len(twiglets.end) >= 3 * len(twigs.tip)
    assert np.linalg.norm(twiglets.end - twiglets.start, axis=1).max() < 1.0
    assert twiglets.start_radius.max() < 0.005


def test_turn_and_scale_move_a_plant_as_a_whole():
    base = build_wood(planted())[0]
    turned = build_wood(planted(x=7.0, turn_rad=np.array([np.pi / 2]), scale=np.array([2.0])))[0]
    assert turned.end[:, 0] == pytest.approx(7.0 - 2 * base.end[:, 1], abs=1e-6)
    assert turned.end[:, 1] == pytest.approx(2 * base.end[:, 0], abs=1e-6)
    assert turned.end_radius == pytest.approx(2 * base.end_radius)


def test_branches_meet_and_never_grow_thicker_toward_the_tip():
    wood, _ = build_wood(planted())
    ends = {tuple(point) for point in np.round(wood.end, 6)} | {(0.0, 0.0, 0.0)}
    assert all(tuple(point) in ends for point in np.round(wood.start, 6))
    assert (wood.start_radius >= wood.end_radius - 1e-12).all()


def test_leaves_have_the_area_that_the_leaf_area_index_asks():
    look = replace(LOOK, leaf_area_index=1.5)
    _, twigs = build_wood(planted(look=look))
    leaves = build_leaves(twigs, [look])
    spread = ((twigs.tip[:, :2] - twigs.tip[:, :2].mean(axis=0)) ** 2).sum(axis=1).mean()
    assert leaves.area_m2.sum() == pytest.approx(1.5 * 2 * np.pi * spread, rel=0.1)


def test_few_large_leaves_cover_what_many_small_ones_do():
    _, twigs = build_wood(planted())
    fine, coarse = (build_leaves(twigs, [LOOK], shortest_m=length) for length in (0.0, 0.4))
    assert len(coarse.twig) < 0.25 * len(fine.twig)
    assert coarse.area_m2.sum() == pytest.approx(fine.area_m2.sum(), rel=0.12)


def test_leaves_stay_by_their_twigs():
    look = replace(LOOK, spray_m=0.2)
    _, twigs = build_wood(planted(look=look))
    leaves = build_leaves(twigs, [look])
    away = np.linalg.norm(leaves.centre - twigs.tip[leaves.twig], axis=1)
    assert away.max() < np.linalg.norm(twigs.tip - twigs.base, axis=1).max() + 0.2 + look.blade_m[0]


def placed(seasons=9, **more):
    look = replace(LOOK, **more)
    skeleton = tree(seasons=seasons)
    models = build_models(skeleton, skeleton.seasons, [look], shortest_m=np.zeros(1), thinnest_m=np.zeros(1))
    return models, place_models(models, np.zeros(1, int), np.zeros((1, 3)))


def test_leaves_are_darker_inside_and_below():
    models, instances = placed(seasons=12, leaf_area_index=6.0)
    ring = shade_of([(models, instances)], Faces(), STEEP)
    centre = models.leaf[:, :3].astype(float)
    light = np.exp([-leaf_depth(ring, *(point + 0.6 * STEEP)) for point in centre])
    height = centre[:, 2]
    inner = np.hypot(centre[:, 0], centre[:, 1]) < 1.0
    assert light[inner & (height < 3.0)].mean() < 0.6 * light[height > 5.0].mean()


def test_a_crown_counts_once_in_the_shade():
    models, instances = placed()
    bare = instances._replace(leaf_count=np.zeros(1, np.int64))
    with_leaves, without = (shade_of([(models, item)], Faces(), STEEP) for item in (instances, bare))
    more = (with_leaves.shade[0].sum() - without.shade[0].sum()) * with_leaves.cell**2
    area = float(models.leaf_area[0]) * len(models.leaf)
    assert more == pytest.approx(LEAF_EXTINCTION * area, rel=0.02)


def test_a_house_casts_its_shadow_to_the_right():
    house = np.array([shapely.box(-3, 2, 3, 6)], dtype=object)
    camera = view_from((0.0, -30.0, 12.0), (0.0, 3.0, 1.0), size_px=(400, 240), field_deg=45.0)
    back = Backdrop((0.9, 0.9, 0.9), (0.9, 0.9, 0.9), (0.6, 0.6, 0.6), (0.0, 0.0), (100.0, 100.0))
    image = render(Scene([], house, np.array([6.0]), backdrop=back), camera).astype(int)
    column, row = camera.seen(np.array([[5.0, 4.5, 0.0], [-5.0, 4.5, 0.0]]))[:, :2].round().astype(int).T
    right, left = (image[y - 2 : y + 3, x - 2 : x + 3].mean() for x, y in zip(column, row, strict=True))
    assert right < 0.8 * left


def test_walls_close_around_a_house_with_a_yard():
    yard = np.array([shapely.box(0, 0, 20, 20).difference(shapely.box(5, 5, 15, 15))], dtype=object)
    faces = build_walls(yard, np.array([7.0]))
    sides = np.cross(faces.corners[:, 1] - faces.corners[:, 0], faces.corners[:, 2] - faces.corners[:, 0])
    area = np.linalg.norm(sides, axis=1) / 2
    upward = faces.normal[:, 2] > 0.5
    assert area[upward].sum() == pytest.approx(300.0)
    assert area[~upward].sum() == pytest.approx(7.0 * (80 + 40))
    assert np.abs(faces.normal * area[:, None]).sum() > 0
    assert (faces.normal[~upward] * area[~upward, None]).sum(axis=0) == pytest.approx(np.zeros(3), abs=1e-9)
    probe = faces.corners[~upward].mean(axis=1) + 0.1 * faces.normal[~upward]
    assert not shapely.contains_xy(yard[0], probe[:, 0], probe[:, 1]).any()  # normals look out of the house


def test_flat_areas_keep_their_area():
    area = shapely.Point(3, 4).buffer(17.0)
    faces = build_slabs(np.array([area], dtype=object), z_m=0.1, rgb=(0.5, 0.5, 0.5))
    sides = np.cross(faces.corners[:, 1] - faces.corners[:, 0], faces.corners[:, 2] - faces.corners[:, 0])
    assert np.linalg.norm(sides, axis=1).sum() / 2 == pytest.approx(area.area)
    assert (faces.corners[..., 2] == 0.1).all()


def test_twice_as_far_is_half_as_large():
    camera = view_from((0.0, -10.0, 0.0), (0.0, 0.0, 0.0), size_px=(200, 100), field_deg=90.0)
    seen = camera.seen(np.array([[1.0, 0.0, 0.0], [1.0, 10.0, 0.0], [0.0, 0.0, 0.0], [0.0, 0.0, 1.0]]))
    assert seen[0] == pytest.approx([110.0, 50.0, 10.0, 10.0])
    assert seen[1] == pytest.approx([105.0, 50.0, 20.0, 5.0])
    assert seen[2, :2] == pytest.approx([100.0, 50.0])
    assert seen[3, 1] < seen[2, 1]


def test_a_view_onto_points_is_just_filled_by_them():
    points = np.array([[0.0, 0, 0], [100, 0, 0], [100, 80, 0], [0, 80, 20]])
    camera = view_onto(points, azimuth_deg=20.0, pitch_deg=35.0, distance_m=150.0, size_px=(600, 300), margin_px=10)
    xy = camera.seen(points)[:, :2]
    room = np.minimum(xy.min(axis=0), np.array([600, 300]) - xy.max(axis=0))
    assert room.min() == pytest.approx(10.0)
    assert (room >= 10 - 1e-9).all()


def test_the_page_and_the_ground_that_fades_keep_the_colour_of_paper():
    paper = (0.988, 0.984, 0.973)
    image = render(Scene([]), side_view(-20.0, 40.0, 5.0, above_m=10.0, below_m=3.0))
    assert np.abs(image[0] - np.round(255 * np.array(paper))).max() <= 1
    assert np.abs(image[50].mean(axis=0) - image[0].mean(axis=0)).max() > 3


def test_a_person_is_as_tall_as_asked():
    person = joined_wood([build_person(0.0, 0.0, height_m=1.6)])
    assert (person.end[:, 2] + person.end_radius).max() == pytest.approx(1.6, abs=0.03)


def test_every_shipped_species_has_a_look_and_others_take_their_colour():
    catalogue = load_catalogue(settings.Species())
    assert set(catalogue.ids) == set(LOOKS)
    red, blue = (look_of(replace(catalogue["tilia_cordata"], id="other", colour=colour))
                 for colour in ("#ff0000", "#0000ff"))  # fmt: skip
    assert red.leaf[0] > blue.leaf[0]
    assert red.leaf[2] < blue.leaf[2]
    assert max(abs(a - b) for a, b in zip(red.bark, to_rgb("#6f665b"), strict=True)) == 0


def test_a_sheet_shows_each_panel_pixel_by_pixel():
    images = [np.full((40, 90, 3), tone, np.uint8) for tone in (10, 120)]
    figure = draw_sheet([[Panel(images[0], "a", "b", [Label(3, 3, "", ("",))]), Panel(images[1], px_per_m=4.0)]],
                        ("Title", "line"))  # fmt: skip
    figure.canvas.draw()
    page = np.asarray(figure.canvas.buffer_rgba())[..., 0]
    assert (page == 10).sum() == 40 * 90
    assert 0.9 * 40 * 90 < (page == 120).sum() <= 40 * 90 + 200
