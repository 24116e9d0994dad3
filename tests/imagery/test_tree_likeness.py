"""The classifier that tells trees from lawns."""

import numpy as np
import pytest

from urbanforest_cli.imagery.tree_likeness import CLOSE_FEATURES, Examples, fit_likeness, fit_looks, tree_features


def two_clouds(count, shift, seed, spread=1.0):
    rng = np.random.default_rng(seed)
    is_tree = np.arange(count) % 2 == 0
    features = rng.normal(0, spread, (count, 3)) + np.where(is_tree[:, None], shift, -shift) * np.array([1, 0, 0.5])
    return Examples(features.astype(np.float32), is_tree, is_tree & (np.arange(count) % 4 == 0))


def test_clouds_apart_are_told_apart_and_even_odds_lie_between():
    known = fit_likeness({"a": two_clouds(2000, 1.5, 1)})["a"]
    other = two_clouds(2000, 1.5, 2)
    right = (known.logit(other.features) > 0) == other.is_tree
    assert right.mean() > 0.9
    assert abs(float(known.logit(np.zeros((1, 3), np.float32))[0])) < 1.0


def test_frequency_of_trees_does_not_move_the_odds():
    even = two_clouds(6000, 1.0, 3)
    kept = np.r_[0:1200:2, 1:6000:2]
    rare = Examples(even.features[kept], even.is_tree[kept], even.is_stem[kept])
    middle = np.zeros((1, 3), np.float32)
    assert abs(float(fit_likeness({"a": rare})["a"].logit(middle)[0])) < 0.6


def test_logit_is_the_sum_that_was_fitted():
    from urbanforest_cli.imagery.tree_likeness import _terms

    known = fit_likeness({"a": two_clouds(3000, 0.4, 4)})["a"]
    probe = np.random.default_rng(5).normal(0, 2, (50, 3)).astype(np.float32)
    expected = np.clip(_terms((probe - known.mean) / known.scale) @ known.weights, -6, 6)
    np.testing.assert_allclose(known.logit(probe), expected, atol=1e-3)


def test_group_with_few_examples_takes_what_is_common():
    large = two_clouds(4000, 1.0, 6)
    small = two_clouds(60, 1.0, 7)
    turned = Examples(small.features, ~small.is_tree, small.is_stem)
    known = fit_likeness({"large": large, "small": turned})
    probe = np.array([[3.0, 0.0, 1.5]], np.float32)
    assert known["small"].logit(probe)[0] > 1.0, "60 examples to the contrary change nothing"


def test_too_few_examples_tell_nothing():
    known = fit_likeness({"a": two_clouds(100, 3.0, 8), "empty": two_clouds(0, 1.0, 9)})
    assert set(known) == {"a"}
    assert not known["a"].weights.any()


def test_close_look_corrects_what_wide_windows_blur():
    rng = np.random.default_rng(11)
    count = 4000
    is_tree = np.arange(count) % 2 == 0
    features = rng.normal(0, 1, (count, 14)).astype(np.float32)
    features[:, 10] += np.where(is_tree, 2, -2)  # a wide window: the neighbourhood
    features[:, 2] += np.where(is_tree, 2, -2)  # the pixel itself
    look = fit_looks({"a": Examples(features, is_tree, is_tree)})["a"]
    lawn_beside_tree = np.zeros((1, 14), np.float32)
    lawn_beside_tree[0, 10], lawn_beside_tree[0, 2] = 2, -2
    assert look.logit(lawn_beside_tree)[0] < look.wide.logit(lawn_beside_tree)[0] - 0.5
    assert set(look.close.logit(features[:5, CLOSE_FEATURES]).shape) == {5}


def test_features_mean_the_same_at_every_resolution():
    rng = np.random.default_rng(10)
    coarse = rng.integers(40, 200, (4, 40, 40)).astype(np.uint8)
    fine = coarse.repeat(2, axis=1).repeat(2, axis=2)
    first = tree_features(coarse[:3], coarse[3], median_brightness=100.0, resolution_m=(0.6, 0.6))
    second = tree_features(fine[:3], fine[3], median_brightness=100.0, resolution_m=(0.3, 0.3))[::2, ::2]
    inner = slice(10, 30)
    off = np.abs(first - second)[inner, inner].mean(axis=(0, 1)) / first[inner, inner].std(axis=(0, 1))
    assert off.max() < 0.8


@pytest.mark.parametrize("value", [0, 255])
def test_features_of_flat_images_are_finite(value):
    flat = np.full((4, 8, 8), value, np.uint8)
    assert np.isfinite(tree_features(flat[:3], flat[3], median_brightness=0.0, resolution_m=(0.6, 0.6))).all()
