"""Curves of a training for TensorBoard."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from types import TracebackType
from typing import Any

UNDRAWN = ("epoch", "best")


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

    def add(self, row: Mapping[str, Any]) -> None:
        """Write one epoch, whose number counts from 1 and stands in `epoch`."""
        if self._writer is not None:
            for name, value in row.items():
                if name not in UNDRAWN:
                    self._writer.add_scalar(name.replace("_", "/", 1), value, row["epoch"])
            self._writer.flush()

    def __enter__(self) -> Curves:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        if self._writer is not None:
            self._writer.close()
