"""`evaluate-regression` as a user calls it, with the model that comes with the program."""

from __future__ import annotations

import json

import pytest

from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.files.parameter_models import SHIPPED

shipped = pytest.mark.skipif(not SHIPPED.is_file(), reason="no model is shipped")


@pytest.mark.slow
@shipped
@pytest.mark.parametrize("design", ["S", "P"])
def test_shipped_model_is_judged_and_all_is_told(runner, tmp_path, design):
    plot, tables = tmp_path / "page.png", tmp_path / "scores.md"
    outcome = runner("evaluate-regression", "--design", design, "--pairs", "600", "--plot", plot, "--markdown", tables,
                     "--json", "--workers", "2")  # fmt: skip
    assert outcome.exit_code == 0, outcome.stderr
    record = json.loads(outcome.stdout)
    found = record["judgement"]
    model, nothing = (found["total"][name] for name in found["predictors"])
    assert model["mean_r2"] > {"S": 0.3, "P": 0.42}[design]
    assert model["scores"]["radius_mean_m"]["r2"] > 0.7
    assert abs(nothing["mean_r2"]) < 0.05
    assert set(model["scores"]) == set(REGRESSED)
    for name, left in found["shuffle"][found["predictors"][0]].items():
        assert abs(left["correlation"]) < 0.2, name
        assert left["r2"] < 0.05, name
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert 'What "95 % accuracy" may mean' in tables.read_text()


@pytest.mark.slow
@shipped
def test_tables_are_told_in_words_and_workers_change_nothing(runner):
    told = [runner("evaluate-regression", "--pairs", "150", "--workers", str(workers)) for workers in (1, 3)]
    assert told[0].exit_code == 0, told[0].stderr
    assert told[0].stdout == told[1].stdout
    for text in ("radius", "R2 by plants standing", "95 % accuracy", "swapped"):
        assert text in told[0].stdout


def test_what_does_not_go_together_is_refused(runner, tmp_path):
    outcome = runner("evaluate-regression", "--design", "S", "--lots", "city.gpkg")
    assert (outcome.exit_code, "do not go together" in outcome.stderr) == (2, True)
    for option, value in (("--plot", "page.pdf"), ("--markdown", "scores.txt"), ("-m", "nowhere.onnx")):
        outcome = runner("evaluate-regression", option, tmp_path / value)
        assert outcome.exit_code == 2, option
        assert value in outcome.stderr
        assert "Traceback" not in outcome.stderr


def test_what_files_of_lots_need_is_told_once_however_often_pairs_are_made(runner, monkeypatch):
    from tests.regression.judging.made_pairs import disc_pairs
    from urbanforest_cli import pipeline_pairs
    from urbanforest_cli.core.notices import Notices
    from urbanforest_cli.regression.judging import stage

    told = []

    def make_pairs(count, *, notices, lots, **rest):
        if notices is not None:
            notices.add("W_PAIRS_SMALL", "small lots", len(lots))
        return disc_pairs(count, 1)

    def evaluate(make, *, notices: Notices, **rest):
        for seed in range(3):
            make(10, seed)
        told.extend(notices.as_records())
        raise KeyboardInterrupt

    monkeypatch.setattr(pipeline_pairs, "make_pairs", make_pairs)
    monkeypatch.setattr(stage, "evaluate_regression", evaluate)
    assert runner("evaluate-regression", "--lots", "a.gpkg").exit_code == 130
    assert [(notice["code"], notice["count"]) for notice in told] == [("W_PAIRS_SMALL", 1)]
