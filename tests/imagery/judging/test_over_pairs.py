from __future__ import annotations

import threading

import numpy as np
import pytest

from urbanforest_cli.core.progress import silent
from urbanforest_cli.imagery.judging import over_pairs
from urbanforest_cli.imagery.judging.baselines import AllCovered
from urbanforest_cli.imagery.judging.over_pairs import by_baseline, by_model, judge_pairs, learn, panels_of, truth_of

CLASSES = ("canopy", "vegetation")


def perfect(pair):
    return truth_of(pair, CLASSES) >= 50


def run(pairs, predictors, *, indices=range(16), workers=1, classes=CLASSES):
    return judge_pairs(pairs, indices, predictors, classes, seed=0, workers=workers, progress=silent)


def test_a_perfect_predictor_is_perfect_and_all_covered_is_as_good_as_the_truth_s_share(made_pairs):
    found = run(made_pairs, {"m": perfect, "all": by_baseline(AllCovered(2))})
    for one in found.total.values():
        assert (one.scores["m"].iou, one.scores["m"].accuracy, one.scores["m"].bias) == (1, 1, 0)
        assert one.scores["all"].iou == pytest.approx(one.scores["m"].truth_share)
        assert one.places == 8
        assert one.scores["m"].pixels == 16 * 40 * 38
    assert sorted(found.groups) == ["north_2018", "north_2020", "south_2018", "south_2020"]
    assert [found.total[name].scores["m"].trees_on for name in CLASSES] == [0.5, 1]
    assert found.total["canopy"].scores["m"].trees == 16


def test_classes_are_judged_by_name_whatever_their_order(made_pairs):
    found = run(made_pairs, {"m": lambda pair: perfect(pair)[::-1]}, classes=("vegetation", "canopy"))
    assert found.total["canopy"].scores["m"].iou == found.total["vegetation"].scores["m"].iou == 1
    assert found.total["canopy"].scores["m"].truth_share < found.total["vegetation"].scores["m"].truth_share


def test_any_number_of_threads_finds_the_same(made_pairs):
    taught = learn([(made_pairs, range(8))], CLASSES, seed=0, progress=silent).green_index()
    predictors = {"index": by_baseline(taught), "all": by_baseline(AllCovered(2))}
    one, four = (run(made_pairs, predictors, indices=range(8, 16), workers=workers) for workers in (1, 4))
    assert one.as_record() == four.as_record()
    assert one.total["vegetation"].scores["index"].iou > 0.9


def test_few_images_are_in_memory_at_once_and_a_fault_comes_out(made_pairs):
    read, judged = [], []
    lock = threading.Lock()

    class Watched(type(made_pairs)):
        def __getitem__(self, index):
            with lock:
                read.append(index)
            return super().__getitem__(index)

    def faulty(pair):
        judged.append(pair.name)
        if len(judged) > 3:
            raise RuntimeError("as planned")
        return perfect(pair)

    with pytest.raises(RuntimeError, match="as planned"):
        run(Watched(), {"m": faulty})
    assert len(read) <= 6


def test_a_model_tells_its_classes_at_its_thresholds_and_nothing_where_it_knows_nothing(made_pairs, monkeypatch):
    class Session:
        class info:  # noqa: N801
            classes = ("vegetation", "canopy")

    def predicted(session, rgb, valid, resolution_m):
        assert resolution_m == (0.6, 0.6)
        values = np.stack([np.full(valid.shape, 0.45), np.full(valid.shape, 0.55)]).astype(np.float32)
        values[:, ~valid] = np.nan
        return values

    monkeypatch.setattr(over_pairs, "predict_at", predicted)
    pair = made_pairs[0]
    assert by_model(Session(), CLASSES, (0.5, 0.5))(pair)[:, 0, 0].tolist() == [True, False]
    assert by_model(Session(), CLASSES, (0.6, 0.4))(pair)[:, 0, 0].tolist() == [False, True]
    assert not by_model(Session(), ("canopy",), (0.1,))(pair)[0, :, -1].any()


def test_tiles_shown_are_predicted_again(made_pairs):
    found = run(made_pairs, {"m": perfect}, indices=range(8, 16))
    panels = panels_of(found, made_pairs, range(8, 16), perfect)
    assert {panel.name[:5] for panel in panels["canopy"]} == {"south"}
    for panel in panels["vegetation"]:
        pair = made_pairs[made_pairs.names.index(panel.name)]
        assert np.array_equal(panel.truth, pair.truth[1] >= 50)
        assert np.array_equal(panel.predicted, panel.truth)
        assert np.array_equal(panel.known, pair.valid)
