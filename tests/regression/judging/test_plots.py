from __future__ import annotations

import io

import numpy as np
import pytest
from PIL import Image

from urbanforest_cli.regression.judging.markdown import as_markdown
from urbanforest_cli.regression.judging.plots import draw_judgement, png_of
from urbanforest_cli.regression.judging.predictions import Prediction, shares
from urbanforest_cli.regression.judging.results import judge


def judged(pairs, name="model", spreads=True):
    said = np.clip(shares(pairs.values) + np.random.default_rng(0).normal(0, 0.1, pairs.values.shape), 0, 1)
    model = Prediction(said, np.full(said.shape, 0.1) if spreads else None, np.eye(3)[pairs.strategy])
    return judge(pairs, {name: model, "mean": Prediction(np.full(said.shape, 0.5))}, seed=0), model


@pytest.mark.parametrize("name", ["a$b$c", "_\u6771\u4eac", "x" * 300])
def test_a_page_is_a_picture_of_bounded_size_whatever_the_model_is_called(pairs, name):
    found, model = judged(pairs, name)
    with Image.open(io.BytesIO(png_of(draw_judgement(found, model, pairs, f"{name[:60]} on S pairs")))) as picture:
        assert 1200 < picture.width < 2000
        assert 700 < picture.height < 2000


def test_a_page_can_be_drawn_of_a_model_without_spreads_and_of_few_pairs(pairs):
    few = pairs.take(np.arange(5))
    found, model = judged(few, spreads=False)
    assert png_of(draw_judgement(found, model, few, "t")).startswith(b"\x89PNG")


def test_markdown_tables_are_whole(pairs):
    text = as_markdown(judged(pairs, "a|b")[0], "A | title")
    assert text.count("## ") == 1
    assert "a\\|b" in text
    widths = [line.replace("\\|", "").count("|") for line in text.splitlines() if line.startswith("|")]
    heads = [i for i, line in enumerate(text.splitlines()) if line.startswith("| ---")]
    assert len(heads) >= 7
    assert min(widths) > 2
    lines = text.splitlines()
    for head in heads:
        row = head
        while row < len(lines) and lines[row].startswith("|"):
            assert lines[row].replace("\\|", "").count("|") == lines[head].count("|"), lines[row]
            row += 1
    assert "nan" not in text.lower()
