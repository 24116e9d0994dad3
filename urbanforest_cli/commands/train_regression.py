"""``urbanforest train-regression``."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING, Any

import click

from urbanforest_cli.commands import options
from urbanforest_cli.commands.train_coverage import onnx_path
from urbanforest_cli.regression.learning.settings import LOSSES, NETWORKS, UNUSED

if TYPE_CHECKING:
    from urbanforest_cli.core.notices import Notices
    from urbanforest_cli.core.progress import Progress
    from urbanforest_cli.regression.pair_table import PairTable


@click.command(short_help="Train a network to read placement parameters off coverage.")
@click.option("-o", "--output", type=options.FilePath(), metavar="MODEL.onnx", required=True, callback=onnx_path,
              help="Model to write.")  # fmt: skip
@click.option("--pairs", "pair_count", type=click.IntRange(100, 10_000_000), default=21_000, show_default=True,
              help="Pairs of coverage and parameters to make.")  # fmt: skip
@click.option("--lots", multiple=True, metavar="FILE[:LAYER]",
              help="Real lots to make some of the pairs on, with the buildings of the file. Repeatable.")  # fmt: skip
@click.option("--network", type=click.Choice(NETWORKS), default="informed", show_default=True,
              help="informed: lot, edge, scale and features; spreads and strategy. paper: as published.")  # fmt: skip
@click.option("--epochs", type=click.IntRange(1, 100_000), help="Times all pairs are shown.  [default: the network's]")
@click.option("--batch", type=click.IntRange(2, 4096), help="Pairs a step.  [default: the network's]")
@click.option("--learning-rate", type=click.FloatRange(0, 1, min_open=True),
              help="The highest.  [default: the network's]")  # fmt: skip
@click.option("--loss", type=click.Choice(LOSSES),
              help="mse: squared error. nll: and the likelihood of the spread.  [default: the network's]")  # fmt: skip
@click.option("--unused", type=click.Choice(UNUSED), default="masked", show_default=True,
              help="Parameters that a pair's strategy does not use: not taught, or taught as 0.")  # fmt: skip
@click.option("--validation-fraction", type=click.FloatRange(0, 0.9, min_open=True), default=0.2, show_default=True,
              help="Share of the lots that are only judged by.")  # fmt: skip
@click.option("--minutes", type=click.FloatRange(0, min_open=True), metavar="M",
              help="Stop after the epoch that ends later than this.")  # fmt: skip
@click.option("--seed", type=click.IntRange(0, 2**63 - 1), default=0, show_default=True,
              help="Root of every random stream.")  # fmt: skip
@click.option("--resume", is_flag=True, help="Go on from the last checkpoint, to the same model.")
@click.option("--work", type=options.FilePath(), metavar="FOLDER",
              help="Folder of checkpoint, metrics and sheets.  [default: MODEL-training]")  # fmt: skip
@click.option("--threads", type=click.IntRange(1, 1024), default=options.cores, show_default="all cores",
              help="Threads to train with; another number changes last digits.")  # fmt: skip
@options.overwrite_opt
@options.json_opt
@options.talk_opts
def command(
    output: Path,
    pair_count: int,
    lots: tuple[str, ...],
    network: Any,
    minutes: float | None,
    seed: int,
    resume: bool,
    work: Path | None,
    threads: int,
    overwrite: bool,
    as_json: bool,
    **changes: Any,
) -> None:
    """Train a network to read placement parameters off the coverage of a lot, and write it as a model for `regress`.

    The pairs to learn from are made first: lots planted by this program's own strategies with parameters over the
    table's ranges, seen as coverage maps show them. A fifth of the lots is kept to judge by. After each epoch the
    work folder has a checkpoint, metrics.csv, curves for TensorBoard and a sheet of pictures.

    \b
    Example:
        urbanforest train-regression -o parameters.onnx
        urbanforest train-regression -o parameters.onnx --pairs 100000 --lots delmar.gpkg:parcels
        urbanforest train-regression -o parameters.onnx --resume
        urbanforest train-regression -o paper.onnx --network paper
    """
    from urbanforest_cli.core.publish import folder_lock
    from urbanforest_cli.pipeline_pairs import make_pairs
    from urbanforest_cli.regression.learning.mixture import mixed_pairs
    from urbanforest_cli.regression.learning.settings import settings_for
    from urbanforest_cli.regression.learning.stage import CHECKPOINT, train_regression
    from urbanforest_cli.regression.learning.story import RegressionRequest

    def make(progress: Progress, notices: Notices) -> PairTable:
        def of_kind(count: int, kind: str, seed: int) -> PairTable:
            sources = [] if kind else [Path(source) for source in lots]
            return make_pairs(
                count, lots=sources, seed=seed, design=kind or None, workers=threads, notices=notices,
                progress=lambda task, done, total: progress(f"{task} {kind}".strip(), done, total),
            )  # fmt: skip

        return mixed_pairs(of_kind, pair_count, seed)

    request = RegressionRequest(
        make=make,
        pair_count=pair_count,
        lots=lots,
        output=output,
        work=work or output.with_name(f"{output.stem}-training"),
        settings=settings_for(network, seed=seed, **changes),
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
            summary = train_regression(request, progress=progress, on_epoch=tell_epoch)
        except BaseException as stop:
            if not isinstance(stop, Exception) and (request.work / CHECKPOINT).exists():
                click.echo("The last whole epoch is kept: the same command with --resume goes on from it.", err=True)
            raise
    options.tell([summary], as_json)
