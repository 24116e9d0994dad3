"""What a training is told, what it learns from, what it has come to, and what its model says of all that."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

from urbanforest_cli import __version__
from urbanforest_cli.core.coverage_model import CoverageModelInfo
from urbanforest_cli.imagery.learning.progress_log import EpochReport
from urbanforest_cli.imagery.learning.settings import Device, Precision, TrainingSettings
from urbanforest_cli.imagery.learning.tiles import CHANNEL_MEAN, CHANNEL_SCALE, TileLook, Tiles
from urbanforest_cli.imagery.learning.validation import Agreement
from urbanforest_cli.imagery.pairs import PairLabel, PairSet, content_of
from urbanforest_cli.imagery.splits import Split

if TYPE_CHECKING:
    from urbanforest_cli.core.training import Machine
    from urbanforest_cli.imagery.learning.training import Weights

HALO_STEPS, HALO_MOST_PX = 3, 256
"""The halo of a window: so many times what a network's innermost pixel covers, where that can be paid."""


@dataclass(frozen=True, kw_only=True)
class TrainingRequest:
    """What is to be trained from what.

    Parameters
    ----------
    pairs, label, classes, polygons, trees, palette, assume_crs, image_resolution_m
        As `read_pairs` takes them.
    output, work
        The model, and the folder of checkpoint, metrics and sheets.
    hold_out
        Patterns of groups or names that are neither trained on nor looked at.
    validation_fraction
        Share of the other places by which epochs are compared and thresholds chosen.
    resume
        Go on from the checkpoint in `work`; with none there, begin.
    minutes
        Stop after the first epoch that ends later; the model is then written as it is.
    """

    pairs: Path
    output: Path
    work: Path
    settings: TrainingSettings
    label: PairLabel = "auto"
    classes: tuple[str, ...] | None = None
    polygons: Path | None = None
    trees: Path | None = None
    palette: Mapping[str, str] | None = None
    assume_crs: str | None = None
    image_resolution_m: float | None = None
    hold_out: tuple[str, ...] = ()
    validation_fraction: float = 0.15
    device: Device = "auto"
    precision: Precision = "auto"
    threads: int = 1
    resume: bool = False
    overwrite: bool = False
    minutes: float | None = None


@dataclass(frozen=True)
class TrainingData:
    """Tiles to learn from and to validate by, at the model's resolution."""

    pairs: PairSet
    parts: Split
    training: Tiles
    looks: list[TileLook]
    validation: Tiles
    resolution_m: float


@dataclass
class Story:
    """What a training has come to: its epochs, the best of them, and what went before this run."""

    history: list[EpochReport] = field(default_factory=list)
    best: Weights | None = None

    @property
    def best_epoch(self) -> int:
        """Return the best epoch, counted from 1; 0 before the first."""
        return max((report.epoch for report in self.history if report.best), default=0)

    def ended(self, settings: TrainingSettings) -> bool:
        """Tell whether all epochs are done, or the last ones brought nothing better."""
        epochs = len(self.history)
        waited = settings.patience_epochs > 0 and epochs - self.best_epoch >= settings.patience_epochs
        return epochs >= settings.epochs or (epochs > 0 and waited)


def model_info(
    request: TrainingRequest,
    data: TrainingData,
    story: Story,
    key: str,
    decisive: dict[str, Any],
    machine: dict[str, Any],
    agreements: dict[str, Agreement],
) -> CoverageModelInfo:
    """Return what a model says of itself.

    Nothing of it hangs on the clock, so that the same training gives the same file.

    Parameters
    ----------
    key, decisive
        Hash of what decided the weights, and that itself.
    machine
        What they were computed on.
    agreements
        By class, of the network as it is written.
    """
    settings = request.settings
    return CoverageModelInfo(
        classes=tuple(data.pairs.classes),
        resolution_m=data.resolution_m,
        multiple_px=settings.multiple_px,
        halo_px=min(HALO_STEPS * settings.multiple_px, HALO_MOST_PX),
        channel_mean=(CHANNEL_MEAN, CHANNEL_MEAN, CHANNEL_MEAN),
        channel_scale=(CHANNEL_SCALE, CHANNEL_SCALE, CHANNEL_SCALE),
        thresholds=tuple(agreement.threshold for agreement in agreements.values()),
        preset=settings.preset,
        program_version=__version__,
        training={
            "key": key,
            "complete": story.ended(settings),
            "settings": decisive["settings"],
            "data": {
                **decisive["data"],
                **data_counts(data),
                "hold_out": list(request.hold_out),
                "image_hashes": sorted(
                    content_of(data.pairs[index].rgb) for index in (*data.parts.training, *data.parts.validation)
                ),
            },
            "machine": machine,
            "epochs": len(story.history),
            "best_epoch": story.best_epoch,
        },
        scores={
            "validation": {
                name: {
                    "iou": round(agreement.iou, 5),
                    "predicted_share": round(agreement.predicted_share, 5),
                    "true_share": round(agreement.true_share, 5),
                }
                for name, agreement in agreements.items()
            }
        },
    )


def decisive_record(request: TrainingRequest, data: TrainingData, machine: Machine) -> dict[str, Any]:
    """Return all that decides the weights."""
    return {
        "program_version": __version__,
        "settings": request.settings.decisive(),
        "data": {
            "label": request.label,
            "fingerprint": data.pairs.fingerprint,
            "training_images": _hash_of(data.pairs, data.parts.training),
            "validation_images": _hash_of(data.pairs, data.parts.validation),
            "classes": list(data.pairs.classes),
        },
        "device": machine.device,
        "bf16": machine.bf16,
    }


def _hash_of(pairs: PairSet, indices: Sequence[int]) -> str:
    return hashlib.sha256("\n".join(pairs.names[index] for index in indices).encode()).hexdigest()[:16]


def data_counts(data: TrainingData) -> dict[str, int | float | str]:
    """Return how many images and places there are."""
    return {
        "images": len(data.training),
        "validation_images": len(data.validation),
        "held_out_images": len(data.parts.held_out),
        "places": len({data.pairs.places[index] for index in (*data.parts.training, *data.parts.validation)}),
    }
