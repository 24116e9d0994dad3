from __future__ import annotations

import json

import numpy as np
import pytest

from urbanforest_cli.evaluation.agreement.plot import draw_agreement
from urbanforest_cli.evaluation.agreement.scores import score_agreement
from urbanforest_cli.evaluation.agreement.sets import PLACED, RANDOM
from urbanforest_cli.evaluation.agreement.tally import Tally

AREA = 100.0


def scored(covered, *, known=AREA, seed=0, **crowns):
    """Score lots of 100 m2; of each set (area under crowns, of that covered)."""
    covered = np.asarray(covered, dtype=float)
    known = np.broadcast_to(np.asarray(known, dtype=float), covered.shape)
    named = {name.replace("_", " "): np.asarray(value, dtype=float) for name, value in crowns.items()}
    areas = Tally(
        np.full(covered.shape, AREA), known, covered, covered,
        *({name: value[part] for name, value in named.items()} for part in (0, 0, 1)),
    )  # fmt: skip
    plants = {name: np.ones(covered.shape, dtype=np.int64) for name in named}
    return score_agreement(
        areas, plants, np.random.default_rng(seed), crowns="discs", threshold_percent=50.0, cell_m=0.6
    )


def test_crowns_that_cover_what_the_map_covers_score_full_marks():
    covered = np.arange(0, 50, 5.0)
    (placed,) = scored(covered, placed=(covered, covered)).sets
    for measure, value in (("error_mean", 0), ("near_share", 1), ("bias", 0), ("correlation", 1), ("iou", 1),
                           ("total_ratio", 1), ("percent_ratio", 1)):  # fmt: skip
        estimate = getattr(placed, measure)
        assert (estimate.value, estimate.low, estimate.high) == pytest.approx((value,) * 3), measure


def test_measures_are_those_reckoned_by_hand():
    covered = [20.0, 40.0, 0.0, 60.0]
    crown, both = [24.0, 30.0, 10.0, 60.0], [20.0, 25.0, 0.0, 50.0]
    (placed,) = scored(covered, placed=(crown, both)).sets
    error = (np.array(crown) - covered) / 100
    assert placed.error_mean.value == pytest.approx(np.abs(error).mean())
    assert placed.near_share.value == pytest.approx(0.5)
    assert placed.bias.value == pytest.approx(error.mean())
    assert placed.correlation.value == pytest.approx(np.corrcoef(covered, crown)[0, 1])
    assert placed.iou.value == pytest.approx(95 / (120 + 124 - 95))
    assert placed.total_ratio.value == pytest.approx(124 / 120)


def test_five_points_off_is_still_near():
    (placed,) = scored([20.0, 20.0, 20.0], placed=([25.0, 15.0, 25.1], [20.0, 15.0, 20.0])).sets
    assert placed.near_share.value == pytest.approx(2 / 3)


def test_lots_that_the_map_hardly_knows_are_left_out():
    found = scored([20.0, 20.0, 10.0], known=[100.0, 49.0, 50.0], placed=([20.0, 0.0, 10.0], [20.0, 0.0, 10.0]))
    assert (found.lots, found.lots_compared, found.lots_unknown) == (3, 2, 1)
    assert found.sets[0].error_mean.value == pytest.approx(0)
    assert found.shares.lot.tolist() == [0, 2]
    assert found.shares.covered.tolist() == pytest.approx([0.2, 0.2])


def test_intervals_hold_the_truth_about_as_often_as_they_say():
    rng = np.random.default_rng(5)
    held = 0
    for trial in range(100):
        covered = rng.uniform(10, 60, 60)
        crown = np.clip(covered + rng.normal(0, 10, 60), 0, 100)
        bias = scored(covered, seed=trial, placed=(crown, np.minimum(crown, covered))).sets[0].bias
        held += bias.low <= 0 <= bias.high
    assert 88 <= held <= 100


def test_a_gain_is_positive_where_the_placed_crowns_are_nearer_and_seen_through_noise():
    rng = np.random.default_rng(6)
    covered = rng.uniform(0, 60, 200)
    near, far = np.clip(covered + rng.normal(0, 3, 200), 0, 100), rng.permutation(covered)
    found = scored(covered, placed=(near, np.minimum(near, covered)), random=(far, near * 0.2))
    (gain,) = found.gains
    assert gain.over == RANDOM
    assert gain.error_mean.low > 0
    assert gain.iou.low > 0
    swapped = scored(covered, placed=(far, near * 0.2), random=(near, np.minimum(near, covered)))
    assert swapped.gains[0].error_mean.high < 0
    assert gain.error_mean.value == pytest.approx(-swapped.gains[0].error_mean.value)


def test_what_cannot_be_told_is_left_open():
    flat = scored([20.0] * 5, placed=([10.0] * 5, [10.0] * 5)).sets[0]
    assert flat.correlation.value is None
    bare = scored([0.0] * 5, placed=([0.0] * 5, [0.0] * 5)).sets[0]
    assert bare.iou.value is None
    assert bare.total_ratio.value is None
    assert bare.error_mean.value == 0
    alone = scored([20.0], placed=([10.0], [10.0])).sets[0]
    assert alone.error_mean.value == pytest.approx(0.1)
    assert alone.error_mean.low is None
    none = scored([20.0], known=[0.0], placed=([10.0], [10.0])).sets[0]
    assert none.error_mean.value is None


def test_records_are_plain_json_without_single_lots():
    found = scored([20.0, 30.0], placed=([10.0, 0.0], [10.0, 0.0]), random=([1.0, 2.0], [1.0, 2.0]))
    record = json.loads(json.dumps(found.as_record(), allow_nan=False))
    assert "shares" not in record
    assert [one["name"] for one in record["sets"]] == [PLACED, RANDOM]
    assert record["gains"][0]["iou"]["value"] is not None


def test_the_page_can_be_drawn_of_few_lots_and_of_none():
    for covered, known in (([20.0, 0.0], 100.0), ([0.0], 100.0), ([20.0], 0.0)):
        found = scored(covered, known=known, placed=(covered, covered))
        figure = draw_agreement(found, "town")
        assert len(figure.axes) == 3
        figure.canvas.draw()
