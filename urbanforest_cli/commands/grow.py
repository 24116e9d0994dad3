"""``urbanforest grow``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from urbanforest_cli.commands import one_plant, options


@click.command(short_help="Grow every plant into a skeleton, in the sight of its neighbours and of buildings.")
@click.argument("register", type=options.FilePath(), required=False)
@click.option(
    "--environment", type=click.Choice(["both", "shadow", "markers"]),
    help="What plants sense: light (shadow), room (markers), or both.  [default: growth.environment of the config]",
)  # fmt: skip
@click.option(
    "--detail", type=click.Choice(["unique", "library", "auto"]),
    help="Grow every plant in its place, or take the nearest of a few thousand grown.  "
    "[default: growth.detail of the config]",
)  # fmt: skip
@click.option("--only", multiple=True, metavar="LOTS", help="Lots in focus, their ids with commas between. Repeatable.")
@click.option(
    "--bbox", type=float, nargs=4, metavar="W S E N",
    help="Lots in focus: those with plants here, in the CRS of the register.",
)  # fmt: skip
@click.option(
    "--year", type=int, metavar="Y",
    help="Show the plants Y years after the oldest was planted, or below 0, before today; grows nothing.",
)  # fmt: skip
@one_plant.one_plant_opts
@options.config_opts
@options.workers_opt
@options.json_opt
@options.talk_opts
def command(
    register: Path | None,
    environment: str | None,
    detail: str | None,
    only: tuple[str, ...],
    bbox: tuple[float, float, float, float] | None,
    year: int | None,
    config_path: Path | None,
    settings: tuple[str, ...],
    seed: int | None,
    workers: int,
    as_json: bool,
    **one: Any,
) -> None:
    """Grow the plants of REGISTER, or of the register in a folder, into skeletons.

    Reads layers plants, lots and buildings; writes skeletons/ beside the register, and its layers trees, groves and
    skeleton_parts. Lots in focus grow each plant in its place whatever the detail; with --detail unique only they are
    grown anew, and all others keep the skeletons they have. With --one SPECIES, grow a single plant instead, alone or
    beside walls and neighbours.

    \b
    Example:
        urbanforest grow rome-forest
        urbanforest grow rome-forest --only 17,18 --environment shadow
        urbanforest grow rome-forest --year 10
        urbanforest grow --one tilia_cordata --age 40 --wall 3@180x12 -o lime.parquet -o lime.png
    """
    asked = {"growth.environment": environment, "growth.detail": detail}
    others = {"--detail": detail, "--only": only, "--bbox": bbox, "--year": year}
    options.refuse_inside_out(bbox)
    one_plant.refuse_strangers(register, others, one)
    if year is not None:
        _refuse_growth({"--environment": environment, "--detail": detail, "--only": only, "--bbox": bbox})
    settings += tuple(f"{name}={value}" for name, value in asked.items() if value is not None)
    if register is None:
        one_plant.grow_one(config_path, settings, seed, as_json, one)
        return
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.growth.stage import grow_plants, show_year

    register = register / "register.gpkg" if register.is_dir() else register
    config, seed = options.load(config_path, settings, seed, register)
    lots = [lot for text in only for lot in text.split(",")] or None
    if year is not None:
        with folder_lock(register.parent):
            options.tell([show_year(register, year)], as_json)
        return
    with folder_lock(register.parent), options.progress() as progress:
        summary = grow_plants(
            register,
            config=config,
            seed=seed,
            workers=workers,
            focus_lots=lots,
            bbox=bbox,
            progress=progress,
        )
    options.tell([summary], as_json)


def _refuse_growth(given: dict[str, Any]) -> None:
    """Refuse options that say how to grow beside one that grows nothing."""
    for option, value in given.items():
        if value not in (None, ()):
            raise click.UsageError(f"{option} says how to grow, and --year grows nothing: leave one of them out.")
