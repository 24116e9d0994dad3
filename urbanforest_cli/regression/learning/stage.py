"""Train a parameter model: pairs of coverage and parameters in, an ONNX file and the story of its training out."""

from __future__ import annotations

import hashlib
import json
import math
import time
from collections.abc import Callable
from pathlib import Path
from types import ModuleType
from typing import TYPE_CHECKING, Any

import numpy as np

from urbanforest_cli.core.checkpoints import differences, seal, unseal
from urbanforest_cli.core.errors import ConfigError, InputError, OutputExistsError, StaleError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import Progress, silent
from urbanforest_cli.core.publish import publish, write_text
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.core.summary import StageSummary
from urbanforest_cli.core.training_report import rows_csv
from urbanforest_cli.files.parameter_models import load_parameter_model, write_parameter_model
from urbanforest_cli.files.training_curves import Curves
from urbanforest_cli.regression.learning.progress_log import EpochReport
from urbanforest_cli.regression.learning.samples import Parted, parted
from urbanforest_cli.regression.learning.story import RegressionRequest, Story, decisive_record, model_info

if TYPE_CHECKING:
    from urbanforest_cli.regression.learning.training import Trainer

STAGE = "train"
CHECKPOINT, METRICS, CURVES, SHEETS = "checkpoint.pt", "metrics.csv", "tensorboard", "sheets"
LEFT_OVER_EPOCHS = 5
FEWEST_PAIRS = 20

OnEpoch = Callable[[EpochReport, int, float], None]


def train_regression(
    request: RegressionRequest, *, progress: Progress = silent, on_epoch: OnEpoch | None = None
) -> StageSummary:
    """Train a network on pairs, set its spreads right, export it, and write it as a parameter model.

    Pairs are parted by lot: most are learnt from, some compare epochs and set spreads right, and the validation pairs
    do neither, so that the model's scores are of lots it knows nothing of.

    Parameters
    ----------
    on_epoch
        Called after each epoch with its report, the number of epochs, and the seconds left if all are needed.

    Raises
    ------
    InputError
        There are too few pairs to part.
    ConfigError
        Settings cannot be, or the packages for training are missing.
    StaleError
        The checkpoint belongs to another training, or is damaged.
    OutputExistsError
        The model is there already, or a checkpoint that nobody asked to go on from.
    """
    started = time.monotonic()
    training = _training_module()
    if faults := request.settings.faults():
        raise ConfigError("settings that cannot be", found="; ".join(faults), next_step="see --help")
    _refuse_lost_work(request)
    notices = Notices()
    pairs = request.make(progress, notices)
    parts = parted(pairs, request.settings)
    if min(len(parts.training), len(parts.calibration), len(parts.validation)) < FEWEST_PAIRS:
        raise InputError(
            "too few pairs to train and to judge by", found=f"{len(pairs)} pairs on {len(np.unique(pairs.lot))} lots",
            next_step="ask for more with --pairs",
        )  # fmt: skip
    decisive = decisive_record(request, pairs)
    key = hashlib.sha256(json.dumps(decisive, sort_keys=True).encode()).hexdigest()[:32]
    counts: dict[str, int | float | str] = {"pairs": len(pairs), "held_out_pairs": len(parts.validation)}
    del pairs  # its parts are copies
    if _is_made(request, key):
        return StageSummary(STAGE, request.output, counts, notices, up_to_date=True)
    from urbanforest_cli.core.training import Machine, pack, settled
    from urbanforest_cli.regression.learning.onnx_export import export_onnx
    from urbanforest_cli.regression.learning.settle import settle

    machine = _machine_record(request)
    story, state = _resumed(request, decisive, machine, notices)
    with settled(Machine("cpu", False, request.threads)):
        trainer = training.Trainer(request.settings, parts.training)
        if state is not None:
            trainer.take_state(state)

        def keep() -> None:
            content = pack({
                "decisive": json.dumps(decisive), "machine": json.dumps(machine),
                "history": json.dumps([report.as_record() for report in story.history]),
                "best": story.best, "parts": trainer.state(),
            })  # fmt: skip
            with publish(request.work / CHECKPOINT) as part:
                part.write_bytes(seal(content))

        _run(request, parts, trainer, story, keep, notices, progress, on_epoch)
        assert story.best is not None, "the first epoch is the best so far"
        trainer.take_weights(story.best)
        scores = settle(trainer, parts)
        info = model_info(request, story, key, decisive, machine, scores)
        content = export_onnx(trainer.network, info, parts.validation)
    write_parameter_model(request.output, content)
    counts |= {
        "epochs": len(story.history),
        "best_epoch": story.best_epoch,
        **{f"{name}_r2": round(scores["validation"]["r2"][name], 4) for name in REGRESSED},
        "minutes": round(sum(report.seconds for report in story.history) / 60.0, 2),
        "sha256": hashlib.sha256(content).hexdigest(),
    }
    return StageSummary(STAGE, request.output, counts, notices, seconds=time.monotonic() - started)


def _run(
    request: RegressionRequest,
    parts: Parted,
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
            report = _epoch(settings.epochs, parts, trainer, story, progress)
            story.history.append(report)
            if report.best:
                story.best = trainer.weights()
            _draw(request, parts, trainer, report)
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


def _epoch(epochs: int, parts: Parted, trainer: Trainer, story: Story, progress: Progress) -> EpochReport:
    from urbanforest_cli.regression.learning.settle import figures

    begun, done = time.monotonic(), len(story.history)
    steps = trainer.steps_an_epoch
    losses = trainer.run_epoch(done, lambda step: progress("training", done * steps + step, epochs * steps))
    if not all(math.isfinite(value) for value in losses.values()):
        raise ConfigError(
            "the training ran away: a loss is no number any more", where=f"epoch {done + 1}", found=losses,
            next_step="train anew with a lower --learning-rate",
        )  # fmt: skip
    found = figures(trainer, parts.calibration)
    report = EpochReport(
        done + 1, time.monotonic() - begun, trainer.learning_rate, losses, found["r2"], found.get("strategies_right")
    )
    best = all(report.mean_r2 > before.mean_r2 for before in story.history)
    return EpochReport(**{**vars(report), "best": best})


def _draw(request: RegressionRequest, parts: Parted, trainer: Trainer, report: EpochReport) -> None:
    from urbanforest_cli.regression.learning.samples import HIGH, LOW
    from urbanforest_cli.regression.learning.settle import said_of
    from urbanforest_cli.regression.learning.sheets import chosen, sheet_png

    shown = parts.validation.take(chosen(parts.validation))
    title = f"epoch {report.epoch}, R2 {report.mean_r2:.3f}; true value red, what is read blue with its spread"
    png = sheet_png(shown, said_of(trainer, shown), LOW, HIGH, title)
    with publish(_sheet(request, report.epoch)) as part:
        part.write_bytes(png)


def _sheet(request: RegressionRequest, epoch: int) -> Path:
    return request.work / SHEETS / f"epoch_{epoch:04d}.png"


def _refuse_lost_work(request: RegressionRequest) -> None:
    """Refuse, before pairs are made, to begin where a training lies that was stopped."""
    path = request.work / CHECKPOINT
    if path.exists() and not (request.resume or request.overwrite or _is_ended(path)):
        raise OutputExistsError(
            "a training lies here that was stopped", where=path,
            next_step="go on with it by --resume, begin anew with --overwrite, or name another folder with --work",
        )  # fmt: skip


def _resumed(
    request: RegressionRequest, decisive: dict[str, Any], machine: dict[str, Any], notices: Notices
) -> tuple[Story, dict[str, Any] | None]:
    """Return where a training goes on, or the beginning."""
    path = request.work / CHECKPOINT
    if not request.resume:
        return Story(), None
    if not path.exists():
        notices.add("W_NOTHING_TO_RESUME", "nothing to go on from, so the training began anew", examples=[path])
        return Story(), None
    from urbanforest_cli.core.training import unpack

    try:
        state = unpack(unseal(path.read_bytes()))
        before, machine_before = json.loads(state["decisive"]), json.loads(state["machine"])
        history = [EpochReport(**record) for record in json.loads(state["history"])]
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
    if changed := differences(machine_before, machine):
        notices.add("W_OTHER_MACHINE", "gone on in another way than begun, so that last digits may differ",
                    len(changed), changed)  # fmt: skip
    return Story(history, best), parts


def _is_ended(path: Path) -> bool:
    """Tell whether a checkpoint is the last of its training, which nobody will miss."""
    from urbanforest_cli.core.training import unpack

    try:
        state = unpack(unseal(path.read_bytes()))
        epochs = int(json.loads(state["decisive"])["settings"]["epochs"])
        return len(json.loads(state["history"])) >= epochs
    except (ValueError, KeyError, TypeError, OSError):
        return False


def _is_made(request: RegressionRequest, key: str) -> bool:
    """Tell whether the model is there already; refuse another file in its place."""
    if request.overwrite or not request.output.exists():
        return False
    try:
        made = load_parameter_model(request.output).info.training
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


def _machine_record(request: RegressionRequest) -> dict[str, Any]:
    from urbanforest_cli.core.training import version

    return {"device": "cpu", "threads": request.threads, "torch": version()}


def _training_module() -> ModuleType:
    """Import what needs the packages for training, or say which are missing."""
    try:
        import onnx  # noqa: F401

        from urbanforest_cli.regression.learning import training
    except ModuleNotFoundError as error:
        if (error.name or "").partition(".")[0] not in ("torch", "onnx"):
            raise
        raise ConfigError(
            "the packages for training are not installed", found=f"no package {error.name!r}",
            next_step="pip install 'urbanforest[train]'",
        ) from error  # fmt: skip
    return training
