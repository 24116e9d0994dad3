import numpy as np
import pytest
import shapely

from urbanforest_cli.placement.inside import inside_by_margin


def asked_of_shapely(polygons, site, xy, margin_m):
    points = shapely.points(xy)
    inside = shapely.contains(polygons[site], points)
    return inside & (shapely.distance(shapely.boundary(polygons)[site], points) >= margin_m)


@pytest.mark.parametrize("margin_m", [0.001, 0.5])
@pytest.mark.parametrize("offset_m", [0.0, 5_000_000.0])
def test_points_are_told_as_shapely_tells_them(margin_m, offset_m):
    rng = np.random.default_rng(0)
    outlines = [rng.uniform(0, 40, (n, 2)) for n in (3, 7, 20, 200, 4)]
    shapes = [shapely.make_valid(shapely.Polygon(outline)) for outline in outlines]
    shapes.append(shapely.Point(20, 20).buffer(18) - shapely.Point(22, 20).buffer(9))
    polygons = shapely.transform(np.array(shapes, dtype=object), lambda xy: xy + offset_m)
    site = np.repeat(np.arange(len(polygons)), 700)
    xy = rng.uniform(-1, 41, (len(site), 2)) + offset_m
    assert np.array_equal(
        inside_by_margin(polygons, site, xy, margin_m), asked_of_shapely(polygons, site, xy, margin_m)
    )


def test_points_on_corners_and_edges_and_level_with_corners():
    diamond = np.array([shapely.Polygon([(0, 0), (2, -2), (4, 0), (2, 2)])], dtype=object)
    xy = np.array([[2.0, 0], [1, 0], [-1, 0], [5, 0], [0, 0], [1, 1], [2, 2], [2, 1.9], [0.0015, 0]])
    found = inside_by_margin(diamond, np.zeros(len(xy), dtype=np.int64), xy)
    assert found.tolist() == [True, True, False, False, False, False, False, True, True]


def test_nothing_is_inside_nothing():
    empty = np.array([shapely.Polygon(), None], dtype=object)
    assert inside_by_margin(empty, np.array([0, 0, 1]), np.zeros((3, 2))).tolist() == [False] * 3
    assert len(inside_by_margin(empty, np.zeros(0, dtype=np.int64), np.zeros((0, 2)))) == 0
