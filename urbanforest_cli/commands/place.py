"""``urbanforest place``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Place plants in the ground of each lot.")
@options.register_arg
@options.config_opts
@options.workers_opt
@options.json_opt
@options.talk_opts
def command(
    register: Path, config_path: Path | None, settings: tuple[str, ...], seed: int | None, workers: int, as_json: bool
) -> None:
    """Place plants in the active areas of REGISTER.

    Reads layers lots, active_areas and parameters; writes plants, placements and its rows of skipped.

    \b
    Example:
        urbanforest place rome-forest/register.gpkg --seed 7
    """
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.placement.stage import place_plants

    config, seed = options.load(config_path, settings, seed, register)
    with folder_lock(register.parent), options.progress() as progress:
        summary = place_plants(register, config=config, seed=seed, workers=workers, progress=progress)
    options.tell([summary], as_json)
