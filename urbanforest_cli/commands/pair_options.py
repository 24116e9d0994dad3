"""Options that say what is in a folder of pairs of images and truths."""

from __future__ import annotations

import click

from urbanforest_cli.commands import options
from urbanforest_cli.core.coverage_model import CLASSES
from urbanforest_cli.imagery.pairs import PAIR_LABELS


def class_names(ctx: click.Context, param: click.Parameter, value: str | None) -> tuple[str, ...] | None:
    """Take names parted by commas apart, and refuse what is no class."""
    names = None if value is None else tuple(name.strip() for name in value.split(","))
    if names is not None and not (set(names) <= set(CLASSES) and len(set(names)) == len(names)):
        raise click.BadParameter(f"{value!r}: name one or more of {', '.join(CLASSES)}, parted by commas")
    return names


def colours(ctx: click.Context, param: click.Parameter, values: tuple[str, ...]) -> dict[str, str]:
    """Take colours of classes apart; whether they make sense is for the reader of masks to say."""
    parts = [value.partition("=") for value in values]
    if not all(name and colour for name, _, colour in parts):
        raise click.BadParameter("a class and its colour, such as canopy=#00ff00")
    return {name: colour for name, _, colour in parts}


pair_opts = options.stack(
    click.option("--label", type=click.Choice(PAIR_LABELS), default="auto", show_default=True,
                 help="Where the truth of PAIRS comes from."),
    click.option("--classes", metavar="NAMES", callback=class_names,
                 help="What the truth shows: canopy, vegetation or both.  [default: as its files say]"),
    click.option("--polygons", type=options.FilePath(), metavar="FILE[:LAYER]",
                 help="Canopy polygons over the images of PAIRS."),
    click.option("--trees", type=options.FilePath(), metavar="FILE[:LAYER]",
                 help="Points of all visible trees.  [default: folder trees of PAIRS]"),
    click.option("--palette", multiple=True, metavar="CLASS=#RRGGBB", callback=colours,
                 help="Colour of a class in masks of colours. Repeatable."),
    click.option("--resolution", "image_resolution_m", type=click.FloatRange(0.01, 100), metavar="METRES",
                 help="Size of a pixel of images that do not tell it.  [default: 0.6]"),
)  # fmt: skip
