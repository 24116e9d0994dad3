"""Networks that read placement parameters off the coverage of a lot.

Both take (lot, channel, row, col) windows of `CHANNELS`, from 0 to 1. Means are in shares of each parameter's range;
spreads are standard deviations in the same shares.
"""

from __future__ import annotations

import copy
import io
import warnings
from dataclasses import dataclass
from itertools import pairwise

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor, nn

from urbanforest_cli.core.parameter_model import (
    CHANNELS,
    FEATURE_INPUT,
    SPREAD_OUTPUT,
    STRATEGIES_READ,
    STRATEGY_OUTPUT,
    VALUE_OUTPUT,
    WINDOW_INPUT,
)
from urbanforest_cli.regression.learning.sureness import MIDDLE_WEIGHT

OPSET = 17
LEVELS, FILTERS = 5, 32
WINDOW_PX = 64
LEAST_WEIGHT, MOST_WEIGHT = 0.5, 5000.0
"""Bounds of the concentration a + b of a Beta distribution; 2 is that of knowing nothing."""
LEAST_SPREAD = 1e-3
STEPS_MOST = 4.0
"""Standard deviations beyond which a feature is taken for no further out."""


@dataclass(frozen=True)
class Encoding:
    """How features are told to the dense layers: standardised, and by how far they fill each of some steps.

    Parameters
    ----------
    mean, deviation
        (feature,).
    knots
        (feature, bins + 1) ascending: quantiles over the training pairs.
    """

    mean: NDArray[np.float32]
    deviation: NDArray[np.float32]
    knots: NDArray[np.float32]

    @classmethod
    def of(cls, features: NDArray[np.float32], bins: int) -> Encoding:
        """Return the encoding that parts these features (pair, feature) into equally many pairs a step."""
        values = features.astype(np.float64)
        deviation = values.std(axis=0)
        knots = np.quantile(values, np.linspace(0.0, 1.0, bins + 1), axis=0).T
        return cls(
            values.mean(axis=0).astype(np.float32),
            np.where(deviation > 0, deviation, 1.0).astype(np.float32),
            np.ascontiguousarray(knots, np.float32),
        )


class PaperNetwork(nn.Module):
    """Five convolutions of 32 and two dense layers of 64 on the coverage alone, ReLU but for the last layer.

    The published text names neither kernels nor strides: here 3 x 3 pixels and 2, which bring 64 pixels to 2. Its
    spread is a constant that `set_spread` puts in, its strategies are equally likely.
    """

    constant_spread: Tensor

    def __init__(self, parameters: int, dense: tuple[int, ...] = (64, 64)) -> None:
        super().__init__()
        layers: list[nn.Module] = []
        for level in range(LEVELS):
            layers += [nn.Conv2d(FILTERS if level else 1, FILTERS, 3, 2, 1), nn.ReLU()]
        self.convolutions = nn.Sequential(*layers, nn.Flatten())
        widths = [FILTERS * (WINDOW_PX >> LEVELS) ** 2, *dense]
        self.dense = nn.Sequential(
            *(part for before, after in pairwise(widths)
              for part in (nn.Linear(before, after), nn.ReLU())),
            nn.Linear(widths[-1], parameters),
        )  # fmt: skip
        self.register_buffer("constant_spread", torch.full((parameters,), 12.0**-0.5))

    def forward(self, window: Tensor) -> Tensor:
        """Return (lot, parameter) values, which may lie a little beyond 0 and 1."""
        result: Tensor = self.dense(self.convolutions(window[:, :1]))
        return result

    def set_spread(self, spread: NDArray[np.float64]) -> None:
        """Say how far off its values are, (parameter,)."""
        self.constant_spread.copy_(torch.from_numpy(spread))

    def read(self, window: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return means, spreads and strategies as the model states them."""
        value = self(window).clamp(0.0, 1.0)
        nothing = 0.0 * value
        return value, nothing + self.constant_spread, nothing[:, : len(STRATEGIES_READ)] + 1.0 / len(STRATEGIES_READ)


class InformedNetwork(nn.Module):
    """Five convolutions of 32 with norms, means and maxima of every level, and features, joined before dense layers.

    `forward` returns the means, the concentrations a + b of the Beta distributions that they are the means of, and
    the logits of the strategies. A parameter of `levels` whole steps above its lowest value is one of levels + 1
    equal parts of the range there, so that a whole number is not a point; `read` takes that back.

    Parameters
    ----------
    levels
        (parameter,) whole steps within the range, 0 for a parameter that is not whole.
    """

    feature_mean: Tensor
    feature_scale: Tensor
    step_low: Tensor
    step_scale: Tensor
    stretch: Tensor
    shift: Tensor
    dither: Tensor
    sureness: Tensor
    sureness_power: Tensor

    def __init__(
        self, encoding: Encoding, levels: NDArray[np.float32], dense: tuple[int, ...], members: int, dropout: float
    ) -> None:
        super().__init__()
        features, bins = len(encoding.mean), encoding.knots.shape[1] - 1
        self.convolutions = nn.ModuleList(
            nn.Sequential(
                nn.Conv2d(FILTERS if level else len(CHANNELS), FILTERS, 3, 2, 1, bias=False), nn.BatchNorm2d(FILTERS)
            )
            for level in range(LEVELS)
        )
        self.pooled_norm = nn.BatchNorm1d(2 * (LEVELS * FILTERS + len(CHANNELS)))
        for name, values in _buffers(encoding, levels).items():
            self.register_buffer(name, values)
        self.parameters_read = len(levels)
        width = 2 * (LEVELS * FILTERS + len(CHANNELS)) + features * (bins + 1)
        outputs = 2 * len(levels) + len(STRATEGIES_READ)
        self.members = nn.ModuleList(_dense(width, dense, outputs, dropout) for _ in range(members))

    def forward(self, window: Tensor, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return (lot, parameter) means in shares, concentrations, and (lot, strategy) logits."""
        means, weights, logits = self.by_member(window, features)
        return means.mean(0), weights.mean(0), logits.mean(0)

    def by_member(self, window: Tensor, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return the same of each member, (member, lot, ...)."""
        joined = torch.cat([self.pooled_norm(self._pooled(window)), self._encoded(features)], 1)
        raw = torch.stack([member(joined) for member in self.members])  # (member, lot, output)
        count = self.parameters_read
        means = torch.sigmoid(raw[:, :, :count])
        weights = (LEAST_WEIGHT + torch.exp(raw[:, :, count : 2 * count].clamp(-4.0, 8.0))).clamp(max=MOST_WEIGHT)
        return means, weights, raw[:, :, 2 * count :]

    def set_sureness(self, factor: NDArray[np.float64], power: NDArray[np.float64]) -> None:
        """Scale the concentrations that `read` goes by, as `sureness.scaled_weight` does, each (parameter,)."""
        self.sureness.copy_(torch.from_numpy(factor))
        self.sureness_power.copy_(torch.from_numpy(power))

    def read(self, window: Tensor, features: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        """Return means, spreads and strategies as the model states them."""
        mean, weight, logits = self(window, features)
        scaled = self.sureness * MIDDLE_WEIGHT * torch.exp(self.sureness_power * torch.log(weight / MIDDLE_WEIGHT))
        variance = mean * (1.0 - mean) / (scaled + 1.0)
        value = (mean * self.stretch - self.shift).clamp(0.0, 1.0)
        variance = variance * self.stretch * self.stretch - self.dither
        return value, variance.clamp(min=LEAST_SPREAD**2).sqrt(), torch.softmax(logits, 1)

    def _pooled(self, window: Tensor) -> Tensor:
        levels = [window]
        for convolution in self.convolutions:
            levels.append(torch.relu(convolution(levels[-1])))  # (lot, 32, 64 / 2^level, ...)
        pooled = [
            nn.functional.adaptive_avg_pool2d(level, 1).flatten(1) for level in levels
        ] + [nn.functional.adaptive_max_pool2d(level, 1).flatten(1) for level in levels]  # fmt: skip
        return torch.cat(pooled, 1)

    def _encoded(self, features: Tensor) -> Tensor:
        standard = ((features - self.feature_mean) * self.feature_scale).clamp(-STEPS_MOST, STEPS_MOST)
        filled = ((features.unsqueeze(2) - self.step_low) * self.step_scale).clamp(0.0, 1.0)
        return torch.cat([standard, filled.flatten(1)], 1)


def beta_logarithm(mean: Tensor, weight: Tensor, share: Tensor) -> Tensor:
    """Return the logarithm of the density of Beta distributions of these means and concentrations."""
    a, b = mean * weight, (1.0 - mean) * weight
    norm = torch.lgamma(weight) - torch.lgamma(a) - torch.lgamma(b)
    return norm + (a - 1.0) * torch.log(share) + (b - 1.0) * torch.log1p(-share)


def parameter_count(network: nn.Module) -> int:
    """Return how many numbers are trained."""
    return sum(parameter.numel() for parameter in network.parameters())


def frozen(network: PaperNetwork | InformedNetwork) -> PaperNetwork | InformedNetwork:
    """Return a copy for use: in `eval()` mode, without gradients."""
    copied = copy.deepcopy(network).eval()
    for parameter in copied.parameters():
        parameter.requires_grad_(False)
    return copied


def readings(
    network: PaperNetwork | InformedNetwork, window: NDArray[np.float32], features: NDArray[np.float32]
) -> tuple[NDArray[np.float32], NDArray[np.float32], NDArray[np.float32]]:
    """Return what a network in `eval()` mode states of windows: means, spreads, strategies."""
    given = (torch.from_numpy(window), torch.from_numpy(np.ascontiguousarray(features)))
    with torch.inference_mode():
        found = network.read(*given) if isinstance(network, InformedNetwork) else network.read(given[0])
    value, spread, strategy = (part.numpy() for part in found)
    return value, spread, strategy


def traced(network: PaperNetwork | InformedNetwork, features: int) -> bytes:
    """Return a frozen network as ONNX, any number of lots at once."""
    window = torch.zeros(2, len(CHANNELS), WINDOW_PX, WINDOW_PX)
    informed = isinstance(network, InformedNetwork)
    inputs = [WINDOW_INPUT, FEATURE_INPUT] if informed else [WINDOW_INPUT]
    outputs = [VALUE_OUTPUT, SPREAD_OUTPUT, STRATEGY_OUTPUT]
    content = io.BytesIO()
    with warnings.catch_warnings(action="ignore"):  # this exporter, which needs no other package, calls itself old
        torch.onnx.export(
            _Reading(network).eval(),
            (window, torch.zeros(2, features)) if informed else (window,),
            content,  # type: ignore[arg-type]
            dynamo=False,
            opset_version=OPSET,
            input_names=inputs,
            output_names=outputs,
            dynamic_axes={name: {0: "lots"} for name in (*inputs, *outputs)},
        )
    return content.getvalue()


class _Reading(nn.Module):
    def __init__(self, network: PaperNetwork | InformedNetwork) -> None:
        super().__init__()
        self.network = network

    def forward(self, *given: Tensor) -> tuple[Tensor, Tensor, Tensor]:
        return self.network.read(*given)


def _dense(width: int, dense: tuple[int, ...], outputs: int, dropout: float) -> nn.Sequential:
    layers: list[nn.Module] = []
    for wide in dense:
        layers += [nn.Dropout(dropout), nn.Linear(width, wide), nn.ReLU()]
        width = wide
    return nn.Sequential(*layers, nn.Linear(width, outputs))


def _buffers(encoding: Encoding, levels: NDArray[np.float32]) -> dict[str, Tensor]:
    """Return the constants of a network: steps that no pair parts are left empty."""
    low, width = encoding.knots[:, :-1], np.diff(encoding.knots, axis=1)
    whole = levels > 0
    parts = np.where(whole, levels, 1.0)
    constants = {
        "feature_mean": encoding.mean,
        "feature_scale": 1.0 / encoding.deviation,
        "step_low": low,
        "step_scale": np.divide(1.0, width, out=np.zeros_like(width), where=width > 1e-6),
        "stretch": np.where(whole, (parts + 1.0) / parts, 1.0),
        "shift": np.where(whole, 0.5 / parts, 0.0),
        "dither": np.where(whole, 1.0 / (12.0 * parts**2), 0.0),
        "sureness": np.ones_like(levels),
        "sureness_power": np.ones_like(levels),
    }
    return {name: torch.from_numpy(np.array(value, np.float32)) for name, value in constants.items()}
