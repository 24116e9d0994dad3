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
@click.option("--image", type=options.FilePath(), metavar="FILE.tif",
              help="Take an aerial picture of the city, too; FILE_coverage.tif tells what in it is green.")  # fmt: skip
@click.option("--image-resolution", "resolution_m", type=click.FloatRange(0.1, 5.0), default=0.6, show_default=True,
              metavar="M", help="Side of a pixel in metres.")  # fmt: skip
@click.option("--nir", is_flag=True, help="Give the picture near infrared as a fourth band.")
@options.workers_opt
@options.overwrite_opt
@options.json_opt
@options.talk_opts
def command(
    lot_count: int,
    seed: int | None,
    output: Path,
    crs: str,
    squares: bool,
    image: Path | None,
    resolution_m: float,
    nir: bool,
    workers: int,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Make a procedural city and write it to a GeoPackage.

    Writes layers lots, buildings, roads, driveways, entrances, obstacles, sketches and observed_plants. The same
    number of lots and the same seed make the same city. With --image, a picture of it as from a plane in summer is
    written, too: trees, shrubs, lawns, roofs, cars and shadows, and beside it the percentage of each pixel that is
    canopy, and that is vegetation.

    \b
    Example:
        urbanforest synth --lots 350 --seed 7 -o city.gpkg
        urbanforest synth --lots 350 --seed 7 -o city.gpkg --image city.tif
    """
    if image is None and nir:
        raise click.UsageError("--nir belongs to --image.")
    from urbanforest_cli.synth.picture.stage import PictureSettings
    from urbanforest_cli.synth.stage import make_city

    picture = None
    if image is not None:
        picture = PictureSettings(path=image, resolution_m=resolution_m, nir=nir, workers=workers)

    with options.progress() as progress:
        summary = make_city(
            output,
            lot_count=lot_count,
            seed=seed or 0,
            crs=crs,
            squares=squares,
            picture=picture,
            overwrite=overwrite,
            progress=progress,
        )
    options.tell([summary], as_json)
