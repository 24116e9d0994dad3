"""``urbanforest study``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Write a questionnaire: which of two plantings looks more realistic?")
@click.argument("register", metavar="OUT", type=options.FilePath())
@click.option("--observed", required=True, metavar="FILE[:LAYER]", help="Points of real plants.")
@click.option(
    "-o", "--output", "folder", type=options.FilePath(), help="Folder to write.  [default: study in OUT's folder]"
)
@click.option(
    "--also", multiple=True, metavar="NAME=REGISTER",
    help="Show the plants of another register of this city too, as rules=rules/register.gpkg.",
)  # fmt: skip
@click.option("--lots", "lots_shown", type=click.IntRange(1, 500), default=28, show_default=True,
              help="Lots to show.")  # fmt: skip
@click.option("--min-plants", type=click.IntRange(1), default=4, show_default=True,
              help="Show lots where every set has this many plants.")  # fmt: skip
@click.option("--title", help="Heading of the questionnaire.")
@options.assume_crs_opt
@options.seed_opt
@options.overwrite_opt
@options.json_opt
@options.talk_opts
def command(
    register: Path,
    observed: str,
    folder: Path | None,
    also: tuple[str, ...],
    lots_shown: int,
    min_plants: int,
    title: str | None,
    assume_crs: str | None,
    seed: int | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Write a two-alternative study of OUT, a folder of populate or a register.

    Lots are drawn from above with their real plants, with those placed and with as many at random, in one style;
    questionnaire.html shows them in pairs, needs neither network nor server and saves its answers to a file;
    key.json tells which pictures are real: keep it from the raters.

    \b
    Example:
        urbanforest study rome-forest --observed rome.gpkg:observed_plants -o rome-study
        urbanforest study-score rome-study answers-*.json
    """
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.pipeline_study import make_study

    register = options.register_in(register)
    others = dict(options.named_path(text, "--also") for text in also)
    folder = folder or register.parent / "study"
    with folder_lock(folder.parent), options.progress() as progress:
        summary = make_study(
            register,
            folder,
            observed=observed,
            also={name: options.register_in(path) for name, path in others.items()},
            lots_shown=lots_shown,
            min_plants=min_plants,
            seed=seed or 0,
            assume_crs=assume_crs,
            title=title,
            overwrite=overwrite,
            progress=progress,
        )
    options.tell([summary], as_json)
    if not as_json and not options.quiet():
        click.echo(f"Open {folder / 'questionnaire.html'} in a browser; keep key.json from the raters")
