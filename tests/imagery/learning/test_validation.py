import numpy as np
import pytest

from urbanforest_cli.imagery.learning.validation import Tally, mean_iou


def counted(probability, truth):
    tally = Tally(len(truth))
    tally.add(np.asarray(probability, np.float32), np.asarray(truth, np.uint8))
    return tally


def test_scores_at_each_threshold_are_those_of_the_slow_way():
    rng = np.random.default_rng(0)
    truth = rng.choice(np.array([0, 30, 50, 100, 255], np.uint8), (2, 40, 50))
    probability = np.clip(rng.normal(truth / 130, 0.25), 0, 1).astype(np.float32)
    tally = counted(probability[:, :20], truth[:, :20])
    tally.add(probability[:, 20:], truth[:, 20:])
    for number in range(2):
        known = truth[number] != 255
        covered = (truth[number] >= 50)[known]
        for threshold in (0.1, 0.37, 0.5, 0.9):
            predicted = probability[number][known] >= np.float32(threshold)
            found = tally.at(number, threshold)
            union = (predicted | covered).sum()
            assert found.iou == pytest.approx((predicted & covered).sum() / union, abs=0.002)
            assert found.predicted_share == pytest.approx(predicted.mean(), abs=0.002)
            assert found.true_share == covered.mean()
        ious = [tally.at(number, step / 100).iou for step in range(10, 91)]
        assert tally.agreements()[number].iou == max(ious)


def test_of_equal_thresholds_the_middle_one_is_taken():
    truth = np.array([[[0, 0, 100, 100]]])
    assert counted([[[0.02, 0.05, 0.97, 0.99]]], truth).agreements()[0].threshold == 0.5


def test_certain_pixels_count_too():
    best = counted([[[1.0, 0.0]]], [[[100, 0]]]).agreements()[0]
    assert (best.iou, best.predicted_share, best.true_share) == (1.0, 0.5, 0.5)


def test_a_truth_without_cover_scores_nothing_and_does_not_fail():
    best = counted([[[0.2, 0.3]]], [[[0, 0]]]).agreements()
    assert best[0].iou == 0.0
    assert best[0].threshold == 0.5
    assert mean_iou(best) == 0.0


def test_unknown_pixels_count_nowhere():
    assert counted([[[0.9, 0.9]]], [[[255, 255]]]).counts.sum() == 0
