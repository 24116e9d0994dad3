"""One page of a judgement: truth against prediction, how sure and how right, and R2 by visible plants."""

from __future__ import annotations

import io
import warnings

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from urbanforest_cli.core.params import PARAMETERS
from urbanforest_cli.core.schema import REGRESSED
from urbanforest_cli.regression.judging.baselines import BOOSTED_ALL, BOOSTED_HAND, CLOSED_FORM, MEAN
from urbanforest_cli.regression.judging.calibration import BINS, LEVELS, Calibration, central_interval
from urbanforest_cli.regression.judging.predictions import LOW, RANGE, Floats, Prediction, shares
from urbanforest_cli.regression.judging.results import Judgement
from urbanforest_cli.regression.pair_table import PairTable

JUDGED_COLOUR, TRUTH_GREEN, GRID = "#1b1b1b", "#2c7a3f", "#dddddd"
COLOURS = {MEAN: "#9a9a9a", CLOSED_FORM: "#c8553d", BOOSTED_HAND: "#3a6ea5", BOOSTED_ALL: "#8cb1d8"}
OTHER_COLOURS = ("#8b5a9e", "#c79a2b", "#4f9d8f", "#a06a4a")
POINTS = 250
DPI, COLUMN_INCHES, ROW_INCHES = 120, 2.55, 2.7
NAME_LETTERS = 28
INTERVAL = 0.68


def draw_judgement(judgement: Judgement, prediction: Prediction, table: PairTable, title: str) -> Figure:
    """Draw a page: a column a parameter.

    Parameters
    ----------
    judgement
        What was found.
    prediction
        Of the predictor judged.
    table
        The pairs; an even choice of them is drawn.
    title
        What was judged on what.
    """
    figure = Figure(figsize=(len(REGRESSED) * COLUMN_INCHES, 3 * ROW_INCHES + 0.6), dpi=DPI, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=13, parse_math=False)
    axes = figure.subplots(3, len(REGRESSED), squeeze=False)
    truth = shares(table.values)
    for number, name in enumerate(REGRESSED):
        rows = np.flatnonzero(table.used[:, number])
        shown = rows[np.linspace(0, len(rows) - 1, min(POINTS, len(rows))).astype(np.int64)]
        _draw_scatter(axes[0, number], number, prediction.take(shown), truth[shown, number], judgement)
        _draw_calibration(axes[1, number], judgement.calibration.get(judgement.judged, {}).get(name))
        _draw_visible(axes[2, number], judgement, name)
    figure.legend(*axes[2, 0].get_legend_handles_labels(), loc="outside lower center", ncols=8, fontsize=9,
                  frameon=False)  # fmt: skip
    return figure


def _draw_scatter(axes: Axes, number: int, prediction: Prediction, truth: Floats, judgement: Judgement) -> None:
    parameter = PARAMETERS[REGRESSED[number]]
    low, width = LOW[number], RANGE[number]
    said = prediction.values[:, number]
    ends = (low, low + width)
    axes.plot(ends, ends, color="#bbbbbb", linewidth=1, linestyle="--")
    if prediction.spreads is not None and len(said):
        bottom, top = (ends[:, number] for ends in central_interval(prediction, INTERVAL))
        axes.vlines(low + truth * width, bottom, top, color=TRUTH_GREEN, alpha=0.16, linewidth=1)
    axes.plot(low + truth * width, low + said * width, linestyle="none", marker="o", markersize=2.4, alpha=0.75,
              color=TRUTH_GREEN, markeredgewidth=0)  # fmt: skip
    axes.set(xlim=ends, ylim=ends)
    found = judgement.total[judgement.judged].scores[parameter.name]
    r2 = "" if found.r2 is None else f"  R2 {found.r2:.2f}"
    unit = "" if parameter.unit == "1" else f", {parameter.unit}"
    _tidy(axes, f"{parameter.symbol}{r2}", f"true {parameter.name}{unit}",
          f"predicted, bars {INTERVAL:.0%}" if number == 0 else "")  # fmt: skip


def _draw_calibration(axes: Axes, found: Calibration | None) -> None:
    axes.plot([0, 1], [0, 1], color="#bbbbbb", linewidth=1, linestyle="--")
    axes.set(xlim=(0, 1), ylim=(0, 1))
    if found is None:
        axes.text(0.5, 0.5, "no spreads", ha="center", fontsize=9)
        _tidy(axes, "", "interval", "")
        return
    heights = np.array(found.ranks) * BINS / 4  # a quarter of the height where ranks are even
    axes.bar((np.arange(BINS) + 0.5) / BINS, heights, width=1 / BINS, color="#d9e6d6", edgecolor="white")
    axes.axhline(0.25, color="#a9c3a4", linewidth=0.8)
    axes.plot([0, *LEVELS, 1], [0, *found.covered, 1], color=JUDGED_COLOUR, marker="o", markersize=4, linewidth=1.2)
    _tidy(axes, f"at most {100 * found.worst:.1f} points off", "interval told (bars: ranks of the truth)",
          "truths within it")  # fmt: skip


def _draw_visible(axes: Axes, judgement: Judgement, name: str) -> None:
    texts = list(judgement.by_visible)
    for number, predictor in enumerate(judgement.predictors):
        colour = JUDGED_COLOUR if number == 0 else COLOURS.get(predictor, OTHER_COLOURS[number % len(OTHER_COLOURS)])
        points = [(place, judgement.by_visible[text][predictor].scores[name].r2) for place, text in enumerate(texts)]
        there = [(place, r2) for place, r2 in points if r2 is not None]
        axes.plot([place for place, _ in there], [max(r2, -0.5) for _, r2 in there], color=colour, marker="o",
                  markersize=5 if number == 0 else 3.5, linewidth=1.3 if number == 0 else 0.9,
                  label=_shortened(predictor), zorder=3 if number == 0 else 2)  # fmt: skip
    axes.set_xticks(range(len(texts)), texts)
    axes.set_ylim(-0.52, 1)
    axes.axhline(0, color="#bbbbbb", linewidth=1)
    _tidy(axes, "", "plants standing in the lot", "R2" if name == REGRESSED[0] else "")


def _tidy(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=10, loc="left", parse_math=False)
    axes.set_xlabel(x, fontsize=8)
    axes.set_ylabel(y, fontsize=8)
    axes.tick_params(labelsize=7.5)
    axes.grid(color=GRID, linewidth=0.5)
    axes.set_axisbelow(True)
    axes.spines[["top", "right"]].set_visible(False)


def _shortened(text: str) -> str:
    clean = "".join(letter if letter.isprintable() and letter != "$" else " " for letter in text).lstrip("_")
    return clean if len(clean) <= NAME_LETTERS else "\u2026" + clean[1 - NAME_LETTERS :]


def png_of(figure: Figure) -> bytes:
    """Return a figure as PNG; letters of names that the font lacks appear as boxes."""
    stream = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph \d+ .* missing from font")
        figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()
