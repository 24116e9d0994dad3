from __future__ import annotations

import numpy as np
import pytest
from pyproj import CRS

from urbanforest_cli.core.progress import silent
from urbanforest_cli.core.raster_grid import RasterGrid
from urbanforest_cli.imagery.judging.over_map import blocks, judge_map, panels_of

GRID = RasterGrid(600, 300, (1.0, 0.0, 0.0, 0.0, -1.0, 0.0), CRS.from_epsg(32633))


def reads(values: np.ndarray):
    return lambda window: values[:, window[0] : window[0] + window[2], window[1] : window[1] + window[3]]


def scene() -> tuple[np.ndarray, np.ndarray]:
    truth = np.zeros((1, 300, 600), dtype=np.uint8)
    truth[0, 100:200, 100:500] = 100
    found = np.zeros_like(truth)
    found[0, 100:200, 150:550] = 60
    return found, truth


def judged(found, truth, trees=None, threshold=0.5):
    return judge_map(GRID, "map.tif", reads(found), reads(truth), ("canopy",), (threshold,), trees, seed=0,
                     progress=silent)  # fmt: skip


def test_blocks_cover_every_pixel_once():
    seen = np.zeros((300, 600), dtype=int)
    for row, col, rows, cols in blocks(GRID):
        seen[row : row + rows, col : col + cols] += 1
    assert (seen == 1).all()


def test_a_map_scores_as_counted_by_hand_over_all_blocks():
    found = judged(*scene()).total["canopy"]
    assert found.scores["map.tif"].iou == pytest.approx(350 / 450)
    assert found.scores["map.tif"].pixels == 180_000
    assert found.scores["all covered"].iou == pytest.approx(40_000 / 180_000)
    assert found.tiles == 6


def test_the_threshold_is_a_share_of_the_map_s_percentages():
    assert judged(*scene(), threshold=0.6).total["canopy"].scores["map.tif"].recall > 0.8
    assert judged(*scene(), threshold=0.61).total["canopy"].scores["map.tif"].recall == 0


@pytest.mark.parametrize("percent", [14, 28, 55, 56, 60])
def test_a_pixel_of_exactly_the_threshold_is_covered(percent):
    found, truth = scene()
    found[found > 0] = percent
    assert judged(found, truth, threshold=percent / 100).total["canopy"].scores["map.tif"].recall > 0.8
    found[found > 0] = percent - 1
    assert judged(found, truth, threshold=percent / 100).total["canopy"].scores["map.tif"].recall == 0


def test_what_either_does_not_know_is_left_out():
    found, truth = scene()
    found[0, :, :150] = 255
    truth[0, :, 500:] = 255
    score = judged(found, truth).total["canopy"].scores["map.tif"]
    assert score.pixels == 300 * 350
    assert score.iou == 1
    truth[:] = 255
    assert judged(found, truth) is None


def test_trees_are_found_in_the_block_they_stand_in():
    trees = np.array([[150.5, 300.5], [150.5, 120.5], [255.9, 255.9], [299.9, 599.9]])
    found, truth = scene()
    score = judged(found, truth, trees).total["canopy"]
    assert (score.scores["map.tif"].trees, score.scores["map.tif"].trees_on) == (4, 0.25)
    assert score.truth_trees_on == 0.5


def test_blocks_shown_are_the_map_s_own_pixels():
    found, truth = scene()
    judgement = judged(found, truth, np.array([[150.5, 300.5]]))
    panels = panels_of(judgement, GRID, reads(found), reads(truth), (0.5,), np.array([[150.5, 300.5]]))["canopy"]
    assert [panel.iou for panel in panels] == sorted((panel.iou for panel in panels), reverse=True)
    best = panels[0]
    assert best.name == "row 0 column 256"
    assert np.array_equal(best.truth, truth[0, :256, 256:512] == 100)
    assert np.array_equal(best.predicted, found[0, :256, 256:512] == 60)
    assert best.trees_px.tolist() == [[150.5, 44.5]]
