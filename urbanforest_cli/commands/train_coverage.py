"""``urbanforest train-coverage``."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import click

from urbanforest_cli.commands import options
from urbanforest_cli.commands.pair_options import pair_opts
from urbanforest_cli.imagery.learning.settings import LOSSES, PRESETS


def onnx_path(ctx: click.Context, param: click.Parameter, value: Path) -> Path:
    """Refuse a model whose name ends otherwise than what is written into it."""
    if value.suffix.lower() != ".onnx":
        raise click.BadParameter(f"{value.name!r} is no name of a model: it must end in .onnx")
    return value


@click.command(short_help="Train a network to map vegetation, from images and masks.")
@click.argument("pairs", type=options.FilePath())
@click.option("-o", "--output", type=options.FilePath(), metavar="MODEL.onnx", required=True, callback=onnx_path,
              help="Model to write.")  # fmt: skip
@click.option("--preset", type=click.Choice(PRESETS), default="small", show_default=True,
              help="small: a light network, minutes on two cores. pix2pix: as published, for a GPU.")  # fmt: skip
@pair_opts
@click.option("--hold-out", multiple=True, metavar="PATTERN",
              help="Images or cities to leave for judging, such as 'rome_*'. Repeatable.")  # fmt: skip
@click.option("--validation-fraction", type=click.FloatRange(0, 0.9), default=0.15, show_default=True,
              help="Share of the places by which epochs are compared.")  # fmt: skip
@click.option("--epochs", type=click.IntRange(1, 100_000), help="Times all images are shown.  [default: the preset's]")
@click.option("--loss", type=click.Choice(LOSSES), help="What is made small.  [default: the preset's]")
@click.option("--batch", type=click.IntRange(1, 1024), help="Crops a step.  [default: the preset's]")
@click.option("--crop", "crop_px", type=click.IntRange(1, 2048), metavar="PX",
              help="Side of a crop.  [default: the preset's]")  # fmt: skip
@click.option("--downs", type=click.IntRange(1, 10), help="Times it halves the image.  [default: the preset's]")
@click.option("--filters", type=click.IntRange(1, 256), help="Width of the network.  [default: the preset's]")
@click.option(
    "--learning-rate", type=click.FloatRange(0, 1, min_open=True), help="The highest.  [default: the preset's]"
)
@click.option("--jitter", type=click.FloatRange(0, 10), metavar="X",
              help="Strength of the random change of colours, 0 for none.  [default: the preset's]")  # fmt: skip
@click.option("--colour-transfer", "transfer", type=click.FloatRange(0, 1), metavar="SHARE",
              help="Of crops that get the colours of another city.  [default: the preset's]")  # fmt: skip
@click.option("--patience", type=click.IntRange(0), metavar="EPOCHS",
              help="Stop after so many without a better validation, 0 for never.  "
              "[default: a quarter of the epochs; pix2pix: never]")  # fmt: skip
@click.option("--minutes", type=click.FloatRange(0, min_open=True), metavar="M",
              help="Stop after the epoch that ends later than this.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True,
              help="Root of every random stream.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on from the last checkpoint, to the same model.")
@click.option("--work", type=options.FilePath(), metavar="FOLDER",
              help="Folder of checkpoint, metrics and sheets.  [default: MODEL-training]")  # fmt: skip
@click.option("--device", type=click.Choice(["auto", "cpu", "cuda"]), default="auto", show_default=True,
              help="auto takes a GPU where there is one.")  # fmt: skip
@click.option("--precision", type=click.Choice(["auto", "fp32", "bf16"]), default="auto", show_default=True,
              help="auto takes bfloat16 where the processor multiplies it.")  # fmt: skip
@click.option("--threads", type=click.IntRange(1, 1024), default=options.cores, show_default="all cores",
              help="Threads to train with; another number changes last digits.")  # fmt: skip
@options.assume_crs_opt
@options.overwrite_opt
@options.json_opt
@options.talk_opts
def command(
    pairs: Path,
    output: Path,
    preset: Any,
    label: Any,
    classes: tuple[str, ...] | None,
    polygons: Path | None,
    trees: Path | None,
    palette: dict[str, str],
    image_resolution_m: float | None,
    assume_crs: str | None,
    hold_out: tuple[str, ...],
    validation_fraction: float,
    seed: int,
    resume: bool,
    work: Path | None,
    device: Any,
    precision: Any,
    threads: int,
    minutes: float | None,
    overwrite: bool,
    as_json: bool,
    **changes: Any,
) -> None:
    """Train a network on PAIRS, a folder of images with what covers them, and write it as a model for `cover`.

    PAIRS holds images/ and masks/ of equal names, or images with four bands and trees/. Places are kept apart: what is
    seen in training is never validated by. After each epoch the work folder has a checkpoint, metrics.csv, curves for
    TensorBoard and a sheet of pictures.

    \b
    Example:
        urbanforest train-coverage naip -o trees.onnx
        urbanforest train-coverage naip -o trees.onnx --label ndvi --hold-out 'eureka_*' --epochs 60
        urbanforest train-coverage naip -o trees.onnx --resume
        urbanforest train-coverage pairs -o pix2pix.onnx --preset pix2pix --device cuda
    """
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.imagery.learning.settings import settings_for
    from urbanforest_cli.imagery.learning.stage import CHECKPOINT, train_coverage
    from urbanforest_cli.imagery.learning.story import TrainingRequest

    request = TrainingRequest(
        pairs=pairs,
        output=output,
        work=work or output.with_name(f"{output.stem}-training"),
        settings=settings_for(preset, seed=seed, **changes),
        label=label,
        classes=classes,
        polygons=polygons,
        trees=trees,
        palette=palette,
        assume_crs=assume_crs,
        image_resolution_m=image_resolution_m,
        hold_out=hold_out,
        validation_fraction=validation_fraction,
        device=device,
        precision=precision,
        threads=threads,
        resume=resume,
        overwrite=overwrite,
        minutes=minutes,
    )

    def tell_epoch(report: Any, epochs: int, left_s: float) -> None:
        if not options.quiet():
            click.echo(report.line(epochs, left_s), err=True)

    with folder_lock(request.work), options.progress() as progress:
        try:
            summary = train_coverage(request, progress=progress, on_epoch=tell_epoch)
        except BaseException as stop:
            if not isinstance(stop, Exception) and (request.work / CHECKPOINT).exists():
                click.echo("The last whole epoch is kept: the same command with --resume goes on from it.", err=True)
            raise
    options.tell([summary], as_json)
