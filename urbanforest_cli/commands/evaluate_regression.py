"""``urbanforest evaluate-regression``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from urbanforest_cli.commands import options

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rich.table import Table

    from urbanforest_cli.regression.judging.results import Judgement
    from urbanforest_cli.regression.judging.stage import RegressionSummary
    from urbanforest_cli.regression.pair_table import PairTable

LOG_WIDTH = 140
HELD_OUT = "held-out"
BASELINE_PAIRS = 16_000


@click.command(short_help="Judge a parameter model beside baselines, and how sure it is.")
@click.option("-m", "--model", "models", type=options.FilePath(), multiple=True, metavar="MODEL.onnx",
              help="Model to judge; more of them are shown beside the first.  [default: the one that comes with the "
                   "program]")  # fmt: skip
@click.option("--pairs", type=click.IntRange(100, 1_000_000), default=2000, show_default=True,
              help="Pairs of coverage and parameters to judge on, made for this.")  # fmt: skip
@click.option("--design", type=click.Choice([HELD_OUT, "S", "P"]), default=HELD_OUT, show_default=True,
              help="Lots and maps as in training, or a frozen test: small lots (S), large lots (P).")  # fmt: skip
@click.option("--faults/--no-faults", default=None,
              help="Whether maps have the faults of real ones.  [default: on held-out pairs only]")  # fmt: skip
@click.option("--lots", multiple=True, metavar="FILE[:LAYER]",
              help="Make held-out pairs on these lots too; a model trained on the same lots has seen their shapes. "
                   "Repeatable.")  # fmt: skip
@click.option("--baselines", is_flag=True,
              help="Teach classical estimators and gradient boosting on as many pairs of the same design.")  # fmt: skip
@click.option("--baseline-pairs", type=click.IntRange(300, 1_000_000), metavar="N",
              help=f"Pairs to teach baselines with, and --baselines.  [default: {BASELINE_PAIRS:,}]")  # fmt: skip
@click.option(
    "--probes", is_flag=True,
    help="Also raise each parameter alone on the same lots, and pool lots that share their parameters.",
)  # fmt: skip
@click.option("--plot", type=options.FilePath(), metavar="FILE.png", help="Write a page of scores and intervals.")
@click.option("--markdown", type=options.FilePath(), metavar="FILE.md", help="Write all tables, for a model card.")
@options.seed_opt
@options.workers_opt
@options.json_opt
@options.talk_opts
def command(
    models: tuple[Path, ...],
    pairs: int,
    design: str,
    faults: bool | None,
    lots: tuple[str, ...],
    baselines: bool,
    baseline_pairs: int | None,
    probes: bool,
    plot: Path | None,
    markdown: Path | None,
    seed: int | None,
    workers: int,
    as_json: bool,
) -> None:
    """Judge how well a model reads placement parameters off coverage, on pairs made anew.

    Tells for each parameter R2, 1 less the normalised mean absolute error (NMAE) and the share of pairs within 10 % of
    the range, on those whose strategy uses it, by plants standing in the lot, and beside a predictor that knows
    nothing; whether intervals hold as many truths as they say; what is left when lots get one another's coverage; and
    what "95 % accuracy" would be under every reading of it. Intervals come from drawing lots anew.

    \b
    Example:
        urbanforest evaluate-regression --design S --baselines --plot small.png
        urbanforest evaluate-regression --design P --faults
        urbanforest evaluate-regression -m parameters.onnx -m paper.onnx --probes --markdown scores.md
    """
    if lots and design != HELD_OUT:
        raise click.UsageError("--lots and --design do not go together: a frozen design has its own lots")
    from urbanforest_cli.core.notices import Notices
    from urbanforest_cli.pipeline_pairs import make_pairs
    from urbanforest_cli.regression.judging.stage import evaluate_regression

    held_out = design == HELD_OUT
    faulty = held_out if faults is None else faults
    notices = Notices()
    to_count = iter([notices])  # each call reads the same files: what they need is counted once
    with options.progress() as progress:

        def make(
            count: int,
            seed: int,
            values: NDArray[np.float64] | None = None,
            strategies: NDArray[np.int8] | None = None,
        ) -> PairTable:
            return make_pairs(
                count,
                lots=tuple(Path(name) for name in lots),
                seed=seed,
                design=None if held_out else design,
                degraded=faulty,
                values=values,
                strategies=strategies,
                workers=workers,
                notices=next(to_count, None),
                progress=progress,
            )

        summary = evaluate_regression(
            make,
            models=models,
            pairs=pairs,
            baseline_pairs=baseline_pairs or (BASELINE_PAIRS if baselines else 0),
            probed=probes,
            design=design if faulty == held_out else f"{design} {'faulty' if faulty else 'faultless'}",
            lots=lots,
            plot=plot,
            markdown=markdown,
            seed=seed or 0,
            threads=workers,
            notices=notices,
            progress=progress,
        )
    if as_json:
        click.echo(json.dumps(summary.as_record(), indent=2, ensure_ascii=False, allow_nan=False))
    elif not options.quiet():
        _tell(summary)


def _tell(summary: RegressionSummary) -> None:
    from rich.console import Console

    judgement = summary.judgement
    assert judgement is not None, "a judgement that ended well has results"
    console = Console(highlight=False, width=None if sys.stdout.isatty() else LOG_WIDTH)
    design = summary.about["design"]
    console.print(_r2_table(judgement, f"R2 on {judgement.pairs:,} {design} pairs, parameters in use"))
    for one in judgement.differences:
        if one.parameter == "mean":
            console.print(f"  {judgement.judged} less {one.against}: mean R2 {one.r2:+.3f} "
                          f"({one.low:+.3f} to {one.high:+.3f})")  # fmt: skip
    console.print(_judged_table(judgement))
    console.print(_visible_table(judgement))
    console.print(_visible_means_table(judgement))
    rows = [[text, *(_number(value) for value in found.values())] for text, found in judgement.readings.items()]
    console.print(_table('What "95 % accuracy" may mean', ["", *judgement.predictors], rows))
    if judgement.responses:
        rows = [[name, *(_number(value) for value in found.predicted), _number(found.slope), _percent(found.rising)]
                for name, found in judgement.responses.items()]  # fmt: skip
        console.print(_table("Raised alone on the same lots: mean prediction, shares of the range",
                             ["", *(f"step {number + 1}" for number in range(len(rows[0]) - 3)), "slope", "rising"],
                             rows))  # fmt: skip
    if judgement.zones:
        rows = [[name, *(_number(one.mean_r2) for one in found)] for name, found in judgement.zones.items()]
        sizes = [f"{one.lots}" for one in next(iter(judgement.zones.values()))]
        console.print(_table("Mean R2 when so many lots share their parameters", ["", *sizes], rows))
    for notice in summary.notices:
        click.echo(f"  warning: {notice.line()}", err=True)


def _r2_table(judgement: Judgement, title: str) -> Table:
    rows = []
    for name, found in judgement.total.items():
        rows.append([name, *(_number(one.r2) for one in found.scores.values()), _number(found.mean_r2),
                     _number(found.mean_one_less_nmae), _percent(found.mean_within),
                     _percent(found.strategy_accuracy)])  # fmt: skip
    names = next(iter(judgement.total.values())).scores
    return _table(title, ["", *names, "mean", "1 - NMAE", "within 10 %", "strategy"], rows)


def _judged_table(judgement: Judgement) -> Table:
    calibration = judgement.calibration.get(judgement.judged, {})
    shuffle = judgement.shuffle[judgement.judged]
    turning = judgement.turning
    rows = []
    for name, one in judgement.total[judgement.judged].scores.items():
        interval = "" if one.r2_low is None else f"{one.r2_low:.3f}-{one.r2_high:.3f}"
        held = [_percent(share) for share in calibration[name].covered] if name in calibration else [""] * 4
        left = _number(shuffle[name].correlation) if name in shuffle else ""
        bias = "" if one.bias is None else f"{one.bias:+.1%}"
        rows.append([name, f"{one.pairs:,}", interval, _number(one.one_less_nmae), _percent(one.within), bias, *held,
                     left, _percent(turning[name].median) if name in turning else ""])  # fmt: skip
    columns = [
        "",
        "pairs",
        "R2, 95 %",
        "1 - NMAE",
        "in 10 %",
        "bias",
        "50 %",
        "68 %",
        "90 %",
        "95 %",
        "swapped",
        "turned",
    ]
    return _table(f"{judgement.judged}: errors, truths in its intervals, correlation left when coverage is swapped",
                  columns, rows)  # fmt: skip


def _visible_table(judgement: Judgement) -> Table:
    rows = []
    for text, found in judgement.by_visible.items():
        one = found[judgement.judged]
        scores = [_number(score.r2) for score in one.scores.values()]
        rows.append([text, f"{judgement.pairs_by_visible[text]:,}", *scores,
                     _number(one.mean_r2), _percent(one.strategy_accuracy)])  # fmt: skip
    columns = ["plants", "pairs", *judgement.total[judgement.judged].scores, "mean", "strategy"]
    return _table(f"{judgement.judged}: R2 by plants standing in the lot", columns, rows)


def _visible_means_table(judgement: Judgement) -> Table:
    rows = [
        [text, *(_number(found[name].mean_one_less_nmae) for name in judgement.predictors)]
        for text, found in judgement.by_visible.items()
    ]
    return _table("Mean 1 - NMAE by plants standing in the lot", ["plants", *judgement.predictors], rows)


def _table(title: str, columns: list[str], rows: list[list[str]]) -> Table:
    """Lay out rows; a column that is empty in all of them is left out."""
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", title_style="bold")
    kept = [index for index in range(len(columns)) if any(row[index] for row in rows)]
    for index in kept:
        name = columns[index].replace("_", "\n", 1) if index else ""
        table.add_column(name, justify="left" if index == 0 else "right", no_wrap=True)
    for row in rows:
        table.add_row(*(row[index] for index in kept))
    return table


def _number(value: float | None) -> str:
    return "" if value is None else f"{value:.3f}"


def _percent(value: float | None) -> str:
    return "" if value is None else f"{value:.1%}"
