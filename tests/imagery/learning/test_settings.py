import itertools
from dataclasses import replace

import pytest

from urbanforest_cli.imagery.learning.settings import PIX2PIX, SMALL, Jitter, rate_at, settings_for


def test_pix2pix_is_as_published():
    shape = (PIX2PIX.filters, PIX2PIX.downs, PIX2PIX.batch, PIX2PIX.load_px, PIX2PIX.crop_px, PIX2PIX.epochs)
    assert shape == (64, 8, 1, 286, 256, 200)
    assert (PIX2PIX.loss, PIX2PIX.l1_weight, PIX2PIX.learning_rate, PIX2PIX.momentum) == ("l1+gan", 100.0, 2e-4, 0.5)
    assert (PIX2PIX.dihedral, PIX2PIX.jitter, PIX2PIX.weight_decay, PIX2PIX.patience_epochs) == (False, None, 0.0, 0)


def test_published_rate_is_constant_for_100_epochs_and_falls_in_100():
    steps = 7
    rates = [rate_at(PIX2PIX, epoch * steps + 3, steps)[0] for epoch in range(200)]
    assert rates[:100] == [2e-4] * 100
    falls = [before - after for before, after in itertools.pairwise(rates[99:])]
    assert falls == pytest.approx([2e-4 / 101] * 100)
    assert rates[-1] == pytest.approx(2e-4 / 101)


def test_one_cycle_is_that_of_torch():
    torch = pytest.importorskip("torch")
    settings, steps = replace(SMALL, epochs=6, learning_rate=0.01), 9
    parameter = torch.nn.Parameter(torch.zeros(1))
    optimiser = torch.optim.AdamW([parameter], 1e-3)
    schedule = torch.optim.lr_scheduler.OneCycleLR(optimiser, 0.01, 54, pct_start=settings.warm_up_fraction)
    for step in range(54):
        group = optimiser.param_groups[0]
        rate, momentum = rate_at(settings, step, steps)
        assert rate == pytest.approx(group["lr"], rel=1e-9)
        assert momentum == pytest.approx(group["betas"][0], rel=1e-9)
        optimiser.step()
        if step < 53:
            schedule.step()


def test_one_step_of_one_cycle_has_a_rate():
    assert 0.0 < rate_at(replace(SMALL, epochs=1), 0, 1)[0] <= SMALL.learning_rate


def test_a_crop_keeps_the_enlargement_of_its_preset():
    assert settings_for("pix2pix", crop_px=512).load_px == 572
    assert settings_for("small", crop_px=256).magnification == 1.0


def test_only_what_is_given_changes():
    assert settings_for("small", epochs=None, loss=None) == SMALL
    assert settings_for("small", epochs=3) == replace(SMALL, epochs=3)


def test_strength_and_transfer_of_colours():
    assert settings_for("small", jitter=0).jitter is None
    assert settings_for("small", jitter=2).jitter.gain == 2 * Jitter().gain
    assert settings_for("small", transfer=0.5).jitter == replace(Jitter(), transfer=0.5)
    alone = settings_for("pix2pix", transfer=0.5).jitter
    assert (alone.gain, alone.noise, alone.transfer) == (0.0, 0.0, 0.5)


def test_when_to_stop_decides_no_weight():
    assert replace(SMALL, patience=3).decisive() == SMALL.decisive()
    assert replace(SMALL, epochs=3).decisive() != SMALL.decisive()


def test_patience_is_a_quarter_of_the_epochs():
    assert [replace(SMALL, epochs=epochs).patience_epochs for epochs in (4, 20, 100)] == [5, 5, 25]


@pytest.mark.parametrize(
    ("changes", "word"),
    [
        ({"crop_px": 100}, "crop_px"),
        ({"epochs": 0}, "epochs"),
        ({"batch": 1, "crop_px": SMALL.multiple_px, "load_px": SMALL.multiple_px}, "batch"),
    ],
)
def test_faults_name_what_cannot_be(changes, word):
    faults = replace(SMALL, **changes).faults()
    assert len(faults) == 1
    assert word in faults[0]
    assert SMALL.faults() == PIX2PIX.faults() == []
