"""Whole trainings of a tiny network: what is left, how they go on, and what is refused."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import pytest
from PIL import Image

from tests.imagery.learning.pairs import Discs

pytest.importorskip("torch")
pytest.importorskip("onnx")

from urbanforest_cli.core.errors import ConfigError, InputError, OutputExistsError, StaleError
from urbanforest_cli.files.coverage_models import load_coverage_model
from urbanforest_cli.imagery.learning import stage
from urbanforest_cli.imagery.learning.settings import SMALL
from urbanforest_cli.imagery.learning.stage import CHECKPOINT, train_coverage
from urbanforest_cli.imagery.learning.story import TrainingRequest
from urbanforest_cli.imagery.learning.validation import Agreement
from urbanforest_cli.imagery.pairs import content_of

TINY = replace(SMALL, filters=4, downs=3, crop_px=32, load_px=32, batch=4, epochs=3)


class Killed(BaseException):
    """What no handler of errors catches."""


@pytest.fixture
def pairs(monkeypatch):
    found = Discs(count=8)
    monkeypatch.setattr(stage, "read_pairs", lambda folder, **options: found)
    return found


@pytest.fixture
def request_for(tmp_path):
    def make(name="model", **what):
        settings = replace(TINY, **what.pop("settings", {}))
        return TrainingRequest(
            pairs=tmp_path / "pairs", output=tmp_path / f"{name}.onnx", work=tmp_path / name,
            settings=settings, precision="fp32", validation_fraction=0.25, **what,
        )  # fmt: skip

    return make


def killed_after(epochs):
    def on_epoch(report, total, left_s):
        if report.epoch == epochs:
            raise Killed

    return on_epoch


def test_a_training_leaves_a_model_its_figures_and_a_sheet_an_epoch(pairs, request_for):
    request = request_for(hold_out=("town_*_5",))
    lines = []
    summary = train_coverage(request, on_epoch=lambda report, total, left_s: lines.append(report.line(total, left_s)))
    info = load_coverage_model(request.output).info
    assert (info.classes, info.resolution_m, info.multiple_px, info.halo_px) == (pairs.classes, 0.6, 8, 24)
    assert (info.channel_mean[0], info.channel_scale[0], info.preset) == (127.5, 127.5, "small")
    assert info.training["complete"]
    assert info.training["settings"]["epochs"] == 3
    assert info.training["data"]["fingerprint"] == "discs"
    assert info.training["data"]["hold_out"] == ["town_*_5"]
    shown = {content_of(pairs[index].rgb): name for index, name in enumerate(pairs.names)}
    assert {shown[one] for one in info.training["data"]["image_hashes"]} == set(pairs.names) - {pairs.names[5]}
    assert info.training["parity_max"] <= 1e-4
    with (request.work / "metrics.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["epoch"] for row in rows] == ["1", "2", "3"]
    best = max(float(row["iou"]) for row in rows)
    scored = [info.scores["validation"][name]["iou"] for name in pairs.classes]
    assert sum(scored) / 2 == pytest.approx(best, abs=1e-4)
    assert float(rows[summary.counts["best_epoch"] - 1]["canopy_threshold"]) == info.thresholds[0]
    sheets = sorted((request.work / "sheets").iterdir())
    assert [path.name for path in sheets] == ["epoch_0001.png", "epoch_0002.png", "epoch_0003.png"]
    with Image.open(sheets[0]) as sheet:
        assert sheet.width > 5 * 192
    assert any(path.name.startswith("events") for path in (request.work / "tensorboard").iterdir())
    assert len(lines) == 3
    assert "canopy 0." in lines[0]
    assert "left" in lines[0]
    assert (summary.counts["images"], summary.counts["validation_images"], summary.counts["held_out_images"]) == (
        5,
        2,
        1,
    )


def test_a_killed_training_goes_on_to_the_same_bytes(pairs, request_for):
    whole, broken = request_for("whole"), request_for("broken")
    train_coverage(whole)
    with pytest.raises(Killed):
        train_coverage(broken, on_epoch=killed_after(2))
    assert not broken.output.exists()
    epochs = []
    summary = train_coverage(
        replace(broken, resume=True), on_epoch=lambda report, total, left_s: epochs.append(report.epoch)
    )
    assert epochs == [3]
    assert summary.counts["epochs"] == 3
    assert whole.output.read_bytes() == broken.output.read_bytes()


def test_killed_before_the_first_epoch_it_begins_anew(pairs, request_for):
    request = request_for(resume=True)
    summary = train_coverage(request)
    assert summary.notices.count("W_NOTHING_TO_RESUME") == 1
    again = train_coverage(replace(request, overwrite=True))
    assert again.counts["epochs"] == 3


def test_another_training_is_not_gone_on_with(pairs, request_for):
    request = request_for()
    with pytest.raises(Killed):
        train_coverage(request, on_epoch=killed_after(1))
    other = replace(request, resume=True, settings=replace(request.settings, learning_rate=1e-4))
    with pytest.raises(StaleError, match=r"learning_rate was 0.003, is 0.0001"):
        train_coverage(other)
    pairs.fingerprint = "others"
    with pytest.raises(StaleError, match='fingerprint was "discs", is "others"'):
        train_coverage(replace(request, resume=True))
    with pytest.raises(StaleError, match="training_images was"):
        train_coverage(replace(request, resume=True, hold_out=("town_*_3",)))


def test_other_threads_are_told_and_gone_on_with(pairs, request_for, monkeypatch):
    request = request_for()
    monkeypatch.setattr(stage._training_module().torch, "set_num_threads", lambda count: None)
    with pytest.raises(Killed):
        train_coverage(request, on_epoch=killed_after(2))
    summary = train_coverage(replace(request, resume=True, threads=2))
    assert "threads was 1, is 2" in next(iter(summary.notices)).examples


@pytest.mark.parametrize("damage", ["cut", "flipped", "foreign"])
def test_a_damaged_checkpoint_is_refused(pairs, request_for, damage):
    request = request_for()
    with pytest.raises(Killed):
        train_coverage(request, on_epoch=killed_after(1))
    path = request.work / CHECKPOINT
    content = bytearray(path.read_bytes())
    if damage == "cut":
        del content[-1000:]
    elif damage == "flipped":
        content[len(content) // 2] ^= 1
    else:
        content = bytearray(b"PK\x03\x04")
    path.write_bytes(content)
    with pytest.raises(StaleError) as error:
        train_coverage(replace(request, resume=True))
    assert error.value.where == path


def test_a_stopped_training_is_not_lost_by_a_second_start(pairs, request_for):
    request = request_for()
    with pytest.raises(Killed):
        train_coverage(request, on_epoch=killed_after(1))
    before = (request.work / CHECKPOINT).read_bytes()
    with pytest.raises(OutputExistsError, match="stopped"):
        train_coverage(request)
    assert (request.work / CHECKPOINT).read_bytes() == before
    (request.work / "sheets" / "epoch_0009.png").touch()
    assert train_coverage(replace(request, overwrite=True)).counts["epochs"] == 3
    assert [path.name for path in sorted((request.work / "sheets").iterdir())] == [
        f"epoch_000{n}.png" for n in (1, 2, 3)
    ]


def test_a_model_that_is_there_is_kept(pairs, request_for):
    request = request_for()
    train_coverage(request)
    before = request.output.read_bytes()
    assert train_coverage(request).up_to_date
    with pytest.raises(OutputExistsError):
        train_coverage(replace(request, settings=replace(request.settings, seed=4)))
    request.output.write_bytes(b"mine")
    with pytest.raises(OutputExistsError):
        train_coverage(request)
    assert request.output.read_bytes() == b"mine"
    train_coverage(replace(request, overwrite=True))
    assert request.output.read_bytes() == before


def test_the_best_epoch_is_exported_and_waiting_has_an_end(pairs, request_for, monkeypatch):
    scores = iter([0.3, 0.6, 0.5, 0.4, 0.55, 0.9])

    def agreements(tally):
        return [Agreement(0.5, score, 0.1, 0.1) for score in [next(scores)] * 2]

    weights = []
    request = request_for(settings={"epochs": 6, "patience": 2})
    monkeypatch.setattr("urbanforest_cli.imagery.learning.validation.Tally.agreements", agreements)
    take = stage._final

    def final(trainer, data, notices):
        weights.append(trainer.weights())
        return take(trainer, data, notices)

    monkeypatch.setattr(stage, "_final", final)
    kept = []
    training = stage._training_module()
    run_epoch = training.Trainer.settle_norms

    def settle(self):
        run_epoch(self)
        kept.append(self.weights())

    monkeypatch.setattr(training.Trainer, "settle_norms", settle)
    summary = train_coverage(request)
    assert (summary.counts["epochs"], summary.counts["best_epoch"]) == (4, 2)
    torch = pytest.importorskip("torch")
    assert all(torch.equal(weights[0][name], kept[1][name]) for name in kept[1])
    assert not all(torch.equal(weights[0][name], kept[3][name]) for name in kept[3])


def test_time_is_up_after_the_epoch_and_the_rest_can_follow(pairs, request_for):
    request = request_for(minutes=1e-6)
    summary = train_coverage(request)
    assert summary.counts["epochs"] == 1
    assert summary.notices.count("W_TIME_IS_UP") == 2
    assert not load_coverage_model(request.output).info.training["complete"]
    whole = request_for("whole")
    train_coverage(whole)
    train_coverage(replace(request, resume=True, minutes=None))
    assert request.output.read_bytes() == whole.output.read_bytes()


def test_what_is_held_out_is_never_looked_at(request_for, monkeypatch):
    read = set()

    class Watched(Discs):
        def __getitem__(self, index):
            read.add(index)
            return super().__getitem__(index)

    monkeypatch.setattr(stage, "read_pairs", lambda folder, **options: Watched(count=8))
    summary = train_coverage(request_for(hold_out=("town_2020", "nowhere_*"), settings={"epochs": 1}))
    assert read == {0, 2, 4, 6}
    assert summary.notices.count("W_NOTHING_HELD_OUT") == 1


def test_one_place_alone_is_learnt_without_validation(request_for, monkeypatch):
    monkeypatch.setattr(stage, "read_pairs", lambda folder, **options: Discs(count=1))
    request = request_for(settings={"epochs": 2})
    summary = train_coverage(request)
    assert summary.notices.count("W_NO_VALIDATION") == 1
    assert summary.counts["best_epoch"] == 2
    assert "iou" not in (request.work / "metrics.csv").read_text()


def test_images_whose_truth_is_unknown_are_left_out(request_for, monkeypatch):
    discs = Discs(count=6, unknown=(0, 1, 2, 3, 4))
    monkeypatch.setattr(stage, "read_pairs", lambda folder, **options: discs)
    request = replace(request_for(settings={"epochs": 1}), validation_fraction=0.0)
    assert train_coverage(request).notices.count("W_NOTHING_KNOWN") == 5
    discs.unknown = tuple(range(6))
    with pytest.raises(InputError, match="known"):
        train_coverage(request_for("other"))
    with pytest.raises(InputError, match="no image is left"):
        train_coverage(request_for("third", hold_out=("*",)))


def test_a_training_that_runs_away_is_told(pairs, request_for, monkeypatch):
    training = stage._training_module()
    monkeypatch.setattr(training.Trainer, "run_epoch", lambda self, epoch, on_step: {"bce": math.nan})
    request = request_for()
    with pytest.raises(ConfigError, match="ran away"):
        train_coverage(request)
    assert not request.output.exists()


def test_missing_packages_are_named(pairs, request_for, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    with pytest.raises(ConfigError, match=r"urbanforest\[train\]"):
        train_coverage(request_for())


def test_without_tensorboard_all_else_goes_on(pairs, request_for, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "tensorboardX", None)
    summary = train_coverage(request_for(settings={"epochs": 1}))
    assert summary.notices.count("W_NO_TENSORBOARD") == 1
    assert json.dumps(summary.as_record())


def test_settings_that_cannot_be_are_refused_before_anything_is_read(request_for):
    with pytest.raises(ConfigError, match="crop_px"):
        train_coverage(request_for(settings={"crop_px": 30}))
