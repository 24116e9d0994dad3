"""What is told of each epoch: a line for people, and a row of a table."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field
from typing import Any

from urbanforest_cli.core.training_report import duration
from urbanforest_cli.imagery.learning.validation import Agreement, mean_iou


@dataclass(frozen=True)
class EpochReport:
    """One epoch, counted from 1.

    Parameters
    ----------
    seconds
        Spent in this epoch, validation and checkpoint included.
    losses
        Mean of each over the epoch.
    agreements
        By class on the validation images; empty where there are none.
    best
        Whether it is the best so far.
    """

    epoch: int
    seconds: float
    learning_rate: float
    losses: dict[str, float]
    agreements: dict[str, Agreement] = field(default_factory=dict)
    best: bool = False

    @property
    def iou(self) -> float | None:
        """Mean over the classes; None without validation."""
        return mean_iou(list(self.agreements.values())) if self.agreements else None

    def as_row(self) -> dict[str, Any]:
        """Return values by column."""
        row: dict[str, Any] = {
            "epoch": self.epoch,
            "seconds": round(self.seconds, 2),
            "learning_rate": self.learning_rate,
            **{f"loss_{name}": value for name, value in self.losses.items()},
        }
        if self.agreements:
            row["iou"] = self.iou
        for name, agreement in self.agreements.items():
            row |= {f"{name}_{key}": value for key, value in asdict(agreement).items()}
        return {**row, "best": int(self.best)}

    def as_record(self) -> dict[str, Any]:
        """Return plain values that `from_record` reads."""
        return asdict(self)

    @classmethod
    def from_record(cls, record: dict[str, Any]) -> EpochReport:
        """Rebuild what `as_record` returned."""
        agreements = {name: Agreement(**values) for name, values in record["agreements"].items()}
        return cls(**{**record, "agreements": agreements})

    def line(self, epochs: int, left_s: float) -> str:
        """Return what a user reads while waiting."""
        losses = ", ".join(f"{name} {value:.4f}" for name, value in self.losses.items())
        parts = [f"epoch {self.epoch}/{epochs}", f"loss {losses}"]
        if self.agreements:
            classes = ", ".join(f"{name} {agreement.iou:.3f}" for name, agreement in self.agreements.items())
            parts.append(f"validation IoU {self.iou:.3f} ({classes})" + (", best so far" if self.best else ""))
        return "  ".join([*parts, f"{duration(left_s)} left" if self.epoch < epochs else "done"])
