"""``urbanforest export``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options

FORMATS = ("glb", "3dtiles", "cityjson", "obj", "geojson", "gpkg", "geoparquet", "itree", "canopy")
DETAILS = ("full", "high", "medium", "low", "billboard", "point")
SEASONS = ("spring", "summer", "autumn", "winter")
ALL = "1000000"


def _formats(context: click.Context, parameter: click.Parameter, values: tuple[str, ...]) -> tuple[str, ...]:
    """Take names with commas between apart."""
    names = tuple(dict.fromkeys(name.strip().casefold() for value in values for name in value.split(",")))
    if unknown := [name for name in names if name not in FORMATS]:
        raise click.BadParameter(
            f"no format {', '.join(map(repr, unknown))}; there are {', '.join(FORMATS)}.", context, parameter
        )
    return names


def _count(context: click.Context, parameter: click.Parameter, value: str | None) -> str | None:
    """Take a whole number above 0, or all."""
    if value is None:
        return None
    if value.casefold() == "all":
        return ALL
    if not value.isdecimal() or int(value) < 1:
        raise click.BadParameter(f"{value!r} is neither a number above 0 nor 'all'.", context, parameter)
    return value


@click.command(short_help="Write a planted city as glTF, 3D Tiles, CityJSON, OBJ, tables and canopy rasters.")
@click.argument("out", type=options.FilePath())
@click.option(
    "--to", "formats", callback=_formats, multiple=True, required=True, metavar="FORMAT[,FORMAT...]",
    help="glb: forest.glb; 3dtiles: tiles/; cityjson: forest.city.json; obj: species/; geojson: plants.geojson; "
    "gpkg: plants.gpkg; geoparquet: plants.parquet; itree: itree.csv; canopy: two GeoTIFFs. Repeatable.",
)  # fmt: skip
@click.option("-o", "--output", "path", type=options.FilePath(), help="File or folder to write to, of a single format.")
@click.option(
    "--detail", type=click.Choice(DETAILS),
    help="How much of each plant is drawn.  [default: medium; cityjson: low; export.detail of the config]",
)  # fmt: skip
@click.option(
    "--prototypes", callback=_count, metavar="N|all",
    help="Most shapes of plants that are stored; others take the nearest, and how near is told. all: each its own.  "
    "[default: 300; cityjson: 200; obj: 80; export.prototypes_max of the config]",
)  # fmt: skip
@click.option("--season", type=click.Choice(SEASONS), help="Leaves and flowers.  [default: summer]")
@click.option(
    "--bbox", type=float, nargs=4, metavar="W S E N", help="Only plants in this box, in the CRS of the register."
)
@click.option("--plain", is_flag=True, help="glb without any extension: a node a plant, for readers that need it.")
@click.option("--no-ground", is_flag=True, help="Leave out buildings, lots and roads.")
@click.option(
    "--cell", "cell_m", type=click.FloatRange(0.1, 100), default=1.0, show_default=True, metavar="METRES",
    help="Cell of the canopy rasters.",
)  # fmt: skip
@click.option(
    "--ground-height", "ground_height_m", type=click.FloatRange(-500, 9000), default=0.0, metavar="METRES",
    help="Height of the ground in 3D Tiles, above the ellipsoid of WGS 84.  [default: 0]",
)  # fmt: skip
@options.config_opts
@options.workers_opt
@options.json_opt
@options.talk_opts
def command(
    out: Path,
    formats: tuple[str, ...],
    path: Path | None,
    detail: str | None,
    prototypes: str | None,
    season: str | None,
    bbox: tuple[float, float, float, float] | None,
    plain: bool,
    no_ground: bool,
    cell_m: float,
    ground_height_m: float,
    config_path: Path | None,
    settings: tuple[str, ...],
    seed: int | None,
    workers: int,
    as_json: bool,
) -> None:
    """Write the plants of OUT, a folder that `populate` or `grow` wrote, or its register, in other formats.

    Every file appears whole or not at all and says inside where it comes from; exports.json in OUT lists them with
    their hashes, and `urbanforest verify OUT` holds them against the register.

    \b
    Example:
        urbanforest export rome-forest --to 3dtiles,cityjson
        urbanforest export rome-forest --to glb --detail full --prototypes all --bbox 291000 4640200 291200 4640400
        urbanforest export rome-forest --to canopy --cell 0.5
    """
    if path is not None and len(formats) > 1:
        raise click.UsageError("-o names the output of one format; leave it out or export one format at a time.")
    if plain and "glb" not in formats:
        raise click.UsageError("--plain is for glb.")
    options.refuse_inside_out(bbox)
    register = out / "register.gpkg" if out.is_dir() else out
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.export.formats.stage import Wanted, export_formats

    asked = {"export.detail": detail, "export.season": season, "export.prototypes_max": prototypes}
    settings += tuple(f"{name}={value}" for name, value in asked.items() if value is not None)
    config, seed = options.load(config_path, settings, seed, register)
    wanted = Wanted(
        bbox=bbox, plain=plain, with_surroundings=not no_ground, cell_m=cell_m, ground_height_m=ground_height_m
    )
    with folder_lock(register.parent), options.progress() as progress:
        summaries = export_formats(
            register, formats, path=path, config=config, seed=seed, wanted=wanted, workers=workers, progress=progress
        )
    options.tell(summaries, as_json)
    if not as_json and not options.quiet():
        for summary in summaries:
            click.echo(f"Wrote {summary.output}")
