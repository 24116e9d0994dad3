"""Sheets: rendered panels on one page, with headings, captions, labels at places of the scene, and scale bars."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from urbanforest_cli.export.map_page import DPI, INK, PAPER, SOFT_INK
from urbanforest_cli.export.text import printable, round_length


@dataclass(frozen=True)
class Label:
    """Text at a place of a panel.

    Parameters
    ----------
    x_px, y_px
        From the panel's upper left corner.
    text, notes
        A line, and softer ones below it.
    align
        "center", "left" or "right" of the place.
    """

    x_px: float
    y_px: float
    text: str
    notes: tuple[str, ...] = ()
    align: str = "center"


@dataclass(frozen=True)
class Panel:
    """A rendered picture and what is written on and below it.

    Parameters
    ----------
    image
        (h, w, 3) uint8.
    title, note
        Two lines below it.
    labels
        On it.
    px_per_m
        For its scale bar; 0 for none, as in perspective.
    """

    image: NDArray[np.uint8]
    title: str = ""
    note: str = ""
    labels: Sequence[Label] = ()
    px_per_m: float = 0.0


def draw_sheet(
    rows: Sequence[Sequence[Panel]], heading: tuple[str, str], *, gap_px: int = 28, margin_px: int = 70,
    letter_px: float = 20.0,
) -> Figure:  # fmt: skip
    """Put panels side by side, row below row.

    Parameters
    ----------
    rows
        Panels from left to right; those of a row are aligned at their upper edge.
    heading
        Title of the page and the line below it.
    gap_px, margin_px, letter_px
        Between panels, around the page, and the height of letters.
    """
    foot = round(3.6 * letter_px)
    widths = [sum(panel.image.shape[1] for panel in row) + gap_px * (len(row) - 1) for row in rows]
    feet = [foot if any(panel.title or panel.note for panel in row) else 0 for row in rows]
    heights = [max(panel.image.shape[0] for panel in row) + below for row, below in zip(rows, feet, strict=True)]
    head = margin_px + round(5.2 * letter_px)
    width, height = max(widths) + 2 * margin_px, head + sum(heights) + gap_px * (len(rows) - 1) + margin_px // 2
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    page = figure.add_axes((0, 0, 1, 1), zorder=10)
    page.set(xlim=(0, width), ylim=(height, 0))
    page.axis("off")

    def write(x: float, y: float, text: str, size: float, colour: str, **style: Any) -> None:
        page.text(x, y, printable(text), fontsize=size * 72 / DPI, color=colour, parse_math=False, **style)

    write(margin_px, margin_px, heading[0], 1.9 * letter_px, INK, va="top", weight="bold")
    write(margin_px, margin_px + 2.9 * letter_px, heading[1], 1.05 * letter_px, SOFT_INK, va="top")
    top = head
    for row, tall in zip(rows, heights, strict=True):
        left = margin_px
        for panel in row:
            high, wide = panel.image.shape[:2]
            axes = figure.add_axes((left / width, 1 - (top + high) / height, wide / width, high / height))
            axes.imshow(panel.image, interpolation="nearest", aspect="auto")
            axes.axis("off")
            for label in panel.labels:
                write(left + label.x_px, top + label.y_px, label.text, letter_px, INK, ha=label.align, va="top")
                for number, line in enumerate(label.notes):
                    write(left + label.x_px, top + label.y_px + (1.35 + 1.15 * number) * letter_px, line,
                          0.86 * letter_px, SOFT_INK, ha=label.align, va="top")  # fmt: skip
            bottom = top + high
            write(left, bottom + 0.5 * letter_px, panel.title, 1.1 * letter_px, INK, va="top", weight="bold")
            write(left, bottom + 2.0 * letter_px, panel.note, 0.95 * letter_px, SOFT_INK, va="top")
            if panel.px_per_m:
                length_m = round_length(0.22 * wide / panel.px_per_m if wide < 900 else 130 / panel.px_per_m)
                right, y = left + wide - 4, bottom - 0.9 * letter_px
                page.plot([right - length_m * panel.px_per_m, right], [y, y], color=INK, solid_capstyle="butt",
                          linewidth=0.13 * letter_px * 72 / DPI)  # fmt: skip
                write(right, y - 0.3 * letter_px, f"{length_m:g} m", 0.86 * letter_px, INK, ha="right", va="bottom")
            left += wide + gap_px
        top += tall + gap_px
    return figure
