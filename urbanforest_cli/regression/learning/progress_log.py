"""What is told of each epoch: a line for people, and a row of a table."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from urbanforest_cli.core.training_report import duration


@dataclass(frozen=True)
class EpochReport:
    """One epoch, counted from 1.

    Parameters
    ----------
    seconds
        Spent in this epoch, validation included.
    losses
        Mean of each over the epoch.
    r2
        By parameter, on the calibration lots that use it.
    strategies_right
        Share of these lots whose strategy is told; None for a network that tells none.
    best
        Whether the mean over parameters is the best so far.
    """

    epoch: int
    seconds: float
    learning_rate: float
    losses: dict[str, float]
    r2: dict[str, float] = field(default_factory=dict)
    strategies_right: float | None = None
    best: bool = False

    @property
    def mean_r2(self) -> float:
        """Return the mean over parameters."""
        return sum(self.r2.values()) / max(1, len(self.r2))

    def as_row(self) -> dict[str, Any]:
        """Return values by column."""
        row: dict[str, Any] = {
            "epoch": self.epoch,
            "seconds": round(self.seconds, 2),
            "learning_rate": self.learning_rate,
            **{f"loss_{name}": value for name, value in self.losses.items()},
            "r2": self.mean_r2,
            **{f"r2_{name}": value for name, value in self.r2.items()},
        }
        if self.strategies_right is not None:
            row["strategies_right"] = self.strategies_right
        return {**row, "best": int(self.best)}

    def as_record(self) -> dict[str, Any]:
        """Return plain values that the class takes again."""
        return asdict(self)

    def line(self, epochs: int, left_s: float) -> str:
        """Return what a user reads while waiting."""
        losses = ", ".join(f"{name} {value:.4f}" for name, value in self.losses.items())
        each = " ".join(f"{value:.2f}" for value in self.r2.values())
        parts = [
            f"epoch {self.epoch}/{epochs}",
            f"loss {losses}",
            f"R2 {self.mean_r2:.3f} ({each})" + (", best so far" if self.best else ""),
        ]
        if self.strategies_right is not None:
            parts.append(f"strategy {100 * self.strategies_right:.0f} %")
        return "  ".join([*parts, f"{duration(left_s)} left" if self.epoch < epochs else "done"])
