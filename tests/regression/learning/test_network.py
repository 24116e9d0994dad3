"""What networks are made of, what they look at, and what spreads mean."""

from __future__ import annotations

import numpy as np
import pytest
from scipy import stats

from tests.regression.learning.pairs import squares
from urbanforest_cli.core.parameter_input import network_input

torch = pytest.importorskip("torch")

from urbanforest_cli.regression.learning.network import (  # noqa: E402
    Encoding,
    InformedNetwork,
    beta_logarithm,
    frozen,
    parameter_count,
    readings,
)
from urbanforest_cli.regression.learning.samples import LEVELS  # noqa: E402
from urbanforest_cli.regression.learning.settings import INFORMED, PAPER  # noqa: E402
from urbanforest_cli.regression.learning.sureness import scaled_weight  # noqa: E402
from urbanforest_cli.regression.learning.training import build_network  # noqa: E402


def network_of(settings=INFORMED, pairs=None):
    pairs = squares() if pairs is None else pairs
    torch.manual_seed(1)
    return frozen(build_network(settings, pairs.features)), pairs


def read(network, pairs):
    return readings(network, network_input(pairs.windows, pairs.pixel_m), pairs.features)


def test_the_papers_network_is_five_convolutions_and_two_dense_layers_on_coverage_alone():
    network, pairs = network_of(PAPER)
    kinds = [type(layer).__name__ for layer in (*network.convolutions, *network.dense)]
    assert kinds == ["Conv2d", "ReLU"] * 5 + ["Flatten"] + ["Linear", "ReLU"] * 2 + ["Linear"]
    assert parameter_count(network) == 320 + 4 * 9248 + 128 * 64 + 64 + 64 * 64 + 64 + 64 * 6 + 6
    window = network_input(pairs.windows[:4], pairs.pixel_m[:4])
    other = window.copy()
    other[:, 1:] = 0.3
    with torch.inference_mode():
        both = [network(torch.from_numpy(one)) for one in (window, other)]
    assert torch.equal(*both)


@pytest.mark.parametrize("channel", range(4))
def test_the_informed_network_sees_every_channel(channel):
    network, pairs = network_of()
    window = network_input(pairs.windows[:2], pairs.pixel_m[:2])
    changed = window.copy()
    changed[:, channel] *= 0.5
    first, second = (readings(network, one, pairs.features[:2])[0] for one in (window, changed))
    assert np.abs(first - second).max() > 1e-6


def test_features_are_told_in_steps_of_equally_many_pairs_and_never_run_away():
    values = np.random.default_rng(0).lognormal(size=(1000, 2)).astype(np.float32)
    values[:, 1] = 3.0
    network = InformedNetwork(Encoding.of(values, 4), LEVELS, (8,), 1, 0.0)
    told = network._encoded(torch.from_numpy(values)).numpy()
    assert told.shape == (1000, 2 * 5)
    assert [float((told[:, 2 + step] >= 1.0).mean()) for step in range(3)] == pytest.approx([0.75, 0.5, 0.25], abs=0.01)
    assert not told[:, 6:].any()  # all alike
    far = network._encoded(torch.tensor([[1e9, -1e9]])).numpy()
    assert np.abs(far).max() <= 4.0
    assert np.isfinite(far).all()


def test_a_beta_distribution_is_that_of_scipy():
    mean, weight, share = (
        np.random.default_rng(2).uniform(low, high, 50) for low, high in ((0.1, 0.9), (1, 40), (0, 1))
    )
    found = beta_logarithm(*(torch.from_numpy(one) for one in (mean, weight, share))).numpy()
    assert found == pytest.approx(stats.beta.logpdf(share, mean * weight, (1 - mean) * weight))


def test_knowing_nothing_is_the_uniform_prior():
    """A mean of a half and a concentration of 2 say the spread of the range, and of six whole numbers."""
    network, pairs = network_of()

    def nothing(window, features):
        half = torch.full((len(window), 6), 0.5)
        return half, torch.full_like(half, 2.0), torch.zeros(len(window), 3)

    network.forward = nothing
    value, spread, strategy = read(network, pairs.take(np.arange(3)))
    assert value == pytest.approx(np.full((3, 6), 0.5))
    assert spread[:, :5] == pytest.approx(12**-0.5, rel=1e-5)
    assert spread[:, 5] == pytest.approx(np.std(np.arange(6)) / 5, rel=1e-5)
    assert strategy == pytest.approx(1 / 3)


def test_sureness_narrows_spreads_and_leaves_means():
    network, pairs = network_of()
    before = read(network, pairs)
    network.set_sureness(np.array([4.0, 1, 1, 1, 1, 1]), np.ones(6))
    after = read(network, pairs)
    assert np.array_equal(before[0], after[0])
    assert (after[1][:, 0] < 0.75 * before[1][:, 0]).all()
    assert np.array_equal(before[1][:, 1:], after[1][:, 1:])
    mean, weight, _ = network(
        *(torch.from_numpy(one) for one in (network_input(pairs.windows, pairs.pixel_m), pairs.features))
    )
    network.set_sureness(np.full(6, 1.3), np.full(6, 1.2))
    scaled = scaled_weight(weight.numpy().astype(float), 1.3, 1.2)[:, :5]
    means = mean.numpy()[:, :5]
    assert read(network, pairs)[1][:, :5] == pytest.approx(np.sqrt(means * (1 - means) / (scaled + 1)), rel=1e-4)


def test_the_papers_network_states_its_usual_error_and_no_strategy():
    network, pairs = network_of(PAPER)
    network.set_spread(np.linspace(0.1, 0.6, 6))
    value, spread, strategy = read(network, pairs)
    assert spread == pytest.approx(np.tile(np.linspace(0.1, 0.6, 6), (len(pairs), 1)))
    assert strategy == pytest.approx(1 / 3)
    assert value.min() >= 0.0
    assert value.max() <= 1.0
