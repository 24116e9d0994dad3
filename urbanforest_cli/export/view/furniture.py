"""A scale bar and a north arrow on pictures seen from above."""

from __future__ import annotations

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from numpy.typing import NDArray

from urbanforest_cli.export.map_page import DPI, INK
from urbanforest_cli.export.text import round_length

BAR_SHARE = 0.10  # of the picture's width
LETTER_SHARE = 0.011  # height of letters, of the mean side
MARGIN_SHARE = 0.028
WHOLE_PX = 0.01  # so that rounding to inches and back takes no pixel
LETTERS_BESIDE, LETTERS_ABOVE = 6.0, 8.0  # room that bar, arrow and text take, in heights of letters


def with_scale(image: NDArray[np.uint8], px_per_m: float) -> NDArray[np.uint8]:
    """Draw a scale bar and a north arrow in the lower right corner of a picture (h, w, 3), and return it."""
    height, width = image.shape[:2]
    side = (width + height) / 2
    letter, margin = max(LETTER_SHARE * side, 7.0), MARGIN_SHARE * side
    length_m = round_length(BAR_SHARE * width / px_per_m)
    right, y = width - margin, height - margin
    left, point = right - length_m * px_per_m, 72 / DPI
    west, north = max(int(left - LETTERS_BESIDE * letter), 0), max(int(y - LETTERS_ABOVE * letter), 0)
    wide, high = width - west + WHOLE_PX, height - north + WHOLE_PX
    figure = Figure(figsize=(wide / DPI, high / DPI), dpi=DPI, facecolor="none")
    canvas = FigureCanvasAgg(figure)
    page = figure.add_axes((0, 0, 1, 1))
    page.set(xlim=(west, width), ylim=(height, north))
    page.axis("off")
    page.plot([left, left, right, right], [y - 0.5 * letter, y, y, y - 0.5 * letter], color=INK,
              linewidth=0.11 * letter * point, solid_joinstyle="miter", solid_capstyle="butt")  # fmt: skip
    page.text((left + right) / 2, y - 0.45 * letter, f"{length_m:g} m", fontsize=letter * point, color=INK,
              ha="center", va="bottom", parse_math=False)  # fmt: skip
    x, foot = left - 2.2 * letter, y
    tip = foot - 2.4 * letter
    page.fill([x, x - 0.55 * letter, x], [tip, foot, foot - 0.5 * letter], color=INK, linewidth=0)
    page.fill([x, x + 0.55 * letter, x], [tip, foot, foot - 0.5 * letter], facecolor="none", edgecolor=INK,
              linewidth=0.07 * letter * point)  # fmt: skip
    page.text(x, tip - 0.2 * letter, "N", fontsize=letter * point, color=INK, ha="center", va="bottom",
              parse_math=False)  # fmt: skip
    canvas.draw()  # type: ignore[no-untyped-call]
    drawn = np.asarray(canvas.buffer_rgba())  # type: ignore[no-untyped-call]
    corner = image[north:, west:]
    drawn = drawn[: height - north, : width - west].astype(np.float64)
    cover = drawn[..., 3:] / 255.0
    corner[...] = np.round(corner * (1 - cover) + drawn[..., :3] * cover)
    return image
