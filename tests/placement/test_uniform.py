import numpy as np
import shapely

from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.placement.uniform import uniform_points


def drawn(area, count):
    keys = keys_for(0, "t", ["lot"])
    owner, xy = uniform_points(np.array([area], dtype=object), keys, np.array([count]))
    assert (owner == 0).all()
    return xy


def test_points_fall_by_area_over_parts_and_never_into_holes():
    big = shapely.box(0, 0, 30, 10).difference(shapely.box(5, 2, 10, 8))
    small = shapely.box(50, 50, 60, 60)
    xy = drawn(shapely.MultiPolygon([big, small]), 6000)
    assert len(xy) == 6000
    assert shapely.contains_xy(shapely.union(big, small), xy[:, 0], xy[:, 1]).all()
    share = (xy[:, 0] > 40).mean()
    assert abs(share - small.area / (small.area + big.area)) < 0.02


def test_slivers_in_a_large_box_are_drawn_from_uniformly_too():
    sliver = shapely.LineString([(0, 0), (1000, 1000)]).buffer(0.05)
    xy = drawn(sliver, 500)
    assert len(xy) == 500
    along = xy.sum(axis=1) / 2000
    assert abs(along.mean() - 0.5) < 0.05
    assert abs(along.std() - 12**-0.5) < 0.03


def test_points_hang_on_the_lot_alone():
    areas = np.array([shapely.box(i * 10, 0, i * 10 + 8, 8) for i in range(5)], dtype=object)
    keys = keys_for(0, "t", list("abcde"))
    counts = np.array([3, 0, 1, 2, 4])
    owner, xy = uniform_points(areas, keys, counts)
    assert owner.tolist() == [0, 0, 0, 2, 3, 3, 4, 4, 4, 4]
    back, xy_back = uniform_points(areas[::-1], keys[::-1], counts[::-1])
    assert np.allclose(np.sort(xy[owner == 4], axis=0), np.sort(xy_back[back == 0], axis=0))


def test_empty_and_vanishing_areas_yield_nothing():
    areas = np.array([shapely.Polygon(), shapely.box(0, 0, 1e-4, 1e-4)], dtype=object)
    owner, _ = uniform_points(areas, keys_for(0, "t", ["a", "b"]), np.array([2, 2]))
    assert len(owner) == 0
