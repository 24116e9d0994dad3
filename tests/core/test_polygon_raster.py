import numpy as np
import pytest
import shapely

from urbanforest_cli.core.polygon_raster import raster_shares, rings_of


def by_overlay(shape, x0, y_top, pixel_m, height, width):
    col, row = np.meshgrid(np.arange(width), np.arange(height))
    west, north = x0 + col * pixel_m, y_top - row * pixel_m
    cells = shapely.box(west, north - pixel_m, west + pixel_m, north)
    return shapely.area(shapely.intersection(cells, shape)) / pixel_m**2


def stars(count, seed=0):
    rng = np.random.default_rng(seed)
    turn = np.sort(rng.uniform(0, 2 * np.pi, (count, 24)), axis=1)
    reach = rng.uniform(1, 14, (count, 24))
    xy = np.stack((reach * np.cos(turn), reach * np.sin(turn)), axis=-1) + rng.uniform(-4, 4, (count, 1, 2))
    return np.asarray(shapely.polygons(xy))


@pytest.mark.parametrize("reverse", [False, True])
def test_shares_are_those_of_an_exact_overlay(reverse):
    shapes = shapely.make_valid(stars(25), method="structure", keep_collapsed=False)
    shapes[3] = shapely.difference(shapely.box(-9, -9, 9, 9), shapely.Point(0.3, 0.2).buffer(4))
    shapes[4] = shapely.union_all([shapely.box(-30, -30, -5, -2.5), shapely.box(1.1, 1.2, 30, 30)])
    if reverse:
        shapes = shapely.reverse(shapes)
    found = raster_shares(shapes, -8.0, 7.0, 0.7, 20, 23)
    for shape, shares in zip(shapes, found, strict=True):
        np.testing.assert_allclose(shares, by_overlay(shape, -8.0, 7.0, 0.7, 20, 23), atol=2e-6)


def test_a_far_away_place_loses_no_precision():
    shape = shapely.Point(0, 0).buffer(5)
    near = raster_shares(np.array([shape]), -6, 6, 0.5, 24, 24)
    moved = shapely.transform(shape, lambda xy: xy + np.array([500_000, 4_000_000]))
    far = raster_shares(np.array([moved]), 499_994, 4_000_006, 0.5, 24, 24)
    np.testing.assert_allclose(far, near, atol=1e-6)
    assert near.sum() * 0.25 == pytest.approx(shape.area, rel=1e-6)


def test_what_is_missing_empty_or_no_polygon_covers_nothing():
    shapes = np.array([None, shapely.Polygon(), shapely.Point(1, 1), shapely.box(0, 0, 2, 2)], dtype=object)
    found = raster_shares(shapes, 0, 4, 1, 4, 4)
    assert found[:3].sum() == 0
    assert found[3].sum() == 4
    assert raster_shares(np.array([], dtype=object), 0, 4, 1, 4, 4).shape == (0, 4, 4)


def test_of_a_collection_the_polygons_are_taken():
    mixed = shapely.GeometryCollection(
        [shapely.Point(0, 0), shapely.MultiPolygon([shapely.box(0, 0, 1, 1), shapely.box(2, 2, 3, 3)])]
    )
    rings = rings_of(np.array([mixed, shapely.box(0, 0, 1, 1)], dtype=object))
    assert rings.shape_offsets.tolist() == [0, 2, 3]


def test_each_shape_may_have_a_grid_of_its_own():
    shapes = np.array([shapely.box(0, 0, 2, 2), shapely.box(10, 10, 14, 14)], dtype=object)
    found = raster_shares(shapes, [0, 10], [2, 14], [1.0, 2.0], 2, 2)
    assert (found == 1).all()
