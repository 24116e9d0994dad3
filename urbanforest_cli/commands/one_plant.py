"""Options of ``urbanforest grow --one``: a plant, its age, and what stands beside it."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from urbanforest_cli.commands import options

if TYPE_CHECKING:
    from urbanforest_cli.growth.alone import Neighbour, Wall

NUMBER = r"[+-]?(?:\d+\.?\d*|\.\d+)"


WALL = re.compile(rf"({NUMBER})@({NUMBER})(?:x({NUMBER}))?")
NEIGHBOUR = re.compile(rf"(.+)@({NUMBER}),({NUMBER})(?:,({NUMBER}))?")


def _walls(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> tuple[Wall, ...]:
    """Read ``DISTANCE@AZIMUTH`` or ``DISTANCE@AZIMUTHxHEIGHT``, in metres and degrees."""
    return tuple(_wall(text, ctx, param) for text in texts)


def _wall(text: str, ctx: click.Context, param: click.Parameter) -> Wall:
    from urbanforest_cli.growth.alone import Wall

    found = WALL.fullmatch(text.replace(" ", ""))
    if found is None:
        raise click.BadParameter(
            f"{text!r} is no wall; write its distance in metres, its compass direction and, if you like, its height, "
            "for example 3@180 or 3@180x12",
            ctx,
            param,
        )
    distance, azimuth, height = found.groups()
    return Wall(float(distance), float(azimuth), float(height) if height is not None else None)


def _neighbours(ctx: click.Context, param: click.Parameter, texts: tuple[str, ...]) -> tuple[Neighbour, ...]:
    """Read ``SPECIES@DISTANCE,AZIMUTH`` or ``SPECIES@DISTANCE,AZIMUTH,AGE``, in metres, degrees and years."""
    return tuple(_neighbour(text, ctx, param) for text in texts)


def _neighbour(text: str, ctx: click.Context, param: click.Parameter) -> Neighbour:
    from urbanforest_cli.growth.alone import Neighbour

    species, at, place = text.rpartition("@")
    found = NEIGHBOUR.fullmatch(species.strip() + at + place.replace(" ", ""))
    if found is None:
        raise click.BadParameter(
            f"{text!r} is no neighbour; write its species, its distance in metres, its compass direction and, if you "
            "like, its age, for example acer_platanoides@5,90 or acer_platanoides@5,90,20",
            ctx,
            param,
        )
    name, distance, azimuth, age = found.groups()
    return Neighbour(name, float(distance), float(azimuth), float(age) if age is not None else None)


one_plant_opts = options.stack(
    click.option("--one", metavar="SPECIES", help="Grow one plant of a species, without a register."),
    click.option("--age", type=float, metavar="YEARS", help="With --one: its age, 0 to 250."),
    click.option(
        "--wall", "walls", callback=_walls, multiple=True, metavar="M@DEG[xM]",
        help="With --one: a wall at a distance in a compass direction (0 north, 90 east), and its height. Repeatable.",
    ),
    click.option(
        "--neighbour", "neighbours", callback=_neighbours, multiple=True, metavar="SPECIES@M,DEG[,YEARS]",
        help="With --one: a plant beside it, as old as it unless told. Repeatable.",
    ),
    click.option(
        "--pruning", type=float, metavar="G", help="With --one: scale of the crown's bounds.  [default: 1]"
    ),
    click.option("--latitude", type=float, metavar="DEG", help="With --one: where the sun shines.  [default: 48]"),
    click.option(
        "-o", "--output", "outputs", type=options.FilePath(), multiple=True, metavar="FILE",
        help="With --one: tree.parquet for the skeleton, tree.png for a picture. Repeatable.",
    ),
    options.overwrite_opt,
)  # fmt: skip
"""What `grow_one` takes."""


def refuse_strangers(register: Path | None, others: dict[str, Any], one: dict[str, Any]) -> None:
    """Refuse a register with ``--one``, options that belong to the other of the two, and neither of them.

    Parameters
    ----------
    others
        What was given for options of a register, by option.
    one
        What was given for `one_plant_opts`, by parameter.
    """
    if one["one"] is None:
        if given := _given({f"--{name}": value for name, value in one.items()}):
            names = {"--outputs": "-o", "--walls": "--wall", "--neighbours": "--neighbour"}
            raise click.UsageError(f"{names.get(given[0], given[0])} goes with --one SPECIES.")
        if register is None:
            raise click.UsageError("Name a REGISTER, or a species with --one.")
        return
    if register is not None:
        raise click.UsageError("--one grows a plant without a register: leave REGISTER out.")
    if given := _given(others):
        raise click.UsageError(f"{given[0]} goes with a REGISTER, not with --one.")
    if one["age"] is None:
        raise click.UsageError("--one needs the plant's age: --age YEARS.")


def _given(values: dict[str, Any]) -> list[str]:
    """Return the options that were given; 0 is given too."""
    return [name for name, value in values.items() if value is not None and value is not False and value != ()]


def grow_one(
    config_path: Path | None, settings: Sequence[str], seed: int | None, as_json: bool, one: dict[str, Any]
) -> None:
    """Grow one plant, write it and tell of it."""
    from urbanforest_cli import pipeline_alone

    config, seed = options.load(config_path, settings, seed)
    request = pipeline_alone.Request(
        species=one["one"],
        age_years=one["age"],
        config=config,
        seed=seed,
        outputs=one["outputs"],
        walls=one["walls"],
        neighbours=one["neighbours"],
        pruning_factor=1.0 if one["pruning"] is None else one["pruning"],
        latitude_deg=48.0 if one["latitude"] is None else one["latitude"],
        overwrite=one["overwrite"],
    )
    with options.progress() as progress:
        summary, lines = pipeline_alone.grow_one(request, progress=progress)
    if as_json:
        options.tell([summary], as_json)
    elif not options.quiet():
        for line in lines:
            click.echo(line)
        for path in one["outputs"]:
            click.echo(f"Wrote {path}")
