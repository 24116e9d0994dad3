"""Whole trainings of a tiny network: what is left, how they go on, and what is refused."""

from __future__ import annotations

import csv
import json
import math
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.regression.learning.pairs import squares

pytest.importorskip("torch")
pytest.importorskip("onnx")

from urbanforest_cli.core.errors import ConfigError, InputError, OutputExistsError, StaleError
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.files.parameter_models import ParameterSession, load_parameter_model
from urbanforest_cli.regression.learning import stage
from urbanforest_cli.regression.learning.settings import INFORMED, PAPER
from urbanforest_cli.regression.learning.stage import CHECKPOINT, train_regression
from urbanforest_cli.regression.learning.story import RegressionRequest

TINY = replace(INFORMED, dense=(8,), members=1, bins=2, batch=64, epochs=3, calibration_fraction=0.2)


class Killed(BaseException):
    """What no handler of errors catches."""


@pytest.fixture
def request_for(tmp_path):
    def make(name="model", settings=TINY, pairs=None, **what):
        table = squares(320) if pairs is None else pairs
        return RegressionRequest(
            make=lambda progress, notices: table, pair_count=len(table), output=tmp_path / f"{name}.onnx",
            work=tmp_path / name, settings=settings, **what,
        )  # fmt: skip

    return make


def killed_after(epochs):
    def on_epoch(report, total, left_s):
        if report.epoch == epochs:
            raise Killed

    return on_epoch


def test_a_training_leaves_a_model_its_figures_and_a_sheet_an_epoch(request_for):
    request = request_for(lots=("somewhere/town.gpkg:parcels",))
    lines = []
    summary = train_regression(request, on_epoch=lambda report, total, left_s: lines.append(report.line(total, left_s)))
    model = load_parameter_model(request.output)
    assert (model.info.network, model.info.parameters, model.info.window_px) == ("informed", REGRESSED, 64)
    assert model.info.low[2] == 0.05
    training = model.info.training
    assert training["complete"]
    assert training["pairs"]["lots"] == ["town.gpkg:parcels"]
    assert summary.counts["sha256"] == model.sha256
    with (request.work / "metrics.csv").open() as stream:
        rows = list(csv.DictReader(stream))
    assert [row["epoch"] for row in rows] == ["1", "2", "3"]
    best = max(rows, key=lambda row: float(row["r2"]))
    assert int(best["epoch"]) == summary.counts["best_epoch"]
    sheets = sorted((request.work / "sheets").iterdir())
    assert [path.name for path in sheets] == ["epoch_0001.png", "epoch_0002.png", "epoch_0003.png"]
    with Image.open(sheets[0]) as sheet:
        assert 800 < sheet.width < 2000
    assert any(path.name.startswith("events") for path in (request.work / "tensorboard").iterdir())
    assert len(lines) == 3
    assert "R2" in lines[0]
    assert "left" in lines[0]
    assert summary.counts["held_out_pairs"] == 64


def test_scores_in_the_model_are_those_of_the_file_on_lots_never_learnt_from(request_for):
    from urbanforest_cli.regression.learning.samples import parted

    request = request_for()
    train_regression(request)
    model = load_parameter_model(request.output)
    judged = parted(squares(320), TINY).validation
    values, _, strategy = ParameterSession(model.content, model.info).predict(
        judged.windows, judged.pixel_m, judged.features
    )
    for number, name in enumerate(REGRESSED):
        rows = judged.used[:, number]
        truth = judged.values[rows, number]
        r2 = 1 - np.mean((values[rows, number] - truth) ** 2) / np.var(truth)
        assert model.info.scores["validation"]["r2"][name] == pytest.approx(r2, abs=2e-3)
    right = np.mean(strategy.argmax(axis=1) == judged.strategy)
    assert model.info.scores["validation"]["strategies_right"] == pytest.approx(right, abs=0.02)
    assert set(model.info.scores["sureness"]) == set(REGRESSED)


def test_the_best_epoch_is_exported(request_for, monkeypatch):
    from urbanforest_cli.regression.learning import settle

    figures, final = settle.figures, settle.settle
    training = stage._training_module()
    run_epoch = training.Trainer.run_epoch
    scores, kept, exported = iter([0.3, 0.6, 0.5]), [], []

    def ran(self, epoch, on_step):
        losses = run_epoch(self, epoch, on_step)
        kept.append(self.weights())
        return losses

    def scored(trainer, pairs):
        found = figures(trainer, pairs)
        return {**found, "r2": dict.fromkeys(found["r2"], next(scores, 0.0))}

    def settled(trainer, parts):
        exported.append(trainer.weights())
        return final(trainer, parts)

    monkeypatch.setattr(training.Trainer, "run_epoch", ran)
    monkeypatch.setattr(settle, "figures", scored)
    monkeypatch.setattr(settle, "settle", settled)
    assert train_regression(request_for()).counts["best_epoch"] == 2
    assert all(np.array_equal(exported[0][name], kept[1][name]) for name in kept[1])
    assert not all(np.array_equal(exported[0][name], kept[2][name]) for name in kept[2])


def test_the_papers_network_is_written_with_its_usual_error(request_for):
    request = request_for(settings=replace(PAPER, epochs=2, calibration_fraction=0.2))
    summary = train_regression(request)
    model = load_parameter_model(request.output)
    assert (model.info.network, model.info.features) == ("paper", ())
    pairs = squares(5)
    values, spreads, strategy = ParameterSession(model.content, model.info).predict(
        pairs.windows, pairs.pixel_m, pairs.features[:, :0]
    )
    assert values.shape == (5, 6)
    assert (spreads == spreads[0]).all()
    assert strategy == pytest.approx(1 / 3)
    assert "density_r2" in summary.counts


def test_a_killed_training_goes_on_to_the_same_bytes(request_for):
    whole, broken = request_for("whole"), request_for("broken")
    train_regression(whole)
    with pytest.raises(Killed):
        train_regression(broken, on_epoch=killed_after(2))
    assert not broken.output.exists()
    epochs = []
    again = replace(broken, resume=True)
    summary = train_regression(again, on_epoch=lambda report, total, left_s: epochs.append(report.epoch))
    assert epochs == [3]
    assert summary.counts["epochs"] == 3
    assert whole.output.read_bytes() == broken.output.read_bytes()


def test_another_training_is_not_gone_on_with(request_for):
    request = request_for()
    with pytest.raises(Killed):
        train_regression(request, on_epoch=killed_after(1))
    other = replace(request, resume=True, settings=replace(TINY, learning_rate=1e-4))
    with pytest.raises(StaleError, match=r"learning_rate was 0.002, is 0.0001"):
        train_regression(other)
    with pytest.raises(StaleError, match="fingerprint was"):
        train_regression(replace(request, resume=True, make=lambda progress, notices: squares(320, seed=1)))


@pytest.mark.parametrize("damage", ["cut", "flipped", "foreign"])
def test_a_damaged_checkpoint_is_refused(request_for, damage):
    request = request_for()
    with pytest.raises(Killed):
        train_regression(request, on_epoch=killed_after(1))
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
        train_regression(replace(request, resume=True))
    assert error.value.where == path


def test_a_stopped_training_is_not_lost_by_a_second_start(request_for):
    request = request_for()
    with pytest.raises(Killed):
        train_regression(request, on_epoch=killed_after(1))
    before = (request.work / CHECKPOINT).read_bytes()
    with pytest.raises(OutputExistsError, match="stopped"):
        train_regression(replace(request, make=lambda progress, notices: pytest.fail("pairs were made")))
    assert (request.work / CHECKPOINT).read_bytes() == before
    assert train_regression(replace(request, overwrite=True)).counts["epochs"] == 3


def test_a_model_that_is_there_is_kept(request_for):
    request = request_for()
    train_regression(request)
    before = request.output.read_bytes()
    assert train_regression(request).up_to_date
    with pytest.raises(OutputExistsError):
        train_regression(replace(request, settings=replace(TINY, seed=4)))
    request.output.write_bytes(b"mine")
    with pytest.raises(OutputExistsError):
        train_regression(request)
    assert request.output.read_bytes() == b"mine"
    train_regression(replace(request, overwrite=True))
    assert request.output.read_bytes() == before


def test_time_is_up_after_the_epoch_and_the_rest_can_follow(request_for):
    request = request_for(minutes=1e-6)
    summary = train_regression(request)
    assert summary.counts["epochs"] == 1
    assert summary.notices.count("W_TIME_IS_UP") == 2
    assert not load_parameter_model(request.output).info.training["complete"]
    whole = request_for("whole")
    train_regression(whole)
    train_regression(replace(request, resume=True, minutes=None))
    assert request.output.read_bytes() == whole.output.read_bytes()


def test_with_nothing_to_go_on_from_it_begins(request_for):
    summary = train_regression(request_for(resume=True, settings=replace(TINY, epochs=1)))
    assert summary.notices.count("W_NOTHING_TO_RESUME") == 1


def test_a_training_that_runs_away_is_told(request_for, monkeypatch):
    training = stage._training_module()
    monkeypatch.setattr(training.Trainer, "run_epoch", lambda self, epoch, on_step: {"mse": math.nan})
    request = request_for()
    with pytest.raises(ConfigError, match="ran away"):
        train_regression(request)
    assert not request.output.exists()


def test_missing_packages_are_named(request_for, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "onnx", None)
    with pytest.raises(ConfigError, match=r"urbanforest\[train\]"):
        train_regression(request_for())


def test_without_tensorboard_all_else_goes_on(request_for, monkeypatch):
    monkeypatch.setitem(__import__("sys").modules, "tensorboardX", None)
    summary = train_regression(request_for(settings=replace(TINY, epochs=1)))
    assert summary.notices.count("W_NO_TENSORBOARD") == 1
    assert json.dumps(summary.as_record())


def test_what_cannot_be_is_refused_before_pairs_are_made(request_for):
    request = request_for(settings=replace(PAPER, loss="nll"))
    with pytest.raises(ConfigError, match="--loss mse"):
        train_regression(replace(request, make=lambda progress, notices: pytest.fail("pairs were made")))
    with pytest.raises(InputError, match="too few pairs"):
        train_regression(request_for(pairs=squares(60)))


def test_what_was_counted_while_pairs_were_made_is_told(request_for):
    def make(progress, notices):
        notices.add("W_PAIRS_SMALL", "small lots", 3)
        return squares(320)

    request = replace(request_for(), make=make)
    for up_to_date in (False, True):
        summary = train_regression(request)
        assert summary.up_to_date == up_to_date
        assert summary.notices.count("W_PAIRS_SMALL") == 3
