"""One page of a judgement: scores by group, trees held, and tiles from the best to the worst."""

from __future__ import annotations

import io
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from matplotlib.axes import Axes
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure, SubFigure
from matplotlib.patches import Patch
from numpy.typing import NDArray

from urbanforest_cli.core.coverage_model import CANOPY
from urbanforest_cli.imagery.judging.baselines import ALL, BOOSTED, INDEX
from urbanforest_cli.imagery.judging.results import ClassJudgement, Judgement
from urbanforest_cli.imagery.judging.scores import Floats, Mask, Score

Picture = NDArray[np.float32]

AGREED, ADDED, MISSED, BARE, UNKNOWN_GRAY = "#2c7a3f", "#e0662b", "#3a6ea5", "#f3f1ea", "#b9b9b9"
CANOPY_GREEN, VEGETATION_GREEN = "#2c7a3f", "#8cb85a"
COLOURS = {ALL: "#9a9a9a", INDEX: "#c8553d", BOOSTED: "#3a6ea5"}
LEGEND = {"agreed": AGREED, "predicted only": ADDED, "truth only": MISSED, "unknown": UNKNOWN_GRAY}
JUDGED_COLOUR, TRUTH_COLOUR = "#1b1b1b", "#2c7a3f"
RANKS = {"best": 0.0, "upper": 0.25, "median": 0.5, "lower": 0.75, "worst": 1.0}
GROUPS_SHOWN = 12
PANEL_INCHES, ROW_INCHES, DPI = 2.2, 2.42, 130
NAME_LETTERS = 34


@dataclass(frozen=True)
class Panel:
    """A tile to draw for one class: image (3, rows, cols) 0-255 or None, masks (rows, cols), trees (n, 2) row, col."""

    rank: str
    name: str
    iou: float
    rgb: NDArray[np.uint8] | None
    truth: Mask
    predicted: Mask
    known: Mask
    trees_px: Floats | None


def chosen_tiles(judgement: Judgement, class_name: str) -> list[tuple[str, int, float]]:
    """Choose tiles from best to worst, each once.

    Returns
    -------
    list of (rank, index of the tile, its IoU)
    """
    ranked = judgement.ranked(class_name)
    index_of = {id(tile): index for index, tile in enumerate(judgement.tiles)}
    chosen: dict[int, tuple[str, int, float]] = {}
    for rank, share in RANKS.items():
        if ranked:
            place = round(share * (len(ranked) - 1))
            tile, found = ranked[place]
            chosen.setdefault(place, (rank, index_of[id(tile)], found))
    return list(chosen.values())


def draw_judgement(judgement: Judgement, panels: Mapping[str, Sequence[Panel]], title: str) -> Figure:
    """Draw scores by group, trees beside area, and a row of pictures a tile.

    Parameters
    ----------
    judgement
        What was found.
    panels
        Tiles to show by class, see `chosen_tiles`.
    title
        What was judged against what.
    """
    rows = max((len(shown) for shown in panels.values()), default=0)
    groups = min(len(judgement.groups), GROUPS_SHOWN)
    head = 2.4 + 0.24 * groups
    columns = len(judgement.classes)
    pictured = any(panel.rgb is not None for shown in panels.values() for panel in shown)
    figure = Figure(figsize=(max(columns * (3 + pictured) * PANEL_INCHES, 11.0), 0.5 + head + rows * ROW_INCHES + 0.35),
                    dpi=DPI, layout="constrained")  # fmt: skip
    FigureCanvasAgg(figure)
    figure.suptitle(title, fontsize=13, parse_math=False)
    parts = figure.subfigures(1, columns, squeeze=False, wspace=0.02)
    for part, class_name in zip(parts[0], judgement.classes, strict=True):
        shown = panels.get(class_name, ())
        heights = [head, max(rows, 1) * ROW_INCHES]
        charts, pictures = part.subfigures(2, 1, height_ratios=heights)
        _draw_charts(charts, judgement, class_name)
        _draw_panels(pictures, shown, (rows, 3 + pictured), class_name)
    return figure


def _draw_charts(figure: SubFigure, judgement: Judgement, class_name: str) -> None:
    found = judgement.total[class_name]
    trees = any(one.trees for one in found.scores.values())
    axes = figure.subplots(1, 2 if trees else 1, squeeze=False, width_ratios=(3, 2) if trees else None)
    _draw_groups(axes[0, 0], judgement, class_name)
    if trees:
        _draw_trees(axes[0, 1], judgement, found)


def _draw_groups(axes: Axes, judgement: Judgement, class_name: str) -> None:
    largest = sorted(judgement.groups, key=lambda name: (-judgement.groups[name][class_name].tiles, name))
    names = sorted(largest[:GROUPS_SHOWN])
    rows = [("all", judgement.total[class_name])]
    if len(judgement.groups) > 1:
        rows += [(name, judgement.groups[name][class_name]) for name in names]
    offsets = np.linspace(-0.27, 0.27, len(judgement.predictors)) if len(judgement.predictors) > 1 else [0.0]
    for predictor, offset in zip(judgement.predictors, offsets, strict=True):
        points = [(number + offset, group.scores[predictor]) for number, (_, group) in enumerate(rows)]
        _draw_points(axes, points, predictor, judgement.judged)
    axes.set_yticks(range(len(rows)), [_shortened(name) for name, _ in rows])
    for label in axes.get_yticklabels():
        label.set_parse_math(False)
    axes.set_ylim(len(rows) - 0.5, -0.5)
    axes.set_xlim(0, 1)
    axes.grid(axis="x", color="#dddddd", linewidth=0.7)
    axes.set_axisbelow(True)
    remarks = []
    if any(one.iou_low is not None for _, group in rows for one in group.scores.values()):
        remarks.append("bars: 95 % of draws of other places")
    if left_out := len(judgement.groups) - len(names):
        remarks.append(f"{left_out} more groups not drawn")
    _tidy(axes, f"{class_name}: intersection over union", "; ".join(remarks))
    axes.legend(fontsize=8, frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.07), ncols=4, columnspacing=1.0)


def _draw_points(axes: Axes, points: list[tuple[float, Score]], predictor: str, judged: str) -> None:
    colour = JUDGED_COLOUR if predictor == judged else COLOURS.get(predictor, "#777777")
    size = 6.5 if predictor == judged else 4.5
    there = [(one.iou, y) for y, one in points if one.iou is not None]
    axes.plot([x for x, _ in there], [y for _, y in there], linestyle="none", marker="o", markersize=size,
              color=colour, label=_shortened(predictor))  # fmt: skip
    for y, one in points:
        if one.iou_low is not None and one.iou_high is not None:
            axes.plot([one.iou_low, one.iou_high], [y, y], color=colour, linewidth=1.4)


def _draw_trees(axes: Axes, judgement: Judgement, found: ClassJudgement) -> None:
    axes.plot([0, 1], [0, 1], color="#bbbbbb", linewidth=1, linestyle="--")
    for predictor, one in found.scores.items():
        if one.trees_on is not None and one.predicted_share is not None:
            colour = JUDGED_COLOUR if predictor == judgement.judged else COLOURS.get(predictor, "#777777")
            axes.plot(one.predicted_share, one.trees_on, marker="o", markersize=7, color=colour, clip_on=False)
    truth_share = found.scores[judgement.judged].truth_share
    if found.truth_trees_on is not None and truth_share is not None:
        axes.plot(truth_share, found.truth_trees_on, marker="*", markersize=11, color=TRUTH_COLOUR, clip_on=False)
        axes.annotate("truth", (truth_share, found.truth_trees_on), xytext=(7, -11), textcoords="offset points",
                      fontsize=8, color=TRUTH_COLOUR)  # fmt: skip
    axes.set_xlim(0, 1)
    axes.set_ylim(0, 1)
    trees = found.scores[judgement.judged].trees
    _tidy(axes, f"share of {trees:,} annotated trees held", "share of the area covered (dashed: by chance)")


def _draw_panels(figure: SubFigure, panels: Sequence[Panel], shape: tuple[int, int], class_name: str) -> None:
    if not panels:
        figure.text(0.5, 0.5, "no tile has a truth or a prediction to show", ha="center", fontsize=9)
        return
    grid = figure.subplots(*shape, squeeze=False)
    for axes in grid.flat:
        axes.axis("off")
    green = CANOPY_GREEN if class_name == CANOPY else VEGETATION_GREEN
    for line, panel in zip(grid, panels, strict=False):
        truth, predicted, difference = line[-3:]
        if panel.rgb is not None:
            line[0].imshow(np.moveaxis(panel.rgb, 0, -1))
        truth.imshow(_layers(panel, {green: panel.truth}))
        predicted.imshow(_layers(panel, {green: panel.predicted}))
        difference.imshow(_layers(panel, {
            AGREED: panel.truth & panel.predicted,
            ADDED: panel.predicted & ~panel.truth,
            MISSED: panel.truth & ~panel.predicted,
        }))  # fmt: skip
        if panel.trees_px is not None and len(panel.trees_px):
            row, col = panel.trees_px.T - 0.5
            predicted.plot(col, row, linestyle="none", marker="o", markersize=2.2, markerfacecolor="white",
                           markeredgecolor="black", markeredgewidth=0.5)  # fmt: skip
            predicted.set(xlim=(-0.5, panel.truth.shape[1] - 0.5), ylim=(panel.truth.shape[0] - 0.5, -0.5))
        name, share = f"{panel.rank}: {_shortened(panel.name, 24)}", f"truth, {_share_text(panel.truth, panel.known)}"
        if panel.rgb is not None:
            _name(line[0], name)
        _name(truth, share if panel.rgb is not None else f"{name}; {share}")
        trees = ", dots: trees" if panel.trees_px is not None and len(panel.trees_px) else ""
        _name(predicted, f"prediction, {_share_text(panel.predicted, panel.known)}{trees}")
        _name(difference, f"IoU {panel.iou:.2f}")
    legend = [Patch(color=colour, label=text) for text, colour in LEGEND.items()]
    figure.legend(handles=legend, loc="outside lower center", ncols=4, fontsize=9, frameon=False)


def _layers(panel: Panel, layers: Mapping[str, Mask]) -> Picture:
    picture = np.empty((*panel.known.shape, 3), dtype=np.float32)
    picture[:] = to_rgb(BARE)
    for colour, mask in layers.items():
        picture[mask] = to_rgb(colour)
    picture[~panel.known] = to_rgb(UNKNOWN_GRAY)
    return picture


def _share_text(mask: Mask, known: Mask) -> str:
    return f"{mask[known].mean():.0%}" if known.any() else "unknown"


def _name(axes: Axes, text: str) -> None:
    axes.set_title(text, fontsize=8.5, loc="left", pad=3, parse_math=False)


def _shortened(text: str, letters: int = NAME_LETTERS) -> str:
    clean = "".join(letter if letter.isprintable() else " " for letter in text)
    return clean if len(clean) <= letters else "\u2026" + clean[1 - letters :]


def _tidy(axes: Axes, title: str, x: str) -> None:
    axes.set_title(title, fontsize=10, loc="left")
    axes.set_xlabel(x, fontsize=8.5)
    axes.tick_params(labelsize=8.5)
    axes.spines[["top", "right"]].set_visible(False)


def png_of(figure: Figure) -> bytes:
    """Return a figure as PNG; letters of names that the font lacks appear as boxes."""
    stream = io.BytesIO()
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", message=r"Glyph \d+ .* missing from font")
        figure.savefig(stream, format="png", metadata={"Software": None})
    return stream.getvalue()
