import numpy as np
import pytest
from scipy import ndimage

from urbanforest_cli.core.distance_kernel import FAR, distances_to, label, squared_distances


def patches(seed, share=0.5):
    rng = np.random.default_rng(seed)
    return ndimage.gaussian_filter(rng.normal(size=(57, 83)), 1.5) > np.quantile([0.0], share) + 0.05


@pytest.mark.parametrize("seed", range(4))
def test_distances_are_exact(seed):
    targets = patches(seed)
    found = np.empty(targets.shape, np.float32)
    distances_to(targets, found)
    np.testing.assert_allclose(found, ndimage.distance_transform_edt(~targets), rtol=1e-6)


def test_distances_to_one_target_and_to_none():
    targets = np.zeros((9, 7), bool)
    found = np.empty(targets.shape, np.float32)
    distances_to(targets, found)
    assert (found == FAR).all()
    targets[8, 0] = True
    distances_to(targets, found)
    assert found[0, 6] == pytest.approx(10.0)


@pytest.mark.parametrize("seed", range(4))
def test_parts_are_those_of_eight_neighbours(seed):
    mask = patches(seed)
    labels = np.empty(mask.shape, np.int32)
    count = label(mask, labels, np.empty(mask.size, np.int64))
    true, true_count = ndimage.label(mask, np.ones((3, 3)))
    assert count == true_count
    np.testing.assert_array_equal(labels, true)


@pytest.mark.parametrize("share", [0.02, 0.5, 0.98])
@pytest.mark.parametrize("shape", [(1, 1), (1, 40), (40, 1), (37, 53)])
def test_squared_distances_are_whole_numbers(shape, share):
    targets = np.random.default_rng(5).random(shape) < share
    targets[-1, 0] = True
    found = np.empty(shape)
    squared_distances(targets, float(sum(shape)), found)
    np.testing.assert_array_equal(found, np.round(ndimage.distance_transform_edt(~targets) ** 2))


def test_squared_distances_where_all_or_nothing_is_a_target():
    found = np.empty((6, 9))
    squared_distances(np.zeros((6, 9), np.uint8), 15.0, found)
    assert (found == 15.0**2).all()
    squared_distances(np.ones((6, 9), np.uint8), 15.0, found)
    assert (found == 0).all()
