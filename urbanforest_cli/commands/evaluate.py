"""``urbanforest evaluate``."""

from __future__ import annotations

import json
import math
from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from urbanforest_cli.commands import options

if TYPE_CHECKING:
    from urbanforest_cli.core.summary import StageSummary


class Place(click.ParamType):  # type: ignore[type-arg]
    """Easting and northing, as 500120,5300080."""

    name = "X,Y"

    def convert(self, value: Any, param: click.Parameter | None, ctx: click.Context | None) -> tuple[float, float]:
        """Return both, or refuse."""
        if isinstance(value, tuple):
            return float(value[0]), float(value[1])
        try:
            x, y = (float(part) for part in str(value).split(","))
        except ValueError:
            x = y = math.nan
        if not (math.isfinite(x) and math.isfinite(y)):
            self.fail(f"{value!r} is no place: X,Y in the CRS of the register, such as 500120,5300080")
        return x, y


@click.command(short_help="Judge placed plants against real ones, or against a coverage map.")
@click.argument("register", metavar="OUT", type=options.FilePath())
@click.option("--observed", metavar="FILE[:LAYER]", help="Points of real plants.")
@click.option("--buildings", metavar="FILE[:LAYER]", help="Buildings.  [default: layer buildings beside the points]")
@click.option(
    "--replicate", type=options.FilePath(), metavar="REGISTER",
    help="The same city under another seed: what the model scores against itself.",
)  # fmt: skip
@click.option("--tiles", metavar="FILE[:LAYER]", help="Polygons in which to count observed and placed plants.")
@click.option(
    "--coverage", type=options.FilePath(), metavar="FILE.tif", help="Coverage map to hold the crowns against."
)
@click.option(
    "--rules", type=options.FilePath(), metavar="REGISTER", help="The same city planted without the map, beside it."
)
@click.option("--envelopes", is_flag=True, help="Hold the envelopes of placement against the map, not grown crowns.")
@click.option("--plot", type=options.FilePath(), metavar="FILE.png", help="Write a page of plots.")
@click.option(
    "--sheet", type=options.FilePath(), metavar="FILE.png",
    help="Write image, coverage, regions, plants and the view from above, side by side.",
)  # fmt: skip
@click.option("--image", type=options.FilePath(), metavar="FILE", multiple=True, help="Aerial image for the sheet.")
@click.option(
    "--lots", "places", type=click.IntRange(1, 8), default=1, show_default=True, help="Places on the sheet, one a row."
)
@click.option(
    "--at", "at", type=Place(), metavar="X,Y", multiple=True,
    help="Middle of a place on the sheet, in the CRS of the register.  [default: where the most plants stand]",
)  # fmt: skip
@click.option(
    "--size", "size_m", type=click.FloatRange(10, 2000), default=120.0, show_default=True,
    help="Width of a place on the sheet, in metres.",
)  # fmt: skip
@click.option(
    "--min-plants", type=click.IntRange(4), default=5, show_default=True,
    help="Compare patterns in lots where both have this many plants.",
)  # fmt: skip
@click.option(
    "--max-lots", type=click.IntRange(2), default=2000, show_default=True,
    help="Compare patterns in a sample of so many lots where there are more.",
)  # fmt: skip
@options.assume_crs_opt
@options.seed_opt
@options.json_opt
@options.talk_opts
def command(
    register: Path,
    observed: str | None,
    buildings: str | None,
    replicate: Path | None,
    tiles: str | None,
    coverage: Path | None,
    rules: Path | None,
    envelopes: bool,
    plot: Path | None,
    sheet: Path | None,
    image: tuple[Path, ...],
    places: int,
    at: tuple[tuple[float, float], ...],
    size_m: float,
    min_plants: int,
    max_lots: int,
    assume_crs: str | None,
    seed: int | None,
    as_json: bool,
) -> None:
    """Judge the plants of OUT, a folder of populate or a register, lot by lot.

    Against real plants: counts first; then, at equal counts, how plants stand to one another, to the lot's edge and
    to buildings, and whether a classifier can tell placed from real. Against a coverage map: how well the crowns
    cover what the map covers, beside crowns that know less. Nothing is written into the register.

    \b
    Example:
        urbanforest evaluate rome-forest --observed rome.gpkg --plot rome.png
        urbanforest evaluate rome-forest --coverage rome-forest/coverage.tif --rules rules/register.gpkg
        urbanforest evaluate rome-forest --sheet sheet.png --image aerial.tif --at 290400,4640900 --size 150
    """
    from urbanforest_cli.commands.evaluate_tables import tell_evaluation
    from urbanforest_cli.evaluation.stage import EvaluationSummary, evaluate_register, refuse_plot_over

    register = options.register_in(register)
    if tiles is not None and observed is None:
        raise click.UsageError("--tiles counts observed plants: name them with --observed")
    if (rules is not None or envelopes) and coverage is None:
        raise click.UsageError("--rules and --envelopes hold crowns against a map: name it with --coverage")
    if sheet is None and (image or at):
        raise click.UsageError("--image and --at are of a sheet: name it with --sheet")
    if observed is None and coverage is None and sheet is None:
        raise click.UsageError("name real plants with --observed, a map with --coverage, or a --sheet to write")
    for picture in (plot, sheet):
        if picture is not None:
            refuse_plot_over(picture)
    told: list[StageSummary] = []
    with options.progress() as progress:
        if observed is not None or coverage is not None:
            summary = evaluate_register(
                register,
                observed=observed,
                buildings=buildings,
                replicate=replicate,
                tiles=tiles,
                coverage=coverage,
                rules=options.register_in(rules) if rules is not None else None,
                envelopes=envelopes,
                plot=plot,
                seed=seed or 0,
                min_plants=min_plants,
                max_lots=max_lots,
                assume_crs=assume_crs,
                progress=progress,
            )
            told.append(summary)
        if sheet is not None:
            from urbanforest_cli.pipeline_sheet import write_sheet

            config, _ = options.load(None, (), seed, register)
            told.append(
                write_sheet(
                    register,
                    sheet,
                    config=config,
                    images=image,
                    coverage=coverage,
                    at=at,
                    places=places,
                    size_m=size_m,
                    assume_crs=assume_crs,
                    workers=options.cores(),
                    progress=progress,
                )
            )
    if as_json:
        records = [one.as_record() for one in told]
        click.echo(json.dumps(records[0] if len(records) == 1 else records, indent=2, ensure_ascii=False))
    elif not options.quiet():
        for one in told:
            if isinstance(one, EvaluationSummary):
                tell_evaluation(one)
            else:
                options.tell([one], as_json=False)
