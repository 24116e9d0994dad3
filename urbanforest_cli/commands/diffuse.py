"""``urbanforest diffuse``."""

from __future__ import annotations

from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Let neighbouring lots share their parameters.")
@options.register_arg
@options.config_opts
@options.json_opt
@options.talk_opts
def command(
    register: Path, config_path: Path | None, settings: tuple[str, ...], seed: int | None, as_json: bool
) -> None:
    """Let each lot of REGISTER share its parameters with the lots within its context radius.

    Reads layers lots and parameters (as resolved by stencil), writes parameters; can be run again. How far and how
    often is said by context_radius_m of each zone and by [context] of the config.

    \b
    Example:
        urbanforest diffuse rome-forest/register.gpkg --set context.passes=2
    """
    from urbanforest_cli.context.stage import diffuse_parameters
    from urbanforest_cli.core.publish import folder_lock

    config, seed = options.load(config_path, settings, seed, register)
    with folder_lock(register.parent), options.progress() as progress:
        summary = diffuse_parameters(register, config=config, seed=seed, progress=progress)
    options.tell([summary], as_json)
