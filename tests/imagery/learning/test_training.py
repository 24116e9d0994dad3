"""Losses, steps, norms and the state that goes on, on networks of a few thousand weights."""

from __future__ import annotations

from dataclasses import replace
from fractions import Fraction

import numpy as np
import pytest

from tests.imagery.learning.pairs import Discs

torch = pytest.importorskip("torch")

from urbanforest_cli.core.training import Machine, find_machine, pack, settled, unpack  # noqa: E402
from urbanforest_cli.imagery.learning import training  # noqa: E402
from urbanforest_cli.imagery.learning.augment import Batch, CropSource  # noqa: E402
from urbanforest_cli.imagery.learning.settings import PIX2PIX, SMALL  # noqa: E402
from urbanforest_cli.imagery.learning.tiles import Tiles  # noqa: E402
from urbanforest_cli.imagery.learning.training import Trainer  # noqa: E402

CPU = Machine("cpu", False, 1)
TINY = replace(SMALL, filters=4, downs=3, crop_px=32, load_px=32, batch=4, epochs=4)
TINY_PIX2PIX = replace(PIX2PIX, filters=2, downs=6, crop_px=64, load_px=64, epochs=4)


def tiles_of(count=4, **what):
    return Tiles(Discs(count=count, **what), range(count), 0.6, Fraction(1))


def trainer_of(settings=TINY, machine=CPU, **what):
    tiles = tiles_of(**what)
    source = CropSource(tiles, [tiles.look(place) for place in range(len(tiles))], settings)
    return Trainer(settings, 2, source, machine)


def same(first, second):
    return first.keys() == second.keys() and all(torch.equal(first[name], second[name]) for name in first)


def quiet(step):
    pass


@pytest.mark.parametrize("settings", [TINY, TINY_PIX2PIX, replace(TINY, loss="l1+gan")])
@pytest.mark.parametrize("bf16", [False, True])
def test_gone_on_from_a_state_ends_in_the_same_weights(settings, bf16):
    machine = replace(CPU, bf16=bf16)
    with settled(machine):
        whole, broken = trainer_of(settings, machine), trainer_of(settings, machine)
        for epoch in range(2):
            whole.run_epoch(epoch, quiet)
            whole.settle_norms()
        broken.run_epoch(0, quiet)
        broken.settle_norms()
        content = pack(broken.state())
        torch.manual_seed(99)  # another process has other random numbers
        again = trainer_of(settings, machine)
        again.take_state(unpack(content))
        again.run_epoch(1, quiet)
        again.settle_norms()
    assert same(whole.weights(), again.weights())
    assert not same(whole.weights(), broken.weights())


def test_the_same_seed_gives_the_same_weights_and_another_others():
    with settled(CPU):
        made = [trainer_of(replace(TINY, seed=seed)) for seed in (1, 1, 2)]
        for trainer in made:
            trainer.run_epoch(0, quiet)
    assert same(made[0].weights(), made[1].weights())
    assert not same(made[0].weights(), made[2].weights())


@pytest.mark.parametrize(
    "settings", [replace(TINY, loss="bce"), replace(TINY, loss="l1"), replace(TINY_PIX2PIX, batch=4)]
)
def test_unknown_truth_teaches_nothing(settings):
    """Two batches that differ only where nothing is known move the weights alike."""
    side = settings.crop_px
    images = np.random.default_rng(0).uniform(-1, 1, (4, 3, side, side)).astype(np.float32)
    truths = np.random.default_rng(1).integers(0, 101, (4, 2, side, side)).astype(np.uint8)
    truths[:, :, : side // 2] = 255
    with settled(CPU):
        trainer = trainer_of(settings)
        losses = trainer._step(Batch(images, truths))
    main = losses[settings.loss.partition("+")[0]]
    with torch.no_grad():
        fresh = trainer_of(settings).network.train()
        torch.manual_seed(0)
        probability = fresh.probability(fresh(torch.from_numpy(images)))[:, :, side // 2 :]
    share = torch.from_numpy(truths[:, :, side // 2 :] / np.float32(100))
    if settings.loss == "bce":
        assert main == pytest.approx(torch.nn.functional.binary_cross_entropy(probability, share).item(), rel=1e-4)
    elif settings.preset == "small":  # dropout aside
        assert main == pytest.approx(2 * (probability - share).abs().mean().item(), rel=1e-4)
    else:
        assert main == pytest.approx(2 * (probability - share).abs().mean().item(), rel=0.05)


def test_cross_entropy_of_pix2pix_is_that_of_its_probability():
    settings = replace(TINY_PIX2PIX, loss="bce")
    raw = torch.linspace(-0.999, 0.999, 50)[None, None, None]
    share = torch.linspace(0, 1, 50)[None, None, None]
    expected = torch.nn.functional.binary_cross_entropy((raw + 1) / 2, share, reduction="none")
    torch.testing.assert_close(training._cross_entropy(settings, raw, share), expected, rtol=1e-3, atol=1e-4)
    certain = training._cross_entropy(settings, torch.tensor([1.0, -1.0]), torch.tensor([0.0, 1.0]))
    assert torch.isfinite(certain).all()


def test_the_discriminator_learns_in_its_own_step_alone():
    with settled(CPU):
        trainer = trainer_of(TINY_PIX2PIX)
        judge, before = trainer._judge, trainer.weights()
        steps, own = [], []
        judge_step = trainer._judge_optimiser.step

        def watched_judge(*args, **kwargs):
            own[:] = [value.grad.clone() for value in judge.parameters()]
            return judge_step(*args, **kwargs)

        trainer._judge_optimiser.step = watched_judge
        step = trainer._optimiser.step

        def watched(*args, **kwargs):
            steps.append(
                all(torch.equal(value.grad, before) for value, before in zip(judge.parameters(), own, strict=True))
            )
            kept = {name: value.clone() for name, value in judge.state_dict().items() if "running" not in name}
            result = step(*args, **kwargs)
            assert all(torch.equal(judge.state_dict()[name], value) for name, value in kept.items())
            return result

        first = {name: value.clone() for name, value in judge.named_parameters()}
        trainer._optimiser.step = watched
        losses = trainer.run_epoch(0, quiet)
    assert set(losses) == {"l1", "gan", "judge"}
    assert steps == [True] * len(steps) != []
    assert any(not torch.equal(value, first[name]) for name, value in judge.named_parameters())
    assert not same(before, trainer.weights())
    assert all(value.requires_grad for value in judge.parameters())


def test_pix2pix_learns_by_the_published_optimisers():
    with settled(CPU):
        trainer = trainer_of(TINY_PIX2PIX)
        trainer.run_epoch(0, quiet)
    for optimiser in (trainer._optimiser, trainer._judge_optimiser):
        assert type(optimiser) is torch.optim.Adam
        assert optimiser.param_groups[0]["lr"] == 2e-4
        assert optimiser.param_groups[0]["betas"] == (0.5, 0.999)
        assert optimiser.param_groups[0]["weight_decay"] == 0


def test_norms_are_settled_on_the_network_as_it_is():
    """After a few steps the running statistics are far off; settled, use comes near to what training sees."""
    with settled(CPU):
        trainer = trainer_of(replace(TINY, jitter=None, batch=16), count=8)
        trainer.run_epoch(0, quiet)
        batch = torch.from_numpy(trainer._source.plain_batch(0, 16).images)
        network = trainer.network

        def in_use():
            with torch.no_grad():
                return network.eval()(batch)

        lagging = in_use()
        trainer.settle_norms()
        used = in_use()
        assert not network.training
        with torch.no_grad():
            seen = network.train()(batch)
    assert (used - seen).abs().mean() < 0.5 * (lagging - seen).abs().mean()


def test_settled_statistics_are_those_of_training_images_in_true_colours():
    with settled(CPU):
        trainer = trainer_of()
        trainer.settle_norms()
    norm = next(module for module in trainer.network.modules() if isinstance(module, torch.nn.BatchNorm2d))
    images = np.concatenate([trainer._source.plain_batch(number, 4).images for number in range(64)])
    first = torch.nn.functional.conv2d(torch.from_numpy(images), trainer.network.stem[0].weight, padding=1)
    torch.testing.assert_close(norm.running_mean, first.mean((0, 2, 3)).detach(), rtol=1e-4, atol=1e-5)
    assert norm.momentum == 0.1


def test_use_has_no_randomness_and_no_regard_for_its_neighbours():
    with settled(CPU):
        trainer = trainer_of(TINY_PIX2PIX)
        trainer.run_epoch(0, quiet)
        trainer.settle_norms()
        tiles = tiles_of(4)
        together = [values for _, values in trainer.probabilities(tiles, exact=True)]
        alone = [next(iter(trainer.probabilities(tiles[place : place + 1], exact=True)))[1] for place in range(4)]
    for one, other in zip(together, alone, strict=True):
        np.testing.assert_allclose(one, other, atol=1e-5)


def test_tiles_of_several_sizes_are_validated_in_their_order():
    class Uneven(Discs):
        def __getitem__(self, index):
            pair = super().__getitem__(index)
            size = 64 - 16 * (index % 3 == 1)
            return replace(
                pair, rgb=pair.rgb[:, :size], valid=pair.valid[:size], truth=pair.truth[:, :size]
            )  # fmt: skip

    with settled(CPU):
        trainer = trainer_of()
        tiles = Tiles(Uneven(count=6), range(6), 0.6, Fraction(1))
        shapes = [(tile.name, values.shape) for tile, values in trainer.probabilities(tiles, exact=True)]
    assert [name for name, _ in shapes] == Uneven(count=6).names
    assert [shape[1] for _, shape in shapes] == [64, 48, 64, 64, 48, 64]


def test_discs_are_learnt_by_heart_within_seconds():
    settings = replace(TINY, epochs=40, filters=8)
    with settled(CPU):
        trainer = trainer_of(settings)
        for epoch in range(settings.epochs):
            losses = trainer.run_epoch(epoch, quiet)
        trainer.settle_norms()
        agreements = trainer.validate(tiles_of(), exact=True).agreements()
    assert losses["bce"] < 0.35
    assert min(agreement.iou for agreement in agreements) > 0.9


def test_settings_of_torch_are_put_back():
    threads = torch.get_num_threads()
    state = torch.random.get_rng_state()
    with settled(Machine("cpu", False, threads + 1)):
        assert torch.get_num_threads() == threads + 1
        assert torch.are_deterministic_algorithms_enabled()
        torch.rand(1)
    assert torch.get_num_threads() == threads
    assert not torch.are_deterministic_algorithms_enabled()
    assert torch.equal(torch.random.get_rng_state(), state)


def test_a_gpu_that_is_not_there_is_refused(monkeypatch):
    monkeypatch.setattr(torch.cuda, "is_available", lambda: False)
    assert find_machine("auto", "fp32", 2) == Machine("cpu", False, 2)
    assert find_machine("cpu", "bf16", 1).bf16
    with pytest.raises(ValueError, match="no GPU"):
        find_machine("cuda", "auto", 1)


@pytest.mark.parametrize("content", [b"", b"PK\x03\x04rubbish", b"\x80\x04N.", pack({"a": 1})[:-300]])
def test_rubbish_is_no_state(content):
    with pytest.raises(ValueError):  # noqa: PT011
        unpack(content)


def test_nothing_is_made_of_a_state_but_tensors_and_plain_values():
    import io

    class Trap:
        def __reduce__(self):
            return print, ("sprung",)

    stream = io.BytesIO()
    torch.save({"a": Trap()}, stream)
    with pytest.raises(ValueError, match=r"(?i)weights.only|unsupported|global"):
        unpack(stream.getvalue())
