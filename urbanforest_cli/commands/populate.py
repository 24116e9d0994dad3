"""``urbanforest populate``."""

from __future__ import annotations

import json
from pathlib import Path

import click

from urbanforest_cli.commands import options


@click.command(short_help="Fill a city with plants: all stages, and the files people open.")
@click.argument("city", type=options.FilePath())
@click.option("-o", "--output", "out", type=options.FilePath(), help="Folder to write to.  [default: CITY-forest]")
@options.config_opts
@click.option(
    "--image", "images", type=options.FilePath(), multiple=True, metavar="IMAGE",
    help="Aerial image, or a folder of them, that says where plants are. Repeatable.",
)  # fmt: skip
@click.option(
    "--coverage", type=options.FilePath(), metavar="COVERAGE.tif",
    help="Map of where plants are, of `urbanforest cover` or drawn, in place of an image.",
)  # fmt: skip
@click.option(
    "--sketch", type=options.FilePath(), metavar="FILE",
    help="Sketches: polygons (.gpkg, .geojson), or a painted picture (.png, .tif).",
)  # fmt: skip
@click.option("--keep-observed", is_flag=True, help="Keep the plants of layer observed_plants, and fill up the rest.")
@click.option(
    "--coverage-model", type=options.FilePath(), metavar="MODEL.onnx",
    help="Model of `train-coverage` that maps the image.  [default: the one that comes with the program]",
)  # fmt: skip
@click.option(
    "--parameter-model", type=options.FilePath(), metavar="MODEL.onnx",
    help="Model of `train-regression` that reads the map.  [default: the one that comes with the program]",
)  # fmt: skip
@click.option(
    "--until", type=click.Choice(["cover", "stencil", "regress", "diffuse", "place", "grow", "export"]),
    default="export", show_default=True, help="Last stage to run; cover and regress are run with an image or a map.",
)  # fmt: skip
@click.option(
    "--year", type=int, metavar="Y",
    help="Show the city Y years after its oldest plant was planted, or below 0, before today.  [default: today]",
)  # fmt: skip
@options.workers_opt
@options.assume_crs_opt
@options.layer_opt
@options.max_bad_opt
@click.option("--dry-run", is_flag=True, help="Tell what would be done and write nothing.")
@options.json_opt
@options.talk_opts
def command(
    city: Path,
    out: Path | None,
    config_path: Path | None,
    settings: tuple[str, ...],
    seed: int | None,
    images: tuple[Path, ...],
    coverage: Path | None,
    sketch: Path | None,
    keep_observed: bool,
    coverage_model: Path | None,
    parameter_model: Path | None,
    until: str,
    year: int | None,
    workers: int,
    assume_crs: str | None,
    lots_layer: str | None,
    max_bad_fraction: float | None,
    dry_run: bool,
    as_json: bool,
) -> None:
    """Fill CITY, a GeoPackage with a layer of lots, with plants.

    The zones of the lots decide; where an aerial image or a map of coverage is given, plants stand where it shows
    them. Writes register.gpkg, the plants' skeletons in skeletons/, plants.geojson, map.png, report.html and
    report.json, and coverage.tif for an image. A second run does again only what changed; a run that was stopped is
    gone on with.

    \b
    Example:
        urbanforest populate rome.gpkg
        urbanforest populate rome.gpkg --image aerial.tif
        urbanforest populate rome.gpkg -o rome-dense -c dense.toml --seed 7
        urbanforest populate rome.gpkg --year -10
    """
    if images and coverage is not None:
        raise click.UsageError("--image and --coverage: give one of them, for the map is made from the image.")
    if coverage_model is not None and not images:
        raise click.UsageError("--coverage-model maps an image: add --image.")
    if parameter_model is not None and not images and coverage is None:
        raise click.UsageError("--parameter-model reads a map: add --image or --coverage.")
    if (until == "cover" and not images) or (until == "regress" and not images and coverage is None):
        raise click.UsageError(f"--until {until} needs {'--image' if until == 'cover' else '--image or --coverage'}.")
    city, lots_layer = options.city_and_layer(city, lots_layer)
    from urbanforest_cli import pipeline

    config, seed = options.load(config_path, settings, seed)
    request = pipeline.Request(
        city=city,
        out=out or pipeline.default_out(city),
        config=config,
        seed=seed,
        until=until,
        year=year,
        workers=workers,
        assume_crs=assume_crs,
        lots_layer=lots_layer,
        max_bad_fraction=max_bad_fraction,
        images=images,
        coverage=coverage,
        coverage_model=coverage_model,
        parameter_model=parameter_model,
        sketch=sketch,
        keep_observed=keep_observed,
    )
    if dry_run:
        steps = pipeline.plan(request)
        if as_json:
            click.echo(json.dumps(steps, indent=2))
        else:
            for step in steps:
                click.echo(f"{step['would']:>5}  {step['stage']}")
        return
    with options.progress() as progress:
        summaries = pipeline.populate(request, progress=progress)
    options.tell(summaries, as_json)
    if not as_json and not options.quiet():
        click.echo(f"Wrote {request.out}")
