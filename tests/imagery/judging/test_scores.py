from __future__ import annotations

import numpy as np
import pytest

from urbanforest_cli.imagery.judging.scores import confusion, hard_truth, iou, score, tree_hits

SQUARE = np.zeros((10, 10), dtype=bool)
SQUARE[2:6, 2:6] = True  # 16 pixels
SHIFTED = np.roll(SQUARE, 2, axis=1)  # 8 of them shared
KNOWN = np.ones((10, 10), dtype=bool)


def test_two_squares_that_share_half_score_as_counted_by_hand():
    found = score(confusion(SHIFTED, SQUARE, KNOWN))
    assert found.pixels == 100
    assert found.iou == pytest.approx(8 / 24)
    assert found.f1 == pytest.approx(0.5)
    assert found.accuracy == pytest.approx(0.84)
    assert found.precision == found.recall == pytest.approx(0.5)
    assert found.truth_share == found.predicted_share == pytest.approx(0.16)
    assert found.bias == 0


def test_fields_are_not_mixed_up():
    smaller = SQUARE.copy()
    smaller[2] = False  # 12 of 16, none beside
    assert confusion(smaller, SQUARE, KNOWN).tolist() == [12, 0, 4, 84]
    assert confusion(SQUARE, smaller, KNOWN).tolist() == [12, 4, 0, 84]
    found = score(confusion(smaller, SQUARE, KNOWN))
    assert (found.precision, found.recall) == (1.0, 0.75)
    assert found.bias == pytest.approx(-0.04)


def test_unknown_pixels_count_nowhere():
    known = KNOWN.copy()
    known[:, 6:] = False
    assert confusion(SHIFTED, SQUARE, known).tolist() == [8, 0, 8, 44]


def test_where_nobody_sees_anything_there_is_no_ratio():
    nothing = np.zeros((4, 4), dtype=bool)
    found = score(confusion(nothing, nothing, ~nothing))
    assert (found.iou, found.f1, found.precision, found.recall) == (None, None, None, None)
    assert (found.accuracy, found.bias) == (1.0, 0.0)
    assert np.isnan(iou(np.array([0, 0, 0, 9])))
    assert score(np.zeros(4, dtype=np.int64)).accuracy is None


def test_truth_is_covered_from_half_on_and_unknown_is_neither():
    covered, known = hard_truth(np.array([[0, 49, 50, 100, 255]], dtype=np.uint8))
    assert covered.tolist() == [[False, False, True, True, False]]
    assert known.tolist() == [[True, True, True, True, False]]


def test_trees_are_on_near_or_off_the_covered_pixels():
    trees = np.array([[2.0, 2.0], [5.99, 5.99], [1.9, 3.5], [6.2, 6.2], [0.5, 3.5], [7.1, 3.0]])
    assert tree_hits(SQUARE, KNOWN, trees).tolist() == [6, 2, 4]


def test_trees_outside_the_image_or_where_nothing_is_known_are_left_out():
    known = KNOWN.copy()
    known[:, :4] = False
    trees = np.array([[-0.1, 5.0], [5.0, 10.0], [np.nan, 2.0], [3.0, 3.0], [3.0, 5.0]])
    assert tree_hits(SQUARE, known, trees).tolist() == [1, 1, 1]
    hidden = np.array([[3.0, 4.5]])
    left = SQUARE & (np.arange(10) < 4)
    assert tree_hits(left, known, hidden).tolist() == [1, 0, 0]


def test_no_tree_is_no_share():
    assert score(np.array([1, 1, 1, 1]), np.array([0, 0, 0])).trees_on is None
    assert tree_hits(SQUARE, KNOWN, np.empty((0, 2))).tolist() == [0, 0, 0]
