"""A page that shows how planted crowns cover what a map covers."""

from __future__ import annotations

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from urbanforest_cli.evaluation.agreement.scores import NEAR, CoverageAgreement
from urbanforest_cli.evaluation.agreement.sets import PLACED, RANDOM, RULES, SHUFFLED

COLOURS = {PLACED: "#2a8c4a", RULES: "#3a6ea5", SHUFFLED: "#9a7bb0", RANDOM: "#c8553d"}
LOTS_DRAWN = 20_000


def draw_agreement(found: CoverageAgreement, title: str) -> Figure:
    """Draw covered shares lot by lot, their errors, and the overlap with the map, for every set of crowns."""
    figure = Figure(figsize=(13.5, 4.6), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    placed = found.sets[0]
    error, near = placed.error_mean.value, placed.near_share.value
    figure.suptitle(f"{title}: {found.lots_compared:,} lots, {found.crowns}", fontsize=12)
    left, middle, right = figure.subplots(1, 3)
    shares = found.shares
    step = max(1, len(shares.covered) // LOTS_DRAWN)
    size = np.clip(np.sqrt(shares.known_m2[::step]) / 3, 2, 40)
    left.plot([0, 1], [0, 1], color="#999999", linewidth=1, zorder=1)
    left.scatter(shares.covered[::step], shares.crowns[PLACED][::step], s=size, color=COLOURS[PLACED], alpha=0.4, lw=0)
    left.set(xlim=(0, 1.02), ylim=(0, 1.02), aspect="equal")
    correlation = "" if placed.correlation.value is None else f"correlation {placed.correlation.value:.3f}"
    _tidy(left, f"share of a lot; {correlation}", "covered in the map", "under crowns")
    for one in found.sets:
        errors = np.sort(np.abs(shares.crowns[one.name] - shares.covered))
        if len(errors):
            middle.plot(errors, np.arange(1, len(errors) + 1) / len(errors), color=COLOURS[one.name], label=one.name,
                        linewidth=2.2 if one.name == PLACED else 1.3)  # fmt: skip
    middle.axvline(NEAR, color="#999999", linewidth=0.8, linestyle=":")
    middle.set(xlim=(0, 0.6), ylim=(0, 1.01))
    if len(shares.covered):
        middle.legend(fontsize=8, frameon=False, loc="lower right")
    text = "" if error is None or near is None else f": mean {100 * error:.1f}, {near:.0%} within 5 points"
    _tidy(middle, f"error of the share{text}", "|under crowns - covered|", "share of lots")
    heights = [one.iou for one in found.sets]
    place = np.arange(len(heights))
    value = [estimate.value or 0.0 for estimate in heights]
    right.bar(place, value, width=0.6, color=[COLOURS[one.name] for one in found.sets])
    for x, estimate in zip(place, heights, strict=True):
        if estimate.low is not None and estimate.high is not None:
            right.plot([x, x], [estimate.low, estimate.high], color="#1b1b1b", linewidth=1.4)
    right.set_xticks(place, [one.name for one in found.sets])
    right.set_ylim(0, 1)
    _tidy(right, "ground in common over ground in either", "", "")
    return figure


def _tidy(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)
