"""How a parameter network is trained."""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace
from typing import Any, Literal

Network = Literal["informed", "paper"]
Loss = Literal["nll", "mse"]
Unused = Literal["masked", "zero"]

NETWORKS: tuple[Network, ...] = ("informed", "paper")
LOSSES: tuple[Loss, ...] = ("nll", "mse")
UNUSED: tuple[Unused, ...] = ("masked", "zero")


@dataclass(frozen=True, kw_only=True)
class RegressionSettings:
    """All that decides a training but its pairs.

    Parameters
    ----------
    network
        `informed`: windows with lot, edge and scale, features, spreads and strategy. `paper`: coverage alone.
    loss
        `mse`: squared error of values as shares of their range. `nll`: the same, and what the true values weigh under
        the Beta distribution that mean and spread describe, which the mean is not moved by.
    unused
        What becomes of parameters that a pair's strategy does not use: left out of the loss, or taught as 0.
    dense
        Widths of the dense layers.
    members
        Sets of dense layers, each started otherwise, whose outputs are averaged.
    bins
        Steps that a feature is given in, each of as many training pairs; with the paper's network none.
    dropout
        Share of what goes into each dense layer left out in training.
    learning_rate, warm_up_fraction, weight_decay
        The highest rate of a cycle over all steps, the share in which it rises, and AdamW's decay; 0 is plain Adam.
    validation_fraction
        Share of the lots that are never learnt from; the model's scores are of them.
    calibration_fraction
        Share of the other lots that neither move weights: epochs are compared, and spreads set right, by them.
    """

    network: Network = "informed"
    loss: Loss = "nll"
    unused: Unused = "masked"
    dense: tuple[int, ...] = (256, 128)
    members: int = 2
    bins: int = 12
    dropout: float = 0.1
    epochs: int = 12
    batch: int = 128
    learning_rate: float = 2e-3
    warm_up_fraction: float = 0.1
    weight_decay: float = 1e-2
    validation_fraction: float = 0.2
    calibration_fraction: float = 0.1
    seed: int = 0

    def as_record(self) -> dict[str, Any]:
        """Return plain values as JSON gives them back."""
        return {**asdict(self), "dense": list(self.dense)}

    def faults(self) -> list[str]:
        """Return a sentence for each value that cannot be."""
        checks = {
            "epochs must lie within 1 and 100000": 1 <= self.epochs <= 100_000,
            "batch must lie within 2 and 4096": 2 <= self.batch <= 4096,
            "learning_rate must lie within 0 and 1": 0.0 < self.learning_rate <= 1.0,
            "validation_fraction must lie within 0 and 0.9": 0.0 < self.validation_fraction <= 0.9,
            "the paper's network has no spread to teach: --loss mse": self.network == "informed" or self.loss == "mse",
        }
        return [text for text, holds in checks.items() if not holds]


INFORMED = RegressionSettings()
PAPER = RegressionSettings(
    network="paper", loss="mse", dense=(64, 64), members=1, bins=0, dropout=0.0, epochs=20, batch=64,
    learning_rate=1e-3, weight_decay=0.0,
)  # fmt: skip
"""Five convolutions of 32, two dense layers of 64, ReLU but for the last, squared error (paper, Data and Training)."""


def settings_for(network: Network, **changes: Any) -> RegressionSettings:
    """Return the settings of a network with changes; those that are None change nothing."""
    base = PAPER if network == "paper" else INFORMED
    return replace(base, **{name: value for name, value in changes.items() if value is not None})
