"""``urbanforest figures``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Render the paper's figures with this program's own strategies and plants.")
@click.argument("names", nargs=-1, metavar="[NAME]...")
@click.option("-o", "--output", "out", type=options.FilePath(), default=Path("figures"), show_default=True,
              help="Folder to write to.")  # fmt: skip
@options.json_opt
@options.talk_opts
def command(names: tuple[str, ...], out: Path, as_json: bool) -> None:
    """Render the paper's figures, one PNG a page; all of them, or those NAMEd.

    Pages of placement: boundary, cluster, regular, random, structural, envelope, context, growth_of_building,
    vegetation_lots. Pages of grown plants: species_sheet, species_winter, individual_growth, pruned,
    structural_growth, growth_years. The values are those of the presets in configs/paper.

    \b
    Example:
        urbanforest figures -o figures
        urbanforest figures cluster species_sheet
    """
    from urbanforest_cli.core.kernels import announce_compile
    from urbanforest_cli.growth.simulate import KERNELS
    from urbanforest_cli.pipeline_figures import render_figures
    from urbanforest_cli.pipeline_growth_figures import ALL_PAGES, GROWTH_PAGES

    with options.progress() as progress:
        if not names or set(names) & set(GROWTH_PAGES):
            announce_compile(KERNELS, progress)
        summary = render_figures(out, names=names, pages=ALL_PAGES, progress=progress)
    options.tell([summary], as_json)
