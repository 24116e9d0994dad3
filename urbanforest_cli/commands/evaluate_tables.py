"""What an evaluation tells at the terminal."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import click

if TYPE_CHECKING:
    from rich.console import Console
    from rich.table import Table

    from urbanforest_cli.evaluation.agreement.scores import CoverageAgreement, Estimate
    from urbanforest_cli.evaluation.results import Evaluation
    from urbanforest_cli.evaluation.stage import EvaluationSummary
    from urbanforest_cli.evaluation.tile_counts import TileCounts
    from urbanforest_cli.evaluation.two_sample import FlipTest

PAPER_REMARK = (
    "The paper reports a Chamfer distance of 0.16 for its model and 0.27 for random points, normalisation\n"
    "unstated. Any evenly spaced set that knows nothing of the real plants scores about 0.6 of what random\n"
    "points score, and a lattice beats the true model where real plants stand in groups: read it beside\n"
    "the references, never alone."
)


COVERAGE_REMARK = (
    "Shuffled: every lot with the plants of another of similar size. Random: as many crowns of the same radii\n"
    "anywhere in the lot's open ground. In common: ground under crowns and covered, over ground that is either.\n"
    "Percentages: ground under crowns over the sum of the map's percentages. Intervals: 95 of 100 draws of lots."
)


def tell_evaluation(summary: EvaluationSummary) -> None:
    """Print tables of what an evaluation found, and its warnings."""
    from rich.console import Console

    console = Console(highlight=False, width=None if sys.stdout.isatty() else 110)
    if summary.evaluation is not None:
        _tell_plants(console, summary.evaluation)
    if summary.tiles is not None:
        console.print(_tiles_table(summary.tiles))
    if summary.coverage is not None:
        console.print(_coverage_table(summary.coverage))
        console.print(COVERAGE_REMARK, style="dim")
        console.print(_gains(summary.coverage), style="bold")
    for notice in summary.notices:
        click.echo(f"  warning: {notice.line()}", err=True)


def _tell_plants(console: Console, evaluation: Evaluation) -> None:
    console.print(_counts_table(evaluation))
    if evaluation.classifier is None:
        console.print(
            f"Patterns are not compared: {evaluation.lots_eligible} lots hold enough plants of both kinds; "
            "lower --min-plants, or give more observed plants."
        )
        return
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


def _tiles_table(found: TileCounts) -> Table:
    table = _table("Counts by tile", "", "")
    table.add_row("tiles, with real plants", f"{found.tiles:,}, {found.tiles_with_real:,}")
    table.add_row("placed over real plants", _number(found.ratio, 3))
    table.add_row("correlation, of ranks", f"{_number(found.correlation, 2)}, {_number(found.rank_correlation, 2)}")
    table.add_row("error of a tile, mean", f"{_number(found.error_mean)} plants")
    return table


def _coverage_table(found: CoverageAgreement) -> Table:
    table = _table(
        f"Crowns against the map: {found.lots_compared:,} lots, {found.covered_ha:,.2f} of {found.known_ha:,.2f} ha "
        f"covered ({found.threshold_percent:g} % or more); {found.crowns}",
        "",
        *(one.name for one in found.sets),
    )
    table.add_row("plants", *(f"{one.plants:,}" for one in found.sets))
    rows = (
        ("error of a lot's share, points", "error_mean", 100.0, 1),
        ("lots within 5 points, %", "near_share", 100.0, 1),
        ("bias, points", "bias", 100.0, 1),
        ("correlation over lots", "correlation", 1.0, 3),
        ("in common / in either", "iou", 1.0, 3),
        ("crowns / covered ground", "total_ratio", 1.0, 3),
        ("crowns / percentages", "percent_ratio", 1.0, 3),
    )
    for words, measure, factor, digits in rows:
        judged, *others = (getattr(one, measure) for one in found.sets)
        table.add_row(words, _estimate(judged, factor, digits), *(_value(one, factor, digits) for one in others))
    return table


def _gains(found: CoverageAgreement) -> str:
    return "\n".join(
        f"Better than {gain.over}: error of a share {_estimate(gain.error_mean, 100.0, 1)} points, "
        f"common ground {_estimate(gain.iou, 1.0, 3)}."
        for gain in found.gains
    )


def _value(found: Estimate, factor: float, digits: int) -> str:
    return "" if found.value is None else f"{factor * found.value:.{digits}f}"


def _estimate(found: Estimate, factor: float, digits: int) -> str:
    if found.value is None or found.low is None or found.high is None:
        return _value(found, factor, digits)
    return f"{factor * found.value:.{digits}f} ({factor * found.low:.{digits}f} to {factor * found.high:.{digits}f})"


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
