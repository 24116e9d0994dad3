"""Losses, steps and the state that goes on."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.regression.learning.pairs import squares

torch = pytest.importorskip("torch")

from urbanforest_cli.core.training import Machine, pack, settled, unpack  # noqa: E402
from urbanforest_cli.regression.learning.settings import INFORMED, PAPER  # noqa: E402
from urbanforest_cli.regression.learning.settle import figures, said_of  # noqa: E402
from urbanforest_cli.regression.learning.training import Trainer  # noqa: E402

CPU = Machine("cpu", False, 1)
TINY = replace(INFORMED, dense=(16, 8), members=2, bins=4, batch=32, epochs=4)
TINY_PAPER = replace(PAPER, batch=32, epochs=4)


def quiet(step):
    pass


def same(first, second):
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


@pytest.mark.parametrize("settings", [TINY, TINY_PAPER])
def test_gone_on_from_a_state_ends_in_the_same_weights(settings):
    with settled(CPU):
        whole, broken = (Trainer(settings, squares(128, features=8)) for _ in range(2))
        whole.run_epoch(0, quiet)
        whole.run_epoch(1, quiet)
        broken.run_epoch(0, quiet)
        content = pack(broken.state())
        torch.manual_seed(99)  # another process has other random numbers
        again = Trainer(settings, squares(128, features=8))
        again.take_state(unpack(content))
        again.run_epoch(1, quiet)
    assert same(whole.weights(), again.weights())
    assert not same(whole.weights(), broken.weights())


def test_the_same_seed_gives_the_same_weights_and_another_others():
    with settled(CPU):
        made = [Trainer(replace(TINY, seed=seed), squares(128, features=8)) for seed in (1, 1, 2)]
        for trainer in made:
            trainer.run_epoch(0, quiet)
    assert same(made[0].weights(), made[1].weights())
    assert not same(made[0].weights(), made[2].weights())


@pytest.mark.parametrize("settings", [TINY, TINY_PAPER, replace(TINY, loss="mse")])
def test_parameters_that_are_not_used_teach_nothing(settings):
    pairs = squares(128, features=8)
    values = np.where(pairs.used, pairs.values, np.float32(1.5))
    other = replace(pairs, values=values.astype(np.float32))
    with settled(CPU):
        first, second = Trainer(settings, pairs), Trainer(settings, other)
        losses = [trainer.run_epoch(0, quiet) for trainer in (first, second)]
        zero = [Trainer(replace(settings, unused="zero"), table) for table in (pairs, other)]
        taught = [trainer.run_epoch(0, quiet) for trainer in zero]
    assert losses[0] == losses[1]
    assert same(first.weights(), second.weights())
    assert taught[0] == taught[1]  # as 0, whatever they were
    assert taught[0] != losses[0]


def test_the_likelihood_does_not_move_the_means():
    with settled(CPU):
        trainer = Trainer(TINY, squares(128, features=8))
        losses = trainer._losses(np.arange(32), np.random.default_rng(0))
        losses["nll"].backward()
        last = [member[-1].bias.grad for member in trainer.network.members]
    for gradient in last:
        assert not gradient[:6].any()
        assert gradient[6:12].abs().min() > 0
        assert not gradient[12:].any()


def test_what_can_be_known_is_learnt_within_seconds():
    """The side of a square is its mean radius, the first feature its density; its shade tells the strategy."""
    settings = replace(TINY, epochs=12, dense=(32,), members=1, dropout=0.0, learning_rate=1e-2)
    pairs = squares(480, features=8)
    with settled(CPU):
        trainer = Trainer(settings, pairs)
        for epoch in range(settings.epochs):
            trainer.run_epoch(epoch, quiet)
        fresh = squares(300, seed=5, features=8)
        found = figures(trainer, fresh)
        said = said_of(trainer, fresh)
    assert found["r2"]["radius_mean_m"] > 0.9
    assert found["r2"]["density"] > 0.8
    assert found["r2"]["radius_variance_m2"] < 0.3
    assert found["strategies_right"] > 0.9
    spread = said.spreads.mean(axis=0)
    assert spread[0] < 0.5 * 9.0 * 12**-0.5
    assert spread[1] > 0.6 * 1.9 * 12**-0.5
    assert said.values[:, 0] == pytest.approx(fresh.values[:, 0], abs=2.0)


def test_fewer_pairs_than_a_batch_are_one_step():
    with settled(CPU):
        trainer = Trainer(TINY, squares(20, features=8))
        assert trainer.steps_an_epoch == 1
        assert np.isfinite(list(trainer.run_epoch(0, quiet).values())).all()
