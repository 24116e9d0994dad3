"""Buildings in a frame: conservative columns, and the light that is left beside them."""

import numpy as np
import pytest
import shapely
from shapely import affinity

from urbanforest_cli.growth.grove import COLUMN_M, SKY_CELL_M
from urbanforest_cli.growth.solids import footprints_of, sky_field, solid_top, within_shade
from urbanforest_cli.growth.sunlight import light_from

CITY = np.array([4_310_000.0, 3_210_000.0])  # far from 0, as maps are


def blocks(rng, count, spread):
    """Turned blocks, some with a court, some of two parts."""
    shapes = []
    for _ in range(count):
        width, depth = rng.uniform(1.5, 20, 2)
        block = shapely.box(-width / 2, -depth / 2, width / 2, depth / 2)
        if width > 8 and depth > 8:
            block = block.difference(shapely.box(-width / 4, -depth / 4, width / 4, depth / 4))
        elif width > 8:
            block = block.difference(shapely.box(-0.8, -depth, 0.8, depth))
        block = affinity.rotate(block, rng.uniform(0, 360))
        shapes.append(affinity.translate(block, *(CITY + rng.uniform(*spread, 2))))
    return np.array(shapes, dtype=object)


def columns_of(xy, top):
    i, j = np.floor((xy - CITY) / COLUMN_M).astype(int).T
    return top[j, i]


@pytest.mark.parametrize("seed", range(6))
def test_no_place_in_an_unbuilt_column_is_inside_a_footprint(seed):
    rng = np.random.default_rng(seed)
    shapes, heights = blocks(rng, 9, (-5, 55)), rng.uniform(2, 20, 9)
    footprints = footprints_of(shapes, heights, 8.0)
    top = solid_top(footprints, np.arange(len(footprints)), CITY, np.array([50.0, 50, 20]))
    anywhere = CITY + rng.uniform(0, 50, (20_000, 2))
    edges = [shapely.line_interpolate_point(s.boundary, rng.uniform(0, 1, 800), normalized=True) for s in shapes]
    near = shapely.get_coordinates(np.concatenate(edges)) + rng.uniform(-0.004, 0.004, (7200, 2))
    near = near[((near > CITY) & (near < CITY + 50)).all(axis=1)]
    for xy in (anywhere, near):
        highest = np.zeros(len(xy))
        for shape, height in zip(shapes, heights, strict=True):
            inside = shapely.contains_xy(shape, xy)
            highest[inside] = np.maximum(highest[inside], height)
        assert (columns_of(xy, top) >= highest - 1e-5).all()
    assert (columns_of(near, top) > 0).all()  # also within a few millimetres of the walls
    assert top.shape == (200, 200)
    assert top.dtype == np.float32


def test_columns_are_built_only_where_a_footprint_comes_close():
    rng = np.random.default_rng(11)
    shapes = blocks(rng, 6, (5, 45))
    footprints = footprints_of(shapes, np.full(6, 9.0), 8.0)
    top = solid_top(footprints, np.arange(len(footprints)), CITY, np.array([50.0, 50, 20]))
    rows, cols = np.nonzero(top)
    low = CITY + np.column_stack((cols, rows)) * COLUMN_M
    squares = shapely.box(*(low - 0.0051).T, *(low + COLUMN_M + 0.0051).T)
    assert shapely.intersects(squares, shapely.union_all(shapes)).all()
    courts = [
        shapely.Polygon(ring).centroid
        for shape in shapes
        for part in shapely.get_parts(shape)
        for ring in part.interiors
    ]
    courts = [court for court in courts if shapely.distance(shapely.union_all(shapes), court) > 1]
    assert courts
    assert (columns_of(shapely.get_coordinates(courts), top) == 0).all()


def test_nothing_built_costs_nothing():
    footprints = footprints_of(np.array([], dtype=object), np.array([]), 8.0)
    size = np.array([30.0, 30, 20])
    none = np.empty(0, dtype=np.int64)
    assert solid_top(footprints, none, CITY, size).tolist() == [[0.0]]
    assert sky_field(footprints, none, CITY, size, light_from(50, 0.5)).tolist() == [[[255]]]
    far = footprints_of(np.array([affinity.translate(shapely.box(500, 500, 510, 510), *CITY)]), np.array([9.0]), 8.0)
    assert solid_top(far, np.array([0]), CITY, size).shape == (1, 1)


def test_heights_unknown_are_those_of_the_config_and_none_is_none():
    shapes = np.array([affinity.translate(shapely.box(x, 2, x + 4, 6), *CITY) for x in (2, 10, 18)])
    footprints = footprints_of(shapes, np.array([np.nan, 0.0, 5.0]), 7.5)
    top = solid_top(footprints, np.arange(len(footprints)), CITY, np.array([30.0, 10, 20]))
    assert [float(columns_of(CITY + np.array([[x, 4.0]]), top)[0]) for x in (4, 12, 20)] == [7.5, 0.0, 5.0]


def test_a_column_that_a_wall_touches_is_built_whole():
    house = np.array([affinity.translate(shapely.Polygon([(5.1, 5.1), (15.1, 5.1), (15.1, 15.1), (5.1, 15.1)]), *CITY)])
    footprints = footprints_of(house, np.array([9.0]), 8.0)
    spots = CITY + np.array([[5.05, 10.0], [5.2, 8.2], [4.9, 10.0], [2.0, 2.0]])
    top = solid_top(footprints, np.array([0]), CITY, np.array([20.0, 20, 20]))
    assert columns_of(spots, top).tolist() == [9.0, 9.0, 0.0, 0.0]


def traced(shapes, tops, spot, light):
    """Return the share of light at a spot, ray by ray against exact prisms."""
    share = 0.0
    start = np.array(spot[:2])
    for ray, amount in zip(light.sky_ray.astype(float), light.sky_light.astype(float), strict=True):
        flat = np.hypot(*ray[:2])
        if flat > 1e-6:
            line = shapely.LineString([start, start + ray[:2] / flat * 150])
            entry = shapely.distance(shapely.Point(start), shapely.intersection(line, shapes))
            if (spot[2] + entry * ray[2] / flat < tops).any():  # no entry is NaN, and no shadow
                continue
        share += amount
    return share


@pytest.mark.parametrize("seed", range(3))
def test_sky_field_agrees_with_rays_traced_through_prisms(seed):
    rng = np.random.default_rng(seed)
    shapes, tops = blocks(rng, 10, (-30, 80)), rng.uniform(4, 14, 10)
    light = light_from(48.0, 0.5)
    footprints = footprints_of(shapes, tops, 8.0)
    sky = sky_field(footprints, np.arange(len(footprints)), CITY, np.array([50.0, 50, 16]), light)
    assert sky.shape == (16, 50, 50)
    built = shapely.union_all(shapes)
    found, true = [], []
    while len(found) < 250:
        k, j, i = rng.integers(0, (12, 50, 50))
        spot = np.array([*(CITY + (np.array([i, j]) + 0.5) * SKY_CELL_M), (k + 0.5) * SKY_CELL_M])
        if shapely.distance(built, shapely.Point(spot[:2])) > 1:
            found.append(sky[k, j, i] / 255)
            true.append(traced(shapes, tops, spot, light))
    error = np.array(found) - true
    assert np.std(true) > 0.04
    assert abs(error.mean()) < 0.01
    assert np.abs(error).mean() < 0.015
    assert np.abs(error).max() < 0.25
    assert np.corrcoef(found, true)[0, 1] > 0.97


def wall_at(offset, latitude):
    """Return the sky field around the frame's middle with a wall 4 m to one side of it."""
    middle = CITY + 20.5
    wall = affinity.translate(shapely.box(-15, -0.4, 15, 0.4), *(middle + np.array([0, offset])))
    if offset == 0:
        wall = affinity.translate(shapely.box(-4.4, -15, -3.6, 15), *middle)
    footprints = footprints_of(np.array([wall]), np.array([10.0]), 8.0)
    return (
        sky_field(footprints, np.array([0]), CITY, np.array([40.0, 40, 12]), light_from(latitude, 0.5))[:, 20, 20] / 255
    )


def test_a_wall_toward_the_sun_darkens_more():
    for latitude, sunny in ((50.0, -4), (-50.0, 4)):
        toward, away = wall_at(sunny, latitude), wall_at(-sunny, latitude)
        assert toward[1] < away[1] - 0.1
        assert away[1] < 0.95
    toward, away = wall_at(4, 0.0), wall_at(-4, 0.0)
    assert toward[1] == pytest.approx(away[1], abs=0.01)
    half_sun = wall_at(0, 50.0)[1]
    assert wall_at(-4, 50.0)[1] < half_sun < wall_at(4, 50.0)[1]


def test_light_grows_with_height_and_is_full_above_the_roofs():
    rng = np.random.default_rng(2)
    shapes = blocks(rng, 8, (0, 40))
    footprints = footprints_of(shapes, np.full(8, 8.0), 8.0)
    sky = sky_field(footprints, np.arange(len(footprints)), CITY, np.array([40.0, 40, 14]), light_from(50, 0.5))
    assert (np.diff(sky.astype(int), axis=0) >= 0).all()
    assert (sky[8:] == 255).all()
    assert sky[0].min() < 200


def test_buildings_beyond_the_frame_shade_it_and_the_far_do_not():
    size = np.array([30.0, 30, 15])
    light = light_from(50, 0.5)
    near = affinity.translate(shapely.box(0, -20, 30, -12), *CITY)
    far = affinity.translate(shapely.box(0, -90, 30, -75), *CITY)
    one = sky_field(footprints_of(np.array([near]), np.array([15.0]), 8.0), np.array([0]), CITY, size, light)
    all_of_them = footprints_of(np.array([far, near]), np.array([60.0, 15]), 8.0)
    both = sky_field(all_of_them, within_shade(all_of_them, np.arange(2), CITY, size, light), CITY, size, light)
    assert one[0, 2, 15] < 230
    assert one[0, 2, 15] < one[0, 27, 15]
    assert (one == both).all()


def test_a_mirrored_scene_has_a_mirrored_field():
    shape = shapely.Polygon([(-18, 3), (-9, 4), (-7, 12), (-15, 11)])
    size = np.array([40.0, 30, 10])
    fields = []
    for side in (1, -1):
        block = affinity.translate(affinity.scale(shape, side, 1, origin=(0, 0)), *(CITY + np.array([20, 0])))
        fields.append(
            sky_field(
                footprints_of(np.array([block]), np.array([9.0]), 8.0), np.array([0]), CITY, size, light_from(48, 0.5)
            )
        )
    assert np.abs(fields[0].astype(float) - fields[1][:, :, ::-1]).mean() < 0.5
