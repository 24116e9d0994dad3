"""Lots stay on one side, and shares are those of the ranges that pairs are drawn from."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.regression.learning.pairs import squares
from urbanforest_cli.core.randomness import keys_for
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.designs import draw_pairs
from urbanforest_cli.regression.learning.samples import HIGH, LEVELS, LOW, parted, shares, spread_shares
from urbanforest_cli.regression.learning.settings import INFORMED


def test_no_lot_is_learnt_from_and_judged_by():
    parts = parted(squares(400), INFORMED)
    sets = [set(part.lot.tolist()) for part in (parts.training, parts.calibration, parts.validation)]
    assert [len(lots) for lots in sets] == [72, 8, 20]
    assert not sets[0] & sets[1] | sets[0] & sets[2] | sets[1] & sets[2]
    assert sum(len(part) for part in (parts.training, parts.calibration, parts.validation)) == 400


def test_parts_follow_from_seed_and_lot_whatever_the_order_of_pairs():
    pairs = squares(400)
    turned = parted(pairs.take(np.arange(400)[::-1].copy()), INFORMED)
    assert set(turned.validation.lot.tolist()) == set(parted(pairs, INFORMED).validation.lot.tolist())
    other = parted(pairs, replace(INFORMED, seed=1))
    assert set(other.validation.lot.tolist()) != set(turned.validation.lot.tolist())


def test_drawn_parameters_fill_the_range_evenly():
    drawn = draw_pairs(keys_for(3, "test", map(str, range(4000))))
    found = shares(drawn.values.astype(np.float32))
    assert found.min() >= 0.0
    assert found.max() <= 1.0 + 1e-6
    filled = spread_shares(found, np.random.default_rng(0).random((4000, 1), dtype=np.float32))
    for number in range(len(REGRESSED)):
        counts = np.histogram(filled[:, number], 6, (0, 1))[0]
        assert counts.min() > 560, REGRESSED[number]


def test_whole_numbers_keep_their_part_and_others_stay():
    values = np.array([[2.0, 1.0, 0.5, 1.0, 4.0, count] for count in range(6)], np.float32)
    for within in (0.001, 0.999):
        moved = spread_shares(shares(values), np.full((6, 1), within, np.float32))
        assert np.floor(6 * moved[:, 5]).tolist() == [0, 1, 2, 3, 4, 5]
        assert moved[:, :5] == pytest.approx(shares(values)[:, :5])
    assert (LEVELS > 0).tolist() == [False] * 5 + [True]
    assert (LOW[2], HIGH[2]) == (0.05, 1.0)
