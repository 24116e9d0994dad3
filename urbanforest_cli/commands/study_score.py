"""``urbanforest study-score``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Score the answers to a study.")
@click.argument("study", type=options.FilePath())
@click.argument("answers", type=options.FilePath(), nargs=-1, required=True)
@options.seed_opt
@options.json_opt
@options.talk_opts
def command(study: Path, answers: tuple[Path, ...], seed: int | None, as_json: bool) -> None:
    """Score ANSWERS, files that the questionnaire of STUDY saved, or folders of them.

    Tells for every set of plants how often it was chosen over the real ones, with 95 % intervals over lots and raters.

    \b
    Example:
        urbanforest study-score rome-study answers/
    """
    from urbanforest_cli.evaluation.study.score import PAPER_PREFERENCE
    from urbanforest_cli.evaluation.study.stage import score_study

    summary = score_study(study, answers, seed=seed or 0)
    options.tell([summary], as_json)
    if as_json or options.quiet() or summary.score is None:
        return
    click.echo(f"{'chosen over real':<18}{'share':>7}  {'95 % interval':<16}{'answers':>8}{'raters':>8}{'lots':>6}")
    for item in summary.score.preferences:
        between = f"{item.low:.0%} to {item.high:.0%}" if item.low is not None and item.high is not None else "-"
        click.echo(
            f"{item.category:<18}{item.share:>7.0%}  {between:<16}{item.answers:>8,}{item.raters:>8,}{item.lots:>6,}"
        )
    click.echo(
        f"50 % is what nobody can tell apart; the paper reports {PAPER_PREFERENCE:.0%} for its placement. "
        f"The left picture was chosen in {summary.score.left_share:.0%} of the answers."
    )
