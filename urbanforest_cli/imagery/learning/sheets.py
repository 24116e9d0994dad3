"""A picture of how far a training is: images, their truth, and what the network makes of them."""

from __future__ import annotations

import io
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont

from urbanforest_cli.core.coverage_model import UNKNOWN

PANEL_PX = 192
GAP_PX = 6
TEXT_PX = 15
HEADING_PX = 22
TILES = 6
PAPER, INK = (255, 255, 255), (40, 40, 40)
BARE, COVERED, NOT_KNOWN = (246, 243, 236), (24, 96, 48), (214, 170, 190)


@dataclass(frozen=True)
class SheetRow:
    """An image (3, row, col), its truth in percent and its prediction from 0 to 1, both (class, row, col)."""

    name: str
    rgb: NDArray[np.uint8]
    truth: NDArray[np.uint8]
    prediction: NDArray[np.float32]


def chosen(count: int) -> list[int]:
    """Return which of so many validation images are shown: some, evenly spread, always the same."""
    return sorted({round(place) for place in np.linspace(0, count - 1, min(TILES, count))}) if count else []


def sheet_png(rows: Sequence[SheetRow], classes: Sequence[str], title: str) -> bytes:
    """Return a PNG with one image a row: the image, then the truth and the prediction of each class."""
    headings = ["image", *(f"{name}: {what}" for name in classes for what in ("truth", "predicted"))]
    step = PANEL_PX + GAP_PX
    top = 2 * HEADING_PX
    size = GAP_PX + step * len(headings), top + len(rows) * (step + HEADING_PX)
    page = Image.new("RGB", size, PAPER)
    draw, font = ImageDraw.Draw(page), ImageFont.load_default(TEXT_PX)
    draw.text((GAP_PX, 4), title, INK, font)
    for number, heading in enumerate(headings):
        draw.text((GAP_PX + number * step, HEADING_PX), heading, INK, font)
    for line, row in enumerate(rows):
        y = top + line * (step + HEADING_PX)
        panels = [row.rgb.transpose(1, 2, 0)]
        for truth, prediction in zip(row.truth, row.prediction, strict=True):
            panels += [coloured(truth), coloured(np.rint(100.0 * prediction).astype(np.uint8))]
        for number, panel in enumerate(panels):
            page.paste(_scaled(panel), (GAP_PX + number * step, y))
        draw.text((GAP_PX, y + PANEL_PX + 2), row.name, INK, font)
    stream = io.BytesIO()
    page.save(stream, format="PNG")
    return stream.getvalue()


def coloured(percent: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """Return (row, col, 3): from the colour of bare ground at 0 to that of leaves at 100, another where not known."""
    table = np.empty((256, 3))
    share = np.clip(np.arange(256) / 100.0, 0.0, 1.0)[:, None]
    table[:] = (1.0 - share) * np.array(BARE) + share * np.array(COVERED)
    table[UNKNOWN] = NOT_KNOWN
    return np.rint(table).astype(np.uint8)[percent]


def _scaled(panel: NDArray[np.uint8]) -> Image.Image:
    """Fit a panel into its place, at the upper left."""
    image = Image.fromarray(np.ascontiguousarray(panel))
    factor = PANEL_PX / max(image.size)
    size = (max(1, round(image.width * factor)), max(1, round(image.height * factor)))
    return image.resize(size, Image.Resampling.BOX if factor < 1 else Image.Resampling.NEAREST)
