"""``urbanforest verify``."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import click

from urbanforest_cli.commands import options

if TYPE_CHECKING:
    from urbanforest_cli.verification.verdicts import Verdict


@click.command(short_help="Hold every output of a city against its register.")
@click.argument("out", type=options.FilePath())
@click.argument("files", type=options.FilePath(), nargs=-1)
@options.json_opt
@options.talk_opts
def command(out: Path, files: tuple[Path, ...], as_json: bool) -> None:
    """Hold every output in OUT, a folder that `populate` and `export` wrote to, against the register in it.

    Each has the same plants, by id, within 1 cm of the same place and height, after changes of CRS and axes; is as it
    was written, which exports.json remembers; and shows the growth that the register holds. Of an output cut to a box
    the plants in it count. With FILES, only those; they may lie elsewhere. The exit code is 2 where anything differs,
    is missing, or was named and cannot be checked, and the message lists all faults; 75 while a run writes to OUT.

    \b
    Example:
        urbanforest verify rome-forest
        urbanforest verify rome-forest tiles forest.glb --json
    """
    from urbanforest_cli.verification.stage import verify_outputs
    from urbanforest_cli.verification.verdicts import refuse_faults

    verdicts = verify_outputs(out, files)
    if not as_json and not options.quiet():
        _print_table(verdicts)
    refuse_faults(out, verdicts)
    if as_json:
        click.echo(json.dumps({"outputs": [verdict.as_record() for verdict in verdicts]}, indent=2, ensure_ascii=False))


def _print_table(verdicts: Sequence[Verdict]) -> None:
    width = max(len("output"), *(len(verdict.name) for verdict in verdicts))
    click.echo(f"{'output':<{width}}  {'format':<10}  {'plants':>9}  {'largest distance':>16}  state")
    for verdict in verdicts:
        plants = "" if verdict.plants is None else f"{verdict.plants:,}"
        distance = "" if verdict.largest_distance_m is None else f"{1000 * verdict.largest_distance_m:.2f} mm"
        state = verdict.state + (", part of the city" if verdict.is_part else "")
        state += "" if verdict.recorded or verdict.format == "register" else ", not in exports.json"
        click.echo(f"{verdict.name:<{width}}  {verdict.format:<10}  {plants:>9}  {distance:>16}  {state}")
