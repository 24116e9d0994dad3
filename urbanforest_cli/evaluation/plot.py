"""One page that shows how placed plants compare with real ones."""

from __future__ import annotations

from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FixedLocator
from numpy.typing import NDArray

from urbanforest_cli.evaluation.edges import FARTHEST_BUILDING_M
from urbanforest_cli.evaluation.point_patterns import NEIGHBOUR_SHARES, RADII_M
from urbanforest_cli.evaluation.results import EVEN, LATTICE, MODEL, RANDOM, REAL, Curves, Evaluation

LOOKS: dict[str, dict[str, Any]] = {
    REAL: {"color": "#1b1b1b", "linewidth": 2.2, "zorder": 6},
    MODEL: {"color": "#2a8c4a", "linewidth": 2.2, "zorder": 5},
    RANDOM: {"color": "#c8553d", "linewidth": 1.2, "linestyle": "--", "zorder": 4},
    EVEN: {"color": "#3a6ea5", "linewidth": 1.2, "linestyle": "--", "zorder": 3},
    LATTICE: {"color": "#9a7bb0", "linewidth": 1.2, "linestyle": ":", "zorder": 2},
}
CURVE_POINTS = 400
EDGE_SHARE_SHOWN = 0.99
TICKS = [0, 2, 5, 10, 20, 50, 100, 200, 500, 1000, 2000, 5000, 10_000, 100_000, 1_000_000]


def draw_evaluation(evaluation: Evaluation, title: str) -> Figure:
    """Draw counts, neighbours, L(r), distances to edge and buildings, and the classifier's guesses."""
    figure = Figure(figsize=(13.5, 8.4), dpi=130, layout="constrained")
    FigureCanvasAgg(figure)
    figure.suptitle(f"{title}: {_headline(evaluation)}", fontsize=12)
    if evaluation.curves is None:
        axes = figure.subplots()
        axes.axis("off")
        axes.text(0.5, 0.5, "too few lots hold enough plants of both kinds to compare patterns", ha="center")
        return figure
    axes = figure.subplots(2, 3)
    curves = evaluation.curves
    _draw_counts(axes[0, 0], evaluation, curves)
    _draw_neighbours(axes[0, 1], evaluation, curves)
    _draw_l(axes[0, 2], evaluation, curves)
    _draw_distances(axes[1, 0], curves.edge_m, "distance to the lot's edge [m]", _p(evaluation.edge))
    if curves.building_m:
        _draw_distances(axes[1, 1], curves.building_m, "distance to buildings [m]", _p(evaluation.building))
    else:
        axes[1, 1].axis("off")
        axes[1, 1].text(0.5, 0.5, "no buildings known", ha="center")
    _draw_guesses(axes[1, 2], evaluation, curves)
    return figure


def _headline(evaluation: Evaluation) -> str:
    counts = evaluation.counts
    text = f"{counts.model_in_lots_with_real:,} placed for {counts.real:,} real plants"
    if evaluation.score is not None and evaluation.score.score is not None:
        text += f"; score {evaluation.score.score:.2f} (1 real, 0 at random)"
    return text


def _p(test: object) -> str:
    p = getattr(test, "p", None)
    return "" if p is None else f"p = {p:.3f}"


def _tidy(axes: Axes, title: str, x: str, y: str) -> None:
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(x, fontsize=9)
    axes.set_ylabel(y, fontsize=9)
    axes.tick_params(labelsize=8)
    axes.spines[["top", "right"]].set_visible(False)


def _draw_counts(axes: Axes, evaluation: Evaluation, curves: Curves) -> None:
    seen = curves.real_counts > 0
    real, model = curves.real_counts[seen], curves.model_counts[seen]
    top = max(real.max(), model.max(), 1) * 1.3
    # Equal counts lie on one another: a bubble's area is the number of lots.
    pairs, lots = np.unique(np.column_stack((real, model)), axis=0, return_counts=True)
    axes.plot([0, top], [0, top], color="#999999", linewidth=1, zorder=1)
    axes.scatter(pairs[:, 0], pairs[:, 1], s=8 + 60 * lots / lots.max(), color=LOOKS[MODEL]["color"], alpha=0.45, lw=0)
    for axis, scale in ((axes.xaxis, axes.set_xscale), (axes.yaxis, axes.set_yscale)):
        scale("symlog", linthresh=10)
        axis.set_major_locator(FixedLocator(TICKS))
        axis.set_major_formatter("{x:,.0f}")
    axes.set_xlim(0, top)
    axes.set_ylim(-0.3, top)
    error = evaluation.counts.total_error
    _tidy(axes, f"plants a lot, {len(real):,} lots with real ones; {error:+.1%} in total", "real", "placed")


def _draw_neighbours(axes: Axes, evaluation: Evaluation, curves: Curves) -> None:
    for name, values in curves.neighbour.items():
        axes.plot(NEIGHBOUR_SHARES, values, label=name, marker="o", markersize=3.5, **LOOKS[name])
    axes.set_ylim(0)
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    lots = f"{evaluation.lots_compared:,} lots, {evaluation.plants_compared:,} plants of each"
    _tidy(axes, f"nearest neighbour, {_p(evaluation.neighbour)}; {lots}", "quantile", "distance x sqrt(n / A)")


def _draw_l(axes: Axes, evaluation: Evaluation, curves: Curves) -> None:
    low, high = curves.envelope
    axes.fill_between(RADII_M, low - RADII_M, high - RADII_M, color="#d8d8d8", lw=0, zorder=1,
                      label="99 swaps of real and model")  # fmt: skip
    for name, values in curves.pooled_l.items():
        axes.plot(RADII_M, values - RADII_M, **LOOKS[name])
    axes.axhline(0, color="#999999", linewidth=0.8)
    axes.legend(fontsize=8, frameon=False, loc="lower right")
    _tidy(axes, f"clustered above, spaced out below 0, {_p(evaluation.l_function)}", "r [m]", "L(r) - r [m]")


def _draw_distances(axes: Axes, distances: dict[str, NDArray[np.float64]], label: str, p: str) -> None:
    shares = np.linspace(0, 1, CURVE_POINTS)
    for name, values in distances.items():
        axes.plot(np.quantile(values, shares), shares, label=name, **LOOKS[name])
    shown = max(float(np.quantile(values, EDGE_SHARE_SHOWN)) for values in distances.values())
    axes.set_xlim(0, min(max(shown, 1.0), FARTHEST_BUILDING_M))
    axes.set_ylim(0, 1)
    _tidy(axes, f"{label.split(' [')[0]}, {p}", label, "share of plants")


def _draw_guesses(axes: Axes, evaluation: Evaluation, curves: Curves) -> None:
    test = evaluation.classifier
    assert test is not None, "a classifier has run wherever there are curves"
    axes.hist(curves.guesses, bins=25, color="#cccccc", label="labels swapped at random")
    axes.axvspan(test.low, test.high, color=LOOKS[MODEL]["color"], alpha=0.15, lw=0)
    axes.axvline(test.accuracy, color=LOOKS[MODEL]["color"], linewidth=2.2, label="model told from real")
    axes.set_xlim(0, 1.02)
    axes.legend(fontsize=8, frameon=False, loc="upper left")
    _tidy(axes, f"classifier: {test.accuracy:.0%} right, {_p(test)}; 50 % is guessing", "share right", "of 999")
