"""What simple methods reach on real imagery, so that a fault in judging shows as figures nobody has measured."""

from __future__ import annotations

import shutil

import pytest

from urbanforest_cli.core.notices import Notices
from urbanforest_cli.core.progress import silent
from urbanforest_cli.imagery.judging.baselines import AllCovered
from urbanforest_cli.imagery.judging.over_pairs import by_baseline, judge_pairs, learn
from urbanforest_cli.imagery.judging.selection import select_pairs
from urbanforest_cli.imagery.pairing.stage import read_pairs

CLASSES = ("vegetation",)


@pytest.mark.slow
def test_baselines_reach_on_unseen_cities_what_they_reached_elsewhere(real_data, tmp_path):
    pytest.importorskip("sklearn")
    for kind, ending in (("images", "tif"), ("trees", "json")):
        (tmp_path / kind).mkdir()
        for city, count in (("long_beach_2018", 30), ("santa_monica_2020", 30), ("eureka_2020", 21)):
            for number in range(count):
                source = real_data / "naip_california" / kind / f"{city}_{number}.{ending}"
                if source.exists():
                    shutil.copy(source, tmp_path / kind)
    pairs = read_pairs(tmp_path, label="ndvi", classes=CLASSES, notices=Notices())
    chosen = select_pairs(pairs, ("eureka_*",), ("long_beach_*", "santa_monica_*"), where=tmp_path)
    taught = learn([(pairs, chosen.training)], CLASSES, seed=0, progress=silent)
    baselines = (taught.boosted_pixels(), taught.green_index(), AllCovered(1))
    predictors = {one.name: by_baseline(one) for one in baselines}
    found = judge_pairs(pairs, chosen.judged, predictors, CLASSES, seed=0, workers=1, progress=silent)
    scores = found.total["vegetation"].scores
    assert 0.72 < scores["boosted pixels"].iou < 0.84
    assert 0.62 < scores["excess green"].iou < 0.76
    assert scores["boosted pixels"].iou > scores["excess green"].iou + 0.03
    assert scores["all covered"].iou == pytest.approx(scores["all covered"].truth_share)
    assert scores["boosted pixels"].trees > 1500
    assert scores["boosted pixels"].trees_on > 0.85
    assert found.total["vegetation"].truth_trees_on > 0.95
