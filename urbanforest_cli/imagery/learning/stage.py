"""Train a coverage model: pairs of images and truths in, an ONNX file and the story of its training out."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable
from fractions import Fraction
from pathlib import Path
from statistics import median
from types import ModuleType
from typing import TYPE_CHECKING, Any

from urbanforest_cli.core.checkpoints import differences, seal, unseal
from urbanforest_cli.core.errors import ConfigError, InputError, OutputExistsError, StaleError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish, write_text
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.core.training_report import rows_csv
from urbanforest_cli.files.coverage_models import load_coverage_model, write_coverage_model
from urbanforest_cli.files.training_curves import Curves
from urbanforest_cli.imagery.learning.augment import CropSource
from urbanforest_cli.imagery.learning.progress_log import EpochReport
from urbanforest_cli.imagery.learning.settings import TrainingSettings
from urbanforest_cli.imagery.learning.sheets import SheetRow, chosen, sheet_png
from urbanforest_cli.imagery.learning.story import (
    Story,
    TrainingData,
    TrainingRequest,
    data_counts,
    decisive_record,
    model_info,
)
from urbanforest_cli.imagery.learning.tiles import Tiles
from urbanforest_cli.imagery.learning.validation import Agreement
from urbanforest_cli.imagery.pairing.stage import read_pairs
from urbanforest_cli.imagery.splits import fits, split

if TYPE_CHECKING:
    from urbanforest_cli.core.training import Machine
    from urbanforest_cli.imagery.learning.training import Trainer

STAGE = "train"
CHECKPOINT, METRICS, CURVES, SHEETS = "checkpoint.pt", "metrics.csv", "tensorboard", "sheets"
LEFT_OVER_EPOCHS = 5
THRESHOLD_TILES = 64

OnEpoch = Callable[[EpochReport, int, float], None]


def train_coverage(
    request: TrainingRequest, *, progress: Progress = silent, on_epoch: OnEpoch | None = None
) -> StageSummary:
    """Train a network, export it, and write it as a coverage model.

    In use the model has no randomness: its norms have fixed statistics and its dropout is off, whereas Pix2Pix as
    published keeps both going in use. Thresholds are those with the best intersection over union on the validation
    images.

    Parameters
    ----------
    on_epoch
        Called after each epoch with its report, the number of epochs, and the seconds left if all are needed.

    Raises
    ------
    InputError
        The pairs cannot be learnt from.
    ConfigError
        Settings cannot be, no GPU is there, or the packages for training are missing.
    StaleError
        The checkpoint belongs to another training, or is damaged.
    OutputExistsError
        The model is there already, or a checkpoint that nobody asked to go on from.
    """
    started = time.monotonic()
    training = _training_module()
    if faults := request.settings.faults():
        raise ConfigError("settings that cannot be", found="; ".join(faults), next_step="see --help")
    from urbanforest_cli.core.training import pack, settled

    machine = _machine(request)
    notices = Notices()
    data = _read(request, notices, progress)
    decisive = decisive_record(request, data, machine)
    key = hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()[:32]
    if _is_made(request, key):
        return StageSummary(STAGE, request.output, data_counts(data), notices, up_to_date=True)
    story, state = _resumed(request, decisive, machine, notices)
    with settled(machine):
        source = CropSource(data.training, data.looks, request.settings)
        trainer = training.Trainer(request.settings, len(data.pairs.classes), source, machine)
        if state is not None:
            trainer.take_state(state)

        def keep() -> None:
            content = pack({
                "decisive": json.dumps(decisive), "machine": json.dumps(_machine_record(machine)),
                "history": json.dumps([report.as_record() for report in story.history]),
                "best": story.best, "parts": trainer.state(),
            })  # fmt: skip
            with publish(request.work / CHECKPOINT) as part:
                part.write_bytes(seal(content))

        _run(request, data, trainer, story, keep, notices, progress, on_epoch)
        if story.best is not None:
            trainer.take_weights(story.best)
        agreements = _final(trainer, data, notices)
        info = model_info(request, data, story, key, decisive, _machine_record(machine), agreements)
        from urbanforest_cli.imagery.learning.onnx_export import export_onnx

        content = export_onnx(trainer.network, info)
    write_coverage_model(request.output, content)
    counts = data_counts(data) | {
        "epochs": len(story.history),
        "best_epoch": story.best_epoch,
        **{f"{name}_iou": round(agreement.iou, 4) for name, agreement in agreements.items()},
        "minutes": round(sum(report.seconds for report in story.history) / 60.0, 2),
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    return StageSummary(STAGE, request.output, counts, notices, seconds=time.monotonic() - started)


def _run(
    request: TrainingRequest,
    data: TrainingData,
    trainer: Trainer,
    story: Story,
    keep: Callable[[], None],
    notices: Notices,
    progress: Progress,
    on_epoch: OnEpoch | None,
) -> None:
    """Train epoch after epoch, and put down after each how it went and where to go on."""
    settings, begun = request.settings, time.monotonic()
    kept = {_sheet(request, epoch) for epoch in range(1, len(story.history) + 1)}
    for left in set((request.work / SHEETS).glob("epoch_*.png")) - kept:
        left.unlink()  # of a training before this one
    with Curves(request.work / CURVES, after=len(story.history)) as curves:
        if not curves.writes:
            notices.add("W_NO_TENSORBOARD", "curves for TensorBoard not written, since tensorboardX is not installed")
        while not story.ended(settings):
            report = _epoch(settings, data, trainer, story, progress)
            story.history.append(report)
            if report.best:
                story.best = trainer.weights()
            _draw(request, data, trainer, report)
            keep()
            write_text(request.work / METRICS, rows_csv([each.as_row() for each in story.history]))
            curves.add(report.as_row())
            spent_s = time.monotonic() - begun
            if on_epoch is not None:
                recent = [each.seconds for each in story.history[-LEFT_OVER_EPOCHS:]]
                left_s = sum(recent) / len(recent) * (settings.epochs - len(story.history))
                if request.minutes is not None:
                    left_s = min(left_s, max(0.0, 60.0 * request.minutes - spent_s))
                on_epoch(report, settings.epochs, left_s)
            if request.minutes is not None and spent_s >= 60.0 * request.minutes and not story.ended(settings):
                notices.add("W_TIME_IS_UP", "stopped by --minutes; --resume goes on. Epochs not trained",
                            settings.epochs - len(story.history))  # fmt: skip
                break


def _epoch(
    settings: TrainingSettings, data: TrainingData, trainer: Trainer, story: Story, progress: Progress
) -> EpochReport:
    begun, done = time.monotonic(), len(story.history)
    steps = trainer.steps_an_epoch
    losses = trainer.run_epoch(done, lambda step: progress("training", done * steps + step, settings.epochs * steps))
    if not all(math.isfinite(value) for value in losses.values()):
        raise ConfigError(
            "the training ran away: a loss is no number any more", where=f"epoch {done + 1}", found=losses,
            next_step="train anew with a lower --learning-rate, or with --precision fp32",
        )  # fmt: skip
    trainer.settle_norms()
    agreements: dict[str, Agreement] = {}
    if len(data.validation):
        agreements = dict(zip(data.pairs.classes, trainer.validate(data.validation).agreements(), strict=True))
    report = EpochReport(done + 1, time.monotonic() - begun, trainer.learning_rate, losses, agreements)
    before = max((each.iou or 0.0 for each in story.history), default=-1.0)
    best = report.iou is None or report.iou > before
    return EpochReport(**{**vars(report), "best": best})


def _draw(request: TrainingRequest, data: TrainingData, trainer: Trainer, report: EpochReport) -> None:
    tiles = data.validation if len(data.validation) else data.training
    shown = tiles.subset(chosen(len(tiles)))
    rows = [
        SheetRow(tile.name, tile.rgb, tile.truth, probability)
        for tile, probability in trainer.probabilities(shown, exact=False)
    ]
    score = "" if report.iou is None else f", validation IoU {report.iou:.3f}"
    png = sheet_png(rows, data.pairs.classes, f"epoch {report.epoch}{score}")
    with publish(_sheet(request, report.epoch)) as part:
        part.write_bytes(png)


def _sheet(request: TrainingRequest, epoch: int) -> Path:
    return request.work / SHEETS / f"epoch_{epoch:04d}.png"


def _final(trainer: Trainer, data: TrainingData, notices: Notices) -> dict[str, Agreement]:
    """Score the best network as it is exported, and choose its thresholds."""
    tiles = data.validation
    if not len(tiles):
        tiles = data.training[:THRESHOLD_TILES]
        notices.add("W_NO_VALIDATION", "no place is left to validate by: thresholds come from training images",
                    len(tiles))  # fmt: skip
    return dict(zip(data.pairs.classes, trainer.validate(tiles, exact=True).agreements(), strict=True))


def _read(request: TrainingRequest, notices: Notices, progress: Progress) -> TrainingData:
    """Read pairs, part them by place, and look at each once."""
    pairs = read_pairs(
        request.pairs, label=request.label, classes=request.classes, polygons=request.polygons, trees=request.trees,
        palette=request.palette, assume_crs=request.assume_crs, resolution_m=request.image_resolution_m,
        workers=request.threads, notices=notices,
    )  # fmt: skip
    parts = split(
        pairs, validation_fraction=request.validation_fraction, hold_out=request.hold_out, seed=request.settings.seed
    )
    for pattern in request.hold_out:
        if not any(fits(pairs, index, (pattern,)) for index in range(len(pairs))):
            notices.add("W_NOTHING_HELD_OUT", "patterns of --hold-out that no image fits", examples=[pattern])
    notices.add("W_PLACE_HELD_OUT", "images left out because they show a place that is held out", len(parts.dropped))
    resolutions = []
    for number, index in enumerate(parts.training):
        resolutions.append(math.sqrt(math.prod(pairs[index].resolution_m)))
        progress("reading pairs", number + 1, len(parts.training))
    if not resolutions:
        raise InputError(
            "no image is left to train on", where=request.pairs, found=f"{len(pairs)} pairs, all held out or none",
            next_step="add pairs, or hold out less",
        )  # fmt: skip
    resolution_m = float(f"{median(resolutions):.3g}")
    enlarged = Fraction(request.settings.load_px, request.settings.crop_px)
    tiles = Tiles(pairs, parts.training, resolution_m, enlarged)
    looks = [tiles.look(place) for place in range(len(tiles))]
    known = [place for place, look in enumerate(looks) if look.known]
    notices.add("W_NOTHING_KNOWN", "images left out whose truth is known nowhere", len(tiles) - len(known))
    if not known:
        raise InputError("the truth of no image is known anywhere", where=request.pairs, next_step="check the masks")
    validation = Tiles(pairs, parts.validation, resolution_m, enlarged)
    return TrainingData(
        pairs, parts, tiles.subset(known), [looks[place] for place in known], validation,
        float(resolution_m / enlarged),
    )  # fmt: skip


def _resumed(
    request: TrainingRequest, decisive: dict[str, Any], machine: Machine, notices: Notices
) -> tuple[Story, dict[str, Any] | None]:
    """Return where a training goes on, or the beginning."""
    from urbanforest_cli.core.training import unpack

    path = request.work / CHECKPOINT
    if not path.exists():
        if request.resume:
            notices.add("W_NOTHING_TO_RESUME", "nothing to go on from, so the training began anew", examples=[path])
        return Story(), None
    if not request.resume:
        if request.overwrite or _is_ended(path, request.settings):
            return Story(), None
        raise OutputExistsError(
            "a training lies here that was stopped", where=path,
            next_step="go on with it by --resume, begin anew with --overwrite, or name another folder with --work",
        )  # fmt: skip
    try:
        state = unpack(unseal(path.read_bytes()))
        before, machine_before = json.loads(state["decisive"]), json.loads(state["machine"])
        history = [EpochReport.from_record(record) for record in json.loads(state["history"])]
        best, parts = state["best"], state["parts"]
    except (ValueError, KeyError, TypeError, OSError) as error:
        raise StaleError(
            "the checkpoint cannot be read", where=path, found=str(error),
            next_step="begin anew with --overwrite instead of --resume",
        ) from error  # fmt: skip
    if changed := differences(before, decisive):
        raise StaleError(
            "the checkpoint belongs to another training", where=path, found="; ".join(changed),
            next_step="give the options it was begun with, or begin anew with --overwrite instead of --resume",
        )  # fmt: skip
    if changed := differences(machine_before, _machine_record(machine)):
        notices.add("W_OTHER_MACHINE", "gone on in another way than begun, so that last digits may differ",
                    len(changed), changed)  # fmt: skip
    return Story(history, best), parts


def _is_ended(path: Path, settings: TrainingSettings) -> bool:
    """Tell whether a checkpoint is the last of its training, which nobody will miss."""
    from urbanforest_cli.core.training import unpack

    try:
        state = unpack(unseal(path.read_bytes()))
        history = [EpochReport.from_record(record) for record in json.loads(state["history"])]
        epochs = int(json.loads(state["decisive"])["settings"]["epochs"])
    except (ValueError, KeyError, TypeError, OSError):
        return False
    return len(history) >= epochs or Story(history).ended(settings)


def _is_made(request: TrainingRequest, key: str) -> bool:
    """Tell whether the model is there already; refuse another file in its place."""
    if request.overwrite or not request.output.exists():
        return False
    try:
        made = load_coverage_model(request.output).info.training
    except InputError:
        made = {}
    if made.get("key") == key:
        if made.get("complete"):
            return True
        if request.resume:
            return False
    raise OutputExistsError(
        "the output is there already and is not the model that this training gives", where=request.output,
        next_step="name another file with -o, or replace it with --overwrite",
    )  # fmt: skip


def _machine_record(machine: Machine) -> dict[str, Any]:
    from urbanforest_cli.core.training import version

    return {"device": machine.device, "bf16": machine.bf16, "threads": machine.threads, "torch": version()}


def _machine(request: TrainingRequest) -> Machine:
    from urbanforest_cli.core.training import find_machine

    try:
        return find_machine(request.device, request.precision, request.threads)
    except ValueError as error:
        raise ConfigError(
            str(error), found=f"--device {request.device}", next_step="train with --device cpu"
        ) from error


def _training_module() -> ModuleType:
    """Import what needs the packages for training, or say which are missing."""
    try:
        import onnx  # noqa: F401

        from urbanforest_cli.imagery.learning import training
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("torch", "onnx"):
            raise
        raise ConfigError(
            "the packages for training are not installed", found=f"no package {error.name!r}",
            next_step="pip install 'urbanforest[train]'",
        ) from error  # fmt: skip
    return training
