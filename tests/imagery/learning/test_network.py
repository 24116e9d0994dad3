"""The networks: Pix2Pix as published, the small one, and both in use."""

from __future__ import annotations

import numpy as np
import pytest

torch = pytest.importorskip("torch")

from urbanforest_cli.imagery.learning.network import (  # noqa: E402
    Generator,
    NetworkShape,
    PatchDiscriminator,
    SmallUnet,
    UnetGenerator,
    build_generator,
    frozen,
    parameter_count,
    probabilities,
)

TINY = (
    NetworkShape(kind="pix2pix", class_count=2, filters=3, downs=6),
    NetworkShape(kind="small", class_count=2, filters=3, downs=3),
)


def used(shape: NetworkShape, steps: int = 3) -> Generator:
    """Return a network whose norms have seen something."""
    network = build_generator(shape, seed=5)
    side = 2 * shape.multiple_px
    with torch.random.fork_rng():
        torch.manual_seed(6)
        for _ in range(steps):
            network(torch.randn(2, 3, side, side) * 3.0 + 1.0)
    return network


def images(rows: int, columns: int, batch: int = 1) -> torch.Tensor:
    return torch.from_numpy(np.random.default_rng(7).normal(size=(batch, 3, rows, columns)).astype(np.float32))


def nested(network: UnetGenerator, level: int, image: torch.Tensor) -> torch.Tensor:
    """Follow the generator as the release has it: each level holds the next, and passes its input on beside it."""
    inner = network.downs[level](image)
    if level < len(network.downs) - 1:
        inner = nested(network, level + 1, inner)
    if level == 0:
        return network.last(inner)
    return torch.cat([image, network.ups[len(network.downs) - 1 - level](inner)], 1)


def test_pix2pix_has_as_many_parameters_as_published() -> None:
    # Summed by hand from the release's layers; its own log says 54.414 M and 2.769 M.
    assert parameter_count(UnetGenerator(3, 3)) == 54_413_955
    assert parameter_count(UnetGenerator(3, 1)) == 54_409_857
    assert parameter_count(PatchDiscriminator(6)) == 2_768_705


def test_pix2pix_has_the_layers_as_published() -> None:
    network = UnetGenerator(3, 1)
    convolutions = [layer for layer in network.modules() if isinstance(layer, torch.nn.Conv2d)]
    transposed = [layer for layer in network.modules() if isinstance(layer, torch.nn.ConvTranspose2d)]
    assert [layer.out_channels for layer in convolutions] == [64, 128, 256, 512, 512, 512, 512, 512]
    assert [layer.in_channels for layer in transposed] == [512, 1024, 1024, 1024, 1024, 512, 256, 128]
    assert [layer.out_channels for layer in transposed] == [512, 512, 512, 512, 256, 128, 64, 1]
    for layer in convolutions + transposed:
        assert (layer.kernel_size, layer.stride, layer.padding) == ((4, 4), (2, 2), (1, 1))
    assert [layer.bias is not None for layer in convolutions + transposed] == [False] * 15 + [True]
    norms = [[type(layer).__name__ for layer in level].count("BatchNorm2d") for level in (*network.downs, *network.ups)]
    assert norms == [0, 1, 1, 1, 1, 1, 1, 0] + [1] * 7
    drops = [any(isinstance(layer, torch.nn.Dropout) for layer in up) for up in network.ups]
    assert drops == [False, True, True, True, False, False, False]


def test_pix2pix_gives_what_the_nested_blocks_of_the_release_give() -> None:
    network = used(TINY[0]).eval()
    assert isinstance(network, UnetGenerator)
    image = images(64, 128)
    assert torch.equal(network(image), nested(network, 0, image))


def test_pix2pix_starts_as_published() -> None:
    for network in (UnetGenerator(3, 1, 16), PatchDiscriminator(6)):
        for layer in network.modules():
            if isinstance(layer, (torch.nn.Conv2d, torch.nn.ConvTranspose2d)) and layer.weight.numel() > 5000:
                assert abs(float(layer.weight.detach().mean())) < 0.002
                assert float(layer.weight.detach().std()) == pytest.approx(0.02, rel=0.1)
            if isinstance(layer, torch.nn.BatchNorm2d):
                assert float(layer.weight.detach().mean()) == pytest.approx(1.0, abs=0.02)
            if getattr(layer, "bias", None) is not None:
                assert not layer.bias.detach().any()


def test_the_discriminator_judges_patches_of_70_pixels() -> None:
    image = torch.zeros(1, 6, 256, 256, requires_grad=True)
    logits = PatchDiscriminator(6, 4).eval()(image)
    assert logits.shape == (1, 1, 30, 30)
    logits[0, 0, 15, 15].backward()
    assert image.grad is not None
    seen = image.grad.abs().sum((0, 1)) > 0
    assert (int(seen.any(0).sum()), int(seen.any(1).sum())) == (70, 70)


@pytest.mark.parametrize("shape", TINY)
def test_the_size_stays_and_values_become_probabilities(shape: NetworkShape) -> None:
    network = used(shape).eval()
    rows, columns = shape.multiple_px, 3 * shape.multiple_px
    raw = network(images(rows, columns, 2)).detach()
    assert raw.shape == (2, 2, rows, columns)
    chance = network.probability(raw)
    assert float(chance.min()) >= 0.0
    assert float(chance.max()) <= 1.0
    assert float(chance.max() - chance.min()) > 0.01
    if shape.kind == "pix2pix":
        assert float(raw.abs().max()) <= 1.0
        assert torch.allclose(2.0 * chance - 1.0, raw, atol=1e-6)
    else:
        assert torch.allclose(torch.log(chance / (1.0 - chance)), raw, atol=1e-4)


@pytest.mark.parametrize("shape", TINY)
def test_same_seed_same_weights_and_the_global_stream_stays(shape: NetworkShape) -> None:
    before = torch.random.get_rng_state()
    first, second, other = (build_generator(shape, seed=seed).state_dict() for seed in (1, 1, 2))
    assert torch.equal(before, torch.random.get_rng_state())
    assert all(torch.equal(first[name], second[name]) for name in first)
    assert any(not torch.equal(first[name], other[name]) for name in first)


def test_a_shape_that_cannot_be_is_told_why() -> None:
    with pytest.raises(ValueError, match="downs must lie within 5 and 10"):
        build_generator(NetworkShape(kind="pix2pix", class_count=1, downs=4))
    with pytest.raises(ValueError, match=r"class_count .*; filters"):
        build_generator(NetworkShape(kind="small", class_count=0, filters=0, downs=3))


def test_dropout_draws_in_training_alone() -> None:
    network = used(TINY[0])
    image = images(128, 128, 2)
    assert not torch.equal(network(image), network(image))
    network.eval()
    assert torch.equal(network(image), network(image))


@pytest.mark.parametrize("shape", TINY)
def test_a_frozen_network_gives_the_same_without_norms_and_leaves_its_source_alone(shape: NetworkShape) -> None:
    network = used(shape).to(memory_format=torch.channels_last)
    state = {name: value.clone() for name, value in network.state_dict().items()}
    folded = frozen(network)
    assert not any(isinstance(layer, torch.nn.BatchNorm2d) for layer in folded.modules())
    assert any(isinstance(layer, torch.nn.BatchNorm2d) for layer in frozen(network, fold=False).modules())
    assert network.training
    assert not folded.training
    assert all(torch.equal(state[name], value) for name, value in network.state_dict().items())
    image = images(shape.multiple_px, 2 * shape.multiple_px).numpy()
    assert np.abs(probabilities(folded, image) - probabilities(network.eval(), image)).max() < 1e-5


@pytest.mark.parametrize("shape", TINY)
def test_each_network_learns_where_an_image_is_bright(shape: NetworkShape) -> None:
    network = build_generator(shape, seed=1)
    blocks = torch.from_numpy(np.random.default_rng(1).random((4, 1, 8, 8)).astype(np.float32))
    truth = (blocks > 0.5).float().repeat_interleave(16, 2).repeat_interleave(16, 3)  # (image, 1, 128, 128)
    optimiser = torch.optim.Adam(network.parameters(), 2e-2)
    with torch.random.fork_rng():
        torch.manual_seed(1)
        for _ in range(40):
            chance = network.probability(network((2.0 * truth - 1.0).expand(-1, 3, -1, -1)))
            loss = torch.nn.functional.binary_cross_entropy(chance.clamp(1e-4, 1 - 1e-4), truth.expand(-1, 2, -1, -1))
            optimiser.zero_grad()
            loss.backward()
            optimiser.step()
    assert float(((chance > 0.5) == (truth > 0.5)).float().mean()) > 0.97


def test_the_small_network_is_small() -> None:
    assert 2_000_000 < parameter_count(SmallUnet(2)) < 2_200_000
    assert NetworkShape(kind="small", class_count=2, filters=16, downs=5).multiple_px == 32
