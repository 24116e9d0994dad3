from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from tests.regression.judging.made_pairs import disc_pairs
from urbanforest_cli.core.errors import InputError, OutputExistsError
from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression import model_fit
from urbanforest_cli.regression.judging import stage
from urbanforest_cli.regression.judging.predictions import LOW, RANGE, shares

NAMES = (*stage.probes.LOT_FEATURES, *REGRESSED, "constant")
WHOLE_BATCH = 64


def featured(table):
    """Put the seven made features behind those of the lot."""
    lot = np.tile(np.arange(6, dtype=np.float32), (len(table), 1))
    return stage.replace(table, features=np.column_stack([lot, table.features]).astype(np.float32))


@dataclass
class Maker:
    """Makes pairs and keeps what it was asked."""

    asked: list[tuple[int, int, bool]] = field(default_factory=list)

    def __call__(self, count, seed, values=None, strategies=None):
        self.asked.append((count, seed, values is not None))
        return featured(disc_pairs(count, seed % 1000, values, strategies))


class FakeSession:
    """Reads the truth with noise off the features, which arrive in the model's own order, as its outputs leave."""

    def __init__(self, content: bytes, info) -> None:
        self.info = info

    def predict(self, windows, pixel_m, features):
        assert len(windows) == WHOLE_BATCH
        order = [self.info.features.index(name) for name in REGRESSED]
        said = np.clip(features[:, order], 0, 1)
        out = [REGRESSED.index(name) for name in self.info.parameters]
        values = (LOW + said * RANGE)[:, out]
        return values, np.tile((0.2 * RANGE)[out], (len(said), 1)), np.full((len(said), 3), 1 / 3)


@pytest.fixture(autouse=True)
def _made(monkeypatch):
    def load(path):
        path = path or Path("shipped.onnx")
        if path.stem == "broken":
            raise InputError("the model is damaged", where=path)
        info = SimpleNamespace(
            features=tuple(reversed(NAMES)), parameters=tuple(reversed(REGRESSED)), network="informed",
            window_px=32 if path.stem == "other" else 64,
        )  # fmt: skip
        return SimpleNamespace(path=path, content=b"", sha256="0" * 64, info=info)

    monkeypatch.setattr(stage, "FEATURES", NAMES)
    monkeypatch.setattr(model_fit, "FEATURES", NAMES)
    monkeypatch.setattr(stage, "HAND_FEATURES", NAMES[:6])
    monkeypatch.setattr(stage, "load_parameter_model", load)
    monkeypatch.setattr(stage, "ParameterSession", FakeSession)
    monkeypatch.setattr(stage, "RESPONSE_LOTS", 30)
    monkeypatch.setattr(stage, "ZONES", 40)


def test_a_model_is_asked_and_understood_in_its_own_order():
    table = featured(disc_pairs(150, seed=3))
    model = stage.load_parameter_model(None)
    one, two = (stage.by_model(model, threads)(table) for threads in (1, 3))
    assert (one.values == two.values).all()
    assert one.values == pytest.approx(np.clip(table.features[:, 6:12], 0, 1), abs=1e-5)
    assert one.spreads == pytest.approx(np.full((150, 6), 0.2))
    assert np.corrcoef(one.values[:, 0], shares(table.values)[:, 0])[0, 1] > 0.99


def test_all_is_judged_and_written(tmp_path):
    make = Maker()
    plot, tables = tmp_path / "page.png", tmp_path / "scores.md"
    summary = stage.evaluate_regression(
        make, models=[Path("a/m.onnx"), Path("b/m.onnx")], pairs=300, baseline_pairs=400, probed=True, design="S",
        plot=plot, markdown=tables,
    )  # fmt: skip
    found = summary.judgement
    assert found.predictors == ("m 1", "m 2", "mean", "closed form", "boosting, hand", "boosting, all")
    assert found.total["boosting, all"].mean_r2 > 0.2 > found.total["boosting, hand"].mean_r2
    assert found.responses["radius_mean_m"].slope > 0.9
    assert found.zones["m 1"][-1].mean_r2 > found.zones["m 1"][0].mean_r2
    assert abs(found.shuffle["m 1"]["radius_mean_m"].correlation) < 0.2
    assert plot.read_bytes().startswith(b"\x89PNG")
    assert tables.read_text().startswith("## M 1 on S pairs")
    assert summary.counts["pairs"] == 300
    assert make.asked[0][0] == 300
    assert len({seed for _, seed, given in make.asked if not given}) == 2
    assert make.asked[0][1] not in [seed for _, seed, _ in make.asked[1:]]


def test_without_baselines_the_middle_of_the_range_stands_beside_the_model():
    make = Maker()
    found = stage.evaluate_regression(make, pairs=200).judgement
    assert found.predictors == ("shipped", "mean")
    assert found.total["mean"].mean_r2 == pytest.approx(0, abs=0.05)
    assert len(make.asked) == 1


def test_same_seed_same_judgement_another_seed_other_pairs():
    records = [stage.evaluate_regression(Maker(), pairs=200, seed=seed).judgement.as_record() for seed in (1, 1, 2)]
    assert records[0] == records[1]
    assert records[0] != records[2]


def test_what_cannot_be_used_is_refused_before_any_pair_is_made(tmp_path):
    make = Maker()
    (tmp_path / "mine.png").write_text("no picture")
    (tmp_path / "folder.md").mkdir()
    for arguments, error in (
        ({"models": [Path("broken.onnx")]}, InputError),
        ({"models": [Path("fine.onnx"), Path("other.onnx")]}, InputError),
        ({"plot": tmp_path / "page.pdf"}, InputError),
        ({"markdown": tmp_path / "scores.txt"}, InputError),
        ({"plot": tmp_path / "mine.png"}, OutputExistsError),
        ({"markdown": tmp_path / "folder.md"}, OutputExistsError),
    ):
        with pytest.raises(error):
            stage.evaluate_regression(make, pairs=200, **arguments)
    assert make.asked == []
    assert (tmp_path / "mine.png").read_text() == "no picture"


def test_what_was_counted_while_pairs_were_made_is_told():
    notices = Notices()

    class Telling(Maker):
        def __call__(self, *what, **rest):
            notices.add("W_PAIRS_SMALL", "small lots", 3)
            return super().__call__(*what, **rest)

    summary = stage.evaluate_regression(Telling(), pairs=200, notices=notices)
    assert [(notice["code"], notice["count"]) for notice in summary.as_record()["warnings"]] == [("W_PAIRS_SMALL", 3)]
