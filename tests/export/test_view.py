"""Pictures of whole cities: what stands where, seen from where, and in what light."""

import itertools
import threading
from dataclasses import replace

import numpy as np
import pytest
import shapely

from tests.reference.planted import planted_city
from urbanforest_cli.core.errors import InputError, LimitError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.skeleton import select
from urbanforest_cli.export.plant_camera import Camera, view_from
from urbanforest_cli.export.plant_looks import LOOKS, look_of
from urbanforest_cli.export.view import draw, ground
from urbanforest_cli.export.view.draw import blank_canvas, view_of
from urbanforest_cli.export.view.draw_kernel import LAWN, LEAF, WALL, draw_plants
from urbanforest_cli.export.view.faces_kernel import draw_faces, draw_plain
from urbanforest_cli.export.view.models import build_models, place_models
from urbanforest_cli.export.view.picture import KINDS, choose_shot, draw_view

SIZE = (240, 150)


@pytest.fixture(scope="module")
def city():
    return planted_city()


def looks_of(city):
    return [look_of(species) for species in city.species]


def with_plants(city, xy, **more):
    """Return the city with the first of its plants at places about the origin alone."""
    count = len(xy)
    plants = city.plants.take(np.zeros(count, dtype=int))
    place = np.array([city.origin.easting_m, city.origin.northing_m])
    upright = {"yaw_rad": np.zeros(count), "mirror": np.zeros(count, bool), "scale": np.ones(count)} | more
    return replace(city, plants=replace(plants, xy_m=np.asarray(xy, float) + place, **upright))


def with_town(city):
    """Return the city with a house, a road and lots."""
    place = np.array([city.origin.easting_m, city.origin.northing_m])

    def shapes(*boxes):
        return np.array([shapely.box(*(np.array(box) + np.tile(place, 2))) for box in boxes], dtype=object)

    return replace(city, buildings=shapes((12, -30, 24, -20)), building_height_m=np.array([9.0]),
                   building_id=np.array(["h"], dtype=object), roads=shapes((-60, -14, 90, -6)),
                   lots=shapes((-60, -6, 90, 40), (-60, -60, 90, -14)),
                   lot_colour=np.array(["#f6eddc", "#f5dfe0"], dtype=object))  # fmt: skip


def green(image):
    image = image.astype(int)
    return (image[..., 1] > image[..., 0] + 6) & (image[..., 1] > image[..., 2] + 12)


def around(image, camera, point, reach=3):
    x, y = camera.seen(np.array([point]))[0, :2].round().astype(int)
    return image[max(y - reach, 0) : y + reach + 1, max(x - reach, 0) : x + reach + 1]


@pytest.mark.parametrize("kind", KINDS)
def test_every_kind_shows_plants_where_they_stand(city, kind):
    rows = [[x, y] for x in range(-20, 60, 8) for y in (-16.0, -4.0)]
    town = with_town(with_plants(city, rows) if kind == "street" else city)
    shot = choose_shot(town, kind=kind, size_px=SIZE)
    image = draw_view(town, looks_of(town), kind=kind, size_px=SIZE, scale_bar=False)
    assert image.shape == (SIZE[1], SIZE[0], 3)
    assert image.std() > 10
    crowns = town.local(town.plants.xy_m) + np.outer(0.75 * town.plants.height_m, [0, 0, 1.0])
    seen = shot.camera.seen(crowns)
    inside = (seen[:, 2] > 1) & ((seen[:, :2] > 4) & (seen[:, :2] < np.array(SIZE) - 4)).all(axis=1)
    assert inside.sum() >= 6
    found = [green(around(image, shot.camera, point)).any() for point in crowns[inside]]
    assert np.mean(found) > 0.8


def test_ground_without_plants_shows_none(city):
    alone = with_plants(city, [[0.0, 0.0]])
    camera = Camera((0.0, 0.0, 0.0), 0.0, 90.0, 4.0, SIZE, (SIZE[0] / 2, SIZE[1] / 2))
    image = draw_view(alone, looks_of(alone), kind="top", size_px=SIZE, bounds_m=(-30, -18.75, 30, 18.75),
                      scale_bar=False)  # fmt: skip
    assert green(around(image, camera, (0.3, 0.1, 0.0), reach=5)).any()
    assert not green(image[:, :70]).any()


def test_shadows_fall_away_from_the_sun(city):
    alone = with_plants(with_town(city), [[0.0, 30.0]])
    box = (-30.0, -40.0, 60.0, 16.25)
    camera = choose_shot(alone, kind="top", size_px=SIZE, bounds_m=box).camera
    for azimuth, lit, dark in ((90.0, (26.5, -25, 0), (9.5, -25, 0)), (270.0, (9.5, -25, 0), (26.5, -25, 0))):
        image = draw_view(alone, looks_of(alone), kind="top", size_px=SIZE, bounds_m=box, sun=(azimuth, 45.0),
                          scale_bar=False)  # fmt: skip
        assert around(image, camera, dark, 1).mean() < 0.75 * around(image, camera, lit, 1).mean()


def test_a_crown_shades_the_ground_behind_it(city):
    rows = [[x, y] for x in (-1.5, 0.0, 1.5) for y in (-1.5, 0.0, 1.5)]
    grove = with_plants(city, rows)
    camera = choose_shot(grove, kind="top", size_px=SIZE, bounds_m=(-16, -10, 16, 10)).camera
    image = draw_view(grove, looks_of(grove), kind="top", size_px=SIZE, bounds_m=(-16, -10, 16, 10), sun=(270.0, 35.0),
                      scale_bar=False)  # fmt: skip
    assert around(image, camera, (4.5, 1.5, 0), 1).mean() < 0.85 * around(image, camera, (-4.5, 1.5, 0), 1).mean()


@pytest.mark.parametrize("kind", KINDS)
def test_any_number_of_threads_draws_the_same_picture(city, kind, monkeypatch):
    town = with_town(city)
    monkeypatch.setattr(draw, "BATCH", 2)
    monkeypatch.setattr(draw, "READ", 4)
    one, many = (draw_view(town, looks_of(town), kind=kind, size_px=SIZE, workers=workers) for workers in (1, 5))
    assert (one == many).all()


def test_bands_and_batches_leave_no_trace(city, monkeypatch):
    town = with_town(city)
    whole = draw_view(town, looks_of(town), size_px=SIZE)
    monkeypatch.setattr(draw, "BANDS", 3)
    monkeypatch.setattr(draw, "BATCH", 3)
    monkeypatch.setattr(draw, "READ", 3)
    assert np.abs(whole.astype(int) - draw_view(town, looks_of(town), size_px=SIZE)).max() <= 1


def test_strips_leave_no_trace(city, monkeypatch):
    town = with_town(city)
    whole = draw_view(town, looks_of(town), size_px=SIZE).astype(int)
    monkeypatch.setattr(draw, "STRIP_PX", 4 * SIZE[0] * SIZE[1] // 7)
    assert len(draw.strips_of((2 * SIZE[0], 2 * SIZE[1]), 2)) >= 7
    apart = np.abs(whole - draw_view(town, looks_of(town), size_px=SIZE)).max(axis=2)
    assert (apart > 1).mean() < 0.001  # depths are rounded otherwise


def test_strips_are_whole_pixels_and_no_larger_than_told():
    for size in ((3200, 2000), (16384, 16384), (400, 30002), (8, 2)):
        strips = draw.strips_of(size, 2)
        assert strips[0][0] == 0
        assert strips[-1][1] == size[1]
        assert all(a[1] == b[0] for a, b in itertools.pairwise(strips))
        assert all((bottom - top) % 2 == 0 for top, bottom in strips)
        assert max(bottom - top for top, bottom in strips) * size[0] <= 1.1 * draw.STRIP_PX + 2 * size[0]


def test_more_pixels_than_memory_holds_are_refused(city):
    with pytest.raises(LimitError, match="--bbox"):
        draw_view(city, looks_of(city), size_px=(8193, 8192))


def test_who_stops_a_picture_leaves_no_thread_at_work(city):
    def stop(task, done, total):
        raise KeyboardInterrupt

    before = threading.active_count()
    with pytest.raises(KeyboardInterrupt):
        draw_view(city, looks_of(city), size_px=SIZE, workers=3, progress=stop)
    assert threading.active_count() == before


def test_how_far_a_picture_is_is_told_to_its_end(city):
    told = []
    draw_view(city, looks_of(city), size_px=SIZE, progress=lambda *report: told.append(report))
    for task in ("draw plants", "light the picture"):
        steps = [(done, total) for name, done, total in told if name == task]
        assert steps == sorted(steps)
        assert steps[-1][0] == steps[-1][1] > 0
    assert told[-1] == ("light the picture", SIZE[1], SIZE[1])


def test_a_street_view_without_a_road_is_counted(city):
    notices = Notices()
    draw_view(with_town(city), looks_of(city), size_px=SIZE, notices=notices)
    assert not len(notices)
    draw_view(replace(city, roads=np.zeros(0, dtype=object)), looks_of(city), kind="street", size_px=SIZE,
              notices=notices)  # fmt: skip
    assert notices.count("W_NO_ROAD") == 1


def test_shadows_have_smooth_edges_without_grain(city):
    alone = with_plants(city, [[0.0, 30.0]])
    house = shapely.box(*(np.array([12, -30, 24, -20]) + np.tile([city.origin.easting_m, city.origin.northing_m], 2)))
    alone = replace(alone, buildings=np.array([house], dtype=object), building_height_m=np.array([9.0]),
                    building_id=np.array(["h"], dtype=object))  # fmt: skip
    box = (-30.0, -40.0, 60.0, 16.25)
    camera = choose_shot(alone, kind="top", size_px=SIZE, bounds_m=box).camera
    image = draw_view(alone, looks_of(alone), kind="top", size_px=SIZE, bounds_m=box, sun=(270.0, 45.0),
                      scale_bar=False).astype(int)  # fmt: skip
    left, right = (int(camera.seen(np.array([[x, -25.0, 0.0]]))[0, 0]) for x in (26.0, 45.0))
    row = int(camera.seen(np.array([[26.0, -25.0, 0.0]]))[0, 1])
    tones = image[row - 3 : row + 4, left:right, 1]
    assert np.ptp(tones) > 40  # the shadow's end is in it
    assert (np.diff(tones, axis=1) >= -1).all()
    deep = tones[:, tones.max(axis=0) < tones.min() + 30]
    assert deep.shape[1] > 10
    assert np.abs(np.diff(deep, axis=0)).max() <= 2


def test_leaves_near_the_viewer_have_the_size_of_the_species(city):
    camera = Camera((0.0, 0.0, 1.7), 0.0, 0.0, 1600 / 2 / np.tan(np.radians(31.0)), (1600, 1000), (800, 640), True)
    need = draw.px_per_m(camera.enlarged(2), np.array([[0.0, 25.0, 0.0]]), np.array([12.0]), np.array([0.0]))
    skeletons = city.skeletons_of(city.plants.skeleton_id[:1])
    for look in LOOKS.values():
        models = build_models(skeletons, skeletons.seasons, [look], shortest_m=draw.SHORTEST_LEAF_PX / need,
                              thinnest_m=np.zeros(1))  # fmt: skip
        long = 2 * np.linalg.norm(models.leaf[:, 3:6].astype(float), axis=1)
        assert 0.79 * look.blade_m[0] < long.min()
        assert long.max() < 1.21 * look.blade_m[0]


def silhouette(skeletons, camera, **placed):
    """Return where the wood of one plant, placed as told, is seen."""
    look = look_of(planted_city().species[0])
    models = build_models(skeletons, skeletons.seasons, [look], shortest_m=np.zeros(1), thinnest_m=np.zeros(1),
                          leafy=False)  # fmt: skip
    instances = place_models(models, np.zeros(1, int), np.zeros((1, 3)), **placed)
    canvas = blank_canvas(camera)
    draw_plants(canvas, view_of(camera), models, instances, 0, camera.size_px[1])
    return np.isfinite(canvas.depth)


@pytest.mark.parametrize(("yaw", "mirror", "scale"), [(0.7, False, 1.0), (0.0, True, 1.0), (2.2, True, 1.3)])
def test_a_library_plant_is_mirrored_then_turned_then_scaled(city, yaw, mirror, scale):
    skeletons = replace(city.skeletons_of(city.plants.skeleton_id[:1]), tip_radius_m=np.array([0.05]))
    camera = view_from((3.0, -14.0, 5.0), (0.0, 0.0, 3.0), size_px=(200, 200), field_deg=45.0)
    placed = silhouette(skeletons, camera, yaw_rad=np.array([yaw]), mirror=np.array([mirror]), scale=np.array([scale]))
    x, y, z = skeletons.xyz_m.T.astype(float)
    y = -y if mirror else y
    moved = scale * np.column_stack((np.cos(yaw) * x - np.sin(yaw) * y, np.sin(yaw) * x + np.cos(yaw) * y, z))
    ends = camera.seen(moved[1:])[:, :2].astype(int)
    standing = (skeletons.death_season[1:] == 0) & ~np.isin(np.arange(1, len(x)), skeletons.parent)  # bends are rounded
    hit = np.array([placed[max(v - 2, 0) : v + 3, max(u - 2, 0) : u + 3].any() for u, v in ends[standing]])
    assert hit.all()
    plain = silhouette(skeletons, camera, yaw_rad=np.zeros(1), mirror=np.zeros(1, bool), scale=np.ones(1))
    assert (placed & plain).sum() < 0.8 * placed.sum()  # so the transform matters


def test_fewer_larger_leaves_cover_what_all_leaves_do(city):
    skeletons = city.skeletons_of(city.plants.skeleton_id[:1])
    look = look_of(city.species[0])
    camera = view_from((0.0, -30.0, 3.0), (0.0, 0.0, 3.0), size_px=(300, 300), field_deg=16.0)
    models = build_models(skeletons, skeletons.seasons, [look], shortest_m=np.zeros(1), thinnest_m=np.zeros(1))
    count = int(models.first_leaf[1])
    covered = []
    for share in (1.0, 0.25):
        placed = place_models(models, np.zeros(1, int), np.zeros((1, 3)), leaf_share=np.array([share]))
        assert placed.leaf_count[0] == pytest.approx(share * count, abs=1)
        canvas = blank_canvas(camera)
        draw_plants(canvas, view_of(camera), models, placed, 0, 300)
        covered.append(float((canvas.kind == LEAF).mean()))
    assert covered[1] == pytest.approx(covered[0], rel=0.2)


def test_branches_come_from_thick_to_thin(city):
    skeletons = city.skeletons_of(np.unique(city.plants.skeleton_id))
    looks = [look_of(city.species[0])] * len(skeletons)
    models = build_models(skeletons, skeletons.seasons, looks, shortest_m=np.zeros(4), thinnest_m=np.full(4, 0.005))
    thick = np.maximum(models.wood[:, 6], models.wood[:, 7])
    for first, last in zip(models.first_wood[:-1], models.first_wood[1:], strict=True):
        assert (np.diff(thick[first:last]) <= 0).all()
    assert thick.min() >= 0.005
    alone = build_models(select(skeletons, [2]), skeletons.seasons[2:3], looks[:1], shortest_m=np.zeros(1),
                         thinnest_m=np.full(1, 0.005))  # fmt: skip
    assert (alone.wood == models.wood[models.first_wood[2] : models.first_wood[3]]).all()


def test_a_face_around_the_viewer_is_cut_and_lies_as_the_plain_does():
    camera = view_from((0.0, 0.0, 1.7), (0.0, 10.0, 1.0), size_px=(160, 100), field_deg=70.0)
    view, plain, paint = view_of(camera), blank_canvas(camera), blank_canvas(camera)
    grey = np.full(3, 100, np.uint8)
    draw_plain(plain, view, grey, LAWN, 0, 100)
    far = 4000.0
    corners = np.array([[[-far, -far, 0], [far, -far, 0], [far, far, 0]], [[-far, -far, 0], [far, far, 0],
                                                                          [-far, far, 0]]])  # fmt: skip
    draw_faces(paint, view, corners, np.full((2, 3, 2), -1.0), np.tile([0, 0, 1.0], (2, 1)), np.tile(grey, (2, 1)),
               np.full(2, LAWN, np.uint8), True, 0, 100)  # fmt: skip
    near = plain.depth < 1000
    assert near.sum() > 0.3 * near.size
    assert paint.depth[near] == pytest.approx(plain.depth[near], rel=1e-4)


def test_a_wall_hides_what_is_behind_it():
    camera = view_from((0.0, -20.0, 3.0), (0.0, 0.0, 3.0), size_px=(100, 80), field_deg=50.0)
    canvas, view = blank_canvas(camera), view_of(camera)
    wall = np.array([[[-4.0, 0, 0], [4, 0, 0], [4, 0, 6]], [[-4, 0, 0], [4, 0, 6], [-4, 0, 6]]])
    for y in (5.0, 0.0, 8.0):
        tone = np.full((2, 3), int(10 * y) + 20, np.uint8)
        draw_faces(canvas, view, wall + np.array([0, y, 0]), np.full((2, 3, 2), -1.0), np.tile([0, -1.0, 0], (2, 1)),
                   tone, np.full(2, WALL, np.uint8), False, 0, 80)  # fmt: skip
    assert canvas.rgb[40, 50, 0] == 20
    assert canvas.depth[40, 50] == pytest.approx(20.0, abs=0.1)


def test_winter_is_bare_and_spring_blooms(city):
    grove = with_plants(city, [[x, 0.0] for x in range(0, 12, 2)])
    cherry = [look_of(species) for species in city.species if species.id == "prunus_serrulata"] * len(city.species)
    box = (-6, -6, 16, 8)
    summer, winter, spring = (draw_view(grove, cherry, kind="top", size_px=SIZE, bounds_m=box, season=season,
                                        scale_bar=False).astype(int)
                              for season in ("summer", "winter", "spring"))  # fmt: skip
    coloured = [(np.ptp(image, axis=2) > 40).mean() for image in (summer, winter)]
    assert coloured[1] < 0.2 * coloured[0]
    pink = [((image[..., 0] > image[..., 1] + 15) & (image[..., 2] > image[..., 1])).mean() for image in
            (summer, spring)]  # fmt: skip
    assert pink[1] > 0.002
    assert pink[0] == 0


def test_a_scale_bar_and_an_arrow_stand_on_views_from_above_alone(city):
    with_bar, without = (draw_view(city, looks_of(city), kind="top", size_px=(400, 250), scale_bar=bar)
                         for bar in (True, False))  # fmt: skip
    changed = np.nonzero((with_bar != without).any(axis=2))
    assert changed[0].min() > 200
    assert changed[1].min() > 250
    row = (with_bar != without).any(axis=2)[changed[0].max()]
    width = np.ptp(np.flatnonzero(row & (np.arange(400) > 345)))
    scale = choose_shot(city, kind="top", size_px=(400, 250)).camera.scale_px
    assert any(width == pytest.approx(metres * scale, abs=3) for metres in (1, 2, 5, 10))


def test_a_city_without_plants_is_refused(city):
    empty = replace(city, plants=city.plants.take(np.zeros(0, dtype=int)))
    with pytest.raises(InputError, match="no plant stands"):
        draw_view(empty, looks_of(empty))


def test_the_tone_of_a_lot_hangs_on_nothing_but_itself(city):
    squares = shapely.box(100 * np.arange(6.0), 0, 100 * np.arange(6.0) + 80, 80)
    colours = np.array(["#d8e6c8"] * 6, dtype=object)
    tones, _ = ground._lot_colours(replace(city, lots=squares, lot_colour=colours))
    order = np.array([4, 2, 0])
    some, _ = ground._lot_colours(replace(city, lots=squares[order], lot_colour=colours[order]))
    assert (some == tones[order]).all()
    assert len(np.unique(tones, axis=0)) > 2
