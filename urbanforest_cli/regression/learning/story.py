"""What a training is told, what it has come to, and what its model says of all that."""

from __future__ import annotations

import hashlib
from collections.abc import Callable
from dataclasses import dataclass, field, fields
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from urbanforest_cli import __version__
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.parameter_model import ParameterModelInfo
from urbanforest_cli.core.progress import Progress
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.features import FEATURES
from urbanforest_cli.regression.learning.progress_log import EpochReport
from urbanforest_cli.regression.learning.samples import HIGH, LOW
from urbanforest_cli.regression.learning.settings import RegressionSettings
from urbanforest_cli.regression.pair_table import PairTable

if TYPE_CHECKING:
    from urbanforest_cli.regression.learning.training import Weights

MakePairs = Callable[[Progress, Notices], PairTable]


@dataclass(frozen=True, kw_only=True)
class RegressionRequest:
    """What is to be trained on what.

    Parameters
    ----------
    make
        Makes the pairs; always the same ones. Counts there what it repairs and leaves out.
    pair_count, lots
        How many, and files of real lots that some of them are made on, as a user named them.
    output, work
        The model, and the folder of checkpoint, metrics and sheets.
    resume
        Go on from the checkpoint in `work`; with none there, begin.
    minutes
        Stop after the first epoch that ends later; the model is then written as it is.
    """

    make: MakePairs
    pair_count: int
    output: Path
    work: Path
    settings: RegressionSettings
    lots: tuple[str, ...] = ()
    threads: int = 1
    resume: bool = False
    overwrite: bool = False
    minutes: float | None = None


@dataclass
class Story:
    """What a training has come to: its epochs, and the weights of the best of them."""

    history: list[EpochReport] = field(default_factory=list)
    best: Weights | None = None

    @property
    def best_epoch(self) -> int:
        """Return the best epoch, counted from 1; 0 before the first."""
        return max((report.epoch for report in self.history if report.best), default=0)

    def ended(self, settings: RegressionSettings) -> bool:
        """Tell whether all epochs are done."""
        return len(self.history) >= settings.epochs


def decisive_record(request: RegressionRequest, pairs: PairTable) -> dict[str, Any]:
    """Return all that decides the weights."""
    return {
        "program_version": __version__,
        "settings": request.settings.as_record(),
        "pairs": {
            "count": len(pairs),
            "fingerprint": fingerprint(pairs),
            "lots": [Path(lots).name for lots in request.lots],
        },
        "features": hashlib.sha256("\n".join(FEATURES).encode()).hexdigest()[:16],
    }


def fingerprint(pairs: PairTable) -> str:
    """Return a hash of all that is in pairs."""
    digest = hashlib.sha256()
    for item in fields(pairs):
        digest.update(np.ascontiguousarray(getattr(pairs, item.name)).tobytes())
    return digest.hexdigest()[:32]


def model_info(
    request: RegressionRequest,
    story: Story,
    key: str,
    decisive: dict[str, Any],
    machine: dict[str, Any],
    scores: dict[str, Any],
) -> ParameterModelInfo:
    """Return what a model says of itself; nothing of it hangs on the clock, so that a training gives one file."""
    return ParameterModelInfo(
        network=request.settings.network,
        parameters=REGRESSED,
        low=LOW,
        high=HIGH,
        features=FEATURES if request.settings.network == "informed" else (),
        window_px=64,
        training={
            "key": key,
            "complete": story.ended(request.settings),
            **decisive,
            "machine": machine,
            "epochs": len(story.history),
            "best_epoch": story.best_epoch,
        },
        scores=scores,
    )
