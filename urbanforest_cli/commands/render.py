"""``urbanforest render``."""

from __future__ import annotations

import re
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from urbanforest_cli.commands import options

if TYPE_CHECKING:
    from urbanforest_cli.export.view.picture import Kind

SIZE_MIN_PX, SIZE_MAX_PX = 64, 16384
PIXELS_MAX = 8192 * 8192
SUN_LOWEST_DEG, SUN_HIGHEST_DEG = 5.0, 90.0


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
        if size[0] * size[1] > PIXELS_MAX:
            self.fail(f"{value!r} is too large: at most {PIXELS_MAX:,} pixels, such as 8192x8192; --bbox draws a part")
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
        if not (-360.0 <= azimuth <= 360.0 and SUN_LOWEST_DEG <= elevation <= SUN_HIGHEST_DEG):
            self.fail(f"{value!r} is no place of the sun: AZIMUTH,ELEVATION in degrees, such as 230,35; "
                      f"0 is north and 90 east, the elevation {SUN_LOWEST_DEG:g} to {SUN_HIGHEST_DEG:g}")  # fmt: skip
        return azimuth % 360.0, elevation


def png_path(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
    """Refuse a picture whose name ends otherwise than what is written into it."""
    if value is not None and value.suffix.lower() != ".png":
        raise click.BadParameter(f"{value.name!r} is no name of a PNG: it must end in .png")
    return value


def one_kind(ctx: click.Context, param: click.Parameter, value: bool) -> bool:
    """Refuse a second kind of picture."""
    kinds = ctx.meta.setdefault("urbanforest.kinds", [])
    if value:
        kinds.append(f"--{param.name}")
    if len(kinds) > 1:
        raise click.UsageError(f"{' and '.join(sorted(kinds))} are different pictures: name one")
    return value


@click.command(short_help="Draw a planted city: from above, in perspective, from the street.")
@click.argument("register", metavar="OUT", type=options.FilePath())
@click.option(
    "-o", "--output", type=options.FilePath(), metavar="FILE.png", callback=png_path,
    help="Picture to write.  [default: view.png, street.png or top.png in OUT]",
)  # fmt: skip
@click.option("--perspective", is_flag=True, callback=one_kind, help="From the air.  [default]")
@click.option("--street", is_flag=True, callback=one_kind, help="From eye height, on the road with the most trees.")
@click.option("--top", is_flag=True, callback=one_kind, help="Straight down, north up.")
@click.option(
    "--bbox", type=float, nargs=4, metavar="W S E N",
    help="What the picture is of, in the CRS of the register.  [default: chosen by itself]",
)  # fmt: skip
@click.option(
    "--size", type=Size(), default="1920x1200", show_default=True,
    help=f"Of the picture, in pixels: each side {SIZE_MIN_PX} to {SIZE_MAX_PX}, at most {PIXELS_MAX:,} in all.",
)  # fmt: skip
@click.option(
    "--season", type=click.Choice(["spring", "summer", "autumn", "winter"]),
    help="Leaves and flowers.  [default: export.season of the config]",
)  # fmt: skip
@click.option(
    "--sun", type=SunPlace(),
    help=f"Where the sun stands, in degrees: from north over east, and {SUN_LOWEST_DEG:g} to {SUN_HIGHEST_DEG:g} above "
    "the horizon.  [default: to suit the view]",
)  # fmt: skip
@options.config_opts
@options.workers_opt
@options.json_opt
@options.talk_opts
def command(
    register: Path,
    output: Path | None,
    perspective: bool,
    street: bool,
    top: bool,
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
    kind: Kind = "street" if street else "top" if top else "perspective"
    path = output or register.parent / ("view.png" if kind == "perspective" else f"{kind}.png")
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
