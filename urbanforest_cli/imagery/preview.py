"""The picture of a coverage map: the image, and beside it the same image with what was found laid over it."""

from __future__ import annotations

import io
import json
import math
from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image, ImageDraw, ImageFont
from PIL.PngImagePlugin import PngInfo

from urbanforest_cli.core.coverage_model import CANOPY, UNKNOWN, VEGETATION

SIDE_MOST_PX = 2400
MARGIN_PX, FOOT_PX, LETTER_PX = 24, 56, 22
PANEL_LEAST_PX = 420
PAPER, INK, SOFT_INK = (250, 249, 246), (38, 42, 38), (112, 116, 110)
MISSING = (226, 224, 219)
COLOURS = {CANOPY: (20, 118, 58), VEGETATION: (186, 198, 66)}
NAMES = {CANOPY: "canopy", VEGETATION: "other vegetation"}
VEIL = 0.62
"""How much of the picture the colour hides where all of a pixel is covered."""
FADE = 0.55
"""How pale the image is below."""
PNG_LEVEL = 6  # fixed, so that the same picture gives the same bytes


def panel_size(width_m: float, height_m: float, width_px: int, height_px: int) -> tuple[int, int]:
    """Return width and height in pixels of one of the two panels.

    Parameters
    ----------
    width_m, height_m
        Of the ground shown.
    width_px, height_px
        Of the image; small ones are shown up to eight times as large.
    """
    stacked = _stacked(width_m, height_m)
    across = (SIDE_MOST_PX - 2 * MARGIN_PX) if stacked else (SIDE_MOST_PX - 3 * MARGIN_PX) // 2
    down = (SIDE_MOST_PX - FOOT_PX - (3 if stacked else 2) * MARGIN_PX) // (2 if stacked else 1)
    fits = min(across / width_m, down / height_m)
    enough = min(8 * width_px / width_m, 8 * height_px / height_m)
    scale = min(fits, max(enough, PANEL_LEAST_PX / max(width_m, height_m)))
    return max(round(width_m * scale), 1), max(round(height_m * scale), 1)


def draw_preview(
    rgb: NDArray[np.uint8],
    coverage: NDArray[np.uint8],
    classes: tuple[str, ...],
    *,
    width_m: float,
    height_m: float,
    size_px: tuple[int, int],
    shares: Mapping[str, float],
    provenance: Mapping[str, Any],
) -> bytes:
    """Draw both panels, with a scale bar and what the colours mean.

    Parameters
    ----------
    rgb, coverage
        (3, row, col) 0-255 and (class, row, col) percentages, 255 where unknown; north up.
    width_m, height_m
        Of the ground shown.
    size_px
        Of the image this was made from; see `panel_size`.
    shares
        Covered fraction of the known ground by class, for the legend; empty where nothing is known.

    Returns
    -------
    PNG, at most `SIDE_MOST_PX` a side, with its provenance as JSON in the text chunk ``urbanforest``.
    """
    width, height = panel_size(width_m, height_m, size_px[1], size_px[0])
    known = coverage[0] != UNKNOWN
    left = np.where(known[..., None], rgb.transpose(1, 2, 0), np.array(MISSING, np.uint8))
    panels = [_panel(values, width, height) for values in (left, overlay(left, coverage, classes))]
    stacked = _stacked(width_m, height_m)
    inner = (width, 2 * height + MARGIN_PX) if stacked else (2 * width + MARGIN_PX, height)
    page = Image.new("RGB", (inner[0] + 2 * MARGIN_PX, inner[1] + 2 * MARGIN_PX + FOOT_PX), PAPER)
    page.paste(panels[0], (MARGIN_PX, MARGIN_PX))
    page.paste(panels[1], (MARGIN_PX, 2 * MARGIN_PX + height) if stacked else (2 * MARGIN_PX + width, MARGIN_PX))
    foot = page.height - FOOT_PX - MARGIN_PX // 3
    _scale_bar(page, foot, width, width_m)
    _legend(page, foot, classes, shares)
    stream = io.BytesIO()
    metadata = PngInfo()
    metadata.add_text("urbanforest", json.dumps(dict(provenance), ensure_ascii=True))
    page.save(stream, format="PNG", pnginfo=metadata, compress_level=PNG_LEVEL)
    return stream.getvalue()


def overlay(picture: NDArray[np.uint8], coverage: NDArray[np.uint8], classes: tuple[str, ...]) -> NDArray[np.uint8]:
    """Lay the classes over a faded picture, (row, col, 3): canopy, and vegetation where it stands alone."""
    gray = picture.mean(axis=2, keepdims=True)
    known = (coverage[0] != UNKNOWN)[..., None]
    result = np.where(known, 255 - FADE * (255 - gray), picture).repeat(3 if picture.shape[2] == 1 else 1, axis=2)
    for name in sorted(classes, key=list(COLOURS).index, reverse=True):
        values = coverage[classes.index(name)].astype(np.float64)
        if name == VEGETATION and CANOPY in classes:
            values = np.maximum(values - coverage[classes.index(CANOPY)], 0)
        veil = (np.where(values == UNKNOWN, 0, values) / 100 * VEIL)[..., None]
        result = result * (1 - veil) + np.array(COLOURS[name]) * veil
    return np.rint(np.where(known, result, picture)).astype(np.uint8)


def _stacked(width_m: float, height_m: float) -> bool:
    return width_m > 1.5 * height_m


def _panel(values: NDArray[np.uint8], width: int, height: int) -> Image.Image:
    larger = width > values.shape[1] or height > values.shape[0]
    how = Image.Resampling.NEAREST if larger else Image.Resampling.BOX
    return Image.fromarray(values).resize((width, height), how)


def _scale_bar(page: Image.Image, top: int, width_px: int, width_m: float) -> None:
    """Draw a bar of a round length below the first panel, with a mark for the north."""
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(LETTER_PX)
    metres = _round_length(width_m / 4)
    length = round(metres / width_m * width_px)
    low = top + FOOT_PX // 2
    pen.rectangle((MARGIN_PX, low, MARGIN_PX + length, low + 5), fill=INK)
    label = f"{metres / 1000:g} km" if metres >= 1000 else f"{metres:g} m"
    pen.text((MARGIN_PX + length + 12, low + 2), label, fill=INK, font=font, anchor="lm")
    at = MARGIN_PX + length + 12 + round(pen.textlength(label, font=font)) + 32
    pen.polygon(((at, low - 14), (at - 8, low + 10), (at, low + 5), (at + 8, low + 10)), fill=INK)
    pen.text((at + 16, low + 2), "N", fill=SOFT_INK, font=font, anchor="lm")


def _legend(page: Image.Image, top: int, classes: tuple[str, ...], shares: Mapping[str, float]) -> None:
    """Name the colours and the shares they take, right-aligned."""
    pen, font = ImageDraw.Draw(page), ImageFont.load_default(LETTER_PX)
    low, right = top + FOOT_PX // 2 + 2, page.width - MARGIN_PX
    for name in sorted(classes, key=list(COLOURS).index, reverse=True):
        alone = name == VEGETATION and CANOPY not in classes
        text = VEGETATION if alone else NAMES[name]
        if shares:
            share = shares[name] - (shares[CANOPY] if name == VEGETATION and not alone else 0)
            text += f" {100 * max(share, 0):.0f} %"
        right -= round(pen.textlength(text, font=font))
        pen.text((right, low), text, fill=INK, font=font, anchor="lm")
        right -= 34
        pen.rectangle((right, low - 10, right + 22, low + 10), fill=COLOURS[name])
        right -= 28


def _round_length(metres: float) -> float:
    power = 10.0 ** math.floor(math.log10(metres))
    return next(step * power for step in (5.0, 2.0, 1.0) if step * power <= metres)
