"""``urbanforest synth``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Make a procedural city for demos, tests and scale.")
@click.option("--lots", "lot_count", type=click.IntRange(10, 1_000_000), default=350, show_default=True,
              help="Lots of the city.")  # fmt: skip
@options.seed_opt
@click.option("-o", "--output", type=options.FilePath(), required=True, metavar="CITY.gpkg", help="City file to write.")
@click.option("--crs", default="EPSG:32633", show_default=True, metavar="EPSG:CODE", help="A projected CRS in metres.")
@click.option("--squares", is_flag=True, help="Make a few lots squares of the street zone; else roads alone are it.")
@options.overwrite_opt
@options.json_opt
@options.talk_opts
def command(
    lot_count: int, seed: int | None, output: Path, crs: str, squares: bool, overwrite: bool, as_json: bool
) -> None:
    """Make a procedural city and write it to a GeoPackage.

    Writes layers lots, buildings, roads, driveways, entrances, obstacles, sketches and observed_plants. The same
    number of lots and the same seed make the same city.

    \b
    Example:
        urbanforest synth --lots 350 --seed 7 -o city.gpkg
    """
    from urbanforest_cli.synth.stage import make_city

    with options.progress() as progress:
        summary = make_city(
            output,
            lot_count=lot_count,
            seed=seed or 0,
            crs=crs,
            squares=squares,
            overwrite=overwrite,
            progress=progress,
        )
    options.tell([summary], as_json)
