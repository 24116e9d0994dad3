"""``urbanforest cover``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from urbanforest_cli.commands import options

BANDS_MOST = 16
WINDOW_LEAST_PX, WINDOW_MOST_PX = 64, 4096


class Bands(click.ParamType):  # type: ignore[type-arg]
    """Numbers of the bands of red, green and blue, or of one for gray."""

    name = "R,G,B"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[int, ...]:
        """Return them, or refuse."""
        if isinstance(value, tuple):
            return tuple(int(band) for band in value)
        parts = str(value).split(",")
        if len(parts) not in (1, 3) or not all(part.strip().isdecimal() for part in parts):
            self.fail(f"{value!r} names no bands: R,G,B, each from 1, such as 3,2,1; or one for gray")
        bands = tuple(int(part) for part in parts)
        if not all(1 <= band <= BANDS_MOST for band in bands):
            self.fail(f"{value!r}: bands are counted from 1, and at most {BANDS_MOST}")
        return bands


class Stretch(click.ParamType):  # type: ignore[type-arg]
    """The samples that become black and white."""

    name = "LOW,HIGH"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Return both, or refuse."""
        if isinstance(value, tuple):
            return float(value[0]), float(value[1])
        try:
            low, high = (float(part) for part in str(value).split(","))
        except ValueError:
            low, high = 0.0, 0.0
        if not -1e12 < low < high < 1e12:
            self.fail(f"{value!r} is no range: LOW,HIGH, two numbers, such as 0,4095")
        return low, high


def _ending(*endings: str) -> Any:
    def check(ctx: click.Context, param: click.Parameter, value: Path | None) -> Path | None:
        if value is not None and value.suffix.lower() not in endings:
            raise click.BadParameter(f"{value.name!r} must end in {' or '.join(endings)}, as what is written into it")
        return value

    return check


@click.command(short_help="Map the vegetation in an aerial image.")
@click.argument("images", metavar="IMAGE...", type=options.FilePath(), nargs=-1, required=True)
@click.option(
    "-o", "--output", type=options.FilePath(), required=True, metavar="COVERAGE.tif", callback=_ending(".tif", ".tiff"),
    help="Map to write: a band a class, percentages, 255 where nothing is known.",
)  # fmt: skip
@click.option(
    "-m", "--model", type=options.FilePath(), metavar="MODEL.onnx",
    help="Model that `urbanforest train-coverage` wrote.  [default: the one that comes with the program]",
)  # fmt: skip
@click.option("--mosaic", is_flag=True, help="Take several images, or those of a folder, as one.")
@click.option(
    "--preview", type=options.FilePath(), metavar="FILE.png", callback=_ending(".png"),
    help="Draw the image and what was found beside each other.",
)  # fmt: skip
@click.option("--bands", type=Bands(), help="Bands of red, green and blue.  [default: as the image says]")
@click.option(
    "--stretch", type=Stretch(),
    help="Samples that are black and white, of images that are not of 8 bits.  [default: from the pixels]",
)  # fmt: skip
@options.assume_crs_opt
@click.option("--bbox", type=float, nargs=4, metavar="W S E N", help="Part to map, in the CRS of the image.")
@click.option(
    "--window", "window_px", type=click.IntRange(WINDOW_LEAST_PX, WINDOW_MOST_PX), metavar="PX",
    help="Pixels along a side that are mapped at once; the map is the same.  [default: to suit memory]",
)  # fmt: skip
@options.overwrite_opt
@options.workers_opt
@options.json_opt
@options.talk_opts
def command(
    images: tuple[Path, ...],
    output: Path,
    model: Path | None,
    mosaic: bool,
    preview: Path | None,
    bands: tuple[int, ...] | None,
    stretch: tuple[float, float] | None,
    assume_crs: str | None,
    bbox: tuple[float, float, float, float] | None,
    window_px: int | None,
    overwrite: bool,
    workers: int,
    as_json: bool,
) -> None:
    """Map where plants cover the ground of IMAGE, an aerial image of red, green and blue.

    Any size, type and CRS; what a pixel measures on the ground is brought to what the model knows, and back. IMAGE may
    be a folder, or several files with --mosaic. The same image and model make the same map, whatever the workers.

    \b
    Example:
        urbanforest cover aerial.tif -o coverage.tif --preview coverage.png
        urbanforest cover tiles/ -o coverage.tif --bbox 384000 3730000 386000 3732000
    """
    options.refuse_inside_out(bbox)
    if len(images) > 1 and not mosaic:
        raise click.UsageError("several images: add --mosaic to map them as one, or map them one by one.")
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.imagery.stage import CoverOptions, cover_image

    with folder_lock(output.parent), options.progress() as progress:
        summary = cover_image(
            images,
            output,
            model=model,
            options=CoverOptions(bands=bands, stretch=stretch, assume_crs=assume_crs, bbox=bbox, window_px=window_px),
            preview=preview,
            workers=workers,
            overwrite=overwrite,
            progress=progress,
        )
    options.tell([summary], as_json)
