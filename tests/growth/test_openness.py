"""How open plants stand: truths known by hand, a brute-force twin, and what a key must not hang on."""

import numpy as np
import pytest
import shapely
from shapely.affinity import rotate

from urbanforest_cli.core.config import Growth
from urbanforest_cli.core.habits import usual_sizes
from urbanforest_cli.growth import openness
from urbanforest_cli.growth.openness import (
    AZIMUTHS_RAD,
    CROWN_DEPTH_PER_M,
    LIGHT_PART,
    OVERHEAD,
    SECTOR_OF_RAY,
    Crowns,
    openness_keys,
    openness_of,
)
from urbanforest_cli.growth.solids import footprints_of
from urbanforest_cli.growth.sunlight import light_from as light_from_latitude
from urbanforest_cli.growth.surroundings import Plants, Site

EAST, NORTH, WEST, SOUTH = 0, 2, 4, 6


def walls_of(shapes, tops):
    return footprints_of(np.array(shapes, dtype=object), np.asarray(tops, dtype=float), 8.0)


NO_WALLS = walls_of([], [])


def empty_site(latitude_deg):
    sizes = usual_sizes("tree", mature_height_m=18.0, mature_crown_diameter_m=11.0, clear_stem_m=2.0)
    plants = Plants(
        keys=np.array([1], dtype=np.uint64), xy_m=np.zeros((1, 2)), species=np.zeros(1, dtype=np.int64),
        age_years=np.array([30.0]), pruning_factor=np.ones(1),
    )  # fmt: skip
    nothing = np.array([], dtype=object), np.zeros(0)
    return Site(plants, [sizes], *nothing, light_from_latitude(latitude_deg, 0.5), Growth())


def light_from(sun=0.0):
    """Seventeen rays; `sun` is how much more comes from the south than from the mean."""
    rays, shares = [(0.0, 0.0, 1.0)], [0.2]
    for elevation, share in ((60.0, 0.06), (25.0, 0.04)):
        for k in range(8):
            a, e = np.radians(45.0 * k), np.radians(elevation)
            rays.append((np.cos(a) * np.cos(e), np.sin(a) * np.cos(e), np.sin(e)))
            shares.append(share * (1.0 - sun * np.sin(a)))
    return {"ray": np.array(rays), "ray_light": np.array(shares) / np.sum(shares)}


def crowns(xy, height=12.0, radius=4.0, base=2.0):
    n = len(xy)
    full = (np.broadcast_to(np.asarray(value, dtype=float), (n,)).copy() for value in (height, radius, base))
    height, radius, base = full
    return Crowns(xy_m=np.asarray(xy, dtype=float), height_m=height, radius_m=radius, base_m=base)


def random_city(n=150, buildings=12, seed=3, side=90.0):
    rng = np.random.default_rng(seed)
    height = rng.uniform(1.0, 18.0, n)
    plants = crowns(rng.uniform(0, side, (n, 2)), height, height * rng.uniform(0.2, 0.4, n), height * 0.15)
    centres, halves = rng.uniform(0, side, (buildings, 2)), rng.uniform(2.0, 6.0, (buildings, 2))
    shapes = [rotate(shapely.box(*(c - h), *(c + h)), rng.uniform(0, 90)) for c, h in zip(centres, halves, strict=True)]
    inside = shapely.contains_xy(shapely.union_all(shapes).buffer(0.3), plants.xy_m)
    keep = ~inside
    plants = crowns(plants.xy_m[keep], plants.height_m[keep], plants.radius_m[keep], plants.base_m[keep])
    return plants, shapes, rng.uniform(3.0, 25.0, buildings)


def test_a_plant_alone_is_wholly_open_but_to_the_shaded_side():
    np.testing.assert_allclose(openness_keys(crowns([(0, 0)]), NO_WALLS, **light_from()), np.ones((1, 9)))
    keys = openness_keys(crowns([(0, 0)]), NO_WALLS, **light_from(0.6))[0]
    np.testing.assert_allclose(
        keys[[SOUTH, EAST, NORTH, OVERHEAD]], [1.0, 1 - LIGHT_PART * 0.6 / 1.6, 1 - LIGHT_PART * 1.2 / 1.6, 1.0]
    )


def test_sunny_sides_are_told_from_shaded_ones_on_either_half_of_the_earth():
    alone = empty_site(50.0), empty_site(-35.0)
    north, south = (openness_of(site)[0] for site in alone)
    assert north[SOUTH] > north[NORTH] + 0.06
    assert south[NORTH] > south[SOUTH] + 0.06


def test_no_plants_no_keys():
    assert openness_keys(crowns(np.zeros((0, 2))), NO_WALLS, **light_from()).shape == (0, 9)


def test_a_neighbour_of_the_same_kind_leaves_half_the_way_to_it():
    dark = {"ray": np.array([[0.0, 0.0, 1.0]]), "ray_light": np.ones(1)}  # light from straight up: room alone tells
    keys = openness_keys(crowns([(0, 0), (4.0, 0)]), NO_WALLS, **dark)
    rays = np.cos(AZIMUTHS_RAD[SECTOR_OF_RAY == EAST])
    np.testing.assert_allclose(keys[0, EAST], np.mean(2.0 / rays / 4.0))
    np.testing.assert_allclose(keys[1, WEST], keys[0, EAST])
    assert keys[0, WEST] == keys[0, NORTH] == 1.0


def test_a_low_shrub_takes_no_room_from_a_crown_above_it():
    keys = openness_keys(crowns([(0, 0), (2.0, 0)], [12.0, 1.8], [4.0, 1.0], [2.0, 0.0]), NO_WALLS, **light_from())
    np.testing.assert_array_equal(keys[0], 1.0)
    assert keys[1, WEST] < 0.8
    assert keys[1, OVERHEAD] < 0.8


def test_a_wall_on_the_sunny_side_takes_more_than_on_the_other():
    wall = [shapely.box(-20, -6, 20, -5)], np.array([14.0])
    free = openness_keys(crowns([(0, 0)]), NO_WALLS, **light_from(0.6))[0]
    south = openness_keys(crowns([(0, 0)]), walls_of(*wall), **light_from(0.6))[0]
    north = openness_keys(crowns([(0, -11)]), walls_of(*wall), **light_from(0.6))[0]
    assert (free - south)[SOUTH] > 2.0 * (free - north)[NORTH] > 0.05
    alike = light_from(0.0)
    south = openness_keys(crowns([(0, 0)]), walls_of(*wall), **alike)[0]
    north = openness_keys(crowns([(0, -11)]), walls_of(*wall), **alike)[0]
    np.testing.assert_allclose(south[[0, 7, 6, 5, 4]], north[[0, 1, 2, 3, 4]], atol=1e-9)


@pytest.mark.parametrize("change", ["nearer", "higher"])
def test_a_wall_nearer_or_higher_leaves_less(change):
    keys = []
    for value in (3.0, 2.0, 1.0):
        near, top = (value, 8.0) if change == "nearer" else (3.0, 14.0 - 2.0 * value)
        wall = walls_of([shapely.box(near, -15, near + 5, 15)], np.array([top]))
        keys.append(openness_keys(crowns([(0, 0)]), wall, **light_from())[0, EAST])
    assert 1.0 > keys[0] > keys[1] > keys[2] > 0.0


def first_nearer_to_the_neighbour(i, j, plants, azimuth):
    """March along a ray until the neighbour is nearer in crown radii."""
    steps = np.linspace(0.0, 1.0, 4001)[:, None]
    points = plants.xy_m[i] + steps * plants.radius_m[i] * np.array([np.cos(azimuth), np.sin(azimuth)])
    taken = np.linalg.norm(points - plants.xy_m[j], axis=1) / plants.radius_m[j] < steps[:, 0]
    return steps[taken.argmax(), 0] if taken.any() else 1.0


def metres_in_crown(i, j, plants, direction, eye):
    """March along a ray of light and count the steps inside the neighbour's ellipsoid."""
    step = 0.02
    points = np.append(plants.xy_m[i], eye) + np.arange(0.0, 80.0, step)[:, None] * direction
    tall = 0.5 * (plants.height_m[j] - plants.base_m[j])
    centre = np.append(plants.xy_m[j], plants.base_m[j] + tall)
    axes = np.array([plants.radius_m[j], plants.radius_m[j], tall])
    return step * (np.sum(((points - centre) / axes) ** 2, axis=1) < 1.0).sum()


def slow_key(i, plants, shapes, tops, ray, ray_light):
    elevations = np.round(np.arcsin(ray[1:, 2]), 6)
    slopes = np.unique(elevations)
    edges = np.r_[slopes[0] - np.radians(10.0), 0.5 * (slopes + np.append(slopes[1:], np.pi / 2))]
    by_ray = np.zeros((len(AZIMUTHS_RAD), len(slopes)))
    for (x, y, _), rise, share in zip(ray[1:], elevations, ray_light[1:], strict=True):
        turn = np.angle(np.exp(1j * (AZIMUTHS_RAD - np.arctan2(y, x))))
        by_ray[np.abs(turn) < np.radians(22.5), np.searchsorted(slopes, rise)] += share / 3
    depth = plants.height_m[i] - plants.base_m[i]
    room = np.ones(len(AZIMUTHS_RAD))
    light = {}
    for eye_share in (0.5, 0.75):
        eye = plants.base_m[i] + eye_share * depth
        seen = np.ones((len(AZIMUTHS_RAD), len(slopes)))
        for a, azimuth in enumerate(AZIMUTHS_RAD):
            level = np.array([np.cos(azimuth), np.sin(azimuth)])
            line = shapely.LineString([plants.xy_m[i], plants.xy_m[i] + 200.0 * level])
            for shape, top in zip(shapes, tops, strict=True):
                hit = shapely.intersection(line, shape.exterior)
                if hit.is_empty:
                    continue
                distance = max(shapely.distance(hit, shapely.Point(plants.xy_m[i])), 0.05)
                beside = np.clip((min(top, plants.height_m[i]) - plants.base_m[i]) / depth, 0.0, 1.0)
                room[a] = min(room[a], 1.0 - beside * (1.0 - min(distance / plants.radius_m[i], 1.0)))
                rise = np.arctan2(top - eye, distance)
                seen[a] = np.minimum(seen[a], np.clip((edges[1:] - rise) / np.diff(edges), 0.0, 1.0))
            for j in range(len(plants)):
                if j == i:
                    continue
                beside = min(plants.height_m[i], plants.height_m[j]) - max(plants.base_m[i], plants.base_m[j])
                if beside > 0:
                    free = first_nearer_to_the_neighbour(i, j, plants, azimuth)
                    room[a] = min(room[a], 1.0 - min(beside / depth, 1.0) * (1.0 - free))
                if np.linalg.norm(plants.xy_m[i] - plants.xy_m[j]) < 50.0:
                    for e, rise in enumerate(slopes):
                        direction = np.append(level * np.cos(rise), np.sin(rise))
                        seen[a, e] *= np.exp(-CROWN_DEPTH_PER_M * metres_in_crown(i, j, plants, direction, eye))
        up = 1.0
        for j in range(len(plants)):
            if j != i and np.linalg.norm(plants.xy_m[i] - plants.xy_m[j]) < plants.radius_m[j]:
                up *= np.exp(-CROWN_DEPTH_PER_M * metres_in_crown(i, j, plants, np.array([0.0, 0.0, 1.0]), eye))
        light[eye_share] = seen, up
    brightest = max(by_ray[k == SECTOR_OF_RAY].sum() for k in range(8))
    key = np.empty(9)
    for k in range(8):
        mine = k == SECTOR_OF_RAY
        key[k] = room[mine].mean() * (
            1.0 - LIGHT_PART + LIGHT_PART * (by_ray[mine] * light[0.5][0][mine]).sum() / brightest
        )
    above, up = light[0.75]
    high = by_ray[:, 1]
    key[8] = ((high * above[:, 1]).sum() + ray_light[0] * up) / (high.sum() + ray_light[0])
    return np.clip(key, 0.0, 1.0)


def test_keys_agree_with_a_slow_twin_that_marches_along_every_ray():
    plants, shapes, tops = random_city(n=40, buildings=6, side=45.0)
    light = light_from(0.5)
    keys = openness_keys(plants, walls_of(shapes, tops), **light)
    assert keys.std(axis=0).min() > 0.1
    for i in range(0, len(plants), 6):
        np.testing.assert_allclose(keys[i], slow_key(i, plants, shapes, tops, **light), atol=0.01)


def test_keys_know_no_order_of_rows_or_chunks(monkeypatch):
    plants, shapes, tops = random_city()
    keys = openness_keys(plants, walls_of(shapes, tops), **light_from(0.4))
    order, turned = np.random.default_rng(1).permutation(len(plants)), np.arange(len(shapes))[::-1]
    shuffled = crowns(*(values[order] for values in (plants.xy_m, plants.height_m, plants.radius_m, plants.base_m)))
    monkeypatch.setattr(openness, "CHUNK", 17)
    again = openness_keys(shuffled, walls_of([shapes[t] for t in turned], tops[turned]), **light_from(0.4))
    np.testing.assert_array_equal(again, keys[order])


def test_turning_the_city_turns_the_sectors():
    plants, shapes, tops = random_city()
    keys = openness_keys(plants, walls_of(shapes, tops), **light_from())
    quarter = np.array([[0.0, -1.0], [1.0, 0.0]])
    around = crowns(plants.xy_m @ quarter.T, plants.height_m, plants.radius_m, plants.base_m)
    walls = walls_of([rotate(shape, 90, origin=(0, 0)) for shape in shapes], tops)
    turned = openness_keys(around, walls, **light_from())
    np.testing.assert_allclose(turned[:, :8], np.roll(keys[:, :8], 2, axis=1), atol=2e-3)
    np.testing.assert_allclose(turned[:, 8], keys[:, 8], atol=2e-3)


def test_outlines_of_holes_and_parts_are_walls():
    ring = shapely.Polygon([(0, 0), (20, 0), (20, 20), (0, 20)], [[(9, 9), (11, 9), (11, 11), (9, 11)]])
    shape = shapely.MultiPolygon([shapely.box(40, 0, 41, 1), ring])
    dark = {"ray": np.array([[0.0, 0.0, 1.0]]), "ray_light": np.ones(1)}
    court, outside = openness_keys(crowns([(10, 10), (-2, 10)], 6.0, 3.0, 0.0), walls_of([shape], [30.0]), **dark)
    np.testing.assert_allclose(court[[EAST, NORTH, WEST, SOUTH]], np.mean(1.0 / np.cos(AZIMUTHS_RAD[[23, 0, 1]])) / 3.0)
    assert outside[EAST] < 0.7
    assert outside[WEST] == 1.0
