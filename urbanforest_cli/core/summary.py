"""What a stage tells its caller when it is done."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path

from urbanforest_cli.core.notices import Notices


@dataclass
class StageSummary:
    """Counts, warnings and files of one stage.

    Parameters
    ----------
    unknown
        Counts that cannot be told: null in JSON.
    sentence
        What a user reads in place of the counts; made of their names where it is empty.
    """

    stage: str
    output: Path
    counts: dict[str, int | float | str] = field(default_factory=dict)
    notices: Notices = field(default_factory=Notices)
    seconds: float = 0.0
    up_to_date: bool = False
    unknown: tuple[str, ...] = ()
    sentence: str = ""

    def as_record(self) -> dict[str, object]:
        """Return the summary for ``--json``."""
        return {
            "stage": self.stage,
            "output": str(self.output),
            "up_to_date": self.up_to_date,
            "seconds": round(self.seconds, 3),
            "counts": {**self.counts, **dict.fromkeys(self.unknown)},
            "warnings": self.notices.as_records(),
        }
