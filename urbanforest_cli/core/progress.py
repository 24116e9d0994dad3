"""How a long stage tells how far it is."""

from __future__ import annotations

from typing import Protocol


class Progress(Protocol):
    """Called with what is being done and how much of it; must not fail."""

    def __call__(self, task: str, done: int, total: int) -> None:
        """Take one report."""


def silent(task: str, done: int, total: int) -> None:
    """Take a report and say nothing."""
