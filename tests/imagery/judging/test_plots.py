from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from urbanforest_cli.imagery.judging.plots import ADDED, AGREED, MISSED, Panel, chosen_tiles, draw_judgement, png_of
from urbanforest_cli.imagery.judging.results import judge, judge_tile

CLASSES = ("canopy", "vegetation")


def judgement(tiles: int, groups: int = 2):
    truth = np.zeros((2, 16, 16), np.uint8)
    truth[:, :8] = 100
    made = []
    for number in range(tiles):
        found = np.zeros((2, 16, 16), bool)
        found[:, : 1 + number % 16] = True
        predictions = {"m": found, "all": found | True}
        made.append(judge_tile(f"t{number:02d}", f"p{number}", f"city_{number % groups}", predictions, truth,
                               np.ones((16, 16), bool), np.array([[4.0, 4.0]])))  # fmt: skip
    return judge(made, CLASSES, ("m", "all"), seed=0)


def panel(name: str = "t", rgb: bool = True) -> Panel:
    truth, predicted, known = (np.zeros((16, 16), bool) for _ in range(3))
    truth[:8], predicted[4:12], known[:, 2:] = True, True, True
    return Panel("best", name, 0.3, np.full((3, 16, 16), 90, np.uint8) if rgb else None, truth, predicted, known,
                 np.array([[4.0, 4.0]]))  # fmt: skip


def colours(png: bytes) -> dict[tuple[int, ...], int]:
    picture = Image.open(io.BytesIO(png)).convert("RGB")
    return {colour: count for count, colour in picture.getcolors(2**24)}


def of(colour: str) -> tuple[int, ...]:
    return tuple(int(colour[i : i + 2], 16) for i in (1, 3, 5))


def test_tiles_run_from_best_to_worst_each_once():
    found = judgement(9)
    chosen = chosen_tiles(found, "canopy")
    assert [rank for rank, _, _ in chosen] == ["best", "upper", "median", "lower", "worst"]
    ious = [iou for _, _, iou in chosen]
    assert ious == sorted(ious, reverse=True)
    assert ious[0] == 1
    assert found.tiles[chosen[0][1]].name == "t07"
    assert len(chosen_tiles(judgement(2), "canopy")) == 2


def test_page_shows_what_agrees_what_was_added_and_what_was_missed():
    shown = colours(png_of(draw_judgement(judgement(6), {"canopy": [panel()], "vegetation": [panel()]}, "a title")))
    agreed, added, missed = (shown[of(colour)] for colour in (AGREED, ADDED, MISSED))
    assert min(agreed, added, missed) > 5_000
    assert added == pytest.approx(missed, rel=0.35)


@pytest.mark.parametrize("name", ["a$b$c", "\u6771\u4eac", "x" * 300, "line\nbreak"])
def test_odd_names_break_no_page(name):
    figure = draw_judgement(judgement(3), {"canopy": [panel(name)], "vegetation": []}, name[:60])
    assert png_of(figure).startswith(b"\x89PNG")


def test_many_groups_and_images_that_nobody_gave_leave_a_page_of_bounded_size():
    found = judgement(40, groups=40)
    with Image.open(io.BytesIO(png_of(draw_judgement(found, {"canopy": [panel(rgb=False)]}, "t")))) as picture:
        assert 1000 < picture.width < 3000
        assert picture.height < 2000
