"""A sheet of places: the same ground shown in several ways side by side, one place a row."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.patches import Rectangle
from numpy.typing import NDArray

from urbanforest_cli.core.colours import to_rgb
from urbanforest_cli.export.drawing import Bounds, Pane, fill_polygons, lay_picture, make_pane
from urbanforest_cli.export.map_page import DPI, GROUND, HAIRLINE, INK, PAPER, SOFT_INK
from urbanforest_cli.export.text import length_text, printable, round_length, shortened

PANE_PX = 440
GAP, MARGIN, HEAD, TITLE, NOTE = 14.0, 48.0, 116.0, 40.0, 62.0
BARE, COVERED, UNKNOWN_GROUND = "#f4f1e8", "#1f6b35", "#c9cbd0"
LOT_EDGE = "#6f6a60"
UNKNOWN = 255
LETTERS_A_PANE = 38

Painter = Callable[[Pane], None]


@dataclass(frozen=True)
class SheetRow:
    """A place: the ground shown in metres, a line about it, and a painter for each column, None for no picture."""

    bounds: Bounds
    note: str
    painters: Sequence[Painter | None]


def draw_sheet(titles: Sequence[str], rows: Sequence[SheetRow], *, heading: str, note: str) -> Figure:
    """Draw a sheet.

    Parameters
    ----------
    titles
        Of the columns.
    rows
        With square bounds and as many painters as there are titles.
    heading, note
        Title of the sheet and the line below it.
    """
    width = 2 * MARGIN + len(titles) * PANE_PX + (len(titles) - 1) * GAP
    height = HEAD + TITLE + len(rows) * (PANE_PX + NOTE) + MARGIN / 2
    figure = Figure(figsize=(width / DPI, height / DPI), dpi=DPI, facecolor=PAPER)
    FigureCanvasAgg(figure)
    canvas = figure.add_axes((0, 0, 1, 1), zorder=10)
    canvas.set(xlim=(0, width), ylim=(height, 0))
    canvas.axis("off")

    def write(x: float, y: float, text: str, size: float, colour: str, **style: Any) -> None:
        canvas.text(x, y, printable(text), fontsize=size * 72 / DPI, color=colour, parse_math=False, **style)

    letters = LETTERS_A_PANE * len(titles)
    write(MARGIN, 30, shortened(heading, int(letters * 0.75)), 28, INK, va="top", weight="bold")
    write(MARGIN, 72, shortened(note, int(letters * 1.2)), 17, SOFT_INK, va="top")
    for column, title in enumerate(titles):
        write(MARGIN + column * (PANE_PX + GAP), HEAD + TITLE - 10, title, 21, INK, va="bottom", weight="bold")
    for number, row in enumerate(rows):
        top = HEAD + TITLE + number * (PANE_PX + NOTE)
        for column, paint in enumerate(row.painters):
            left = MARGIN + column * (PANE_PX + GAP)
            pane = make_pane(figure, (left, top, PANE_PX, PANE_PX), row.bounds, GROUND)
            if paint is None:
                write(left + PANE_PX / 2, top + PANE_PX / 2, "nothing there", 17, SOFT_INK, ha="center", va="center")
            else:
                paint(pane)
            frame = Rectangle((left, top), PANE_PX, PANE_PX, facecolor="none", edgecolor=HAIRLINE,
                              linewidth=1.2 * 72 / DPI)  # fmt: skip
            canvas.add_patch(frame)
        scale = PANE_PX / (row.bounds[2] - row.bounds[0])
        length_m = round_length(0.3 * PANE_PX / scale)
        y = top + PANE_PX + 14
        canvas.plot([MARGIN, MARGIN + length_m * scale], [y, y], color=INK, linewidth=3.0 * 72 / DPI,
                    solid_capstyle="butt")  # fmt: skip
        write(MARGIN, y + 8, length_text(length_m, unit_of=length_m), 16, INK, va="top")
        write(MARGIN + PANE_PX + GAP, y - 2, shortened(row.note, letters), 16, SOFT_INK, va="top")
    return figure


def paint_picture(pane: Pane, colours: NDArray[np.uint8], known: NDArray[np.bool_]) -> None:
    """Fill a pane with red, green and blue (row, col, 3), grey where nothing is known."""
    grey = np.round(255 * np.array(to_rgb(UNKNOWN_GROUND))).astype(np.uint8)
    picture = np.full((*known.shape, 4), 255, dtype=np.uint8)
    picture[..., :3] = np.where(known[..., None], colours, grey)
    lay_picture(pane, picture, 1.0)


def paint_percent(pane: Pane, percent: NDArray[np.uint8], bounds: Bounds) -> None:
    """Paint percentages of coverage from bare to green, grey where unknown.

    Parameters
    ----------
    percent
        (row, col), 255 where unknown.
    bounds
        Ground that they lie on; it may reach over the pane.
    """
    share = np.minimum(percent, 100)[..., None] / 100.0
    colours = np.array(to_rgb(BARE)) * (1 - share) + np.array(to_rgb(COVERED)) * share
    picture = np.where((percent == UNKNOWN)[..., None], np.array(to_rgb(UNKNOWN_GROUND)), colours)
    west, south, east, north = bounds
    pane.axes.imshow(picture, extent=(west, east, south, north), interpolation="nearest", zorder=1.0, aspect="auto")


def paint_outlines(pane: Pane, lots: NDArray[np.object_], *, z: float) -> None:
    """Draw the edges of lots, over what lies below `z`."""
    fill_polygons(pane, lots, "none", edge=LOT_EDGE, edge_px=0.9, alpha=0.7, z=z)
