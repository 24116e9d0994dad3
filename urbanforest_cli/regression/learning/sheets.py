"""A picture of how far a training is: windows of lots, and of each parameter the truth beside what is read."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from urbanforest_cli.core.parameter_model import STRATEGIES_READ
from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.pair_table import PairTable

PANEL_PX = 160
BAR_PX = 150
LABEL_PX, NUMBERS_PX = 140, 160
GAP_PX = 8
LINE_PX = 24
TEXT_PX = 13
HEADING_PX = 24
PER_STRATEGY = 3
PAPER, INK, FAINT = (255, 255, 255), (40, 40, 40), (170, 170, 170)
BEYOND, GROUND, BUILT, COVERED = (222, 220, 216), (246, 243, 236), (150, 140, 132), (24, 96, 48)
TRUTH, READ, READ_BAND = (200, 60, 30), (30, 90, 170), (190, 210, 235)


@dataclass(frozen=True)
class Said:
    """What a network says of pairs, in units: (pair, parameter) means and spreads, (pair, strategy) probabilities."""

    values: NDArray[np.float64]
    spreads: NDArray[np.float64]
    strategies: NDArray[np.float64]


def chosen(pairs: PairTable) -> NDArray[np.int64]:
    """Return rows of pairs that are shown: of each strategy some, evenly spread over those with two plants or more."""
    rows: list[int] = []
    for letter in range(len(STRATEGIES_READ)):
        there = np.flatnonzero((pairs.strategy == letter) & (pairs.visible >= 2))
        if not len(there):
            there = np.flatnonzero(pairs.strategy == letter)
        picked = np.linspace(0, len(there) - 1, min(PER_STRATEGY, len(there))).round().astype(int)
        rows += there[picked].tolist()
    return np.array(rows, np.int64)


def sheet_png(pairs: PairTable, said: Said, low: Sequence[float], high: Sequence[float], title: str) -> bytes:
    """Return a PNG with one pair a panel, three beside one another.

    A bar is a parameter's range: the true value a red tick, what is read blue with its spread; bars of parameters
    that the pair's strategy does not use are left out.
    """
    wide = PANEL_PX + LABEL_PX + BAR_PX + NUMBERS_PX + 4 * GAP_PX
    high_px = PANEL_PX + HEADING_PX + 2 * GAP_PX
    down = -(-len(pairs) // PER_STRATEGY)
    page = Image.new("RGB", (PER_STRATEGY * wide + GAP_PX, down * high_px + 2 * HEADING_PX), PAPER)
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(TEXT_PX)
    draw.text((GAP_PX, 6), title, INK, font)
    for place in range(len(pairs)):
        x = GAP_PX + place % PER_STRATEGY * wide
        y = HEADING_PX + GAP_PX + place // PER_STRATEGY * high_px
        _panel(page, draw, font, (x, y), pairs.take(np.array([place])), _one(said, place), low, high)
    stream = io.BytesIO()
    page.save(stream, format="PNG")
    return stream.getvalue()


def _panel(
    page: Image.Image,
    draw: ImageDraw.ImageDraw,
    font: ImageFont.FreeTypeFont | ImageFont.ImageFont,
    at: tuple[int, int],
    pair: PairTable,
    said: Said,
    low: Sequence[float],
    high: Sequence[float],
) -> None:
    x, y = at
    side_m = pair.windows.shape[2] * float(pair.pixel_m[0])
    likely = int(np.argmax(said.strategies[0]))
    draw.text(
        (x, y),
        f"{STRATEGIES_READ[int(pair.strategy[0])]}, {int(pair.visible[0])} plants, {side_m:.0f} m wide; "
        f"read: {STRATEGIES_READ[likely]} {100 * said.strategies[0, likely]:.0f} %",
        INK, font,
    )  # fmt: skip
    y += HEADING_PX
    picture = Image.fromarray(coloured(pair.windows[0])).resize((PANEL_PX, PANEL_PX), Image.Resampling.NEAREST)
    page.paste(picture, (x, y))
    for number, name in enumerate(REGRESSED):
        if not pair.used[0, number]:
            continue
        top = y + 4 + number * LINE_PX
        left = x + PANEL_PX + LABEL_PX + 2 * GAP_PX
        truth, value = float(pair.values[0, number]), float(said.values[0, number])
        spread = float(said.spreads[0, number])
        draw.text((x + PANEL_PX + GAP_PX, top), name, INK, font)
        places = [
            left + BAR_PX * min(max((one - low[number]) / (high[number] - low[number]), 0.0), 1.0)
            for one in (value - spread, value + spread, value, truth)
        ]
        draw.line((left, top + 8, left + BAR_PX, top + 8), FAINT)
        draw.rectangle((places[0], top + 3, places[1], top + 13), READ_BAND)
        draw.line((places[2], top + 2, places[2], top + 14), READ, 3)
        draw.line((places[3], top, places[3], top + 16), TRUTH, 3)
        unit = PARAMETERS[name].unit
        text = f"{truth:.2f}: {value:.2f} ± {spread:.2f} {'' if unit == '1' else unit}"
        draw.text((left + BAR_PX + GAP_PX, top), text, INK, font)


def coloured(window: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (row, col, 3) of a window (3, row, col): crowns over the lot's ground and buildings and what is beyond."""
    coverage, ground, edge = (channel.astype(np.float64)[..., None] for channel in window)
    lot = np.where(edge > 0, ground / 100.0 * np.array(GROUND) + (1.0 - ground / 100.0) * np.array(BUILT), BEYOND)
    colours = (1.0 - coverage / 100.0) * lot + coverage / 100.0 * np.array(COVERED)
    return np.asarray(np.rint(colours), np.uint8)


def _one(said: Said, place: int) -> Said:
    part = slice(place, place + 1)
    return Said(said.values[part], said.spreads[part], said.strategies[part])
