from __future__ import annotations

import sys

import numpy as np
import pytest

from urbanforest_cli.core.errors import ConfigError, InputError
from urbanforest_cli.imagery.judging import baselines
from urbanforest_cli.imagery.judging.baselines import BINS, AllCovered, BaselineTraining, best_threshold
from urbanforest_cli.imagery.judging.pixel_features import NAMES, excess_green, pixel_features

RESOLUTION_M = (0.6, 0.6)


def scene(seed: int, side: int = 48) -> tuple[np.ndarray, np.ndarray]:
    """Return an image of a green, rough crown and a green, smooth lawn on gray, and the truth: crown, and both."""
    rng = np.random.default_rng(seed)
    rgb = np.full((3, side, side), 120.0) + rng.normal(0, 3, (1, side, side))
    crown, lawn = np.zeros((side, side), bool), np.zeros((side, side), bool)
    crown[6:24, 6:24] = True
    lawn[28:44, 8:40] = True
    rgb[:, lawn] = np.array([[80.0], [140.0], [70.0]])
    rgb[:, crown] = np.array([[80.0], [140.0], [70.0]]) * rng.uniform(0.4, 1.6, crown.sum())
    truth = np.stack([crown, crown | lawn]) * np.uint8(100)
    return np.clip(np.round(rgb), 0, 255).astype(np.uint8), truth


def train(seeds=(1, 2), seed: int = 0, order: int = 1) -> BaselineTraining:
    training = BaselineTraining(("canopy", "vegetation"), len(seeds), seed)
    for number in list(seeds)[::order]:
        rgb, truth = scene(number)
        training.add(f"tile{number}", rgb, np.ones(rgb.shape[1:], bool), truth, RESOLUTION_M)
    return training


def overlap(predicted: np.ndarray, truth: np.ndarray) -> float:
    return (predicted & (truth >= 50)).sum() / (predicted | (truth >= 50)).sum()


def test_excess_green_is_that_of_chromaticities():
    rgb = np.array([[50, 0, 0, 200, 7], [100, 255, 0, 0, 7], [50, 0, 0, 200, 7]], np.uint8).reshape(3, 1, 5)
    assert excess_green(rgb)[0] == pytest.approx([0.5, 2.0, 0.0, -1.0, 0.0])


def test_threshold_is_the_best_of_all():
    rng = np.random.default_rng(5)
    without, covered = rng.integers(0, 20, BINS), rng.integers(0, 20, BINS) * (np.arange(BINS) > 1000)
    found = best_threshold(without, covered)
    slow = [covered[i:].sum() / (covered.sum() + without[i:].sum()) for i in range(BINS)]
    assert found == pytest.approx(-1 + 3 * int(np.argmax(slow)) / BINS)


def test_greenness_finds_vegetation_but_takes_lawns_for_trees():
    index = train().green_index()
    rgb, truth = scene(9)
    crown, green = index.covered(rgb, RESOLUTION_M)
    assert overlap(green, truth[1]) > 0.99
    assert overlap(crown, truth[0]) < 0.5


def test_texture_tells_trees_from_lawns():
    pytest.importorskip("sklearn")
    rgb, truth = scene(9)
    crown, green = train().boosted_pixels().covered(rgb, RESOLUTION_M)
    assert overlap(crown, truth[0]) > 0.85
    assert overlap(green, truth[1]) > 0.95


def test_what_is_learnt_hangs_on_no_order():
    pytest.importorskip("sklearn")
    values = pixel_features(scene(9)[0], RESOLUTION_M).reshape(-1, len(NAMES))
    there, back = train((1, 2, 3)), train((1, 2, 3), order=-1)
    assert there.green_index() == back.green_index()
    shares = [one.boosted_pixels().classifiers[0].predict_proba(values) for one in (there, back)]
    assert np.array_equal(*shares)


def test_unknown_and_empty_pixels_teach_nothing(monkeypatch):
    monkeypatch.setattr(baselines, "SAMPLED_PX", 10**6)
    training = BaselineTraining(("canopy",), 1, 0)
    rgb, truth = scene(1)
    truth = truth[:1].copy()
    truth[:, 30:] = 255
    valid = np.ones(rgb.shape[1:], bool)
    valid[:3] = False
    training.add("a", rgb, valid, truth, RESOLUTION_M)
    assert training._hits.sum() == 27 * 48
    assert training._hits[0, 1].sum() == 18 * 18
    assert len(training._drawn["a"][0]) == 27 * 48
    training.add("b", rgb, np.zeros_like(valid), truth, RESOLUTION_M)
    assert training._hits.sum() == 27 * 48


def test_a_class_that_is_nowhere_or_everywhere_is_refused():
    training = BaselineTraining(("canopy",), 1, 0)
    rgb, truth = scene(1)
    training.add("a", rgb, np.ones(rgb.shape[1:], bool), np.zeros_like(truth[:1]), RESOLUTION_M)
    with pytest.raises(InputError, match="baselines cannot learn canopy"):
        training.green_index()


def test_without_scikit_learn_the_command_that_installs_it_is_named(monkeypatch):
    monkeypatch.setitem(sys.modules, "sklearn.ensemble", None)
    with pytest.raises(ConfigError, match=r"pip install 'urbanforest\[train\]'"):
        train().boosted_pixels()


def test_everything_is_everything():
    assert AllCovered(2).covered(np.zeros((3, 4, 5), np.uint8), RESOLUTION_M).shape == (2, 4, 5)
    assert AllCovered(2).covered(np.zeros((3, 4, 5), np.uint8), RESOLUTION_M).all()


def test_features_are_those_named_and_finite_even_in_black():
    rgb, _ = scene(1)
    values = pixel_features(rgb, RESOLUTION_M)
    assert values.shape == (48, 48, len(NAMES))
    assert np.isfinite(pixel_features(np.zeros_like(rgb), RESOLUTION_M)).all()
    rough = values[..., NAMES.index("roughness, 4.2 m")]
    assert rough[10:20, 10:20].min() > 5 * rough[32:40, 14:34].max()


def test_windows_are_metres_whatever_the_pixels():
    rgb, _ = scene(1)
    fine = np.repeat(np.repeat(rgb, 3, axis=1), 3, axis=2)
    coarse_values, fine_values = pixel_features(rgb, (0.6, 0.6)), pixel_features(fine, (0.2, 0.2))[1::3, 1::3]
    inside = (slice(12, -12), slice(12, -12))
    assert np.allclose(coarse_values[inside], fine_values[inside], atol=1e-4)
