"""`urbanforest train-regression`: its options, and how it stops."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from tests.regression.learning.pairs import squares

pytest.importorskip("torch")
pytest.importorskip("onnx")

from urbanforest_cli import pipeline_pairs
from urbanforest_cli.files.parameter_models import load_parameter_model
from urbanforest_cli.regression.learning import stage


@pytest.fixture
def pairs_made(monkeypatch):
    """Make pairs of squares in place of planted lots; returns what was asked for."""
    asked = []

    def make(count, **options):
        asked.append((count, options))
        options["notices"].add("W_PAIRS_SMALL", "small lots", len(options["lots"]))
        return squares(count)

    monkeypatch.setattr(pipeline_pairs, "make_pairs", make)
    return asked


def test_pairs_become_a_model(tmp_path, runner, pairs_made):
    model = tmp_path / "m.onnx"
    options = ("--pairs", 400, "--epochs", 2, "--threads", 1, "--lots", "town.gpkg:parcels", "--seed", 3)
    done = runner("train-regression", "-o", model, *options, "--json")
    assert done.exit_code == 0, done.stderr
    record = json.loads(done.stdout)
    assert record["counts"]["epochs"] == 2
    assert [notice["count"] for notice in record["warnings"] if notice["code"] == "W_PAIRS_SMALL"] == [1]
    assert load_parameter_model(model).sha256 == record["counts"]["sha256"]
    (count, asked), *_ = pairs_made
    assert (count, asked["lots"], asked["seed"], asked["workers"]) == (240, [Path("town.gpkg:parcels")], 3, 1)
    assert "epoch 1/2  loss mse" in done.stderr
    assert (tmp_path / "m-training" / "metrics.csv").is_file()
    again = runner("train-regression", "-o", model, *options)
    assert (again.exit_code, "up to date" in again.stdout) == (0, True)
    told = runner("train-regression", "-o", model, *options, "-q", "--overwrite")
    assert (told.exit_code, told.stdout, told.stderr) == (0, "", "")


def test_every_option_reaches_the_training(tmp_path, runner, monkeypatch):
    asked = []

    def recorded(request, **rest):
        asked.append(request)
        raise KeyboardInterrupt

    monkeypatch.setattr(stage, "train_regression", recorded)
    done = runner(
        "train-regression", "-o", tmp_path / "m.onnx", "--network", "paper", "--pairs", 500, "--epochs", 7, "--batch",
        32, "--learning-rate", 0.01, "--loss", "mse", "--unused", "zero", "--validation-fraction", 0.3, "--minutes", 4,
        "--seed", 5, "--resume", "--work", tmp_path / "w", "--threads", 3, "--overwrite", "--lots", "a.gpkg", "--lots",
        "b.gpkg:lots",
    )  # fmt: skip
    assert done.exit_code == 130
    (request,) = asked
    settings = request.settings
    assert (settings.network, settings.epochs, settings.batch, settings.learning_rate) == ("paper", 7, 32, 0.01)
    assert (settings.loss, settings.unused, settings.validation_fraction, settings.seed) == ("mse", "zero", 0.3, 5)
    assert (request.pair_count, request.lots, request.minutes) == (500, ("a.gpkg", "b.gpkg:lots"), 4)
    assert (request.resume, request.overwrite, request.threads, request.work) == (True, True, 3, tmp_path / "w")


def test_interrupted_it_tells_how_to_go_on_and_ends_in_the_same_model(tmp_path, runner, pairs_made, monkeypatch):
    from urbanforest_cli.regression.learning.progress_log import EpochReport

    options = ("--pairs", 400, "--epochs", 3, "--threads", 1)
    assert runner("train-regression", "-o", tmp_path / "whole.onnx", *options).exit_code == 0
    line = EpochReport.line

    def interrupted(self, epochs, left_s):
        if self.epoch == 2:
            raise KeyboardInterrupt
        return line(self, epochs, left_s)

    with monkeypatch.context() as patched:
        patched.setattr(EpochReport, "line", interrupted)
        stopped = runner("train-regression", "-o", tmp_path / "m.onnx", *options)
    assert stopped.exit_code == 130
    assert "--resume goes on" in stopped.stderr
    assert not (tmp_path / "m.onnx").exists()
    resumed = runner("train-regression", "-o", tmp_path / "m.onnx", *options, "--resume")
    assert resumed.exit_code == 0, resumed.stderr
    assert "epoch 2/3" not in resumed.stderr
    assert (tmp_path / "m.onnx").read_bytes() == (tmp_path / "whole.onnx").read_bytes()


@pytest.mark.parametrize(
    ("options", "text"),
    [
        (("-o", "model.pt"), ".onnx"),
        (("-o", "m.onnx", "--network", "paper", "--loss", "nll"), "mse"),
        (("-o", "m.onnx", "--pairs", "3"), "100"),
        ((), "--output"),
    ],
)
def test_what_cannot_be_is_refused_at_once(tmp_path, runner, options, text, monkeypatch):
    monkeypatch.chdir(tmp_path)
    done = runner("train-regression", *options)
    assert done.exit_code == 2
    assert text in done.stderr
    assert "Traceback" not in done.stderr


def test_two_trainings_in_one_folder_do_not_mix(tmp_path, runner):
    from urbanforest_cli.core.publish import folder_lock

    with folder_lock(tmp_path / "m-training"):
        done = runner("train-regression", "-o", tmp_path / "m.onnx")
    assert done.exit_code == 75


@pytest.mark.slow
def test_a_small_training_on_planted_lots_beats_knowing_nothing(tmp_path, runner):
    done = runner(
        "train-regression", "-o", tmp_path / "m.onnx", "--pairs", 3000, "--epochs", 6, "--threads", 1, "--json"
    )
    assert done.exit_code == 0, done.stderr
    counts = json.loads(done.stdout)["counts"]
    assert counts["radius_mean_m_r2"] > 0.6
    assert counts["density_r2"] > 0.35
    assert counts["boundary_width_m_r2"] > 0.2
