from __future__ import annotations

import json

import numpy as np
import pytest

from urbanforest_cli.imagery.judging.results import Tile, judge, judge_tile

CLASSES = ("canopy", "vegetation")
VALID = np.ones((8, 8), bool)


def block(rows: int) -> np.ndarray:
    mask = np.zeros((8, 8), bool)
    mask[:rows] = True
    return mask


def tile(name: str, place: str, group: str, model_rows: int, other_rows: int, trees=None) -> Tile:
    """Judge bands of rows against a truth of four for canopy and six for vegetation."""
    truth = np.stack([block(4), block(6)]) * np.uint8(100)
    predictions = {"model": np.stack([block(model_rows)] * 2), "all": np.stack([block(other_rows)] * 2)}
    return judge_tile(name, place, group, predictions, truth, VALID, trees)


def test_tiles_are_added_up_before_they_are_divided():
    tiles = [tile("a1", "p", "a", 4, 8), tile("a2", "q", "a", 2, 8), tile("b1", "r", "b", 6, 8)]
    found = judge(tiles, CLASSES, ("model", "all"), seed=0)
    assert found.total["canopy"].scores["model"].iou == pytest.approx((4 + 2 + 4) / (4 + 4 + 6))
    assert found.total["canopy"].scores["all"].iou == pytest.approx(0.5)
    assert found.groups["a"]["canopy"].scores["model"].iou == pytest.approx(6 / 8)
    assert found.groups["b"]["vegetation"].scores["model"].iou == 1
    assert found.total["canopy"].tile_iou_median == pytest.approx(4 / 6)
    assert (found.total["canopy"].tiles, found.groups["a"]["canopy"].places) == (3, 2)


def test_one_place_has_no_interval_and_more_have_one_around_the_score():
    alone = judge([tile("a1", "p", "a", 4, 8), tile("a2", "p", "a", 2, 8)], CLASSES, ("model", "all"), seed=0)
    assert alone.total["canopy"].scores["model"].iou_low is None
    assert alone.total["canopy"].differences == []
    tiles = [tile(f"t{i}", f"p{i}", "a", 2 + i % 4, 8) for i in range(12)]
    many = judge(tiles, CLASSES, ("model", "all"), seed=0).total["canopy"]
    model = many.scores["model"]
    assert model.iou_low < model.iou < model.iou_high
    assert many.scores["all"].iou_low == many.scores["all"].iou_high == pytest.approx(0.5)
    (difference,) = many.differences
    assert difference.iou == pytest.approx(model.iou - 0.5)
    assert (difference.low, difference.high) == pytest.approx((model.iou_low - 0.5, model.iou_high - 0.5))


def test_trees_are_counted_for_truth_and_predictors_and_tiles_without_annotation_left_out():
    trees = np.array([[0.5, 1.0], [3.5, 2.0], [5.5, 2.0], [7.5, 2.0]])
    tiles = [tile("a", "p", "a", 3, 8, trees), tile("b", "q", "a", 3, 8)]
    found = judge(tiles, CLASSES, ("model", "all"), seed=0).total["canopy"]
    assert found.truth_trees_on == 0.5
    assert (found.scores["model"].trees, found.scores["model"].trees_on, found.scores["model"].trees_near) == (
        4,
        0.25,
        0.5,
    )
    assert found.scores["all"].trees_on == 1


def test_what_image_or_truth_do_not_know_counts_for_no_class_that_misses_it():
    truth = np.full((2, 8, 8), 100, np.uint8)
    truth[0, :2] = 255
    valid = VALID.copy()
    valid[:, 0] = False
    found = judge_tile("a", "p", "g", {"model": np.ones((2, 8, 8), bool)}, truth, valid, None)
    assert found.counts[0].sum(axis=1).tolist() == [6 * 7, 8 * 7]


def test_same_seed_same_intervals_and_groups_do_not_disturb_one_another():
    tiles = [tile(f"t{i}", f"p{i}", "ab"[i % 2], 2 + i % 5, 8) for i in range(12)]
    whole = judge(tiles, CLASSES, ("model", "all"), seed=4)
    only_b = judge([one for one in tiles if one.group == "b"], CLASSES, ("model", "all"), seed=4)
    assert whole.groups["b"] == only_b.groups["b"]
    assert judge(tiles[::-1], CLASSES, ("model", "all"), seed=4).total == whole.total


def test_bare_tiles_are_not_ranked_by_a_ratio_of_nothing():
    bare = judge_tile("bare", "z", "a", {"model": np.zeros((2, 8, 8), bool), "all": np.ones((2, 8, 8), bool)},
                      np.zeros((2, 8, 8), np.uint8), VALID, None)  # fmt: skip
    found = judge([bare, tile("a", "p", "a", 2, 8), tile("b", "q", "a", 4, 8)], CLASSES, ("model", "all"), seed=0)
    assert [one.name for one, _ in found.ranked("canopy")] == ["b", "a"]
    assert judge([bare], CLASSES, ("model", "all"), seed=0).ranked("canopy") == []


def test_record_is_plain_json_and_names_every_tile():
    tiles = [tile("a1", "p", "a", 4, 8, np.array([[1.0, 1.0]])), tile("a2", "q", "a", 2, 8)]
    record = json.loads(json.dumps(judge(tiles, CLASSES, ("model", "all"), seed=0).as_record(), allow_nan=False))
    assert [row["name"] for row in record["tiles"]] == ["a1", "a2"]
    assert record["tiles"][0]["canopy"]["trees_on"] == 1
    assert record["groups"]["a"]["canopy"]["scores"]["all"]["iou"] == 0.5
