"""``urbanforest regress``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Read each lot's parameters off its coverage, and how sure they are.")
@options.register_arg
@click.option(
    "-m", "--model", type=options.FilePath(), metavar="MODEL.onnx",
    help="Model that `urbanforest train-regression` wrote.  [default: the one that comes with the program]",
)  # fmt: skip
@options.config_opts
@options.workers_opt
@options.json_opt
@options.talk_opts
def command(
    register: Path,
    model: Path | None,
    config_path: Path | None,
    settings: tuple[str, ...],
    seed: int | None,
    workers: int,
    as_json: bool,
) -> None:
    """Read radius, density, band and clusters of the plants of each lot of REGISTER off its coverage map.

    Reads layers lots, regions, buildings and parameters, as `urbanforest stencil --coverage` wrote them; writes layer
    regressed, with a standard deviation and an origin for every value: map, neighbourhood, zone, or own where a column
    of the lot or a sketch sets it. Values that rest on map or neighbourhood come in force. Can be run again.

    \b
    Example:
        urbanforest stencil rome.gpkg --coverage coverage.tif -o rome-forest/register.gpkg
        urbanforest regress rome-forest/register.gpkg --set regression.pooling_radius_m=200
    """
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.regression.stage import regress_register

    config, seed = options.load(config_path, settings, seed, register)
    with folder_lock(register.parent), options.progress() as progress:
        summary = regress_register(register, model=model, config=config, seed=seed, workers=workers, progress=progress)
    options.tell([summary], as_json)
