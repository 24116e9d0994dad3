"""Sheets show what is there: truth in red, what is read in blue, at its place on the range."""

from __future__ import annotations

import io

import numpy as np
from PIL import Image

from tests.regression.learning.pairs import squares
from urbanforest_cli.regression.learning.samples import HIGH, LOW
from urbanforest_cli.regression.learning.sheets import READ, TRUTH, Said, chosen, coloured, sheet_png


def test_truth_and_reading_stand_where_they_are_on_the_range():
    pairs = squares(60)
    shown = pairs.take(chosen(pairs)[:1])
    shown.values[0] = LOW
    said = Said(np.array([HIGH]), np.full((1, 6), 0.01), np.array([[1.0, 0.0, 0.0]]))
    with Image.open(io.BytesIO(sheet_png(shown, said, LOW, HIGH, "title"))) as image:
        pixels = np.asarray(image.convert("RGB"))
    truth = np.flatnonzero((pixels == TRUTH).all(axis=2).any(axis=0))
    read = np.flatnonzero((pixels == READ).all(axis=2).any(axis=0))
    assert truth.max() < read.min()
    assert 140 <= read.mean() - truth.mean() <= 160
    rows = (pixels == READ).all(axis=2).any(axis=1)
    assert np.count_nonzero(np.diff(rows.astype(int)) == 1) == shown.used[0].sum()


def test_each_strategy_is_shown_always_by_the_same_pairs():
    pairs = squares(60)
    rows = chosen(pairs)
    assert pairs.strategy[rows].tolist() == [0] * 3 + [1] * 3 + [2] * 3
    assert np.array_equal(rows, chosen(pairs))


def test_crowns_lie_over_ground_and_buildings_over_neither():
    window = np.zeros((3, 1, 4), np.uint8)
    window[:, 0, :3] = np.array([[100, 0, 0], [100, 100, 0], [50, 50, 50]]).T[:, [0, 1, 2]].T
    colours = coloured(window)[0]
    assert len({tuple(colour) for colour in colours.tolist()}) == 4
