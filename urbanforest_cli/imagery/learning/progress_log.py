"""What is told of each epoch: a line for people, a row of a table, and a curve for TensorBoard."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import TracebackType
from typing import Any

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
        return "  ".join([*parts, f"{_duration(left_s)} left" if self.epoch < epochs else "done"])


def csv_text(history: Sequence[EpochReport]) -> str:
    """Return all epochs as CSV."""
    rows = [report.as_row() for report in history]
    stream = io.StringIO()
    writer = csv.DictWriter(stream, fieldnames=list(dict.fromkeys(name for row in rows for name in row)))
    writer.writeheader()
    writer.writerows(rows)
    return stream.getvalue()


class Curves:
    """Writes each epoch for TensorBoard; where its package is missing, `writes` is false and nothing happens.

    `after` is how many epochs were written before; later ones of an earlier run are taken back.
    """

    def __init__(self, folder: Path, *, after: int) -> None:
        try:
            from tensorboardX import SummaryWriter
        except ModuleNotFoundError:
            self._writer = None
        else:
            self._writer = SummaryWriter(str(folder), purge_step=after + 1)

    @property
    def writes(self) -> bool:
        """Tell whether anything is written."""
        return self._writer is not None

    def add(self, report: EpochReport) -> None:
        """Write one epoch."""
        if self._writer is not None:
            for name, value in report.as_row().items():
                if name not in ("epoch", "best"):
                    self._writer.add_scalar(name.replace("_", "/", 1), value, report.epoch)
            self._writer.flush()

    def __enter__(self) -> Curves:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()


def _duration(seconds: float) -> str:
    minutes = seconds / 60.0
    return f"{minutes / 60:.1f} h" if minutes >= 90 else f"{minutes:.0f} min" if minutes >= 1.5 else f"{seconds:.0f} s"
