"""``urbanforest evaluate-coverage``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from urbanforest_cli.commands import options
from urbanforest_cli.commands.pair_options import pair_opts

if TYPE_CHECKING:
    from rich.table import Table

    from urbanforest_cli.imagery.judging.results import ClassJudgement, Judgement
    from urbanforest_cli.imagery.judging.scores import Score
    from urbanforest_cli.imagery.judging.stage import CoverageSummary

WORST_SHOWN = 5
LOG_WIDTH = 120


@click.command(short_help="Judge coverage maps and models against masks, beside baselines.")
@click.argument("judged", metavar="PAIRS|MAP.tif", type=options.FilePath())
@click.option("-m", "--model", type=options.FilePath(), metavar="MODEL.onnx",
              help="Model to judge on PAIRS.  [default: the one that comes with the program]")  # fmt: skip
@click.option("--truth", metavar="FILE[:LAYER]", help="Mask or polygons that MAP.tif is held against.")
@pair_opts
@click.option("--group", "groups", multiple=True, metavar="PATTERN",
              help="Judge these groups or pairs only, such as 'eureka_*'. Repeatable.")  # fmt: skip
@click.option(
    "--train", "training", multiple=True, metavar="PAIRS|PATTERN",
    help="Fit baselines on this folder, or on these of PAIRS, which are then not judged. Repeatable.",
)  # fmt: skip
@click.option(
    "--threshold", type=click.FloatRange(0, 1, min_open=True, max_open=True), metavar="SHARE",
    help="From which value on a pixel counts as covered.  [default: the model's own; 0.5 for a foreign map]",
)  # fmt: skip
@click.option("--plot", type=options.FilePath(), metavar="FILE.png", help="Write a page of scores and pictures.")
@options.assume_crs_opt
@options.seed_opt
@options.workers_opt
@options.json_opt
@options.talk_opts
def command(
    judged: Path,
    model: Path | None,
    truth: str | None,
    label: Any,
    polygons: Path | None,
    trees: Path | None,
    classes: tuple[str, ...] | None,
    palette: dict[str, str],
    image_resolution_m: float | None,
    groups: tuple[str, ...],
    training: tuple[str, ...],
    threshold: float | None,
    plot: Path | None,
    assume_crs: str | None,
    seed: int | None,
    workers: int,
    as_json: bool,
) -> None:
    """Judge a model on PAIRS of images and masks, or MAP.tif against a truth.

    Tells intersection over union (IoU), F1, accuracy and area for each class, in all and by group, beside a map that
    covers everything. With --train also beside a threshold of greenness and beside gradient boosting on each pixel's
    colour and texture, both fitted there. Intervals come from drawing places anew, for tiles of one place are no
    evidence of their own. Truth counts as covered from 50 % on; a tree is held if its point lies on a covered pixel.

    \b
    Example:
        urbanforest evaluate-coverage naip --label ndvi --train 'long_beach_*' --group 'eureka_*' --plot eureka.png
        urbanforest evaluate-coverage masks -m model.onnx
        urbanforest evaluate-coverage coverage.tif --truth delmar.gpkg:canopy
    """
    of_pairs = {"model": model, "polygons": polygons, "group": groups, "train": training, "palette": palette,
                "resolution": image_resolution_m, "label": None if label == "auto" else label}  # fmt: skip
    on_map = _refuse_mixed(judged, truth, [f"--{name}" for name, value in of_pairs.items() if value])
    from urbanforest_cli.imagery.judging.stage import PairOptions, evaluate_map, evaluate_pairs

    with options.progress() as progress:
        if on_map:
            summary = evaluate_map(
                judged,
                truth=truth or "",
                trees=str(trees) if trees else None,
                classes=classes,
                threshold=threshold,
                assume_crs=assume_crs,
                plot=plot,
                seed=seed or 0,
                progress=progress,
            )
        else:
            summary = evaluate_pairs(
                judged,
                model=model,
                reading=PairOptions(
                    label=label,
                    classes=classes,
                    polygons=polygons,
                    trees=trees,
                    palette=palette or None,
                    assume_crs=assume_crs,
                    resolution_m=image_resolution_m,
                ),
                groups=groups,
                training=training,
                threshold=threshold,
                plot=plot,
                seed=seed or 0,
                workers=workers,
                progress=progress,
            )
    if as_json:
        click.echo(json.dumps(summary.as_record(), indent=2, ensure_ascii=False, allow_nan=False))
    elif not options.quiet():
        _tell(summary)


def _refuse_mixed(judged: Path, truth: str | None, named: list[str]) -> bool:
    """Tell whether a map is judged; refuse options named that belong to pairs alone."""
    if truth is not None and judged.is_dir():
        raise click.UsageError("--truth is for a map; the truth of a folder of pairs lies in it")
    if truth is not None and named:
        raise click.UsageError(f"{', '.join(named)} and --truth do not go together: a map is no folder of pairs")
    if truth is None and judged.is_file():
        raise click.UsageError("a map needs a truth: name a mask or polygons with --truth")
    return truth is not None


def _tell(summary: CoverageSummary) -> None:
    from rich.console import Console

    judgement = summary.judgement
    assert judgement is not None, "a judgement that ended well has results"
    console = Console(highlight=False, width=None if sys.stdout.isatty() else LOG_WIDTH)
    for name in judgement.classes:
        found = judgement.total[name]
        threshold = summary.about["thresholds"][name]
        console.print(_class_table(name, threshold, found))
        for line in _remarks(judgement, found):
            console.print(line)
        if len(judgement.groups) > 1:
            console.print(_group_table(judgement, name))
        console.print(_tile_table(judgement, name, every=options.verbosity() == "verbose"))
    for notice in summary.notices:
        click.echo(f"  warning: {notice.line()}", err=True)


def _table(title: str, columns: list[str], rows: list[list[str]]) -> Table:
    """Lay out rows; a column that is empty in all of them is left out."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", title_style="bold")
    kept = [index for index in range(len(columns)) if any(row[index] for row in rows)]
    for index in kept:
        table.add_column(columns[index], justify="left" if index == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(row[index] for index in kept))
    return table


def _class_table(name: str, threshold: float, found: ClassJudgement) -> Table:
    title = f"{name}: {_counted(found.tiles, 'tile')} of {_counted(found.places, 'place')}, "
    title += f"covered from {threshold:.2f} on"
    columns = ["", "IoU", "95 %", "F1", "accuracy", "area", "- truth", "trees on", "1 px near"]
    rows = [[predictor, *_cells(one)] for predictor, one in found.scores.items()]
    truth = next(iter(found.scores.values())).truth_share
    rows.append(["truth", "", "", "", "", _percent(truth), "", _percent(found.truth_trees_on), ""])
    return _table(title, columns, rows)


def _cells(one: Score) -> list[str]:
    return [_number(one.iou), _interval(one), _number(one.f1), _number(one.accuracy), _percent(one.predicted_share),
            _percent(one.bias, sign=True), _percent(one.trees_on), _percent(one.trees_near)]  # fmt: skip


def _remarks(judgement: Judgement, found: ClassJudgement) -> list[str]:
    """Say by how much the predictor judged is ahead of each other, and of how many trees the shares are."""
    lines = [
        f"  {judgement.judged} less {row.against}: IoU {row.iou:+.3f} ({row.low:+.3f} to {row.high:+.3f})"
        for row in found.differences
    ]
    trees = found.scores[judgement.judged].trees
    if trees:
        lines.append(f"  {trees:,} annotated trees; by chance as many are held as there is area")
    return lines


def _group_table(judgement: Judgement, name: str) -> Table:
    judged, *others = judgement.predictors
    title = f"{name} by group: IoU, 95 %, area and trees of {judged}; IoU of others"
    columns = ["", "tiles", "IoU", "95 %", "area", "- truth", "trees on"]
    rows = []
    for group, classes in judgement.groups.items():
        found = classes[name]
        one = found.scores[judged]
        beside = [_number(found.scores[predictor].iou) for predictor in others]
        rows.append([group, f"{found.tiles:,}", _number(one.iou), _interval(one), _percent(one.predicted_share),
                     _percent(one.bias, sign=True), _percent(one.trees_on), *beside])  # fmt: skip
    return _table(title, [*columns, *(predictor.replace(" ", "\n") for predictor in others)], rows)


def _tile_table(judgement: Judgement, name: str, *, every: bool) -> Table:
    from urbanforest_cli.imagery.judging.scores import score

    ranked = judgement.ranked(name)
    shown = ranked if every else ranked[-WORST_SHOWN:]
    title = f"{name}: {'tiles' if every else 'worst tiles'}, best first"
    if len(ranked) > len(shown):
        title += " (-v or --json: every tile)"
    number = judgement.classes.index(name)
    rows = []
    for tile, found in shown:
        one = score(tile.counts[0, number], None if tile.hits is None else tile.hits[1, number])
        rows.append([tile.name, tile.group, _number(found), _percent(one.predicted_share), _percent(one.truth_share),
                     _percent(one.trees_on)])  # fmt: skip
    return _table(title, ["", "group", "IoU", "area", "truth", "trees on"], rows)


def _counted(number: int, noun: str) -> str:
    return f"{number:,} {noun}" if number == 1 else f"{number:,} {noun}s"


def _interval(one: Score) -> str:
    return "" if one.iou_low is None or one.iou_high is None else f"{one.iou_low:.3f}-{one.iou_high:.3f}"


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _percent(value: float | None, *, sign: bool = False) -> str:
    return "" if value is None else f"{value:+.1%}" if sign else f"{value:.1%}"
