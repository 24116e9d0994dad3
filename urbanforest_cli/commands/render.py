"""``urbanforest render``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import click

from urbanforest_cli.commands import options

SIZE_MIN_PX, SIZE_MAX_PX = 64, 16384


class Size(click.ParamType):  # type: ignore[type-arg]
    """Width and height in pixels, as 1920x1200."""

    name = "WIDTHxHEIGHT"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, int]:
        """Return both, or refuse."""
        if isinstance(value, tuple):
            return int(value[0]), int(value[1])
        found = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", str(value))
        size = (int(found[1]), int(found[2])) if found else (0, 0)
        if not all(SIZE_MIN_PX <= side <= SIZE_MAX_PX for side in size):
            self.fail(f"{value!r} is no size: WIDTHxHEIGHT, each {SIZE_MIN_PX} to {SIZE_MAX_PX}, such as 1920x1200")
        return size


class SunPlace(click.ParamType):  # type: ignore[type-arg]
    """Azimuth and elevation of the sun in degrees, as 230,35."""

    name = "AZIMUTH,ELEVATION"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Return both, or refuse."""
        if isinstance(value, tuple):
            return float(value[0]), float(value[1])
        try:
            azimuth, elevation = (float(part) for part in str(value).split(","))
        except ValueError:
            azimuth, elevation = 0.0, -1.0
        if not (-360.0 <= azimuth <= 360.0 and 5.0 <= elevation <= 90.0):
            self.fail(f"{value!r} is no place of the sun: AZIMUTH,ELEVATION in degrees, such as 230,35; "
                      "0 is north and 90 east, the elevation 5 to 90")  # fmt: skip
        return azimuth % 360.0, elevation


@click.command(short_help="Draw a planted city: from above, in perspective, from the street.")
@click.argument("register", metavar="OUT", type=options.FilePath())
@click.option(
    "-o", "--output", type=options.FilePath(), metavar="FILE.png",
    help="Picture to write.  [default: view.png, street.png or top.png in OUT]",
)  # fmt: skip
@click.option("--perspective", "kind", flag_value="perspective", default="perspective", help="From the air. [default]")
@click.option("--street", "kind", flag_value="street", help="From the height of eyes, on the road with the most trees.")
@click.option("--top", "kind", flag_value="top", help="Straight down, north up.")
@click.option(
    "--bbox", type=float, nargs=4, metavar="W S E N",
    help="What the picture is of, in the CRS of the register.  [default: chosen by itself]",
)  # fmt: skip
@click.option("--size", type=Size(), default="1920x1200", show_default=True, help="Of the picture, in pixels.")
@click.option(
    "--season", type=click.Choice(["spring", "summer", "autumn", "winter"]),
    help="Leaves and flowers.  [default: export.season of the config]",
)  # fmt: skip
@click.option("--sun", type=SunPlace(), help="Where the sun stands, in degrees.  [default: to suit the view]")
@options.config_opts
@options.workers_opt
@options.json_opt
@options.talk_opts
def command(
    register: Path,
    output: Path | None,
    kind: Any,
    bbox: tuple[float, float, float, float] | None,
    size: tuple[int, int],
    season: Any,
    sun: tuple[float, float] | None,
    config_path: Path | None,
    settings: tuple[str, ...],
    seed: int | None,
    workers: int,
    as_json: bool,
) -> None:
    """Draw the plants of OUT, as they grew, among houses, lots and roads.

    OUT is a folder that `populate` wrote, or a register. Needs no graphics card. Pictures carry their provenance, and
    are named in exports.json where they lie in OUT.

    \b
    Example:
        urbanforest render rome-forest
        urbanforest render rome-forest --street --season spring -o street.png
        urbanforest render rome-forest --top --bbox 1000 1000 1400 1300 --size 3000x2250
    """
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.export.view.stage import render_view

    register = register / "register.gpkg" if register.is_dir() else register
    config, _ = options.load(config_path, settings, seed, register)
    path = output or register.parent / {"perspective": "view.png"}.get(kind, f"{kind}.png")
    with folder_lock(path.parent), options.progress() as progress:
        summary = render_view(
            register,
            path,
            config=config,
            kind=kind,
            size_px=size,
            bbox=bbox,
            season=season or config.export.season,
            sun=sun,
            workers=workers,
            progress=progress,
        )
    options.tell([summary], as_json)
