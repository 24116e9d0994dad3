"""``urbanforest evaluate``."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING

import click

from urbanforest_cli.commands import options

if TYPE_CHECKING:
    from rich.table import Table

    from urbanforest_cli.evaluation.results import Evaluation
    from urbanforest_cli.evaluation.stage import EvaluationSummary
    from urbanforest_cli.evaluation.two_sample import FlipTest

PAPER_REMARK = (
    "The paper reports a Chamfer distance of 0.16 for its model and 0.27 for random points, normalisation\n"
    "unstated. Any evenly spaced set that knows nothing of the real plants scores about 0.6 of what random\n"
    "points score, and a lattice beats the true model where real plants stand in groups: read it beside\n"
    "the references, never alone."
)


@click.command(short_help="Judge placed plants against real ones.")
@options.register_arg
@click.option("--observed", required=True, metavar="FILE[:LAYER]", help="Points of real plants.")
@click.option("--buildings", metavar="FILE[:LAYER]", help="Buildings.  [default: layer buildings beside the points]")
@click.option(
    "--replicate", type=options.FilePath(), metavar="REGISTER",
    help="The same city under another seed: what the model scores against itself.",
)  # fmt: skip
@click.option("--plot", type=options.FilePath(), metavar="FILE.png", help="Write a page of plots.")
@click.option(
    "--min-plants", type=click.IntRange(4), default=5, show_default=True,
    help="Compare patterns in lots where both have this many plants.",
)  # fmt: skip
@click.option(
    "--max-lots", type=click.IntRange(2), default=2000, show_default=True,
    help="Compare patterns in a sample of so many lots where there are more.",
)  # fmt: skip
@options.assume_crs_opt
@options.seed_opt
@options.json_opt
@options.talk_opts
def command(
    register: Path,
    observed: str,
    buildings: str | None,
    replicate: Path | None,
    plot: Path | None,
    min_plants: int,
    max_lots: int,
    assume_crs: str | None,
    seed: int | None,
    as_json: bool,
) -> None:
    """Judge the plants of REGISTER against real ones, lot by lot.

    Counts first; then, at equal counts, how plants stand to one another, to the lot's edge and to buildings, and
    whether a classifier can tell placed from real. Nothing is written into the register.

    \b
    Example:
        urbanforest evaluate rome-forest/register.gpkg --observed rome.gpkg --plot rome.png
    """
    from urbanforest_cli.evaluation.stage import evaluate_register

    with options.progress() as progress:
        summary = evaluate_register(
            register,
            observed=observed,
            buildings=buildings,
            replicate=replicate,
            plot=plot,
            seed=seed or 0,
            min_plants=min_plants,
            max_lots=max_lots,
            assume_crs=assume_crs,
            progress=progress,
        )
    if as_json:
        click.echo(json.dumps(summary.as_record(), indent=2, ensure_ascii=False))
    elif not options.quiet():
        _tell(summary)


def _tell(summary: EvaluationSummary) -> None:
    from rich.console import Console

    evaluation = summary.evaluation
    assert evaluation is not None, "an evaluation that ended well has results"
    console = Console(highlight=False, width=None if sys.stdout.isatty() else 110)
    console.print(_counts_table(evaluation))
    if evaluation.classifier is None:
        console.print(
            f"Patterns are not compared: {evaluation.lots_eligible} lots hold enough plants of both kinds; "
            "lower --min-plants, or give more observed plants."
        )
    else:
        sample = "" if evaluation.lots_compared == evaluation.lots_eligible else f" (of {evaluation.lots_eligible:,})"
        console.print(
            f"Patterns of {evaluation.lots_compared:,} lots{sample}, {evaluation.plants_compared:,} plants of each "
            f"kind: {evaluation.kept_of_real:.0%} of the real and {evaluation.kept_of_model:.0%} of the placed ones, "
            "thinned to equal counts."
        )
        console.print(_tests_table(evaluation))
        console.print(_chamfer_table(evaluation))
        console.print(PAPER_REMARK, style="dim")
        console.print(_score_line(evaluation), style="bold")
    for notice in summary.notices:
        click.echo(f"  warning: {notice.line()}", err=True)


def _table(title: str, *columns: str) -> Table:
    from rich import box
    from rich.table import Table

    table = Table(title=title, box=box.SIMPLE_HEAD, title_justify="left", title_style="bold")
    for index, name in enumerate(columns):
        table.add_column(name, justify="left" if index == 0 else "right")
    return table


def _counts_table(evaluation: Evaluation) -> Table:
    counts = evaluation.counts
    table = _table("Counts", "", "real", "placed", "difference")
    table.add_row("plants in lots with real ones", f"{counts.real:,}", f"{counts.model_in_lots_with_real:,}",
                  _percent(counts.total_error))  # fmt: skip
    table.add_row("plants in all lots", f"{counts.real:,}", f"{counts.model:,}", "")
    table.add_row("lots with plants", f"{counts.lots_with_real:,}", f"{counts.lots_with_model:,}", "")
    table.add_row(
        "plants a hectare, lots with real ones", _number(counts.real_per_ha), _number(counts.model_per_ha), ""
    )
    table.add_row("error of a lot, median", "", "", _percent(counts.lot_error_median, sign=False))
    table.add_row("error of a lot, mean", "", "", _percent(counts.lot_error_mean, sign=False))
    table.add_row("rank correlation over lots", "", "", _number(counts.rank_correlation, 2))
    return table


def _tests_table(evaluation: Evaluation) -> Table:
    table = _table("Is it one process? (p: chance of as large a difference if it is)", "measure", "p", "placed - real")
    middle = "median {:+.3f} +- {:.3f}"
    rows: list[tuple[str, FlipTest | None, int, str]] = [
        ("nearest neighbour, d sqrt(n/A)", evaluation.neighbour, 2, middle),
        ("L(r), 1-20 m", evaluation.l_function, 4, "at 5 m {:+.2f} +- {:.2f} m"),
        ("distance to the lot's edge", evaluation.edge, 1, "median {:+.2f} +- {:.2f} m"),
        ("distance to buildings", evaluation.building, 1, "median {:+.2f} +- {:.2f} m"),
    ]
    for name, test, index, text in rows:
        if test is not None:
            table.add_row(name, f"{test.p:.3f}", text.format(test.difference[index], test.error[index]))
    told = evaluation.classifier
    assert told is not None, "a classifier has run wherever tests have"
    table.add_row(
        f"classifier on {told.features} features",
        f"{told.p:.3f}",
        f"{told.accuracy:.1%} right ({told.low:.1%} to {told.high:.1%}), 50 % is guessing",
    )
    return table


def _chamfer_table(evaluation: Evaluation) -> Table:
    table = _table(
        "Chamfer: sum of squared distances per lot area, mean over lots", "set", "against", "there", "back", "mean"
    )
    labels = {"random": "at random", "even": "evenly spaced (saturated)", "lattice": "square lattice"}
    for row in evaluation.chamfer:
        values = (f"{row.there:.3f}", f"{row.back:.3f}", f"{row.mean:.3f}")
        table.add_row(labels.get(row.name, row.name), row.against, *values)
    return table


def _score_line(evaluation: Evaluation) -> str:
    score = evaluation.score
    if score is None:
        return "Score: too few lots."
    if score.score is None:
        return "Score: none, for the real plants cannot be told from random ones here."
    return (
        f"Score {score.score:.2f} +- {score.error:.2f}: 1 is as near to the real lots as they are to one another, "
        f"0 is points at random (energy distance: model {score.distances['model']:.3f}, random "
        f"{score.distances['random']:.3f}, even {score.distances['even']:.3f}, lattice "
        f"{score.distances['lattice']:.3f}, real against real {score.ceiling:.3f})."
    )


def _percent(value: float | None, *, sign: bool = True) -> str:
    return "" if value is None else f"{value:+.1%}" if sign else f"{value:.1%}"


def _number(value: float | None, digits: int = 1) -> str:
    return "" if value is None else f"{value:.{digits}f}"
