"""``urbanforest import``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

import click

from urbanforest_cli.commands import options

if TYPE_CHECKING:
    from urbanforest_cli.sources.stage import ImportSummary

CODES_SHOWN = 40

_ROLES = {
    "lots": "Lots",
    "buildings": "Buildings",
    "roads": "Roads, as lines or polygons",
    "driveways": "Driveways",
    "entrances": "Doors and windows",
    "obstacles": "What plants keep away from",
    "sketches": "Zones a person drew",
    "observed": "Real trees, to compare with",
}
_COLUMNS = {
    "lot_id": ("lots", "id", "--lot-id", "identifier of a lot"),
    "zone": ("lots", "zone", "--zone", "zone of a lot"),
    "height": ("buildings", "height", "--height", "height of a building in metres"),
    "road_width": ("roads", "width", "--road-width", "width of a road in metres"),
}

role_opts = options.stack(
    *(click.option(f"--{name}", metavar="FILE[:LAYER]", help=f"{text}.") for name, text in _ROLES.items())
)
column_opts = options.stack(
    *(click.option(flag, metavar="COLUMN", help=f"Column with the {text}.") for _, _, flag, text in _COLUMNS.values())
)


@click.command(short_help="Make a city file from land registers, OSM, Overture and the like.")
@click.argument("sources", nargs=-1, metavar="[SOURCE]...")
@click.option("--profile", metavar="NAME|FILE", help="How to read the sources: a shipped mapping file, or your own.")
@role_opts
@column_opts
@click.option("--default-zone", default="other", show_default=True, help="Zone of lots that nothing gives one.")
@click.option("-o", "--output", type=options.FilePath(), required=True, metavar="CITY.gpkg", help="The city file.")
@options.assume_crs_opt
@options.overwrite_opt
@options.json_opt
@options.talk_opts
def command(
    sources: tuple[str, ...],
    profile: str | None,
    default_zone: str,
    output: Path,
    assume_crs: str | None,
    overwrite: bool,
    as_json: bool,
    **named: str | None,
) -> None:
    """Make a city file from what you have.

    Each SOURCE is a FILE or FILE:LAYER that the profile knows how to read; the options below name single layers
    instead, or besides. Where there are no lots, they are made from streets and buildings.

    Profiles: nyc-pluto, fr-cadastre, osm, nl-bgt, overture, or a mapping file of your own.

    \b
    Example:
        urbanforest import pluto.gpkg --profile nyc-pluto -o city.gpkg
        urbanforest import cadastre.gpkg plu.gpkg osm.gpkg --profile fr-cadastre -o city.gpkg
        urbanforest import --lots parcels.shp --lot-id APN --buildings houses.gpkg:roofs --height H -o city.gpkg
    """
    from urbanforest_cli.core.errors import ConfigError
    from urbanforest_cli.sources.stage import RoleSource, import_city

    columns: dict[str, dict[str, str]] = {}
    for option, (role, use, flag, _) in _COLUMNS.items():
        column = named[option]
        if column is not None:
            if named[role] is None:
                raise ConfigError(
                    f"{flag} needs --{role}", next_step=f"say which layer holds it: --{role} FILE[:LAYER]"
                )
            columns.setdefault(role, {})[use] = column
    roles = {
        "observed_plants" if role == "observed" else role: RoleSource(str(named[role]), columns.get(role, {}))
        for role in _ROLES
        if named[role] is not None
    }
    with options.progress() as progress:
        summary = import_city(
            sources, output, profile=profile, roles=roles, assume_crs=assume_crs, default_zone=default_zone,
            overwrite=overwrite, progress=progress,
        )  # fmt: skip
    options.tell([summary], as_json)
    if not as_json and not options.quiet():
        _tell_sources(summary)


def _tell_sources(summary: ImportSummary) -> None:
    """Tell what was taken, what became of each zone code, and what was left."""
    click.echo("\ntaken")
    for entry in summary.taken:
        made = f" -> {entry['made']:,}" if entry["made"] != entry["taken"] else ""
        click.echo(f"  {entry['layer']:<16} {entry['taken']:>9,} of {entry['rows']:>9,} rows  {entry['source']}{made}")
    click.echo("\nzones")
    for entry in summary.zones[:CODES_SHOWN]:
        code = "(none)" if entry["code"] is None else entry["code"]
        mark = "" if entry["known"] else "  not in the profile" if entry["code"] is not None else ""
        click.echo(f"  {code!s:<40} {entry['zone']:<14} {entry['lots']:>9,} lots{mark}")
    if len(summary.zones) > CODES_SHOWN:
        click.echo(f"  and {len(summary.zones) - CODES_SHOWN} more codes; see them all with --json")
    if summary.left:
        click.echo("\nleft")
        for entry in summary.left:
            click.echo(f"  {entry['source']}: {entry['why']}")
