"""The training of a parameter network: losses, steps, and a state that goes on exactly.

What a step does follows from the settings, the pairs and the step's number. So a training that goes on from the state
after an epoch ends in the same weights, bit by bit with the same number of threads.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from numpy.typing import NDArray
from torch import Tensor
from torch.nn import functional

from urbanforest_cli.core.learning_rate import one_cycle
from urbanforest_cli.core.parameter_input import network_input
from urbanforest_cli.core.randomness import key_for, rng_for
from urbanforest_cli.regression.learning.network import Encoding, InformedNetwork, PaperNetwork, beta_logarithm
from urbanforest_cli.regression.learning.samples import LEVELS, STREAM, shares, spread_shares
from urbanforest_cli.regression.learning.settings import RegressionSettings
from urbanforest_cli.regression.pair_table import PairTable

ADAM_BETA2 = 0.999
SQUARED_WEIGHT, STRATEGY_WEIGHT = 10.0, 0.3
"""Of the squared error, in shares of the range, and of the cross entropy of strategies, beside the likelihood."""
LOTS_AT_ONCE = 512

Weights = dict[str, Tensor]


@dataclass(frozen=True)
class Stated:
    """What a network says of pairs: means and concentrations (pair, parameter), logits (pair, strategy)."""

    mean: NDArray[np.float64]
    weight: NDArray[np.float64]
    logits: NDArray[np.float64]


class Trainer:
    """A network in training. Use within `core.training.settled`."""

    def __init__(self, settings: RegressionSettings, pairs: PairTable) -> None:
        self._settings, self._pairs = settings, pairs
        self._shares = shares(pairs.values)
        self._mask = pairs.used.astype(np.float32)
        if settings.unused == "zero":
            self._shares = np.where(pairs.used, self._shares, np.float32(0.0))
            self._mask = np.ones_like(self._mask)
        with torch.random.fork_rng(devices=[]):
            torch.manual_seed(key_for(settings.seed, STREAM, "weights") >> 1)
            self.network = build_network(settings, pairs.features)
        decay = settings.weight_decay
        kind = torch.optim.AdamW if decay > 0 else torch.optim.Adam
        self._optimiser = kind(self.network.parameters(), settings.learning_rate, weight_decay=decay)

    @property
    def steps_an_epoch(self) -> int:
        """Return how many full batches an epoch has; at least one, of all there is."""
        return max(1, len(self._pairs) // self._settings.batch)

    @property
    def learning_rate(self) -> float:
        """Return the rate of the last step."""
        return float(self._optimiser.param_groups[0]["lr"])

    def run_epoch(self, epoch: int, on_step: Callable[[int], None]) -> dict[str, float]:
        """Train one epoch, counted from 0, and return the mean of each loss by its name."""
        torch.manual_seed(key_for(self._settings.seed, STREAM, f"epoch {epoch}") >> 1)
        rng = rng_for(self._settings.seed, STREAM, f"epoch {epoch}")
        self.network.train()
        order, steps = rng.permutation(len(self._pairs)), self.steps_an_epoch
        sums: dict[str, float] = {}
        for step in range(steps):
            rate, momentum = one_cycle(
                epoch * steps + step, self._settings.epochs * steps,
                highest=self._settings.learning_rate, warm_up_fraction=self._settings.warm_up_fraction,
            )  # fmt: skip
            for group in self._optimiser.param_groups:
                group["lr"], group["betas"] = rate, (momentum, ADAM_BETA2)
            rows = order[step * self._settings.batch : (step + 1) * self._settings.batch]
            losses = self._losses(rows, rng)
            self._optimiser.zero_grad()
            sum(losses.values(), torch.zeros(())).backward()  # type: ignore[no-untyped-call]
            self._optimiser.step()
            for name, value in losses.items():
                sums[name] = sums.get(name, 0.0) + value.item()
            on_step(step + 1)
        return {name: value / steps for name, value in sums.items()}

    def state_of(self, pairs: PairTable) -> Stated:
        """Return what the network says of pairs, as it is used; the paper's has no concentrations and no logits."""
        self.network.eval()
        found: list[tuple[Tensor, Tensor, Tensor]] = []
        with torch.inference_mode():
            for start in range(0, len(pairs), LOTS_AT_ONCE):
                part = pairs.take(np.arange(start, min(start + LOTS_AT_ONCE, len(pairs))))
                window = torch.from_numpy(network_input(part.windows, part.pixel_m))
                if isinstance(self.network, InformedNetwork):
                    found.append(self.network(window, torch.from_numpy(part.features)))
                else:
                    mean = self.network(window).clamp(0.0, 1.0)
                    found.append((mean, torch.zeros_like(mean), torch.zeros(len(part), 3)))
        mean, weight, logits = (np.concatenate([part.numpy() for part in parts]) for parts in zip(*found, strict=True))
        return Stated(mean.astype(np.float64), weight.astype(np.float64), logits.astype(np.float64))

    def weights(self) -> Weights:
        """Return a copy of the network's weights and constants."""
        return {name: value.detach().clone() for name, value in self.network.state_dict().items()}

    def take_weights(self, weights: Weights) -> None:
        """Give the network weights that `weights` returned."""
        self.network.load_state_dict(weights)

    def state(self) -> dict[str, Any]:
        """Return all that the next epoch starts from, as tensors and plain values."""
        return {"network": self.network.state_dict(), "optimiser": self._optimiser.state_dict()}

    def take_state(self, state: dict[str, Any]) -> None:
        """Go on from what `state` returned."""
        self.network.load_state_dict(state["network"])
        self._optimiser.load_state_dict(state["optimiser"])

    def _losses(self, rows: NDArray[np.int64], rng: np.random.Generator) -> dict[str, Tensor]:
        pairs = self._pairs
        window = _turned(
            torch.from_numpy(network_input(pairs.windows[rows], pairs.pixel_m[rows])), int(rng.integers(8))
        )
        within = rng.random((len(rows), 1), dtype=np.float32)
        mask = torch.from_numpy(self._mask[rows])
        count = mask.sum().clamp(min=1.0)
        if isinstance(self.network, PaperNetwork):
            error = self.network(window) - torch.from_numpy(self._shares[rows])
            return {"mse": (error.square() * mask).sum() / count}
        share = torch.from_numpy(spread_shares(self._shares[rows], within))
        means, weights, logits = self.network.by_member(window, torch.from_numpy(pairs.features[rows]))
        members = len(means)
        strategy = torch.from_numpy(pairs.strategy[rows].astype(np.int64)).repeat(members)
        losses = {
            "mse": SQUARED_WEIGHT * ((means - share).square() * mask).sum() / (members * count),
            "strategy": STRATEGY_WEIGHT * functional.cross_entropy(logits.flatten(0, 1), strategy),
        }
        if self._settings.loss == "nll":
            likelihood = beta_logarithm(means.detach(), weights, share.expand_as(means))
            losses["nll"] = -(likelihood * mask).sum() / (members * count)
        return losses


def build_network(settings: RegressionSettings, features: NDArray[np.float32]) -> PaperNetwork | InformedNetwork:
    """Make a network with new weights from torch's own stream, and the constants that these features call for."""
    if settings.network == "paper":
        return PaperNetwork(len(LEVELS), settings.dense)
    encoding = Encoding.of(features, settings.bins)
    return InformedNetwork(encoding, LEVELS, settings.dense, settings.members, settings.dropout)


def _turned(window: Tensor, turn: int) -> Tensor:
    """Return windows turned by `turn % 4` quarters, and mirrored from 4 on."""
    turned = torch.rot90(window, turn % 4, (2, 3))
    return (turned.flip(3) if turn >= 4 else turned).contiguous()
