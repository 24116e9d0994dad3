"""The plan's warp bends streets and folds nothing."""

from __future__ import annotations

import numpy as np

from urbanforest_cli.core.randomness import rng_for
from urbanforest_cli.synth.plan import make_plan


def test_the_warp_keeps_orientation_and_nearly_keeps_lengths() -> None:
    for seed in range(5):
        warp = make_plan(2000, 800.0, rng_for(seed, "synth", "plan")).warp
        xy = rng_for(seed, "test", "points").uniform(-1000, 1000, (500, 2))
        step = 0.01
        along_x = (warp(xy + np.array([step, 0.0])) - warp(xy)) / step
        along_y = (warp(xy + np.array([0.0, step])) - warp(xy)) / step
        turn = along_x[:, 0] * along_y[:, 1] - along_x[:, 1] * along_y[:, 0]
        assert turn.min() > 0.6
        assert np.abs(np.hypot(*along_x.T) - 1).max() < 0.25


def test_districts_do_not_overlap_and_their_lots_stay_inside() -> None:
    plan = make_plan(2000, 800.0, rng_for(1, "synth", "plan"))
    for number, cell in enumerate(plan.cells):
        assert plan.regions[number].within(cell)
        for other in plan.cells[number + 1 :]:
            assert cell.intersection(other).area < 1.0
