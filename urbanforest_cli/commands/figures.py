"""``urbanforest figures``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Render the paper's placement figures with this program's own strategies.")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("-o", "--output", "out", type=options.FilePath(), default=Path("figures"), show_default=True,
              help="Folder to write to.")  # fmt: skip
@options.json_opt
@options.talk_opts
def command(names: tuple[str, ...], out: Path, as_json: bool) -> None:
    """Render the paper's placement figures, one PNG a page; all of them, or those NAMEd.

    Pages: boundary, cluster, regular, random, structural, envelope, context, growth_of_building, vegetation_lots.
    The values are those of the presets in configs/paper.

    \b
    Example:
        urbanforest figures -o figures
        urbanforest figures cluster context
    """
    from urbanforest_cli.pipeline_figures import render_figures

    with options.progress() as progress:
        summary = render_figures(out, names=names, progress=progress)
    options.tell([summary], as_json)
