"""``urbanforest stencil``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Make a register from a city.")
@click.argument("city", type=options.FilePath())
@click.option(
    "-o", "--output", "register", type=options.FilePath(), required=True, metavar="REGISTER", help="Register to write."
)
@click.option(
    "--coverage", type=options.FilePath(), metavar="COVERAGE.tif",
    help="Coverage map: lots that it knows are planted where it shows vegetation, and nowhere else.",
)  # fmt: skip
@click.option(
    "--sketch", type=options.FilePath(), metavar="FILE",
    help="Sketches: polygons, or a picture in which vegetation is painted; replace the lots' own models inside.",
)  # fmt: skip
@click.option("--keep-observed", is_flag=True, help="Keep the plants of layer observed_plants as they are.")
@options.config_opts
@options.workers_opt
@options.assume_crs_opt
@options.layer_opt
@options.max_bad_opt
@options.overwrite_opt
@options.json_opt
@options.talk_opts
def command(
    city: Path,
    register: Path,
    coverage: Path | None,
    sketch: Path | None,
    keep_observed: bool,
    config_path: Path | None,
    settings: tuple[str, ...],
    seed: int | None,
    workers: int,
    assume_crs: str | None,
    lots_layer: str | None,
    max_bad_fraction: float | None,
    overwrite: bool,
    as_json: bool,
) -> None:
    """Make REGISTER from CITY: clean lots, and the ground in each where plants may stand.

    Reads layer lots (or the only polygon layer) and, where they are, buildings, roads, driveways, entrances,
    obstacles and sketches; writes lots, active_areas, parameters and skipped. With a coverage map, which `cover` makes
    of an aerial image, the active areas are the vegetation that it shows in each lot, and layer regions has it with
    what reaches over the lot's border.

    \b
    Example:
        urbanforest stencil rome.gpkg -o rome-forest/register.gpkg
        urbanforest stencil rome.gpkg --coverage rome_coverage.tif -o rome-forest/register.gpkg
    """
    from urbanforest_cli.core.errors import OutputExistsError
    from urbanforest_cli.core.params import strategy_names
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.register.stage import refuse_too_many_bad, stencil_city

    if register.exists() and not overwrite:
        raise OutputExistsError(
            "the register exists", where=register, next_step="name another with -o, or add --overwrite"
        )
    city, lots_layer = options.city_and_layer(city, lots_layer)
    config, seed = options.load(config_path, settings, seed)
    with folder_lock(register.parent), options.progress() as progress:
        summary = stencil_city(
            city,
            register,
            config=config,
            seed=seed,
            workers=workers,
            assume_crs=assume_crs,
            lots_layer=lots_layer,
            known_strategies=strategy_names(),
            coverage=coverage,
            sketch=sketch,
            keep_observed=keep_observed,
            progress=progress,
        )
    if not as_json:
        options.tell([summary], as_json)
    refuse_too_many_bad(summary, max_bad_fraction, city)
    if as_json:
        options.tell([summary], as_json)
