import numpy as np
import pytest
import shapely

from urbanforest_cli.export.sheet_places import densest_places

SQUARE = shapely.box(0, 0, 1000, 1000)


def clump(x, y, count, seed=0):
    return np.random.default_rng(seed).uniform(-10, 10, (count, 2)) + np.array([x, y])


def test_the_fullest_places_come_first_and_do_not_overlap():
    xy = np.concatenate((clump(200, 200, 50), clump(700, 300, 80), clump(715, 330, 40), clump(500, 800, 20)))
    found = densest_places(xy, SQUARE, 100.0, 3)
    assert len(found) == 3
    inside = [(np.abs(xy - place) <= 50).all(axis=1).sum() for place in found]
    assert inside == [120, 50, 20]
    apart = np.abs(found[:, None] - found[None]).max(axis=2)[~np.eye(3, dtype=bool)]
    assert apart.min() >= 100


def test_places_lie_within_what_is_known_where_they_can():
    xy = np.concatenate((clump(20, 500, 100), clump(600, 600, 40)))
    (found,) = densest_places(xy, shapely.box(20, 0, 1000, 1000), 100.0, 1)
    assert np.abs(found - (600, 600)).max() <= 50
    narrow = shapely.box(580, 590, 620, 610)
    (found,) = densest_places(xy, narrow, 100.0, 1)
    assert np.abs(found - (600, 600)).max() <= 50


@pytest.mark.parametrize("xy", [np.zeros((0, 2)), np.array([[5000.0, 5000.0]])])
def test_without_plants_the_middle_is_shown(xy):
    assert densest_places(xy, SQUARE, 100.0, 3).tolist() == [[500.0, 500.0]]


def test_one_plant_is_one_place():
    found = densest_places(np.array([[333.0, 444.0]]), SQUARE, 100.0, 3)
    assert (np.abs(found - (333, 444)) <= 50).all()
    assert len(found) >= 1
