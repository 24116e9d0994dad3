"""Options that mean the same in every command, and how results are told."""

from __future__ import annotations

import json
import logging
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING, Any, TypeVar

import click

from urbanforest_cli.core.progress import Progress, silent

if TYPE_CHECKING:
    from urbanforest_cli.core.config import Config
    from urbanforest_cli.core.summary import StageSummary

Function = TypeVar("Function", bound=Callable[..., Any])

LOG_EVERY_S = 30.0
LONG_S = 5.0
"""What a task takes at least for its end to be told."""
DECIDED_BY = (
    ("regress", ("regression",)),
    ("diffuse", ("context",)),
    ("place", ("placement", "species")),
    ("grow", ("growth",)),
)
"""Which stage's record tells which sections of the config a register was made with, beside those of `stencil`."""


def cores() -> int:
    """Return how many processors this process may use."""
    return len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count() or 1


class FilePath(click.Path):
    """A path, as `pathlib.Path`; whether it can be used is for the stage to say."""

    def __init__(self) -> None:
        super().__init__(path_type=Path)


config_opt = click.option(
    "-c", "--config", "config_path", type=FilePath(), metavar="CONFIG.toml",
    help="Config file, or the name of a shipped one such as paper/positional_a.",
)  # fmt: skip
set_opt = click.option(
    "--set", "settings", multiple=True, metavar="KEY=VALUE",
    help="Set one config key, for example rules.building_clearance_m=5. Repeatable.",
)  # fmt: skip
seed_opt = click.option("--seed", type=click.IntRange(0, 2**63 - 1), help="Root of every random stream.")
json_opt = click.option("--json", "as_json", is_flag=True, help="Print the result as JSON on standard output.")
workers_opt = click.option(
    "--workers", type=click.IntRange(1, 1024), default=cores, show_default="all cores",
    help="Threads to work with; the result is the same for any number.",
)  # fmt: skip
assume_crs_opt = click.option("--assume-crs", metavar="EPSG:CODE", help="CRS of input that states none.")
overwrite_opt = click.option("--overwrite", is_flag=True, help="Replace an output that exists.")
max_bad_opt = click.option(
    "--max-bad",
    "max_bad_fraction",
    type=click.FloatRange(0, 1),
    help="Share of lots with unusable geometry above which the exit code is 3.  [default: 0.1, from 20 lots on]",
)
layer_opt = click.option("--layer", "lots_layer", metavar="NAME", help="Layer that holds the lots.")
register_arg = click.argument("register", type=FilePath())


def _verbosity(ctx: click.Context, parameter: click.Parameter, value: bool) -> None:
    if value:
        ctx.meta["urbanforest.verbosity"] = parameter.name


def talk_opts(function: Function) -> Function:
    """Add ``-v``, ``-q`` and ``--debug``."""
    for names, text in (
        (("-v", "--verbose"), "Tell more."),
        (("-q", "--quiet"), "Tell nothing but errors."),
    ):
        function = click.option(*names, is_flag=True, expose_value=False, callback=_verbosity, help=text)(function)
    return click.option(
        "--debug", is_flag=True, expose_value=False, help="Show the traceback of a fault of this program."
    )(function)


def stack(*decorators: Callable[[Function], Function]) -> Callable[[Function], Function]:
    """Apply options so that help lists them in the order given."""

    def apply(function: Function) -> Function:
        for decorator in reversed(decorators):
            function = decorator(function)
        return function

    return apply


config_opts = stack(config_opt, set_opt, seed_opt)


def city_and_layer(city: Path, lots_layer: str | None) -> tuple[Path, str | None]:
    """Take ``FILE:LAYER`` apart, and refuse a file that is not there before anything slow is loaded."""
    path, colon, layer = str(city).rpartition(":")
    if colon and not city.exists() and Path(path).exists():
        return Path(path), lots_layer or layer
    if not city.exists() and "//" not in str(city) and ":/" not in str(city):
        from urbanforest_cli.core.errors import InputError

        raise InputError("no such file", where=city, next_step="check the path")
    return city, lots_layer


def refuse_inside_out(bbox: tuple[float, float, float, float] | None) -> None:
    """Refuse a box whose edges are not west, south, east, north, or lie nowhere."""
    if bbox is not None and not all(map(math.isfinite, bbox)):
        raise click.UsageError("--bbox takes four finite numbers: west south east north.")
    if bbox is not None and not (bbox[0] < bbox[2] and bbox[1] < bbox[3]):
        raise click.UsageError("--bbox takes west south east north: west must be below east, south below north.")


def quiet() -> bool:
    """Tell whether the user asked for silence."""
    return verbosity() == "quiet"


def verbosity() -> str | None:
    """Return what the user asked for: verbose, quiet or nothing."""
    context = click.get_current_context(silent=True)
    return context.meta.get("urbanforest.verbosity") if context is not None else None


def load(
    config_path: Path | None, settings: Iterable[str], seed: int | None, register: Path | None = None
) -> tuple[Config, int]:
    """Load the config in force and the seed; a stage that goes on with a register goes on with its config."""
    base = _in_force(register) if register is not None and config_path is None else None
    from urbanforest_cli.core.params import strategy_names
    from urbanforest_cli.files.configs import load_config

    config = load_config(
        config_path, settings=tuple(settings), seed=seed, known_strategies=strategy_names(), base=base
    ).config
    return config, config.seed


def _in_force(register: Path) -> dict[str, Any]:
    """Return the config that made a register as it is: of each section, that of the stage it decides."""
    from urbanforest_cli.files.manifest import read_manifest
    from urbanforest_cli.files.provenance import read_records, require_record

    stencil = require_record(register, "stencil")
    records = read_records(register)
    base: dict[str, Any] = {**stencil.config, "seed": stencil.seed}
    for stage, sections in DECIDED_BY:
        made = records[stage].config if stage in records else {}
        base |= {section: made[section] for section in sections if section in made}
    for export in read_manifest(register.parent).values():
        if isinstance(shown := export.options.get("export"), dict):  # what `populate` last showed
            base["export"] = shown
    return base


@contextmanager
def progress() -> Iterator[Progress]:
    """Yield a progress bar on a terminal, plain lines now and then in a log, nothing when quiet.

    Everything goes to standard error; standard output is for results.
    """
    logging.basicConfig(
        level=logging.DEBUG if verbosity() == "verbose" else logging.WARNING,
        stream=sys.stderr,
        format="%(levelname)s %(name)s: %(message)s",
    )
    logging.getLogger("numba").setLevel(logging.WARNING)
    for name in ("matplotlib", "PIL"):
        logging.getLogger(name).setLevel(logging.WARNING)
    if quiet():
        yield silent
    elif sys.stderr.isatty():
        with _bar() as bar:
            yield bar
    else:
        yield _LogLines()


@contextmanager
def _bar() -> Iterator[Progress]:
    from rich.console import Console
    from rich.progress import BarColumn, TaskID, TextColumn, TimeRemainingColumn
    from rich.progress import Progress as Bars

    tasks: dict[str, TaskID] = {}
    columns = (TextColumn("{task.description:<28}"), BarColumn(), TextColumn("{task.completed}/{task.total}"))
    with Bars(*columns, TimeRemainingColumn(), console=Console(stderr=True)) as bars:

        def report(task: str, done: int, total: int) -> None:
            if task not in tasks:
                tasks[task] = bars.add_task(task, total=total)
            bars.update(tasks[task], completed=done, total=total)

        yield report


class _LogLines:
    """One line when a task begins, one every half minute, and one when a task that took its time ends."""

    def __init__(self) -> None:
        self._begun: dict[str, float] = {}
        self._last: dict[str, float] = {}

    def __call__(self, task: str, done: int, total: int) -> None:
        now = time.monotonic()
        if task not in self._last or done >= total or now - self._last[task] >= LOG_EVERY_S:
            if self._last.get(task) == float("inf"):
                return
            took_s = now - self._begun.setdefault(task, now)
            share = f" {done} of {total}" if done and total > 1 else ""
            if done < total:
                click.echo(f"{task}{share} ...", err=True)
            elif took_s >= LONG_S:
                click.echo(f"{task} done in {took_s:.0f} s", err=True)
            self._last[task] = float("inf") if done >= total else now


def tell(summaries: Iterable[StageSummary], as_json: bool) -> None:
    """Tell what stages did: a few lines, or JSON."""
    summaries = list(summaries)
    if as_json:
        records = [summary.as_record() for summary in summaries]
        click.echo(json.dumps(records[0] if len(records) == 1 else records, indent=2, ensure_ascii=False))
        return
    if quiet():
        return
    for summary in summaries:
        state = "up to date" if summary.up_to_date else f"{summary.seconds:.1f} s"
        counts = ", ".join(f"{_number(value)} {name.replace('_', ' ')}" for name, value in summary.counts.items())
        click.echo(f"{summary.stage:<9} {state:>10}  {summary.sentence or counts}")
        for notice in summary.notices:
            click.echo(f"  warning: {notice.line()}", err=True)


def _number(value: float | str) -> str:
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 100 else f"{value:.3g}"
    return f"{value:,}" if isinstance(value, int) else value


def register_in(path: Path) -> Path:
    """Return the register of a folder that `populate` wrote, or the path itself if it is no folder."""
    return path / "register.gpkg" if path.is_dir() else path


def named_path(text: str, option: str) -> tuple[str, Path]:
    """Return name and path of ``NAME=PATH``.

    Raises
    ------
    click.BadParameter
        A part is missing.
    """
    name, equals, path = text.partition("=")
    if not (name.strip() and equals and path.strip()):
        raise click.BadParameter(f"{text!r} is not NAME=PATH", param_hint=option)
    return name.strip(), Path(path.strip())
